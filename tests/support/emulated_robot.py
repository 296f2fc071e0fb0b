"""An emulated robot in a process of its own, for tests: `softmap servo emulate`, its camera
streaming here.
"""

import json
import subprocess
from contextlib import contextmanager

from command import SOFTMAP

from softmap_edge.robot.link.points import PointReceiver


@contextmanager
def emulated(folder, *more):
    """Start `softmap servo emulate` with a camera that streams here; gives its process, document
    and the receiver.
    """
    rig, bundle = folder / "rig.toml", folder / "bundle"
    with PointReceiver("", 0) as camera:
        argv = [
            *(SOFTMAP, "servo", "emulate", "--rig", str(rig)),
            *(
                "--calibrated",
                str(bundle),
                "--stream",
                f"udp://127.0.0.1:{camera.port}",
                *more,
                "--json",
            ),
        ]
        with subprocess.Popen(
            argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process:
            yield process, json.loads(process.stdout.readline()), camera
            process.communicate()
            assert process.returncode == 0


def say(process, line):
    process.stdin.write(line + "\n")
    process.stdin.flush()
