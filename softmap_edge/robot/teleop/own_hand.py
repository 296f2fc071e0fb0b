"""Follow the hand seen when the key was pressed: only it drives until the key is released.

A picture shows the same hand if palm, size and direction have changed no more than a hand can in
the time since it was last seen (time in which another hand is in view does not count). MediaPipe
sometimes takes a left hand for a right one for a picture or two, so a changed side alone counts
only if it lasts. Any other hand counts as no hand. The hand may come back if it was not gone for
longer than `eyes.SEEN`. Pinned by tests/robot/test_own_hand.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.robot.teleop.hand import INDEX_KNUCKLE, MIDDLE_KNUCKLE, WRIST, Hand, surest

Floats = NDArray[np.float64]

PALM = (WRIST, INDEX_KNUCKLE, MIDDLE_KNUCKLE, 13, 17)  # motion of the fingers does not move these
LENGTH = 2.0  # wrist to fingertip, in wrist to middle knuckle
# s: two pictures that are nearer in time are compared as if they were this far apart
PICTURE = 1.0 / 30.0
# hand lengths from a picture to the next, and a second beyond: 6 m/s and 2.4 m/s
LEAP, SPEED = 1.0, 12.0
# of the size (log), from a picture to the next, and a second beyond
GROWTH, GROWS = math.log(1.55), 3.0
TURN, TURNS = math.radians(75.0), math.radians(400.0)  # of its direction, likewise
FLAT = 0.5  # of the palm's size that wrist to knuckle must be long, for its direction to count
SIDES = 2  # pictures in which the other side counts as an error of the detector
ANOTHER = "another hand is in view"


class OwnHand:
    """Follow one hand from picture to picture; `other` is true if another is in its place."""

    def __init__(self) -> None:
        self.begin(None, -math.inf)

    def begin(self, hand: Hand | None, t: float) -> None:
        """Follow this hand, seen at `t` s; None follows the hand with the highest score."""
        self._last, self._t, self._side = hand, t, "" if hand is None else hand.side
        self._strange, self.other, self._until = 0, False, math.inf

    def among(self, hands: Sequence[Hand], t: float) -> Hand | None:
        """Return the followed hand among those in a picture at `t` s; None if it is not there.

        Args:
            hands: all hands that may drive. t: time of the picture, s.
        """
        hands = [hand for hand in hands if np.isfinite(hand.points).all()]
        if self._last is None:
            return surest(hands)
        last, since = self._last, max(min(t, self._until) - self._t - PICTURE, 0.0)
        same = [
            hand for hand in hands if _moved(last, hand, since if hand.side == self._side else 0.0)
        ]
        # The side decides between two hands in one picture, and how near they are where it does
        # not.
        own = min(same, key=lambda hand: (hand.side != self._side, _leap(last, hand)), default=None)
        if own is not None:
            self._strange = max(self._strange + (1 if own.side != self._side else -1), 0)
            self._strange = min(self._strange, SIDES + 1)
        if own is None or self._strange > SIDES:
            if hands:
                self.other, self._until = True, min(self._until, t)
            return None
        self._last, self._t, self.other, self._until = own, t, False, math.inf
        return own


def _moved(before: Hand, now: Hand, since: float) -> bool:
    """Return whether one hand can have moved so, in `since` s beyond the time of a picture."""
    grown = abs(math.log(max(_size(now), 1e-6) / max(_size(before), 1e-6)))
    if grown > GROWTH + GROWS * since or _leap(before, now) > LEAP + SPEED * since:
        return False
    return _turn(before, now) <= TURN + TURNS * since


def _leap(before: Hand, now: Hand) -> float:
    """Return how far the wrist moved, in lengths of the hand before."""
    moved = float(np.hypot(*(now.points[WRIST] - before.points[WRIST])))
    return moved / (LENGTH * max(_length(before), _size(before), 1e-6))


def _turn(before: Hand, now: Hand) -> float:
    """Return by how much its direction changed, rad; 0 where the palm is seen from its edge."""
    if any(_length(hand) < FLAT * _size(hand) for hand in (before, now)):
        return 0.0
    a, b = (hand.points[MIDDLE_KNUCKLE] - hand.points[WRIST] for hand in (before, now))
    return abs(math.atan2(float(a[0] * b[1] - a[1] * b[0]), float(a @ b)))


def _length(hand: Hand) -> float:
    """Return px from wrist to middle knuckle."""
    return float(np.hypot(*(hand.points[MIDDLE_KNUCKLE] - hand.points[WRIST])))


def _size(hand: Hand) -> float:
    """Return px of the palm in its longer direction: a hand that leans is shorter in one alone."""
    palm = hand.points[list(PALM)]
    return float(
        2.0 * np.linalg.svd(palm - palm.mean(axis=0), compute_uv=False)[0] / math.sqrt(len(palm))
    )
