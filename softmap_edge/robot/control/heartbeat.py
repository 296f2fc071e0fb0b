"""The emergency stop on another computer: UDP heartbeats while it is not pressed.

    with Heart("robot.local", 5006, read_key("stop.key")) as heart:
        while True:
            heart.beat(pressed=button())
            time.sleep(0.02)

If no heartbeat arrives, the control loop switches torque off (docs/reference/safety.md).
`rust/control/heartbeat.rs` receives the datagrams and defines their form and their sessions. Pinned
by tests/robot/test_emergency.py.
"""

from __future__ import annotations

import struct
import time

from softmap_edge.robot.link.session import TAG, Sender, signed

MARK, OFFER_MARK = b"SMB1", b"SMC1"
_BODY = struct.Struct("<4sB16sQQ")
BEAT = _BODY.size + TAG
PRESSED = 1


class Heart(Sender):
    """Send heartbeats to the robot at `host`:`port`, signed with `key`; a context manager.

    Closing it presses the stop. `.heard` is whether the robot has answered; until then heartbeats
    have no effect.

    Raises:
        LinkError: no such host or port, or the key is too short.
    """

    def __init__(self, host: str, port: int, key: bytes) -> None:
        mend = "give the host, and the port in [emergency] of the robot's rig.toml"
        super().__init__(host, port, key, OFFER_MARK, mend)

    def beat(self, pressed: bool = False) -> bool:
        """Send a heartbeat, with the stop `pressed` or not; return False if it cannot be sent."""
        session, sequence = self._next()
        flags = PRESSED if pressed else 0
        return self._put(
            signed(self._key, _BODY.pack(MARK, flags, session, sequence, time.monotonic_ns()))
        )
