"""Another program on the bus of an emulated rig: it leaves registers, or takes no lock
and talks on.
"""

import contextlib
import os
import subprocess
import sys
import threading
import time
import tty

from softmap_edge import _core
from softmap_edge.robot.servo.bus import patiently

HOLDS = (
    "import os, sys, time; os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); print('open', "
    "flush=True); time.sleep(60)"
)


def leave(path, baud, id=1, **values):
    """Write registers of a servo as another program leaves them; one that answers nothing is not
    waited for.
    """
    bus = _core.ServoBus(path, baud)
    for name, value in values.items():
        address, size, _ = _core.servo_registers()[name]
        with contextlib.suppress(Exception):
            patiently(bus.write, id, address, value.to_bytes(size, "little", signed=value < 0))
    bus.close()


@contextlib.contextmanager
def holding(path):
    """Let another process have the device `path` open, without a lock; gives it."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLDS, path], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "open\n"
        try:
            yield process
        finally:
            process.kill()


@contextlib.contextmanager
def talking(path, address, data, every=0.02, id=1):
    """Let a thread of this process, which is the one that emulates, write registers of a servo
    again and again.
    """
    file = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(file)
    packet = _core.servo_packet(id, 3, address.to_bytes(2, "little") + data)
    done = threading.Event()

    def talk():
        while not done.wait(every):
            with contextlib.suppress(OSError):
                os.write(file, packet)

    thread = threading.Thread(target=talk)
    thread.start()
    time.sleep(0.05)
    try:
        yield
    finally:
        done.set()
        thread.join()
        os.close(file)
