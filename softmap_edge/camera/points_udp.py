"""Points that a camera program sees, sent to the robot's host over UDP (docs/camera.md).

    with PointSender("192.168.1.20", 9870, read_key("camera.key")) as out:
        out.send(points, stamp)          # (N, 3) mm in the base frame, NaN or `visible` for what is not seen; s

A datagram, little-endian: mark `SMP1`, N (u16), 0 (u16), session (u64), sequence number (u64), stamp (f64 s, the
camera's clock), 3 N coordinates (f32 mm), and HMAC-SHA256 of all that where both sides have a key. The session is a
random number of the sender; sequence numbers and stamps rise within it. While a sender is alive no other takes its
place, and a session that was left does not come back. Whatever else arrives is counted in `refused` and dropped.
Known limit: what was recorded before the receiver began can be played to it while nobody sends. Pinned by
tests/test_camera_points.py.
"""

from __future__ import annotations

import hmac
import math
import secrets
import socket
import struct
import threading
import time
from collections import Counter, deque
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.camera.frames import Frame
from softmap_edge.errors import TeleopError
from softmap_edge.signed_udp import TAG, Link, checked_key, open_udp, tag

MARK = b"SMP1"
_HEAD = struct.Struct("<4sHHQQd")
MOST_POINTS = 5000  # what one datagram carries
FARTHEST = 1e4  # mm
SILENCE = 0.5  # s after which a sender that is not heard may be followed by another
GONE = 0.5  # s without a frame after which a camera is gone
JUMP = 2.0  # s by which a sender's clock may leave ours between two frames before it counts as a new clock
KEPT = 9000  # frames: five minutes
WAIT = 0.2  # s that the receiver waits at a time
THIS_COMPUTER = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True, eq=False)
class Message:
    """What a datagram says: `points` (N, 3) mm, NaN where not seen, `stamp` s, and its place in a session."""

    points: NDArray[np.float32]
    stamp: float
    session: int
    sequence: int


def packed(message: Message, key: bytes | None = None) -> bytes:
    """Return a message as a datagram, signed where there is a key."""
    points = np.ascontiguousarray(message.points, "<f4")
    body = _HEAD.pack(MARK, len(points), 0, message.session, message.sequence, message.stamp) + points.tobytes()
    return body if key is None else body + tag(key, body)


def unpacked(datagram: bytes, key: bytes | None = None) -> Message | str:
    """Return what a datagram says, or in a word why it counts nothing: length, signature, content."""
    if len(datagram) < _HEAD.size:
        return "length"
    mark, count, zero, session, sequence, stamp = _HEAD.unpack_from(datagram)
    end = _HEAD.size + 12 * count
    if len(datagram) != end + (0 if key is None else TAG):
        return "length"
    body = datagram[:end]
    if key is not None and not hmac.compare_digest(datagram[end:], tag(key, body)):
        return "signature"
    points = np.frombuffer(body, "<f4", offset=_HEAD.size).reshape(count, 3).astype(np.float32)
    unseen = np.isnan(points).any(axis=1)
    fits = mark == MARK and zero == 0 and 1 <= count <= MOST_POINTS and math.isfinite(stamp)
    if not fits or np.any(np.abs(points[~unseen]) > FARTHEST):
        return "content"
    points[unseen] = np.nan
    return Message(points, stamp, session, sequence)


class PointSender(Link):
    """Sends frames to `host`:`port`; a context manager, to be closed.

    Raises:
        TeleopError: no such host, or the key is too short.
    """

    def __init__(self, host: str, port: int, key: bytes | None = None) -> None:
        self._key = None if key is None else checked_key(key)
        self._session, self._sequence = secrets.randbits(64), 0
        self._socket = open_udp(host, port, socket.socket.connect, "be reached", "check host and port")

    def send(self, points: ArrayLike, stamp: float | None = None, visible: ArrayLike | None = None) -> bool:
        """Send a frame; False where it could not be sent just now (no network, or nobody listens).

        Args:
            points: (N, 3) mm, NaN where not seen. stamp: s by the camera's clock; this moment without it.
            visible: (N,) bool.

        Raises:
            TeleopError: points that are none, or too many of them.
        """
        now = np.array(points, np.float32)
        if now.ndim != 2 or now.shape[1:] != (3,) or not 1 <= len(now) <= MOST_POINTS:
            raise TeleopError(f"points of shape {now.shape}; expected (N, 3) with 1 to {MOST_POINTS} points")
        if visible is not None:
            shown = np.asarray(visible, bool)
            if shown.shape != now.shape[:1]:
                raise TeleopError(f"visible of shape {shown.shape}, expected ({len(now)},) for {len(now)} points")
            now[~shown] = np.nan
        self._sequence += 1
        message = Message(now, time.monotonic() if stamp is None else float(stamp), self._session, self._sequence)
        datagram = packed(message, self._key)
        try:
            return self._socket.send(datagram) == len(datagram)
        except OSError:  # refused or unreachable: the other side may come back
            return False


class PointReceiver(Link):
    """Takes frames at `host`:`port` (0: any free one, see `.port`) from entering to leaving.

    `.refused` counts what was not taken, by why: length, signature, content, points (another number of them), sender
    (another one while ours is alive), replay (a number or stamp that did not rise, a session that was left). `.lost`
    counts the numbers that never came, `.taken` the frames.

    Args:
        key: shared with the sender; without it only this computer may send. count: how many points a frame has; any
            number without it. frame: (3, 4) [R | mm] from the camera to the base, as in a run of `softmap align`.

    Raises:
        TeleopError: the address is not ours or in use, the key is too short, or it is needed.
    """

    def __init__(
        self, host: str, port: int, key: bytes | None = None, *, count: int | None = None, frame: Any = None
    ) -> None:
        if key is None and host not in ("", *THIS_COMPUTER):
            raise TeleopError(
                f"udp://{host}:{port}: points of other computers need a shared key; without one give "
                "udp://127.0.0.1:PORT"
            )
        self._key = None if key is None else checked_key(key)
        self._count, self._frame = count, None if frame is None else np.asarray(frame, float)
        self.refused: Counter[str] = Counter()
        self.lost = self.taken = 0
        self._frames: deque[Frame] = deque(maxlen=KEPT)
        self._from: object = None
        self._last: tuple[Message, float] | None = None
        self._left: set[int] = set()
        self._shift, self._quickest = 0.0, math.inf  # of stamps: one clock through all sessions
        host = "127.0.0.1" if key is None and not host else host
        self._socket = open_udp(host, port, socket.socket.bind, "be listened at", "give a free port of this computer")
        self._socket.settimeout(WAIT)
        self.port = int(self._socket.getsockname()[1])
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def close(self) -> None:
        """Listen no more, and free the port; may be called again."""
        self._done.set()
        if self._thread.is_alive():
            self._thread.join(10 * WAIT)
        super().close()

    def seen(self) -> list[Frame]:
        """Return the frames that have arrived, oldest first, at most the last `KEPT`."""
        return list(self._frames)

    @property
    def silent(self) -> float:
        """How long no frame came, s; infinite before the first."""
        last = self._last
        return math.inf if last is None else time.monotonic() - last[1]

    def said(self) -> str:
        """Return what came, in a line."""
        dropped = ", ".join(f"{count} for {why}" for why, count in sorted(self.refused.items()))
        lost = f", {self.lost} lost on the way" if self.lost else ""
        return f"{self.taken} frames came{lost}" + (f"; datagrams dropped: {dropped}" if dropped else "")

    def _listen(self) -> None:
        while not self._done.is_set():
            try:
                datagram, address = self._socket.recvfrom(_HEAD.size + 12 * MOST_POINTS + TAG + 1)
            except OSError:  # nothing came, or what came back of another's datagram
                continue
            self._take(datagram, address, time.monotonic())

    def _take(self, datagram: bytes, address: object, now: float) -> None:
        got = unpacked(datagram, self._key)
        if isinstance(got, str):
            self.refused[got] += 1
            return
        if self._count is not None and len(got.points) != self._count:
            self.refused["points"] += 1
            return
        last = self._last
        new = last is None or got.session != last[0].session
        if last is not None and (new or address != self._from) and now - last[1] < SILENCE:
            self.refused["sender"] += 1
            return
        if got.session in self._left or (
            last is not None and not new and (got.sequence <= last[0].sequence or got.stamp <= last[0].stamp)
        ):
            self.refused["replay"] += 1
            return
        if last is not None:
            self.lost += 0 if new else got.sequence - last[0].sequence - 1
            if new:
                self._left.add(last[0].session)
            if new or abs((now - last[1]) - (got.stamp - last[0].stamp)) > JUMP:
                # Another clock: its first frame is taken to have come as quickly as the quickest did.
                self._shift, old = now - got.stamp - self._quickest, self._shift
                self._shift = max(self._shift, last[0].stamp + old - got.stamp + 1e-6)
        stamp = got.stamp + self._shift
        self._quickest = min(self._quickest, now - stamp)
        self._from, self._last = address, (got, now)
        points: NDArray[Any] = got.points
        if self._frame is not None:
            points = (points @ self._frame[:, :3].T + self._frame[:, 3]).astype(np.float32)
        self.taken += 1
        self._frames.append(Frame(stamp, now, points))
