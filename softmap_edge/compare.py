"""How far a model is from a measured run, and where: by section, direction, speed, dwell, history, command and time.

    d(k, n) = |predicted - seen| of point n in frame k, mm, visible points only
    rms = sqrt(mean d²); tip = the same for the centroid of the tip points; a cell's rms is over its frames' points

The noise floor is the RMS distance of a point from its own mean when nothing but the camera changes. It is taken from
successive frames of one uninterrupted dwell, sqrt(sum |x(k+1) - x(k)|² / 2), which creep does not inflate; without enough
of them from other visits of the same command by the same direction (memory then counts as noise); without those from
the second differences of the residual. Which one is in `made_from["noise_floor"]`.
Known limit: noise that stays constant through a dwell (a jittering camera mount) is seen only by the second kind.
Pinned by tests/test_compare.py.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.conditions import Cell, Conditions, cells, conditions
from softmap_edge.errors import ComparisonError

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SCHEMA = "softmap.comparison/1"
SETTLED = 0.5  # s after the last motion from which a frame counts as a replicate
MIN_PAIRS = 15  # replicates below this say nothing about the noise (DISCOVERY: at least 15)
HASHED = ("t", "command", "ticks", "t_seen", "vertices", "markers", "visible", "gravity", "load", "temperature")


@dataclass(frozen=True)
class Bin:
    """One class of a condition: its name, bounds (or None), number of frames and RMS error in mm."""

    label: str
    low: float | None
    high: float | None
    n: int
    rms_mm: float

    def to_dict(self) -> dict[str, Any]:
        """Return the bin as `{label, low, high, n, rms_mm}`."""
        return dict(label=self.label, low=self.low, high=self.high, n=self.n, rms_mm=self.rms_mm)


@dataclass(frozen=True)
class Comparison:
    """The error of one model on one run; prints itself, and `to_dict()` is the document softmap.comparison/1."""

    run: dict[str, Any]
    bundle: dict[str, Any]
    frames: int
    error: dict[str, float]
    noise_floor_mm: float | None
    where: dict[str, list[Bin]]
    worst: dict[str, Any]
    made_from: dict[str, Any]

    def __str__(self) -> str:
        from softmap_edge.report import comparison_text

        return comparison_text(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the document softmap.comparison/1: plain numbers, strings, lists and dicts."""
        return {
            "schema": SCHEMA,
            "run": self.run,
            "bundle": self.bundle,
            "frames": self.frames,
            "error": self.error,
            "noise_floor_mm": self.noise_floor_mm,
            "where": {name: [row.to_dict() for row in rows] for name, rows in self.where.items()},
            "worst": self.worst,
            "made_from": self.made_from,
        }

    @classmethod
    def from_dict(cls, document: Any) -> Comparison:
        """Read a document softmap.comparison/1.

        Args:
            document: what `to_dict()` gave, also after a passage through JSON.

        Returns:
            Comparison: equal to the one that was written.

        Raises:
            ComparisonError: another schema, or a missing or malformed entry.
        """
        schema = document.get("schema") if isinstance(document, dict) else None
        if schema != SCHEMA:
            raise ComparisonError(f"this is no comparison: schema {schema!r}, expected {SCHEMA!r}; make one with `softmap compare --json`")
        try:
            where = {str(name): [_bin(row) for row in rows] for name, rows in document["where"].items()}
            floor = document["noise_floor_mm"]
            return cls(
                run=dict(document["run"]),
                bundle=dict(document["bundle"]),
                frames=int(document["frames"]),
                error={key: float(document["error"][key]) for key in ERROR_KEYS},
                noise_floor_mm=None if floor is None else float(floor),
                where=where,
                worst=dict(document["worst"]),
                made_from=dict(document["made_from"]),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ComparisonError(
                f"damaged comparison document: {type(error).__name__} {error}; make it again with `softmap compare --json`"
            ) from None


ERROR_KEYS = ("rms_mm", "median_mm", "p95_mm", "max_mm", "tip_rms_mm")


@dataclass(frozen=True)
class Series:
    """What pictures need of a run seen by one model or by two (before, after): errors per frame and per point, mm."""

    kind: str  # "held out" or "fitted": whether the run took part in the fit
    t_seen: Floats  # (K,) s
    before: Floats  # (K,) RMS over the points of a frame
    after: Floats | None  # (K,)
    point_before: Floats  # (N,) RMS over the frames of a point
    point_after: Floats | None  # (N,)
    template: Floats  # (N, 3) where the points are drawn
    triangles: NDArray[np.int64] | None  # (F, 3); None for markers
    noise_floor_mm: float | None
    tip_seen: Floats  # (K, 3)
    tip_before: Floats  # (K, 3)
    tip_after: Floats | None  # (K, 3)


def compare(model: Any, run: Any) -> Comparison:
    """Measure how far a model's prediction is from a run, and where.

    Args:
        model: predicts (K, N, 3) mm for the run by `predict(run)`.
        run: a run with points that keep their identity (vertices or markers) in at least one frame.

    Returns:
        Comparison: error figures, noise floor and the map of the error over the conditions of the run.

    Raises:
        ComparisonError: nothing is seen, or the model's points are not the run's.
    """
    predicted, seen, visible = _aligned(model, run)
    squared = np.where(visible, np.sum((predicted - seen) ** 2, axis=2), 0.0)  # (K, N) mm²
    distance = np.sqrt(squared[visible])
    state = conditions(run)
    where = {"section": _by_section(model, run, squared, visible)}
    for name, row in cells(state).items():
        where[name] = [_bin_of(cell, squared, visible) for cell in row]
    where = {name: [row for row in rows if row.n > 0] for name, rows in where.items()}
    tip_seen, tip_predicted = _tips(model, predicted, seen, visible)
    known = ~np.isnan(tip_seen[:, 0])
    error = {
        "rms_mm": math.sqrt(float(np.mean(distance**2))),
        "median_mm": float(np.median(distance)),
        "p95_mm": float(np.percentile(distance, 95)),
        "max_mm": float(np.max(distance)),
        "tip_rms_mm": _rms(np.sum((tip_predicted - tip_seen)[known] ** 2, axis=1)),
    }
    floor, kind = noise_floor(state, seen, visible, predicted)
    return Comparison(
        run={"name": _name(run, "run"), "sha256": digest(run)},
        bundle={"name": _name(model, "model"), "sha256": _model_digest(model)},
        frames=len(seen),
        error=error,
        noise_floor_mm=floor,
        where=where,
        worst=_worst(where, squared, visible, run, error["rms_mm"]),
        made_from=_made_from(model, kind),
    )


def series(run: Any, before: Any, after: Any = None, kind: str = "held out") -> Series:
    """Collect what the pictures of a run need, for one model or for a model before and after a change.

    Args:
        run: as for `compare`.
        before: the model, or the model before the change.
        after: the model after the change, or None.
        kind: "held out" or "fitted": whether the run took part in the fit.

    Returns:
        Series: errors over time and over the body, template and tip paths.

    Raises:
        ComparisonError: as `compare`; also when `kind` is neither.
    """
    if kind not in ("held out", "fitted"):
        raise ComparisonError(f"kind is {kind!r}; it is 'held out' or 'fitted'")
    predicted, seen, visible = _aligned(before, run)
    squared = np.where(visible, np.sum((predicted - seen) ** 2, axis=2), 0.0)
    tip_seen, tip_before = _tips(before, predicted, seen, visible)
    frame_after = point_after = tip_after = None
    if after is not None:
        predicted_after, _, _ = _aligned(after, run)
        squared_after = np.where(visible, np.sum((predicted_after - seen) ** 2, axis=2), 0.0)
        frame_after, point_after = _mean_root(squared_after, visible, 1), _mean_root(squared_after, visible, 0)
        tip_after = _tips(after, predicted_after, seen, visible)[1]
    template, triangles = _drawn(before, run, seen, visible)
    floor, _ = noise_floor(conditions(run), seen, visible, predicted)
    return Series(
        kind=kind,
        t_seen=np.asarray(run.t_seen, float),
        before=_mean_root(squared, visible, 1),
        after=frame_after,
        point_before=_mean_root(squared, visible, 0),
        point_after=point_after,
        template=template,
        triangles=triangles,
        noise_floor_mm=floor,
        tip_seen=tip_seen,
        tip_before=tip_before,
        tip_after=tip_after,
    )


def noise_floor(state: Conditions, seen: Floats, visible: Mask, predicted: Floats) -> tuple[float | None, str]:
    """Estimate the RMS distance of a seen point from its own mean, and say what it was taken from.

    Args:
        state: conditions of the K frames.
        seen: (K, N, 3) mm. visible: (K, N). predicted: (K, N, 3) mm, used by the fallback only.

    Returns:
        tuple: mm (None when no estimate is possible) and a sentence.
    """
    settled = ~state.moving & (state.dwell >= SETTLED)
    pair = settled[1:] & settled[:-1] & (state.visit[1:] == state.visit[:-1]) if len(seen) > 1 else np.zeros(0, bool)
    if int(pair.sum()) >= MIN_PAIRS:
        both = visible[1:][pair] & visible[:-1][pair]
        step = np.sum((seen[1:][pair] - seen[:-1][pair]) ** 2, axis=2)[both]
        if len(step):
            visits = len(np.unique(state.visit[1:][pair]))
            return _rms(step / 2.0), f"{int(pair.sum())} pairs of successive frames inside {visits} dwells"
    groups = _replicates(state, settled)
    if sum(len(group) - 1 for group in groups) >= MIN_PAIRS:
        value = _within(groups, seen, visible)
        if value is not None:
            return value, f"{len(groups)} commands seen repeatedly; what the robot remembers counts as noise here"
    if len(seen) < MIN_PAIRS + 2:
        return None, f"not known: no replicates, and {len(seen)} frames are too few"
    residual = seen - predicted
    bend = np.sum((residual[1:-1] - 0.5 * (residual[2:] + residual[:-2])) ** 2, axis=2)
    whole = visible[1:-1] & visible[2:] & visible[:-2]
    if not whole.any():
        return None, "not known: no replicates, and no point is visible in three successive frames"
    return _rms(bend[whole] / 1.5), "no replicates: from the residual's high-frequency part, an upper bound"


def digest(run: Any) -> str:
    """Return the SHA-256 of a run's content: the same numbers give the same hash wherever the file lies."""
    sha = hashlib.sha256()
    for name in HASHED:
        value = getattr(run, name, None)
        if value is not None:
            array = np.ascontiguousarray(value)
            sha.update(f"{name} {array.dtype.str} {array.shape}".encode())
            sha.update(array.tobytes())
    return sha.hexdigest()


def _aligned(model: Any, run: Any) -> tuple[Floats, Floats, Mask]:
    """Prediction, measurement (hidden points zero) and visibility with equal shapes, or an error that says why not."""
    if len(run.t_seen) == 0:
        raise ComparisonError("the run has no seen frames (K = 0), so there is nothing to compare with; record one that is seen")
    if run.seen_points is None:
        raise ComparisonError(
            "the run has neither vertices nor markers; points of a cloud have no identity, register them to the template first"
        )
    seen = np.asarray(run.seen_points, float)
    predicted = np.asarray(model.predict(run), float)
    if predicted.shape != seen.shape:
        raise ComparisonError(
            f"the model predicts {predicted.shape} (frames, points, xyz), the run has {seen.shape}; "
            "take the bundle of this robot and template"
        )
    declared = getattr(run, "visible", None)
    visible = np.all(np.isfinite(seen), axis=2)
    if declared is not None:
        visible = visible & np.asarray(declared, bool)
    if not visible.any():
        raise ComparisonError("no point is visible in any frame of the run; check its field `visible`")
    if not np.isfinite(predicted[visible]).all():
        raise ComparisonError("the model predicts values that are not finite for this run; look at it with `softmap check`")
    return predicted, np.where(visible[..., None], seen, 0.0), visible


def _rms(squares: Floats) -> float:
    return math.sqrt(float(np.mean(squares))) if len(squares) else math.nan


def _mean_root(squared: Floats, visible: Mask, axis: int) -> Floats:
    """RMS along an axis over what is visible; NaN where nothing is."""
    count = visible.sum(axis=axis)
    total = squared.sum(axis=axis)
    return np.asarray(np.sqrt(np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)))


def _tips(model: Any, predicted: Floats, seen: Floats, visible: Mask) -> tuple[Floats, Floats]:
    """Tip centroids seen and predicted, over the tip points visible in a frame; NaN where none is."""
    tip = getattr(model, "tip_indices", None)
    index = np.array([seen.shape[1] - 1]) if tip is None else np.asarray(tip, int)
    weight = visible[:, index].astype(float)  # (K, n)
    count = weight.sum(axis=1)
    scale = np.divide(1.0, count, out=np.full(len(count), np.nan), where=count > 0)[:, None]
    return np.einsum("kn,knc->kc", weight, seen[:, index]) * scale, np.einsum(
        "kn,knc->kc", weight, predicted[:, index]
    ) * scale


def _by_section(model: Any, run: Any, squared: Floats, visible: Mask) -> list[Bin]:
    """One bin per section (base first), with its height range where a template is known; per marker without sections."""
    markers = getattr(run, "markers", None) is not None
    sections = getattr(model, "sections", None)
    if markers or sections is None:
        sections = np.arange(squared.shape[1])
    sections = np.asarray(sections)
    template = getattr(model, "template", None)
    rows = []
    labels = np.unique(sections)
    for position, section in enumerate(labels):
        member = sections == section
        sums, counts = squared[:, member], visible[:, member]
        if not counts.any():
            continue
        name = f"marker {position + 1}" if markers else str(position + 1)
        name += " base" if position == 0 and not markers else ""
        name += " tip" if position == len(labels) - 1 and not markers else ""
        low = high = None
        if template is not None and np.shape(template) == (len(sections), 3) and not markers:
            height = np.asarray(template)[member, 2]
            low, high = float(height.min()), float(height.max())
        rows.append(Bin(name, low, high, int(counts.any(axis=1).sum()), _rms(sums[counts])))
    return rows


def _bin_of(cell: Cell, squared: Floats, visible: Mask) -> Bin:
    inside = visible[cell.frames]
    count = int(inside.any(axis=1).sum())
    return Bin(cell.label, cell.low, cell.high, count, _rms(squared[cell.frames][inside]) if count else 0.0)


def _worst(where: dict[str, list[Bin]], squared: Floats, visible: Mask, run: Any, rms: float) -> dict[str, Any]:
    """The bin that stands out most in each condition, worst first, and the worst frame."""
    least = max(3, round(0.02 * len(squared)))
    found = []
    for name, rows in where.items():
        enough = [row for row in rows if row.n >= least]
        if len(enough) > 1:
            top = max(enough, key=lambda row: row.rms_mm)
            found.append({"where": name, "label": top.label, "n": top.n, "rms_mm": top.rms_mm})
    found.sort(key=lambda row: -row["rms_mm"])
    frame = _mean_root(squared, visible, 1)
    k = int(np.nanargmax(frame))
    return {"bins": found[:4], "frame": {"index": k, "t_s": float(run.t_seen[k]), "rms_mm": float(frame[k])}}


def _replicates(state: Conditions, settled: Mask) -> list[NDArray[np.int64]]:
    """Settled frames that share their command (to 1 % of the largest) and the direction it was reached from."""
    top = float(np.max(np.abs(state.command), initial=0.0))
    index = np.flatnonzero(settled)
    if len(index) == 0:
        return []
    key = np.round(state.command[index] / (0.01 * top)) if top > 0 else np.zeros((len(index), 1))
    _, which = np.unique(key, axis=0, return_inverse=True)
    which = which.reshape(-1)
    groups = [index[which == g] for g in range(int(which.max()) + 1)]
    return [group for group in groups if len(group) > 1]


def _within(groups: list[NDArray[np.int64]], seen: Floats, visible: Mask) -> float | None:
    """Pooled RMS deviation of points from their mean inside each group, with one degree of freedom taken off."""
    total, freedom = 0.0, 0
    for group in groups:
        x, v = seen[group], visible[group]
        count = v.sum(axis=0)
        known = count > 1
        mean = x.sum(axis=0) / np.maximum(count, 1)[:, None]
        deviation = np.where(v[..., None], x - mean, 0.0)[:, known]
        total += float(np.sum(deviation**2))
        freedom += int(np.sum(count[known] - 1))
    return math.sqrt(total / freedom) if freedom else None


def _drawn(model: Any, run: Any, seen: Floats, visible: Mask) -> tuple[Floats, NDArray[np.int64] | None]:
    """Where to draw the points: the model's template with its triangles, else the mean of what was seen."""
    template = getattr(model, "template", None)
    if template is not None and np.shape(template) == seen.shape[1:]:
        triangles = getattr(model, "triangles", None)
        return np.asarray(template, float), None if triangles is None else np.asarray(triangles, np.int64)
    count = np.maximum(visible.sum(axis=0), 1)
    return seen.sum(axis=0) / count[:, None], None


def _name(thing: Any, fallback: str) -> str:
    """A display name: the object's own, else its robot's, else a plain word; never a path."""
    name = getattr(thing, "name", None)
    if not isinstance(name, str):
        robot = getattr(thing, "robot", None)
        name = robot if isinstance(robot, str) else getattr(robot, "name", None)
    if not isinstance(name, str) or not name:
        return fallback
    return name.replace("\\", "/").rstrip("/").rsplit("/", 1)[-1]


def _model_digest(model: Any) -> str:
    """The model's own hash where it has one, else a hash of its chain, parameters and template."""
    own = getattr(model, "sha256", None)
    if isinstance(own, str):
        return own
    sha = hashlib.sha256()
    sha.update(repr(tuple(str(name) for name in getattr(model, "names", ()))).encode())
    for name in ("params", "template"):
        value = getattr(model, name, None)
        if isinstance(value, (np.ndarray, list, tuple)):
            sha.update(np.ascontiguousarray(value, dtype=float).tobytes())
    return sha.hexdigest()


def _made_from(model: Any, kind: str) -> dict[str, Any]:
    from softmap_edge import __version__

    return {"softmap_edge": __version__, "numpy": np.__version__, "noise_floor": kind}


def _bin(row: Any) -> Bin:
    low, high = row["low"], row["high"]
    return Bin(
        str(row["label"]),
        None if low is None else float(low),
        None if high is None else float(high),
        int(row["n"]),
        float(row["rms_mm"]),
    )
