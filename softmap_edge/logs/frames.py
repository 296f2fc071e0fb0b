"""Convert the markers of a log to the frames of a run.

This handles base frame, dropouts, repeated frames, swaps, labels and rates.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError, differing_times
from softmap_edge.files.atomic import Document
from softmap_edge.files.printable import listed
from softmap_edge.logs.coverage import unseen_spans
from softmap_edge.logs.held import LONGEST_HOLD, repeated_frames
from softmap_edge.logs.likelihood import lines_of, unlikely
from softmap_edge.logs.mapping import FILE, LENGTH, PIXEL, Log, Mapping, Quantity
from softmap_edge.logs.measured import Column, Measured
from softmap_edge.logs.mixed_units import places_question
from softmap_edge.logs.never_seen import at_one_number, never_moving, never_seen
from softmap_edge.logs.not_seen import declared, not_seen
from softmap_edge.logs.other_units import doubts_of_units
from softmap_edge.logs.plausible import doubts_of_points, is_relative
from softmap_edge.logs.shifted import find_shifted
from softmap_edge.logs.swaps import find_swaps, mend_swaps
from softmap_edge.logs.table import LogTable, place
from softmap_edge.run.output import output_of
from softmap_edge.run.plane import AXES, PLANE

Array = NDArray[np.float64]
_LISTED = 5  # swaps, and unseen markers, that are listed
_SLOW = 25.0  # % of frames that repeat: the camera is slower than the log
_RELATIVE = (
    "Places relative to the base (tip minus base), or a typed one, look like this: then a base "
    "that moves is not seen, and `mount` and `camera_drift` cannot be tested by it"
)
_OF_FRAMES = ("markers", "visible", "block", "base_markers")


def seen(
    tables: list[LogTable],
    mapping: Mapping,
    t: Array | None,
    fields: Document,
    notes: list[str],
    doubts: list[str],
) -> Array | None:
    """Return the frame times; add markers in the base frame, visibility and labels to `fields`.

    Args:
        tables: the logs.
        mapping: the meaning of their columns.
        t: (T,) s, times of the commands in `fields`; None without commands.
        fields: the fields of the run so far.
        notes: receives changes that were made.
        doubts: receives suspicious findings.

    Raises:
        RunError: several logs hold markers, no frame shows one, or their unit is impossible.
    """
    owners = [
        k for k, log in enumerate(mapping.logs) if log.markers is not None or log.output is not None
    ]
    if not owners:
        return None
    if len(owners) > 1:
        raise RunError(
            f"{mapping.path}: {len(owners)} logs hold what is seen; name the columns of one of "
            "them only"
        )
    table, log = tables[owners[0]], mapping.logs[owners[0]]
    commands = None if t is None else _commands_at(table.t, t, fields)
    if log.output is not None:
        table = _without_lost(table, log.output, log.output.names, commands, 1, notes, doubts)
        return _outputs(table, log, log.output, fields, notes, doubts)
    assert log.markers is not None
    table = _without_unlikely("markers", table, log.markers, log.markers.labels, notes)
    table = _without_unseen(table, log.markers, notes, doubts)
    table = _without_lost(
        table, log.markers, log.markers.labels, commands, log.markers.axes, notes, doubts
    )
    if log.base is not None:
        named = tuple(f"base {b}" for b in range(len(log.base.columns) // log.base.axes))
        table = _without_unlikely("base", table, log.base, named, notes)
        _note_base(table, log.base, named, doubts)
        table = _without_lost(table, log.base, named, commands, log.base.axes, notes, doubts)
    table = _without_shifts(table, log.markers, doubts)
    given = np.isfinite(table.numbers(log.markers.columns)).reshape(
        len(table.t), -1, log.markers.axes
    )
    shown = np.asarray(np.any(np.all(given, axis=2), axis=1))
    if not shown.any():
        raise RunError(f"{table.path}: no frame shows a marker; check the columns of `markers`")
    if not shown.all():
        notes.append(
            f"{int((~shown).sum())} of {len(shown)} rows show no marker and are not frames"
        )
        table = table.rows(shown)
    table = _without_repeats(table, log.markers, notes, doubts)
    points = _points(table, log.markers, doubts)
    visible = np.asarray(np.isfinite(points).all(axis=2))
    if not visible.all():
        fields["visible"] = visible
        _note_dropouts(visible, log.markers.labels, notes)
    points = _without_swaps(points, table.t, log, notes, doubts)
    if "visible" in fields:
        fields["visible"] = np.isfinite(points).all(axis=2)
    fields["markers"] = mapping.to_base(points)
    if log.markers.axes < 3:
        _flatten(fields, mapping, notes)
    fields["marker_labels"] = np.array(log.markers.labels)
    if relative := [label for label in log.markers.labels if is_relative(label)]:
        notes.append(
            f"markers: {listed(relative, _LISTED)}: relative to the base by the name, so the base "
            "is the origin of the log and its motion is not seen: `mount` and `camera_drift` "
            "cannot be tested"
        )
    if log.base is not None:
        fields["base_markers"] = mapping.to_base(_points(table, log.base, doubts, "base"))
        if PLANE in fields:
            fields["base_markers"][..., AXES.index(str(fields[PLANE]))] = 0.0
    if log.block is not None:
        fields["block"] = table.texts()
    return table.t


def _commands_at(t_seen: Array, t: Array, fields: Document) -> Array | None:
    """Return the commands or ticks (K, C) at the times of the frames; None without."""
    rows = next(
        (np.asarray(fields[name], float) for name in ("command", "ticks") if name in fields), None
    )
    if rows is None or not rows.shape[1] or len(rows) != len(t):
        return None
    return np.stack([np.interp(t_seen, t, column) for column in rows.T], axis=1)


def _without_lost(
    table: LogTable,
    quantity: Quantity | Measured,
    labels: tuple[str, ...],
    commands: Array | None,
    axes: int,
    notes: list[str],
    doubts: list[str],
) -> LogTable:
    """Return the table with NaN at positions that stand for "not seen", and report them."""
    if quantity.not_seen is None:
        return table
    points = table.numbers(quantity.columns).reshape(len(table.t), -1, axes)
    given = declared(points, quantity.not_seen)
    points[given.mask] = np.nan
    lost = not_seen(points, commands)
    points[lost.mask] = np.nan
    what = "markers" if axes > 1 else "output"
    notes += given.lines(labels, f"{what}.not_seen names them")
    doubts += lost.lines(labels, f'{what}.not_seen = "keep" keeps them')
    return (
        table
        if not (given.mask | lost.mask).any()
        else _with_numbers(table, quantity.columns, points)
    )


def _without_unlikely(
    name: str, table: LogTable, quantity: Quantity, labels: tuple[str, ...], notes: list[str]
) -> LogTable:
    """Return the table with NaN for places of a low likelihood, and count them."""
    if not quantity.likelihood:
        return table
    gone = unlikely(table, quantity)
    notes += lines_of(name, table, quantity, labels, gone)
    points = table.numbers(quantity.columns).reshape(*gone.shape, quantity.axes)
    points[gone] = np.nan
    return _with_numbers(table, quantity.columns, points)


def _without_unseen(
    table: LogTable, markers: Quantity, notes: list[str], doubts: list[str]
) -> LogTable:
    """Return the table with NaN for markers at 0, 0, 0 or another such place in every row.

    They are reported; `not_seen = "keep"` keeps them.
    """
    points = table.numbers(markers.columns).reshape(len(table.t), -1, markers.axes)
    unseen = never_seen(points)
    if not len(unseen):
        return table
    places = at_one_number(points, unseen.tolist(), markers.labels)
    if markers.not_seen is None:
        notes += [f"markers: {each}: kept as asked" for each in places]
        return table
    if len(unseen) == points.shape[1]:
        raise RunError(
            f"{table.path}: markers: {places[0]}, so no marker was ever seen; check the columns of "
            '`markers`, or set markers.not_seen = "keep" if this is a place'
        )
    doubts += [
        f"markers: {each}: never seen, or the origin of the log; taken as not seen. Leave "
        'the columns out, or set markers.not_seen = "keep" if the marker is there'
        for each in places
    ]
    points[:, unseen] = np.nan
    return _with_numbers(table, markers.columns, points)


def _note_base(table: LogTable, base: Quantity, labels: tuple[str, ...], doubts: list[str]) -> None:
    """Report markers of the base at one place to the last digit in every row; they are kept."""
    if base.not_seen is None:
        return
    points = table.numbers(base.columns).reshape(len(table.t), -1, base.axes)
    zero = never_seen(points)
    doubts += [
        f"base: {each}: kept as the origin of the log. {_RELATIVE}. If it was never seen, leave "
        'the columns out; base.not_seen = "keep" if it is there'
        for each in at_one_number(points, zero.tolist(), labels)
    ]
    still = [m for m in never_moving(points) if m not in zero]
    if still:
        named = listed((labels[m] for m in still), _LISTED)
        doubts.append(
            f"base: {named} at one place to the last digit in all {len(points)} frames, so it was "
            f'not measured in each of them. {_RELATIVE}; base.not_seen = "keep" if the base '
            "cannot move"
        )


def _without_shifts(table: LogTable, markers: Quantity, doubts: list[str]) -> LogTable:
    """Return the table without positions of wrong markers.

    Columns that show another marker become NaN, or the positions move to their own columns.
    """
    if markers.not_seen is None:
        return table
    points = table.numbers(markers.columns).reshape(len(table.t), -1, markers.axes)
    found = find_shifted(points)
    if found is None:
        return table
    if markers.swaps == "mend":
        doubts += found.lines(markers.labels, "mended: each place is in the column of its marker")
        return _with_numbers(table, markers.columns, found.mended(points))
    points[found.wrong] = np.nan
    remedy = (
        "they are taken as not seen; "
        'markers.swaps = "mend" puts them into the columns of their markers'
    )
    doubts += found.lines(markers.labels, remedy)
    return _with_numbers(table, markers.columns, points)


def _without_swaps(points: Array, t: Array, log: Log, notes: list[str], doubts: list[str]) -> Array:
    """Return points (K, M, 3) with marker swaps corrected, or only reported, as in the mapping."""
    markers = log.markers
    assert markers is not None
    swaps = find_swaps(points, t, markers.labels)
    swaps = [replace(swap, t=None) for swap in swaps] if log.clock.timeless else swaps
    if swaps and markers.swaps == "mend":
        notes += _few([f"{swap}: mended" for swap in swaps])
        mended, first = mend_swaps(points, swaps)
        if not first:
            notes.append(
                "the log begins with exchanged markers; the names of most of its frames count"
            )
        return mended
    remedy = 'look at them; markers.swaps = "mend" exchanges them back'
    doubts += _few([f"{swap}; {remedy}" for swap in swaps])
    return points


def _flatten(fields: Document, mapping: Mapping, notes: list[str]) -> None:
    """Set the coordinate across the plane of the markers to 0, and keep its axis in the run."""
    axis = [k for k, _ in mapping.axes].index(2)
    fields["markers"][..., axis] = 0.0
    fields[PLANE] = np.array(AXES[axis])
    notes.append(
        f"markers in a plane: {AXES[axis]} of the base frame is not measured and counts as 0; "
        "nothing across the plane is examined"
    )


def _with_numbers(table: LogTable, columns: tuple[Column, ...], numbers: Array) -> LogTable:
    """Return the table with numbers (rows, ...) replaced in some columns."""
    flat = numbers.reshape(len(numbers), -1)
    places = [place(table.path, table.names, column) for column in columns]
    return replace(
        table, values={**table.values, **{at: flat[:, k] for k, at in enumerate(places)}}
    )


def _outputs(
    table: LogTable,
    log: Log,
    measured: Measured,
    fields: Document,
    notes: list[str],
    doubts: list[str],
) -> Array:
    """Return the times of rows with an output; add outputs (as markers) and labels to `fields`."""
    given = np.asarray(np.isfinite(table.numbers(measured.columns)).any(axis=1))
    if not given.any():
        raise RunError(f"{table.path}: no row has an output; check the columns of `output`")
    if not given.all():
        notes.append(
            f"{int((~given).sum())} of {len(given)} rows have no output and are not frames"
        )
        table = table.rows(given)
    doubts += doubts_of_units("output", table, measured)
    values = table.numbers(measured.columns) * measured.scale + measured.offset
    output = output_of(values, measured.unit, measured.names)
    fields["output"], fields["markers"] = output, output.markers(values)
    visible = np.asarray(np.isfinite(values))
    if not visible.all():
        fields["visible"] = visible
        _note_dropouts(visible, measured.names, notes)
    if log.block is not None:
        fields["block"] = table.texts()
    return table.t


def _few(lines: list[str]) -> list[str]:
    return [
        *lines[:_LISTED],
        *([f"and {len(lines) - _LISTED} more such swaps"] if len(lines) > _LISTED else []),
    ]


@np.errstate(invalid="ignore")  # a signalling NaN of a damaged file counts as NaN
def _points(table: LogTable, quantity: Quantity, doubts: list[str], name: str = "markers") -> Array:
    """Return points (K, M, 3) mm in the log's frame; `name` is their key in the mapping.

    Raises:
        RunError: some seem to be in another unit than the others, and the mapping has no `scale`.
    """
    units = [quantity.unit] * len(quantity.columns)
    if quantity.unit == FILE:  # of a line of units, or of the format; each marker has its own
        stated = [table.unit(column) for column in quantity.columns[:: quantity.axes]]
        usual = next((unit for unit in stated if unit in LENGTH), "mm")
        units = [unit if unit in LENGTH else usual for unit in stated for _ in range(quantity.axes)]
    unit = units[0]
    other = doubts_of_units(name, table, quantity, units)
    if unit == PIXEL and (quantity.scale == 1.0).all():
        other = [
            f"{name}: in pixels, which are not mm: a pixel counts as 1 mm, and every length of the "
            f"run is wrong by that factor; set {name}.scale to the mm of one pixel, from a length "
            "that you know in the picture"
        ]
    doubts += other
    raw = table.numbers(quantity.columns)
    raw *= [1.0 if unit == PIXEL else LENGTH[unit] for unit in units]
    raw *= quantity.scale
    raw += quantity.offset
    points = raw.reshape(len(raw), -1, quantity.axes)
    if quantity.axes < 3:  # a plane: the third coordinate is not measured
        points = np.concatenate([points, np.zeros((*points.shape[:2], 1))], axis=2)
    if not other:
        question = None if quantity.scaled else places_question(points, quantity.labels)
        if question is not None:
            raise RunError(f"{table.path}: {name}: {question}")
        doubts += doubts_of_points(points, "mm" if unit == PIXEL else unit, name)
    return points


def _without_repeats(
    table: LogTable, markers: Quantity, notes: list[str], doubts: list[str]
) -> LogTable:
    held, still = repeated_frames(table.t, table.numbers(markers.columns))
    if still.any():
        doubts.append(
            f"{int(still.sum())} frames repeat the one before bit for bit for more than "
            f"{LONGEST_HOLD:g} s: a camera that stood still, or a simulation at rest; they are "
            "kept"
        )
    if not held.any() or markers.held == "keep":
        return table
    share = 100 * held.mean()
    why = "the camera is slower than the log" if share > _SLOW else "these pictures are old"
    notes.append(
        f"{int(held.sum())} frames ({share:.0f} %) repeat the one before bit for bit and were "
        f"left out: {why} "
        '(markers.held = "keep" keeps them)'
    )
    return table.rows(~held)


def _note_dropouts(visible: NDArray[np.bool_], labels: tuple[str, ...], notes: list[str]) -> None:
    share = 1.0 - visible.mean(axis=0)
    lost = (f"{labels[m]} {100 * share[m]:.1f} %" for m in np.argsort(-share) if share[m] > 0)
    notes.append(f"not seen in some frames: {listed(lost, _LISTED)}")


def choose_frames(
    t: Array, t_seen: Array, fields: Document, mapping: Mapping, notes: list[str]
) -> Array:
    """Drop frames outside the mapping's interval, thin to its rate, cut into blocks.

    Frames outside the commands are dropped too.

    Args:
        t: times of the commands, (T,) s.
        t_seen: times of the frames, (K,) s.
        fields: the fields of the run; those with one entry per frame are thinned.
        mapping: gives interval, rate and blocks.
        notes: receives a sentence for each change.

    Returns:
        Array: the times (s) of the frames that are kept.

    Raises:
        RunError: no frame remains.
    """
    low = max(float(t[0]), mapping.from_s if mapping.from_s is not None else -np.inf)
    high = min(float(t[-1]), mapping.to_s if mapping.to_s is not None else np.inf)
    slack = max(1e-9, 4.0 * float(np.spacing(max(abs(low), abs(high)))))  # rounding of times
    keep = np.flatnonzero((t_seen >= low - slack) & (t_seen <= high + slack))
    if len(t_seen) and not len(keep):
        first, last, begin, end = differing_times(float(t_seen[0]), float(t_seen[-1]), low, high)
        raise RunError(
            f"{mapping.path}: the frames last from {first} to {last} s, but only {begin} to {end} "
            "s is commanded and asked for; give time.offset_s of one log"
        )
    if len(keep) < len(t_seen):
        notes.append(
            f"{len(t_seen) - len(keep)} of {len(t_seen)} frames lie outside "
            f"{' to '.join(differing_times(low, high))} s and were dropped"
        )
    notes += unseen_spans(t_seen[keep], low, high)
    if mapping.seen_rate_hz is not None and len(keep) > 1:
        # first frame at or after each tick of the requested rate, even if the log's clock jitters
        tick = np.floor((t_seen[keep] - t_seen[keep[0]]) * mapping.seen_rate_hz + 1e-6)
        thinned = keep[np.r_[True, np.diff(tick) > 0]]
        notes.append(f"{len(thinned)} of {len(keep)} frames kept for {mapping.seen_rate_hz:g} Hz")
        keep = thinned
    if len(keep) < len(t_seen):
        for name in _OF_FRAMES:
            if name in fields:
                fields[name] = fields[name][keep]
        t_seen = t_seen[keep]
    _blocks(t_seen, fields, mapping)
    return t_seen


def _blocks(t_seen: Array, fields: Document, mapping: Mapping) -> None:
    if "block" in fields or not len(t_seen):
        return
    since = t_seen - t_seen[0]
    if mapping.block_seconds is not None:
        fields["block"] = np.floor(since / mapping.block_seconds).astype(np.int64)
    elif mapping.block_count is not None:
        share = since / max(float(since[-1]), 1e-12)
        fields["block"] = np.minimum(
            np.floor(share * mapping.block_count), mapping.block_count - 1
        ).astype(np.int64)
