"""What `softmap servo home` does: a bench commissioned with its user, or by options where there is none."""

from __future__ import annotations

import argparse
import json
import sys

from softmap_edge.commands.output import check_file
from softmap_edge.errors import ServoError
from softmap_edge.servo.rig import read_rig


def home_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `servo home`."""
    parser.add_argument("--rig", required=True, metavar="rig.toml", help="the bench; its homes are written into it")
    parser.add_argument("--yes", action="store_true", help="the finger is straight: ask nothing")
    parser.add_argument("--new", action="store_true", help="this is home, whatever was stored before")


def home(args: argparse.Namespace) -> int:
    """Prove home after a power-up; 0 when it is proved."""
    from softmap_edge.commissioning.home import prove, relax

    check_file("--rig", args.rig, ".toml")
    rig = read_rig(args.rig)
    relax(rig)
    confirmed = "by --yes"
    if not args.yes:
        if not confirm("Torque is off. Let the finger hang straight and still. Is it straight?"):
            raise ServoError("home is not proved: nobody said that the finger is straight")
        confirmed = "by the user at the terminal"
    homed = prove(rig, confirmed, new=args.new)
    homed.rig.note(args.rig)
    print(json.dumps(homed.to_dict() | {"rig": args.rig}) if args.json else f"{homed}\n{args.rig}: home is proved")
    return 0


def confirm(question: str) -> bool:
    """Ask a question on the terminal; yes or no.

    Raises:
        ServoError: there is no terminal.
    """
    if not sys.stdin.isatty():
        raise ServoError("no terminal to ask at; --yes says it instead")
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")
