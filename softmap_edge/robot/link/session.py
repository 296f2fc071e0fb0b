"""Sessions of signed datagrams: a key file, a signature, an address, a sender and a listener.

HMAC-SHA256 under a shared key: without the key a datagram can be read, but neither created nor
changed.

A session is a random number chosen by the listener. The listener offers it, signed, to a sender
that signs correctly under another one. Sequence numbers must increase within a session. So a
replayed datagram is never accepted, even after a restart of either side, and clocks need not agree.
While a sender is active, no other can take its place. Rejected datagrams are counted by reason and
not answered. The first datagrams of a sender only request the session. Without a key (programs on
one computer) datagrams are unsigned; all else is the same. `rust/control/heartbeat.rs` is another
listener. Pinned by tests/robot/test_landmarks_udp.py, tests/robot/test_camera_points.py and
tests/robot/test_emergency.py.
"""

from __future__ import annotations

import hashlib
import hmac
import math
import os
import re
import secrets
import socket
import stat
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from softmap_edge.errors import LinkError
from softmap_edge.files.refusals import refusal

# an IPv4 address, an IPv6 address, and one without IPv6 support, as Python returns them
Address = tuple[str, int] | tuple[str, int, int, int] | tuple[int, bytes]

TAG = 32  # bytes of HMAC-SHA256
SESSION = 16  # bytes of a session number
NO_SESSION = bytes(SESSION)
SILENCE = 0.5  # s without a datagram after which another sender may take over
OFFER_LASTS = 1.0  # s for which an offered session can be accepted
MOST_OFFERS = 64  # offers that are read at a time
SHORTEST_KEY = 16  # bytes


def new_key(path: str | Path) -> bytes:
    """Write a random 32-byte key as text to a new file readable by its owner alone, and return it.

    Raises:
        LinkError: the file exists, or cannot be written.
    """
    key, made = secrets.token_bytes(32), False
    try:
        with open(
            os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii"
        ) as file:
            made = True
            file.write(key.hex() + "\n")
    except FileExistsError:
        raise LinkError(f"{path}: it exists; give the name of a new file for the key") from None
    except OSError as cause:
        if made:  # not half a key
            Path(path).unlink(missing_ok=True)
        raise LinkError(refusal(cause, path)) from None
    return key


def read_key(path: str | Path) -> bytes:
    """Return the key in a file that `new_key` wrote.

    Raises:
        LinkError: the file cannot be read, other users may read it, or it holds no key.
    """
    try:
        # Do not block on a pipe without a writer.
        with open(
            path, "rb", opener=lambda file, flags: os.open(file, flags | os.O_NONBLOCK)
        ) as file:
            mode = os.fstat(file.fileno()).st_mode
            text = file.read(1025) if stat.S_ISREG(mode) else b""
    except OSError as cause:
        raise LinkError(
            f"{path}: the key cannot be read ({cause.strerror}); copy it from the other computer"
        ) from None
    if mode & 0o077:
        raise LinkError(f"{path}: others can read this key; run chmod 600 {path}")
    try:
        key = bytes.fromhex(text.decode("ascii").strip()) if len(text) <= 1024 else b""
    except ValueError:
        key = b""
    return checked_key(key)


def checked_key(key: bytes) -> bytes:
    """Return a key that is long enough.

    Raises:
        LinkError: the key is too short.
    """
    if len(key) < SHORTEST_KEY:
        raise LinkError(
            f"key: {len(key)} bytes in hexadecimal digits, at least {SHORTEST_KEY} are needed; "
            "make a new one"
        )
    return key


def tag(key: bytes, body: bytes) -> bytes:
    """Return the signature of `body`, TAG bytes."""
    return hmac.new(key, body, hashlib.sha256).digest()


def signed(key: bytes | None, body: bytes) -> bytes:
    """Return `body` as a datagram, followed by its tag if there is a key."""
    return body if key is None else body + tag(key, body)


def body_of(key: bytes | None, datagram: bytes, size: int) -> bytes | str:
    """Return the first `size` bytes of a `signed` datagram, or the fault: length or signature."""
    if len(datagram) != size + (0 if key is None else TAG):
        return "length"
    body = datagram[:size]
    if key is not None and not hmac.compare_digest(datagram[size:], tag(key, body)):
        return "signature"
    return body


class _Link:
    """An open socket and its key; a context manager."""

    def __init__(self, key: bytes | None, opened: socket.socket) -> None:
        self._key, self._socket = key, opened

    def close(self) -> None:
        """Close the socket; may be called again."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()


class Sender(_Link):
    """Send to `host`:`port`; the base of a class with its own datagram layout.

    Offers follow `mark`.

    Raises:
        LinkError: no such host or port, or the key is too short.
    """

    def __init__(
        self,
        host: str,
        port: int,
        key: bytes | None,
        mark: bytes,
        mend: str = "check host and port",
    ) -> None:
        key = None if key is None else checked_key(key)
        super().__init__(key, _open(host, port, socket.socket.connect, "be reached", mend))
        self._mark, self._session, self._sequence = mark, NO_SESSION, 0

    @property
    def heard(self) -> bool:
        """Whether the listener has answered; until then datagrams only request a session."""
        return self._session != NO_SESSION

    def _next(self) -> tuple[bytes, int]:
        """Return the newest session offered by the listener, and the next sequence number."""
        size = len(self._mark) + SESSION
        for _ in range(MOST_OFFERS):
            try:
                offer = self._socket.recv(size + TAG + 1)
            except BlockingIOError:
                break
            except OSError:
                continue  # the answer to an earlier datagram
            body = body_of(self._key, offer, size)
            if isinstance(body, bytes) and body.startswith(self._mark):
                self._session = body[len(self._mark) :]
        self._sequence += 1
        return self._session, self._sequence

    def _put(self, datagram: bytes) -> bool:
        """Send a datagram; return False if it cannot be sent now (no network, no listener)."""
        try:
            return self._socket.send(datagram) == len(datagram)
        except OSError:  # refused or unreachable: the other side may return
            return False


class Listener(_Link):
    """Listen at `host`:`port`; the base of a class with its own datagram layout.

    Port 0 is any free port, see `.port`. `.refused` counts rejected datagrams by reason: session
    (of another listener), replay (a sequence number that did not increase), sender (another one
    while ours is active), and the reasons of the layout. `.lost` counts sequence numbers that never
    arrived.

    Raises:
        LinkError: the address is not local or in use, or the key is too short.
    """

    def __init__(self, host: str, port: int, key: bytes | None, mark: bytes) -> None:
        key = None if key is None else checked_key(key)
        mend = "give a free port of this computer"
        super().__init__(key, _open(host, port, socket.socket.bind, "be listened at", mend))
        self.port = int(self._socket.getsockname()[1])
        self.refused: Counter[str] = Counter()
        self.lost = 0
        self._mark = mark
        # our session; an offered one, and when it was first offered
        self._session, self._offered = b"", (b"", -math.inf)
        self._from: object = None
        # last accepted datagram: its number, and its arrival, s
        self._sequence, self._heard = 0, -math.inf

    def _counts(self, session: bytes, sequence: int, address: Address, now: float) -> bool:
        """Return whether a correctly signed datagram from `address` at `now` s is accepted.

        Otherwise count the reason.
        """
        offered, since = self._offered
        another = address != self._from and now - self._heard < SILENCE
        if another:
            self.refused["sender"] += 1
        elif session == offered and now - since < OFFER_LASTS:
            # A sender that signs under the offered session is live; a replay cannot.
            self._session, self._offered, self._sequence = session, (b"", -math.inf), sequence - 1
        elif session != self._session:
            if session != NO_SESSION:  # a request for a session is not rejected
                self.refused["session"] += 1
            self._offer(address, now)
        if another or session != self._session:
            return False
        if sequence <= self._sequence:
            self.refused["replay"] += 1
            return False
        self.lost += sequence - self._sequence - 1
        self._from, self._sequence, self._heard = address, sequence, now
        return True

    def _offer(self, address: Address, now: float) -> None:
        """Offer our session to a sender with the right key but another session."""
        if now - self._offered[1] >= OFFER_LASTS:
            self._offered = (secrets.token_bytes(SESSION), now)
        try:
            self._socket.sendto(signed(self._key, self._mark + self._offered[0]), address)
        except OSError:
            return  # the sender asks again with its next datagram


def dropped_words(refused: Mapping[str, int]) -> str:
    """Return a line on the numbers of rejected datagrams by reason; empty if there are none."""
    counts = ", ".join(f"{count} for {why}" for why, count in sorted(refused.items()))
    return f"datagrams dropped: {counts}" if counts else ""


def udp_address(text: str) -> tuple[str, int]:
    """Return (host, port) of `udp://HOST:PORT`.

    The host may be omitted, or be an IPv6 address in brackets.

    Raises:
        LinkError: it is not such an address.
    """
    found = re.fullmatch(r"udp://(?:\[([0-9A-Fa-f:.%]+)\]|([^\[\]:/@]*)):(\d{1,5})/?", text)
    if found is None or not 1 <= int(found[3]) <= 65535:
        raise LinkError(
            f"'{text[:80]}' is not an address; give udp://HOST:PORT with a port of 1 to 65535"
        )
    return found[1] or found[2] or "", int(found[3])


def _open(
    host: str, port: int, use: Callable[[socket.socket, Address], None], what: str, mend: str
) -> socket.socket:
    """Return a non-blocking socket, connected or bound (`use`) to an address.

    If a host has both, it is the IPv4 address.

    Raises:
        LinkError: this fails; the message states `what`, and the remedy `mend`.
    """
    if not (1 if use is socket.socket.connect else 0) <= port <= 65535:
        raise LinkError(f"udp://{host}:{port}: ports are 1 to 65535; {mend}")
    try:
        found = socket.getaddrinfo(
            host or None, port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE
        )
        family, kind, proto, _, address = min(found, key=lambda entry: entry[0] != socket.AF_INET)
        opened = socket.socket(family, kind, proto)
        try:
            use(opened, address)  # connected, so that datagrams of other hosts do not arrive
        except BaseException:
            opened.close()
            raise
    except (OSError, UnicodeError) as cause:
        raise LinkError(f"udp://{host}:{port}: cannot {what} ({cause!s:.80}); {mend}") from None
    opened.setblocking(False)
    return opened
