"""A progress bar for long work: drawn on a terminal, silent where output is not watched."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

_WIDTH = 30
QUIET = 8.0  # s without a word after which long work says that it goes on


class Ticker:
    """Says lines, and between them a sign of life: call it with the share done of what was said last."""

    def __init__(self, say: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._say, self._clock, self._last = say, clock, clock()

    def say(self, text: str) -> None:
        """Say a line."""
        self._say(text)
        self._last = self._clock()

    def __call__(self, share: float) -> None:
        """Say how far the work is, if nothing was said for a while."""
        if self._clock() - self._last >= QUIET:
            self.say(f"  … solving, {share:.0%} of this part")


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
