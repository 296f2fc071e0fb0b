"""Hand landmarks over UDP, for boards that cannot run MediaPipe; also a heartbeat of the key.

Each datagram has DATAGRAM bytes, little-endian: mark `SMH1`, flags (1: a hand, 2: a right hand, 4:
the key is held), session (16 bytes), sequence number, the sender's clock (s), score, 21 points (x,
y) in px, and HMAC-SHA256 of all that under a shared key. Without the key, a datagram can be neither
created nor changed. Datagrams are not encrypted.

Datagrams belong to sessions (`link/session.py`). `age` of the newest message is the time since its
arrival plus its extra delay relative to the fastest message, so queued messages count as old.
Pinned by tests/robot/test_landmarks_udp.py.
"""

from __future__ import annotations

import math
import struct
import time
from dataclasses import dataclass

import numpy as np

from softmap_edge.errors import TeleopError
from softmap_edge.robot.link import session as signed_udp
from softmap_edge.robot.link.session import SESSION, TAG, Address, Listener, body_of, signed
from softmap_edge.robot.teleop.hand import LANDMARKS, Hand

MARK, OFFER_MARK = b"SMH1", b"SMO1"
_BODY = struct.Struct(f"<4sB16sQdf{2 * LANDMARKS}f")
DATAGRAM = _BODY.size + TAG
OFFER = len(OFFER_MARK) + SESSION + TAG
HAND, RIGHT, HELD = 1, 2, 4  # flags: a hand, a right hand, the key is held
MOST_AT_ONCE = 256  # datagrams that one call reads at most: a flood cannot block it
DRIFT = 1e-4  # s/s by which two clocks may drift apart; the fastest delay is forgotten at this rate


@dataclass(frozen=True, eq=False)
class Message:
    """A message of a sender: the detected hand, if any, and whether the key is held."""

    hand: Hand | None = None
    held: bool = False


@dataclass(frozen=True, eq=False)
class Received:
    """The newest message, its sequence number, and its `age` in s at the time of the call."""

    message: Message
    sequence: int
    age: float


def packed(
    message: Message, session: bytes, sequence: int, clock: float, key: bytes | None
) -> bytes:
    """Return the message as a signed datagram."""
    hand = message.hand
    flags = (HELD if message.held else 0) | (
        0 if hand is None else HAND | (RIGHT if hand.side == "right" else 0)
    )
    points = np.zeros(2 * LANDMARKS) if hand is None else hand.points.ravel()
    score = 0.0 if hand is None else hand.score
    return signed(key, _BODY.pack(MARK, flags, session, sequence, clock, score, *points))


def unpacked(datagram: bytes, key: bytes | None) -> tuple[Message, bytes, int, float] | str:
    """Return (message, session, sequence, sender's clock) of a datagram, or why it is rejected."""
    body = body_of(key, datagram, _BODY.size)
    if isinstance(body, str):
        return body
    mark, flags, session, sequence, clock, score, *points = _BODY.unpack(body)
    if mark != MARK or flags & ~(HAND | RIGHT | HELD) or not math.isfinite(clock):
        return "content"
    hand = None
    if flags & HAND:
        try:
            hand = Hand(
                np.reshape(points, (LANDMARKS, 2)), "right" if flags & RIGHT else "left", score
            )
        except TeleopError:
            return "content"
    return Message(hand, bool(flags & HELD)), session, sequence, clock


class Sender(signed_udp.Sender):
    """Send messages to `host`:`port`; a context manager.

    Raises:
        LinkError: no such host or port, or the key is too short.
    """

    def __init__(self, host: str, port: int, key: bytes) -> None:
        super().__init__(host, port, key, OFFER_MARK)

    def send(self, message: Message) -> bool:
        """Send one message; return False if it cannot be sent now (no network, no listener)."""
        return self._put(packed(message, *self._next(), time.monotonic(), self._key))


class Receiver(Listener):
    """Receive messages at `host`:`port` (0: any free port, see `.port`); a context manager.

    Call `newest()` at least once per camera frame. `.refused` counts rejected datagrams by reason:
    length, signature, content, and those of a `Listener`.

    Raises:
        LinkError: the address is not local or in use, or the key is too short.
    """

    def __init__(self, host: str, port: int, key: bytes) -> None:
        super().__init__(host, port, key, OFFER_MARK)
        self._last: tuple[Message, float] | None = None  # newest message and its extra delay, s
        self._taken = b""  # session of that message
        # smallest (arrival − sender's clock), s, and when it occurred
        self._quickest = (math.inf, 0.0)

    def newest(self) -> Received | None:
        """Return the newest message received, with its age; None before the first."""
        for _ in range(MOST_AT_ONCE):
            try:
                datagram, address = self._socket.recvfrom(DATAGRAM + 1)
            except BlockingIOError:
                break
            except OSError:
                continue
            self._take(datagram, address, time.monotonic())
        if self._last is None:
            return None
        message, lateness = self._last
        return Received(message, self._sequence, time.monotonic() - self._heard + lateness)

    def _take(self, datagram: bytes, address: Address, now: float) -> None:
        got = unpacked(datagram, self._key)
        if isinstance(got, str):
            self.refused[got] += 1
            return
        message, session, sequence, clock = got
        if not self._counts(session, sequence, address, now):
            return
        if session != self._taken:
            self._taken, self._quickest = session, (math.inf, 0.0)
        self._last = (message, self._lateness(now, clock))

    def _lateness(self, now: float, clock: float) -> float:
        """Return the delay (s) of a datagram beyond that of the fastest."""
        quickest, when = self._quickest
        least = min(quickest + DRIFT * (now - when), now - clock)
        self._quickest = (least, now)
        return (now - clock) - least
