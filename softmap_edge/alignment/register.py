"""Register a finger's template to point clouds, one frame or a run: places of its vertices, sigma.

- `robust` (default) starts from the shape of the model that is nearest to the cloud, and moves as
  rigidly as possible about that shape. It fits the cloud to the surface, with weights that remove
  outliers (`rust/geometry/register.rs`).
- `paper` is the published objective: each vertex, or each handle of a model that has them, moves to
  its nearest point, starting at rest (`rust/geometry/paper.rs`).

Frame: the base. Unit: mm. Limit: clouds do not show the roll of a round finger, so the roll of the
vertices is that of the start. Pinned by tests/alignment/test_registration.py and
tests/geometry/test_handles.py.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.alignment.clouds import clouds_of
from softmap_edge.errors import RegistrationError
from softmap_edge.files.atomic import Document
from softmap_edge.model.model import Model
from softmap_edge.model.orientation import prior_under_gravity, priors_by_orientation
from softmap_edge.run.run import ROLL_SEEN, Run

Floats = NDArray[np.float64]
Mode = Literal["robust", "paper"]

SCHEMA = "softmap.registration/1"
LEAST_POINTS = 60  # of a cloud; fewer do not show where a finger is
# commands a channel among which the start is looked for; fewer where channels make too many
GRID, CANDIDATES = 9, 800
CLAMPED_MM = 1e-6  # vertices that no command moves by more are held by the clamp
PAPER_STRENGTH, PAPER_ROUNDS = 1.0, 100  # λ and rounds of `paper`: not in the paper
SEEN = 0.5  # points that must speak for a vertex to be seen
OWN_MM = 0.3  # how far vertices are off for other reasons than noise
SCALE = 0.02  # by which a cloud may be larger or smaller than the template without a word
UNITS = {"metres": 1e-3, "centimetres": 0.1, "inches": 1 / 25.4, "tenths of a mm": 10.0}
NEAR_UNIT = 2.0  # factor between the extent of a cloud and that of the template in another unit
POOR, LOST = 0.8, 0.5  # share of a cloud that counts: less is worth a word; less is another object
# of the usual share among the clouds of a run: a cloud of which less counts has seen nothing
AMID = 0.85
# of the robust cost between two starts of different shape: closer, the wrong one may have won
NEAR_COST = 0.1
PRINTED = 5  # frames with warnings that are printed


@dataclass(frozen=True, eq=False)
class Registered:
    """A template fitted to K clouds; `to_dict()` is the document softmap.registration/1.

    It prints as text.

    Attributes:
        vertices: (K, N, 3) mm.
        support: number of points of the cloud that determine a vertex, by their weights, (K, N);
            the robust mode uses at most 2000 points. A vertex without support was not seen, and its
            neighbours place it.
        frames: report of each cloud.
        mode: the method.
        seconds: computing time, s.
    """

    vertices: Floats
    support: Floats
    frames: list[Document]
    mode: Mode
    seconds: float

    @property
    def visible(self) -> NDArray[np.bool_]:
        """Which vertices (K, N) a cloud shows."""
        return self.support >= SEEN

    def to_dict(self) -> Document:
        """Return the document softmap.registration/1, without the vertices."""
        return {
            "schema": SCHEMA,
            "mode": self.mode,
            "frames": self.frames,
            "not_measured": "roll: what a round finger does about its own axis",
            "seconds": self.seconds,
        }

    def __str__(self) -> str:
        mean = {
            key: np.median([row[key] for row in self.frames])
            for key in ("residual_mm", "noise_mm", "used", "visible")
        }
        lines = [
            f"Registered {len(self.frames)} clouds ({self.mode}), "
            f"{1e3 * self.seconds / len(self.frames):.0f} ms each",
            f"  median: {mean['residual_mm']:.2f} mm RMS from cloud to surface, noise "
            f"{mean['noise_mm']:.2f} mm, {100 * mean['used']:.0f} % of the points count, "
            f"{100 * mean['visible']:.0f} % of the vertices were seen",
            "  not measured: roll, what a round finger does about its own axis",
        ]
        wrong = [row for row in self.frames if row["warnings"]]
        lines += [
            f"  look at cloud {row['frame']}: {'; '.join(row['warnings'])}"
            for row in wrong[:PRINTED]
        ]
        return "\n".join(
            [
                *lines,
                *([f"  and {len(wrong) - PRINTED} more (--json)"] if len(wrong) > PRINTED else []),
            ]
        )

    def run(self, of: Run) -> Run:
        """Return the run of clouds `of` as a run of vertices.

        It has `visible` and `sigma` (mm), and its roll is marked as not seen.
        """
        noise = np.array([row["noise_mm"] for row in self.frames])[:, None]
        sigma = np.sqrt(noise**2 / np.maximum(self.support, SEEN) + OWN_MM**2)
        extra = dict(of.extra) | {ROLL_SEEN: np.array(False)}
        return replace(
            of,
            points=None,
            start=None,
            vertices=self.vertices,
            visible=self.visible,
            sigma=sigma,
            extra=extra,
        )


def register(model: Model, of: Run | Sequence[Floats], mode: Mode = "robust") -> Registered:
    """Fit the template of a model to point clouds of its finger.

    Args:
        model: of the finger, with a surface (a bundle built from a finger, or from a sweep with
            triangles).
        of: a run of clouds, or clouds (M, 3) mm in the base frame.
        mode: "robust", or "paper" for the published objective.

    Returns:
        Registered: one frame for each cloud.

    Raises:
        RegistrationError: the model has no surface, or a cloud is empty, tiny, in another unit or
            of another object.
    """
    if not len(model.triangles):
        raise RegistrationError(
            f"the model of '{model.robot}' has no surface to lay onto a cloud; build it from a "
            "finger.toml, or from a sweep with triangles"
        )
    clouds = (
        clouds_of(of) if isinstance(of, Run) else [np.asarray(cloud, np.float64) for cloud in of]
    )
    if not clouds:
        raise RegistrationError(
            "the run has no seen frames (K = 0), so there is no cloud to lay a template onto"
        )
    for k, cloud in enumerate(clouds):
        _check(k, cloud, model.rest)
    ahead = time.perf_counter()
    core = _core.Registration(
        model.rest, np.asarray(model.triangles).tolist(), clamped(model).tolist()
    )
    if mode == "robust":
        found = _robust(core, model, of if isinstance(of, Run) else None, clouds)
    else:
        found = _published(core, model, clouds)
    seconds = time.perf_counter() - ahead
    frames = [_row(k, one, mode) for k, one in enumerate(found)]
    used = float(np.median([row["used"] for row in frames]))
    if used < LOST:
        raise RegistrationError(
            f"only {100 * used:.0f} % of the points lie on the template (median of {len(frames)} "
            f"clouds), {100 * LOST:.0f} % are needed: another object, another frame than the "
            "base, or another finger; align the run, cut the finger out of the cloud"
        )
    support = np.array([one["support"] for one in found])
    # one that is something else, or may as well be another shape, has seen nothing
    for row in frames:
        if row["doubtful"] or row["used"] < max(LOST, AMID * used):
            support[row["frame"]] = 0.0
    return Registered(np.array([one["vertices"] for one in found]), support, frames, mode, seconds)


def clamped(model: Model) -> NDArray[np.int64]:
    """Return the vertices that no command moves, because the clamp holds them."""
    shapes = np.asarray(model.prior.evaluate(np.array(_candidates(model)))).reshape(
        -1, *model.rest.shape
    )
    return np.flatnonzero(np.ptp(shapes, axis=0).max(axis=1) <= CLAMPED_MM)


def _candidates(model: Model) -> list[list[float]]:
    """Return commands that cover the range of a model."""
    low, high = model.command_range.T
    each = max(2, min(GRID, int(CANDIDATES ** (1.0 / max(1, model.channels)))))
    axes = [np.linspace(a, b, each) for a, b in zip(low, high)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, model.channels).tolist()


def _check(k: int, cloud: Floats, rest: Floats) -> None:
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise RegistrationError(f"cloud {k}: points of shape {cloud.shape}, expected (M, 3) in mm")
    if len(cloud) < LEAST_POINTS:
        raise RegistrationError(
            f"cloud {k}: {len(cloud)} points, {LEAST_POINTS} or more show where a finger is; "
            "leave it out"
        )
    low, high = np.quantile(cloud, [0.05, 0.95], axis=0)  # what flies about is not an extent
    ratio = float(np.linalg.norm(high - low) / np.linalg.norm(np.ptp(rest, axis=0)))
    for unit, factor in UNITS.items():
        if factor / NEAR_UNIT < ratio < factor * NEAR_UNIT:
            raise RegistrationError(
                f"cloud {k}: {ratio:.2g} times as large as the template, as if it were in {unit}; "
                f"multiply by {1 / factor:g}"
            )


def _robust(
    core: _core.Registration, model: Model, run: Run | None, clouds: list[Floats]
) -> list[Document]:
    """Register clouds, each from the shapes of the model in its orientation."""
    low, high = model.command_range.T.tolist()
    found: list[Document] = [{}] * len(clouds)
    for rows, shape in (
        [(np.arange(len(clouds)), prior_under_gravity(model))]
        if run is None
        else priors_by_orientation(model, run)
    ):
        some = core.robust(shape, [clouds[k] for k in rows], _candidates(model), low, high)
        for k, one in zip(rows, some):
            found[k] = one
    return found


def _published(core: _core.Registration, model: Model, clouds: list[Floats]) -> list[Document]:
    """Register clouds by the published objective.

    Only handles are matched to points, and points only to handles.
    """
    handles = np.arange(len(model.rest)) if model.handles is None else model.handles
    strength, found = np.zeros(len(model.rest)), []
    strength[handles] = PAPER_STRENGTH
    for cloud in clouds:
        vertices, rounds = core.published(cloud, strength, PAPER_ROUNDS)
        distance, _ = _core.chamfer(vertices, cloud)["to_template"]
        _, nearest = _core.chamfer(vertices[handles], cloud)["to_template"]
        support = np.zeros(len(vertices))
        support[handles] = np.bincount(nearest, minlength=len(handles))
        rms = float(np.sqrt(np.mean(np.square(distance))))
        found.append(
            dict(
                vertices=vertices,
                support=support,
                rounds=rounds,
                settled=rounds < PAPER_ROUNDS,
                residual_mm=rms,
                noise_mm=float(np.median(distance)),
                used=1.0,
            )
        )
    return found


def _row(k: int, one: Document, mode: Mode) -> Document:
    """Return the report of one frame: numbers and warnings."""
    row: Document = {
        "frame": k,
        "residual_mm": float(one["residual_mm"]),
        "noise_mm": float(one["noise_mm"]),
        "used": float(one["used"]),
        "visible": float(np.mean(one["support"] >= SEEN)),
        "rounds": int(one["rounds"]),
        "settled": bool(one["settled"]),
    }
    if mode == "robust":
        row |= {
            "start": np.asarray(one["command"]).tolist(),
            "start_cost": float(one["start_cost"]),
            "scale": float(one["scale"]),
        }
    row["doubtful"] = (
        one.get("other") is not None and one["other"][0] < row["start_cost"] + NEAR_COST
    )
    row["warnings"] = _warnings(row, one)
    return row


def _warnings(row: Document, one: Document) -> list[str]:
    warnings = []
    if "scale" in row and abs(row["scale"] - 1.0) > SCALE:
        percent = 100.0 * (row["scale"] - 1.0)
        warnings.append(
            f"the cloud is {abs(percent):.0f} % {'larger' if percent > 0 else 'smaller'} than the "
            "template: check unit and calibration"
        )
    if row["used"] < POOR:
        warnings.append(
            f"{100 * row['used']:.0f} % of the cloud lie on the template; the rest is something "
            "else, or the start was wrong"
        )
    if row["doubtful"]:
        warnings.append(
            f"another shape, {one['other'][1]:.0f} mm RMS away, explains the cloud nearly as well"
        )
    return warnings
