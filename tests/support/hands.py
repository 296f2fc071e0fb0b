"""Hands that are made: what a camera's landmarks would be of a hand that is curled, points aside,
or is turned.
"""

import numpy as np

from softmap_edge.robot.teleop.hand import Hand


def hand(curl=0.0, sideways=0.0, side="right", folded=0.0):
    """An upright hand of 100 px from wrist to middle knuckle, in a picture with y down; c_f = 0.9 −
    curl.
    """
    points = np.zeros((21, 2))
    points[0] = (320, 400)
    for k in range(4):  # index to little finger: knuckles in a row above the wrist
        knuckle = np.array([300.0 + 20 * k, 300.0])
        straight = 0.9 - (curl if k == 0 else folded)
        tip = knuckle + (100 * sideways if k == 0 else 0.0, -100 * straight)
        points[5 + 4 * k : 9 + 4 * k] = knuckle + np.linspace(0, 1, 4)[:, None] * (tip - knuckle)
    return Hand(points, side)


def turned(seen, degrees, scale=1.0, shift=(0.0, 0.0)):
    """The same hand turned about the middle of the picture, larger, and moved."""
    a = np.radians(degrees)
    turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    return Hand((seen.points - 320) @ turn.T * scale + 320 + shift, seen.side)
