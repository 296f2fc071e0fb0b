"""A mark of the session that drives a rig, so the next start can report how it ended.

A session writes the mark to the user's state folder when it begins, and removes it when it ends
normally. The mark stays if the program is killed or the computer stops. The loop outlives a killed
program and notes in the mark that it has released the servos. Emulated robots at pseudo-terminals
have no next start and get no mark. A start never fails because of the mark: if the folder is not
writable, there is none. Pinned by tests/robot/test_session_mark.py.
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

from softmap_edge.errors import SessionWarning

EMULATED = "/dev/pts/"
RELEASED = "released"
_MOST = 1 << 16  # bytes of a mark that are read at most
_NAME = 80  # characters of a program's or file's name that are printed at most


def mark_file(port: str) -> Path | None:
    """Return the file of the mark of the rig at `port`; None for an emulated robot."""
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
    """Issue a `SessionWarning` if the last session at `port` did not end normally."""
    file = mark_file(port)
    if file is not None and (message := last_session(file)) is not None:
        warnings.warn(SessionWarning(message), stacklevel=3)


def begin(port: str, record: Path | None, loop: int) -> Path | None:
    """Write the mark of this session with control loop process `loop`; return its file, or None."""
    file = mark_file(port)
    if file is None:
        return None
    about = {
        "port": port,
        "program": Path(sys.argv[0] or "python").name,
        "pid": os.getpid(),
        "pid_began": _began(os.getpid()),
        "loop_pid": loop,
        "loop_began": _began(loop),
        "boot": _boot(),
        "begun": time.time(),
        "record": None if record is None else str(record.absolute()),
    }
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(about) + "\n", "utf-8")
    return file


def note_released(file: str | None) -> None:
    """Note in an existing mark that the loop has ended and released the servos."""
    if file is not None and os.path.exists(file):
        with contextlib.suppress(OSError), open(file, "a", encoding="utf-8") as stream:
            stream.write(json.dumps({"loop": RELEASED}) + "\n")


def end(file: Path | None) -> None:
    """Remove the mark: the session ended normally, or its end was reported to the program."""
    if file is not None:
        with contextlib.suppress(OSError):
            file.unlink(missing_ok=True)


def last_session(file: Path) -> str | None:
    """Return how the last session was interrupted; None if it ended normally or still runs."""
    try:
        with open(file, encoding="utf-8") as stream:
            lines = [json.loads(line) for line in stream.read(_MOST).splitlines()]
        about, released = lines[0], any(line.get("loop") == RELEASED for line in lines[1:])
        begun = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(float(about["begun"])))
        restarted = about["boot"] != _boot()
        if not restarted and _runs(int(about["pid"]), about.get("pid_began")):
            return None
        loop_runs = not restarted and _runs(int(about["loop_pid"]), about.get("loop_began"))
        program, record = _printable(about["program"]), about["record"]
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        IndexError,
        AttributeError,
        OverflowError,
        RecursionError,
    ):
        return None
    if restarted:
        how = "the computer stopped or was restarted meanwhile"
    elif released:
        how = "its program was killed, and the control loop released the servos"
    elif loop_runs:
        how = (
            "its program was killed, and its control loop still runs: it releases the servos, or "
            "it is frozen"
        )
    else:
        how = "its program was killed, and its control loop died before it released the servos"
    kept = f"; `softmap servo replay {_printable(record)}` reads what it recorded" if record else ""
    return (
        f"the last session of this rig ({program}, begun {begun}) ended without shutting down: "
        f"{how}{kept}"
    )


def _printable(name: object) -> str:
    return "".join(c if c.isprintable() else "?" for c in str(name))[-_NAME:]


def _runs(pid: int, began: object = None) -> bool:
    """Return whether the process with this id and start time runs; this process counts as well.

    The system reuses ids, so the start time must agree. A mark without a start time counts by its
    id.
    """
    now = _began(pid)
    if began is not None and now is not None and began != now:
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _began(pid: int) -> int | None:
    """Return when a process started, clock ticks after boot (field 22 of its stat), or None."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text("ascii", "replace")
        # its name, in brackets, may contain anything
        return int(text.rpartition(")")[2].split()[19])
    except (OSError, ValueError, IndexError):
        return None


def _boot() -> str:
    """Return an identifier of the current boot of the computer."""
    with contextlib.suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    return ""
