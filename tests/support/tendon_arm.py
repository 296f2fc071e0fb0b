"""A robot of two segments and six tendons whose numbers are known, and its runs."""

import numpy as np

from softmap_edge import Robot, Run

ARM = """
schema = "softmap.robot/1"
name = "arm"
[body]
segments = 2
length_mm = [70, 50]
stiffness_mm2 = [8, 5]
base_mm = [0, 0, 5]
tilt_deg = [2, -1]
markers = [1, 1.5, 2]
[tendons]
segment = [1, 1, 1, 2, 2, 2]
angle_deg = [0, 120, 240, 60, 180, 300]
radius_mm = 6
pretension_mm = 0.5
slack = 0.0
[fit]
angle = "each"
radius = "shared"
stiffness = "each"
length = "each"
base = "height"
tilt = "fitted"
"""
ROUGH = {
    "length_mm = [70, 50]": "length_mm = 60",
    "stiffness_mm2 = [8, 5]": "stiffness_mm2 = 20",
    "base_mm = [0, 0, 5]": "base_mm = 0",
    "tilt_deg = [2, -1]": "",
    "angle_deg = [0, 120, 240, 60, 180, 300]": "angle_deg = [20, 100, 250, 40, 200, 290]",
    "radius_mm = 6": "radius_mm = 5",
}


def arm(**changed):
    """Return the arm; `changed` replaces lines of its file."""
    text = ARM
    for old, new in changed.items():
        assert old in text
        text = text.replace(old, new)
    return Robot.from_toml(text)


def moves(t, channels=6):
    """Return commands (T, C) mm that fill ±6 mm, each at its own pace, without repeating in two
    minutes.
    """
    pace = 0.31 + 0.13 * np.arange(channels)
    return 6.0 * np.sin(pace * t[:, None] + np.arange(channels))


def recorded(robot, drive=moves, seconds=90.0, rate=20.0, noise=0.0, **more):
    """Return a run of the robot as its file describes it."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    channels = robot.layout.channels
    markers = robot.layout.compiled(robot.start).evaluate(drive(t, channels)).reshape(len(t), -1, 3)
    markers = markers + noise * np.random.default_rng(7).normal(size=markers.shape)
    gravity = np.array([0.0, 0.0, 1.0])
    return Run(t=t, command=moves(t, channels), t_seen=t, markers=markers, gravity=gravity, **more)
