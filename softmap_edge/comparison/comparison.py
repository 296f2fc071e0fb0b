"""Measure the error of a model on a run, and map it over the conditions of the run.

The conditions are section, direction, speed, dwell, history, command and time.

    d(k, n) = |predicted - seen| of point n in frame k, mm, visible points only
    rms = sqrt(mean d²); tip = the same for the centroid of the tip points
    rms of a cell = over the points of its frames

Nothing is fitted here. The error is held out only if the run took no part in making the model.
Units: mm, s. Pinned by tests/comparison/test_compare.py.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.checks.leverage import hardly_follows
from softmap_edge.checks.lost_points import without_lost
from softmap_edge.checks.unanswered import ENGAGED, unanswered
from softmap_edge.errors import ComparisonError
from softmap_edge.files.atomic import Document
from softmap_edge.model.views import members, roll_seen, without_roll
from softmap_edge.noise.floor import (
    BOUND,
    commanded,
    memoryless_floor,
    noise_floor,
    rms,
    some_points,
)
from softmap_edge.run.conditions import Bin, Cell, cells, conditions
from softmap_edge.run.run import Run, known

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.noise.memoryless import Repeats

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SCHEMA = "softmap.comparison/1"


@dataclass(frozen=True)
class MemorylessFloor:
    """The lowest error of any model without memory on the frames whose pose is repeated.

    Attributes:
        mm: this error, RMS in mm.
        poses: number of poses that were visited repeatedly.
        passages: number of their visits.
        frames: number of their frames.
        error_mm: error of the compared model on these frames, RMS in mm; None if unknown.
    """

    mm: float
    poses: int
    passages: int
    frames: int
    error_mm: float | None = None

    def to_dict(self) -> Document:
        """Return it as plain numbers."""
        return asdict(self)


@dataclass(frozen=True)
class Comparison:
    """The error of one model on one run; `to_dict()` is the document softmap.comparison/1.

    It prints as text.
    """

    run: Document
    bundle: Document
    frames: int
    error: dict[str, float]
    noise_floor_mm: float | None
    where: dict[str, list[Bin]]
    worst: Document
    made_from: Document
    memoryless: MemorylessFloor | None = None  # None where too few poses are repeated

    def __str__(self) -> str:
        from softmap_edge.comparison.text import comparison_text

        return comparison_text(self)

    @property
    def floor_kind(self) -> str:
        """The data behind the noise floor, in words."""
        return str(self.made_from.get("noise_floor", "origin not stated"))

    @property
    def floor_is_bound(self) -> bool:
        """Whether the noise floor contains more than noise."""
        return self.floor_kind.endswith(BOUND)

    def to_dict(self) -> Document:
        """Return the document softmap.comparison/1: plain numbers, strings, lists and dicts."""
        return {
            "schema": SCHEMA,
            "run": self.run,
            "bundle": self.bundle,
            "frames": self.frames,
            "error": {
                key: value if math.isfinite(value) else None for key, value in self.error.items()
            },
            "noise_floor_mm": self.noise_floor_mm,
            "memoryless_floor": None if self.memoryless is None else self.memoryless.to_dict(),
            "where": {name: [asdict(row) for row in rows] for name, rows in self.where.items()},
            "worst": self.worst,
            "made_from": self.made_from,
        }

    @classmethod
    def from_dict(cls, document: object) -> Comparison:
        """Read a document softmap.comparison/1.

        Args:
            document: the result of `to_dict()`, also after a JSON round trip.

        Returns:
            Comparison: equal to the one that was written.

        Raises:
            ComparisonError: another schema, or a missing or malformed entry.
        """
        schema = document.get("schema") if isinstance(document, dict) else None
        if not isinstance(document, dict) or schema != SCHEMA:
            raise ComparisonError(
                f"this is no comparison: schema {schema!r}, expected {SCHEMA!r}; make one with "
                "`softmap compare --json`"
            )
        try:
            where = {
                str(name): [_bin(row) for row in rows] for name, rows in document["where"].items()
            }
            floor = document["noise_floor_mm"]
            return cls(
                run=dict(document["run"]),
                bundle=dict(document["bundle"]),
                frames=int(document["frames"]),
                error={key: _length(document["error"][key]) for key in ERROR_KEYS},
                noise_floor_mm=None if floor is None else float(floor),
                where=where,
                worst=dict(document["worst"]),
                made_from=dict(document["made_from"]),
                memoryless=_memoryless(document.get("memoryless_floor")),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ComparisonError(
                f"damaged comparison ({type(error).__name__}: {error}); make it again with "
                "`softmap compare --json`"
            ) from None


TIMED = ("speed", "dwell", "time")  # error maps that a log without time does not have
ERROR_KEYS = ("rms_mm", "median_mm", "p95_mm", "max_mm", "tip_rms_mm")


def compare(model: Model, run: Run) -> Comparison:
    """Measure the error of a model on a run, and map it over the run's conditions.

    Args:
        model: predicts (K, N, 3) mm for the run by `predict(run)`.
        run: a run with points that keep their identity (vertices or markers) in at least one frame.

    Returns:
        Comparison: error figures, noise floor and the map of the error over the conditions of the
        run.

    Raises:
        ComparisonError: nothing is visible, or prediction and measurement do not match.
        RunError: the run is of another robot.
    """
    run, _ = without_lost(run)
    predicted, seen, visible = aligned(model, run)
    squared = np.where(visible, np.sum((predicted - seen) ** 2, axis=2), 0.0)  # (K, N) mm²
    distance = np.sqrt(squared[visible])
    state = conditions(run, model.commands(run))
    where = {"section": _by_section(model, squared, visible, run.marker_names)}
    for name, row in cells(state, model.command_unit).items():
        if run.timeless and name in TIMED:
            continue
        where[name] = [_bin_of(cell, squared, visible) for cell in row]
    where = {name: [row for row in rows if row.n > 0] for name, rows in where.items()}
    tip_seen, tip_predicted = tips(model, predicted, seen, visible)
    with_tip = ~np.isnan(tip_seen[:, 0])
    error = {
        "rms_mm": math.sqrt(float(np.mean(distance**2))),
        "median_mm": float(np.median(distance)),
        "p95_mm": float(np.percentile(distance, 95)),
        "max_mm": float(np.max(distance)),
        "tip_rms_mm": rms(np.sum((tip_predicted - tip_seen)[with_tip] ** 2, axis=1)),
    }
    stands = conditions(run, commanded(run))
    floor, kind = noise_floor(stands, seen, visible, predicted, template(model, seen))
    repeats = memoryless_floor(run, state, seen, visible)
    return Comparison(
        run={"robot": run.robot or "not named", "sha256": run.hash()},
        bundle={
            "robot": model.robot,
            "effects": list(model.chain_names),
            "sha256": model_digest(model),
        },
        frames=len(seen),
        error=error,
        noise_floor_mm=floor,
        where=where,
        worst=_worst(where, squared, visible, run),
        made_from=_made_from(kind, model, run),
        memoryless=_floor_of(repeats, squared, visible),
    )


def still(model: Model, run: Run) -> str | None:
    """Return a sentence if the robot of a run does not move, or hardly, though commands change."""
    if np.ptp(commanded(run), axis=0).any() and (text := unanswered(run)):
        return text
    run, _ = without_lost(run)
    predicted, seen, visible = aligned(model, run)
    u = np.asarray(model.commands(run), float)
    at = [np.interp(run.t_seen, run.t, column) for column in u.T]
    found = hardly_follows(np.stack(at, axis=1), seen, visible, predicted) if at else None
    return None if found is None else f"the robot hardly follows its commands: {found}; {ENGAGED}"


def _floor_of(repeats: Repeats | None, squared: Floats, visible: Mask) -> MemorylessFloor | None:
    """Return the lowest error without memory, and the model's error on the same points."""
    if repeats is None or not math.isfinite(repeats.lowest_mm):
        return None
    points = np.ix_(repeats.rows, some_points(visible))
    return MemorylessFloor(
        repeats.lowest_mm,
        repeats.poses,
        repeats.passages,
        len(repeats.rows),
        rms(squared[points][visible[points]]),
    )


def aligned(model: Model, run: Run) -> tuple[Floats, Floats, Mask]:
    """Return prediction, measurement (hidden points zero) and visibility, with equal shapes.

    Raise an error with the reason if they do not match.
    """
    if len(run.t_seen) == 0:
        raise ComparisonError(
            "the run has no seen frames (K = 0), so there is nothing to compare with; record one "
            "that is seen"
        )
    seen = np.asarray(model.points_in_mm(run), float)
    predicted = np.asarray(model.predict(run), float)
    if predicted.shape != seen.shape:
        raise ComparisonError(
            f"the model predicts {predicted.shape} (frames, points, xyz), the run has "
            f"{seen.shape}; take the bundle of this robot and template"
        )
    visible = known(run, seen)
    if not visible.any():
        raise ComparisonError(
            "no point is visible in any frame of the run; check its field `visible`"
        )
    if not np.isfinite(predicted[visible]).all():
        raise ComparisonError(
            "the model predicts values that are not finite for this run; look at it with `softmap "
            "check`"
        )
    seen = np.where(visible[..., None], seen, 0.0)
    # rotation about the body's axis was not measured, and is not counted
    if not roll_seen(model, run):
        off = np.where(visible[..., None], seen - predicted, 0.0)[..., None]
        predicted = (
            seen
            - without_roll(members(model.sections), off, predicted, visible.astype(float))[..., 0]
        )
    return predicted, seen, visible


def mean_root(squared: Floats, visible: Mask, axis: int) -> Floats:
    """Return the RMS mm of squares (K, N) mm² along an axis, of visible ones; NaN without any."""
    count = visible.sum(axis=axis)
    total = squared.sum(axis=axis)
    return np.asarray(
        np.sqrt(np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0))
    )


def tips(model: Model, predicted: Floats, seen: Floats, visible: Mask) -> tuple[Floats, Floats]:
    """Return measured and predicted tips (K, 3) mm, means of the visible tip points, else NaN.

    If markers are carried on a template, the marker that moves most is the tip.
    """
    index = np.asarray(model.tip_indices, int)
    if seen.shape[1] != len(model.rest):
        index = np.array([int(np.argmax(np.linalg.norm(np.ptp(predicted, axis=0), axis=1)))])
    weight = visible[:, index].astype(float)  # (K, n)
    count = weight.sum(axis=1)
    scale = np.divide(1.0, count, out=np.full(len(count), np.nan), where=count > 0)[:, None]
    both = [
        np.einsum("kn,knc->kc", weight, points[:, index]) * scale for points in (seen, predicted)
    ]
    return both[0], both[1]


def _by_section(model: Model, squared: Floats, visible: Mask, names: list[str]) -> list[Bin]:
    """One bin per section of the template, base first, with its heights, or one per marker."""
    count = squared.shape[1]
    markers = model.markers or len(model.rest) != count
    sections = np.arange(count) if markers else np.asarray(model.sections)
    labels = np.unique(sections)
    rows = []
    for position, section in enumerate(labels):
        member = sections == section
        sums, counts = squared[:, member], visible[:, member]
        if not counts.any():
            continue
        end = {0: " base", len(labels) - 1: " tip"}.get(position, "")
        own = names[section] if names else f"marker {position + 1}"
        name = own if markers else f"{position + 1}{end}"
        height = None if markers else np.asarray(model.structure.arc_length)[member]
        low, high = (None, None) if height is None else (float(height.min()), float(height.max()))
        rows.append(Bin(name, low, high, int(counts.any(axis=1).sum()), rms(sums[counts])))
    return rows


def _bin_of(cell: Cell, squared: Floats, visible: Mask) -> Bin:
    inside = visible[cell.frames]
    count = int(inside.any(axis=1).sum())
    return Bin(
        cell.label, cell.low, cell.high, count, rms(squared[cell.frames][inside]) if count else 0.0
    )


def _worst(where: dict[str, list[Bin]], squared: Floats, visible: Mask, run: Run) -> Document:
    """The most deviating bin of each condition, worst first, and the worst frame."""
    least = max(3, round(0.02 * len(squared)))
    found: list[Document] = []
    for name, rows in where.items():
        enough = [row for row in rows if row.n >= least]
        if len(enough) > 1:
            top = max(enough, key=lambda row: row.rms_mm)
            found.append({"where": name, "label": top.label, "n": top.n, "rms_mm": top.rms_mm})
    frame = mean_root(squared, visible, 1)
    k = int(np.nanargmax(frame))
    return {
        "bins": sorted(found, key=lambda row: -float(row["rms_mm"]))[:4],
        "frame": {"index": k, "t_s": float(run.t_seen[k]), "rms_mm": float(frame[k])},
    }


def template(model: Model, seen: Floats) -> Floats | None:
    """The template at rest (N, 3), if the measured points are its vertices."""
    complete = not model.markers and len(model.rest) == seen.shape[1]
    return np.asarray(model.rest, float) if complete else None


def model_digest(model: Model) -> str:
    """A hash of the model.

    It covers the arrays of prior and fields, template, chain, parameters and calibration.
    """
    sha = hashlib.sha256()
    kept: dict[str, bytes] = {}
    if model.arrays is not None:
        kept = {f"{name}/onnx": file for name, file in model.arrays.networks().items()}
        for group, arrays in model.arrays.contents().items():
            kept |= {f"{group}/{name}": array.tobytes() for name, array in arrays.items()}
    for name, content in sorted(kept.items()):
        sha.update(name.encode())
        sha.update(content)
    sha.update(np.ascontiguousarray(model.rest, dtype=float).tobytes())
    sha.update(repr(sorted(model.params.items())).encode())
    sha.update(b"" if model.calibration is None else repr(model.calibration.to_dict()).encode())
    return sha.hexdigest()


def _made_from(kind: str, model: Model, run: Run) -> Document:
    from softmap_edge.version import __version__

    made: Document = {"softmap_edge": __version__, "numpy": np.__version__, "noise_floor": kind}
    made |= {} if model.output is None else {"output": model.output.to_dict()}
    return made | ({"timeless": True} if run.timeless else {})


def _length(value: float | None) -> float:
    """Read a length; null if it is unknown, such as the tip error of a tip never seen."""
    return math.nan if value is None else float(value)


def _memoryless(entry: Document | None) -> MemorylessFloor | None:
    """Read the lowest error of models without memory; earlier documents have none."""
    if entry is None:
        return None
    error = entry.get("error_mm")
    return MemorylessFloor(
        float(entry["mm"]),
        int(entry["poses"]),
        int(entry["passages"]),
        int(entry["frames"]),
        None if error is None else float(error),
    )


def _bin(row: Document) -> Bin:
    low, high = row["low"], row["high"]
    return Bin(
        str(row["label"]),
        None if low is None else float(low),
        None if high is None else float(high),
        int(row["n"]),
        float(row["rms_mm"]),
    )
