"""Progress of long work: drawn on a terminal; silent if the output is not a terminal."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from softmap_edge.files.printable import printable, raw

_WIDTH, _LEFT = 30, 14
PACE = 3.0  # s of work from which the remaining time is estimated
QUIET = 8.0  # s without output after which long work reports that it continues


class Ticker:
    """Print lines, and progress in between; call it with the completed share of the last line."""

    def __init__(
        self, say: Callable[[str], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._say, self._clock, self._last = say, clock, clock()

    def say(self, text: str) -> None:
        """Print a line."""
        self._say(text)
        self._last = self._clock()

    def __call__(self, share: float) -> None:
        """Print the progress if nothing was printed for a while."""
        if self._clock() - self._last >= QUIET:
            self.say(f"  … solving, {share:.0%} of this part")


def _draw(text: str) -> None:
    """Write over the last line of the terminal."""
    print(f"\r{text}", end="", file=raw(sys.stderr), flush=True)


class Elapsed:
    """Show on one terminal line what is running and for how long; call it with lines that stay.

    For work that cannot state its completed share. The line is redrawn every `pace` seconds and
    cleared at the end; nothing is written if the output is not a terminal.
    """

    def __init__(
        self,
        what: str,
        silent: bool = False,
        clock: Callable[[], float] = time.monotonic,
        pace: float = 1.0,
    ) -> None:
        self._what, self._clock, self._pace = printable(what), clock, pace
        self._silent = silent or not sys.stderr.isatty()
        self._wide = 0  # of the drawn line
        self._lock, self._over = threading.Lock(), threading.Event()
        self._redraws = threading.Thread(target=self._redraw, name="elapsed", daemon=True)
        self._began = clock()

    def __enter__(self) -> Self:
        if not self._silent:
            self._redraws.start()
        return self

    def __call__(self, line: str) -> None:
        """Print a line above the drawn one."""
        if not self._silent:
            with self._lock:
                self._clear()
                print(printable(line), file=raw(sys.stderr), flush=True)

    def _redraw(self) -> None:
        while not self._over.wait(self._pace):
            with self._lock:
                text = f"{self._what} … {self._clock() - self._began:.0f} s"
                _draw(f"{text:<{self._wide}}")
                self._wide = len(text)

    def _clear(self) -> None:
        if self._wide:
            _draw(" " * self._wide + "\r")
        self._wide = 0

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._over.set()
        if not self._silent:
            self._redraws.join()
            self._clear()


class Bar:
    """Call it with (what, share in 0…1); it redraws one terminal line and clears it at the end.

    After a while it prints the remaining time of `what`. The estimate excludes work that was
    already done.
    """

    def __init__(self, silent: bool = False, clock: Callable[[], float] = time.monotonic) -> None:
        self._drawn = False
        self._silent = silent or not sys.stderr.isatty()
        self._clock = clock
        # what, its share and time at the start
        self._began: tuple[str, float, float] = ("", 0.0, 0.0)

    def __enter__(self) -> Self:
        return self

    def __call__(self, what: str, share: float) -> None:
        """Show that `what` is completed to `share`."""
        if self._silent:
            return
        full = round(_WIDTH * min(max(share, 0.0), 1.0))
        bar, left = f"[{'█' * full}{'·' * (_WIDTH - full)}]", self._left(what, share)
        _draw(f"{printable(what):<16} {bar} {share:4.0%}{left:<{_LEFT}}")
        self._drawn = True

    def _left(self, what: str, share: float) -> str:
        now = self._clock()
        if self._began[0] != what or share < self._began[1]:
            self._began = (what, share, now)
        done, seconds = share - self._began[1], now - self._began[2]
        if done <= 0.0 or seconds < PACE or share >= 1.0:
            return ""
        rest = seconds * (1.0 - share) / done
        unit, length = next(
            ((u, n) for u, n in (("h", 3600.0), ("min", 60.0)) if rest >= 1.5 * n), ("s", 1.0)
        )
        return f", {rest / length:.0f} {unit} left"

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._drawn:
            _draw(" " * (_WIDTH + 26 + _LEFT) + "\r")
