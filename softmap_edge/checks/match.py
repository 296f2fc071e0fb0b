"""Check that a run belongs to this model's robot: units, frame, handedness, points, clocks.

The checks detect gross faults only, so missing physics passes. Each limit lies beyond the reach of
any effect of the library, and a memory as strong as a play over most of the range is no fault
(`remembered.py`). A run that fails is refused, with its numbers and the remedy. A fault that a
diagnosis can fit passes: a base that is misaligned by 2 mm, a swapped servo, a clock 0.2 s late.

    follows = 1 − Σ |(s − p) − mean|² / Σ |s − mean|²     s measured, p predicted points, means over
                                                          the frames

Units: mm, s, deg. Limit: markers on one line have no handedness and no order. Pinned by
tests/run/test_bad_runs.py and tests/diagnosis/test_wrongly_declared.py.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.checks.leverage import ALIKE, LARGER, hardly_follows, power
from softmap_edge.checks.remembered import centred, memory_share
from softmap_edge.errors import RunError
from softmap_edge.files.atomic import Document
from softmap_edge.geometry.rigid import kabsch, rotation_vector
from softmap_edge.logs.plausible import doubts_of_time
from softmap_edge.model.effect_info import registry
from softmap_edge.model.training_range import command_extrapolation
from softmap_edge.run.conditions import conditions
from softmap_edge.run.fields import DRIVE
from softmap_edge.run.run import DAMAGE, known

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

FRAMES = 100  # frames examined where all would take too long
LITTLE = 0.05  # of the model's range: commands that stay within it may be in another unit
NO_LOAD = 0.5  # g: a largest load below this was meant in kg
OUT_OF_REACH = 3.0  # body lengths: largest plausible distance from the base
# factor by which neighbours may approach or separate: silicone does not stretch so far
SPACING = 2.0
# deg and body lengths: a heavy load turns the markers of a soft body half as far
TURNED, SHIFTED = 60.0, 0.5
CLAMPED = 0.15  # of the body's length from its base: only the frame of reference moves points there
# a wrong frame: times the largest fitted mount, and times the scatter over frames
FAR, STEADY = 1.5, 3.0
BETTER = 0.5  # of the distance between seen and predicted points that may remain after such a move
# of the expected motion, total and along it; a play of 1.9 half ranges exceeds 0.05
STILL, ALONG = 0.08, 0.02
MOTION = 0.04  # of the body's length (RMS): a smaller motion does not identify its cause
NEARLY = 0.1  # of the motion: explained as well as by another cause
FOLLOWED = 0.6  # share of the motion; a run below it does not belong to these commands
MENDED = 0.3  # of the error that may remain with gravity reversed
LATE = 2.0  # s: delays up to here are left to the effects
TIMES = 1000  # time stamps at which a clock shift is tried
# of the frames at either extreme, and at one of them, that may be clipped; frames
HELD, END, LEAST_HELD = 0.05, 0.02, 4
STEP = 0.02  # of the range of a command: step of the numerical slope
GOES_ON = 0.05  # of the range: standard deviation of the continuation of a clipped command
# times the scatter outside the hold, without its linear part; else the model is wrong there
MORE = 1.2
# of the usual effect of a command step; frames below it do not identify the command
SEEN = 0.3
AS_FAST = 0.4  # of the variance that may remain if the command continues at its approach speed


def declaration_remarks(model: Model, run: Run) -> list[str]:
    """Return remarks on the declarations of a run."""
    found = [f"{text}" for text in doubts_of_time(np.asarray(run.t, float))]
    if run.robot is not None and run.robot != model.robot:
        found.append(
            f"the run is one of '{run.robot}', the model is of '{model.robot}'; give --bundle if "
            "that is another"
        )
    if model.channels and run.command_unit != model.command_unit:
        found.append(
            f"the run's commands are in {run.command_unit}, the model takes {model.command_unit}: "
            "they are taken as they are; set the unit in the mapping"
        )
    low, high = (
        np.asarray(model.command_range, float).T
        if len(model.command_range)
        else (np.zeros(0), np.zeros(0))
    )
    share = float(
        np.max(np.ptp(model.commands(run), axis=0) / np.maximum(high - low, 1e-12), initial=0.0)
    )
    if 0.0 < share < LITTLE:
        found.append(
            f"the commands move by at most {100 * share:.2g} % of what the model was made from"
            f"{_why_little(model, run)}"
        )
    most = 0.0 if run.load is None else float(np.max(run.load, initial=0.0))
    if 0.0 < most < NO_LOAD:
        found.append(
            f"the heaviest load is {most:.3g} g, which moves nothing; `load` is in grams, not kg"
        )
    return found


def _why_little(model: Model, run: Run) -> str:
    """Return why commands may move by little, and the remedy.

    Of a damaged recording the rest is missing. Commands in another unit are too small for the
    motion of the points.
    """
    if DAMAGE in run.extra:
        return (
            " in the part of the recording that could be read; copy the recording again, or record "
            "the rest again"
        )
    if run.places is not None and run.output is None:
        visible = known(run, run.places)
        moved = spread(np.where(visible[..., None], run.places, 0.0), visible)
        if moved < MOTION * float(np.linalg.norm(model.rest, axis=1).max()):
            return (
                f", and the points by {moved:.2g} mm RMS: little can be identified from such small "
                "moves; record larger ones"
            )
    return f"; if they are not in {model.command_unit}, set their unit in the mapping"


def check_run_matches_model(
    model: Model, run: Run, seen: Floats, visible: Mask, predicted: Floats
) -> list[str]:
    """Reject a run that cannot belong to this robot and these commands; return remarks on others.

    Args:
        model: as for `sound`.
        run: as for `sound`.
        seen: measured points (K, N, 3) mm.
        predicted: predicted points (K, N, 3) mm.
        visible: which points were seen, (K, N).

    Raises:
        RunError: the fault, with its numbers and the remedy.
    """
    length = float(np.linalg.norm(model.rest, axis=1).max())
    _in_reach(model, run, predicted, length)
    some = np.unique(np.linspace(0, len(seen) - 1, min(len(seen), FRAMES)).astype(int))
    s, p, v = seen[some], predicted[some], visible[some]
    rest = np.asarray(
        model.rest if run.marker_rest is None or model.markers else run.marker_rest, float
    )
    _in_order(model, rest, s, v)
    _in_place(model, run.at(some), rest, s, v, p)
    _upside_down(model, run.at(some), s, v, p)
    motion = centred(s, v)
    if (
        float(np.sqrt(np.mean(np.sum(motion[v] ** 2, axis=1)))) < MOTION * length
        or not model.channels
    ):
        return []
    answer = centred(p, v)
    both = float(np.sum(motion * answer))
    power, moved = float(np.sum(answer**2)), float(np.sum(motion**2))
    other = (
        power > 0
        and both > ALIKE * np.sqrt(power * moved)
        and not 1 / LARGER < both / power < LARGER
    )
    if other and memory_share(model, run.at(some), s, v).share < ALIKE:
        raise RunError(
            f"the points move {both / power:.3g} times as far as commanded, in the same way: "
            f"the commands are in another unit than {model.command_unit} (cm, m, deg or "
            "ticks?) or of another robot; set `unit` in the mapping"
        )
    if followed_share(s - p, s, v) < FOLLOWED:
        _other_cause(model, run, s, v)
    return _held(model, run, seen - predicted, visible)


def followed_share(left: Floats, seen: Floats, visible: Mask) -> float:
    """Return the share of the motion of points (K, N, 3) that is not in the residual `left`."""
    moved = float(np.sum(centred(seen, visible) ** 2))
    return 1.0 - float(np.sum(centred(left, visible) ** 2)) / max(moved, 1e-300)


def not_following(
    u: Floats, seen: Floats, visible: Mask, expected: Floats, fitted: Floats, length: float
) -> str | None:
    """Report a robot that does not follow its commands, or hardly.

    It hardly moves, or its motion is unrelated to the predicted one.

    Args:
        u: commands (K, C) at the frames.
        seen: measured points (K, N, 3) mm.
        visible: which points were seen, (K, N).
        expected: predicted points (K, N, 3) mm.
        fitted: points (K, N, 3) mm of the model with the effects found, perhaps a dead zone of the
            full range.
        length: of the body, mm.
    """
    required = spread(expected, visible)
    if required < MOTION * length:
        return None
    moved, answer = centred(seen, visible), centred(expected, visible)
    along = float(np.sum(moved * answer)) / max(float(np.sum(answer**2)), 1e-300)
    got = spread(seen, visible)
    if abs(along) <= ALONG and min(got, spread(fitted, visible)) <= STILL * required:
        finding = (
            f"The robot does not follow its commands: they should move its points by "
            f"{required:.3g} mm RMS, and the points move by {got:.2g} mm RMS, of which "
            f"{100 * abs(along):.1f} % follow the commands"
        )
    elif hardly := hardly_follows(u, seen, visible, expected):
        finding = f"The robot hardly follows its commands: {hardly}"
    else:
        return None
    return (
        f"{finding}. No effect is named. Check that the drive is engaged (power, torque, tendons "
        "attached), the unit of the commands, and that the frames are of this recording."
    )


def _in_reach(model: Model, run: Run, predicted: Floats, length: float) -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        far = np.linalg.norm(predicted, axis=2)
    gone = ~(far < OUT_OF_REACH * length).all(axis=1)
    if not gone.any():
        return
    reasons = command_extrapolation(model, run)
    if run.load is not None and np.any(run.load):
        alone = np.linalg.norm(model.predict(replace(run, load=None)), axis=2)
        if (alone < OUT_OF_REACH * length).all():
            reasons = [
                f"the run declares a load of up to {run.load.max():.4g} g; give `load` in grams"
            ]
    why = (reasons or [""])[0] or "look at the commands with `softmap show`"
    raise RunError(
        f"in {int(gone.sum())} of {len(gone)} frames the model puts the body beyond "
        f"{OUT_OF_REACH * length:.3g} mm from its base, {OUT_OF_REACH:g} times the length of "
        f"'{model.robot}', so the run cannot be used: {why}"
    )


def _in_order(model: Model, rest: Floats, seen: Floats, visible: Mask) -> None:
    """Check that neighbours at rest remain neighbours."""
    if len(rest) < 4:
        return
    ones = np.unique(np.linspace(0, len(rest) - 1, min(len(rest), FRAMES)).astype(int))
    apart = np.linalg.norm(rest[ones, None] - rest[None], axis=2)
    apart[apart <= 1e-9] = np.inf
    others = np.argmin(apart, axis=1)
    usual = apart[np.arange(len(ones)), others]
    both = visible[:, ones] & visible[:, others]
    if not both.any() or not np.isfinite(usual).all():
        return
    count = both.sum(axis=0)
    step = np.where(both[..., None], seen[:, ones] - seen[:, others], 0.0).sum(axis=0)[count > 0]
    # the mean: noise averages out
    ratio = np.linalg.norm(step / count[count > 0][:, None], axis=1) / usual[count > 0]
    median = float(np.median(np.maximum(ratio, 1.0 / np.maximum(ratio, 1e-9))))
    if median > SPACING:
        raise RunError(
            f"neighbouring points of '{model.robot}' are {median:.3g} times farther apart or "
            f"closer in this run than at rest, at most {SPACING:g} times is plausible: the points "
            "are in another order, in another unit, or of another robot; give them as the "
            "template has them"
        )


def _in_place(
    model: Model, run: Run, rest: Floats, seen: Floats, visible: Mask, predicted: Floats
) -> None:
    """Check that the frame is right-handed and the base is where a fit can find it."""
    weight = visible.astype(float)
    middle = (seen * weight[..., None]).sum(axis=1) / np.maximum(weight.sum(axis=1), 1.0)[:, None]
    complete = visible.all(axis=1)
    if complete.any() and len(rest) >= 4:
        about = seen[complete] - middle[complete][:, None]
        still = rest - rest.mean(axis=0)
        mixed = np.einsum("kni,nj->kij", about, still)
        strength, sign = np.linalg.svd(mixed, compute_uv=False), np.sign(np.linalg.det(mixed))
        total = np.sum(about**2, axis=(1, 2)) + np.sum(still**2)
        pair = [
            total - 2 * (strength[:, 0] + strength[:, 1] + way * sign * strength[:, 2])
            for way in (1.0, -1.0)
        ]
        turned, mirrored = (
            float(np.sqrt(max(float(left.min()), 0.0) / np.sum(still**2))) for left in pair
        )
        if mirrored < 0.5 * turned and mirrored < 0.1 and turned > 0.1:
            raise RunError(
                f"the points are mirrored: no turn brings them nearer to '{model.robot}' at rest "
                f"than {100 * turned:.0f} % of its size, a mirror does to {100 * mirrored:.0f} %; "
                "the axes of their frame are left-handed, so turn one axis round in the mapping"
            )
    _at_the_clamp(model, rest, seen, visible, predicted)
    flat = (seen[visible], predicted[visible])
    pose = kabsch(flat[1], flat[0], np.ones(len(flat[0])))
    before, after = (
        float(np.sqrt(np.mean(np.sum((q - flat[0]) ** 2, axis=1))))
        for q in (flat[1], pose(flat[1]))
    )
    angle, shift = (
        np.degrees(np.linalg.norm(rotation_vector(pose.rotation))),
        float(np.linalg.norm(pose.shift)),
    )
    length = float(np.linalg.norm(model.rest, axis=1).max())  # points may all be at the tip
    if after < BETTER * before and (angle > TURNED or shift > SHIFTED * length):
        raise RunError(
            f"the points are turned by {angle:.3g}° and shifted by {shift:.4g} mm against the "
            f"base of '{model.robot}', which takes their distance from {before:.3g} to "
            f"{after:.3g} mm RMS; bring them to the base with `softmap run "
            f"align`{_or_opposite(model, run, seen, visible)}"
        )


def _or_opposite(model: Model, run: Run, seen: Floats, visible: Mask) -> str:
    """Report if commands of the opposite sign explain the motion as well as a rotated frame."""
    share = followed_share(seen - _opposite(model, run), seen, visible) if model.channels else 0.0
    if share < ALIKE:
        return ""
    explained = f"with which the commands explain {100 * share:.0f} %"
    return f"; or, if the frame is right, set sign = -1 in the mapping, {explained}"


def _opposite(model: Model, run: Run) -> Floats:
    """Return the predicted points (K, N, 3) mm for commands of the opposite sign."""
    turned: Document = {n: -rows for n in DRIVE if (rows := run.array(n)) is not None}
    return np.asarray(model.predict(replace(run, **turned)))


def _at_the_clamp(
    model: Model, rest: Floats, seen: Floats, visible: Mask, predicted: Floats
) -> None:
    """Report points at the clamp that are in another frame of reference.

    Nothing moves the clamped part, so its points should be at their rest positions.
    """
    length = float(np.linalg.norm(model.rest, axis=1).max())
    there = visible & (np.linalg.norm(rest, axis=1) <= CLAMPED * length)
    frames = there.any(axis=1)
    if not frames.any():
        return
    off = (
        np.where(there[..., None], seen - predicted, 0.0).sum(axis=1)[frames]
        / there.sum(axis=1)[frames][:, None]
    )
    shift, noise = float(np.linalg.norm(off.mean(axis=0))), float(np.linalg.norm(off.std(axis=0)))
    fitted = max(one.high for one in registry()["mount"].parameters if one.unit == "mm")
    if shift > max(FAR * fitted, CLAMPED / 2 * length) and shift > STEADY * noise:
        where = ", ".join(f"{x:.3g}" for x in off.mean(axis=0))
        raise RunError(
            f"this run's frame of reference is {shift:.3g} mm off: where '{model.robot}' is held "
            f"its points stand at ({where}) mm from their place; up to {fitted:g} mm is fitted as "
            "`mount`, so bring them to the base with `softmap run align`"
        )


def _upside_down(model: Model, run: Run, seen: Floats, visible: Mask, predicted: Floats) -> None:
    """Report a declared gravity that points upwards."""
    if run.gravity is None:
        return
    other = np.asarray(model.predict(replace(run, gravity=-run.gravity)))
    ours, theirs = (
        float(np.sqrt(np.mean(np.sum((seen - p)[visible] ** 2, axis=1))))
        for p in (predicted, other)
    )
    if theirs < MENDED * ours:
        raise RunError(
            f"with `gravity` the other way round the error is {theirs:.3g} instead of {ours:.3g} "
            "mm RMS: it is declared upside down; give the direction in which things fall, in the "
            "base frame"
        )


def _other_cause(model: Model, run: Run, seen: Floats, visible: Mask) -> None:
    """Report another clock or the opposite sign if it makes commands and frames agree."""
    some = np.unique(np.linspace(0, run.frames - 1, min(run.frames, FRAMES)).astype(int))
    share = followed_share(seen - _opposite(model, run.at(some)), seen, visible)
    late, later = _clock(model, run, seen, visible, run.t_seen[some])
    if (
        max(share, later) > ALIKE
        and memory_share(model, run.at(some), seen, visible).free > max(share, later) - NEARLY
    ):
        return
    if share > ALIKE:
        raise RunError(
            f"with the opposite sign the commands explain {100 * share:.0f} % of the motion, as "
            "they are far less: every channel pulls the other way; set sign = -1 in the mapping"
        )
    if later > ALIKE and abs(late) > LATE and not run.timeless:
        raise RunError(
            f"the commands explain {100 * later:.0f} % of the motion with the frames "
            f"{abs(late):.4g} s {'earlier' if late > 0 else 'later'}, as they are far less: bring "
            "both to one clock (`time.offset_s` of one log in the mapping)"
        )


def _clock(model: Model, run: Run, seen: Floats, visible: Mask, t: Floats) -> tuple[float, float]:
    """Return the delay of the frames in s, and the share of motion explained with it.

    A periodic command also fits one period later. The smallest shift that explains nearly as much
    is returned.
    """
    grid = np.linspace(run.t[0], run.t[-1], TIMES)
    blank: Document = {
        "vertices": None,
        "markers": None,
        "visible": None,
        "sigma": None,
        "block": None,
        "t_seen": grid,
    }
    name = "vertices" if run.vertices is not None else "markers"
    blank |= {
        name: np.full((TIMES, *seen.shape[1:]), np.nan),
        "visible": np.zeros((TIMES, seen.shape[1]), bool),
    }
    played = np.asarray(model.predict(replace(run, extra={}, **blank)))
    motion = centred(seen, visible)
    ones = np.argsort(-np.sum(motion**2, axis=(0, 2)))[:3]  # the points that move most
    played, seen, visible = played[:, ones], seen[:, ones], visible[:, ones]
    found = [(0.0, -np.inf)]
    for late in np.linspace(-1.0, 1.0, 2 * TIMES + 1) * (grid[-1] - grid[0]):
        inside = (t - late >= grid[0]) & (t - late <= grid[-1])
        if inside.sum() < max(30, 0.4 * len(t)):
            continue
        at = np.clip(
            np.rint((t[inside] - late - grid[0]) / (grid[1] - grid[0])).astype(int), 0, TIMES - 1
        )
        s, v = seen[inside], visible[inside]
        share = followed_share(s - played[at], s, v)
        found.append((float(late), share))
    most = max(share for _, share in found)
    rounds: list[list[tuple[float, float]]] = [[]]
    for pair in sorted(found):
        if pair[1] >= most - NEARLY:
            rounds[-1].append(pair)
        elif rounds[-1]:
            rounds.append([])
    tops = [max(part, key=lambda pair: pair[1]) for part in rounds if part]
    return min(tops, key=lambda pair: abs(pair[0]))


def _held(model: Model, run: Run, left: Floats, visible: Mask) -> list[str]:
    """Report commands logged at an extreme while the body moves on: the log may be clipped.

    The misfit along the slope of the points over this command estimates how far the command
    continued. An effect leaves the same misfit at every hold, or one that depends on the hold's
    duration. A clipped command continues by a different amount each time, or as far as its speed
    before and after the hold allows.
    """
    u = model.commands(run)
    dwell = conditions(run, u).dwell
    at = np.stack([np.interp(run.t_seen, run.t, row) for row in u.T], axis=1)
    span = np.ptp(u, axis=0)
    found, frames, furthest = [], np.zeros(len(at), bool), 0.0
    ends = np.minimum(np.abs(at - u.min(axis=0)), np.abs(at - u.max(axis=0))) <= 1e-9 * np.maximum(
        span, 1e-12
    )
    # if most commands are at their ends, this is intended: slack
    few = ends[:, span > 0].sum(axis=1) <= max(1, model.channels // 2)
    for c, sign in [(int(c), sign) for c in np.flatnonzero(span > 0) for sign in (-1.0, 1.0)]:
        end, near = float(np.max(sign * u[:, c])), 1e-9 * span[c]
        rows = np.flatnonzero((np.abs(sign * at[:, c] - end) <= near) & few)
        if len(rows) < max(LEAST_HELD, END * len(at)):
            continue
        step, free = sign * STEP * span[c], np.abs(sign * u[:, c] - end) > near
        on = STEP * _goes_on(model, run, left, visible, rows, c, step)[0]
        late = np.stack([np.ones(len(rows)), np.log1p(dwell[rows])], axis=1)
        wave = np.minimum(
            _further(run.t, sign * u[:, c], free, run.t_seen[rows]) / span[c], on.max()
        )
        as_fast = np.std(on) > GOES_ON / 2 and np.var(on - wave) < AS_FAST * np.var(on)
        if not as_fast and not np.std(_unexplained(late, on)) > GOES_ON:
            continue
        others = np.flatnonzero(np.abs(at - at[rows[0]])[:, c] > near)
        others = others[
            np.unique(np.linspace(0, len(others) - 1, min(len(others), FRAMES)).astype(int))
        ]
        usual, strength = _goes_on(model, run, left, visible, others, c, step)
        # a command with hardly any effect gives a meaningless estimate
        some = strength > SEEN * np.median(strength)
        usual = STEP * _unexplained(
            np.stack([np.ones(len(others)), at[others, c]], axis=1)[some], usual[some]
        )
        if np.std(on) > MORE * np.std(usual):
            found.append(f"{sign * end:.4g} {model.command_unit} on channel {c}")
            frames[rows], furthest = True, max(furthest, float(on.max() * span[c]))
    count = int(frames.sum())
    if count < HELD * len(at):
        return []
    return [
        f"commands are logged at exactly {', '.join(found)} in {count} of {len(at)} frames, in "
        f"which the body moves as if they went on by up to {furthest:.2g} {model.command_unit}: "
        "the log may be clipped there; log what is sent"
    ]


def _further(t: Floats, u: Floats, free: Mask, seen: Floats) -> Floats:
    """Return how far a command (T,) continues beyond its held end, at the times `seen` (K,).

    It is extrapolated at the approach speed early in the hold, at the departure speed late in it.
    The turning point is unknown.
    """
    speed = np.abs(np.gradient(u, t))
    ones = np.flatnonzero(free)
    after = np.searchsorted(t[ones], seen)
    came, left = ones[np.maximum(after - 1, 0)], ones[np.minimum(after, len(ones) - 1)]
    early = speed[np.maximum(came - 1, 0)] * np.abs(seen - t[came])
    late = speed[np.minimum(left + 1, len(t) - 1)] * np.abs(t[left] - seen)
    return np.asarray(np.minimum(early, late))


def _goes_on(
    model: Model,
    run: Run,
    left: Floats,
    visible: Mask,
    rows: NDArray[np.intp],
    channel: int,
    step: float,
) -> tuple[Floats, Floats]:
    """Return by how many steps a command must have continued in each frame to explain `left`.

    Also return the effect of one step.
    """
    part, moved, shown = run.at(rows), np.zeros(model.channels), visible[rows][..., None]
    moved[channel] = step
    back: Document = {n: own - moved for n in DRIVE if (own := part.array(n)) is not None}
    slope = np.where(shown, model.predict(part) - model.predict(replace(part, **back)), 0.0)
    square = np.sum(slope**2, axis=(1, 2))
    along = np.sum(slope * np.where(shown, left[rows], 0.0), axis=(1, 2))
    return np.asarray(along / np.maximum(square, 1e-12)), np.asarray(np.sqrt(square))


def _unexplained(columns: Floats, values: Floats) -> Floats:
    """Return the residual of values (n,) after a fit of columns (n, m)."""
    return np.asarray(values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0])


def spread(left: Floats, visible: Mask) -> float:
    """Return the RMS (mm) of the misfit (K, N, 3) about its mean over these frames."""
    return float(np.sqrt(power(centred(left, visible), visible)))
