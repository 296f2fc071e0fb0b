"""The emergency stop on another computer: a heart that beats over UDP while nobody presses it.

    with Heart("robot.local", 5006, read_key("stop.key")) as heart:
        while True:
            heart.beat(pressed=button())
            time.sleep(0.02)

Whoever stops beating has pressed it: the control loop switches torque off (docs/safety.md). Datagrams and sessions are
those of `rust/control/heartbeat.rs`, which listens. Pinned by tests/test_emergency.py.
"""

from __future__ import annotations

import socket
import struct
import time

from softmap_edge.errors import ServoError
from softmap_edge.signed_udp import TAG, Link, offered, tag

MARK, OFFER_MARK = b"SMB1", b"SMC1"
_BODY = struct.Struct("<4sB16sQQ")
BEAT = _BODY.size + TAG
PRESSED = 1
NO_SESSION = bytes(16)


class Heart(Link):
    """Beats for the robot at `host`:`port`, signed with `key`; a context manager, to be closed, which the robot takes
    for pressed.

    Raises:
        ServoError: no such host or port.
    """

    def __init__(self, host: str, port: int, key: bytes) -> None:
        if not 1 <= port <= 65_535:
            raise ServoError(
                f"{host}:{port}: ports are 1 to 65535; give the one in [emergency] of the robot's rig.toml"
            )
        self._key, self._session, self._sequence = key, NO_SESSION, 0
        try:
            found = socket.getaddrinfo(host, port, family=socket.AF_INET, type=socket.SOCK_DGRAM)
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.connect(found[0][4])
        except (OSError, UnicodeError) as cause:
            raise ServoError(f"{host}:{port} cannot be reached ({cause!s:.80}); check host and port") from None
        self._socket.setblocking(False)

    @property
    def heard(self) -> bool:
        """Whether the robot has answered: what beats for nobody holds nobody."""
        return self._session != NO_SESSION

    def beat(self, pressed: bool = False) -> bool:
        """Beat once, and say whether the stop is `pressed`; False where it could not be sent just now."""
        self._listen()
        self._sequence += 1
        body = _BODY.pack(MARK, PRESSED if pressed else 0, self._session, self._sequence, time.monotonic_ns())
        try:
            return self._socket.send(body + tag(self._key, body)) == BEAT
        except OSError:  # nobody listens there, or no network: the robot may come back
            return False

    def _listen(self) -> None:
        """Take the newest session that the robot offers."""
        self._session = offered(self._socket, self._key, OFFER_MARK, self._session)
