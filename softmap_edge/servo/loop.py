"""The process of the control loop: Rust alone once it runs. `python -m softmap_edge.servo.loop ORDERS REPORTS < setup`.

ORDERS and REPORTS are descriptors of pipes; the setup is a JSON document on standard input (`Controller`). What cannot
be started is told as a report `{"error": …}`.
"""

from __future__ import annotations

import json
import os
import sys

from softmap_edge import _core
from softmap_edge.errors import SoftmapError
from softmap_edge.teleop.landmarks_udp import read_key


def main() -> int:
    """Run the loop of the setup on standard input; 0 when its orders ended."""
    orders, reports = int(sys.argv[1]), int(sys.argv[2])
    told = os.dup(reports)  # the loop closes its own
    try:
        setup = json.load(sys.stdin)
        if setup["gpio"] is not None:
            setup["gpio"] = tuple(setup["gpio"])
        if setup["heartbeat"] is not None:
            host, port, key_file, timeout = setup["heartbeat"]
            setup["heartbeat"] = host, port, read_key(key_file), timeout
        _core.control_loop(orders, reports, **setup)
    except SoftmapError as fault:
        os.write(told, (json.dumps({"schema": "softmap.loop/1", "error": str(fault)}) + "\n").encode())
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
