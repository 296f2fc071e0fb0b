"""Find the numbers that a sensor of a condition (temperature, load) writes when it fails.

A DS18B20 writes -127 °C or, after power-up, 85 °C; a thermistor that is open writes -273.15 °C; a
converter writes its full scale. Such a number is equal to the last digit wherever it occurs, and
the column enters and leaves it only by a jump. It counts as an error if it is

    known      one of `KNOWN` temperatures, or one of `MARKS` (fills.py) far beyond all others; of
               loads only a negative one, for 999 g is a load; 85 °C that is held for long may be
               that of a hot session: it is kept and reported
    far        repeated in few rows, between others, farther from all of them than they differ

A temperature cannot jump and return, for the robot has heat to lose; in many rows it may be that of
another session. A load can: there the other numbers must be noisy, because a noisy scale repeats no
number and a typed load has no noise.
Pinned by tests/logs/test_sensor_errors.py.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.logs.fills import marked_missing
from softmap_edge.logs.mapping import Quantity
from softmap_edge.logs.table import LogTable

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

KNOWN = (-127.0, 85.0, -273.15)  # °C: DS18B20 without an answer and after power-up, open thermistor
_IMPOSSIBLE = (-127.0, -273.15)  # °C: no robot is so cold, so they are errors wherever they occur
_EQUAL = 1e-6  # °C, after a conversion from K
JUMPS = 2.0  # times the longest of the other steps: jumps of a known error
LEAPS = 5.0  # likewise, of another number
FAR = 2.0  # times the range of the other numbers
MOST = 4  # numbers of one column that are tested
LEAST, DIFFERENT = 5, 3  # other numbers in all, and different ones
FEW = 0.2  # of all rows: most that hold a number which is not a known error
NOISY = 0.5  # share of the other rows with a number of their own


def without_errors(
    name: str, table: LogTable, quantity: Quantity, notes: list[str], doubts: list[str]
) -> Array:
    """Return the raw rows (T, 1) of a condition with NaN at the errors of its sensor.

    Args:
        name: temperature or load.
        table: the log.
        quantity: its column, and the numbers that the mapping declares as errors.
        notes: receives the count of declared numbers.
        doubts: receives the count of numbers that were found.

    Raises:
        RunError: the sensor failed in every row.
    """
    raw = table.numbers(quantity.columns)
    if quantity.not_seen is None:
        return raw
    given = np.isin(raw[:, 0], quantity.not_seen)
    raw[given, 0] = np.nan
    if given.any():
        numbers = _listed(table.numbers(quantity.columns)[given, 0])
        notes.append(
            f"{name}: {numbers} in {int(given.sum())} of {len(raw)} rows: taken as missing, as "
            f"{name}.not_seen asks"
        )
    wrong = errors_of(raw[:, 0], name, quantity.unit)
    if (held := _held(raw[:, 0], name, quantity.unit)).any():
        doubts.append(
            f"{name}: exactly {_listed(raw[held, 0])} in {int(held.sum())} of {len(raw)} rows, "
            "one after the other, with a jump: a hot session, or a sensor that failed. Kept; "
            f"{name}.not_seen = [{_listed(raw[held, 0])}] takes it as missing"
        )
    if not wrong.any():
        return raw
    numbers, others = _listed(raw[wrong, 0]), raw[~wrong & np.isfinite(raw[:, 0]), 0]
    if not len(others):
        raise RunError(
            f"{table.path}: {name}: {table.name(quantity.columns[0])} is {numbers} in all "
            f"{int(wrong.sum())} rows, as a sensor writes when it fails; leave the column out, or "
            f'set {name}.not_seen = "keep" if it is the {name}'
        )
    doubts.append(
        f"{name}: exactly {numbers} in {int(wrong.sum())} of {len(raw)} rows, and "
        f"{others.min():.6g} to {others.max():.6g} in the others: an error of the sensor. Taken as "
        f'missing and interpolated; {name}.not_seen = "keep" keeps it'
    )
    raw[wrong, 0] = np.nan
    return raw


def errors_of(column: Array, name: str, unit: str) -> Mask:
    """Return which numbers (rows,) of a condition are errors of its sensor.

    Args:
        column: as in the log, NaN where missing.
        name: temperature or load.
        unit: of the column.
    """
    found = marked_missing(column) & ((name == "temperature") | (column < 0))
    known = np.zeros(len(column), np.bool_)
    if name == "temperature":
        celsius = column - (273.15 if unit == "K" else 0.0)
        known = _equal(celsius, KNOWN)
        if not (np.isfinite(column) & ~found & ~known).any():
            return np.asarray(found | _equal(celsius, _IMPOSSIBLE), np.bool_)
        found |= _equal(celsius, _IMPOSSIBLE)
    for number in _candidates(column, found, known):
        at, others = column == number, np.isfinite(column) & ~found & (column != number)
        sure = bool(known[at][0])
        session = sure and _is_session(at[at | others])
        if not session and _is_error(column, at, others, sure, name):
            found |= at
    return np.asarray(found, np.bool_)


def _held(column: Array, name: str, unit: str) -> Mask:
    """Return which numbers (rows,) are a known error, or the temperature of a hot session."""
    held = np.zeros(len(column), np.bool_)
    if name != "temperature":
        return held
    celsius = column - (273.15 if unit == "K" else 0.0)
    known = _equal(celsius, KNOWN) & ~_equal(celsius, _IMPOSSIBLE)
    for number in np.unique(column[known]):
        at, others = column == number, np.isfinite(column) & (column != number)
        if _is_session(at[at | others]) and _is_error(column, at, others, True, name):
            held |= at
    return held


def _is_session(at: Mask) -> bool:
    """Return whether some of the rows (n,) follow each other for so long that a session is as likely."""
    ends = np.flatnonzero(np.diff(np.r_[False, at, False]))
    return int((ends[1::2] - ends[::2]).max()) > FEW * len(at)


def never_read(name: str, unit: str | None, raw: Array) -> str | None:
    """Return what the raw rows (T, 1) of a condition are if all are errors of its sensor."""
    known = raw[np.isfinite(raw[:, 0]), 0]
    if not len(known) or not errors_of(known, name, unit or "").all():
        return None
    return f"{_listed(known)} in all rows, as a sensor writes when it fails"


def _equal(celsius: Array, numbers: tuple[float, ...]) -> Mask:
    """Return which temperatures (rows,) °C equal one of some numbers."""
    return np.asarray((np.abs(celsius[:, None] - np.array(numbers)) < _EQUAL).any(axis=1), np.bool_)


def _candidates(column: Array, found: Mask, known: Mask) -> list[float]:
    """Return the numbers to test: known errors, then repeated numbers far from the middle."""
    numbers, count = np.unique(column[np.isfinite(column) & ~found], return_counts=True)
    if not len(numbers):
        return []
    several = numbers[count > 1]
    away = np.abs(several - np.median(column[np.isfinite(column) & ~found]))
    far = several[np.argsort(-away, kind="stable")[:MOST]]
    return list(dict.fromkeys([*np.unique(column[known & ~found]).tolist(), *far.tolist()]))


def _is_error(column: Array, at: Mask, others: Mask, known: bool, name: str) -> bool:
    """Return whether the rows `at` of a column (rows,), which hold one number, are errors."""
    rest = column[others]
    if len(rest) < LEAST:
        return False
    shown = at | others
    row, inside = column[shown], at[shown]
    step = np.abs(np.diff(row))
    usual, into = step[~inside[1:] & ~inside[:-1]], step[inside[1:] != inside[:-1]]
    if not len(usual) or not len(into) or into.min() <= (JUMPS if known else LEAPS) * usual.max():
        return False
    if known:
        return True
    numbers, count = np.unique(rest, return_counts=True)
    away = float(np.abs(rest - row[inside][0]).min())
    if inside.mean() > FEW or len(numbers) < DIFFERENT or away <= FAR * float(np.ptp(rest)):
        return False
    noisy = float((count == 1).sum()) > NOISY * len(rest)
    return _between(inside) and (noisy or name == "temperature")


def _between(inside: Mask) -> bool:
    """Return whether a stretch of rows (n,) has other rows on both sides."""
    known = np.flatnonzero(~inside)
    return bool(inside[known[0] : known[-1]].any())


def _listed(numbers: Array) -> str:
    """Return the different numbers for a message."""
    return " and ".join(f"{number + 0.0:.10g}" for number in np.unique(numbers)[:MOST])
