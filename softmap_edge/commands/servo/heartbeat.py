"""The action `servo heartbeat`: the emergency stop on another computer."""

from __future__ import annotations

import argparse
import json
import os
import select
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from softmap_edge.commands.output import check_idle
from softmap_edge.errors import ServoError
from softmap_edge.robot.control.heartbeat import Heart
from softmap_edge.robot.link.session import new_key, read_key
from softmap_edge.robot.servo.terminal import Typed, terminal

EVERY = 0.02  # s between two beats
UNHEARD = 5.0  # s without an answer after which a warning is printed
KEYS = "space presses the stop, r releases it, q or Ctrl-C ends the heartbeat, which presses it too"


@dataclass(frozen=True)
class HeartbeatOptions:
    """Options of `softmap servo heartbeat`, as its parser declares them."""

    robot: str | None
    key: str | None
    new_key: str | None
    every: float | None
    json: bool


def heartbeat_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo heartbeat`."""
    parser.add_argument(
        "robot",
        nargs="?",
        metavar="HOST:PORT",
        help="robot with this port in [emergency] udp of its rig.toml",
    )
    parser.add_argument("--key", metavar="FILE", help="key shared by both computers")
    parser.add_argument(
        "--new-key",
        metavar="FILE",
        help="make a key to copy to both computers; send no heartbeat",
    )
    parser.add_argument("--every", type=float, metavar="S", help=f"between beats ({EVERY:g})")


def heartbeat(args: HeartbeatOptions) -> int:
    """Send beats until Ctrl-C, `q` or `end`; return 0.

    Keys of the terminal press and release the stop; without a terminal, the lines `press` and
    `release` on standard input do.
    """
    every = EVERY if args.every is None else args.every
    if args.new_key is not None:
        beating = {"HOST:PORT": args.robot, "--key": args.key, "--every": args.every}
        check_idle(beating, "--new-key only makes a key; leave it out, and beat afterwards")
        new_key(args.new_key)
        document = {"schema": "softmap.key/1", "key": args.new_key}
        print(
            json.dumps(document)
            if args.json
            else f"{args.new_key}: written; copy it to the other computer"
        )
        return 0
    host, _, port = (args.robot or "").rpartition(":")
    if not host or not port.isdecimal() or args.key is None:
        raise ServoError(
            "give HOST:PORT of the robot and --key FILE, or --new-key FILE to make one"
        )
    if not 0.001 <= every <= 1.0:
        raise ServoError(
            f"--every {every:g} s; allowed is 0.001 to 1 s, well below the timeout in rig.toml"
        )
    pressed = False
    beats = 0
    warned = False
    begun = time.monotonic()
    with Heart(host, int(port), read_key(args.key)) as heart, _keys() as keys:
        if not args.json:
            print(f"beating for {args.robot}: {KEYS}", flush=True)
        try:
            due = time.monotonic()
            while True:
                for asked in keys:
                    if asked == "end":
                        raise KeyboardInterrupt
                    if asked is None:
                        break
                    pressed = asked == "press"
                    if not args.json:
                        print("pressed" if pressed else "released", flush=True)
                heart.beat(pressed)
                beats += 1
                if not warned and not heart.heard and time.monotonic() - begun > UNHEARD:
                    warned = True
                    print(
                        f"{args.robot} does not answer: no loop runs there, or its key is another",
                        file=sys.stderr,
                    )
                due = max(due + every, time.monotonic() - every)
                time.sleep(max(0.0, due - time.monotonic()))
        except KeyboardInterrupt:
            for _ in range(3):  # stops the robot before the timeout
                heart.beat(pressed=True)
    if args.json:
        print(json.dumps({"schema": "softmap.heartbeat/1", "beats": beats, "heard": heart.heard}))
    return 0


@contextmanager
def _keys() -> Iterator[Iterator[str | None]]:
    """Yield an iterator of new requests: `press`, `release` or `end`, then None once none is left.

    The iterator never waits.
    """
    if (file := terminal()) is None:
        yield _lines()
        return
    with Typed(file) as typed:
        yield _pressed(typed)


def _pressed(typed: Typed) -> Iterator[str | None]:
    while True:
        asked = [{" ": "press", "r": "release", "q": "end"}.get(key) for key in typed.read()]
        yield from filter(None, asked)
        yield "end" if typed.gone else None


def _lines() -> Iterator[str | None]:
    text, open_ = "", True
    while True:
        if open_ and select.select([sys.stdin], [], [], 0.0)[0]:
            more = os.read(sys.stdin.fileno(), 1024).decode("utf-8", "replace")
            open_ = more != ""  # after the end of standard input, a signal ends it
            text += more
        line, end, rest = text.partition("\n")
        if end:
            text = rest
        yield (
            {"press": "press", "release": "release", "end": "end"}.get(line.strip())
            if end
            else None
        )
