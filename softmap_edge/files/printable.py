"""Escape control characters, bidirectional marks and surrogates in displayed text.

Names and paths come from files and arguments of unknown origin. Unescaped, they could move the
cursor, recolour the terminal, forge a line or fail to encode. Escapes have the form of JSON
(`\\u001b`), so JSON documents stay valid. Pinned by tests/files/test_printable.py.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable
from typing import Any, TextIO

from softmap_edge.errors import one_line, plain_line, printable, shortened

__all__ = [
    "PrintableStream",
    "listed",
    "one_line",
    "plain_line",
    "printable",
    "raw",
    "shell_file",
    "shell_word",
    "shortened",
]

LONGEST_NAME = 100  # characters of a listed name


def listed(items: Iterable[object], most: int, longest: int = LONGEST_NAME) -> str:
    """Return the first `most` items with commas between them, and the number of the others.

    Each is one printable line of at most `longest` characters.
    """
    texts = [shortened(one_line(str(item)), longest) for item in items]
    return ", ".join(texts[:most]) + (f" and {len(texts) - most} more" if len(texts) > most else "")


class PrintableStream:
    """Wrap the text stream `raw` so that only printable characters are written.

    All other calls are passed on.
    """

    def __init__(self, raw: TextIO) -> None:
        self.raw = raw

    def write(self, text: str) -> int:
        """Write `text`, escaped where needed; return its length."""
        self.raw.write(printable(text))
        return len(text)

    def writelines(self, lines: list[str]) -> None:
        """Write each line."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.raw, name)


def raw(stream: TextIO) -> TextIO:
    """Return the stream behind a `PrintableStream`, for output that moves the cursor on purpose."""
    return stream.raw if isinstance(stream, PrintableStream) else stream


def shell_word(text: str) -> str:
    """Return `text` quoted for a shell, on one line.

    Characters that do not print are written as escapes in `$'…'`.
    """
    if text.isprintable():
        return shlex.quote(text)
    return "$'" + "".join(_shell_escape(c) for c in text) + "'"


def shell_file(path: str | os.PathLike[str]) -> str:
    """Return a file's name quoted for a shell; one that begins with a dash gets `./` in front."""
    name = os.fspath(path)
    return shell_word(f"./{name}" if name.startswith("-") else name)


def _shell_escape(character: str) -> str:
    if character in "'\\":
        return f"\\{character}"
    if character.isprintable():
        return character
    return "".join(f"\\x{byte:02x}" for byte in character.encode("utf-8", "surrogateescape"))
