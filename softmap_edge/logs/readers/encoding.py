"""Find the encoding of a text log by its first bytes: UTF-8, or UTF-16 and UTF-32 with or without a mark of byte order.

Text in UTF-16 without a mark has a zero byte next to nearly each letter, always on the same side. Pinned by
tests/test_encoding.py.
"""

from __future__ import annotations

import codecs
from pathlib import Path

_HEAD = 4096  # bytes that are looked at
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
PLAIN = "utf-8-sig"
_MOST = 0.9  # of the letters: so many have a zero byte


def encoding_of(path: Path) -> str:
    """Return the encoding of a text file, as Python names it; `utf-8-sig` if nothing shows another one.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        return encoding_of_start(file.read(_HEAD))


def encoding_of_start(start: bytes) -> str:
    """Return the encoding of a text that begins with these bytes."""
    for mark, name in _MARKS:
        if start.startswith(mark):
            return name
    start = start[: len(start) // 2 * 2]
    for name, zeros, letters in (("utf-16-le", start[1::2], start[::2]), ("utf-16-be", start[::2], start[1::2])):
        if len(zeros) > 3 and zeros.count(0) >= _MOST * len(zeros) and 0 not in letters:
            return name
    return PLAIN


def is_wide(encoding: str) -> bool:
    """Whether an encoding has zero bytes in ordinary text."""
    return not encoding.startswith("utf-8")
