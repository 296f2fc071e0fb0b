"""Shared by the commissioning commands: the enable key of moves, and terminal questions.

Pinned by tests/robot/test_move.py, tests/robot/test_home.py and
tests/robot/test_calibrate_bench.py.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator

from softmap_edge.commands.output import JsonOption
from softmap_edge.errors import ServoError
from softmap_edge.robot.commissioning.jog import Deadman, Held
from softmap_edge.robot.commissioning.keys import Keys
from softmap_edge.robot.servo.terminal import terminal, wait_for_release


def hold_argument(parser: argparse.ArgumentParser, more: str = "") -> None:
    """Declare `--hold`, the same wherever there is an enable key; `more` is further help."""
    parser.add_argument(
        "--hold",
        action="store_true",
        help=f"no key needs to be held: the program holds while it runs, Ctrl-C lets go{more}",
    )


@contextlib.contextmanager
def deadman(held: bool) -> Iterator[Deadman]:
    """Return what has to be held: the program itself, or a key of the terminal.

    The program is stopped by keys where there is a terminal.
    """
    if held and terminal() is None:
        yield Held()
    else:
        with Keys(always=held) as keys:
            yield keys


def announce(args: JsonOption, what: str, hand: Deadman) -> None:
    """Say what will move, and how it is stopped."""
    if not args.json:
        print(f"{what}; {hand.how}", file=sys.stderr)


def confirm(question: str, instead: str) -> bool:
    """Ask a question on the terminal until the answer is yes or no; no answer is a no.

    A key that is still held is no answer: it is waited for. `instead` is the option that gives it
    where there is no terminal.

    Raises:
        ServoError: there is no terminal.
    """
    if not sys.stdin.isatty():
        raise ServoError(f"no terminal to ask at; {instead} says it instead")
    if (file := terminal()) is not None:
        wait_for_release(file)
    while True:
        print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
        answer = sys.stdin.readline().strip().lower()
        if answer in ("y", "yes", "n", "no", ""):
            return answer.startswith("y")
        print("y for yes, n or Enter for no", file=sys.stderr)
