"""Find the time of a log: one column, seconds and nanoseconds, date and time, or none.

A column of dates or times always counts. Any other column counts if it rises throughout and is
named like a time or comes first. A clock that falls counts if one roll-over or one step explains
it. Full seconds that repeat are completed by the fraction next to them, which has the same name or
falls only where they rise. Pinned by tests/logs/test_guess_time.py.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.files.toml import quoted
from softmap_edge.logs.clock import counting_on, find_jump, find_steps
from softmap_edge.logs.epochs import YEARS, readings_of, without_date
from softmap_edge.logs.guess_columns import last_of
from softmap_edge.logs.guess_falls import counts_of_roll, treatment
from softmap_edge.logs.guess_sheets import Sheet
from softmap_edge.logs.readers.cells import is_value
from softmap_edge.logs.readers.clock_cells import packed_of
from softmap_edge.logs.set_clock import usual_step
from softmap_edge.logs.time_keys import NO_TIME, TIME, Clock, fractions
from softmap_edge.logs.time_names import TIME_NAME, is_time_unit, time_unit
from softmap_edge.logs.time_text import DAY
from softmap_edge.logs.unit_words import unit_in_name
from softmap_edge.run.fields import ROW_S

Array = NDArray[np.float64]
RATE_HZ = 100  # assumed rate of a counter
_COUNTERS = re.compile(
    r"^(id|frame#?|frame_?(idx|index|no|nr|num(ber)?)|index|idx|sample|row|count(er)?|nr|no|n|#|)$",
    re.IGNORECASE,
)
_FRAMES = re.compile(
    r"^frame(#|_?(idx|index|no|nr|num(ber)?))?$", re.IGNORECASE
)  # never holds time
_WHOLE = re.compile(r"(seconds|secs?|s)$", re.IGNORECASE)
_FRACTION = {
    "ns": re.compile(r"(nano_?sec(onds|s)?|n_?secs?|ns)$", re.IGNORECASE),
    "us": re.compile(r"(micro_?sec(onds|s)?|u_?secs?|us)$", re.IGNORECASE),
    "ms": re.compile(r"(milli_?sec(onds|s)?|m_?secs?|ms)$", re.IGNORECASE),
}
_FALLS = 0.1  # of the rows: a column that falls more often is not a clock
_DAYS = ((2e4, 8e4), (7e5, 8e5))  # dates from about 1955 on, in days of spreadsheets and Matlab
_COARSE = 0.05  # of the rows share a time: another column may be finer


@dataclass(frozen=True)
class TimeFound:
    """The time of a log.

    Attributes:
        columns: its columns; empty if only the rows count.
        unit: of the first column: a unit of `TIME`, `rows` for a counter, `stated` at a rate given
            in the file, or `none`.
        why: the reason, as a part of a sentence.
        line: the proposed `time` of the mapping.
        seconds: (rows,) s.
        calendar: whether it counts from 1970 or from midnight.
        doubt: a sentence on times that do not rise; else empty.
    """

    columns: tuple[str, ...]
    unit: str
    why: str
    line: str
    seconds: Array
    calendar: bool = False
    doubt: str = ""


def time_of(sheet: Sheet, alone: bool = True) -> TimeFound:
    """Return the time of a log.

    Args:
        sheet: the log.
        alone: whether no other log is joined to it by time.
    """
    single = _single(sheet)
    pair = _date_and_day(sheet) or _seconds_and_fraction(sheet)
    if pair is not None and (single is None or single in pair[0]):
        return _of_pair(sheet, *pair)
    if single is not None:
        return _of_column(sheet, single)
    rows = np.arange(len(sheet.numbers), dtype=float)
    unread = _unread(sheet)
    why = "no column holds time" if unread is None else f"'{unread[0]}' {unread[1]}"
    if unread is not None and unread[2]:
        line = f"time = {{ column = {cell(sheet, unread[0])} }}   # UNKNOWN: it {unread[1]}"
        return TimeFound((unread[0],), "s", why, line, rows)
    if sheet.rate_hz is not None and sheet.topic is None:
        why = f"{why}; the lines above the table state {sheet.rate_hz:g} Hz"
        return TimeFound(
            (), "stated", why, f"time = {{ rate_hz = {sheet.rate_hz:g} }}", rows / sheet.rate_hz
        )
    if alone:
        line = f'time = "{NO_TIME}"   # UNKNOWN: {{ rate_hz = … }} if you know the rate of the log'
        return TimeFound(
            (), "none", f"{why}: only the order of the rows is known", line, rows * ROW_S
        )
    line = f"time = {{ rate_hz = {RATE_HZ}, assumed = true }}   # UNKNOWN: the rate of the log"
    return TimeFound((), "rows", why, line, rows / RATE_HZ)


def _known(sheet: Sheet, name: str) -> Array:
    values = sheet.column(name)
    return values[np.isfinite(values)]


def cell(sheet: Sheet, name: str) -> str:
    """Return a column as in a mapping: by number without a header, or if its name repeats."""
    k = sheet.names.index(name)
    if (
        not sheet.header
        or sheet.names.count(name) > 1
        or (sheet.bare and sheet.bare.count(sheet.bare[k]) > 1)
    ):
        return str(k)
    return quoted(name)


# --- one column ----------------------------------------------------------------------------
def _single(sheet: Sheet) -> str | None:
    """Return the column that is time by itself."""
    dated = [
        name for name in sheet.clocks if len(known := _known(sheet, name)) > 1 and np.ptp(known) > 0
    ]
    best = min(
        dated, key=lambda name: (sheet.clocks[name] == "day", sheet.names.index(name)), default=None
    )
    if best is not None and not _coarse(sheet, best):
        return best
    names = [name for name in dict.fromkeys(sheet.names) if not _broken_counts(sheet, name).any()]
    rising = [name for name in names if _rises(_known(sheet, name))]
    falling = [name for name in names if name not in rising and _falls(sheet, name)]
    straying = [name for name in names if name not in (*rising, *falling) and _strays(sheet, name)]
    for names in (rising, falling, straying):
        for pattern in (TIME_NAME, _COUNTERS):
            fits = [
                name for name in names if name not in dated and _called_so(sheet, name, pattern)
            ]
            finer = [name for name in fits if not _coarse(sheet, name)]
            if best is not None and (pattern is _COUNTERS or not finer):
                continue
            if fits:
                return (finer or fits)[0]
    if best is not None:
        return best
    first = next(iter([*rising, *falling]), None)
    if first == sheet.names[0] and (not sheet.header or _ticks_evenly(sheet.column(first))):
        return first
    return None


def _broken_counts(sheet: Sheet, name: str) -> NDArray[np.bool_]:
    """Return which values of a column named like a counter are not whole numbers.

    A column with whole numbers in fewer than half of its rows is not a counter and is classified by
    its values, except a frame column.
    """
    known = _known(sheet, name)
    if not (len(known) and sheet.header and _called_so(sheet, name, _COUNTERS)):
        return np.zeros(len(known), bool)
    broken = fractions(known)
    frames = _called_so(sheet, name, _FRAMES)
    return broken if frames or broken.mean() < 0.5 else np.zeros(len(known), bool)


def _bare(name: str) -> str:
    """Return a name without its unit in brackets."""
    return re.sub(r"[\[(].*?[\])]", "", name).strip()


def _coarse(sheet: Sheet, name: str) -> bool:
    """Return whether many rows have the time of the previous row."""
    known = _known(sheet, name)
    return len(known) > 1 and bool((np.diff(known) == 0).mean() > _COARSE)


def _unread(sheet: Sheet) -> tuple[str, str, bool] | None:
    """Return a text column named like a time, its content, and whether most cells can be read."""
    for name, texts in sheet.texts.items():
        filled = [text for text in texts if text]
        if filled and sheet.header and TIME_NAME.search(_bare(last_of(sheet, name))):
            odd = next((text for text in filled if not is_value(text)), filled[0])[:40]
            most = 2 * sum(map(is_value, filled)) > len(filled)
            return (
                name,
                f"holds '{odd}'" + (" as well" if most else ", which is not read as time"),
                most,
            )
    for name in sheet.names:
        broken = _broken_counts(sheet, name)
        if broken.any():
            value = _known(sheet, name)[int(np.argmax(broken))]
            return name, f"holds {value:.6g}, which is not the number of a row or frame", False
    one = next((name for name, form in sheet.clocks.items() if form != "day"), None)
    return None if one is None else (one, "holds one date only", False)


def _rises(known: Array) -> bool:
    return len(known) > 1 and bool((np.diff(known) >= 0).mean() > 0.999 and known[-1] > known[0])


def _falls(sheet: Sheet, name: str) -> bool:
    """Return whether a column rises, except for a few falls of a roll-over or one step."""
    known = _known(sheet, name)
    step = np.diff(known)
    if len(known) < 10 or not 0 < (step < 0).mean() <= _FALLS or (step == 0).mean() > 0.5:
        return False
    seconds, _ = _scale(sheet, name)
    return find_jump(known * seconds, Clock(name, seconds)) is not None


def _strays(sheet: Sheet, name: str) -> bool:
    """Return whether a column named like a time rises except for a few falls of any kind."""
    step = np.diff(_known(sheet, name))
    few = len(step) >= 10 and bool((step < 0).mean() <= _FALLS and (step > 0).mean() > 0.5)
    return few and _called_so(sheet, name, TIME_NAME)


def _called_so(sheet: Sheet, name: str, pattern: re.Pattern[str]) -> bool:
    """Return whether a column is named like a time, or matches a pattern."""
    last = _bare(last_of(sheet, name))
    return pattern.search(last) is not None or (pattern is TIME_NAME and is_time_unit(last))


def _ticks_evenly(values: Array) -> bool:
    """Return whether numbers rise by nearly equal steps, as a clock of any name does."""
    step = np.diff(values[np.isfinite(values)])
    usual = float(np.median(step))
    return usual > 0 and bool((np.abs(step - usual) < 0.5 * usual).mean() > 0.9)


def _of_column(sheet: Sheet, name: str) -> TimeFound:
    seconds, (unit, why) = _scale(sheet, name)
    values = sheet.column(name)
    first = name == sheet.names[0] and not (sheet.header and TIME_NAME.search(name))
    called = "the first column" if first else ""
    if sheet.header:
        called += f" '{name}'"
    elif not first:
        called = f"column {name}"
    t, known = values * seconds, _known(sheet, name)
    others = np.delete(sheet.numbers, sheet.names.index(name), axis=1)[np.isfinite(values)]
    jump = find_steps(known * seconds, others, Clock(name, seconds))
    keys = [f"column = {cell(sheet, name)}"]
    if unit == "rows" and sheet.rate_hz is not None:
        line = f"time = {{ {keys[0]}, rate_hz = {sheet.rate_hz:g} }}   # it counts rows"
        stated = f"the lines above the table state {sheet.rate_hz:g} Hz"
        return TimeFound(
            (name,),
            "stated",
            f"{called.strip()} rises throughout and counts rows; {stated}",
            line,
            t,
        )
    if unit == "rows":
        line = (
            f"time = {{ {keys[0]}, rate_hz = {RATE_HZ}, assumed = true }}   # it counts rows; "
            "UNKNOWN: their rate"
        )
        return TimeFound((name,), "rows", f"{called.strip()} rises throughout; {why}", line, t)
    keys += [] if name in sheet.clocks else [f'unit = "{unit}"']
    moves, doubt = "rises throughout", ""
    if jump is not None and jump.period_s is not None:
        keys.append('jumps = "mend"')
        moves = f"rises, and rolls over at {jump.period}"
        at = np.flatnonzero(np.isfinite(t))
        t[at] = counting_on(t[at], jump)
    elif (np.diff(known) < 0).any():
        treated = treatment(known * seconds, jump, name)
        moves, doubt = treated.moves, treated.doubt
        keys += treated.keys
        t[np.isfinite(t)] = treated.seconds
    keys += [
        key for key in _repeated(known) if not any(other.startswith("repeated") for other in keys)
    ]
    dated = sheet.clocks.get(name, "count") != "count"
    calendar = dated or float(np.abs(known).max()) * seconds > 1e8
    line = f"time = {{ {', '.join(keys)} }}"
    if not doubt and name not in sheet.clocks and _like_digits(known):
        doubt = (
            f"'{name}' looks like the digits of dates (yymmddHHMMSS), such as {known[0]:.0f}, and "
            f"is read as {unit}: convert it to seconds in the log"
        )
    if not doubt and "not known" in why and without_date(known, usual_step(known)):
        doubt = (
            f"what '{name}' counts: {known[0]:.15g} is not a date from {YEARS[0]} to {YEARS[1]} in s, "
            f"ms, us or ns since 1970, 100 ns since 1601 or since year 1; {unit} is written: put "
            "the unit of the log there"
        )
    return TimeFound((name,), unit, f"{called.strip()} {moves}; {why}", line, t, calendar, doubt)


def _like_digits(known: Array) -> bool:
    """Return whether numbers (rows,) may be dates without separators, such as 240305125950."""
    low, high = float(known.min()), float(known.max())
    if not (1e10 < low <= high < 1e12 or 1.9e13 < low <= high < 2.1e13):
        return False
    return packed_of([f"{int(value):012d}" for value in known.tolist()]) is not None


def _repeated(known: Array) -> list[str]:
    """Return the mapping's keys for rows that share a time."""
    same = (np.diff(known) == 0).mean() if len(known) > 1 else 0.0
    if same == 0.0:
        return []
    return ['repeated = "spread"'] if same > 0.05 else ['repeated = "drop"']


def _scale(sheet: Sheet, name: str) -> tuple[float, tuple[str, str]]:
    """Return the s per unit of a column, the unit (`rows` for a counter), and the reason."""
    if name in sheet.clocks:
        what = {
            "day": "times of day, read as seconds",
            "count": "seconds, with a count of their fractions behind the point",
        }
        return 1.0, ("s", f"it holds {what.get(sheet.clocks[name], 'dates, read as seconds')}")
    unit, why = _unit(sheet, name)
    return (1.0 / (sheet.rate_hz or RATE_HZ) if unit == "rows" else TIME[unit]), (unit, why)


def _unit(sheet: Sheet, name: str) -> tuple[str, str]:
    values = _known(sheet, name)
    usual = usual_step(values)
    stated = (
        sheet.units.get(name) or unit_in_name(name, TIME) or time_unit(_bare(last_of(sheet, name)))
    )
    if stated in TIME:
        return stated, f"its unit {stated} is stated"
    if (counts := counts_of_roll(values, usual)) is not None:
        return counts
    largest = float(np.abs(values).max())
    readings = readings_of(values, usual)
    if len(readings) == 1:
        return readings[0].unit, readings[0].says
    if any(low < largest < high for low, high in _DAYS) and 2e-4 <= usual * TIME["d"] < 5.0:
        return "d", "it counts days, as a spreadsheet does"
    if (values == np.rint(values)).all() and usual == 1.0:
        return "rows", "it counts rows"
    for unit in ("s", "ms", "us", "ns"):
        if 2e-4 <= usual * TIME[unit] < 5.0:
            large = ", and its date is not known" if without_date(values, usual) else ""
            return unit, f"rows {usual:.4g} apart look like {unit}{large}"
    return "s", "its unit is not known and taken as s"


# --- two columns ---------------------------------------------------------------------------
def _of_pair(sheet: Sheet, names: tuple[str, str], units: tuple[str, str], why: str) -> TimeFound:
    scales = [1.0 if name in sheet.clocks else TIME[unit] for name, unit in zip(names, units)]
    parts = [sheet.column(name) for name in names]
    if names[0] in sheet.clocks:
        parts[1] = np.mod(parts[1], DAY)
    t = parts[0] * scales[0] + parts[1] * scales[1]
    keys = [f"columns = [{', '.join(cell(sheet, name) for name in names)}]"]
    keys += (
        [f'units = ["{units[0]}", "{units[1]}"]']
        if units != ("s", "ns") and names[0] not in sheet.clocks
        else []
    )
    known = t[np.isfinite(t)]
    keys += _repeated(known)
    calendar = names[0] in sheet.clocks or bool(len(known)) and float(np.abs(known).max()) > 1e8
    return TimeFound(names, units[0], why, f"time = {{ {', '.join(keys)} }}", t, calendar)


def _date_and_day(sheet: Sheet) -> tuple[tuple[str, str], tuple[str, str], str] | None:
    """Return a column of dates and one of times of day."""
    days = [name for name, form in sheet.clocks.items() if form == "day"]
    dates = [
        name
        for name, form in sheet.clocks.items()
        if form != "day" and not np.mod(_known(sheet, name), DAY).any()
    ]
    if not days or not dates:
        return None
    return (dates[0], days[0]), ("s", "s"), f"'{dates[0]}' holds dates and '{days[0]}' times of day"


def _seconds_and_fraction(sheet: Sheet) -> tuple[tuple[str, str], tuple[str, str], str] | None:
    """Return a column of full seconds, and one with the fraction of a second."""
    for full in sheet.names:
        stem = _WHOLE.sub("", full)
        if not sheet.header or stem == full or full in sheet.texts:
            continue
        for unit, pattern in _FRACTION.items():
            for name in sheet.names:
                same = (
                    name != full
                    and pattern.search(name)
                    and pattern.sub("", name).lower() == stem.lower()
                )
                if same and _completes(_known(sheet, full), _known(sheet, name), TIME[unit]):
                    return (
                        (full, name),
                        ("s", unit),
                        f"'{full}' holds seconds and '{name}' their {unit}",
                    )
    for full, name in zip(sheet.names, sheet.names[1:]):
        for unit in ("ns", "us", "ms"):
            one, two = _known(sheet, full), _known(sheet, name)
            if _completes(one, two, TIME[unit]) and _turns(one, two, TIME[unit]):
                return (
                    (full, name),
                    ("s", unit),
                    f"column {full} holds seconds and column {name} their {unit}",
                )
    return None


def _completes(full: Array, fraction: Array, seconds: float) -> bool:
    """Return whether two integer columns are non-decreasing seconds and a fraction of a second."""
    if len(full) != len(fraction) or len(full) < 2 or not (np.rint(full) == full).all():
        return False
    if (
        not (np.rint(fraction) == fraction).all()
        or fraction.min() < 0
        or fraction.max() * seconds >= 1.0
    ):
        return False
    return bool(_rises(full + fraction * seconds) and (np.diff(full) >= 0).mean() > 0.999)


def _turns(full: Array, fraction: Array, seconds: float) -> bool:
    """Return whether the fraction falls only where the seconds rise, and spans most of a second."""
    falls, rises = np.diff(fraction) < 0, np.diff(full) > 0
    repeats = (np.diff(full) == 0).mean() > 0.3
    step = np.diff(full + fraction * seconds)
    even = bool((step > 0).mean() > 0.99 and step.max() < 0.9)
    filled = float(np.ptp(fraction)) * seconds > 0.5
    return bool(repeats and falls.any() and not (falls & ~rises).any() and even and filled)
