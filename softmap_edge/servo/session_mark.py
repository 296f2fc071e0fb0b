"""A mark of the session that drives a bench, so that the next start can report how the last one ended.

A session leaves the mark in the user's state folder when it begins and takes it away when it ends in order. A program
that is killed, and a computer that stops, leave it there. The loop outlives a killed program and notes in the mark that
it has released the servos. Emulated robots at pseudo-terminals have no next start and get no mark. Nothing here stops a
start: where the folder cannot be written there is no mark. Pinned by tests/test_session_mark.py.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
import warnings
import zlib
from pathlib import Path
from typing import Any

from softmap_edge.errors import SessionWarning

EMULATED = "/dev/pts/"
RELEASED = "released"
_MOST = 1 << 16  # bytes of a mark that are read
_NAME = 80  # characters of a program's or a file's name that are printed


def mark_file(port: str) -> Path | None:
    """Return the file of the mark of the bench at `port`; None for one that has no next start."""
    device = os.path.realpath(port)
    if device.startswith(EMULATED):
        return None
    state = os.environ.get("XDG_STATE_HOME")
    folder = Path(state) if state else Path.home() / ".local/state"
    return folder / "softmap" / f"session-{zlib.crc32(device.encode()):08x}.json"


def path_of(port: str) -> str | None:
    """Return the path of the mark, for the process of the loop."""
    file = mark_file(port)
    return None if file is None else str(file)


def report_last(port: str) -> None:
    """Give a `SessionWarning` where the last session at `port` did not end in order."""
    file = mark_file(port)
    if file is not None and (said := last_session(file)) is not None:
        warnings.warn(SessionWarning(said), stacklevel=3)


def begin(port: str, record: Path | None, loop: int) -> Path | None:
    """Leave the mark of this session, whose control loop is the process `loop`; return its file, None without one."""
    file = mark_file(port)
    if file is None:
        return None
    about = {
        "port": port,
        "program": Path(sys.argv[0] or "python").name,
        "pid": os.getpid(),
        "loop_pid": loop,
        "boot": _boot(),
        "begun": time.time(),
        "record": None if record is None else str(record.absolute()),
    }
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(about) + "\n", "utf-8")
    return file


def note_released(file: str | None) -> None:
    """Note that the loop has ended and released the servos; a mark that is not there stays so."""
    if file is not None and os.path.exists(file):
        with contextlib.suppress(OSError), open(file, "a", encoding="utf-8") as stream:
            stream.write(json.dumps({"loop": RELEASED}) + "\n")


def end(file: Path | None) -> None:
    """Take the mark away: the session ended in order, or its program was told how it ended."""
    if file is not None:
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)


def last_session(file: Path) -> str | None:
    """Return how the last session ended where it did not end in order; None where it did, or still runs."""
    try:
        with open(file, encoding="utf-8") as stream:
            lines = [json.loads(line) for line in stream.read(_MOST).splitlines()]
        about, released = lines[0], any(line.get("loop") == RELEASED for line in lines[1:])
        begun = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(float(about["begun"])))
        restarted = about["boot"] != _boot()
        if not restarted and _runs(int(about["pid"])):
            return None
        loop_runs = not restarted and _runs(int(about["loop_pid"]))
        program, record = _printable(about["program"]), about["record"]
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError, RecursionError):
        return None
    if restarted:
        how = "the computer stopped or was restarted meanwhile"
    elif released:
        how = "its program was killed, and the control loop released the servos"
    elif loop_runs:
        how = "its program was killed, and its control loop still runs: it releases the servos, or it is frozen"
    else:
        how = "its program was killed, and its control loop died before it released the servos"
    kept = f"; `softmap replay {_printable(record)}` reads what it recorded" if record else ""
    return f"the last session of this bench ({program}, begun {begun}) ended without shutting down: {how}{kept}"


def _printable(name: Any) -> str:
    return "".join(c if c.isprintable() else "?" for c in str(name))[-_NAME:]


def _runs(pid: int) -> bool:
    """Return whether a process runs; this one, whose session was not ended, counts as well."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _boot() -> str:
    """Return what differs after each start of the computer."""
    with contextlib.suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    return ""
