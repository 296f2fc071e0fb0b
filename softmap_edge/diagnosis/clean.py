"""Find frames and points of a run that are not valid measurements.

They are excluded before a fit, with a remark.

    lost      a place that stands for "not seen" (`checks/lost_points.py`): the point counts as not seen
    dark      a frame without a visible point
    late      a frame outside the record of the commands, or in a gap of it during which the
              commands move
    untaught  a frame whose commands are unlike all that the model was learned from
    repeated  a frame equal to the one before, bit for bit, although the commands move: the camera
              hangs
    unsteady  a frame in which the points jump while nothing is commanded
    clipped   a coordinate exactly at the border of a picture or a box, in several poses: the point
              counts as not seen
    astray    a point far from its prediction in this frame only: it counts as not seen

A body resting within the backlash also repeats frames, and so does a model without noise. A frozen
camera jumps to the body afterwards, while a body in backlash continues from its position. No frame
is excluded if no pair of frames at rest differs. Limits: two agreeing wrong frames in a row are
kept. A border that fewer than 3 % of the frames touch is not found. Units: mm, s. Pinned by
tests/run/test_bad_runs.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.checks.lost_points import without_lost
from softmap_edge.checks.match import (
    FOLLOWED,
    MOTION,
    check_run_matches_model,
    declaration_remarks,
    followed_share,
    not_following,
    spread,
)
from softmap_edge.checks.remembered import catches_up, memory_share
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.records import record_of
from softmap_edge.errors import RunError
from softmap_edge.model.servo_calibration import converted
from softmap_edge.noise.floor import noise_of_points
from softmap_edge.noise.repeats import LEAST_DWELL, undrifted
from softmap_edge.run.conditions import conditions
from softmap_edge.run.folds import LEAST_FRAMES
from softmap_edge.run.run import as_runs, known
from softmap_edge.run.stretches import stretches_of

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

GAP_SAMPLES, GAP = 10.0, 1.0  # usual steps, and s, beyond which the commands have a gap
MOVED = 0.05  # of the command range, across a gap: the motion there is unknown
STEPPED = 0.01  # of the command range between two frames: a working camera shows it
SELDOM = 0.2  # of frame pairs at rest: most that may be equal with camera noise
SOON = 0.1  # of the usual frame interval: no camera is that much faster once
TOUCHED = 0.03  # of the frames with a point exactly at its extreme: a border
POSES = 5  # distinct positions of points at a border: a body at rest has one
ASTRAY = 0.15  # of the body's length: point error in one frame only
ASTRAY_TIMES = 5.0  # times the point's usual error, likewise
ASTRAY_MOST = 0.1  # of the points: more are not outliers
# of all motion, and of the median dwell: allowed scatter in a dwell
UNSTEADY, UNSTEADY_TIMES = 0.05, 4.0
STILL = 0.8  # of all motion: with more scatter in the dwells, the robot does not move
# of the dwells: more are normal for this robot; fewer are not significant
UNSTEADY_MOST, DWELLS = 0.3, 4
WRONG_SIGMA = 5.0  # ratio of declared noise to that of the repeats, or its inverse
REMEMBERED = 100  # frames for the test of a strong memory
UNSEEN = 0.2  # of the points: more never-seen points are reported


@dataclass(frozen=True)
class CleanRun:
    """A run without invalid measurements, and remarks on the run."""

    run: Run
    remarks: tuple[str, ...]
    doubts: tuple[str, ...] = ()  # remarks that make every named effect doubtful


def clean_run(model: Model, run: Run) -> CleanRun:
    """Exclude invalid frames and points, and reject a run that no fit could use.

    Args:
        model: predicts the run.
        run: the run as recorded.

    Returns:
        Sound: the run with the same commands and fewer frames or points, and remarks, each a
        sentence.

    Raises:
        RunError: nothing is visible, too little remains, or the points do not fit this model under
            these commands.
    """
    run, lost = without_lost(converted(model, run))
    if run.frames == 0:
        raise RunError(
            "the run has no seen frames (K = 0); record what the cameras see together with the "
            "commands"
        )
    seen = np.asarray(model.points_in_mm(run), float)
    visible = known(run, seen)
    if not visible.any():
        raise RunError(
            f"no point is visible in any of the {run.frames} frames; check `visible`, or the "
            "mapping of the markers"
        )
    u = model.commands(run)
    remarks, keep = [*lost, *declaration_remarks(model, run)], np.ones(run.frames, bool)
    remarks += _sigma(run)
    for frames, text in _frames(model, run, u, seen, visible):
        remarks.append(
            f"{int(frames.sum())} of {run.frames} frames {text}" if frames.any() else text
        )
        keep &= ~frames
    if keep.sum() < min(LEAST_FRAMES, run.frames):
        raise RunError(
            f"{int(keep.sum())} usable frames, at least {LEAST_FRAMES} are needed: "
            f"{'; '.join(remarks)}"
        )
    part = run if keep.all() else run.at(keep)
    seen, visible = seen[keep], visible[keep]
    predicted = np.asarray(model.predict(part), float)
    doubts = check_run_matches_model(model, part, seen, visible, predicted)
    remarks += doubts
    shown = visible.copy()
    length = float(np.linalg.norm(model.rest, axis=1).max())
    for points, text in _points(seen, visible, predicted, length):
        remarks.append(
            f"{int(points.sum())} points in {int(points.any(axis=1).sum())} frames {text}"
        )
        shown &= ~points
    never = int((~visible.any(axis=0)).sum())
    if never >= UNSEEN * visible.shape[1]:
        remarks.append(
            f"{never} of {visible.shape[1]} points are never seen: what acts there only is not "
            "tested; turn a camera to them, or add one"
        )
    return CleanRun(
        part if bool((shown == visible).all()) else replace(part, visible=shown),
        tuple(remarks),
        tuple(doubts),
    )


def clean_record(
    model: Model, run: Run | Sequence[Run], reference: Run | Sequence[Run] | None = None
) -> tuple[Record, list[str]]:
    """Bind a model to the valid frames and points of one or several runs, with remarks.

    The record keeps the complete runs.

    Raises:
        SoftmapError: as for `clean_run` and `record_of`.
    """
    given = as_runs(run)
    parts = [clean_run(model, one) for one in given]
    several = as_runs(reference)
    record = record_of(
        model, [p.run for p in parts], [clean_run(model, one).run for one in several] or None
    )
    record.recorded_runs = tuple(without_lost(one)[0] for one in given)
    record.doubts = tuple(dict.fromkeys(text for p in parts for text in p.doubts))
    messages = [
        (f"run {i}: " if len(parts) > 1 else "") + text
        for i, p in enumerate(parts, 1)
        for text in p.remarks
    ]
    return record, messages


def commands_not_followed(record: Record, predicted: Floats) -> str | None:
    """Report points that do not move, or do not move as commanded, under any fit."""
    seen = record.seen.reshape(len(record), -1, 3)[:, record.positions]
    left = seen - predicted.reshape(len(record), -1, 3)[:, record.positions]
    visible = np.asarray(np.isfinite(seen).all(axis=2), np.bool_)
    moved, length = spread(seen, visible), float(np.linalg.norm(record.model.rest, axis=1).max())
    if record.replay is not None:
        return None
    expected = record.predict(record.model.chain_names, record.own()[None])[0].reshape(
        len(record), -1, 3
    )
    expected = expected[:, record.positions]
    at_rest = not_following(record.command, seen, visible, expected, seen - left, length)
    if at_rest is not None:
        return at_rest
    if moved < MOTION * length:
        return None
    share = followed_share(left, seen, visible)
    if share > FOLLOWED or _remembers(record):
        return None
    dead = [str(c) for c in np.flatnonzero(~(record.spread > 0))]
    why = (
        "Either commands and frames are not of one recording, or something else than they moves "
        "the robot"
    )
    if len(dead) == len(record.spread):
        why = "The commands never change in this log"
    elif dead:
        why = (
            f"Either channel {', '.join(dead)} never moves in this log, or something else moves "
            "the robot"
        )
    return (
        f"What is seen does not follow the commands: the points move by {moved:.3g} mm RMS, and "
        f"with any effect the model explains at most {100 * max(share, 0.0):.0f} % of that "
        f"(fitted). {why}; no effect is named. Look at the order and the clock of the frames, at "
        "the columns and signs of the commands, and whether it is this robot."
    )


def _remembers(record: Record) -> bool:
    """Return whether the model with backlash explains the motion of every run.

    The misfit is then due to memory, and not to another robot.
    """
    for part in record.parts:
        few = part.run.at(part.spread_rows(REMEMBERED))
        points = np.asarray(record.model.points_in_mm(few), float)
        if not memory_share(record.model, few, points, known(few, points)).share > FOLLOWED:
            return False
    return True


def _sigma(run: Run) -> list[str]:
    """Report a declared noise that differs from the noise of the repeats."""
    if run.sigma is None:
        return []
    found = noise_of_points(run)
    stated = float(np.sqrt(3.0) * np.median(run.sigma))
    if found is None or 1 / WRONG_SIGMA < stated / max(found.mm, 1e-9) < WRONG_SIGMA:
        return []
    return [
        f"`sigma` declares {stated:.2g} mm a point, the repeats show {found.mm:.2g} mm "
        f"({found.source}); the noise is taken from the repeats"
    ]


# --- frames -------------------------------------------------------------------------------------


def _frames(
    model: Model, run: Run, u: Floats, seen: Floats, visible: Mask
) -> Iterator[tuple[Mask, str]]:
    """Yield frames (K,) that are not valid measurements, and why."""
    dark: Mask = np.asarray(~visible.any(axis=1), np.bool_)
    if dark.any():
        yield (
            dark,
            "are set aside: they show no point; look at `visible`, or at the mapping of the "
            "markers",
        )
    step = np.diff(run.t)
    limit = max(GAP, GAP_SAMPLES * float(np.median(step))) if len(step) else GAP
    off = np.maximum(run.t[0] - run.t_seen, run.t_seen - run.t[-1])
    late = off > limit
    if late.any():
        yield (
            late,
            f"are set aside: they were seen up to {off.max():.4g} s outside the commands' "
            f"{run.t[0]:.4g} to {run.t[-1]:.4g} s; bring both to one clock, in s",
        )
    span = np.ptp(u, axis=0)
    moved = (
        (np.abs(np.diff(u, axis=0)) > MOVED * np.maximum(span, 1e-12)).any(axis=1)
        if u.shape[1]
        else step < 0
    )
    inside = np.zeros(run.frames, bool)
    for row in np.flatnonzero((step > limit) & moved) if len(step) > 1 else ():
        inside |= (run.t_seen > run.t[row]) & (run.t_seen < run.t[row + 1])
    if inside.any():
        widest = float(step[(step > limit) & moved].max())
        yield (
            inside & ~late,
            f"are set aside: they were seen in a gap of {widest:.3g} s in the commands, which "
            "moved meanwhile; log every command",
        )
    jumps, text = _unsteady(run, u, np.where(visible[..., None], seen, 0.0), visible)
    if text:
        yield jumps & ~late & ~inside, text
    strange = _untaught(model, run) & ~late & ~inside
    if strange.any():
        yield (
            strange,
            "are set aside: their commands are unlike all that the model was learned from, and "
            "its errors there are unknown; learn it from a run that covers them",
        )
    again = _repeated(model, run, u, seen, visible)
    if again.any():
        yield (
            again & ~late & ~inside,
            "are set aside: each repeats the picture before it exactly; the camera or its log "
            "hangs: drop repeated pictures, and stamp each when it is taken",
        )


def _untaught(model: Model, run: Run) -> Mask:
    """Return the frames (K,) at which a learned map extrapolates; none if most frames do."""
    coverage = model.coverage
    if coverage is None or not isinstance(model.prior, _core.Rod):
        return np.zeros(run.frames, bool)
    outside = np.asarray(coverage.outside(model.effective_commands(run)), np.bool_)
    return outside if 2 * outside.sum() < run.frames else np.zeros(run.frames, bool)


def _unsteady(run: Run, u: Floats, seen: Floats, visible: Mask) -> tuple[Mask, str]:
    """Return the frames (K,) of dwells in which the robot jumps, and a remark.

    The command is constant in a dwell.

    The scatter of each dwell about its drift is compared with the median of the others. It is the
    RMS over the points visible in all frames of the dwell.
    """
    none, state = np.zeros(run.frames, bool), conditions(run, u)
    if not u.shape[1]:
        return none, ""
    dwells, scatter = [], []
    for visit in np.unique(state.visit[~state.moving]):
        rows = np.flatnonzero((state.visit == visit) & ~state.moving & visible.any(axis=1))
        always_seen = visible[rows].all(axis=0)
        if visit < 0 or len(rows) < LEAST_DWELL or not always_seen.any():
            continue
        left, order = undrifted(
            seen[np.ix_(rows, np.flatnonzero(always_seen))].reshape(len(rows), -1)
        )
        dwells.append(rows)
        scatter.append(
            float(np.sqrt(3.0 * np.sum(left**2) / ((len(rows) - order) * left.shape[1])))
        )
    if len(dwells) < DWELLS:
        return none, ""
    moved, usual = spread(seen, visible), float(np.median(scatter))
    if not usual < STILL * moved:  # nothing moves: scatter is the only motion
        return none, ""
    if usual > UNSTEADY * moved:
        return none, (
            f"while nothing is commanded the points scatter by {usual:.3g} mm RMS, "
            f"{100 * usual / moved:.0f} % of all their motion; this counts as noise and hides "
            "smaller effects. Look for a robot that settles slowly, for frames that are late or "
            "out of order, and for a mount or a camera that shakes"
        )
    wild = [
        rows
        for rows, mm in zip(dwells, scatter)
        if mm > max(UNSTEADY_TIMES * usual, UNSTEADY * moved)
    ]
    if not wild or len(wild) > UNSTEADY_MOST * len(dwells):
        return none, ""
    none[np.concatenate(wild)] = True
    return none, (
        f"are set aside: while nothing is commanded the points jump by {max(scatter):.3g} mm RMS "
        f"in them, in other dwells by {usual:.2g}; look at the order of the frames, and at what "
        "touched the robot or a camera"
    )


def _repeated(model: Model, run: Run, u: Floats, seen: Floats, visible: Mask) -> Mask:
    """Return the frames (K,) that repeat the previous image, if only a frozen camera can."""
    again = np.zeros(run.frames, bool)
    if run.frames < 2:
        return again
    both = visible[1:] & visible[:-1]
    same = ((seen[1:] == seen[:-1]).all(axis=2) | ~both).all(axis=1) & both.any(axis=1)
    same &= (visible[1:] == visible[:-1]).all(axis=1)
    if not same.any():
        return again
    again[1:] = same
    if same.all():
        return again
    span = np.maximum(np.ptp(u, axis=0), 1e-12)
    at = np.stack([np.interp(run.t_seen, run.t, row) for row in u.T], axis=1) if u.shape[1] else u
    change = (np.abs(np.diff(at, axis=0)) / span).max(axis=1, initial=0.0)
    gap = np.diff(run.t_seen)
    stamped = same & (gap < SOON * np.median(gap[~same]))
    if (~same & (change < 1e-6)).any() and stamped.sum() >= 2:
        return again
    none = np.zeros(run.frames, bool)
    moving = same & (change > STEPPED)
    if moving.sum() < 2:
        return none
    # the first frame, and the last repetition
    stretches = [(a, b) for a, b in stretches_of(same) if moving[a:b].any()]
    ended = [(a, b, b + 1) for a, b in stretches if b + 1 < run.frames]
    if ended and catches_up(ended, seen, visible, np.asarray(model.predict(run), float)):
        return again
    outside = np.ones(len(same), bool)
    for a, b in stretches:
        outside[a:b] = False
    still = outside & (change < 1e-6)
    # a camera with noise never repeats a frame
    never = still.sum() >= 2 and float(same[still].mean()) < SELDOM
    return again if never else none


# --- points -------------------------------------------------------------------------------------


def _points(
    seen: Floats, visible: Mask, predicted: Floats, length: float
) -> Iterator[tuple[Mask, str]]:
    """Yield points (K, N) that are not valid measurements, and why."""
    for axis, name in enumerate("xyz"):
        for extreme in (np.nanmin, np.nanmax):
            found = _clipped(seen, visible, axis, extreme)
            if found is not None:
                value = float(seen[..., axis][found][0])
                yield (
                    found,
                    f"are taken as not seen: {name} is exactly {value:.6g} mm in all of them, as "
                    "if clipped at the border of a picture or a box; widen it",
                )
    wrong = _astray(seen, visible, predicted, length)
    if wrong.any():
        yield (
            wrong,
            "are taken as not seen: they jump away from their neighbours in time and back; look "
            "for mixed-up markers, reflections or broken rows",
        )


def _clipped(
    seen: Floats, visible: Mask, axis: int, extreme: Callable[[Floats], np.floating]
) -> Mask | None:
    """Return the points (K, N) with a coordinate at an image or box border, or None."""
    place = np.where(visible, seen[..., axis], np.nan)
    at = visible & (place == extreme(place))
    at &= ~(at | ~visible).all(axis=0)  # a point that is always there is fixed
    frames = at.any(axis=1)
    if frames.sum() < max(POSES, TOUCHED * len(frames)):
        return None
    others = seen[at][:, [c for c in range(3) if c != axis]]
    return at if len(np.unique(others, axis=0)) >= max(POSES, frames.sum() // 2) else None


def _astray(seen: Floats, visible: Mask, predicted: Floats, length: float) -> Mask:
    """Return the points (K, N) far from their prediction in a single frame.

    They are close to it in the two frames before and after.
    """
    none = np.zeros(visible.shape, bool)
    if len(seen) < LEAST_FRAMES:
        return none
    off = np.where(visible[..., None], seen - predicted, np.nan)
    far = np.linalg.norm(off, axis=2)  # NaN where hidden
    if not (far > ASTRAY * length).any():
        return none
    with np.errstate(invalid="ignore"):
        usual = np.array(
            [
                np.median(column[np.isfinite(column)]) if np.isfinite(column).any() else 0
                for column in far.T
            ]
        )
        found = far > np.maximum(ASTRAY * length, ASTRAY_TIMES * usual)
    if found.sum() > ASTRAY_MOST * visible.sum():
        return none
    alone = found.copy()
    for k, n in np.argwhere(found):
        around = [j for j in (k - 2, k - 1, k + 1, k + 2) if 0 <= j < len(off) and visible[j, n]]
        if (
            len(around) < 2
            or np.linalg.norm(off[k, n] - np.median(off[around, n], axis=0)) < 0.7 * far[k, n]
        ):
            alone[k, n] = False
            continue
        if found[k].sum() == visible[k].sum():  # the complete frame, with its base
            continue
        near = np.linalg.norm(predicted[k] - predicted[k, n], axis=1)
        near[n], near[~visible[k]] = np.inf, np.inf
        # a real bend also moves the neighbouring points
        neighbour = int(np.argmin(near))
        alone[k, n] = bool(np.linalg.norm(off[k, n] - off[k, neighbour]) > 0.5 * far[k, n])
    return np.asarray(alone)
