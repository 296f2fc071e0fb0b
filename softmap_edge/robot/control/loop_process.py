"""The process of the control loop; once started, it runs in Rust alone.

Its command is `python -m softmap_edge.robot.control.loop_process ORDERS REPORTS < setup`. ORDERS
and REPORTS are descriptors of pipes; the setup is a JSON document on standard input (`Controller`).

A failed start is reported as `{"error": …}`. This process checks set-up and homing of the servos as
late as possible; afterwards the guard detects a servo that loses its turns. Registers that a start
rewrites (a profile, gains) are reported as `{"mended": […]}`. If a fault invalidated the home, the
home marks are cleared at the end. Pinned by tests/robot/test_controller.py and
tests/robot/test_bad_input.py.
"""

from __future__ import annotations

import json
import os
import sys

from softmap_edge import _core
from softmap_edge.errors import SoftmapError
from softmap_edge.robot.control.session_mark import note_released
from softmap_edge.robot.link.session import read_key
from softmap_edge.robot.servo.bus import opened
from softmap_edge.robot.servo.examined import members_of, started
from softmap_edge.robot.servo.home_mark import check_confirmed, forget


def main() -> int:
    """Run the loop of the setup on standard input; return 0 when its orders end."""
    orders, reports = int(sys.argv[1]), int(sys.argv[2])
    reported_to = os.dup(reports)  # the loop closes its own descriptor
    try:
        setup = json.load(sys.stdin)
        homes, session = setup.pop("homes"), setup.pop("session", None)
        servos = members_of(setup["servos"], setup["limits"], setup.pop("gains", ()))
        if mended := started(setup["port"], setup["baud"], servos):
            _report(reported_to, mended=mended)
        if homes is not None:
            _check_home(setup["port"], setup["baud"], setup["servos"], homes)
        if setup["gpio"] is not None:
            setup["gpio"] = tuple(setup["gpio"])
        if setup["heartbeat"] is not None:
            host, port, key_file, timeout = setup["heartbeat"]
            setup["heartbeat"] = host, port, read_key(key_file), timeout
        if _core.control_loop(orders, reports, **setup):
            # a fault invalidated the home
            forget(setup["port"], setup["baud"], [id for id, _ in setup["servos"]])
        note_released(session)
    except SoftmapError as fault:
        _report(reported_to, error=str(fault))
        return 1
    return 0


def _report(pipe: int, **entries: object) -> None:
    os.write(pipe, (json.dumps({"schema": "softmap.loop/1"} | entries) + "\n").encode())


def _check_home(port: str, baud: int, servos: list[list[int]], homes: list[int | None]) -> None:
    with opened(port, baud) as bus:
        check_confirmed(bus, [(id, home) for (id, _), home in zip(servos, homes)])


if __name__ == "__main__":
    sys.exit(main())
