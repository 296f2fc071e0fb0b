"""Compute the times of a log's rows in s.

Empty and repeated rows are left out. A clock that runs backwards is classified:

- a *roll-over*: time falls by 2^16, 2^24 or 2^32 units (or counts), or at the full minute, hour
  or day, and one such step explains it. `time.jumps = "mend"` unwraps it;
- a *step*: the clock was set, so time falls or leaps (`set_clock.py`). `"mend"` removes each step;
  `from_row` and `to_row` cut the log there;
- rows *out of order*, if they are few. `time.repeated = "drop"` leaves them out and is offered
  only if few rows are lost.

Pinned by tests/logs/test_clock.py.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError, differing_times
from softmap_edge.logs.readers.columns import Array, Cells
from softmap_edge.logs.set_clock import Jump, both, returns, set_back, set_forward, usual_step
from softmap_edge.logs.time_keys import TIME, Clock
from softmap_edge.logs.time_text import DAY, HOUR

FEW = 0.05  # of the rows: most that are left out without a warning
_REGULAR = 0.2  # of the usual step: largest jitter of a regular clock
# times the 95th percentile of the steps: longest step that a roll-over may leave
_SLOWEST = 3.0
BITS = (16, 24, 32)  # bits of counters that roll over
_PIVOT = "set pivot = { frame = …, marker = … }"  # of a long table
_LISTED = 5  # steps of a clock that are listed


@dataclass(frozen=True)
class Times:
    """The rows of a log that have a time.

    Attributes:
        t: (rows,) s, increasing.
        cells: the cells of these rows.
        notes: a sentence for each change that was made.
        doubts: a sentence for each suspicious finding.
    """

    t: Array
    cells: Cells
    notes: tuple[str, ...]
    doubts: tuple[str, ...]


def times_of(
    path: Path,
    where: str,
    cells: Cells,
    t: Array,
    clock: Clock,
    clocks: Sequence[int] = (),
    pivoted: bool = False,
) -> Times:
    """Return the times of the rows of a log.

    Args:
        where: the name of a row in this log: line, frame, message.
        t: (rows,) s as in the log; NaN where missing.
        clock: the time declared by the mapping.
        clocks: which of these columns hold time.
        pivoted: whether the mapping has a `pivot`; else it may be the remedy.

    Raises:
        RunError: a row has values but no time, or time does not increase and the mapping declares
            no treatment.
    """
    notes: list[str] = []
    doubts: list[str] = []

    def values(cells: Cells) -> Array:
        return np.delete(cells.numbers, list(clocks), axis=1)

    row = np.arange(len(t)) if cells.rows is None else cells.rows
    empty = ~np.isfinite(t)
    if empty.any():
        if not np.isnan(cells.numbers[empty]).all():
            first = int(np.argmax(empty & np.isfinite(cells.numbers).any(axis=1)))
            raise RunError(
                f"{path}: {where} {cells.lines[first]}: the time is empty or not a number; remove "
                "the line"
            )
        notes.append(f"{int(empty.sum())} empty rows were left out")
        t, cells, row = t[~empty], kept(cells, ~empty), row[~empty]
    if len(t) == 0:
        raise RunError(f"{path}: holds no rows; give a log that holds data")
    again = _written_twice(t, cells)
    if again.any():
        notes.append(
            f"{int(again.sum())} rows that repeat the row before, with its time, were left out"
        )
        t, cells, row = t[~again], kept(cells, ~again), row[~again]
    if clock.jumps == "mend":
        t = _mended(t, values(cells), clock, row, notes, doubts)
    if clock.repeated == "drop" and len(t) > 1:
        fresh = increasing(t)
        if not fresh.all():
            _report_dropped(t, fresh, row, find_steps(t, values(cells), clock), notes, doubts)
            t, cells, row = t[fresh], kept(cells, fresh), row[fresh]
    _refuse_falls(path, where, t, values(cells), cells.lines, row, clock, pivoted)
    if clock.repeated == "spread" and (shared := int((np.diff(t) == 0).sum())):
        doubts.append(
            f"t: {shared} of {len(t)} rows share a time with the row before and were spread "
            "evenly: these times are made up, and delays shorter than the clock's step cannot be "
            "identified"
        )
        t = spread(t)
    if clock.jumps != "mend":
        doubts += _leaps(where, cells, row, set_forward(t, values(cells)))
    return Times(t, cells, (*notes, *_gaps(where, t, cells)), tuple(doubts))


def kept(cells: Cells, keep: NDArray[np.bool_]) -> Cells:
    """Return the rows where `keep` (rows,) is true."""
    labels = None if cells.labels is None else cells.labels[keep]
    rows = None if cells.rows is None else cells.rows[keep]
    return replace(
        cells, numbers=cells.numbers[keep], labels=labels, lines=cells.lines[keep], rows=rows
    )


def _leaps(where: str, cells: Cells, row: NDArray[np.int64], leap: Jump | None) -> list[str]:
    """Return sentences on forward steps of a clock that was set."""
    lines = []
    for at, size in () if leap is None else zip(leap.rows[:_LISTED], leap.size_s):
        lines.append(
            f"t: time leaps by {size:.6g} s at row {row[at]} ({where} {cells.lines[at]}), and the "
            "values go "
            'on as if none had passed: a clock that was set forward? time.jumps = "mend" takes '
            "the step out; to_row = "
            f"{row[at - 1]} and from_row = {row[at]} cut the log in two"
        )
    if leap is not None and len(leap.rows) > _LISTED:
        lines.append(f"t: time leaps in the same way at {len(leap.rows) - _LISTED} more rows")
    return lines


def increasing(t: Array) -> NDArray[np.bool_]:
    """Return which rows (rows,) `repeated = "drop"` keeps: those later than every earlier row.

    A few times that are far too late (wrong stamps) would exclude all following rows, so these
    times are left out instead.
    """
    fresh = np.asarray(np.r_[True, t[1:] > np.maximum.accumulate(t)[:-1]])
    if fresh.mean() >= 1.0 - FEW:
        return fresh
    most = longest_rise(t)
    return most if most.mean() >= 1.0 - FEW else fresh


def _written_twice(t: Array, cells: Cells) -> NDArray[np.bool_]:
    again = np.zeros(len(t), bool)
    at = np.flatnonzero(np.r_[False, np.diff(t) == 0])
    if len(at):
        before, after = cells.numbers[at - 1], cells.numbers[at]
        again[at] = ((before == after) | (np.isnan(before) & np.isnan(after))).all(axis=1)
        if cells.labels is not None:
            again[at] &= cells.labels[at - 1] == cells.labels[at]
    return again


def _report_dropped(
    t: Array,
    fresh: NDArray[np.bool_],
    row: NDArray[np.int64],
    jump: Jump | None,
    notes: list[str],
    doubts: list[str],
) -> None:
    lost, share = int((~fresh).sum()), float((~fresh).mean())
    if share <= FEW:
        notes.append(f"{lost} rows whose time does not increase were dropped")
        return
    at = int(np.argmin(fresh))
    cause = _way_out(t, row, at, jump, True)
    doubts.append(
        f't: time.repeated = "drop" leaves out {lost} of {len(fresh)} rows ({100 * share:.0f} %), '
        f"from row {row[at]} on; {cause}"
    )


# --- roll-overs and steps ------------------------------------------------------------------
def find_jump(t: Array, clock: Clock) -> Jump | None:
    """Return the falls of a clock if all have one cause, a roll-over or a step; else None.

    Args:
        t: (rows,) s.
        clock: its unit, or the rate of its counter, determines possible roll-overs.
    """
    step = np.diff(t)
    rows = np.flatnonzero(step < 0) + 1
    rises = step[step > 0]
    if not len(rows) or len(rises) < 3:
        return None
    size = -step[rows - 1]
    slowest = _SLOWEST * float(np.quantile(rises, 0.95))
    usual = float(np.median(rises))
    for period, words, clocklike in _periods(clock):
        left = period - size
        within = float(np.ptp(t)) <= period * (1 + 1e-9)
        if not (within and ((left > 0) & (left <= slowest)).all()):
            continue
        if clocklike and (t.min() < 0 or period - t.max() > slowest or t[rows].max() > slowest):
            continue
        return Jump(rows, -size, period, words)
    if len(rows) == 1 and size[0] > 3 * usual and not returns(step, int(rows[0]), float(size[0])):
        return Jump(rows, -size, None)
    return None


def _periods(clock: Clock) -> list[tuple[float, str, bool]]:
    """Return the periods of roll-overs: s, text, and whether the calendar determines them."""
    found = (
        [(2.0**bits * clock.seconds, f"2^{bits} counts") for bits in (8, *BITS)]
        if clock.seconds not in TIME.values()
        else []
    )
    for unit in ("us", "ms", "ns", "s"):
        found += [(2.0**bits * TIME[unit], f"2^{bits} {unit}") for bits in BITS]
    counted = [(period, words, False) for period, words in found]
    calendar = (
        (1.0, "the full second"),
        (60.0, "the full minute"),
        (HOUR, "the full hour"),
        (DAY, "midnight"),
    )
    return counted + [(period, words, True) for period, words in calendar]


def counting_on(t: Array, jump: Jump) -> Array:
    """Return the times (rows,) s of a clock, unwrapped over its roll-overs."""
    assert jump.period_s is not None
    turns = np.zeros(len(t))
    turns[jump.rows] = 1.0
    return t + jump.period_s * np.cumsum(turns)


def find_steps(t: Array, values: Array, clock: Clock) -> Jump | None:
    """Return the falls of a clock with one cause, as `find_jump`, or several steps of a set clock.

    Args:
        t: (rows,) s.
        values: (rows, columns) without time columns.
        clock: as in `find_jump`.
    """
    return find_jump(t, clock) or set_back(t, values)


def _mended(
    t: Array,
    values: Array,
    clock: Clock,
    row: NDArray[np.int64],
    notes: list[str],
    doubts: list[str],
) -> Array:
    """Return the times without their jumps if one cause explains all of them."""
    jump = find_steps(t, values, clock)
    if jump is not None and jump.period_s is not None:
        notes.append(
            f"the clock rolls over {len(jump.rows)} times (at {jump.period}) and counts on"
        )
        return counting_on(t, jump)
    jump = both(jump, set_forward(t, values))
    if jump is None:
        return t
    usual, mended = usual_step(t), t.copy()
    for at, size in zip(jump.rows, jump.size_s):
        mended[at:] += usual - size
    doubts += [
        f"t: the clock was set by {size - usual:.6g} s at row {row[at]}, and the step was taken "
        f"out: later rows follow at the usual step of {usual:.3g} s, which is right if the log "
        "did not pause there"
        for at, size in zip(jump.rows[:_LISTED], jump.size_s)
    ]
    if len(jump.rows) > _LISTED:
        doubts.append(f"t: {len(jump.rows) - _LISTED} more such steps were taken out")
    return mended


def _refuse_falls(
    path: Path,
    where: str,
    t: Array,
    values: Array,
    lines: NDArray[np.int64],
    row: NDArray[np.int64],
    clock: Clock,
    pivoted: bool,
) -> None:
    """Raise RunError with cause and remedy if time does not increase."""
    step = np.diff(t)
    late = step < 0 if clock.repeated == "spread" else step <= 0
    if not late.any():
        return
    jump = find_steps(t, values, clock)
    at = int(np.argmax(late)) + 1 if jump is None else int(jump.rows[0])
    back = step[at - 1] < 0
    now, before = differing_times(t[at], t[at - 1])
    raise RunError(
        f"{path}: time {'goes backwards' if back else 'stands still'} at row {row[at]} ({where} "
        f"{lines[at]}: {now} s after {before} s), {int(late.sum())} such rows; "
        f"{_way_out(t, row, at, jump, pivoted)}"
    )


def _way_out(t: Array, row: NDArray[np.int64], at: int, jump: Jump | None, pivoted: bool) -> str:
    if jump is not None and jump.period_s is not None:
        return (
            f"the clock rolls over at {jump.period} ({jump.period_s:.10g} s): "
            'set time.jumps = "mend" to count on'
        )
    again = t[at] == t[0] and at > 1 and not pivoted
    stacked = f"; {_PIVOT} if the log lists one marker after another" if again else ""
    cut = f"import the log in two parts, to_row = {row[at - 1]} and from_row = {row[at]}"
    if jump is not None and len(jump.rows) > 1:
        return _steps(row, jump, usual_step(t)) + stacked
    if jump is not None:
        size = usual_step(t) - jump.size_s[0]
        return (
            f"the clock was set back by about {size:.6g} s: "
            f'set time.jumps = "mend" to take the step out, or {cut}{stacked}'
        )
    ways = []
    lost = int((~increasing(t)).sum())
    if lost <= max(1, FEW * len(t)):
        ways.append(f'set time.repeated = "drop" to leave {lost} of {len(t)} rows out')
    if not (np.diff(t) < 0).any():
        ways.append('set time.repeated = "spread" to place rows of one time evenly up to the next')
        ways += [] if pivoted else [f"{_PIVOT} if the log has a row for each marker"]
    if not ways:
        ways = ["the rows are not in the order of time: choose another column", cut]
    return ", or ".join(ways) + stacked


def _steps(row: NDArray[np.int64], jump: Jump, usual: float) -> str:
    """Return the sentence on a clock that was set back several times."""
    steps = [f"{usual - size:.6g} s at row {row[at]}" for at, size in zip(jump.rows, jump.size_s)]
    begins = [f"from_row = {row[at]}" for at in jump.rows]
    ends = [f"to_row = {row[at - 1]}" for at in jump.rows]
    parts = [ends[0], *(f"{begin} with {end}" for begin, end in zip(begins, ends[1:])), begins[-1]]
    if len(steps) > _LISTED:
        steps, parts = (
            [*steps[:_LISTED], f"{len(steps) - _LISTED} more"],
            [*parts[:_LISTED], "and so on"],
        )
    return (
        f"the clock was set back {len(jump.rows)} times, by about {', '.join(steps)}: set "
        'time.jumps = "mend" to take '
        f"each step out, or import the log in {len(jump.rows) + 1} parts: {'; '.join(parts)}"
    )


def spread(t: Array) -> Array:
    """Return times (rows,) s with rows of equal time spread evenly up to the next time.

    The last rows continue at the usual step. So do the first rows if they are fewer than usual,
    because the log then began within their time.
    """
    first = np.flatnonzero(np.r_[True, np.diff(t) > 0])
    count = np.diff(np.r_[first, len(t)])
    width = np.diff(t[first])
    usual = float(np.median(width / count[:-1])) if len(width) else 1.0
    step = np.r_[width / count[:-1], usual]
    begin = t[first].copy()
    if len(width) > 1 and count[0] * usual < width[0]:
        step[0], begin[0] = usual, t[first[1]] - count[0] * usual
    within = np.arange(len(t)) - np.repeat(first, count)
    return np.asarray(np.repeat(begin, count) + within * np.repeat(step, count))


def corrected(
    t_seen: Array, start: float, fast_ppm: float, step: tuple[float, float] | None
) -> Array:
    """Return frame times (K,) s on the clock of the commands.

    Args:
        t_seen: (K,) s, on the clock of the frames.
        start: s, when both clocks agree: the first command.
        fast_ppm: rate error of the frames' clock; positive if it runs fast.
        step: when that clock is set (s, on itself), and by how much (s); None if it is not.

    Raises:
        RunError: the frames before and after the step would overlap.
    """
    t = t_seen.copy()
    if step is not None:
        t[t_seen >= step[0]] -= step[1]
        if (np.diff(t) <= 0).any():
            k = int(np.argmax(np.diff(t) <= 0))
            raise RunError(
                f"seen.clock_step = [{step[0]:.6g}, {step[1]:.6g}]: frames overlap after "
                f"{t_seen[k]:.6g} s, where none may; give the time and the sign of the step, as "
                "`softmap check` prints them"
            )
    return np.asarray(start + (t - start) / (1.0 + 1e-6 * fast_ppm))


def _gaps(where: str, t: Array, cells: Cells) -> list[str]:
    """Return sentences on rows missing from a regular clock."""
    step = np.diff(t)
    if len(step) < 10:
        return []
    usual = float(np.median(step))
    if (np.abs(step - usual) <= _REGULAR * usual).mean() < 0.9:
        return []
    gaps = step > 1.5 * usual
    if not gaps.any():
        return []
    missing, row = int(np.rint(step[gaps] / usual - 1).sum()), int(np.argmax(step))
    return [
        f"{missing} rows are missing in {int(gaps.sum())} gaps, the longest {step[row]:.3g} s "
        f"after {where} {cells.lines[row]} (usual step {usual:.3g} s); no rows are added for them"
    ]


def longest_rise(t: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which rows (rows,) form the longest series of rising times, in O(n log n).

    All other rows have stray times.

    Args:
        t: (rows,) s, finite.
    """
    ends: list[float] = []  # smallest last time of a rising series of each length
    rows: list[int] = []  # its row
    before = np.full(len(t), -1, np.intp)
    for row, time in enumerate(t.tolist()):
        k = bisect_left(ends, time)
        before[row] = rows[k - 1] if k else -1
        ends[k : k + 1] = [time]
        rows[k : k + 1] = [row]
    kept = np.zeros(len(t), bool)
    row = rows[-1] if rows else -1
    while row >= 0:
        kept[row] = True
        row = int(before[row])
    return kept
