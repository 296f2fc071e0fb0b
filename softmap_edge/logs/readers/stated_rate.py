"""Read the rate of a log from the lines above its table.

Examples: `Sample rate: 200 Hz`, `Delta_X<tab>0.005`, `# fs = 50`. Baud rates and heart rates do not
count. If lines state different rates, none of them counts. Pinned by
tests/logs/test_stated_rate.py.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

_LONG = 200  # characters of a line
_OF = (
    r"(?:sampl(?:e|ing)|capture|camera|frame|acquisition|logging|log|export|recording|video"
    r"|update)s?"
)
_BEGIN = rf"(?:^[\W_]*|[,;\t|][\W_]*|\b{_OF}[ _-]*)"
_NUMBER = r"[^\w+-]*(?P<number>\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?)\s*"
_RATE = re.compile(
    rf"{_BEGIN}(?:rate|frequency|freq|fs|fps|frames[ _]per[ _]second)\b\W*"
    rf"(?:(?:in[ _])?(?:k?hz|fps|1/s)\b)?{_NUMBER}"
    r"(?P<unit>k?hz|fps|1/s)?",
    re.IGNORECASE,
)
_STEP = re.compile(
    r"(?:\bdelta_x\b|\bsampl(?:e|ing)[ _-]*(?:interval|period|time)\b"
    r"|\btime[ _-]*step\b|^[\W_]*dt\b)"
    rf"\W*(?:(?P<before>ms|us|µs|s)\b)?{_NUMBER}(?P<unit>ms|us|µs|s)?\b",
    re.IGNORECASE,
)
_PLAIN = re.compile(r"\d{1,9}(?:[.,]\d{1,9})?")
_STEPS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
_ALLOWED = 1e-3, 1e6  # Hz
_SAME = 1e-3  # relative difference below which two rates are equal


def stated_rate(lines: Iterable[str]) -> float | None:
    """Return the rate (Hz) stated above a table; None if there is none, or several that differ."""
    found = [rate for line in lines if len(line) <= _LONG for rate in _rates(line)]
    found = [rate for rate in found if _ALLOWED[0] <= rate <= _ALLOWED[1]]
    return found[0] if found and max(found) - min(found) <= _SAME * max(found) else None


def rate_of(stated: dict[str, str], keys: Iterable[str]) -> tuple[str, float] | None:
    """Return the first of these keys whose cell in a head is a rate, and the rate in Hz."""
    for key in keys:
        found = _PLAIN.fullmatch(stated.get(key, "").strip())
        rate = float(found[0].replace(",", ".")) if found else 0.0
        if _ALLOWED[0] <= rate <= _ALLOWED[1]:
            return key, rate
    return None


def _rates(line: str) -> list[float]:
    rates = []
    for match in _RATE.finditer(line):
        kilo = 1e3 if (match["unit"] or "").lower().startswith("k") else 1.0
        rates.append(kilo * float(match["number"].replace(",", ".")))
    for match in _STEP.finditer(line):
        step = (
            float(match["number"].replace(",", "."))
            * _STEPS[(match["unit"] or match["before"] or "s").lower()]
        )
        rates += [1.0 / step] if step > 0 else []
    return rates
