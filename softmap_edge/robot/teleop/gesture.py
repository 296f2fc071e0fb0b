"""A gesture in addition to the enable key.

It can release, or be required as well, and never replaces the key.

`openness` is the mean c_f (hand.py) of middle, ring and little finger, which the driving index
finger leaves alone: 0.65 to 1 for an open palm, about 0 or below for a fist. Between CLOSED and
OPEN whatever was there before stays, so that a hand near one threshold does not flicker. A palm
that leans towards the camera looks shorter everywhere, which the scale takes out; fingers that
point at the camera look folded, which lets go. Pinned by tests/robot/test_gesture.py.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from softmap_edge.errors import TeleopError
from softmap_edge.robot.teleop.hand import Hand, projection

OTHER_FINGERS = ((9, 12), (13, 16), (17, 20))  # knuckle and tip of middle, ring and little finger
OPEN, CLOSED = 0.5, 0.25  # openness above which a palm is open, and below which a hand is a fist
DWELL = 0.2  # s for which an asked gesture must last before it counts; letting go is at once
GAP = 0.5  # s without a picture, after which a gesture must be shown again

Rule = Literal["key", "fist releases", "open palm", "fist"]


def openness(hand: Hand) -> float | None:
    """Return how straight the three other fingers are, in hand scales; None if not seen."""
    seen = [projection(hand, finger) for finger in OTHER_FINGERS]
    return (
        None
        if any(c is None for c in seen)
        else float(np.mean([c[0] for c in seen if c is not None]))
    )


class Deadman:
    """Whether the operator holds on: the key always, and by `rule` what the hand shows.

    `key`: the key alone. `fist releases`: as the key, but a fist lets go until the key is let go
    and pressed again. `open palm`, `fist`: the key, and this gesture for as long as it is held;
    without a hand nothing is held.

    Raises:
        TeleopError: no such rule.
    """

    def __init__(self, rule: Rule = "fist releases") -> None:
        if rule not in get_args(Rule):
            raise TeleopError(
                f"enable key: no rule {rule!r:.40}; there are {', '.join(get_args(Rule))}"
            )
        self.rule = rule
        self._fist: bool | None = None  # None: not known yet
        self._since: float | None = None  # s, since when the asked gesture is shown
        self._last: float | None = None  # s, of the newest call
        self._released = False

    def held(self, key: bool, hand: Hand | None, t: float) -> bool:
        """Return whether the operator holds at `t` s, a steady clock; call once per picture."""
        if self._last is None or not 0.0 <= t - self._last <= GAP:
            self._fist, self._since = None, None
        self._last = t
        self._look(hand)
        if self.rule == "key":
            return key
        if self.rule == "fist releases":
            self._released = key and (self._released or self._fist is True)
            return key and not self._released
        if self._fist is not (self.rule == "fist"):
            self._since = None
            return False
        self._since = t if self._since is None else self._since
        return key and t - self._since >= DWELL

    def _look(self, hand: Hand | None) -> None:
        straight = None if hand is None else openness(hand)
        if straight is None:
            self._fist = None
        elif self._fist is None:  # between the thresholds nothing is taken for granted
            self._fist = False if straight > OPEN else True if straight < CLOSED else None
        else:
            self._fist = straight < (OPEN if self._fist else CLOSED)
