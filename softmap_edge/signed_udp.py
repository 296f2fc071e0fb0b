"""What datagrams of this package share: a key in a file, a signature, an address, a socket and its end.

HMAC-SHA256 under a shared key: whoever has no key can neither write nor change a datagram; they are not secret.
Pinned by tests/test_landmarks_udp.py and tests/test_camera_points.py.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
import socket
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from softmap_edge.errors import TeleopError

TAG = 32  # bytes of HMAC-SHA256
SESSION = 16  # bytes that name a session
MOST_AT_ONCE = 64  # offers that are taken in at a time
SHORTEST_KEY = 16  # bytes


def new_key(path: str | Path) -> bytes:
    """Write a key of 32 random bytes as text to a new file that its owner alone can read, and return it.

    Raises:
        TeleopError: the file is there already, or cannot be written.
    """
    key = secrets.token_bytes(32)
    try:
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(key.hex() + "\n")
    except OSError as cause:
        raise TeleopError(f"{path}: the key cannot be written ({cause.strerror}); give a new file") from None
    return key


def read_key(path: str | Path) -> bytes:
    """Return the key in a file that `new_key` wrote.

    Raises:
        TeleopError: it cannot be read, others may read it, or it is no key.
    """
    try:
        with open(path, "rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            text = file.read(1025)
    except OSError as cause:
        raise TeleopError(
            f"{path}: the key cannot be read ({cause.strerror}); copy it from the other computer"
        ) from None
    if mode & 0o077:
        raise TeleopError(f"{path}: others can read this key; run chmod 600 {path}")
    try:
        key = bytes.fromhex(text.decode("ascii").strip()) if len(text) <= 1024 else b""
    except ValueError:
        key = b""
    return checked_key(key)


def checked_key(key: bytes) -> bytes:
    """Return a key that is long enough.

    Raises:
        TeleopError: it is not.
    """
    if len(key) < SHORTEST_KEY:
        raise TeleopError(
            f"key: {len(key)} bytes in hexadecimal digits, at least {SHORTEST_KEY} are needed; make a new one"
        )
    return key


def tag(key: bytes, body: bytes) -> bytes:
    """Return what signs `body`, TAG bytes."""
    return hmac.new(key, body, hashlib.sha256).digest()


class Link:
    """What talks through a `_socket` of its own: a context manager, to be closed."""

    _socket: socket.socket

    def close(self) -> None:
        """Close the socket; may be called again."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, fault: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def offered(link: socket.socket, key: bytes, mark: bytes, session: bytes) -> bytes:
    """Return the newest session (SESSION bytes) that the other side of `link` offers, signed and behind `mark`;
    `session` where it offers none."""
    size = len(mark) + SESSION + TAG
    for _ in range(MOST_AT_ONCE):
        try:
            offer = link.recv(size + 1)
        except BlockingIOError:
            break
        except OSError:
            continue  # what came back of an earlier datagram
        body = offer[: size - TAG]
        right = len(offer) == size and body.startswith(mark)
        if right and hmac.compare_digest(offer[len(body) :], tag(key, body)):
            session = body[len(mark) :]
    return session


def udp_address(text: str) -> tuple[str, int]:
    """Return (host, port) of `udp://HOST:PORT`; the host may be left out, or be an IPv6 address in brackets.

    Raises:
        TeleopError: it is no such address.
    """
    found = re.fullmatch(r"udp://(?:\[([0-9A-Fa-f:.%]+)\]|([^\[\]:/@]*)):(\d{1,5})/?", text)
    if found is None or not 1 <= int(found[3]) <= 65535:
        raise TeleopError(f"'{text[:80]}' is no address; give udp://HOST:PORT with a port of 1 to 65535")
    return found[1] or found[2] or "", int(found[3])


def open_udp(host: str, port: int, use: Callable[[socket.socket, Any], None], what: str, mend: str) -> socket.socket:
    """Return a socket that never waits, connected or bound (`use`) to an address; IPv4 where a host has both.

    Raises:
        TeleopError: it cannot; the line says `what`, and how to `mend` it.
    """
    if not 0 <= port <= 65535:
        raise TeleopError(f"udp://{host}:{port}: ports are 1 to 65535; {mend}")
    try:
        found = socket.getaddrinfo(host or None, port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE)
        family, kind, proto, _, address = min(found, key=lambda entry: entry[0] != socket.AF_INET)
        opened = socket.socket(family, kind, proto)
        try:
            use(opened, address)  # connected, so that offers of others do not arrive
        except BaseException:
            opened.close()
            raise
    except (OSError, UnicodeError) as cause:
        raise TeleopError(f"udp://{host}:{port}: cannot {what} ({cause!s:.80}); {mend}") from None
    opened.setblocking(False)
    return opened
