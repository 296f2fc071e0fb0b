"""Points seen by a camera program, sent to the robot's host over UDP (docs/do/camera.md).

    with PointSender("192.168.1.20", 9870, read_key("camera.key")) as out:
        out.send(points, stamp)          # (N, 3) mm in the base frame, NaN or `visible` for points
                                         # that are not seen; s

Each datagram is little-endian: mark `SMP1`, N (u16), 0 (u16), session (16 bytes), sequence number
(u64), stamp (f64 s, the camera's clock), 3 N coordinates (f32 mm), and HMAC-SHA256 of all that if
both sides have a key. Datagrams belong to sessions (`link/session.py`), within which stamps
increase. Pinned by tests/robot/test_camera_points.py.
"""

from __future__ import annotations

import math
import struct
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.errors import LinkError
from softmap_edge.robot.link.frames import Frame
from softmap_edge.robot.link.session import (
    TAG,
    Address,
    Listener,
    Sender,
    body_of,
    dropped_words,
    signed,
)
from softmap_edge.run.fields import unmasked

MARK, OFFER_MARK = b"SMP1", b"SMQ1"
_HEAD = struct.Struct("<4sHH16sQd")
MOST_POINTS = 5000  # points that fit into one datagram
FARTHEST = 1e4  # mm: largest coordinate
NEAREST = 1.0  # mm: if all points are closer to the origin, they are in metres
# s: change of a sender's clock against ours between two frames that counts as a new clock
JUMP = 2.0
LATEST = 1e10  # s, three hundred years: beyond, the stamps of two frames cannot be distinguished
KEPT = 9000  # frames: five minutes
WAIT = 0.2  # s for which the receiver waits at a time
THIS_COMPUTER = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True, eq=False)
class Message:
    """The content of a datagram: `points` (N, 3) mm (NaN if unseen), `stamp` s, session data."""

    points: NDArray[np.float32]
    stamp: float
    session: bytes
    sequence: int


def packed(message: Message, key: bytes | None = None) -> bytes:
    """Return a message as a datagram, signed if there is a key."""
    points = np.ascontiguousarray(message.points, "<f4")
    head = _HEAD.pack(MARK, len(points), 0, message.session, message.sequence, message.stamp)
    return signed(key, head + points.tobytes())


def unpacked(datagram: bytes, key: bytes | None = None) -> Message | str:
    """Return the content of a datagram, or why it is rejected: length, signature, content."""
    if len(datagram) < _HEAD.size:
        return "length"
    mark, count, zero, session, sequence, stamp = _HEAD.unpack_from(datagram)
    body = body_of(key, datagram, _HEAD.size + 12 * count)
    if isinstance(body, str):
        return body
    points = np.frombuffer(body, "<f4", offset=_HEAD.size).reshape(count, 3).astype(np.float32)
    unseen = np.isnan(points).any(axis=1)
    fits = mark == MARK and zero == 0 and 1 <= count <= MOST_POINTS and abs(stamp) <= LATEST
    if not fits or np.any(np.abs(points[~unseen]) > FARTHEST):
        return "content"
    points[unseen] = np.nan
    return Message(points, stamp, session, sequence)


class PointSender(Sender):
    """Send frames to `host`:`port`; a context manager.

    The first frame only asks the receiver for a session.

    Raises:
        LinkError: no such host or port, or the key is too short.
    """

    def __init__(self, host: str, port: int, key: bytes | None = None) -> None:
        super().__init__(host, port, key, OFFER_MARK)

    def send(
        self, points: ArrayLike, stamp: float | None = None, visible: ArrayLike | None = None
    ) -> bool:
        """Send a frame; return False if it cannot be sent now (no network, or no receiver).

        Args:
            points: (N, 3) mm, NaN if not seen
            stamp: s by the camera's clock; by default the current time
            visible: (N,) bool

        Raises:
            LinkError: points are invalid, too many, or not in mm, or the stamp is invalid.
        """
        now = np.array(unmasked(points), np.float32)
        if now.ndim != 2 or now.shape[1:] != (3,) or not 1 <= len(now) <= MOST_POINTS:
            raise LinkError(
                f"points of shape {now.shape}; expected (N, 3) with 1 to {MOST_POINTS} points"
            )
        if visible is not None:
            shown = np.asarray(np.ma.filled(visible, False), bool)
            if shown.shape != now.shape[:1]:
                raise LinkError(
                    f"visible of shape {shown.shape}, expected ({len(now)},) for {len(now)} points"
                )
            now[~shown] = np.nan
        size = np.abs(now[~np.isnan(now).any(axis=1)])
        if size.size and size.max() > FARTHEST:
            raise LinkError(
                f"points up to {size.max():.4g} mm from the origin, at most {FARTHEST:g} mm; "
                "convert them to mm"
            )
        if len(size) > 1 and 0 < size.max() < NEAREST:
            raise LinkError(
                f"all {len(size)} points lie within {size.max():.3g} mm of the origin, which "
                "looks like metres; multiply by 1000"
            )
        stamp = time.monotonic() if stamp is None else float(stamp)
        if not abs(stamp) <= LATEST:
            raise LinkError(f"a stamp of {stamp} s; give a time of at most {LATEST:g} s")
        return self._put(packed(Message(now, stamp, *self._next()), self._key))


class PointReceiver(Listener):
    """Receive frames at `host`:`port` (0: any free port, see `.port`) from entering to leaving.

    `.refused` counts rejected datagrams by reason: length, signature, content, points (another
    number of them), replay (also a stamp that did not increase), and those of a `Listener`.
    `.taken` counts accepted frames.

    Args:
        key: shared with the sender; without a key only this computer may send
        count: number of points in a frame; by default any number
        frame: (3, 4) [R | mm] from the camera to the base, as in a run of `softmap run align`

    Raises:
        LinkError: the address is not local or in use, the key is too short, or a key is required.
    """

    def __init__(
        self,
        host: str,
        port: int,
        key: bytes | None = None,
        *,
        count: int | None = None,
        frame: object = None,
    ) -> None:
        if key is None and host not in ("", *THIS_COMPUTER):
            raise LinkError(
                f"udp://{host}:{port}: points of other computers need a shared key; without one "
                "give udp://127.0.0.1:PORT"
            )
        super().__init__("127.0.0.1" if key is None and not host else host, port, key, OFFER_MARK)
        self._socket.settimeout(WAIT)
        self._count, self._frame = count, None if frame is None else np.asarray(frame, float)
        self.taken = 0
        self._frames: deque[Frame] = deque(maxlen=KEPT)
        self._last: tuple[Message, float] | None = None
        # s: shift of stamps to one clock for all sessions; smallest delay
        self._shift, self._quickest = 0.0, math.inf
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def close(self) -> None:
        """Close the socket and free the port; may be called again."""
        self._done.set()
        if self._thread.is_alive():
            self._thread.join(10 * WAIT)
        super().close()

    def seen(self) -> list[Frame]:
        """Return the frames that have arrived, oldest first, at most the last `KEPT`."""
        return list(self._frames)

    def summary(self) -> str:
        """Return a one-line summary of received and rejected frames."""
        lost = f", {self.lost} lost on the way" if self.lost else ""
        dropped = dropped_words(self.refused)
        return f"{self.taken} frames came{lost}" + (f"; {dropped}" if dropped else "")

    def _listen(self) -> None:
        while not self._done.is_set():
            try:
                datagram, address = self._socket.recvfrom(_HEAD.size + 12 * MOST_POINTS + TAG + 1)
            except OSError:  # no datagram, or an error caused by another program's datagram
                continue
            self._take(datagram, address, time.monotonic())

    def _take(self, datagram: bytes, address: Address, now: float) -> None:
        got = unpacked(datagram, self._key)
        if isinstance(got, str):
            self.refused[got] += 1
            return
        if self._count is not None and len(got.points) != self._count:
            self.refused["points"] += 1
            return
        if not self._counts(got.session, got.sequence, address, now):
            return
        last = self._last
        if last is not None:
            new = got.session != last[0].session
            if not new and got.stamp <= last[0].stamp:
                self.refused["replay"] += 1
                return
            if new or abs((now - last[1]) - (got.stamp - last[0].stamp)) > JUMP:
                # Another clock: assume that its first frame was as fast as the fastest before.
                self._shift, old = now - got.stamp - self._quickest, self._shift
                self._shift = max(self._shift, last[0].stamp + old - got.stamp + 1e-6)
        stamp = got.stamp + self._shift
        self._quickest = min(self._quickest, now - stamp)
        self._last = (got, now)
        points: NDArray[np.floating] = got.points
        if self._frame is not None:
            points = (points @ self._frame[:, :3].T + self._frame[:, 3]).astype(np.float32)
        self.taken += 1
        self._frames.append(Frame(stamp, now, points))
