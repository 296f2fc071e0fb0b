"""The cameras of this computer, by number, persistent name, and path.

A path is `/dev/videoN` or a link to one. Numbers can change when a camera is reconnected; the names
under `v4l/by-id` and `v4l/by-path` do not. Pinned by tests/robot/test_frames.py.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

from softmap_edge.errors import LONGEST_WORD, TeleopError
from softmap_edge.files.printable import listed

DEVICES = Path("/dev")
LASTING = ("v4l/by-id", "v4l/by-path")
NODE = re.compile(r"video([0-9]{1,4})")
MOST = 8  # cameras that a message lists at most


@dataclass(frozen=True)
class Camera:
    """A camera: its number, its file, and its persistent names, the clearest first."""

    number: int
    file: Path
    names: tuple[Path, ...] = ()

    def __str__(self) -> str:
        return f"{self.number} ({self.names[0] if self.names else self.file})"


def cameras(devices: Path = DEVICES) -> list[Camera]:
    """Return the connected cameras, ordered by number."""
    links = [link for folder in LASTING for link in sorted((devices / folder).glob("*"))]
    found = []
    for file in devices.glob("video*"):
        if (number := _number(file, devices)) is not None and not file.is_symlink():
            names = tuple(
                link for link in links if os.path.realpath(link) == os.path.realpath(file)
            )
            found.append(Camera(number, file, names))
    return sorted(found, key=lambda camera: camera.number)


def there(devices: Path = DEVICES) -> str:
    """Return the list of the connected cameras for a message."""
    found = cameras(devices)
    if not found:
        return "no camera is connected"
    return f"the cameras here are {listed(found, MOST, LONGEST_WORD)}"  # paths to copy


def camera_number(text: str, devices: Path = DEVICES) -> int | None:
    """Return the number of the camera at a path; None if the path is not a device.

    Raises:
        TeleopError: the path is a device, but not a connected camera.
    """
    try:
        path = Path(os.path.abspath(text))
        number, exists = _number(path, devices), path.exists()
        if number is not None and exists:
            return number
        if path.is_file() or not (
            path.is_relative_to(devices) or number is not None or path.is_char_device()
        ):
            return None
    except (OSError, RuntimeError, ValueError) as fault:
        why = getattr(fault, "strerror", None) or "links in a circle"
        raise TeleopError(
            f"camera: {text!r:.80} cannot be read ({why.lower()}); {there(devices)}"
        ) from None
    if exists:
        what = "is not a camera"
    elif number is None or path == devices / f"video{number}":
        what = "is not there"
    else:
        what = f"links to camera {number}, now gone"
    raise TeleopError(f"camera {text:.120}: {what}; {there(devices)}; plug it in, or give another")


def _number(path: Path, devices: Path) -> int | None:
    """Return N of the videoN that a path is or links to."""
    file = path.resolve()
    node = NODE.fullmatch(file.name)
    return int(node[1]) if node and file.parent == devices.resolve() else None
