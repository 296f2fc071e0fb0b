"""Format times for messages, with enough digits to show how much they differ.

Pinned by tests/logs/test_import_publishers.py.
"""

from __future__ import annotations

LEAST, MOST = 6, 17  # digits that are printed
NEAR = 0.05  # of the smallest difference: how far a text may be off


def differing(*times: float) -> list[str]:
    """Return times (s) as texts, without exponents, that show how much they differ."""
    ordered = sorted(set(times))
    gaps = [after - before for before, after in zip(ordered, ordered[1:])]
    if not gaps and len(times) > 1:  # all digits that a clock may have
        return [_plain(time, MOST - 1) for time in times]
    for digits in range(LEAST, MOST):
        texts = [_plain(time, digits) for time in times]
        if not gaps or all(
            abs(float(text) - time) <= NEAR * min(gaps) for text, time in zip(texts, times)
        ):
            return texts
    return [_plain(time, MOST) for time in times]


def _plain(time: float, digits: int) -> str:
    """Return a time with at most `digits` digits; those before the point are always complete."""
    if not 1e-6 < abs(time) < 1e15:
        return f"{time:.{digits}g}"
    text = f"{time:.{max(0, digits - len(str(int(abs(time)))))}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
