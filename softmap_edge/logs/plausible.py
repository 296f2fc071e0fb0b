"""Report numbers that do not fit the mapping's declarations: units, or base frame.

Each doubt is one line with the suspicion and the remedy in the mapping. Limits are wide: a robot of
3 mm to 3 m, 0.2 to 300 mm of tendon, half a turn to four turns of a motor. A tendon's pull is
shorter than its body, so centimetres read as millimetres are detected for commands in mm. A scale
of 2 is not detected. The robot's rest axis is z of the base frame by definition, so markers along
another axis at rest indicate a y-up log or swapped axes. Pinned by
tests/logs/test_import_doubts.py and tests/logs/test_import_lengths.py.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.atomic import Document
from softmap_edge.logs.fills import unread_ticks
from softmap_edge.logs.mapping import ANGLE, LENGTH, Mapping, Quantity
from softmap_edge.logs.never_seen import moving
from softmap_edge.run.rest_command import rest_command

Array = NDArray[np.float64]
ROBOT = (3.0, 3000.0)  # mm: extent of all markers
TENDON = (0.2, 300.0)  # mm: largest command
_USUAL = {"robot": (20.0, 2000.0), "tendon": (0.5, 150.0)}  # mm: plausible for a proposed unit
# rad: degrees are rarely below the first, radians rarely beyond the second
HALF_TURN, TURNS = 3.2, 25.0
# of the body's length, from slack to the other end: no tendon is pulled farther
STROKE = 1.2
METRES = 3.0  # mm: apparent distance of a clamp that is given in m
_HOME = 0.1  # of the largest command: below it the robot counts as at rest
# rows of a frozen reading, and of the range of a command meanwhile
_STILL_ROWS, _CROSSED = 20, 0.5
_SAMPLE = 20_000  # frames examined
_LETTERS = "xyz"
_CLAMP = "base|clamp|mount|ground|frame"
_BASE = re.compile(_CLAMP, re.IGNORECASE)
_WORD, _MARK = r"(?<![^\W\d_])", r"[\s_.-]*"
_IN = re.compile(  # the frame of a place: `tip_in_cam`, `base_wrt_world_frame`
    rf"{_WORD}(?:in|wrt){_MARK}(?:the{_MARK})?(?P<frame>[^\W\d_]{{2,}})(?:{_MARK}frame)?",
    re.IGNORECASE,
)
_RELATIVE = re.compile(
    rf"{_WORD}(?:minus|wrt|in|rel|relative|rel(?:ative)?_?to|from|about|-){_MARK}(?:the{_MARK})?"
    rf"(?:base|clamp|mount|ground)|{_WORD}(?:rel|relative)(?![^\W\d_])",
    re.IGNORECASE,
)


def doubts_of_time(t: Array) -> list[str]:
    """Report times t (T,) s that seem to have another unit."""
    largest = float(np.abs(t).max()) if len(t) else 0.0
    for limit, unit in ((1e17, "ns"), (1e14, "us"), (1e11, "ms")):
        if largest > limit:
            return [
                f't: up to {largest:.4g} s looks like {unit} since 1970: set time.unit = "{unit}"'
            ]
    if len(t) < 20:
        return []
    step = float(np.median(np.diff(t)))
    if step >= 5.0:
        return [
            f't: rows are {step:.4g} s apart, which looks like ms: set time.unit = "ms" unless a '
            "pose took so long"
        ]
    if step < 2e-5:
        return [
            f"t: rows are {step:.3g} s apart, faster than any robot is logged: set time.unit = "
            '"s" or another'
        ]
    return []


def doubts_of_rows(name: str, raw: Array, quantity: Quantity) -> list[str]:
    """Report raw values (T, C) that seem to have another unit than the declared one."""
    finite = np.abs(raw[np.isfinite(raw)])
    peak = float(finite.max()) if finite.size else 0.0
    if peak == 0.0:
        return []
    unit, guess = quantity.unit, None
    if unit in LENGTH:
        scale = float(np.abs(quantity.scale).max())
        if not TENDON[0] <= peak * LENGTH[unit] * scale <= TENDON[1]:
            guess = _length(peak * scale, "tendon") or "an angle or ticks"
    elif unit == "deg" and peak < HALF_TURN:
        guess = "rad"
    elif unit == "rad" and peak > TURNS:
        guess = "deg"
    elif name == "temperature":
        middle = float(np.median(finite))
        if unit == "degC" and middle > 150:
            guess = "K"
        elif unit == "K" and middle < 150:
            guess = "degC"
    elif name == "current":
        if unit == "mA" and peak < 10:
            guess = "A"
        elif unit == "A" and peak > 100:
            guess = "mA"
    elif name == "load" and unit == "g" and peak < 0.5:
        guess = "kg"
    elif unit in ANGLE and quantity.spool_radius_mm < METRES / 10:
        guess = _spool_in_metres(peak * (np.pi / 180.0 if unit == "deg" else 1.0), quantity)
        return [] if guess is None else [f"{name}: {guess}"]
    if guess is None or guess == unit:
        return []
    remedy = f'set unit = "{guess}" if so' if " " not in guess else "name their unit"
    return [f'{name}: at most {peak:.4g} with unit = "{unit}" looks like {guess}: {remedy}']


def doubts_of_unread(name: str, raw: Array, quantity: Quantity) -> list[str]:
    """Report ticks (T, C) that look like those of a servo that did not answer."""
    unread = unread_ticks(raw) if quantity.unit == "ticks" else np.zeros((0, 0), bool)
    doubts = []
    for c in np.flatnonzero(unread.any(axis=0)):
        others = raw[~unread[:, c] & np.isfinite(raw[:, c]), c]
        doubts.append(
            f"{name}: column {c + 1} is exactly {raw[unread[:, c], c][0]:g} in "
            f"{int(unread[:, c].sum())} of {len(raw)} rows, and {others.min():g} to "
            f"{others.max():g} ticks in the others: a servo that did not answer looks like this; "
            "if so, leave these cells empty"
        )
    return doubts


def _spool_in_metres(turned: float, quantity: Quantity) -> str | None:
    """Return the suspicion that a spool radius is given in m; None if 1 mm would be implausible.

    Args:
        turned: largest rotation of the spool, rad.
        quantity: the angle of the spool.
    """
    radius, pulled = quantity.spool_radius_mm, turned * quantity.spool_radius_mm
    largest = float(np.abs(quantity.scale).max()) * 1000.0 * pulled
    if not _USUAL["tendon"][0] <= largest <= TENDON[1]:
        return None
    return (
        f"spool_radius_mm = {radius:g} makes {turned:.3g} rad to {pulled:.3g} mm of tendon, which "
        f"looks like a radius in m: set spool_radius_mm = {1000 * radius:g}"
    )


def doubts_of_both(fields: Document) -> list[str]:
    """Report commands and encoders in two units: ranges 57.3 or 1000 times apart."""
    command, present = fields.get("command"), fields.get("present")
    if command is None or present is None or command.shape[1] != present.shape[1]:
        return []
    moved = command.std(axis=0)
    if not (moved > 0).any():
        return []
    ratio = float(np.median(present.std(axis=0)[moved > 0] / moved[moved > 0]))
    for factor, what in ((180.0 / np.pi, "deg and rad"), (1000.0, "mm and m")):
        for times in (factor, 1.0 / factor):
            if abs(ratio / times - 1.0) < 0.25:
                return [
                    f"present: moves {ratio:.3g} times as far as command, which looks like "
                    f"{what}: set unit of each"
                ]
    return []


def doubts_of_frozen(t: Array, fields: Document) -> list[str]:
    """Report drive readings that repeat exactly while a command crosses much of its range.

    Args:
        t: times of the rows, (T,) s.
        fields: the fields of the run, with one entry per row.
    """
    given = next(
        (np.asarray(fields[name], float) for name in ("command", "ticks") if name in fields), None
    )
    doubts: list[str] = []
    for name in ("present", "present_ticks", "current") if given is not None and given.size else ():
        rows = np.asarray(fields.get(name, np.zeros((0, 0))), float)
        for c in range(rows.shape[1]):
            assert given is not None
            own = (
                given[:, c : c + 1]
                if rows.shape[1] == given.shape[1] and name != "current"
                else given
            )
            found = _frozen(rows[:, c], own) if len(np.unique(rows[:, c])) > 1 else None
            if found is not None:
                first, end = found
                doubts.append(
                    f"{name}: column {c + 1} repeats to the last digit in rows {first} to "
                    f"{end - 1} ({t[first]:.6g} to {t[end - 1]:.6g} s) while a command crosses "
                    f"{100 * _CROSSED:.0f} % of its range or more: the reading was lost, or the "
                    "servo is blocked; cut the log there with from_row and to_row"
                )
    return doubts


def _frozen(column: Array, commands: Array) -> tuple[int, int] | None:
    """Return the longest stretch in which a column (T,) is frozen although it should move.

    It is (first row, row after the last).
    """
    edges = np.flatnonzero(np.r_[True, np.diff(column) != 0, True])
    span = np.ptp(commands, axis=0)
    k = int(np.argmax(np.diff(edges)))
    first, end = int(edges[k]), int(edges[k + 1])
    if end - first < _STILL_ROWS or not span.any():
        return None
    moved = np.ptp(commands[first:end], axis=0)
    return (first, end) if (moved >= _CROSSED * np.maximum(span, 1e-12)).any() else None


def doubts_of_points(points: Array, unit: str, name: str = "markers") -> list[str]:
    """Report points (K, M, 3) of key `name`, in mm from `unit`, that do not fit a robot's size."""
    sample = points[:: max(1, len(points) // _SAMPLE)].reshape(-1, 3)
    sample = sample[np.isfinite(sample).all(axis=1)]
    if len(sample) < 2:
        return []
    span = float(np.ptp(sample, axis=0).max())
    if points.shape[1] == 1 or name == "base":  # a single marker, and a base, may be at rest
        span = max(span, float(np.abs(sample).max()))
    if ROBOT[0] <= span <= ROBOT[1] or span == 0.0:
        return []
    guess = _length(span / LENGTH[unit], "robot")
    if guess is None or guess == unit:
        return [
            f'{name}: span {span:.4g} mm with unit = "{unit}", no size of a robot: check columns, '
            "unit and scale"
        ]
    return [
        f'{name}: span {span:.4g} mm with unit = "{unit}", which looks like {guess}: set unit = '
        f'"{guess}"'
    ]


def overlong_stroke(points: Array, command: Array) -> str | None:
    """Return the suspicion that a body is smaller than the pull of its tendons; else None.

    Args:
        points: (K, M, 3) mm in the base frame; NaN where nothing was seen.
        command: (T, C) mm of tendon.
    """
    sample = points[:: max(1, len(points) // _SAMPLE)].reshape(-1, 3)
    sample = sample[np.isfinite(sample).all(axis=1)]
    pulled = command[np.isfinite(command).all(axis=1)]
    if len(sample) < 2 or not pulled.size:
        return None
    stroke = float(np.ptp(pulled, axis=0).max())
    body = max(float(np.ptp(sample, axis=0).max()), float(np.linalg.norm(sample, axis=1).max()))
    if not 0.0 < STROKE * body < stroke:
        return None
    return (
        f"the robot measures {body:.3g} mm, less than the {stroke:.3g} mm over which its tendons "
        "are pulled: the places look like cm, or the commands are in another unit than mm"
    )


def doubts_of_base(t: Array, t_seen: Array, fields: Document, mapping: Mapping) -> list[str]:
    """Return doubts about the unit of places, the origin of the base frame, and the frame.

    Args:
        t: times of the commands, (T,) s.
        t_seen: times of the frames, (K,) s.
        fields: the fields of the run.
        mapping: as declared.
    """
    markers, command, base = fields["markers"], fields.get("command"), fields.get("base_markers")
    small = None
    if command is not None and mapping.command_unit == "mm":
        small = overlong_stroke(markers, command)
    start = at_rest(t, t_seen, command, markers) if base is None else _middle(base)
    metres = _origin_in_metres(start, mapping)
    return [
        *([] if small is None else [f'markers: {small}; set unit = "cm" if so']),
        *(doubts_of_rest(t, t_seen, fields, mapping) if metres is None else [metres]),
    ]


def _origin_in_metres(rest: Array, mapping: Mapping) -> str | None:
    """Return the suspicion that the origin is given in m: times 1000 it lies at the robot.

    Args:
        rest: (M, 3) mm, rest positions of the robot or its clamp, in the declared base frame.
        mapping: as declared.
    """
    origin = np.asarray(mapping.origin_mm, float)
    rest = rest[np.isfinite(rest).all(axis=1)]
    if not 0.0 < np.abs(origin).max() < METRES or not len(rest):
        return None
    moved = rest - mapping.to_base(1000.0 * origin)
    near, nearer = (float(np.linalg.norm(one, axis=1).min()) for one in (rest, moved))
    size = float(np.linalg.norm(np.ptp(moved, axis=0)))
    # a robot hangs or stands on one side of its clamp, so most of it lies along +z
    beside = float(moved[:, 2].min()) < -0.1 * max(size, nearer)
    if nearer >= near or beside:
        return None
    given = ", ".join(f"{x:g}" for x in origin)
    better = ", ".join(f"{1000.0 * x:g}" for x in origin)
    return (
        f"frame: origin_mm = [{given}] leaves {near:.4g} mm to the nearest place of the robot, and "
        f"1000 times as much leaves {nearer:.4g} mm, which looks like metres: set origin_mm = "
        f"[{better}]"
    )


def _length(number: float, what: str) -> str | None:
    low, high = _USUAL[what]
    return next(
        (unit for unit in ("mm", "m", "um", "cm") if low <= number * LENGTH[unit] <= high), None
    )


# --- the frame -----------------------------------------------------------------------------
def doubts_of_rest(t: Array, t_seen: Array, fields: Document, mapping: Mapping) -> list[str]:
    """Say whether the markers at rest run along z of the base frame, and begin near its origin."""
    rest = at_rest(t, t_seen, fields.get("command"), moving(fields["markers"]))
    rest = rest[np.isfinite(rest).all(axis=1)]
    base = fields.get("base_markers")
    start = None if base is None else _middle(base).mean(axis=0)
    along = rest_axis(rest, start)
    if along is None:
        return []
    if start is None and _plate_on_axis(rest, mapping):
        along = np.array([0.0, 0.0, 1.0])
    doubts = []
    k = int(np.argmax(np.abs(along)))
    if along[2] < 0.5:
        log_axis, sign = mapping.axes[k]
        towards = ("-" if along[k] < 0 else "") + _LETTERS[k]
        axes = ", ".join(
            f'"{axis}"' for axis in axes_for(log_axis, sign * (-1 if along[k] < 0 else 1))
        )
        doubts.append(
            f"markers: at rest they run along {towards} of the base frame, but the robot's axis "
            "is z by definition, which looks like a y-up log or swapped axes: set frame.axes = "
            f"[{axes}]"
        )
    length = float(np.linalg.norm(rest[-1] - rest[0]))
    far = float(np.linalg.norm(rest[0]))
    if len(rest) > 1 and start is None and far > 5 * length:
        doubts.append(
            f"markers: the first is {far:.4g} mm from the origin of the base frame and only "
            f"{length:.4g} mm from the last: set frame.origin_mm to the place of the clamp"
        )
    return doubts


def _plate_on_axis(rest: Array, mapping: Mapping) -> bool:
    """Return whether markers (M, 3) form a plate at the tip.

    They are close together on the z axis of a clamp with a given position.
    """
    rest = rest[np.isfinite(rest).all(axis=1)]
    middle = rest.mean(axis=0)
    away = float(np.linalg.norm(middle))
    given = bool(np.any(np.asarray(mapping.origin_mm) != 0))
    return given and away > float(np.ptp(rest, axis=0).max()) and middle[2] > 0.9 * away


def is_base(label: str) -> bool:
    """Return whether a marker's name places it on the clamp, not on the robot.

    `tip_minus_base` and `tip_in_base` are places of the tip.
    """
    return bool(_BASE.search(_IN.sub("", label))) and not is_relative(label)


def is_relative(label: str) -> bool:
    """Return whether a marker's name states that its place is relative to the base."""
    return bool(_RELATIVE.search(label))


def frame_of(label: str) -> str | None:
    """Return the frame that a marker's name states: `cam` of `tip_in_cam`; None without one."""
    found = _IN.search(label)
    return found["frame"].lower() if found else None


def at_rest(t: Array, t_seen: Array, command: Array | None, markers: Array) -> Array:
    """Return the median positions (M, 3) of the markers in the frames nearest to home."""
    if command is None or command.size == 0 or not np.abs(command).max():
        return _middle(markers)
    size = np.abs(command - rest_command(command)).max(axis=1)
    near = np.interp(t_seen, t, size)
    chosen = near <= max(_HOME * float(size.max()), float(np.quantile(near, 0.02)))
    return _middle(markers[chosen])


def _middle(points: Array) -> Array:
    """Return the median (M, 3) over the frames in which each point was seen."""
    points = points[:: max(1, len(points) // _SAMPLE)]
    middle = np.full(points.shape[1:], np.nan)
    for m in range(points.shape[1]):
        shown = points[np.isfinite(points[:, m]).all(axis=1), m]
        if len(shown):
            middle[m] = np.median(shown, axis=0)
    return middle


def rest_axis(rest: Array, base: Array | None) -> Array | None:
    """Return the unit vector (3,) of a robot's axis at rest; None if unknown.

    It follows from markers (M, 3) listed base first. It runs from the base (3,), if known, to the
    centre of the markers; else from the first to the last of an elongated set; else from the origin
    to a single marker.
    """
    rest = rest[np.isfinite(rest).all(axis=1)]
    if len(rest) == 0:
        return None
    if base is not None:
        along = rest.mean(axis=0) - base
    elif len(rest) == 1:
        along = rest[0]
    else:
        spread = np.linalg.svd(rest - rest.mean(axis=0), compute_uv=False)
        if spread[0] ** 2 < 0.7 * (spread**2).sum():
            return None
        along = rest[-1] - rest[0]
    length = float(np.linalg.norm(along))
    return along / length if np.isfinite(length) and length > 0 else None


def axes_for(axis: int, sign: int) -> list[str]:
    """Return right-handed `frame.axes` with the robot's z along `sign` times log axis `axis`."""
    z, x = np.zeros(3), np.zeros(3)
    z[axis] = sign
    x[0 if axis else 1] = 1.0
    y = np.cross(z, x)
    named = []
    for vector in (x, y, z):
        k = int(np.argmax(np.abs(vector)))
        named.append(("-" if vector[k] < 0 else "") + _LETTERS[k])
    return named
