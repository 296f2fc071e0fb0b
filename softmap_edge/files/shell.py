"""Words of command lines that a user can paste into a shell.

Pinned by tests/files/test_shell.py.
"""

from __future__ import annotations

import os
import shlex


def shell_word(text: str) -> str:
    """Return `text` quoted for a shell, on one line.

    Characters that do not print are written as escapes in `$'…'`.
    """
    if text.isprintable():
        return shlex.quote(text)
    return "$'" + "".join(_escaped(c) for c in text) + "'"


def shell_file(path: str | os.PathLike[str]) -> str:
    """Return a file's name quoted for a shell; one that begins with a dash gets `./` in front."""
    name = os.fspath(path)
    return shell_word(f"./{name}" if name.startswith("-") else name)


def _escaped(character: str) -> str:
    if character in "'\\":
        return f"\\{character}"
    if character.isprintable():
        return character
    return "".join(f"\\x{byte:02x}" for byte in character.encode("utf-8", "surrogateescape"))
