"""Hand landmarks in images, by MediaPipe Hands (`[teleop]` extra, `fetch_model`).

mediapipe loads its native library when a task is created, not on import. On a processor that it was
not compiled for, the library aborts the process. So a child process creates the first task, and its
death is reported as an error; on ARM the processor is checked first. Pinned by
tests/robot/test_landmarker.py.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import signal
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import TeleopError, brief
from softmap_edge.robot.teleop.hand import Hand, in_pixels
from softmap_edge.robot.teleop.model_file import HandModel, check_model, default_path
from softmap_edge.robot.teleop.requirements import INSTALL, UDP, processor

TRY_SECONDS = 60.0  # s for a child process to create a task; 1.3 s on a workstation
NEEDS_LSE = 1  # first major version of mediapipe that requires LSE atomics
_TRY = """
import sys
from mediapipe.tasks import python
from mediapipe.tasks.python import vision
base = python.BaseOptions(model_asset_path=sys.argv[1])
options = vision.HandLandmarkerOptions(base_options=base)
vision.HandLandmarker.create_from_options(options).close()
"""
_tried: set[str] = set()  # models with which a child process has created a task


class Landmarker:
    """Detect hands in successive images; a context manager.

    `model` is the task file (default: `default_path()`), `hands` the most hands to detect, and
    `confidence` (0 to 1) the least score of a hand. `.model` is the file and its checksum.

    Raises:
        TeleopError: mediapipe is missing or cannot run here, or the model is not usable.
    """

    def __init__(
        self, model: str | Path | None = None, *, hands: int = 1, confidence: float = 0.5
    ) -> None:
        if not (1 <= hands <= 4 and 0.0 <= confidence <= 1.0):
            raise TeleopError(
                f"landmarker: {hands} hands, confidence {confidence}; allowed are 1 to 4, 0 to 1"
            )
        self.model: HandModel = check_model(default_path() if model is None else model)
        try_out(self.model.path)
        self._mediapipe = importlib.import_module("mediapipe")
        tasks = importlib.import_module("mediapipe.tasks.python")
        vision = importlib.import_module("mediapipe.tasks.python.vision")
        options = vision.HandLandmarkerOptions(
            base_options=tasks.BaseOptions(model_asset_path=str(self.model.path)),
            running_mode=vision.RunningMode.VIDEO,
            num_hands=hands,
            min_hand_detection_confidence=confidence,
            min_hand_presence_confidence=confidence,
            min_tracking_confidence=confidence,
        )
        self._task: Any = vision.HandLandmarker.create_from_options(options)
        self._ms = -1

    def see(self, picture: NDArray[np.uint8], t: float) -> list[Hand]:
        """Return the hands in an image (H, W, 3) in BGR taken at `t` s.

        The time bounds how far a hand may have moved since the previous image. A time that does not
        increase counts as 1 ms later.

        Raises:
            TeleopError: it is not an image, mediapipe failed, or this landmarker is closed.
        """
        if self._task is None:
            raise TeleopError("landmarker: is closed; make another")
        if (
            picture.ndim != 3
            or picture.shape[2] != 3
            or picture.dtype != np.uint8
            or 0 in picture.shape
        ):
            raise TeleopError(
                f"landmarker: {picture.dtype} of shape {picture.shape}, expected uint8 (H, W, 3)"
            )
        if not 0.0 <= t <= 1e12:
            raise TeleopError(f"landmarker: t = {t} s, expected 0 to 1e12")
        # mediapipe rejects times that do not increase
        self._ms = max(self._ms + 1, round(t * 1000.0))
        colours = np.ascontiguousarray(picture[:, :, ::-1])
        image = self._mediapipe.Image(image_format=self._mediapipe.ImageFormat.SRGB, data=colours)
        try:
            found = self._task.detect_for_video(image, self._ms)
        except (RuntimeError, ValueError) as fault:
            raise TeleopError(
                f"landmarker: mediapipe failed ({brief(fault)}); make another landmarker"
            ) from None
        height, width = picture.shape[:2]
        return [
            hand
            for points, sides in zip(found.hand_landmarks, found.handedness)
            if (hand := _hand(points, sides[0], width, height)) is not None
        ]

    def close(self) -> None:
        """Release mediapipe; may be called again."""
        task, self._task = self._task, None
        if task is not None:
            task.close()

    def __enter__(self) -> Landmarker:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()


class _Point(Protocol):
    """A landmark of mediapipe, in shares of the picture."""

    x: float
    y: float


class _Side(Protocol):
    """Which hand mediapipe saw, and how sure it is."""

    category_name: str
    score: float


def _hand(points: Iterable[_Point], side: _Side, width: int, height: int) -> Hand | None:
    """Return a detection of mediapipe as a hand; None if its numbers are not finite.

    mediapipe reports the sides of unmirrored images.
    """
    normalised = np.array([[point.x, point.y] for point in points])
    try:
        score = min(max(float(side.score), 0.0), 1.0)
        return Hand(
            in_pixels(normalised, width, height),
            "left" if side.category_name == "Left" else "right",
            score,
        )
    except TeleopError:
        return None


def try_out(model: Path, python: str = sys.executable, limit: float = TRY_SECONDS) -> None:
    """Create one task of the model in a child process, once per process and model.

    Raises:
        TeleopError: mediapipe is missing, or dies, hangs or fails here.
    """
    if str(model) in _tried:
        return
    try:
        version = importlib.metadata.version("mediapipe")
    except importlib.metadata.PackageNotFoundError:
        raise TeleopError(
            f"landmarker: mediapipe is not installed; run {INSTALL}, or {UDP}"
        ) from None
    here = processor()
    if not here.fine and int(version.split(".")[0]) >= NEEDS_LSE:
        raise TeleopError(
            f"landmarker: mediapipe {version} on {here.name}: {here.found}; {here.do}"
        )
    try:
        done = subprocess.run(
            [python, "-P", "-c", _TRY, str(model)], capture_output=True, timeout=limit, check=False
        )
    except subprocess.TimeoutExpired:
        raise TeleopError(
            f"landmarker: mediapipe {version} did not start within {limit:g} s; {UDP}"
        ) from None
    if done.returncode < 0:
        name = signal.Signals(-done.returncode).name
        raise TeleopError(f"landmarker: mediapipe {version} dies on this computer ({name}); {UDP}")
    if done.returncode:
        lines = [
            line for line in done.stderr.decode("utf-8", "replace").splitlines() if line.strip()
        ]
        raise TeleopError(
            f"landmarker: mediapipe {version} fails here "
            f"({brief(Exception(lines[-1] if lines else ''))})"
        )
    _tried.add(str(model))
