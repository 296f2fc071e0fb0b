"""Track the hand seen when the key was pressed; only it drives until the key is released.

Two images show the same hand if palm, size and direction changed no more than a hand can since it
was last seen. The time during which another hand is in view does not count. MediaPipe sometimes
confuses left and right for an image or two, so a changed side counts only if it lasts. Any other
hand counts as no hand. The hand may return within `hand_source.SEEN`. Pinned by
tests/robot/test_own_hand.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softmap_edge.robot.teleop.hand import INDEX_KNUCKLE, MIDDLE_KNUCKLE, WRIST, Hand, surest

Floats = NDArray[np.float64]

PALM = (WRIST, INDEX_KNUCKLE, MIDDLE_KNUCKLE, 13, 17)  # landmarks that finger motion does not move
LENGTH = 2.0  # wrist to fingertip, as a multiple of wrist to middle knuckle
# s: images closer in time are compared as if they were this far apart
PICTURE = 1.0 / 30.0
# allowed motion in hand lengths, between images and per s beyond: 6 m/s and 2.4 m/s
LEAP, SPEED = 1.0, 12.0
# allowed change of the size (log), between images and per s beyond
GROWTH, GROWS = math.log(1.55), 3.0
# rad: allowed change of direction, between images and per s beyond
TURN, TURNS = math.radians(75.0), math.radians(400.0)
FLAT = 0.5  # least length of wrist to knuckle, as a share of the palm's size, for a valid direction
SIDES = 2  # images for which another side counts as a detection error
ANOTHER = "another hand is in view"


class OwnHand:
    """Track one hand from image to image; `other` is true if another hand took its place."""

    def __init__(self) -> None:
        self.begin(None, -math.inf)

    def begin(self, hand: Hand | None, t: float) -> None:
        """Track this hand, seen at `t` s; None tracks the hand with the highest score."""
        self._last, self._t, self._side = hand, t, "" if hand is None else hand.side
        self._strange, self.other, self._until = 0, False, math.inf

    def among(self, hands: Sequence[Hand], t: float) -> Hand | None:
        """Return the tracked hand among those in an image at `t` s; None if it is not there.

        Args:
            hands: all hands that may drive
            t: time of the image, s
        """
        hands = [hand for hand in hands if np.isfinite(hand.points).all()]
        if self._last is None:
            return surest(hands)
        last, since = self._last, max(min(t, self._until) - self._t - PICTURE, 0.0)
        same = [
            hand for hand in hands if _moved(last, hand, since if hand.side == self._side else 0.0)
        ]
        # Of two hands in one image, take that of the same side; if this leaves two, the nearer one.
        own = min(same, key=lambda hand: (hand.side != self._side, _leap(last, hand)), default=None)
        if own is not None:
            self._strange = max(self._strange + (1 if own.side != self._side else -1), 0)
            self._strange = min(self._strange, SIDES + 1)
        if own is None or self._strange > SIDES:
            if hands:
                self.other, self._until = True, min(self._until, t)
            return None
        self._last = own
        self._t = t
        self.other = False
        self._until = math.inf
        return own


def _moved(before: Hand, now: Hand, since: float) -> bool:
    """Return whether one hand can move this far in `since` s beyond the time between two images."""
    grown = abs(math.log(max(_size(now), 1e-6) / max(_size(before), 1e-6)))
    if grown > GROWTH + GROWS * since or _leap(before, now) > LEAP + SPEED * since:
        return False
    return _turn(before, now) <= TURN + TURNS * since


def _leap(before: Hand, now: Hand) -> float:
    """Return how far the wrist moved, in lengths of the previous hand."""
    moved = float(np.hypot(*(now.points[WRIST] - before.points[WRIST])))
    return moved / (LENGTH * max(_length(before), _size(before), 1e-6))


def _turn(before: Hand, now: Hand) -> float:
    """Return the change of direction, rad; 0 if the palm is seen from its edge."""
    if any(_length(hand) < FLAT * _size(hand) for hand in (before, now)):
        return 0.0
    a, b = (hand.points[MIDDLE_KNUCKLE] - hand.points[WRIST] for hand in (before, now))
    return abs(math.atan2(float(a[0] * b[1] - a[1] * b[0]), float(a @ b)))


def _length(hand: Hand) -> float:
    """Return the distance from wrist to middle knuckle, px."""
    return float(np.hypot(*(hand.points[MIDDLE_KNUCKLE] - hand.points[WRIST])))


def _size(hand: Hand) -> float:
    """Return the palm's size in its longer direction, px: tilting shortens only one of the two."""
    palm = hand.points[list(PALM)]
    return float(
        2.0 * np.linalg.svd(palm - palm.mean(axis=0), compute_uv=False)[0] / math.sqrt(len(palm))
    )
