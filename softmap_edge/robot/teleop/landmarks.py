"""Landmarks of a hand over UDP, for boards that cannot run MediaPipe; also a heartbeat.

A datagram is DATAGRAM bytes, little-endian, of one layout: mark `SMH1`, flags (1: a hand, 2: a
right hand, 4: the key is held), session (16 bytes), sequence number, the sender's clock (s), score,
21 points (x, y) in px, and HMAC-SHA256 of all that under a shared key. A sender without the key can
neither write nor change one; they are not encrypted.

It is sent and listened for in sessions (`signed_udp`). `age` of what is newest counts from its
arrival, and adds by how much later it arrived than the quickest did: what stood in a queue is old.
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
HAND, RIGHT, HELD = 1, 2, 4
MOST_AT_ONCE = 256  # datagrams that one call reads: a flood cannot hold it up
DRIFT = 1e-4  # s a second by which two clocks may part: what counts as the quickest forgets as fast


@dataclass(frozen=True, eq=False)
class Message:
    """A message of a sender: the hand that it sees, if any, and whether the key is held."""

    hand: Hand | None = None
    held: bool = False


@dataclass(frozen=True, eq=False)
class Received:
    """The newest message, its sequence number, and its `age` in s when it was asked for."""

    message: Message
    sequence: int
    age: float


def packed(
    message: Message, session: bytes, sequence: int, clock: float, key: bytes | None
) -> bytes:
    """Return a message as a signed datagram."""
    hand = message.hand
    flags = (HELD if message.held else 0) | (
        0 if hand is None else HAND | (RIGHT if hand.side == "right" else 0)
    )
    points = np.zeros(2 * LANDMARKS) if hand is None else hand.points.ravel()
    score = 0.0 if hand is None else hand.score
    return signed(key, _BODY.pack(MARK, flags, session, sequence, clock, score, *points))


def unpacked(datagram: bytes, key: bytes | None) -> tuple[Message, bytes, int, float] | str:
    """Return (message, session, sequence, sender's clock) of a datagram, or what is wrong.

    The latter is a word for why it is rejected.
    """
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
    """Sends messages to `host`:`port`; a context manager, to be closed.

    Raises:
        LinkError: no such host or port, or the key is too short.
    """

    def __init__(self, host: str, port: int, key: bytes) -> None:
        super().__init__(host, port, key, OFFER_MARK)

    def send(self, message: Message) -> bool:
        """Send one message; False where it could not be sent now (no network, no listener)."""
        return self._put(packed(message, *self._next(), time.monotonic(), self._key))


class Receiver(Listener):
    """Takes messages at `host`:`port` (0: any free one, see `.port`); a context manager.

    `newest()` is to be asked at least as often as pictures come. `.refused` counts what was not
    taken, by why: length, signature, content, and those of a `Listener`.

    Raises:
        LinkError: the address is not ours or in use, or the key is too short.
    """

    def __init__(self, host: str, port: int, key: bytes) -> None:
        super().__init__(host, port, key, OFFER_MARK)
        self._last: tuple[Message, float] | None = None  # and its lateness
        self._taken = b""  # the session of that
        self._quickest = (math.inf, 0.0)  # smallest of arrival − sender's clock, and when that was

    def newest(self) -> Received | None:
        """Return the newest message of all that arrived, with its age; None before the first."""
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
        """By how much later than the quickest a datagram came, in s."""
        quickest, when = self._quickest
        least = min(quickest + DRIFT * (now - when), now - clock)
        self._quickest = (least, now)
        return (now - clock) - least
