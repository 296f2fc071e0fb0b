"""Waiting for what a thread, a process or a robot does in its own time, with limits that a busy
machine meets.
"""

import time


def until(what, seconds=20.0):
    """Wait until `what()`; the seconds it took."""
    begin = time.monotonic()
    while not what():
        assert time.monotonic() - begin < seconds, f"not within {seconds} s"
        time.sleep(0.005)
    return time.monotonic() - begin


def hold_for(robot, u, seconds):
    """Send the command `u` for some seconds."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        robot.target(u)
        time.sleep(0.02)
