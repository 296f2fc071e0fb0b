"""Hand observations, newest first, from camera frames or UDP messages.

Each observation replaces the one before. A slow reader misses some; the camera never waits. The end
(camera lost, file over) is reported, not raised. Pinned by tests/robot/test_teleop_drive.py.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import TeleopError, brief
from softmap_edge.robot.teleop.frames import CameraFrames, FileFrames, Frame
from softmap_edge.robot.teleop.hand import Hand, View, surest
from softmap_edge.robot.teleop.keys import Controls, HeldKey
from softmap_edge.robot.teleop.landmarker import Landmarker
from softmap_edge.robot.teleop.landmarks import Receiver

LOOK = 0.005  # s between two checks for UDP messages
# s without detection after which a hand counts as lost: four frames, so one miss does not count
SEEN = 0.15
FRESH = 0.5  # s: older messages are ignored, because the sender was interrupted


@dataclass(frozen=True, eq=False)
class HandObservation:
    """The hands detected in one frame.

    `hand` is the hand with the highest score that may drive, if any. `t` is when the frame was
    taken (s, steady clock), `number` counts from 0, `picture` is None if only landmarks were
    received, and `hands` are all hands that may drive.
    """

    t: float
    number: int
    hand: Hand | None
    picture: NDArray[np.uint8] | None = None
    hands: tuple[Hand, ...] = ()


class Pictures(Protocol):
    """A camera or video file (`frames`)."""

    def __iter__(self) -> Iterator[Frame]: ...

    def close(self) -> None:
        """Release it."""
        ...


class Finder(Protocol):
    """A detector of hands in images (`landmarker`)."""

    def see(self, picture: NDArray[np.uint8], t: float) -> list[Hand]:
        """Return the hands in an image taken at `t` s."""
        ...

    def close(self) -> None:
        """Release it."""
        ...


class HandSource(ABC):
    """The slot for the newest observation, filled by a thread; a context manager.

    `gone` is a line on why no more observations arrive, and `over` marks the end of a file.
    `.taken` and `.hands` count the frames, and those that show the driving hand.
    """

    def __init__(self, name: str, view: View) -> None:
        self.name, self.view = name, view
        self.gone, self.over = "", False
        self.taken = self.hands = 0
        self._sight: HandObservation | None = None
        self._news = threading.Condition()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"eyes of {name}", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._done.set()
        self._close()
        self._thread.join(5.0)

    def newest(self) -> HandObservation | None:
        """Return the newest observation; None before the first."""
        return self._sight

    def wait(self, number: int, seconds: float) -> None:
        """Wait at most some seconds for an observation other than `number`."""
        with self._news:
            self._news.wait_for(
                lambda: self._sight is not None and self._sight.number != number, seconds
            )

    def _see(self, sight: HandObservation) -> None:
        self.taken += 1
        self.hands += sight.hand is not None
        with self._news:
            self._sight = sight
            self._news.notify_all()

    def _run(self) -> None:
        try:
            self._watch()
            self.over = not self._done.is_set()
        except TeleopError as fault:
            self.gone = str(fault)
        # an error of the driver or of mediapipe: the hand is lost, the loop goes on
        except Exception as fault:
            self.gone = f"{self.name}: failed ({type(fault).__name__}: {brief(fault)}); begin again"

    @abstractmethod
    def _watch(self) -> None:
        """Fill the slot until the source ends."""

    def _close(self) -> None:  # noqa: B027
        """End what the thread may be waiting for."""


class NullHandSource(HandSource):
    """No observations: keys and knob drive."""

    def __init__(self) -> None:
        super().__init__("none", View())

    def _watch(self) -> None:
        self._done.wait()


class CameraHandSource(HandSource):
    """Hands in camera frames."""

    def __init__(self, name: str, pictures: Pictures, finder: Finder, view: View) -> None:
        super().__init__(name, view)
        self._pictures, self._finder = pictures, finder

    def _watch(self) -> None:
        try:
            for frame in self._pictures:
                if self._done.is_set():
                    return
                hands = self.view.allowed(self._finder.see(frame.picture, frame.t))
                self._see(
                    HandObservation(
                        frame.t, frame.number, surest(hands), frame.picture, tuple(hands)
                    )
                )
        except TeleopError:
            if not self._done.is_set():
                raise
        finally:
            self._finder.close()
            self._pictures.close()

    def _close(self) -> None:
        # ends a thread that waits for the next frame
        if isinstance(self._pictures, CameraFrames):
            self._pictures.close()


class RemoteHandSource(HandSource):
    """Landmarks and key from another computer (`landmarks`); also an input (`keys.Input`)."""

    def __init__(self, receiver: Receiver, view: View) -> None:
        super().__init__("the other computer", view)
        self._receiver, self._key = receiver, HeldKey()

    def _watch(self) -> None:
        last = None
        while not self._done.wait(LOOK):
            got = self._receiver.newest()
            if got is None or got.message is last or got.age > FRESH:
                continue
            last = got.message
            now = time.monotonic()
            self._key.say(last.held, now - got.age)
            hands = self.view.allowed([] if last.hand is None else [last.hand])
            self._see(
                HandObservation(now - got.age, got.sequence, surest(hands), None, tuple(hands))
            )
        self._receiver.close()

    def controls(self, now: float) -> Controls:
        """Return whether the key is held on the other computer."""
        return Controls(self._key.held(now), source="hand")

    def asked(self) -> str | None:
        """Return no request."""
        return None

    def rest(self, knob: tuple[float, float]) -> None:
        """Do nothing: there is no knob."""

    @property
    def refused(self) -> dict[str, int]:
        """Numbers of rejected datagrams by reason (`landmarks.Receiver`)."""
        return dict(self._receiver.refused)


def camera_hand_source(what: int | Path, model: str | Path | None, view: View) -> CameraHandSource:
    """Open a camera by number, or a video file at its own rate, with hand detection by mediapipe.

    Raises:
        TeleopError: as `Landmarker`, `CameraFrames`, `FileFrames`.
    """
    finder = Landmarker(model)
    try:
        pictures = CameraFrames(what) if isinstance(what, int) else FileFrames(what)
    except BaseException:
        finder.close()
        raise
    return CameraHandSource(
        f"camera {what}" if isinstance(what, int) else str(what), pictures, finder, view
    )
