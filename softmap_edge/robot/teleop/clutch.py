"""When an operator drives the finger: only from a fresh press of the key, never by itself.

    released → waiting → driving → lost → released

A press waits up to PATIENCE for all that driving needs; if a part is lost, the press ends, and the
key must be let go and pressed again. Motion is relative: the hand's pose at the press stands for
where the finger is (u = 0 after slackening, the paper's), so that nothing jumps. Pinned by
tests/robot/test_clutch.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Stage = Literal["released", "waiting", "driving", "lost"]

PATIENCE = 1.0  # s for which a press waits for a hand, a gesture, or the guard


@dataclass(frozen=True)
class Clutch:
    """A stage, who holds the key, since when (s) it waits, and why it was lost."""

    stage: Stage = "released"
    who: str = ""
    since: float = 0.0
    why: str = ""

    def step(self, now: float, who: str, lacking: str) -> Clutch:
        """Return what follows at `now` s.

        Args:
            who: whose key is held, empty without one. lacking: what driving lacks, empty
                where nothing does.
        """
        if not who:
            return Clutch()
        if self.stage == "released":
            return Clutch("waiting", who, now).step(now, who, lacking)
        if self.stage == "lost":
            return self
        if who != self.who:
            return self.lose(f"{who} took hold while {self.who} held")
        if not lacking:
            return Clutch("driving", who, self.since)
        if self.stage == "driving" or now - self.since > PATIENCE:
            return self.lose(lacking)
        return Clutch("waiting", who, self.since, lacking)

    def lose(self, why: str) -> Clutch:
        """Return the stage after something went, or was asked for, that ends driving."""
        return (
            self
            if self.stage in ("released", "lost")
            else Clutch("lost", self.who, self.since, why)
        )
