"""Print once on stderr, for every command, each opened recording that is damaged or was cut short.

Such a command works with the sound part and returns 1. Pinned by tests/files/test_mcap_damage.py.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from typing import TextIO

from softmap_edge.errors import RecordingWarning, SessionWarning


@contextlib.contextmanager
def printing_warnings(verb: str) -> Iterator[set[str]]:
    """Print recording and session warnings as lines of a command.

    Yield the set of recording warnings.
    """
    printed: set[str] = set()
    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if not issubclass(category, RecordingWarning | SessionWarning):
                usual(message, category, filename, lineno, file, line)
            elif (text := str(message)) not in printed:
                from softmap_edge.commands.output import to_stderr  # loads numpy

                to_stderr(f"softmap {verb}: {text}")
                if issubclass(category, RecordingWarning):
                    printed.add(text)

        for category in (RecordingWarning, SessionWarning):
            warnings.filterwarnings("always", category=category)
        warnings.showwarning = show
        yield printed
