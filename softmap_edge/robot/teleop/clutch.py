"""The clutch: the operator drives only after a fresh press of the enable key.

    released → waiting → driving → lost → released

A press waits up to PATIENCE for everything that driving needs. If a part is lost, the press ends;
the operator must release the key and press it again. Motion is relative, so that nothing jumps: the
hand's pose at the press corresponds to the current position of the finger. After slackening that is
u = 0, as in the paper. Pinned by tests/robot/test_clutch.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Stage = Literal["released", "waiting", "driving", "lost"]

PATIENCE = 1.0  # s for which a press waits for a hand, a gesture, or the guard


@dataclass(frozen=True)
class Clutch:
    """Stage of the clutch, holder of the key, start of the wait (s), and why driving was lost."""

    stage: Stage = "released"
    who: str = ""
    since: float = 0.0
    why: str = ""

    def step(self, now: float, who: str, lacking: str) -> Clutch:
        """Return the next stage at `now` s.

        Args:
            who: holder of the key; empty if it is not held
            lacking: what driving lacks; empty if nothing
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
        """Return the stage after a loss, or a request, that ends driving."""
        return (
            self
            if self.stage in ("released", "lost")
            else Clutch("lost", self.who, self.since, why)
        )
