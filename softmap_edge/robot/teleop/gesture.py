"""A gesture in addition to the enable key: it can release or be required, never replace the key.

`openness` is the mean c_f (hand.py) of the middle, ring and little finger, which are free while the
index finger drives. It is 0.65 to 1 for an open palm, and about 0 or below for a fist. Between
CLOSED and OPEN the previous state remains, so that a hand near a threshold does not flicker. A palm
tilted towards the camera looks shorter everywhere; the scale compensates that. Fingers that point
at the camera look folded, which releases. Pinned by tests/robot/test_gesture.py.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from softmap_edge.errors import TeleopError
from softmap_edge.robot.teleop.hand import Hand, projection

OTHER_FINGERS = ((9, 12), (13, 16), (17, 20))  # knuckle and tip of middle, ring and little finger
# openness above which the palm is open, and below which the hand is a fist
OPEN, CLOSED = 0.5, 0.25
DWELL = 0.2  # s for which a required gesture must last before it counts; its end counts at once
GAP = 0.5  # s without a frame after which a gesture must be shown again

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
    """The enable condition: always the key, and by `rule` also a gesture.

    `key`: the key alone. `fist releases`: a fist releases, until the key is released and pressed
    again. `open palm`, `fist`: this gesture must be shown as well, so that a lost hand releases.

    Raises:
        TeleopError: no such rule.
    """

    def __init__(self, rule: Rule = "fist releases") -> None:
        if rule not in get_args(Rule):
            raise TeleopError(
                f"enable key: no rule {rule!r:.40}; there are {', '.join(get_args(Rule))}"
            )
        self.rule = rule
        self._fist: bool | None = None  # None: unknown
        self._since: float | None = None  # s since which the required gesture is shown
        self._last: float | None = None  # s of the last call
        self._released = False

    def held(self, key: bool, hand: Hand | None, t: float) -> bool:
        """Return whether driving is enabled at `t` s (steady clock); call once per frame."""
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
        elif self._fist is None:  # nothing is assumed between the thresholds
            self._fist = straight < CLOSED if straight > OPEN or straight < CLOSED else None
        else:
            self._fist = straight < (OPEN if self._fist else CLOSED)
