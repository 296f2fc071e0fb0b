"""Check what teleoperation needs on this computer, and how to install what is missing.

mediapipe requires opencv-contrib-python, and this package opencv-python-headless. Both own the
folder `cv2/`: pip installs one over the other, and uninstalling either deletes it. Nothing here
imports either. A missing package is a warning, because driving without a local camera is possible.
A conflict or a damaged package is a fault. Pinned by tests/robot/test_teleop_installed.py.
"""

from __future__ import annotations

import ctypes
import platform
from collections.abc import Iterable
from dataclasses import replace
from importlib.metadata import Distribution, distributions
from pathlib import Path

from softmap_edge.errors import TeleopError
from softmap_edge.robot.finding import FAULT, OK, WARNING, Line, faulty
from softmap_edge.robot.teleop.model_file import check_model, default_path

INSTALL = (
    "uv pip install --override <(echo \"opencv-contrib-python; sys_platform == 'never'\") "
    "'softmap-edge[teleop]'"
)
# libraries that mediapipe's own is linked with, so it never loads without them
LIBRARIES = ("libEGL.so.1", "libGLESv2.so.2")
UDP = "send landmarks from another computer instead (docs/do/teleop.md, --camera udp://)"
# last mediapipe without telemetry: its issue 6291 on GitHub, and 0.10.18 measured
LAST_SILENT = (0, 10, 21)
CPU = Path("/proc/cpuinfo")


def findings(model: str | Path | None = None) -> list[Line]:
    """Return the findings on OpenCV, mediapipe, its libraries, the processor and the hand model."""
    here = list(distributions())
    return [opencv(here), mediapipe(here), libraries(), processor(), hand_model(model)]


def opencv(installed: Iterable[Distribution]) -> Line:
    """Find the distributions that own `cv2/`; exactly one may, and its files must exist."""
    owners: dict[str, Distribution] = {}
    for distribution in installed:
        name = distribution.metadata["Name"] or ""
        files = (
            str(file) for file in distribution.files or [] if name.lower().startswith("opencv")
        )
        if any(file.startswith("cv2/") for file in files):
            owners.setdefault(name, distribution)
    versions = " and ".join(f"{name} {found.version}" for name, found in sorted(owners.items()))
    if not owners:
        return Line("opencv", WARNING, "not installed", f"run {INSTALL}")
    if len(owners) > 1:
        removed = " ".join(sorted(owners))
        mend = f"run uv pip uninstall {removed}, then {INSTALL}"
        return Line("opencv", FAULT, f"{versions} are installed into one folder cv2/", mend)
    file = next(iter(owners.values())).locate_file("cv2/__init__.py")
    if not Path(str(file)).is_file():
        mend = f"run uv pip uninstall {next(iter(owners))}, then {INSTALL}"
        return Line(
            "opencv",
            FAULT,
            f"{versions} lost its folder cv2/ when another OpenCV was removed",
            mend,
        )
    return Line("opencv", OK, versions)


def mediapipe(installed: Iterable[Distribution]) -> Line:
    """Find mediapipe."""
    found = next((d for d in installed if (d.metadata["Name"] or "").lower() == "mediapipe"), None)
    if found is None:
        return Line("mediapipe", WARNING, "not installed", f"run {INSTALL}, or {UDP}")
    if _numbers(found.version) <= LAST_SILENT:
        return Line("mediapipe", OK, found.version)
    text = (
        f"{found.version}, which reports its use to its maker when there is a network "
        "(docs/do/teleop.md)"
    )
    return Line("mediapipe", OK, text)


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) if part.isdigit() else 0 for part in version.split("."))


def libraries(names: Iterable[str] = LIBRARIES) -> Line:
    """Try to load the libraries that mediapipe is linked with."""
    absent = []
    for name in names:
        try:
            ctypes.CDLL(name)
        except OSError:
            absent.append(name)
    if absent:
        mend = "run sudo apt install libegl1 libgles2"
        return Line("graphics libraries", WARNING, f"{', '.join(absent)} cannot be loaded", mend)
    return Line("graphics libraries", OK, ", ".join(names))


def processor(machine: str | None = None, cpu: Path = CPU) -> Line:
    """Check that this processor can run mediapipe 1.0 and later: on ARM they need LSE atomics."""
    machine = platform.machine() if machine is None else machine
    if machine not in ("aarch64", "arm64"):
        return Line("processor", OK, machine)
    try:
        text = cpu.read_text(encoding="ascii", errors="replace")
    except OSError:
        return Line("processor", OK, f"{machine}, {cpu} cannot be read")
    # Boards mix cores, so every core must have them.
    lines = [
        line.split(":", 1)[-1].split() for line in text.splitlines() if line.startswith("Features")
    ]
    if lines and not all("atomics" in line for line in lines):
        mend = f"install mediapipe==0.10.18, or {UDP}"
        return Line(
            "processor",
            WARNING,
            f"{machine} without LSE atomics: mediapipe 1.0 and later abort here",
            mend,
        )
    return Line(
        "processor",
        OK,
        f"{machine} with LSE atomics" if lines else f"{machine}, features not reported",
    )


def hand_model(path: str | Path | None = None) -> Line:
    """Find the hand model."""
    file = default_path() if path is None else Path(path)
    try:
        return Line("hand model", OK, str(check_model(file)))
    except TeleopError as fault:
        line = faulty("hand model", fault, "fetch it again: softmap teleop --fetch-model FROM")
        return line if file.exists() else replace(line, state=WARNING)
