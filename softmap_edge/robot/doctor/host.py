"""The doctor's checks of this computer.

They cover versions, processor, real-time rights, serial ports, cameras and MediaPipe. Each check
returns lines and takes its paths as arguments, so that a test can examine another computer. Pinned
by tests/robot/test_doctor.py.
"""

from __future__ import annotations

import grp
import importlib.metadata
import os
import platform
import resource
import stat
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from softmap_edge.robot.finding import FAULT, OK, WARNING, Line, faulty
from softmap_edge.version import __version__

PROC, DEV, SYS = Path("/proc"), Path("/dev"), Path("/sys")
PYTHON = (3, 11)
NEEDED = ("numpy", "jinja2", "tomlkit", "websockets")
EXTRAS = {  # how to install each; for teleoperation see `teleoperation`
    "dynamixel-sdk": "pip install 'softmap-edge[servo]'",
    "matplotlib": "pip install 'softmap-edge[report]'",
    "onnxruntime": "pip install onnxruntime",
}
CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23  # their bits in a set of capabilities
PRIORITY = 50  # real-time priority that the loop requests
LOCKED = 64 << 20  # bytes of locked memory that the loop needs
SIMD = {"x86_64": ("flags", ("avx2", "fma")), "aarch64": ("Features", ("asimd",))}
QUICK = 1  # ms: latency timer of a USB adapter


def versions() -> Iterator[Line]:
    """Report the versions of this package, Python, the C library, and the packages in use."""
    known = sys.version_info[:2] >= PYTHON
    do = "" if known else f"install Python {PYTHON[0]}.{PYTHON[1]} or newer"
    yield Line("python", OK if known else FAULT, platform.python_version(), do)
    yield Line(
        "softmap-edge",
        OK,
        f"{__version__}, {' '.join(filter(None, platform.libc_ver())) or 'unknown libc'}",
    )
    for name in NEEDED:
        version = _version(name)
        do = "" if version else "run pip install softmap-edge again"
        yield Line(name, OK if version else FAULT, version or "not installed", do)
    for name, install in EXTRAS.items():
        version = _version(name)
        do = "" if version else f"only if you need it: {install}"
        yield Line(name, OK if version else WARNING, version or "not installed", do)


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def processor(machine: str | None = None, proc: Path = PROC) -> Iterator[Line]:
    """Report whether the processor has the instructions that the compiled network code needs.

    `teleoperation` checks what mediapipe needs.
    """
    machine = platform.machine() if machine is None else machine
    key, required = SIMD.get(machine, ("", ()))
    if not key:
        yield Line(
            "processor",
            WARNING,
            machine,
            "supported are x86_64 and aarch64; others run what needs no wheel",
        )
        return
    try:
        text = (proc / "cpuinfo").read_text("ascii", "replace")
    except OSError as fault:
        yield Line(
            "processor",
            WARNING,
            f"{machine}, {fault.filename} cannot be read",
            "its features are not known",
        )
        return
    features = [
        line.split(":", 1)[-1].split() for line in text.splitlines() if line.startswith(key)
    ]
    lacking = (
        [name for name in required if not all(name in one for one in features)] if features else []
    )
    do = (
        "the network pass takes its plain path, several times slower; a table or rod as prior is "
        "not concerned"
    )
    message = f"{machine}, {os.cpu_count()} cores"
    if lacking:
        yield Line("processor", WARNING, f"{message}, without {', '.join(lacking)}", do)
    else:
        yield Line("processor", OK, f"{message}, with {', '.join(required)}")


def real_time(proc: Path = PROC) -> Iterator[Line]:
    """Report whether the loop may use real-time priority and lock its memory."""
    rights = _capabilities(proc)
    most = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    name, file = _user(), "/etc/security/limits.d/softmap.conf"
    do = (
        f"the loop runs without; to mend it, write '{name} - rtprio {PRIORITY}' into {file} and "
        "log in again"
    )
    may = bool(rights >> CAP_SYS_NICE & 1)
    allowed = may or most < 0 or most >= PRIORITY
    right = (
        "CAP_SYS_NICE"
        if may
        else f"rtprio limit {'unlimited' if most < 0 else most}, {PRIORITY} needed"
    )
    yield Line("real-time priority", OK if allowed else WARNING, right, "" if allowed else do)
    locked = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    do = (
        f"the loop runs without; to mend it, write '{name} - memlock unlimited' into {file} and "
        "log in again"
    )
    may = bool(rights >> CAP_IPC_LOCK & 1)
    enough = may or locked < 0 or locked >= LOCKED
    right = f"limit {locked >> 10} KiB, {LOCKED >> 10} needed"
    if may:
        right = "CAP_IPC_LOCK"
    elif locked < 0:
        right = "unlimited"
    yield Line("locked memory", OK if enough else WARNING, right, "" if enough else do)


def _capabilities(proc: Path) -> int:
    """Return the set of effective capabilities; none if it cannot be read."""
    try:
        lines = (proc / "self/status").read_text().splitlines()
        return next(int(line.split()[1], 16) for line in lines if line.startswith("CapEff:"))
    except (OSError, StopIteration, ValueError, IndexError):
        return 0


def _user() -> str:
    return os.environ.get("USER") or str(os.getuid())


def ports(dev: Path = DEV, rig: str | Path | None = None) -> Iterator[Line]:
    """Report the serial ports and that of `rig`, and whether this user may open them."""
    from softmap_edge.robot.servo.bus import ports as listed

    found = listed(dev)
    own = None if rig is None else _port_of(rig)
    if own is not None and os.path.realpath(own) not in map(os.path.realpath, found):
        found.append(own)
    if not found:
        yield Line(
            "serial port", WARNING, "none", "connect the adapter of the servos; `--sim` needs none"
        )
    for port in found:
        file = Path(port)
        try:
            status = file.stat()
        except OSError as fault:
            do = "unplug the adapter and plug it in again"
            do += f", or correct port in {rig}" if port == own else ""
            yield Line(port, FAULT, f"{fault.strerror}", do)
            continue
        owner, mode = _group(status.st_gid), stat.filemode(status.st_mode)
        if os.access(file, os.R_OK | os.W_OK):
            yield Line(port, OK, f"may be opened ({mode}, group {owner})")
        else:
            do = f"run sudo usermod -aG {owner} {_user()}, then log in again"
            yield Line(port, FAULT, f"no permission for this user ({mode}, group {owner})", do)


def _port_of(rig: str | Path) -> str | None:
    """Return the port of a rig file; None if it cannot be read, which another line reports."""
    from softmap_edge.errors import SoftmapError
    from softmap_edge.robot.servo.rig import read_rig

    try:
        return read_rig(rig).port
    except SoftmapError:
        return None


def _group(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def latency(sys: Path = SYS) -> Iterator[Line]:
    """Report how long USB adapters wait before they pass bytes on."""
    for file in sorted(sys.glob("bus/usb-serial/devices/*/latency_timer")):
        name = f"latency of {file.parent.name}"
        try:
            ms = int(file.read_text())
        except (OSError, ValueError):
            yield Line(
                name,
                WARNING,
                f"{file} cannot be read",
                "answers may come late; look whether the adapter is plugged in",
            )
            continue
        if ms <= QUICK:
            yield Line(name, OK, f"{ms} ms")
        else:
            do = f"run echo {QUICK} | sudo tee {file}, again after each plugging in"
            yield Line(name, WARNING, f"{ms} ms: each period of the loop waits so long", do)


def teleoperation() -> Iterator[Line]:
    """Check what teleoperation needs: one OpenCV, mediapipe, its libraries, the hand model."""
    from softmap_edge.robot.teleop.requirements import findings

    for one in findings():
        yield replace(one, name=f"teleop: {one.name}")


def cameras(number: str | None = None, dev: Path = DEV) -> Iterator[Line]:
    """Report the cameras with their persistent names, and whether this user may open them.

    Only the given one is opened.
    """
    from softmap_edge.robot.teleop.devices import cameras as listed

    found = listed(dev)
    if not found:
        state, do = (WARNING, "connect one; keyboard and mouse drive without")
        yield Line("camera", FAULT if number is not None else state, "none", do)
        return
    for file, names in ((one.file, one.names) for one in found):
        if os.access(file, os.R_OK | os.W_OK):
            lasting = f"; its lasting name is {names[0]}" if names else ""
            yield Line(str(file), OK, f"may be opened{lasting}")
        else:
            owner = _group(file.stat().st_gid)
            do = f"run sudo usermod -aG {owner} {_user()}, then log in again"
            yield Line(str(file), WARNING, f"no permission for this user (group {owner})", do)
    if number is not None:
        yield _picture(number)


def _picture(number: str) -> Line:
    """Take an image with a camera."""
    from softmap_edge.errors import SoftmapError
    from softmap_edge.robot.teleop.frames import CameraFrames, source

    name = f"camera {number}"
    try:
        place = source(number)
        if not isinstance(place, int):
            return Line(name, FAULT, "no camera", "give --camera N, or its path under /dev")
        with CameraFrames(place) as camera:
            frame = camera.newest()
        height, width = frame.picture.shape[:2]
        return Line(name, OK, f"gives pictures of {width} × {height}")
    except SoftmapError as fault:
        return faulty(name, fault, "unplug it and plug it in again, or give another --camera")
