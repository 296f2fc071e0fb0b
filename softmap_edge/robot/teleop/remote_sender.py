"""The sender for `--camera udp://`: sends landmarks and the state of the enable key.

Pinned by tests/robot/test_teleop_verb.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

from softmap_edge.files.atomic import Document
from softmap_edge.robot.teleop.hand_source import SEEN, HandSource
from softmap_edge.robot.teleop.keys import Input
from softmap_edge.robot.teleop.landmarks import Message, Sender

UNHEARD = (
    "no answer from there yet: `softmap teleop --camera udp://:PORT` must run there, with the "
    "same key"
)
EVERY = 0.05  # s between two messages at most, also without new frames: the heartbeat of the key


@dataclass
class Sent:
    """Number of messages sent, and why sending ended."""

    sent: int = 0
    ended: str = ""
    failed: bool = False

    def to_dict(self) -> Document:
        """Return it as entries of the document."""
        return asdict(self)


def send(
    eyes: HandSource,
    sender: Sender,
    key: Input | None,
    seconds: float | None,
    say: Callable[[str], None],
) -> Sent:
    """Send what the entered `eyes` see until they, a time limit (s) or the `key` ends it.

    Without a `key`, no key is held here.
    """
    done = Sent()
    number = -1
    begun = time.monotonic()
    line = ""
    try:
        while not done.ended:
            eyes.wait(number, EVERY)
            now = time.monotonic()
            sight = eyes.newest()
            number = -1 if sight is None else sight.number
            held = key is not None and key.controls(now).held
            hand = sight.hand if sight is not None and now - sight.t <= SEEN else None
            done.sent += sender.send(Message(hand, held))
            text = ("sending" if sender.heard else UNHEARD) + ("" if hand else "; no hand is seen")
            if text != line:
                line = text
                say(text)
            if eyes.gone:
                done.ended, done.failed = eyes.gone, True
            elif eyes.over:
                done.ended = f"{eyes.name}: has ended"
            elif seconds is not None and now - begun >= seconds:
                done.ended = f"after {seconds:g} s, as asked"
            elif key is not None and key.asked() == "end":
                done.ended = "ended at the terminal"
    except KeyboardInterrupt:
        done.ended = "interrupted"
    for _ in range(3):  # report the release three times, since datagrams can be lost
        sender.send(Message())
    return done
