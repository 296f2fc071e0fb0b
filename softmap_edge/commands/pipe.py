"""Standard streams that outlive their reader.

After `head` closes the pipe, a command still writes its files.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any, TextIO


class Outliving:
    """A stream that discards its output once the reader has closed the pipe."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write `text`; return the number of characters."""
        try:
            return int(self._stream.write(text))
        except BrokenPipeError:
            self._give_up()
            return len(text)

    def flush(self) -> None:
        """Write out the buffer."""
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._give_up()

    def _give_up(self) -> None:
        """Redirect the stream, with its buffer, to the null device."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def outliving() -> Iterator[None]:
    """Let standard output and standard error outlive their readers."""
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (None if one is None else Outliving(one) for one in streams)
    try:
        yield
    finally:
        for one in (sys.stdout, sys.stderr):
            if one is not None:
                one.flush()
        sys.stdout, sys.stderr = streams
