"""Find a text log's encoding: UTF-8, -16, -32, or Windows-1252 (latin-1) if clear.

UTF-16 and UTF-32 are also recognised without a byte order mark: nearly every letter has zero bytes
next to it, always on the same side. A file truncated within its last character is read up to that
character. Pinned by tests/logs/test_encoding.py and tests/logs/test_wide_encoding.py.
"""

from __future__ import annotations

import codecs
import io
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from softmap_edge.errors import RunError

_BLOCK = 2**22  # bytes read at a time
_HEAD = 4096  # bytes tested for UTF-16 and UTF-32
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
PLAIN = "utf-8-sig"
_MOST = 0.9  # of the letters that must have a zero byte
# bytes that do not occur in Windows-1252 text
_UNDEFINED = bytes(range(9)) + bytes(range(14, 32)) + b"\x7f\x81\x8d\x8f\x90\x9d"
_FOREIGN = 0.1  # of the bytes: a log of numbers has fewer letters beyond ASCII


def encoding_of(path: Path) -> tuple[str, str | None]:
    """Return the encoding of a text log, and a note if it is not UTF-8.

    Raises:
        OSError: the file cannot be read.
        RunError: it is text in none of these encodings.
    """
    with path.open("rb") as file:
        wide = encoding_of_start(file.read(_HEAD))
    if is_wide(wide):
        return wide, None
    state = path.stat()
    return _encoding(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=64)
def _encoding(path: Path, changed: int, size: int) -> tuple[str, str | None]:
    decoder = codecs.getincrementaldecoder("utf-8")()
    line, before, pending = 1, 0, 0
    with path.open("rb") as file:
        while True:
            block = file.read(_BLOCK)
            if not block:
                # remaining bytes in the decoder are a truncated character
                return PLAIN, None
            try:
                decoder.decode(block)
            except UnicodeDecodeError as fault:
                at = max(fault.start - pending, 0)  # the decoder held some bytes back
                return _other(path, line + block.count(b"\n", 0, at), before + at)
            line, before, pending = (
                line + block.count(b"\n"),
                before + len(block),
                len(decoder.getstate()[0]),
            )


def _other(path: Path, line: int, byte: int) -> tuple[str, str | None]:
    """Return the encoding of a file that is not UTF-8 at a line and byte.

    Files with zero bytes are left to the reader.
    """
    high = size = odd = 0
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            if b"\0" in block:
                return PLAIN, None
            high += len(block.translate(None, bytes(range(128))))
            odd += len(block) - len(block.translate(None, _UNDEFINED))
            size += len(block)
    if odd or high > _FOREIGN * size:
        raise RunError(
            f"{path}: line {line} (byte {byte} of the file) is not text in UTF-8, nor clearly in "
            "Windows-1252 (latin-1); save the log as UTF-8: `iconv -f ENCODING -t UTF-8 LOG > "
            "NEW`"
        )
    return "cp1252", f"line {line} is not UTF-8; the file was read as Windows-1252 (latin-1)"


def encoding_of_start(start: bytes) -> str:
    """Return the encoding of a text from its first bytes."""
    for mark, name in _MARKS:
        if start.startswith(mark):
            return name
    start = start[: len(start) // 4 * 4]
    for name, zeros, letters in (
        ("utf-32-le", start[1::4] + start[2::4] + start[3::4], start[::4]),
        ("utf-32-be", start[::4] + start[1::4] + start[2::4], start[3::4]),
    ):
        if len(letters) > 3 and zeros.count(0) >= _MOST * len(zeros) and 0 not in letters:
            return name
    for name, zeros, letters in (
        ("utf-16-le", start[1::2], start[::2]),
        ("utf-16-be", start[::2], start[1::2]),
    ):
        if len(zeros) > 3 and zeros.count(0) >= _MOST * len(zeros) and 0 not in letters:
            return name
    return PLAIN


def decoded(path: Path, encoding: str, size: int) -> Iterator[str]:
    """Yield a file's text in pieces up to its last complete character, with `\\n` as line ends.

    Args:
        path: the file.
        encoding: from `encoding_of`.
        size: bytes read at a time.

    Raises:
        OSError: the file cannot be read.
        UnicodeDecodeError: it holds bytes that are invalid in this encoding.
    """
    decoder = io.IncrementalNewlineDecoder(codecs.getincrementaldecoder(encoding)(), translate=True)
    with path.open("rb") as file:
        while block := file.read(size):
            if text := decoder.decode(block):
                yield text


def is_cut(path: Path) -> bool:
    """Return whether a text file ends within a character.

    Raises:
        OSError: the file cannot be read.
    """
    encoding, size = encoding_of(path)[0], path.stat().st_size
    unit = _unit_of(encoding)
    if size % unit:
        return True
    if unit == 4 or encoding not in (PLAIN, "utf-16", "utf-16-le", "utf-16-be"):
        return False
    with path.open("rb") as file:
        big = encoding == "utf-16-be" or (
            encoding == "utf-16" and file.read(2) == codecs.BOM_UTF16_BE
        )
        file.seek(max(size - 4, 0))
        tail = file.read(4)
    if unit == 2:
        return len(tail) > 1 and 0xD8 <= tail[-2 if big else -1] < 0xDC  # the first half of a pair
    for length, byte in enumerate(reversed(tail), 1):
        if byte < 0x80 or byte >= 0xC0:
            return byte >= 0xC0 and length < _length_from(byte)
    return False


def _unit_of(encoding: str) -> int:
    """Return the bytes of a code unit."""
    if encoding.startswith("utf-32"):
        return 4
    return 2 if encoding.startswith("utf-16") else 1


def _length_from(first: int) -> int:
    """Return the bytes of a UTF-8 character whose first byte is `first`, 0xC0 or above."""
    if first < 0xE0:
        return 2
    return 3 if first < 0xF0 else 4


def is_wide(encoding: str) -> bool:
    """Return whether ordinary text in an encoding has zero bytes."""
    return encoding.startswith(("utf-16", "utf-32"))
