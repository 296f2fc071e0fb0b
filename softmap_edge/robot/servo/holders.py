"""Find other programs that have a serial port open: without a lock, answers would be mixed up.

Linux lists the open files of the processes that this user may inspect (/proc/PID/fd). A program
that emulates servos has the other end of its pseudo-terminal open and does not count. Pinned by
tests/robot/test_holders.py.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from softmap_edge.errors import ServoError

PROC = Path("/proc")
LONGEST_NAME = 32  # characters of a program's name that are shown


@dataclass(frozen=True)
class Holder:
    """A program that has a port open."""

    pid: int
    name: str

    def __str__(self) -> str:
        return f"{self.name}, pid {self.pid}"


def holders(port: str, proc: Path = PROC) -> list[Holder]:
    """Return the other programs that have `port` open, as far as this user may see them.

    Args:
        port: path of the device
        proc: folder of the process list
    """
    try:
        device = os.stat(port)
    except OSError:
        return []
    if not stat.S_ISCHR(device.st_mode):
        return []
    found = []
    for pid in _others(proc):
        files = list(_terminals(proc / str(pid) / "fd"))
        holds = any(rdev == device.st_rdev for _, rdev in files)
        if holds and not any(_is_other_end(file, rdev, device.st_rdev) for file, rdev in files):
            found.append(Holder(pid, _name(proc / str(pid))))
    return found


def check_alone(port: str) -> None:
    """Raise ServoError where another program has the device `port` open."""
    if found := holders(port):
        raise ServoError(
            f"{port} is in use by another program ({' and '.join(map(str, found))}); close it first"
        )


def _others(proc: Path) -> list[int]:
    """Return the ids of all other processes."""
    try:
        return sorted({int(name) for name in os.listdir(proc) if name.isdigit()} - {os.getpid()})
    except OSError:
        return []


def _terminals(folder: Path) -> Iterator[tuple[Path, int]]:
    """Yield the open character devices of a process, with numbers; none without permission."""
    try:
        names = os.listdir(folder)
    except OSError:
        return
    for name in names:
        try:
            file = os.stat(folder / name)
        except OSError:
            continue
        if stat.S_ISCHR(file.st_mode):
            yield folder / name, file.st_rdev


def _is_other_end(file: Path, number: int, device: int) -> bool:
    """Return whether an open file is the other end of the pseudo-terminal `device`."""
    if (os.major(number), os.minor(number)) != (5, 2):  # /dev/ptmx
        return False
    try:
        message = (file.parents[1] / "fdinfo" / file.name).read_text("utf-8", "replace")
    except OSError:
        return False
    index = [line.split()[-1] for line in message.splitlines() if line.startswith("tty-index:")]
    return os.major(device) in range(136, 144) and index == [
        str((os.major(device) - 136) * 256 + os.minor(device))
    ]


def _name(process: Path) -> str:
    """Return the name of a process, without control characters."""
    try:
        name = (process / "comm").read_text("utf-8", "replace").strip()
    except OSError:
        name = ""
    return (
        "".join(letter if letter.isprintable() else "?" for letter in name)[:LONGEST_NAME]
        or "unnamed"
    )
