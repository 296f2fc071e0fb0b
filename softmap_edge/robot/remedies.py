"""Remedies in messages: separate finding and remedy, and complete the named commands.

A message is the finding and, after "; ", the remedy. A "; " inside brackets or backquotes does not
separate them. Code that does not know the user's files writes `--rig FILE`, or omits `--rig`; the
command that prints the message fills it in. Pinned by tests/robot/test_hints.py.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

COMMAND = re.compile(r"`softmap\s([^`]+)`")
OPENS, CLOSES = "([{", ")]}"
COMPLETES = {
    "rig": (
        "servo setup",
        "servo home",
        "servo pull",
        "servo limits",
        "servo off",
        "servo reboot",
        "servo calibrate",
        "servo doctor",
        "servo move",
    ),
    "bundle": ("servo pull", "servo limits"),
}


def parted(message: object) -> tuple[str, str]:
    """Return finding and remedy of a message; the remedy is "" if there is none."""
    text = str(message)
    ends = _ends(text)
    return (text, "") if ends is None else (text[:ends], text[ends + 2 :])


def _ends(text: str) -> int | None:
    """Return where the finding ends: at the first "; " outside brackets and backquotes, or None.

    An unclosed bracket, as in a file name, has no effect.
    """
    depth, quoted = 0, False
    for k, letter in enumerate(text):
        quoted ^= letter == "`"
        depth += 0 if quoted else (letter in OPENS) - (letter in CLOSES and depth > 0)
        if not depth and not quoted and text.startswith("; ", k):
            return k
    return text.index("; ") if (depth or quoted) and "; " in text else None


def filled(text: str, rig: str | None, bundle: str | None = None) -> str:
    """Return a message whose commands name the user's files.

    `--bundle DIR` remains if no bundle was given.

    Args:
        text: the message; its commands stand in backquotes
        rig: rig file; None if none was given
        bundle: folder of the bundle; None if none was given
    """
    if rig is None and bundle is None:
        return text
    from softmap_edge.files.printable import shell_file  # no part of a loop's imports

    given = {"bundle": "DIR" if bundle is None else shell_file(bundle)}
    given |= {} if rig is None else {"rig": shell_file(rig)}
    return COMMAND.sub(lambda found: "`softmap " + _complete(found[1], given) + "`", text)


def _complete(command: str, given: Mapping[str, str]) -> str:
    for name in ("rig", "bundle"):
        option, value = f"--{name}", given.get(name)
        if value is None:
            continue
        if option in command.split():
            command = command.replace(f"{option} FILE", f"{option} {value}")
        elif name == "rig" and command.startswith("servo move --sim"):
            continue
        elif command.startswith(tuple(COMPLETES[name])):
            command += f" {option} {value}"
    return command
