"""Summarise the contents and gaps of a run, for `softmap check`.

Dwells are those of `conditions`. A place is visited again when every channel is within 2 % of its
range. Servo resolution is 10 times finer, so repeated commands match. Neighbours on a usual grid do
not.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.clouds import with_depth
from softmap_edge.checks.advice import Advice, advice, home_unknown
from softmap_edge.checks.collinear import Collinear, collinear_conditions
from softmap_edge.checks.frame_clock import FrameClock, frame_clock
from softmap_edge.checks.lost_points import REMEDY, without_lost
from softmap_edge.checks.unanswered import unanswered
from softmap_edge.checks.unseen_markers import FAR, unseen_parts
from softmap_edge.files.atomic import Document
from softmap_edge.logs.plausible import overlong_stroke
from softmap_edge.model.servo_calibration import converted
from softmap_edge.model.views import laid
from softmap_edge.run.conditions import HOME, conditions, orientations
from softmap_edge.run.contents import command_ranges, rounded
from softmap_edge.run.rollover import roll_overs_of
from softmap_edge.run.run import BASE_MARKERS, DAMAGE, NO_COMMANDS, OURS, Run, known, text_in

Floats = NDArray[np.float64]

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

SCHEMA = "softmap.check/1"
SAME_PLACE = 0.02  # of a channel's range


@dataclass(frozen=True)
class Outputs:
    """The outputs of a run without a body: `names`, `unit`, and the `range` of each."""

    names: list[str]
    unit: str
    range: list[list[float]]


@dataclass(frozen=True)
class RunSummary:
    """The contents and gaps of a run; `to_dict()` is the body of the document softmap.check/1.

    Attributes:
        calibrated: whether ticks were converted to commands by the calibration of a model.
        command_range: lowest and highest command of each channel.
        seen: "vertices", "markers" or "points"; None if nothing was seen.
        points_mm: lowest and highest x, y and z, mm.
        timeless: whether the log has no time, only an order.
        visible_share: share of the points that are visible.
        places_revisited: places other than home that were visited again.
        unknown_fields: fields of the run that no method uses.
        roll_seen: whether the markers show the roll of the body.
        not_seen: sentences on points that stand for "not seen". They count as not visible, and the
            run is not sound.
        unseen_parts: sentences on what was never or hardly seen (`unseen_markers.unseen_parts`).
            They are also `warnings`, and the run is not sound.
        unanswered: a sentence if commands and motion contradict each other. Such a run is not
            sound.
        missing, warnings: sentences.
        collinear: conditions that cannot be separated from time or the commands.
        home_known: whether 0 can be home (`advice.home_unknown`).
        can_tell, cannot_tell: what the run can identify and what it cannot.
        frame_clock: the clock of the frames against that of the commands.
    """

    robot: str | None
    channels: int
    rows: int
    duration_s: float
    rate_hz: float | None
    calibrated: bool
    command_unit: str
    command_range: list[list[float]]
    frames: int
    frame_rate_hz: float | None
    seen: str | None
    points_mm: list[list[float]] | None
    output: Outputs | None
    timeless: bool
    base_markers: int
    points_per_frame: int | None
    visible_share: float
    encoders: bool
    gravity: str | None
    load_g: list[float] | None
    temperature_c: list[float] | None
    blocks: list[str]
    home_visits: int
    places_revisited: int
    unknown_fields: list[str]
    roll_seen: bool
    not_seen: list[str]
    unseen_parts: list[str]
    unanswered: str | None
    hash: str
    missing: list[str]
    collinear: list[Collinear]
    home_known: bool
    can_tell: list[Advice]
    cannot_tell: list[Advice]
    frame_clock: FrameClock | None
    warnings: list[str]

    def to_dict(self) -> Document:
        """Return the summary in document form, with units in the keys."""
        clock = self.frame_clock
        return asdict(self) | {
            "collinear": [asdict(one) | {"text": str(one)} for one in self.collinear],
            "frame_clock": None if clock is None else clock.to_dict(),
        }


def summary(recorded: Run, model: Model | None = None) -> RunSummary:
    """Return the contents and gaps of a run.

    Args:
        recorded: any run.
        model: its calibration, if any, converts the ticks of the run to commands.

    Raises:
        CalibrationError: the calibration belongs to other servos.
    """
    run, lost = without_lost(converted(model, recorded), REMEDY)
    run, depthless = (run, "") if run.points is None else with_depth(run)
    seen = None if run.seen is None else run.array(run.seen)
    home_visits, places_revisited = _visits(run)
    parts = unseen_parts(run)
    collinear = collinear_conditions(run)
    words = advice(run, home_visits)
    clock = frame_clock(run)
    drift = str(clock) if clock is not None and clock.differs else ""
    return RunSummary(
        robot=run.robot,
        channels=run.channels,
        rows=len(run.t),
        duration_s=rounded(run.t[-1] - run.t[0]),
        rate_hz=_rate(run.t),
        calibrated=recorded.ticks is not None and run.ticks is None,
        command_unit="ticks" if run.ticks is not None else run.command_unit,
        command_range=command_ranges(run),
        frames=run.frames,
        frame_rate_hz=_rate(run.t_seen),
        seen=run.seen,
        points_mm=None if run.output is not None else _extent(_shown(run, seen)),
        output=_outputs(run),
        timeless=run.timeless,
        base_markers=int(run.extra[BASE_MARKERS].shape[1]) if _has_base(run) else 0,
        points_per_frame=None if seen is None or seen.ndim != 3 else int(seen.shape[1]),
        visible_share=_visible_share(run),
        encoders=run.present is not None or run.present_ticks is not None,
        gravity=_gravity(run),
        load_g=_span(run.load),
        temperature_c=_span(run.temperature),
        blocks=_blocks(run),
        home_visits=home_visits,
        places_revisited=places_revisited,
        unknown_fields=sorted(set(run.extra) - OURS),
        roll_seen=not laid(run),
        not_seen=lost,
        unseen_parts=parts,
        unanswered=unanswered(run),
        hash=recorded.hash(),
        missing=_missing(run),
        collinear=collinear,
        home_known=home_unknown(run) is None,
        can_tell=[word for word in words if word.tells],
        cannot_tell=[word for word in words if not word.tells],
        frame_clock=clock,
        warnings=[
            *_damage(run),
            *filter(None, [depthless]),
            *parts,
            *_warnings(run),
            *filter(None, [drift]),
        ],
    )


def _span(values: Floats | None) -> list[float] | None:
    """Return the lowest and the highest of some values."""
    return None if values is None else [rounded(values.min()), rounded(values.max())]


def _visible_share(run: Run) -> float:
    return 1.0 if run.visible is None or not run.visible.size else rounded(run.visible.mean())


def _blocks(run: Run) -> list[str]:
    """Return the labels of the frames, in order."""
    return [] if run.block is None else [str(label) for label in dict.fromkeys(run.block.tolist())]


def _has_base(run: Run) -> bool:
    return BASE_MARKERS in run.extra and run.extra[BASE_MARKERS].ndim == 3


def _rate(t: Floats) -> float | None:
    if len(t) < 2:
        return None
    step = np.diff(t)
    # without gaps; the mean, because logged times are rounded
    usual = step[step <= 1.5 * np.median(step)]
    return rounded(1.0 / usual.mean())


def _extent(seen: Floats | None) -> list[list[float]] | None:
    """Return the extent of the points: lowest and highest x, y, z in mm."""
    if seen is None or not seen.size or seen.shape[-1] != 3:
        return None
    flat = seen.reshape(-1, 3)
    flat = flat[np.isfinite(flat).all(axis=1)]
    return [[rounded(c.min()), rounded(c.max())] for c in flat.T] if len(flat) else None


def _shown(run: Run, seen: Floats | None) -> Floats | None:
    """Return the points with NaN where not visible; clouds unchanged."""
    if seen is None or seen.ndim != 3:
        return seen
    return np.where(known(run, seen)[..., None], seen, np.nan)


def _outputs(run: Run) -> Outputs | None:
    """Return the outputs of a run and their ranges, in their unit."""
    if run.output is None:
        return None
    rows = run.outputs
    ranges = [
        [rounded(np.nanmin(c)), rounded(np.nanmax(c))] if np.isfinite(c).any() else [0.0, 0.0]
        for c in rows.T
    ]
    return Outputs(list(run.output.names), run.output.unit, ranges)


def _gravity(run: Run) -> str | None:
    if run.gravity is None:
        return None
    rows = np.unique(np.round(np.atleast_2d(run.gravity), 3), axis=0)
    if len(rows) > 4:
        count = orientations(run.gravity)
        return (
            f"one orientation, {len(rows)} readings"
            if count == 1
            else f"{count} orientations, {len(rows)} readings"
        )
    return " and ".join("(" + ", ".join(f"{x + 0.0:g}" for x in row) + ")" for row in rows)


def _visits(run: Run) -> tuple[int, int]:
    """Return the number of rests at home, and of other places visited again."""
    given = run.command if run.command is not None else run.ticks
    if given is None or run.channels == 0 or run.frames == 0 or len(run.t) < 2:
        return 0, 0
    rows = given.astype(np.float64)
    span = np.ptp(rows, axis=0)
    if not (span > 0).any():
        return 0, 0
    state = conditions(run, rows)
    top = np.abs(rows).max()
    away = run.t[np.abs(rows).max(axis=1) > HOME * top]  # s, away from home
    home, places, since = 0, list[tuple[int, ...]](), -np.inf
    for visit in np.unique(state.visit[state.visit >= 0]):
        frames = state.visit == visit
        place = np.median(state.command[frames], axis=0)
        if np.abs(place).max() > HOME * top:
            places.append(
                tuple(np.rint(place / np.where(span > 0, SAME_PLACE * span, 1.0)).astype(int))
            )
            continue
        begins, ends = run.t_seen[frames][[0, -1]]
        home += since == -np.inf or bool(((away > since) & (away < begins)).any())
        since = ends
    _, counts = (
        np.unique(np.array(places), axis=0, return_counts=True) if places else (None, np.zeros(0))
    )
    return int(home), int((counts > 1).sum())


def _missing(run: Run) -> list[str]:
    gaps = []
    if run.frames and run.seen is None:
        gaps.append("points: there are times of frames but no vertices, markers or points")
    if run.command is None and run.ticks is not None:
        gaps.append(
            "command: only ticks are given; `softmap learn` makes a model in ticks, and for a "
            "model in mm a bundle of `softmap model calibrate` converts them"
        )
    if run.gravity is None and run.output is None:
        gaps.append("gravity: the orientation of the robot is taken to be that of its model")
    if run.markers is not None and run.marker_rest is None and run.output is None:
        gaps.append("marker_rest: the rest place of the markers has to come from the model")
    if run.sigma is None:
        what = "points" if run.output is None else "outputs"
        gaps.append(
            f"sigma: the noise of the {what} comes from repeats alone, with nothing to check it by"
        )
    return gaps


def _damage(run: Run) -> list[str]:
    """Return a sentence if the run comes from a damaged recording or log."""
    text = text_in(run.extra, DAMAGE)
    return [] if text is None else [f"made of what could be read: {text}"]


def _warnings(run: Run) -> list[str]:
    notes = []
    outside = int(((run.t_seen < run.t[0]) | (run.t_seen > run.t[-1])).sum())
    if outside:
        notes.append(
            f"{outside} frames lie outside the time of the commands; the nearest command is taken "
            "as held"
        )
    for name, times in (("t", run.t), ("t_seen", run.t_seen)):
        step = np.diff(times)
        if name == "t_seen" and run.gravity is not None and run.gravity.ndim == 2:
            # ignore frames during which a person turns the robot
            lie = np.asarray(run.gravity)[
                np.clip(np.searchsorted(run.t, run.t_seen), 0, len(run.t) - 1)
            ]
            step = np.where((lie[1:] == lie[:-1]).all(axis=1), step, 0.0)
        if len(step) > 2 and step.max() > 10 * np.median(step):
            row = int(np.argmax(step))
            notes.append(
                f"{name} has a gap of {step.max():.3g} s after row {row} (usual step "
                f"{np.median(step):.3g} s)"
            )
    if run.visible is not None and run.visible.size and run.visible.mean() < 0.5:
        notes.append(f"only {100 * run.visible.mean():.0f} % of the points are visible")
    notes += roll_overs_of(run)
    notes += [f"0 channels: {NO_COMMANDS}"] if run.channels == 0 else []
    small = _too_small(run)
    notes += [] if small is None else [small]
    away = _far_away(run)
    if away is not None:
        notes.append(away)
    if run.command_unit != "mm" and run.output is None:
        notes.append(
            f"commands are in {run.command_unit}: every figure about the drive carries that unit"
        )
    return notes


def _too_small(run: Run) -> str | None:
    """Say so where the body is smaller than the pull of its tendons."""
    seen = run.places
    if seen is None or run.command is None or run.output is not None or run.command_unit != "mm":
        return None
    places = np.where(known(run, seen)[..., None], seen, np.nan)
    found = overlong_stroke(places, run.command)
    return None if found is None else f"{found}; give both in mm (`unit` in the mapping)"


def _far_away(run: Run) -> str | None:
    """Say so where no point comes near the origin, which is the middle of the robot's base."""
    seen = run.places
    if seen is None or seen.shape[1] < 2 or run.output is not None or run.frame is not None:
        return None
    flat = seen[:: max(1, len(seen) // 100)].reshape(-1, 3)
    flat = flat[np.isfinite(flat).all(axis=1)]
    if len(flat) < 2:
        return None
    nearest, extent = float(np.linalg.norm(flat, axis=1).min()), float(np.ptp(flat, axis=0).max())
    if nearest <= FAR * extent:
        return None
    return (
        f"the points come no nearer to the origin than {nearest:.0f} mm: if they are in the frame "
        "of the camera, `softmap run align` brings them to the base"
    )
