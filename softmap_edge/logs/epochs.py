"""Find the unit and the epoch of integer counts of time: only a plausible date is accepted.

Unix time counts from 1970, Windows FILETIME from 1601 and .NET ticks from year 1, both in 100 ns.
Pinned by tests/logs/test_epochs.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.time_keys import TIME

Array = NDArray[np.float64]
YEARS = (1990, 2100)  # of a plausible date
LEAST = 1e8  # a smaller count is not a date in any unit
_YEAR = 365.2425 * 86400.0  # s
_SLOWEST = 1000.0  # s between rows
_FILETIME, _TICKS = -11_644_473_600.0, -62_135_596_800.0  # their epochs, s after 1970


@dataclass(frozen=True)
class Reading:
    """A unit of counts, and the epoch from which they count."""

    unit: str
    epoch_s: float  # after 1970
    says: str
    first_year: int = YEARS[0]


READINGS = (
    *(Reading(unit, 0.0, f"it counts {unit} since 1970") for unit in ("s", "ms", "us")),
    # no log of 1990 counted ns, and .NET ticks of today would be such a date
    Reading("ns", 0.0, "it counts ns since 1970", first_year=2000),
    Reading("100ns", _FILETIME, "it counts 100 ns since 1601, as Windows FILETIME does"),
    Reading("100ns", _TICKS, "it counts 100 ns since year 1, as ticks of .NET do"),
)


def readings_of(known: Array, step: float) -> list[Reading]:
    """Return the readings of counts (rows,) that give dates from 1990 to 2100.

    Args:
        known: the counts, without missing ones.
        step: the usual step between rows.
    """
    low, high = float(known.min()), float(known.max())
    return [
        one
        for one in READINGS
        if _year(low, one) >= one.first_year
        and _year(high, one) <= YEARS[1]
        and step * TIME[one.unit] < _SLOWEST
    ]


def _year(count: float, reading: Reading) -> float:
    return 1970.0 + (count * TIME[reading.unit] + reading.epoch_s) / _YEAR


def without_date(known: Array, step: float) -> bool:
    """Return whether counts (rows,) are as large as a date, and no reading is plausible."""
    largest = float(np.abs(known).max())
    dated = any(
        largest > limit and step * TIME[unit] < _SLOWEST
        for limit, unit in ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (LEAST, "s"))
    )
    return dated and len(readings_of(known, step)) != 1
