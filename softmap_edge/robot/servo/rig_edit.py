"""A `rig.toml` that its user has edited, with what was found written into it: only the lines that change do.

Each table is a part of lines behind its header; a key is changed in its line, and what stands behind it as a comment
stays. The outcome is read again and must say what it should; a file in which that does not come about (tables in one
line, values over several) is written anew in our form, without its comments. Pinned by tests/robot/test_rig_file.py.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

from softmap_edge.files.toml import quoted, written

Part = list[str]  # the lines of a table, its header first (of the first one: an empty line)
TOP = ("port", "baud")
SERVO, MADE = "servo", "made"


def noted(old: str, new: str) -> str:
    """Return the text `old` of a rig with port, servos and provenance as in `new`; all else as it was.

    A servo of `old` keeps the keys that nothing here knows; the tables `ceiling` and `emergency` are the user's own.
    """
    before, after = tomllib.loads(old), tomllib.loads(new)
    servos = [_kept(a, b) for a, b in zip(before[SERVO], after[SERVO])] + after[SERVO][len(before[SERVO]) :]
    wanted = before | {key: after[key] for key in TOP} | {SERVO: servos}
    wanted |= {MADE: after[MADE]} if MADE in after else {}
    text = "\n".join(line for part in _changed(_parts(old), before, wanted) for line in part).removeprefix("\n")
    try:
        return text if tomllib.loads(text) == wanted else new
    except tomllib.TOMLDecodeError:
        return new


def _kept(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """Return a servo's table: what is known now, and what the user wrote beside it."""
    from softmap_edge.robot.servo.rig import KEPT

    return dict(new) | {key: value for key, value in old.items() if key not in new and key not in KEPT}


def _parts(text: str) -> list[tuple[tuple[str, ...], Part]]:
    """Return the tables in order, each with the names in its header."""
    parts: list[tuple[tuple[str, ...], Part]] = [((), [""])]
    for line in text.split("\n"):
        if (names := _header(line)) is None:
            parts[-1][1].append(line)
        else:
            parts.append((names, [line]))
    return parts


def _header(line: str) -> tuple[str, ...] | None:
    """Return the names in a header, None of another line."""
    if not line.lstrip().startswith("["):
        return None
    try:
        table: Any = tomllib.loads(line)
    except tomllib.TOMLDecodeError:
        return None
    names = []
    while table := (table[0] if isinstance(table, list) else table):
        ((name, table),) = table.items()
        names.append(name)
    return tuple(names)


def _changed(parts: list[tuple[tuple[str, ...], Part]], before: Any, wanted: Any) -> list[Part]:
    """Return the parts with `before` made into `wanted`; new servos stand behind the others, new provenance last."""
    found, made = before.get(MADE, {}), wanted.get(MADE, {})
    given = iter(zip(before[SERVO], wanted[SERVO]))
    done: list[Part] = []
    last, known = 0, set()
    for names, part in parts:
        if not names:
            part = _set(part, before, before | {key: wanted[key] for key in TOP})
        elif names == (SERVO,):
            part, last = _set(part, *next(given, ({}, {}))), len(done) + 1
        elif len(names) == 2 and names[0] == MADE and names[1] in made:
            part = _set(part, found.get(names[1], {}), made[names[1]])
            known.add(names[1])
        done.append(part)
    new = [_set([f"[[{SERVO}]]"], {}, one) for one in wanted[SERVO][len(before[SERVO]) :]]
    for part in new:
        part.append("")
    done[last:last] = new
    for name in made:
        if name not in known:
            while done[-1][-1:] == [""]:
                done[-1].pop()
            done[-1].append("")
            done.append([*_set([f"[{MADE}.{quoted(name)}]"], {}, made[name]), ""])
    return done


def _set(part: Part, old: Mapping[str, Any], new: Mapping[str, Any]) -> Part:
    """Return the lines of a table in which `old` has become `new`."""
    changed, place = [part[0]], 1
    for line in part[1:]:
        key, comment = _key(line)
        if key is not None and key in old and old[key] != new.get(key):
            if key not in new:
                continue
            line = f"{line[: line.index('=')]}= {written(new[key])}{comment}"
        changed.append(line)
        place = len(changed) if key is not None else place
    added = [f"{_bare(key)} = {written(new[key])}" for key in new if key not in old]
    return changed[:place] + added + changed[place:]


def _bare(key: str) -> str:
    return key if key.isidentifier() and key.isascii() else quoted(key)


def _key(line: str) -> tuple[str | None, str]:
    """Return the key that a line sets (None: it sets none) and the comment behind its value."""
    for end in [*(k for k, c in enumerate(line) if c == "#"), len(line)]:  # the first at which it is whole
        try:
            found = tomllib.loads(line[:end])
        except tomllib.TOMLDecodeError:
            continue
        value = line[:end].rstrip()
        return (next(iter(found)), line[len(value) :]) if found and "=" in value else (None, "")
    return None, ""
