"""A progress bar for long work: drawn on a terminal, silent where output is not watched."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Self

_WIDTH = 30


class Bar:
    """Call it with (what, share in 0…1); it redraws one line on a terminal and clears it at the end."""

    def __init__(self, silent: bool = False) -> None:
        self._drawn = False
        self._silent = silent or not sys.stderr.isatty()

    def __enter__(self) -> Self:
        return self

    def __call__(self, what: str, share: float) -> None:
        """Show that `what` is done to `share` of its length."""
        if self._silent:
            return
        full = round(_WIDTH * min(max(share, 0.0), 1.0))
        print(f"\r{what:<16} [{'█' * full}{'·' * (_WIDTH - full)}] {share:4.0%}", end="", file=sys.stderr, flush=True)
        self._drawn = True

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._drawn:
            print("\r" + " " * (_WIDTH + 26) + "\r", end="", file=sys.stderr, flush=True)
