"""The paper's Table I and ours beside it: on simulated shapes of one frozen split, and on a recording.

    Chamfer    mean distance from prediction to target + mean distance back, not squared, mm (as in the paper's tables)
    vertex     mean distance from each vertex to where it should be, mm
    surface    mean distance from each point of a cloud to the predicted surface, mm: what nobody saw does not count

Every figure is a mean ± standard deviation over frames. Two views show 55 to 70 % of a body, so that the exact shape
scores 1.8 to 2.5 mm Chamfer on their clouds: `surface`, and where the truth is known `vertex`, tell shapes apart there.
The published figures are those of another finger, simulator and camera. Pinned by tests/test_evaluate.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.model import Model
from softmap_edge.registration.clouds import clouds_of
from softmap_edge.run import Run
from softmap_training.errors import TrainingError

Floats = NDArray[np.float64]

SCHEMA = "softmap.evaluation/1"
# Table I of the paper: Chamfer and vertex error in mm, mean and standard deviation; its own data.
PUBLISHED = {
    "laplacian": ((8.739, 3.67), (8.757, 4.811)),
    "deepsoro": ((4.520, 2.437), (7.970, 4.127)),
    "linear": ((2.726, 1.043), (2.620, 1.143)),
    "xgboost": ((1.28, 0.58), (0.868, 0.563)),
    "arap": ((0.867, 0.53), (0.438, 0.274)),
    "published": ((0.389, 0.188), (0.196, 0.098)),
}
PUBLISHED_REAL = {"deepsoro": (6.386, 1.367), "without residual": (5.681, 0.939), "with residual": (3.786, 0.61)}
TIMED = 50  # single commands that are timed


@dataclass
class Row:
    """One model on one set: per-frame errors (K,) mm by name, and what it took."""

    name: str
    errors: dict[str, Floats]
    told: dict[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return means and standard deviations in mm, the worst frame, and what was told."""
        found = {
            f"{name}_mm": {"mean": float(e.mean()), "sd": float(e.std()), "worst": float(e.max()),
                           "worst_frame": int(e.argmax())}
            for name, e in self.errors.items()
        }  # fmt: skip
        return {"name": self.name, **found, **self.told}


def on_shapes(
    name: str, predict: Callable[[Floats], Floats], commands: Floats, points: Floats, told: Mapping[str, Any]
) -> Row:
    """Judge a model on simulated shapes that taught it nothing.

    Args:
        name: of the row.
        predict: commands (n, C) mm → points (n, 3N) mm.
        commands, points: of the test part.
        told: `what` kind of model it is, seconds of training, numbers learned and so on.
    """
    found = np.asarray(predict(commands), np.float64).reshape(len(points), -1, 3)
    true = points.reshape(len(points), -1, 3)
    errors = {
        "chamfer": np.array([_chamfer(p, q) for p, q in zip(found, true)]),
        "vertex": np.linalg.norm(found - true, axis=2).mean(axis=1),
    }
    return Row(
        name, errors, {**told, "milliseconds": _milliseconds(predict, commands), "paper": _paper(told.get("what"))}
    )


def on_run(name: str, model: Model, run: Run, truth: Floats | None = None) -> Row:
    """Judge a model on a recording of clouds; `truth` (K, N, 3) mm are the true vertices where somebody knows them.

    Raises:
        TrainingError: the truth is of other frames or vertices.
    """
    shapes = np.asarray(model.predict(run))
    if truth is not None and truth.shape != shapes.shape:
        raise TrainingError(f"a truth of shape {truth.shape} for {shapes.shape} predicted; give that of this run")
    errors = judged(shapes, clouds_of(run), model.triangles)
    if truth is not None:
        errors["vertex"] = np.linalg.norm(shapes - truth, axis=2).mean(axis=1)
    return Row(name, errors)


def judged(shapes: Floats, clouds: list[Floats], triangles: NDArray[np.int32]) -> dict[str, Floats]:
    """Return the errors (K,) mm of shapes (K, N, 3) on clouds: Chamfer, and from the clouds to the surface."""
    corners = np.asarray(triangles).tolist()
    near = [_core.Surface(shape, corners).nearest(cloud)[1].mean() for shape, cloud in zip(shapes, clouds)]
    return {"chamfer": np.array([_chamfer(s, c) for s, c in zip(shapes, clouds)]), "surface": np.array(near)}


def fall(before: Row, after: Row, error: str) -> float:
    """Return by what share an error fell from one row to another, of its mean."""
    return 1.0 - float(after.errors[error].mean() / before.errors[error].mean())


def _chamfer(one: Floats, other: Floats) -> float:
    found = _core.chamfer(np.ascontiguousarray(one), np.ascontiguousarray(other))
    return float(found["there"] + found["back"])


def _milliseconds(predict: Callable[[Floats], Floats], commands: Floats) -> float:
    """Return the median time of a prediction at one command, ms."""
    times = []
    for k in range(TIMED):
        u = np.ascontiguousarray(commands[k % len(commands)][None])
        ahead = time.perf_counter()
        predict(u)
        times.append(time.perf_counter() - ahead)
    return 1e3 * float(np.median(times))


def _paper(name: str | None) -> dict[str, Any] | None:
    """Return what the paper gives for a model, on other data."""
    if name not in PUBLISHED:
        return None
    (chamfer, spread), (vertex, of_vertex) = PUBLISHED[name]
    return {
        "chamfer_mm": {"mean": chamfer, "sd": spread},
        "vertex_mm": {"mean": vertex, "sd": of_vertex},
        "on": "other data",
    }
