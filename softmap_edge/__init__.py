"""Simulate, compare and diagnose tendon-driven soft robots.

The public names below are imported when they are first used, so that `import softmap_edge` stays quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from softmap_edge.errors import SoftmapError

if TYPE_CHECKING:
    from softmap_edge._core import effects
    from softmap_edge.adaptation import adapt
    from softmap_edge.bundle import builtin_model, load_bundle, save_bundle
    from softmap_edge.diagnosis.comparison import Comparison, compare
    from softmap_edge.diagnosis.diagnose import diagnose, refit
    from softmap_edge.diagnosis.document import Diagnosis
    from softmap_edge.diagnosis.series import series
    from softmap_edge.experiment.choose import Experiment, next_experiment
    from softmap_edge.logs.guess import guess_mapping
    from softmap_edge.logs.importer import import_logs
    from softmap_edge.logs.mapping import read_mapping
    from softmap_edge.model import Model
    from softmap_edge.own_effect import forget_effect, load_effect
    from softmap_edge.report.html import write_html
    from softmap_edge.residual import learn_residual
    from softmap_edge.rod.learn import learn_model
    from softmap_edge.rod.robot import Robot
    from softmap_edge.run import Run
    from softmap_edge.run_join import join_runs
    from softmap_edge.servo.bench import open_robot
    from softmap_edge.solid.build import build_model
    from softmap_edge.solid.finger import Finger
    from softmap_edge.solid.simulator import Simulator

__version__ = "0.1.0"
__all__ = [
    "Comparison",
    "Diagnosis",
    "Experiment",
    "Finger",
    "Model",
    "Robot",
    "Run",
    "Simulator",
    "SoftmapError",
    "__version__",
    "adapt",
    "build_model",
    "builtin_model",
    "compare",
    "diagnose",
    "effects",
    "forget_effect",
    "guess_mapping",
    "import_logs",
    "join_runs",
    "learn_model",
    "learn_residual",
    "load_bundle",
    "load_effect",
    "next_experiment",
    "open_robot",
    "read_mapping",
    "refit",
    "save_bundle",
    "series",
    "write_html",
]

# Which module of the package holds which public name.
_HOMES = {
    "_core": ["effects"],
    "adaptation": ["adapt"],
    "solid.build": ["build_model"],
    "bundle": ["builtin_model", "load_bundle", "save_bundle"],
    "diagnosis.comparison": ["Comparison", "compare"],
    "diagnosis.series": ["series"],
    "diagnosis.diagnose": ["diagnose", "refit"],
    "diagnosis.document": ["Diagnosis"],
    "experiment.choose": ["Experiment", "next_experiment"],
    "solid.finger": ["Finger"],
    "logs.guess": ["guess_mapping"],
    "logs.importer": ["import_logs"],
    "logs.mapping": ["read_mapping"],
    "model": ["Model"],
    "own_effect": ["forget_effect", "load_effect"],
    "report.html": ["write_html"],
    "residual": ["learn_residual"],
    "rod.robot": ["Robot"],
    "rod.learn": ["learn_model"],
    "run": ["Run"],
    "run_join": ["join_runs"],
    "servo.bench": ["open_robot"],
    "solid.simulator": ["Simulator"],
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'softmap_edge' has no attribute '{name}'; there are {', '.join(__all__)}")
    value = getattr(importlib.import_module(f"softmap_edge.{_HOME[name]}"), name)
    globals()[name] = value  # asked once; later uses are plain attributes
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
