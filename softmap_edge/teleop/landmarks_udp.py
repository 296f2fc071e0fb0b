"""Landmarks of a hand over UDP from another computer, for boards that cannot run MediaPipe; also a heartbeat.

A datagram is DATAGRAM bytes, little-endian, of one layout: mark `SMH1`, flags (1: a hand, 2: a right hand, 4: the key
is held), session (16 bytes), sequence number, the sender's clock (s), score, 21 points (x, y) in px, and HMAC-SHA256
of all that under a shared key. Whoever has no key can neither write nor change one; they are not secret.

The session is a random number of the receiver's: it sends it, signed, to who signs rightly under another one, and
sequence numbers must rise within it. So a recorded datagram counts nowhere again, also after either side was started
anew, and no clocks need agree. While a sender is alive no other takes its place. `age` of what is newest counts from
its arrival, and adds by how much later it arrived than the quickest did: what stood in a queue is old.
Whatever else arrives is counted in `Receiver.refused`, and nothing of it is answered. Pinned by
tests/test_landmarks_udp.py.
"""

from __future__ import annotations

import hmac
import math
import secrets
import socket
import struct
import time
from collections import Counter
from dataclasses import dataclass

import numpy as np

from softmap_edge.errors import TeleopError
from softmap_edge.signed_udp import TAG, Link, checked_key, offered, open_udp, tag
from softmap_edge.teleop.hand import LANDMARKS, Hand

MARK, OFFER_MARK = b"SMH1", b"SMO1"
_BODY = struct.Struct(f"<4sB16sQdf{2 * LANDMARKS}f")
DATAGRAM = _BODY.size + TAG
OFFER = len(OFFER_MARK) + 16 + TAG
HAND, RIGHT, HELD = 1, 2, 4
NO_SESSION = bytes(16)
SILENCE = 0.5  # s after which a sender that is not heard may be followed by another
OFFER_LASTS = 1.0  # s for which a session that was offered can be taken up
MOST_AT_ONCE = 256  # datagrams that one call reads: a flood cannot hold it up
DRIFT = 1e-4  # s a second by which two clocks may part: what counts as the quickest forgets as fast


@dataclass(frozen=True, eq=False)
class Message:
    """What a sender says: the hand that it sees, if any, and whether its operator holds the key."""

    hand: Hand | None = None
    held: bool = False


@dataclass(frozen=True, eq=False)
class Received:
    """The newest message, its sequence number, and its `age` in s when it was asked for."""

    message: Message
    sequence: int
    age: float


def packed(message: Message, session: bytes, sequence: int, clock: float, key: bytes) -> bytes:
    """Return a message as a signed datagram."""
    hand = message.hand
    flags = (HELD if message.held else 0) | (0 if hand is None else HAND | (RIGHT if hand.side == "right" else 0))
    points = np.zeros(2 * LANDMARKS) if hand is None else hand.points.ravel()
    score = 0.0 if hand is None else hand.score
    body = _BODY.pack(MARK, flags, session, sequence, clock, score, *points)
    return body + tag(key, body)


def unpacked(datagram: bytes, key: bytes) -> tuple[Message, bytes, int, float] | str:
    """Return (message, session, sequence, sender's clock) of a datagram, or in a word why it counts nothing."""
    if len(datagram) != DATAGRAM:
        return "length"
    body = datagram[: _BODY.size]
    if not hmac.compare_digest(datagram[_BODY.size :], tag(key, body)):
        return "signature"
    mark, flags, session, sequence, clock, score, *points = _BODY.unpack(body)
    if mark != MARK or flags & ~(HAND | RIGHT | HELD) or not math.isfinite(clock):
        return "content"
    hand = None
    if flags & HAND:
        try:
            hand = Hand(np.reshape(points, (LANDMARKS, 2)), "right" if flags & RIGHT else "left", score)
        except TeleopError:
            return "content"
    return Message(hand, bool(flags & HELD)), session, sequence, clock


class Sender(Link):
    """Sends messages to `host`:`port`; a context manager, to be closed.

    Raises:
        TeleopError: no such host, or the key is too short.
    """

    def __init__(self, host: str, port: int, key: bytes) -> None:
        self._key, self._session, self._sequence = checked_key(key), NO_SESSION, 0
        self._socket = open_udp(host, port, socket.socket.connect, "be reached", "check host and port")

    @property
    def known(self) -> bool:
        """Whether the receiver has been heard; until then what is sent only asks for its session."""
        return self._session != NO_SESSION

    def send(self, message: Message) -> bool:
        """Send one message; False where it could not be sent just now (no network, or nobody listens)."""
        self._listen()
        self._sequence += 1
        datagram = packed(message, self._session, self._sequence, time.monotonic(), self._key)
        try:
            return self._socket.send(datagram) == DATAGRAM
        except OSError:  # refused or unreachable: the other side may come back
            return False

    def _listen(self) -> None:
        """Take the newest session that the receiver offers."""
        self._session = offered(self._socket, self._key, OFFER_MARK, self._session)


class Receiver(Link):
    """Takes messages at `host`:`port` (0: any free one, see `.port`); a context manager, to be closed.

    `newest()` is to be asked at least as often as pictures come. `.refused` counts what was not taken, by why:
    length, signature, content, session (of one that is not ours), replay (a number that did not rise), sender (another
    one while ours is alive). `.lost` counts the numbers that never came.

    Raises:
        TeleopError: the address is not ours or in use, or the key is too short.
    """

    def __init__(self, host: str, port: int, key: bytes) -> None:
        self._key, self._session = checked_key(key), secrets.token_bytes(16)
        self._offered = (b"", -math.inf)  # a session, and when it was first offered
        self.refused: Counter[str] = Counter()
        self.lost = 0
        self._from: tuple[object, ...] | None = None
        self._last: tuple[Message, int, float, float] | None = None  # message, sequence, arrival, lateness
        self._quickest = (math.inf, 0.0)  # smallest of arrival − sender's clock, and when that was
        self._socket = open_udp(host, port, socket.socket.bind, "be listened at", "give a free port of this computer")
        self.port = int(self._socket.getsockname()[1])

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
        message, sequence, arrival, lateness = self._last
        return Received(message, sequence, time.monotonic() - arrival + lateness)

    def _take(self, datagram: bytes, address: tuple[object, ...], now: float) -> None:
        got = unpacked(datagram, self._key)
        if isinstance(got, str):
            self.refused[got] += 1
            return
        message, session, sequence, clock = got
        offered, since = self._offered
        if session == offered and now - since < OFFER_LASTS and not self._other_alive(address, now):
            # Who signs under what was just offered has answered now: no recording could.
            self._session, self._offered = session, (b"", -math.inf)
            self._from, self._last, self._quickest = address, None, (math.inf, 0.0)
        elif session != self._session:
            self._offer(address, now)
            return
        elif address != self._from and self._other_alive(address, now):
            self.refused["sender"] += 1
            return
        if self._last is not None and sequence <= self._last[1]:
            self.refused["replay"] += 1
            return
        self.lost += 0 if self._last is None else sequence - self._last[1] - 1
        self._from = address
        self._last = (message, sequence, now, self._lateness(now, clock))

    def _other_alive(self, address: tuple[object, ...], now: float) -> bool:
        return self._last is not None and address != self._from and now - self._last[2] < SILENCE

    def _offer(self, address: tuple[object, ...], now: float) -> None:
        """Tell who signs rightly, but not under our session, what to sign under."""
        if self._other_alive(address, now):
            self.refused["sender"] += 1
            return
        self.refused["session"] += 1
        if now - self._offered[1] >= OFFER_LASTS:
            self._offered = (secrets.token_bytes(16), now)
        body = OFFER_MARK + self._offered[0]
        try:
            self._socket.sendto(body + tag(self._key, body), address)
        except OSError:
            return  # it asks again with its next datagram

    def _lateness(self, now: float, clock: float) -> float:
        """By how much later than the quickest a datagram came, in s."""
        quickest, when = self._quickest
        least = min(quickest + DRIFT * (now - when), now - clock)
        self._quickest = (least, now)
        return (now - clock) - least
