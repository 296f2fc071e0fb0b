"""Summarise the contents and gaps of a run as a dictionary, for `softmap check`.

Dwells are those of `conditions`. A place is visited again when every channel is within 2 % of its
range. Servo resolution is 10 times finer, so repeated commands always match and neighbours on a
usual grid never do.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.clouds import with_depth
from softmap_edge.checks.advice import Advice, advice, home_unknown
from softmap_edge.checks.advice_text import advice_lines
from softmap_edge.checks.collinear import collinear_conditions
from softmap_edge.checks.frame_clock import frame_clock
from softmap_edge.checks.lost_points import REMEDY, without_lost
from softmap_edge.checks.unanswered import unanswered
from softmap_edge.checks.unseen_markers import FAR, unseen_parts
from softmap_edge.files.atomic import Document
from softmap_edge.files.numbers import folded
from softmap_edge.files.printable import listed, one_line, plain_line
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
MANY = 20  # unknown fields that are named
SAME_PLACE = 0.02  # of a channel's range


def summary(recorded: Run, model: Model | None = None) -> Document:
    """Return the contents of a run, with units in the keys.

    - `missing`, `warnings`: sentences.
    - `collinear`: conditions that cannot be separated from time or the commands
      (`collinear.Collinear`, `text`).
    - `home_known`: whether 0 can be home (`advice.home_unknown`).
    - `not_seen`: sentences on points that stand for "not seen"; these count as not visible, and the
      run is not sound.
    - `unseen_parts`: sentences on what was never or hardly seen (`unseen_markers.unseen_parts`);
      these are also `warnings`, and the run is not sound.
    - `unanswered`: a sentence if commands and motion contradict each other, else None; such a run
      is not sound.
    - `can_tell`, `cannot_tell`: lists of `advice.Advice`, `{about, tells, text, remedy, minutes}`.
    - `frame_clock`: a `frame_clock.FrameClock` as a dictionary, or None.

    Args:
        recorded: any run.
        model: its calibration, if any, converts the ticks of the run to commands.

    Raises:
        CalibrationError: the calibration belongs to other servos.
    """
    run, lost = without_lost(converted(model, recorded), REMEDY)
    run, depthless = (run, "") if run.points is None else with_depth(run)
    seen = None if run.seen is None else run.array(run.seen)
    document: Document = {
        "robot": run.robot,
        "channels": run.channels,
        "rows": len(run.t),
        "duration_s": rounded(run.t[-1] - run.t[0]),
        "rate_hz": _rate(run.t),
        "calibrated": recorded.ticks is not None and run.ticks is None,
        "command_unit": "ticks" if run.ticks is not None else run.command_unit,
        "command_range": command_ranges(run),
        "frames": run.frames,
        "frame_rate_hz": _rate(run.t_seen),
        "seen": run.seen,
        "points_mm": None if run.output is not None else _extent(_shown(run, seen)),
        "output": _outputs(run),
        "timeless": run.timeless,
        "base_markers": int(run.extra[BASE_MARKERS].shape[1]) if _has_base(run) else 0,
        "points_per_frame": None if seen is None or seen.ndim != 3 else int(seen.shape[1]),
        "visible_share": 1.0
        if run.visible is None or not run.visible.size
        else rounded(run.visible.mean()),
        "encoders": run.present is not None or run.present_ticks is not None,
        "gravity": _gravity(run),
        "load_g": None if run.load is None else [rounded(run.load.min()), rounded(run.load.max())],
        "temperature_c": None
        if run.temperature is None
        else [rounded(run.temperature.min()), rounded(run.temperature.max())],
        "blocks": []
        if run.block is None
        else [str(label) for label in dict.fromkeys(run.block.tolist())],
        **_visits(run),
        "unknown_fields": sorted(set(run.extra) - OURS),
        "roll_seen": not laid(run),
        "not_seen": lost,
        "unseen_parts": unseen_parts(run),
        "unanswered": unanswered(run),
        "hash": recorded.hash(),
    }
    document["missing"] = _missing(run, document)
    document["collinear"] = [asdict(one) | {"text": str(one)} for one in collinear_conditions(run)]
    words = advice(run, document["home_visits"])
    document["home_known"] = home_unknown(run) is None
    document["can_tell"] = [word.to_dict() for word in words if word.tells]
    document["cannot_tell"] = [word.to_dict() for word in words if not word.tells]
    clock = frame_clock(run)
    document["frame_clock"] = None if clock is None else clock.to_dict()
    drift = str(clock) if clock is not None and clock.differs else ""
    document["warnings"] = [
        *_damage(run),
        *filter(None, [depthless]),
        *document["unseen_parts"],
        *_warnings(run),
        *filter(None, [drift]),
    ]
    return document


def sentences(document: Document) -> list[str]:
    """Return a summary as plain sentences, one a line."""
    d = document
    unit = d["command_unit"]
    lines = [f"robot     {d['robot'] or 'not named'}"]
    rate = "" if d["rate_hz"] is None else f" at {d['rate_hz']:g} Hz"
    over = ", no time recorded" if d.get("timeless") else f" over {d['duration_s']:g} s{rate}"
    lines.append(f"commands  {d['channels']} channels, {d['rows']} rows{over}")
    if d["calibrated"]:
        lines.append("          ticks, as commands by the calibration of the bundle")
    for c, (low, high) in enumerate(d["command_range"]):
        lines.append(f"          channel {c}: {low:g} to {high:g} {unit}")
    rate = "" if d["frame_rate_hz"] is None else f" at {d['frame_rate_hz']:g} Hz"
    each = "" if d["points_per_frame"] is None else f" of {d['points_per_frame']} {d['seen']}"
    part = "" if d["visible_share"] == 1.0 else f", {100 * d['visible_share']:.1f} % visible"
    roll = "" if d["roll_seen"] else ", roll not measured"
    if (output := d.get("output")) is not None:
        each = f" of {len(output['names'])} output{'s' * (len(output['names']) != 1)}"
    rate = "" if d.get("timeless") else rate
    lines.append(f"seen      {d['frames']} frames{each}{rate}{part}{roll}")
    if output is not None:
        spans = zip(output["names"], output["range"])
        lines += [
            f"          {name}: {low:.4g} to {high:.4g} {output['unit']}"
            for name, (low, high) in spans
        ]
    if d["points_mm"]:
        ranges = ", ".join(
            f"{axis} {low:.4g} to {high:.4g}" for axis, (low, high) in zip("xyz", d["points_mm"])
        )
        lines.append(f"          {ranges} mm in the base frame")
    if d["base_markers"]:
        lines.append(
            f"          and {d['base_markers']} markers on the base (`softmap run align --base b0 "
            "b1 …`)"
        )
    visits = d["home_visits"] if d.get("home_known", True) else "not known"
    lines.append(
        f"repeats   visits of home: {visits}, other places visited again: {d['places_revisited']}"
    )
    declared = [f"gravity {d['gravity']}"] if d["gravity"] else []
    declared += [f"{name} {_span(d[key])} {u}" for name, key, u in _DECLARED if d[key] is not None]
    declared += ["encoder positions"] if d["encoders"] else []
    lines.append(f"declared  {', '.join(declared) or 'nothing'}")
    if d["blocks"]:
        lines.append(
            f"blocks    {len(d['blocks'])}: "
            f"{listed(d['blocks'][:8], 8)}{' …' * (len(d['blocks']) > 8)}"
        )
    if d["unknown_fields"]:
        kept = listed(d["unknown_fields"], MANY)
        lines.append(f"kept      {kept} (not known here, ignored)")
    lines += [line for text in d.get("not_seen", []) for line in _hung("look at", text)]
    lines += [line for text in d["missing"] for line in _hung("missing", text)]
    lines += [line for text in d["warnings"] for line in _hung("look at", text)]
    lines += [line for one in d["collinear"] for line in _hung("alike", one["text"])]
    known_to = [] if d.get("unanswered") else d["can_tell"]  # such a run shows nothing of its drive
    lines += advice_lines([Advice(**word) for word in [*known_to, *d["cannot_tell"]]])
    return [one_line(line) for line in lines]  # names of fields and blocks are of the file


def _hung(name: str, text: str) -> list[str]:
    return folded(f"{name:<10}{plain_line(text)}", 0, 10)


_DECLARED = (("load", "load_g", "g"), ("temperature", "temperature_c", "°C"))


def _span(pair: list[float]) -> str:
    return f"{pair[0]:g}" if pair[0] == pair[1] else f"{pair[0]:g} to {pair[1]:g}"


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


def _outputs(run: Run) -> Document | None:
    """Return the outputs of a run and their ranges, in their unit."""
    if run.output is None:
        return None
    rows = run.outputs
    ranges = [
        [rounded(np.nanmin(c)), rounded(np.nanmax(c))] if np.isfinite(c).any() else [0.0, 0.0]
        for c in rows.T
    ]
    return {"names": list(run.output.names), "unit": run.output.unit, "range": ranges}


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


def _visits(run: Run) -> dict[str, int]:
    """Return the number of rests at home, and of other places visited again."""
    none = {"home_visits": 0, "places_revisited": 0}
    given = run.command if run.command is not None else run.ticks
    if given is None or run.channels == 0 or run.frames == 0 or len(run.t) < 2:
        return none
    rows = given.astype(np.float64)
    span = np.ptp(rows, axis=0)
    if not (span > 0).any():
        return none
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
    return {"home_visits": int(home), "places_revisited": int((counts > 1).sum())}


def _missing(run: Run, document: Document) -> list[str]:
    gaps = []
    if run.frames and document["seen"] is None:
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
