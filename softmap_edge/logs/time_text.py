"""Read dates and times as text (ISO 8601, local dates, times of day) and return seconds.

| form | example | seconds since |
|---|---|---|
| `ymd` | `2031-05-07T10:15:00.050Z`, `2031/05/07 10:15:00,05 +0200`, `20310507T101500` | 1970, of
    UTC or local time |
| `local` | `07.05.2031 10:15:00`, `5/7/2031 10:15:00 AM` | 1970 |
| `named` | `07-May-2031 10:15:00`, `7. Mai 2031 10:15:00`, `Wed May  7 10:15:00 2031` | 1970 |
| packed | `310507101500.05`, `20310507101500`, `101500.05` | as a date or a time of day |
| `day` | `10:15:00.050`, `15:00.05` (minutes and seconds) | midnight, or the full hour |
| `count` | `1700000000.50` (seconds, a point, a count of us or ns without leading zeros) | as the log |

Days with dots are day.month.year. Others are read in both orders; a value above 12 or the sequence
of the rows decides (`TimeText.settle`). A time of day that falls by most of its period has passed
midnight and is unwrapped. Pinned by tests/logs/test_time_text.py.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ORDERS = ("dmy", "mdy")
DAY, HOUR = 86400.0, 3600.0
_LONGEST = 48  # characters of a time
_MOST = 0.9  # of the cells: if this many are times, the others are faults of the file
# ratio of the largest steps at which one day-month order is clearly right
_CLEARER = 5.0
_DOTTED = re.compile(r"\d{1,2}\.\d{1,2}\.\d").search  # a local date is day.month.year
# two digits after a colon are frames of a film, no fraction
_FRACTION = r"(?:[.,](?P<f>\d{1,12})|:(?P<ms>\d{3}))?"
_CLOCK = (
    rf"(?P<h>\d{{1,2}}):(?P<mi>\d{{2}})(?::(?P<s>\d{{2}}){_FRACTION})?"
    r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?"
)
_ZONE = r"(?: ?(?P<zone>Z|z|UTC|GMT|[+-]\d{2}(?::?\d{2})?))?"
# the first letters of the months, English and German, and the rest of their names
_MONTHS = {
    "jan": (1, "uary|uar"),
    "jän": (1, "ner"),
    "feb": (2, "ruary|ruar"),
    "mar": (3, "ch"),
    "mär": (3, "z"),
    "mae": (3, "rz"),
    "mrz": (3, ""),
    "apr": (4, "il"),
    "may": (5, ""),
    "mai": (5, ""),
    "jun": (6, "e|i"),
    "jul": (7, "y|i"),
    "aug": (8, "ust"),
    "sep": (9, "tember|t"),
    "oct": (10, "ober"),
    "okt": (10, "ober"),
    "nov": (11, "ember"),
    "dec": (12, "ember"),
    "dez": (12, "ember"),
}
_NAME = rf"(?P<name>{'|'.join(f'{k}(?:{rest})?' for k, (_, rest) in _MONTHS.items())})\.?"
_WEEKDAY = (
    r"(?:(?:(?:mon|tues|wednes|thurs|fri|satur|sun)day|mon|tue|wed|thu|fri|sat|sun"
    r"|(?:mon|diens|donners|frei|sams|sonn)tag|mittwoch|sonnabend|mo|di|mi|do|fr|sa|so)\.?,? )?"
)
_YEAR = r"(?P<y>\d{4}|\d{2})"
# the time of day, where there is one
_REST = rf"(?:,? {{1,3}}(?:um |at )?|[T_])?(?:{_CLOCK}(?: Uhr)?)?{_ZONE}"
_FIRST = rf"{_CLOCK}{_ZONE},? {{1,2}}"  # the time of day in front of the date
_TIGHT = r"(?P<h>\d{2}):?(?P<mi>\d{2}):?(?P<s>\d{2})(?:[.,](?P<f>\d{1,12}))?"
_YMD = r"(?P<y>\d{4})(?P<sep>[-/.:])(?P<b>\d{1,2})(?P=sep)(?P<a>\d{1,2})"
_LOCAL = rf"(?P<a>\d{{1,2}})(?P<sep>[-/.])(?P<b>\d{{1,2}})(?P=sep){_YEAR}"
_NAMED = (
    rf"(?P<a>\d{{1,2}})(?:st|nd|rd|th)?(?:\. ?|[-/ ]){_NAME}[-/ ]{_YEAR}",
    rf"{_NAME} {{1,2}}(?P<a>\d{{1,2}})(?:st|nd|rd|th)?(?:,? |,){_YEAR}",
    rf"(?P<y>\d{{4}})[-/ ]{_NAME}[-/ ](?P<a>\d{{1,2}})",
)
# as ctime and `date` write it; the name of a local zone does not count
_CTIME = rf"{_NAME} {{1,2}}(?P<a>\d{{1,2}}) {_CLOCK}(?:{_ZONE}| [A-Z]{{3,4}}) (?P<y>\d{{4}})"


def _compiled(*forms: str) -> tuple[re.Pattern[str], ...]:
    return tuple(re.compile(form, re.IGNORECASE) for form in forms)


_FORMS: dict[str, tuple[re.Pattern[str], ...]] = {
    "ymd": _compiled(
        _YMD + _REST,
        rf"(?P<y>\d{{4}})(?P<b>\d{{2}})(?P<a>\d{{2}})[T_ ]{_TIGHT}{_ZONE}",
        _FIRST + _YMD,
    ),
    "local": _compiled(_LOCAL + _REST, _FIRST + _LOCAL),
    "named": _compiled(
        *(_WEEKDAY + form + _REST for form in _NAMED),
        _WEEKDAY + _CTIME,
        *(_FIRST + _WEEKDAY + form for form in _NAMED),
    ),
    "day": _compiled(_CLOCK, r"(?P<mi>\d{1,2}):(?P<s>\d{2})[.,](?P<f>\d{1,12})"),
}  # day and month are `a` and `b`, or `b` and `a`


_DIGITS = r"(?P<b>\d{2})(?P<a>\d{2})(?P<h>\d{2})(?P<mi>\d{2})(?P<s>\d{2})"
_PACKED = {
    "ymd": _compiled(
        rf"(?P<y>\d{{2}}){_DIGITS}(?:[.,](?P<f>\d{{1,12}}))?",
        rf"(?P<y>(?:19|20)\d{{2}}){_DIGITS}(?:[.,]?(?P<f>\d{{1,12}}))?",
    ),
    "day": _compiled(
        r"(?P<h>\d{1,2})(?P<mi>\d{2})(?P<s>\d{2})(?:[.,](?P<f>\d{1,12}))?",
    ),
    "count": _compiled(r"(?P<whole>\d{1,12})(?:[.,](?P<f>\d{1,9}))?"),
}  # dates and times of day whose digits stand without separators, and seconds with a count


class TimeTextError(ValueError):
    """A time that cannot be read; the message is a part of a sentence."""


@dataclass(frozen=True)
class TimeText:
    """The format of the times in one column.

    Attributes:
        form: `ymd`, `local`, `named`, `day` or `count`.
        order: `dmy` or `mdy` of local dates; None where the rows decide.
        period: s after which a time of day begins again; 0 of a date.
        packed: whether its digits stand without separators, as in `240305125950.5`.
        unpadded: digits of the unit in which fractions are counted without leading zeros (3: `.50`
            is 50 ms); 0 of decimal fractions.
    """

    form: str
    order: str | None = None
    period: float = 0.0
    packed: bool = False
    unpadded: int = 0

    def parse(self, cells: Sequence[str]) -> Array:
        """Return the seconds (rows, 2) of times in both day-month orders; NaN if empty.

        Raises:
            TimeTextError: a cell does not have this form; `args[1]` is its row.
        """
        both = np.full((len(cells), 2), np.nan)
        known: dict[tuple[str, ...], tuple[float, float]] = {}
        for row, cell in enumerate(cells):
            if cell.strip():
                found = self.match(cell.strip())
                if found is None:
                    raise TimeTextError(f"'{cell[:40]}' is not a {self.words()}", row)
                both[row] = seconds_of(found, known, self.unpadded)
                if self.form != "local":
                    both[row, 1] = both[row, 0]
                if np.isnan(both[row]).all():
                    raise TimeTextError(f"'{cell[:40]}' is not a date of the calendar", row)
        return both

    def match(self, cell: str) -> re.Match[str] | None:
        """Return the parts of a cell of this form; None if it is none."""
        if len(cell) > _LONGEST:
            return None
        forms = (_PACKED if self.packed else _FORMS)[self.form]
        return next((found for form in forms if (found := form.fullmatch(cell))), None)

    def settle(self, both: Array) -> tuple[Array, str | None]:
        """Return the seconds (rows,) in the right order, and a note on how they were read.

        `both` holds the seconds in both orders, (rows, 2).

        Raises:
            TimeTextError: the rows do not decide between day/month and month/day.
        """
        seconds, note = self._settled(both)
        notes = [note] if note is not None else []
        if self.packed and self.form != "count":
            digits = "HHMMSS" if self.form == "day" else "yymmddHHMMSS or yyyymmddHHMMSS"
            notes.append(f"the digits are read as {digits}")
        if self.unpadded:
            unit = {3: "ms", 6: "us", 9: "ns"}[self.unpadded]
            notes.append(
                f"fractions of a second lack their leading zeros: .50 is read as 50 {unit}"
            )
        return seconds, "; ".join(notes) or None

    def _settled(self, both: Array) -> tuple[Array, str | None]:
        if self.form == "day":
            return counted_on(both[:, 0], self.period)
        if self.form != "local" or self.order is not None:
            column = 1 if self.order == "mdy" else 0
            if np.isnan(both[~np.isnan(both).all(axis=1), column]).any():
                raise TimeTextError(f"the dates are not {ORDER_WORDS[self.order or 'dmy']}")
            return both[:, column], None
        return _ordered(both)

    def words(self) -> str:
        """Return the name of this form."""
        names = {
            "ymd": "date (year-month-day)",
            "local": "date",
            "named": "date with the name of a month",
            "count": "number of seconds with a count of fractions",
        }
        return names.get(self.form, "time of day (hours:minutes:seconds)")


ORDER_WORDS = {"dmy": "day/month/year", "mdy": "month/day/year"}


def is_time(cell: str) -> bool:
    """Return whether a cell is a date or a time of day."""
    return form_of(cell) is not None


def form_of(cell: str) -> str | None:
    """Return the form of a time; None if the cell is not a time."""
    cell = cell.strip()
    if (
        not 4 <= len(cell) <= _LONGEST
        or not any(map(cell.count, ":-/.T "))
        or not any(c.isdigit() for c in cell)
    ):
        return None
    return next(
        (name for name, forms in _FORMS.items() if any(form.fullmatch(cell) for form in forms)),
        None,
    )


def time_text_of(cells: Sequence[str], order: str | None = None) -> TimeText | None:
    """Return the format of a column's times from its first cells; None if they are not times.

    Args:
        cells: the first cells; empty ones are ignored, and one in ten may be something else.
        order: `dmy` or `mdy` for local dates, if a mapping gives it.
    """
    filled = [cell.strip() for cell in cells if cell.strip()]
    forms = [form_of(cell) for cell in filled]
    form = max(set(forms), key=forms.count, default=None)
    if form is None or forms.count(form) < _MOST * len(forms):
        return None
    filled = [cell for cell, found in zip(filled, forms) if found == form]
    if form == "local" and order is None and all(map(_DOTTED, filled)):
        order = "dmy"
    hours = form == "day" and all(_FORMS["day"][0].fullmatch(cell) for cell in filled)
    period = 0.0
    if form == "day":
        period = DAY if hours else HOUR
    return TimeText(form, order if form == "local" else None, period)


def counted_on(seconds: Array, period: float) -> tuple[Array, str | None]:
    """Return times of day (rows,) unwrapped past midnight, and a note.

    They are unwrapped where they fall by more than half a `period` (s).
    """
    known = np.flatnonzero(np.isfinite(seconds))
    falls = np.diff(seconds[known]) < -0.5 * period
    if not falls.any():
        return seconds, None
    turns = np.zeros(len(seconds))
    turns[known[1:]] = falls
    what = "midnight" if period == DAY else "the full hour"
    return seconds + period * np.cumsum(
        turns
    ), f"the time passes {what} {int(falls.sum())} times and counts on"


def common_order(parts: Sequence[Array]) -> str | None:
    """Return the day-month order of a log's parts, `dmy` or `mdy`; None if both give the same.

    Args:
        parts: the seconds (rows, 2) of the dates of each part, in both orders.

    Raises:
        TimeTextError: no order fits all parts, or the parts do not decide.
    """
    known = [both[~np.isnan(both).all(axis=1)] for both in parts]
    known = [both for both in known if len(both)]
    possible = [k for k in (0, 1) if not any(np.isnan(both[:, k]).any() for both in known)]
    if not possible:
        raise TimeTextError(
            "the dates of its parts are neither all day/month/year nor all month/day/year"
        )
    if len(possible) == 1:
        return ORDERS[possible[0]]
    if not known or not np.ptp(np.concatenate([both[:, 0] - both[:, 1] for both in known])):
        return None
    largest = []
    for k in possible:
        columns = sorted((both[:, k] for both in known), key=lambda column: float(column[0]))
        largest.append(float(np.abs(np.diff(np.concatenate(columns))).max(initial=0.0)))
    k = int(np.argmin(largest))
    if largest[1 - k] < _CLEARER * largest[k]:
        raise TimeTextError("the dates of its parts can be day/month/year or month/day/year")
    return ORDERS[k]


def around_the_clock(
    spans: Sequence[tuple[float, float]], period: float
) -> tuple[list[int], list[int]]:
    """Return the order of parts whose times restart after a period, and the turns to add to each.

    Of all orders on the circle of the clock, the one with the shortest longest pause is chosen.

    Args:
        spans: the first and the last time (s) of each part.
        period: s, of a day or an hour.
    """
    begins = [begin % period for begin, _ in spans]
    lengths = [end - begin for begin, end in spans]
    order = sorted(range(len(spans)), key=lambda k: begins[k])
    ways = []
    for first in range(len(order)):
        turned = [*order[first:], *order[:first]]
        start = [
            begins[k] + period * (place >= len(order) - first) for place, k in enumerate(turned)
        ]
        ends = [begin + lengths[k] for begin, k in zip(start, turned)]
        pauses = [begin - end for begin, end in zip(start[1:], ends)]
        ways.append((min(pauses, default=0.0) < 0.0, max(pauses, default=0.0), turned, start))
    _, _, turned, start = min(ways, key=lambda way: way[:2])
    turns = dict(
        zip(turned, (round((begin - spans[k][0]) / period) for begin, k in zip(start, turned)))
    )
    return turned, [turns[k] for k in range(len(spans))]


def _ordered(both: Array) -> tuple[Array, str | None]:
    """Return the times in the day-month order that the rows allow, and a note."""
    there = ~np.isnan(both).all(axis=1)
    possible = [not np.isnan(both[there, k]).any() for k in (0, 1)]
    if not any(possible):
        raise TimeTextError("the dates are neither all day/month/year nor all month/day/year")
    if not all(possible):
        k = possible.index(True)
        return both[:, k], f"the dates are {ORDER_WORDS[ORDERS[k]]}"
    largest = [float(np.abs(np.diff(both[there, k])).max(initial=0.0)) for k in (0, 1)]
    if not np.ptp(both[there, 0] - both[there, 1]):  # one date
        note = (
            "the date may be day/month or month/day; the time within the log is the same "
            "(time.date_order sets it)"
        )
        return both[:, 0], None if np.array_equal(both[there, 0], both[there, 1]) else note
    k = int(np.argmin(largest))
    if largest[1 - k] < _CLEARER * largest[k]:
        raise TimeTextError("the dates can be day/month/year or month/day/year")
    return both[:, k], f"the dates are {ORDER_WORDS[ORDERS[k]]}: in the other order they leap"


def seconds_of(
    found: re.Match[str], known: dict[tuple[str, ...], tuple[float, float]], unpadded: int
) -> tuple[float, float]:
    """Return the seconds of one time in both day-month orders; NaN for an impossible day."""
    part = found.groupdict()
    of_day = float(part.get("whole") or 0) + _of_day(part, unpadded)
    if part.get("y") is None:
        return of_day, of_day
    key = (part["a"], part.get("b") or part["name"], part["y"], "name" if part.get("name") else "")
    if key not in known:
        if len(known) > 10_000:
            known.clear()
        known[key] = _days(*key)
    zone = _zone(part.get("zone"))
    return known[key][0] * DAY + of_day - zone, known[key][1] * DAY + of_day - zone


def _of_day(part: dict[str, str | None], unpadded: int) -> float:
    hours, half = int(part.get("h") or 0), (part.get("half") or "").lower()
    if half:
        hours = hours % 12 + (12 if half == "p" else 0)
    minutes, seconds = int(part.get("mi") or 0), int(part.get("s") or 0)
    if hours > 24 or minutes > 59 or seconds > 60:
        return np.nan
    fraction = part.get("f") or part.get("ms")
    if fraction and unpadded:
        fraction = fraction.rjust(unpadded, "0")
    return 3600.0 * hours + 60.0 * minutes + seconds + (float("0." + fraction) if fraction else 0.0)


def _days(first: str, second: str, year: str, named: str) -> tuple[float, float]:
    """Return days since 1970 with two numbers as day and month, and as month and day."""
    y = int(year) + (2000 if len(year) == 2 else 0)
    if named:
        day = _day(y, _MONTHS[second[:3].lower()][0], int(first))
        return day, day
    one, two = int(first), int(second)
    return _day(y, two, one), _day(y, one, two)


def _day(year: int, month: int, day: int) -> float:
    try:
        return float(datetime.date(year, month, day).toordinal() - 719163)
    except ValueError:
        return np.nan


def _zone(text: str | None) -> float:
    """Return the offset of a time zone from UTC in s."""
    if text is None or text[0] not in "+-":
        return 0.0
    digits = text[1:].replace(":", "").ljust(4, "0")
    return (-1.0 if text[0] == "-" else 1.0) * (3600.0 * int(digits[:2]) + 60.0 * int(digits[2:]))
