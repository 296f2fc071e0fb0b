"""The index finger as two numbers, independent of the hand's position, rotation and distance.

    f = (p_mid − p_wrist) / |p_mid − p_wrist|     r = (f_y, −f_x)     d = p_tip − p_mcp
        s = |p_mid − p_wrist|
    c_f = d·f / s                                 c_r = d·r / s

This is the hand frame of the SoftMap paper ("Human Motion Capture"), in the image plane: wrist
(landmark 0), index knuckle (5) and tip (8), middle knuckle (9). c_f is 0.8 to 1 for a straight
finger and about 0 for a curled one. Three points differ from the paper. Landmarks are first
converted to pixels of the true aspect ratio; normalised per axis, c is wrong by up to 0.15. In the
formula y points up, so that r is to the right of f in the image. Where the paper adds ε to s, a
hand too small to have a direction is rejected. Pinned by tests/robot/test_hand.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.errors import TeleopError
from softmap_edge.run.fields import unmasked

Floats = NDArray[np.float64]
Side = Literal["left", "right"]

LANDMARKS = 21  # landmarks of a hand
WRIST = 0
INDEX_KNUCKLE = 5
INDEX_TIP = 8
MIDDLE_KNUCKLE = 9
# least px from wrist to middle knuckle: landmark noise of 1 to 2 px turns the frame by 10°
SMALLEST = 12.0
FARTHEST = 3.0  # hand scales: no finger is longer, so a longer one is a detection error
MOST_PIXELS = 1e5  # px from the corner: beyond any image


@dataclass(frozen=True, eq=False)
class Hand:
    """One hand in one image.

    `points` (21, 2) px are measured from the upper left corner, y down, square pixels. `side` is
    the hand as it appears in an unmirrored image, and `score` (0 to 1) the confidence in it.

    Raises:
        TeleopError: points of another shape, not finite, or beyond any image.
    """

    points: Floats
    side: Side
    score: float = 1.0

    def __post_init__(self) -> None:
        points = unmasked(self.points)
        if points.shape != (LANDMARKS, 2):
            raise TeleopError(
                f"hand: points of shape {points.shape}, expected {(LANDMARKS, 2)} in px"
            )
        if not (np.abs(points) <= MOST_PIXELS).all():  # also false for NaN
            raise TeleopError(
                f"hand: points hold NaN or lie beyond {MOST_PIXELS:g} px; give what was seen in a "
                "picture"
            )
        if self.side not in ("left", "right") or not 0.0 <= self.score <= 1.0:
            raise TeleopError(
                f"hand: side {self.side!r:.20}, score {self.score!r:.20}; expected left or right, "
                "0 to 1"
            )
        object.__setattr__(self, "points", points)


def in_pixels(normalised: ArrayLike, width: int, height: int) -> Floats:
    """Convert landmarks (21, 2 or 3), as shares of `width` and `height` px, to (21, 2) px."""
    return unmasked(normalised)[:, :2] * (width, height)


def projection(hand: Hand, finger: tuple[int, int] = (INDEX_KNUCKLE, INDEX_TIP)) -> Floats | None:
    """Return (c_f, c_r) of a finger from its knuckle and tip; None if they are not of a hand."""
    points = hand.points * (1.0, -1.0)  # y up
    forward = points[MIDDLE_KNUCKLE] - points[WRIST]
    scale = float(np.hypot(*forward))
    if scale < SMALLEST:
        return None
    f = forward / scale
    d = points[finger[1]] - points[finger[0]]
    found = np.array([d @ f, d @ (f[1], -f[0])]) / scale
    return found if np.abs(found).max() <= FARTHEST else None


def surest(hands: list[Hand]) -> Hand | None:
    """Return the hand with the highest score; None if there is none."""
    return max(hands, key=lambda hand: hand.score, default=None)


@dataclass(frozen=True)
class View:
    """How the camera sees the operator.

    `hand` is the hand that drives; `any` accepts either. `mirrored` states that the images are
    mirrored, as by many laptop cameras: then left and right are swapped back and c_r changes its
    sign.

    Raises:
        TeleopError: no such hand.
    """

    hand: Literal["any", "left", "right"] = "any"
    mirrored: bool = False

    def __post_init__(self) -> None:
        if self.hand not in ("any", "left", "right"):
            raise TeleopError(f"hand: {self.hand!r:.20} drives; choose any, left or right")

    def side(self, hand: Hand) -> Side:
        """Return which hand of the operator it is."""
        if not self.mirrored:
            return hand.side
        return "left" if hand.side == "right" else "right"

    def allowed(self, hands: list[Hand]) -> list[Hand]:
        """Return the hands that may drive."""
        return [hand for hand in hands if self.hand in ("any", self.side(hand))]

    def driving(self, hands: list[Hand]) -> Hand | None:
        """Return the hand with the highest score that may drive, or None."""
        return surest(self.allowed(hands))

    def projection(self, hand: Hand | None) -> Floats | None:
        """Return (c_f, c_r) of the index finger.

        c_r is positive towards the right of an unmirrored image.
        """
        seen = None if hand is None else projection(hand)
        return None if seen is None else seen * (1.0, -1.0 if self.mirrored else 1.0)


SIGNS = np.array([-1.0, 1.0])  # signs of the lateral and vertical command for +c_r and for curling


@dataclass(frozen=True, eq=False)
class HandMap:
    """Map (c_f, c_r) to the commands (u_lat, u_vert) of a model.

    The model is at rest in the pose at which the operator engaged. `command_range` (2, 2) is the
    lowest and highest value of each command (`Model.command_range`), and contains 0. `reach`
    (lateral, forward) is the change of c, in hand scales, that leads to the end of the range.
    `flip` selects the commands that change their sign. Without `flip`, pointing to the operator's
    right leads to the right. The camera faces the operator, so this is the left of its image
    (`SIGNS`).

    Raises:
        TeleopError: not two commands, a range without 0, or a reach that is not above 0.
    """

    command_range: Floats
    reach: tuple[float, float] = (0.35, 0.8)
    flip: tuple[bool, bool] = (False, False)

    def __post_init__(self) -> None:
        span = np.asarray(self.command_range, dtype=np.float64)
        if span.shape != (2, 2):
            raise TeleopError(
                f"hand: command_range of shape {span.shape}, expected (2, 2): a hand drives two "
                "commands"
            )
        if not (np.isfinite(span).all() and (span[:, 0] < 0).all() and (span[:, 1] > 0).all()):
            raise TeleopError(
                f"hand: command_range {span.tolist()}, expected LOW < 0 < HIGH for each of both "
                "commands"
            )
        if not (len(self.reach) == 2 and all(0 < reach < np.inf for reach in self.reach)):
            raise TeleopError(
                f"hand: reach {self.reach!r:.60}, expected two numbers above 0 in hand scales"
            )
        object.__setattr__(self, "command_range", span)

    def command(self, seen: ArrayLike, neutral: ArrayLike) -> Floats:
        """Return the commands (2,) for the observed `seen` (c_f, c_r).

        `neutral` is (c_f, c_r) when the operator engaged.

        Raises:
            TeleopError: either is not two finite numbers, as when no hand is seen.
        """
        both = np.array([np.asarray(seen, dtype=np.float64), np.asarray(neutral, dtype=np.float64)])
        if both.shape != (2, 2) or not np.isfinite(both).all():
            raise TeleopError(
                f"hand: {both.tolist()!s:.80} is not (c_f, c_r) twice; without a hand there is no "
                "command"
            )
        moved = (both[0] - both[1])[::-1] / self.reach * SIGNS * np.where(self.flip, -1.0, 1.0)
        low, high = self.command_range.T
        return np.asarray(np.clip(np.where(moved < 0, -low, high) * moved, low, high))
