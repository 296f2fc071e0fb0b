"""An emulated rig for tests: two servos set up to be driven, at a pseudo-terminal."""

from contextlib import contextmanager

import numpy as np

from softmap_edge import _core
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.robot.servo.bus import patiently
from softmap_edge.robot.servo.home_mark import set_mark
from softmap_edge.robot.servo.loop_limits import loop_limits, servo_limits
from softmap_edge.robot.servo.rig import Rig, RigServo

MODEL, NUMBER, BAUD, HOME = "XL330-M288", 1200, 1_000_000, 2000
WINDOW = (-900.0, 900.0)
LOAD = [(1000.0, -400.0), (2000.0, 0.0), (3000.0, 400.0)]
TICKS_PER_MM = 280.0


def calibration():
    """Return a map of 280 ticks a mm about HOME."""
    return Calibration.stated(
        np.eye(2) / TICKS_PER_MM, np.zeros(2), np.full(2, HOME), "made for tests", WINDOW
    )


def set_up(path, ids=(1, 2), homes=(HOME, HOME)):
    """Set up and home as `softmap servo` does: mode 5, no return delay, homes confirmed."""
    bus = _core.ServoBus(path, BAUD)
    for id, home in zip(ids, homes):
        for address, value in ((64, b"\x00"), (11, b"\x05"), (9, b"\x00")):
            patiently(bus.write, id, address, value)  # on a busy machine an answer may come late
        set_mark(bus, id, home)
    bus.close()


@contextmanager
def emulated_rig(rate=200.0, load=LOAD, **changes):
    """Give an emulated bus whose horns carry `load` each, its rig and its limits."""
    servos = [(id, NUMBER, BAUD, float(HOME)) for id in (1, 2)]
    bus = _core.EmulatedBus(servos, [load, load], delay=0.01, lag=0.03, seed=3)
    set_up(bus.path)
    rig = Rig(bus.path, BAUD, tuple(RigServo(id, MODEL, HOME) for id in (1, 2)))
    limits = loop_limits([servo_limits(MODEL, HOME, WINDOW)] * 2, rate, **changes)
    try:
        yield bus, rig, limits
    finally:
        bus.unplug()


def torque(bus):
    """Return whether any servo has torque."""
    return any(on for _, on, *_ in bus.state()[1])


def angles(bus):
    """Return how far the horns have really turned, ticks."""
    return np.array([angle for angle, *_ in bus.state()[1]])
