"""Camera frames, newest first, or a video file at its own rate (`[teleop]` extra).

A thread reads the camera into a single slot, because camera drivers queue frames: a reader always
gets the newest one. Times are those of the steady clock (`time.monotonic`). Pinned by
tests/robot/test_frames.py.
"""

from __future__ import annotations

import importlib
import math
import os
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Protocol
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import TeleopError
from softmap_edge.robot.teleop import devices
from softmap_edge.robot.teleop.requirements import INSTALL

# requested of a camera, as in the paper; the camera may deliver something else
WIDTH, HEIGHT, RATE = 640, 480, 30.0
SILENCE = 2.0  # s without a frame after which a camera counts as lost
FASTEST = 1000.0  # highest frame rate that a file may state
# share of the stated frames that a file may lack: some files state more than they hold
MISSING = 0.02


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame (H, W, 3) uint8 in BGR, its time (s, steady clock), and its number from 0."""

    picture: NDArray[np.uint8]
    t: float
    number: int


@dataclass(frozen=True)
class UdpAddress:
    """Address to receive landmarks at: `udp://HOST:PORT`; an empty host is every network."""

    host: str
    port: int


def source(text: str) -> int | Path | UdpAddress:
    """Return the source that `--camera N | /dev/… | FILE | udp://HOST:PORT` names.

    It is a camera, a video file, or an address for landmarks. A device path is a camera, numbered
    by the device that it links to. Any other path is a video file.

    Raises:
        TeleopError: it names none of these, or a device that is not a camera.
    """
    if text.isascii() and text.isdigit() and len(text) <= 4:
        return int(text)
    if text.startswith("udp://"):
        try:
            parts = urlsplit(text)
            port = parts.port
        except ValueError:
            port = None
        if (
            port is None
            or not 1 <= port <= 65535
            or parts.path.strip("/")
            or parts.query
            or parts.username
        ):
            raise TeleopError(
                f"camera: {text!r:.80} is not udp://HOST:PORT with a port of 1 to 65535"
            )
        return UdpAddress(parts.hostname or "", port)
    if "://" in text or not text or "\0" in text:
        raise TeleopError(
            f"camera: {text!r:.80}; give the number or path of a camera, a video file or "
            "udp://HOST:PORT"
        )
    number = devices.camera_number(text, devices.DEVICES)
    return Path(text) if number is None else number


class FileFrames:
    """The frames of a video file, as an iterator; a context manager.

    With `live`, frames arrive at the rate of the file, and overdue frames are skipped, as by a
    camera. Otherwise each frame is returned as soon as it is requested. Each iteration starts at
    the first frame, and `t` counts from there.

    Raises:
        TeleopError: OpenCV is missing, or there is no such video.
    """

    def __init__(self, path: str | Path, *, live: bool = True) -> None:
        self.path, self.live = Path(path), live
        cv2 = _cv2()
        if not self.path.is_file():
            raise TeleopError(
                f"{path}: no such video file; give one, or a camera; "
                f"{devices.there(devices.DEVICES)}"
            )
        self._video = cv2.VideoCapture(str(self.path.resolve()), cv2.CAP_FFMPEG)
        self.rate = float(self._video.get(cv2.CAP_PROP_FPS)) if self._video.isOpened() else math.nan
        self.claimed = self._video.get(cv2.CAP_PROP_FRAME_COUNT)
        if not 0 < self.rate <= FASTEST:
            self._video.release()
            raise TeleopError(
                f"{path}: is not a video that can be read, or a damaged one; give another file"
            )
        self._again = cv2.CAP_PROP_POS_FRAMES

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames.

        Raises:
            TeleopError: the file ends early.
        """
        self._video.set(self._again, 0)
        start, number = time.monotonic(), 0
        while self._video.grab():
            due = start + number / self.rate
            late = time.monotonic() - due
            number += 1
            if self.live and late > 1.0 / self.rate:
                continue  # a newer frame is due
            got, picture = self._video.retrieve()
            if not got:
                raise TeleopError(
                    f"{self.path}: picture {number - 1} is damaged; give another file"
                )
            if self.live and late < 0:
                time.sleep(-late)
            yield Frame(picture, due, number - 1)
        if number == 0 or number < self.claimed * (1 - MISSING) - 1:
            raise TeleopError(
                f"{self.path}: ends after {number} of {self.claimed:.0f} pictures: it is damaged"
            )

    def close(self) -> None:
        """Close the file; may be called again."""
        self._video.release()

    def __enter__(self) -> FileFrames:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()


class _Device(Protocol):
    """What OpenCV opens."""

    def read(self) -> tuple[bool, NDArray[np.uint8]]: ...
    def release(self) -> None: ...


class CameraFrames:
    """The newest frames of a camera, as an iterator; a context manager.

    `index` is the N of /dev/videoN. `device` replaces the OpenCV capture (`read() -> (bool,
    picture)`, `release()`). `.dropped` counts the frames that were not requested in time.

    Raises:
        TeleopError: OpenCV is missing, there is no such camera, or it cannot be opened.
    """

    def __init__(
        self, index: int, *, silence: float = SILENCE, device: _Device | None = None
    ) -> None:
        self.name, self.silence, self.dropped = f"camera {index}", silence, 0
        self._device = _opened(index) if device is None else device
        self._new = threading.Condition()
        self._slot: Frame | None = None
        self._gone = self._closed = False
        self._thread = threading.Thread(target=self._read, name=self.name, daemon=True)
        self._thread.start()

    def newest(self) -> Frame:
        """Return the newest frame not returned before; wait for it if necessary.

        Raises:
            TeleopError: the camera is lost, delivers nothing, or is closed.
        """
        with self._new:
            came = self._new.wait_for(
                lambda: self._slot is not None or self._gone or self._closed, self.silence
            )
            frame, self._slot = self._slot, None
        if self._closed:
            raise TeleopError(f"{self.name}: is closed; open it again")
        if frame is not None:
            return frame
        if came:
            raise TeleopError(f"{self.name}: is gone (unplugged?); plug it in and begin again")
        raise TeleopError(
            f"{self.name}: no picture for {self.silence:g} s; plug it in again, or close the "
            "program that uses it"
        )

    def __iter__(self) -> Iterator[Frame]:
        """Yield the newest frame repeatedly until the camera is lost (TeleopError)."""
        while True:
            yield self.newest()

    def close(self) -> None:
        """Stop reading and release the camera; may be called again."""
        with self._new:
            self._closed = True
            self._new.notify_all()
        self._thread.join(self.silence)

    def __enter__(self) -> CameraFrames:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    def _read(self) -> None:
        """Put each new frame into the slot; the reading thread releases the device."""
        number = 0
        try:
            while not self._closed:
                try:
                    got, picture = self._device.read()
                except Exception:  # OpenCV raises its own errors when a camera is unplugged
                    break
                if not got:
                    break
                with self._new:
                    self.dropped += self._slot is not None
                    self._slot = Frame(picture, time.monotonic(), number)
                    self._new.notify_all()
                number += 1
        finally:
            self._device.release()
            with self._new:
                self._gone = True
                self._new.notify_all()


def _opened(index: int) -> _Device:
    cv2 = _cv2()
    file = devices.DEVICES / f"video{index}"
    if not file.exists():
        here = devices.there(devices.DEVICES)
        raise TeleopError(
            f"camera {index}: there is no {file}; {here}; give another camera, a video file or "
            "udp://:PORT"
        )
    if not os.access(file, os.R_OK | os.W_OK):
        raise TeleopError(
            f"camera {index}: no permission for {file}; run sudo usermod -aG video $USER and log "
            "in again"
        )
    device = cv2.VideoCapture(index, cv2.CAP_V4L2)
    if not device.isOpened():
        raise TeleopError(
            f"camera {index}: {file} cannot be opened; close the program that uses it, or try "
            "another number"
        )
    for key, value in (
        ("FRAME_WIDTH", WIDTH),
        ("FRAME_HEIGHT", HEIGHT),
        ("FPS", RATE),
        ("BUFFERSIZE", 1),
    ):
        device.set(getattr(cv2, f"CAP_PROP_{key}"), value)
    opened: _Device = device
    return opened


def _cv2() -> ModuleType:
    try:
        return importlib.import_module("cv2")
    except ImportError as cause:
        raise TeleopError(
            f"camera: OpenCV cannot be loaded ({cause!s:.80}); run {INSTALL}"
        ) from None
