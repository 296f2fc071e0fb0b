"""Report what a run can identify before any fit, and what to record next.

Each answer concerns one question of a diagnosis and uses the run alone: enough frames, known
noise, visits of home, kind of motion. Limits are those of the methods behind the question
(`noise/noise_model.py`, `diagnosis/fit.py`), or a factor below which two causes look alike. Every answer states its
number. Minutes are the duration of the missing block. Units: mm, s, °C. Pinned by
tests/checks/test_advice.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.checks.collinear import collinear_conditions, tied_channels
from softmap_edge.files.atomic import Document
from softmap_edge.model.coverage import apart, pairs_text
from softmap_edge.noise.floor import commanded, noise_of_points
from softmap_edge.noise.repeats import LONG_DWELL
from softmap_edge.run.conditions import (
    STILL,
    WARMING,
    Conditions,
    conditions,
    last_direction,
    orientations,
)
from softmap_edge.run.folds import GAP, LEAST_FRAMES, without_gap
from softmap_edge.run.plane import AXES, plane_of, unmeasured
from softmap_edge.run.rest_command import far_from_home, rest_command
from softmap_edge.run.run import HOME_TICKS, Run, known

Floats = NDArray[np.float64]

ENOUGH_FRAMES = 60  # frames; with fewer, small effects are hidden
# visits of home (start, end, between) needed to separate drift from noise
ENOUGH_VISITS = 3
MOVING = 15  # frames in motion; with fewer, delays are a guess
SLOW = 0.1  # of the range per second: a delay of 0.1 s is then 1 % of the range
SPEEDS = 2.0  # ratio of fast to slow; below it delay and play look alike
DWELL = 5.0  # s of rest needed to see creep
# a gap between two frames: usual steps, and s
GAP_SAMPLES, GAP_S = 10.0, 1.0
MINORITY = 0.1  # of the frames, approached from the rarer side
TOGETHER = 0.95  # correlation; from here on two channels count as one
PAIRS = 4  # pairs of such channels that are listed
DWELL_FRAMES = LONG_DWELL + 2  # frames; three such dwells show the noise (`noise.ENOUGH`)
COLLINEAR = 0.02  # of their length: markers closer to one line than this show no twist


@dataclass(frozen=True)
class Advice:
    """An answer to one question of a diagnosis, with the remedy if the run does not answer it.

    `about` names the question. `tells` is true if the run answers it.
    """

    about: str
    tells: bool
    text: str
    remedy: str | None = None
    minutes: float | None = None

    def to_dict(self) -> Document:
        """Return the answer as plain numbers and texts."""
        return asdict(self)


def advice(run: Run, home_visits: int) -> list[Advice]:
    """Return what a run can identify and what it cannot, most important first.

    Args:
        run: any run.
        home_visits: number of rests at home (`summary` counts them).
    """
    if run.frames == 0:
        return [
            Advice(
                "frames",
                False,
                "anything: no frame was seen",
                "record what the cameras see with the commands",
                4.0,
            )
        ]
    u = commanded(run)
    state = conditions(run, u)
    away = home_unknown(run)
    words = [
        _enough(run.frames),
        *_folds(run),
        _noise(run),
        _home(home_visits) if away is None else away,
    ]
    # outputs have no body
    words += [] if run.output is not None else [_orientation(run), *_points(run)]
    words += _drive(u)
    if words[-1].about != "drive":
        words += [_no_time()] if run.timeless else [_speed(u, state)]
        words += [] if run.timeless or away is not None else [_dwell(state)]
        words.append(_direction(state))
    return [*words, _temperature(run)]


def missing_data(runs: Sequence[Run], frames: int, measured: bool) -> list[str]:
    """Return sentences on what a diagnosis needs and its runs do not provide.

    Args:
        runs: runs that are diagnosed together; one run that shows something is enough.
        frames: number of frames used of all runs.
        measured: whether the noise is measured, and no guess.
    """
    words = [_enough(frames), *_drive(np.concatenate([commanded(run) for run in runs]))]
    words += [_no_time()] if any(run.timeless for run in runs) else []
    if not measured:
        words.append(_guessed(next((run.sigma for run in runs if run.sigma is not None), None)))
    words += [word for run in runs for word in _folds(run)]
    leaning = [run for run in runs if run.gravity is None and run.output is None]
    words += [_orientation(run) for run in leaning[:1]]
    poor = [
        f"these data cannot identify {word.text}; {word.remedy}" for word in words if not word.tells
    ]
    return list(dict.fromkeys(poor))


def _guessed(sigma: Floats | None) -> Advice:
    """Report that the noise is a guess.

    A declared `sigma` is only compared with repeats (`clean.py`); it never replaces them.
    """
    stated = ""
    if sigma is not None:
        stated = f"; the declared {np.median(sigma):.2g} mm per coordinate is not used"
    return Advice(
        "noise",
        False,
        f"noise vs. effects of the same size: too few repeated poses to estimate the noise{stated}",
        f"rest at home and at two other places for 10 s each, with {DWELL_FRAMES} frames or more "
        "each time",
        1.0,
    )


def _no_time() -> Advice:
    text = "which law lags behind or drifts (delay, lag, rate, creep, drift): the log has no time"
    return Advice("time", False, text, "log the time of each row", 1.0)


def _enough(frames: int) -> Advice:
    if frames < LEAST_FRAMES:
        text = f"which effect is missing: {frames} frames are too few to hold some out"
        return Advice(
            "frames", False, text, f"record at least {ENOUGH_FRAMES} frames, better 360", 4.0
        )
    if frames < ENOUGH_FRAMES:
        text = f"small effects: {frames} frames leave too few for validation"
        return Advice("frames", False, text, "record the same for longer, about 360 frames", 4.0)
    return Advice(
        "frames",
        True,
        f"whether an effect helps on what was not fitted: {frames} frames can be held out",
    )


def _folds(run: Run) -> Iterator[Advice]:
    """Report blocks shorter than the gap between held-out and fitted frames."""
    count, folds = (0, 0) if run.timeless else without_gap(run.t_seen, run.block)
    if count > 1:  # one fold of several changes the held-out error little
        text = (
            f"how far off a model is on frames of its own kind: {count} of {folds} held-out parts "
            f"have no gap of {GAP:g} s next to them, since blocks are shorter than the gap, and "
            "their error is too small"
        )
        yield Advice(
            "folds", False, text, "record for longer, or label blocks that last 5 s or more", 4.0
        )


def _noise(run: Run) -> Advice:
    seen = run.places
    if seen is None:
        return Advice(
            "noise",
            False,
            "the noise: the points of clouds have no identity",
            "register them to a template",
        )
    found = noise_of_points(run)
    if found is not None:
        size = (
            f"{found.mm:.2g} mm"
            if run.output is None
            else f"{run.output.value(found.mm):.2g} {run.output.unit}"
        )
        return Advice("noise", True, f"noise vs. effects: the noise is {size}, from {found.source}")
    return _guessed(run.sigma)


def _home(visits: int) -> Advice:
    if visits >= ENOUGH_VISITS:
        return Advice(
            "home", True, f"drift, and whether the base moved: home is visited {visits} times"
        )
    often = {0: "never visited", 1: "visited once", 2: "visited twice"}[visits]
    return Advice(
        "home",
        False,
        f"drift vs. play, and whether the base moved: home is {often}",
        "rest at home for 5 s at the start, at the end and once in between",
        0.5,
    )


def home_unknown(run: Run) -> Advice | None:
    """Return the answer on commands not counted from home; None if 0 can be home."""
    u = commanded(run)
    if (
        not u.size
        or HOME_TICKS in run.extra
        or not (far := np.flatnonzero(far_from_home(reach_of(u)))).size
    ):
        return None
    unit = run.command_unit if run.command is not None else "ticks"
    reach = ", ".join(
        f"channel {c} runs from {u[:, c].min():g} to {u[:, c].max():g} {unit}" for c in far[:PAIRS]
    )
    offset = ", ".join(
        f"{-x + 0.0:g}" for x in np.where(np.isin(np.arange(u.shape[1]), far), rest_command(u), 0.0)
    )
    return Advice(
        "home",
        False,
        f"gain, play, slack and drift, which count from home: {reach}, far from 0, so home is not "
        "known",
        "subtract the command at which the robot rests in the mapping, and import again: offset "
        f"= [{offset}] if that is where the run begins; if 0 is home, record the robot at rest "
        "there",
        None,
    )


def reach_of(u: Floats) -> Floats:
    """Return the smallest and largest command (C, 2) of commands (T, C)."""
    return np.stack([u.min(axis=0), u.max(axis=0)], axis=1)


def _orientation(run: Run) -> Advice:
    at = np.clip(np.searchsorted(run.t, run.t_seen, side="right") - 1, 0, None)
    seen = run.gravity if run.gravity is None or run.gravity.ndim == 1 else run.gravity[at]
    count = orientations(seen)
    if count > 1:
        return Advice(
            "orientation",
            True,
            f"the robot's own weight vs. a load at its tip: {count} orientations",
        )
    declared = (
        "the orientation is not declared"
        if run.gravity is None
        else "it is seen in one orientation"
    )
    loads = run.load is not None and float(np.ptp(run.load)) > 0
    if loads:
        return Advice(
            "orientation", True, "the robot's own weight vs. a load at its tip: the load changes"
        )
    return Advice(
        "orientation",
        False,
        f"the robot's own weight vs. a load at its tip: {declared}",
        "repeat the moves with the robot leaning by about 35°, and declare `gravity` in both",
        3.0,
    )


def _points(run: Run) -> Iterator[Advice]:
    seen = run.markers
    if (axis := unmeasured(run)) is None and (plane := plane_of(run)) is not None:
        remedy = (
            "measure the third coordinate as well, with a second camera; a planar robot does "
            "without"
        )
        yield Advice(
            "markers", False, f"any effect across the plane of the robot: {plane}", remedy, None
        )
    if seen is None or not seen.size:
        return
    if axis is not None:
        text = f"what happens across the plane of the markers: their {AXES[axis]} is not measured"
        yield Advice(
            "plane",
            False,
            text,
            "see the robot from a second side as well, or with a depth camera",
            None,
        )
    if seen.shape[1] == 1:
        text = "where along the body an error begins: one marker is seen"
        yield Advice(
            "markers", False, text, "add markers at several heights, and three on the base", None
        )
        return
    rest = run.marker_rest
    if rest is None:
        complete = np.flatnonzero(known(run, seen).all(axis=1))
        if not len(complete):
            return
        rest = seen[complete[0]]
    size = np.linalg.svd(rest - rest.mean(axis=0), compute_uv=False)
    if len(size) < 2 or size[1] < COLLINEAR * size[0]:
        text = "a twist, and turns of the base about the robot's axis: the markers lie on one line"
        yield Advice(
            "markers", False, text, "glue a marker or two next to the line, 10 mm or more", None
        )


def _drive(u: Floats) -> list[Advice]:
    if u.shape[1] == 0:
        remedy = "send commands and log them with the frames"
        return [
            Advice("drive", False, "anything about the drive: nothing is commanded", remedy, 4.0)
        ]
    if not np.ptp(u, axis=0).any():
        remedy = "move every channel to both ends of its range and back"
        return [
            Advice(
                "drive", False, "anything about the drive: the commands never change", remedy, 2.0
            )
        ]
    return list(_channels(u))


def _channels(u: Floats) -> Iterator[Advice]:
    span = np.ptp(u, axis=0)
    still = np.flatnonzero(span <= 1e-9 * span.max())
    if len(still):
        named = ", ".join(map(str, still))
        text = f"anything about channel {named}: it never moves"
        yield Advice(
            "channels", False, text, "move it to both ends of its range and back", float(len(still))
        )
    alive = np.flatnonzero(span > 1e-9 * span.max())
    tied = [group for group in tied_channels(u) if len(group.channels) > 2]
    for group in tied:
        text = f"effects of one channel of a group alone (gain, play, friction): {group}"
        yield Advice("channels", False, text, group.remedy, float(len(group.channels)))
    pairs = _pairs(
        u,
        alive,
        {frozenset((a, b)) for group in tied for a in group.channels for b in group.channels},
    )
    for one, two, r in pairs:
        text = f"channel {one} vs. channel {two}: they move together (correlation {r:.2f})"
        yield Advice(
            "channels",
            False,
            text,
            "move each channel alone, the others at rest",
            float(len(alive)),
        )
    if len(alive) > 1 and not (tied or pairs or len(still)):
        yield Advice(
            "channels", True, f"one channel vs. another: all {len(alive)} move independently"
        )
    far = far_from_home(reach_of(u))
    if len(alive) > 1 and not (tied or pairs or far.any()) and (never := apart(u)):
        text = f"what channels do together: {pairs_text(never)} are never far from home at once"
        remedy = "move them together as well, to the corners of their ranges"
        yield Advice("together", False, text, remedy, float(min(len(never), 4)))
    counted = [c for c in alive if not far[c]]
    one_sided = [
        c
        for c in counted
        if u[:, c].min() > -0.05 * u[:, c].max() or u[:, c].max() < -0.05 * u[:, c].min()
    ]
    if one_sided:
        named = ", ".join(map(str, one_sided))
        text = f"what the second tendon of a pair does: channel {named} is pulled to one side only"
        remedy = "pull to both sides of home (a single tendon has none: then leave it)"
        yield Advice("sides", False, text, remedy, float(len(one_sided)))


def _pairs(
    u: Floats, alive: NDArray[np.intp], grouped: set[frozenset[int]]
) -> list[tuple[int, int, float]]:
    """Return pairs of channels that move together, with their correlation.

    Pairs within a group that is already reported are omitted.
    """
    if len(alive) < 2:
        return []
    r = np.abs(np.corrcoef(u[:, alive].T))
    found = [
        (int(alive[i]), int(alive[j]), float(r[i, j]))
        for i, j in np.argwhere(np.triu(r, 1) > TOGETHER)
        if frozenset((int(alive[i]), int(alive[j]))) not in grouped
    ]
    return sorted(found, key=lambda pair: (-round(pair[2], 2), pair[:2]))[:PAIRS]


def _speed(u: Floats, state: Conditions) -> Advice:
    moving = int(state.moving.sum())
    remedy = "full-range triangles fast and slow, seen about 9 times a second while they move"
    if moving < MOVING:
        return Advice(
            "speed",
            False,
            f"delay, lag and friction: {moving} frames are seen in motion",
            remedy,
            1.0,
        )
    span = np.ptp(u, axis=0)
    # ranges per second
    pace = np.abs(state.velocity[state.moving]) / np.where(span > 0, span, np.inf)
    pool = np.sort(pace[pace > STILL] if (pace > STILL).any() else pace.max(axis=1))
    few = min(MOVING, len(pool) // 4)  # this many frames are faster, and this many slower
    slow, fast = pool[few], pool[-1 - few]
    if fast < SPEEDS * slow:
        text = (
            f"delay and lag vs. play: it always moves at about {np.sqrt(slow * fast):.2g} of its "
            "range a second"
        )
        return Advice("speed", False, text, remedy, 1.0)
    if fast < SLOW:
        text = (
            f"delay and lag vs. play: it never moves faster than {fast:.2g} of its range a second"
        )
        return Advice("speed", False, text, remedy, 1.0)
    return Advice(
        "speed",
        True,
        f"delay and lag vs. play: it moves at {slow:.2g} to {fast:.2g} of its range a second",
    )


def _dwell(state: Conditions) -> Advice:
    away = ~(np.abs(state.command).max(axis=1) <= 0.1 * np.abs(state.command).max())
    longest = float(
        np.minimum(state.dwell, _since_gap(state.time))[away & ~state.moving].max(initial=0.0)
    )
    if longest >= DWELL:
        return Advice(
            "dwell",
            True,
            f"creep vs. play: it is seen to rest away from home for up to {longest:.0f} s",
        )
    return Advice(
        "dwell",
        False,
        f"creep vs. play: away from home it is seen to rest for {longest:.1f} s at most",
        "a staircase: half, full, half the range, and rest 7 s on each step, five frames each",
        2.0,
    )


def _since_gap(t: Floats) -> Floats:
    """Return the time (K,) s since the last gap in the frames; events in a gap are not seen."""
    if len(t) < 2:
        return np.zeros(len(t))
    step = np.diff(t)
    gap = np.r_[True, step > max(GAP_S, GAP_SAMPLES * float(np.median(step)))]
    return np.asarray(t - np.maximum.accumulate(np.where(gap, t, t[0])))


def _direction(state: Conditions) -> Advice:
    sign = last_direction(state.velocity, state.moving)
    moved = np.abs(sign).sum(axis=0)
    rarer = np.minimum((sign > 0).sum(axis=0), (sign < 0).sum(axis=0)) / np.maximum(moved, 1)
    poor = [str(c) for c in np.flatnonzero(rarer < MINORITY)]
    if not poor:
        return Advice(
            "direction", True, "play, friction and hysteresis: places are reached from both sides"
        )
    named = f"channel {', '.join(poor)} is seen coming from one side only"
    return Advice(
        "direction",
        False,
        f"play, friction and hysteresis: {named}",
        "triangles of growing size, up and back, and small loops around two places",
        2.0,
    )


def _temperature(run: Run) -> Advice:
    remedy = (
        "log a thermometer next to the silicone; warm it up by 5 °C while it moves, and let it "
        "cool down again"
    )
    if run.temperature is None:
        return Advice(
            "temperature",
            False,
            "thermal softening vs. creep: no temperature is logged",
            remedy,
            15.0,
        )
    change = float(np.ptp(run.temperature))
    if change < WARMING:
        text = f"thermal softening vs. creep: the temperature changes by {change:.1f} °C only"
        return Advice("temperature", False, text, remedy, 15.0)
    for confused in collinear_conditions(run):
        if confused.condition == "temperature":
            other = "drift over time" if confused.with_ == "time" else "effects of the commands"
            text = f"thermal softening vs. {other}: the temperature follows {confused.like}"
            return Advice("temperature", False, text, confused.remedy, 15.0)
    return Advice(
        "temperature",
        True,
        f"thermal softening vs. creep: the temperature changes by {change:.1f} °C",
    )
