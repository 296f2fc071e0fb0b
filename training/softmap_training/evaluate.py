"""The paper's Table I and ours, on simulated shapes of one frozen split and on a recording.

    chamfer    mean distance from prediction to target + mean distance back, not squared, mm (as in
               the paper's tables)
    visible    the same, of the vertices alone that registration finds in the cloud: unseen vertices
               do not count
    surface    mean distance from each point of a cloud to the predicted surface, mm: one-sided
    `whole`    Chamfer to the true vertices of a recording, where they are known: no view is missing
    vertex     mean distance from each vertex to where it should be, mm

Every figure is a mean ± standard deviation over frames. For random training, it is the mean over
seeds and the standard deviation of that mean between seeds. Two views show 55 to 70 % of a body, so
the exact shape scores 1.8 to 2.5 mm Chamfer on their clouds. There, `surface`, and with known truth
`vertex`, distinguish shapes. The points of a decoder are not vertices: it has neither `visible`
nor, on a recording, `vertex`. The published figures are those of another finger, simulator and
camera. Pinned by tests/training/test_evaluate.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.alignment.base_in_clouds import base_stood_off, in_base
from softmap_edge.alignment.clouds import clouds_of
from softmap_edge.alignment.register import register
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import FingerTemplate, Simulator, tour
from softmap_edge.model.model import Model
from softmap_edge.run.run import Run
from softmap_training.errors import TrainingError

Floats = NDArray[np.float64]
Triangles = NDArray[np.int32]

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
PUBLISHED_REAL = {
    "deepsoro": (6.386, 1.367),
    "without residual": (5.681, 0.939),
    "with residual": (3.786, 0.61),
}
# fall of the Chamfer distance with the residual, relative to these
FALLS = {"without residual": 0.334, "deepsoro": 0.407}
ERRORS = ("chamfer", "visible", "surface", "whole", "vertex")
TIMES = ("seconds", "milliseconds")
NODE_MM = 1e-6
TIMED = 50  # number of timed single commands


@dataclass(eq=False)
class Row:
    """One model on one set or recording of K frames.

    `errors` (S, K) mm of S seeds by name · `details` kind and cost · `shapes` (K, N, 3) mm of the
    first seed with `triangles`, and the `seen` points of each, for figures.
    """

    name: str
    errors: dict[str, Floats]
    details: dict[str, Any] = field(default_factory=dict)
    shapes: Floats = field(default_factory=lambda: np.zeros((0, 0, 3)), repr=False)
    triangles: Triangles = field(default_factory=lambda: np.zeros((0, 3), np.int32), repr=False)
    seen: Sequence[Floats] = field(default=(), repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Return means and standard deviations in mm, the worst frame, and the details.

        Deviations are over frames, and of the mean between seeds if there are several.
        """
        found = {
            f"{name}_mm": {
                "mean": float(np.nanmean(e)),
                "sd": float(np.nanstd(e, axis=1).mean()),
                "sd_of_seeds": float(np.nanmean(e, axis=1).std(ddof=1)) if len(e) > 1 else None,
                "worst": float(np.nanmax(e[0])),
                "worst_frame": int(np.nanargmax(e[0])),
            }
            for name, e in self.errors.items()
        }
        return {
            "name": self.name,
            "seeds": len(next(iter(self.errors.values()))),
            **found,
            **self.details,
        }

    @classmethod
    def of_seeds(cls, rows: Sequence[Row]) -> Row:
        """Merge the rows of several seeds: errors stacked, times averaged."""
        errors = {
            name: np.concatenate([row.errors[name] for row in rows]) for name in rows[0].errors
        }
        details = dict(rows[0].details)
        details |= {
            key: float(np.mean([row.details[key] for row in rows]))
            for key in TIMES
            if key in details
        }
        return replace(rows[0], errors=errors, details=details)


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording for validation: clouds, fitted vertices (K, N), and true ones if known."""

    run: Run
    clouds: list[Floats]
    laid: Run
    truth: Floats | None = None
    remarks: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, run: Run, model: Model, truth: Floats | None = None) -> Recording:
        """Return the recording of a run of clouds, in the frame of its base.

        Registration uses the model without its residual.

        Args:
            run: a run that was not used for training.
            model: the model of the finger.
            truth: true vertices (K, N, 3) mm.

        Raises:
            TrainingError: the truth is of other frames or vertices.
        """
        shape = (run.frames, *model.rest.shape)
        if truth is not None and truth.shape != shape:
            raise TrainingError(
                f"a truth of shape {truth.shape} for {shape} predicted; give that of this run"
            )
        base = model.with_residual(None)
        run, stood = in_base(run, base)
        remarks = [] if stood is None else [base_stood_off(stood.pose)]
        return cls(run, clouds_of(run), register(base, run).run(run), truth, remarks)

    @property
    def visible(self) -> Floats:
        """Which vertices (K, N) the clouds show: 0 or 1."""
        return np.asarray(self.laid.visible, np.float64)

    def evaluate(self, name: str, model: Model, details: Mapping[str, Any] | None = None) -> Row:
        """Evaluate a model."""
        shapes = np.asarray(model.predict(self.run))
        return self.evaluate_shapes(
            name, shapes, model.triangles, details, body=not is_decoder(model)
        )

    def evaluate_shapes(
        self,
        name: str,
        shapes: Floats,
        triangles: Triangles,
        details: Mapping[str, Any] | None = None,
        body: bool = True,
    ) -> Row:
        """Evaluate shapes (K, N, 3) mm and their surface.

        Without `body`, their points are not vertices.
        """
        found = {
            "chamfer": [_chamfer(s, c) for s, c in zip(shapes, self.clouds)],
            "surface": [_to_surface(s, c, triangles) for s, c in zip(shapes, self.clouds)],
        }
        if body and self.visible.any():
            each = zip(shapes, self.clouds, self.visible)
            # NaN: a doubtful frame
            found["visible"] = [_chamfer(s, c, v) if v.any() else np.nan for s, c, v in each]
        if self.truth is not None:
            found["whole"] = [_chamfer(s, t) for s, t in zip(shapes, self.truth)]
        if self.truth is not None and body:
            found["vertex"] = list(np.linalg.norm(shapes - self.truth, axis=2).mean(axis=1))
        errors = {error: np.array([found[error]]) for error in ERRORS if error in found}
        return Row(name, errors, dict(details or {}), shapes, triangles, self.clouds)


def on_shapes(
    name: str,
    predict: Callable[[Floats], Floats],
    commands: Floats,
    points: Floats,
    details: Mapping[str, Any],
    triangles: Triangles | None = None,
) -> Row:
    """Evaluate a model on simulated shapes of the test part.

    Args:
        name: name of the row.
        predict: commands (n, C) mm → points (n, 3N) mm.
        commands, points: the test part.
        details: kind (`what`), training time in s, number of parameters and so on.
        triangles: triangles of the template.
    """
    found = np.asarray(predict(commands), np.float64).reshape(len(points), -1, 3)
    true = points.reshape(len(points), -1, 3)
    errors = {
        "chamfer": np.array([[_chamfer(p, q) for p, q in zip(found, true)]]),
        "vertex": np.linalg.norm(found - true, axis=2).mean(axis=1)[None],
    }
    took = {"milliseconds": milliseconds(predict, commands), "paper": _paper(details.get("what"))}
    surface = np.zeros((0, 3), np.int32) if triangles is None else triangles
    return Row(name, errors, {**details, **took}, found, surface, list(true))


def holds_shapes_of(model: Model, u: Floats) -> bool:
    """Return whether a model is a table with all commands (n, C) as nodes.

    A learned table has these nodes, but only the training part was used.
    """
    if not isinstance(model.prior, _core.Table) or not len(u) or "prior" in model.made_from:
        return False
    return all(
        np.abs(u[:, c, None] - axis).min(axis=1).max() < NODE_MM
        for c, axis in enumerate(model.prior.axes)
    )


def halfway(model: Model, u: Floats, finger: Finger) -> tuple[Floats, Floats]:
    """Return commands (n, C) half a cell from the nodes u of a table, and their shapes.

    They are shifted towards the middle; the shapes are (n, 3N) mm.

    The finger is simulated there. So a table with all nodes is evaluated where it interpolates, as
    far from its nodes as possible.
    """
    moved = np.empty_like(u)
    for c, axis in enumerate(model.prior.axes):
        node = np.abs(u[:, c, None] - axis).argmin(axis=1)
        moved[:, c] = 0.5 * (axis[node] + axis[node + np.where(node > (len(axis) - 1) // 2, -1, 1)])
    order = tour(moved)
    shapes = np.empty((len(u), model.rest.size))
    simulator = Simulator(finger, FingerTemplate(model.rest, model.triangles))
    shapes[order] = simulator.path(moved[order]).reshape(len(u), -1)
    return moved, shapes


def fall(before: Row, after: Row) -> dict[str, float]:
    """Return the relative fall of each mean error from one row to the other."""
    return {
        name: 1.0 - float(np.nanmean(after.errors[name]) / np.nanmean(before.errors[name]))
        for name in before.errors
        if name in after.errors
    }


def is_decoder(model: Model) -> bool:
    """Return whether a model's points are not vertices of its finger.

    Such a model comes from `softmap train prior --model deepsoro`.
    """
    return (model.made_from.get("prior") or {}).get("kind") == "deepsoro"


def size_of(model: Model) -> int:
    """Return the number of parameters of a model's prior and residual."""
    if is_decoder(model):  # its table is only the output of onnxruntime
        return int(model.made_from["prior"]["parameters"])
    if model.arrays is None:
        raise TrainingError(f"the model of '{model.robot}' has no arrays; load it from a bundle")
    contents = model.arrays.contents()
    return sum(
        shape.parameters
        if isinstance(shape, _core.Network)
        else sum(np.size(array) for array in contents.get(name, {}).values())
        for name, shape in (("prior", model.prior), ("residual", model.residual))
    )


def predicting(model: Model) -> Callable[[Floats], Floats]:
    """Return a model's points (n, 3N) mm for commands (n, C) mm, with its residual."""
    shape = model.prior if model.residual is None else _core.Sum(model.prior, model.residual)
    return lambda u: np.asarray(shape.evaluate(u))


def milliseconds(predict: Callable[[Floats], Floats], commands: Floats) -> float:
    """Return the median time of a prediction at one command, ms."""
    times = []
    for k in range(TIMED):
        u = np.ascontiguousarray(commands[k % len(commands)][None])
        ahead = time.perf_counter()
        predict(u)
        times.append(time.perf_counter() - ahead)
    return 1e3 * float(np.median(times))


def _chamfer(one: Floats, other: Floats, seen: Floats | None = None) -> float:
    found = _core.chamfer(np.ascontiguousarray(one), np.ascontiguousarray(other), seen)
    return float(found["there"] + found["back"])


def _to_surface(shape: Floats, cloud: Floats, triangles: Triangles) -> float:
    corners = np.asarray(triangles).tolist()
    return float(_core.Surface(np.ascontiguousarray(shape), corners).nearest(cloud)[1].mean())


def _paper(name: str | None) -> dict[str, Any] | None:
    """Return the paper's figures for a model, on other data."""
    if name not in PUBLISHED:
        return None
    (chamfer, spread), (vertex, of_vertex) = PUBLISHED[name]
    return {
        "chamfer_mm": {"mean": chamfer, "sd": spread},
        "vertex_mm": {"mean": vertex, "sd": of_vertex},
        "on": "other data",
    }
