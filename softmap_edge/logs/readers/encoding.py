"""Find the encoding of a text log: UTF-8, or Windows-1252 (latin-1) where it is clearly that.

Pinned by tests/test_encoding.py.
"""

from __future__ import annotations

import codecs
from functools import lru_cache
from pathlib import Path

from softmap_edge.errors import RunError

_BLOCK = 2**22  # bytes read at a time
_UNDEFINED = bytes(range(9)) + bytes(range(14, 32)) + b"\x7f\x81\x8d\x8f\x90\x9d"  # no text in Windows-1252
_FOREIGN = 0.1  # of the bytes: a log of numbers holds fewer letters beyond ASCII


def encoding_of(path: Path) -> tuple[str, str | None]:
    """Return the encoding of a text log, and a note if it is not UTF-8.

    Raises:
        OSError: the file cannot be read.
        RunError: it is text in neither encoding.
    """
    state = path.stat()
    return _encoding(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=64)
def _encoding(path: Path, changed: int, size: int) -> tuple[str, str | None]:
    decoder = codecs.getincrementaldecoder("utf-8")()
    line, before, pending = 1, 0, 0
    with path.open("rb") as file:
        while True:
            block = file.read(_BLOCK)
            try:
                decoder.decode(block, final=not block)
            except UnicodeDecodeError as fault:
                at = max(fault.start - pending, 0)  # the decoder held some bytes back
                return _other(path, line + block.count(b"\n", 0, at), before + at)
            if not block:
                return "utf-8-sig", None
            line, before, pending = line + block.count(b"\n"), before + len(block), len(decoder.getstate()[0])


def _other(path: Path, line: int, byte: int) -> tuple[str, str | None]:
    """Return the encoding of a file that is no UTF-8 at a line and byte; leave files with zero bytes to the reader."""
    high = size = odd = 0
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            if b"\0" in block:
                return "utf-8-sig", None
            high += len(block.translate(None, bytes(range(128))))
            odd += len(block) - len(block.translate(None, _UNDEFINED))
            size += len(block)
    if odd or high > _FOREIGN * size:
        raise RunError(
            f"{path}: line {line} (byte {byte} of the file) is not text in UTF-8, nor clearly in Windows-1252 "
            "(latin-1); save the log as UTF-8: `iconv -f ENCODING -t UTF-8 LOG > NEW`"
        )
    return "cp1252", f"line {line} is not UTF-8; the file was read as Windows-1252 (latin-1)"
