"""Format the numbers of reports: lengths, shares, bars, folded lines."""

from __future__ import annotations

import math
import re
import textwrap

from softmap_edge.files.atomic import finite

WIDTH = 100  # characters of a line
BAR = 28
# larger numbers are written as powers of ten, so a diverged fit does not fill the screen
LARGEST = 1e6
LONG_NUMBER = re.compile(r"(?<![\w.])([+-]?)([1-9]\d{6,})(?:\.\d*)?(?!\w)")
EIGHTHS = " ▏▎▍▌▋▊▉█"


def bar(value: float, scale: float, width: int = BAR) -> str:
    """Return a bar of eighth blocks, `width` characters long at `value == scale`.

    It is empty for values that are not finite.
    """
    if not math.isfinite(value) or not math.isfinite(scale) or scale <= 0 or value <= 0:
        return ""
    eighths = max(1, round(min(value / scale, 1.0) * width * 8))
    return "█" * (eighths // 8) + (EIGHTHS[eighths % 8] if eighths % 8 else "")


def mm(value: object) -> str:
    """Return a length with three figures ('0.123', '12.3'), or '–' if unknown."""
    if not finite(value):
        return "–"
    if abs(value) >= LARGEST:
        return f"{value:.1e}"
    if abs(value) < 1:
        return f"{value:.3f}"
    return f"{value:.2f}" if abs(value) < 10 else f"{value:.1f}"


def fall(before: float, after: float, floor: float | None = None) -> float | None:
    """Return the share by which the error above `floor` (default 0) falls, at most 1.

    An error below the floor is noise, so all that could be removed is gone. None if no error
    exceeds the floor.
    """
    base = floor or 0.0
    removable = before - base
    if removable <= 0 or not math.isfinite(after):
        return None
    return min(1.0, (before - after) / removable)


def percent(share: object) -> str:
    """Return a share as '87 %', or '–' if unknown."""
    known = number(share)
    if known is None:
        return "–"
    return f"{100 * known:.0f} %" if abs(100 * known) < LARGEST else f"{100 * known:.1e} %"


def number(value: object) -> float | None:
    """Return a finite number as a float, anything else as None."""
    return float(value) if finite(value) else None


def tamed(text: object) -> str:
    """Return a sentence with large numbers written as powers of ten.

    These have seven digits or more, as in '+1.2e+31 % in mm'.
    """

    def short(found: re.Match[str]) -> str:
        sign, digits = found.groups()
        power = len(digits) - 1  # by hand: 400 digits exceed a float
        leading = f"{int(digits[:6]) / 1e5:.1f}"
        return (
            f"{sign}1.0e+{power + 1:02d}" if leading == "10.0" else f"{sign}{leading}e+{power:02d}"
        )

    return LONG_NUMBER.sub(short, str(text))


def folded(text: str, indent: int, hang: int = 0) -> list[str]:
    """Return lines of at most `WIDTH`, indented; all but the first by `hang` more."""
    pad = " " * indent
    return textwrap.wrap(text, WIDTH, initial_indent=pad, subsequent_indent=pad + " " * hang)
