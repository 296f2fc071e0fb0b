"""Measure the lateness of the control loop on an emulated bus, at 1 kHz and with busy Python.

There is no peer: lateness is an absolute figure. The emulated servos share the machine, so the
result is an upper bound.
"""

from __future__ import annotations

import resource
import threading
import time
from contextlib import contextmanager

import numpy as np

from softmap_edge import _core
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.servo.home_mark import set_mark
from softmap_edge.robot.servo.loop_limits import loop_limits, servo_limits
from softmap_edge.robot.servo.rig import Rig, RigServo

MODEL, NUMBER, HOME = "XM430-W350", 1020, 2048
FAST, USUAL = (4_000_000, 1000.0), (1_000_000, 100.0)  # baud, periods per second


def rows(quick: bool) -> list[dict[str, object]]:
    """Return lateness at 1 kHz and 4 Mbaud (60 s), and at 100 Hz while Python computes."""
    return [
        *lateness("control loop, 1 kHz at 4 Mbaud", FAST, 5.0 if quick else 60.0, False),
        *lateness("control loop, 100 Hz, Python busy", USUAL, 5.0 if quick else 20.0, True),
    ]


def lateness(
    name: str, speed: tuple[int, float], seconds: float, busy: bool
) -> list[dict[str, object]]:
    """Drive two emulated servos for some seconds; return lateness and cost of the loop."""
    baud, rate = speed
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with _bench(baud, rate) as (rig, calibration, limits):
        begun = time.monotonic()
        with Controller(rig, calibration, limits) as robot:
            robot.engage()
            stop = threading.Event()
            thread = threading.Thread(target=_burn, args=(stop,))
            if busy:
                thread.start()
            warned = bool(robot.report.get("warnings"))
            first = time.monotonic()
            while (now := time.monotonic()) - first < seconds:
                t = now - first
                robot.target([1.5 * np.sin(2 * t), 1.5 * np.cos(2 * t)])
                time.sleep(0.02)
            stop.set()
            if busy:
                thread.join()
        ended, whole = robot.ended, time.monotonic() - begun
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    late, how = ended["late_us"], "without real-time rights" if warned else "with real-time rights"
    return [
        _row(f"{name}: p99.9 late, {how}", late["p99_9"] * 1e-3, "ms", f"below {1000.0 / rate:g}"),
        _row(f"{name}: periods missed of {ended['ticks']}", ended["overruns"], "", "0"),
        _row(f"{name}: share of a processor, start included", 100 * spent / whole, "%", "stated"),
    ]


def _row(name: str, value: float, unit: str, wanted: str) -> dict[str, object]:
    return {"name": name, "value": value, "unit": unit, "wanted": wanted}


@contextmanager
def _bench(baud: int, rate: float):
    """Return the rig, the map and the limits of an emulated bus."""
    servos = [(id, NUMBER, baud, float(HOME)) for id in (1, 2)]
    bus = _core.EmulatedBus(
        servos, [[(1000.0, -400.0), (2048.0, 0.0), (3000.0, 400.0)]] * 2, seed=1
    )
    try:
        driver = _core.ServoBus(bus.path, baud)
        for id in (1, 2):
            for address, value in ((64, b"\x00"), (11, b"\x05"), (9, b"\x00")):
                driver.write(id, address, value)
            set_mark(driver, id, HOME)
        driver.close()
        window = (-900.0, 900.0)
        calibration = Calibration.stated(
            np.eye(2) / 280.0, np.zeros(2), np.full(2, HOME), "bench", window
        )
        limits = loop_limits([servo_limits(MODEL, HOME, window)] * 2, rate)
        yield (
            Rig(bus.path, baud, tuple(RigServo(id, MODEL, HOME) for id in (1, 2))),
            calibration,
            limits,
        )
    finally:
        bus.unplug()


def _burn(stop: threading.Event) -> None:
    """Keep the interpreter busy."""
    total = 0
    while not stop.is_set():
        for k in range(10_000):
            total += k * k
