"""Write findings into a `rig.toml` that its user has edited: comments, order and layout stay.

tomlkit keeps everything that does not change. The result is parsed again and must hold the expected
values; otherwise the file is written in our own form, without its comments. Pinned by
tests/robot/test_rig_file.py.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from typing import cast

import tomlkit
from tomlkit.container import Container
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, Array, InlineTable, Item, Table

from softmap_edge.files.atomic import Document
from softmap_edge.files.toml import parsed, written

Tables = Container | Table | InlineTable
TOP = ("port", "baud")
SERVO, MADE = "servo", "made"


def edited(old: str, new: str, kept: Sequence[str]) -> str:
    """Return the text of a rig with port, servos and provenance replaced; all else stays.

    The tables `ceiling` and `emergency` belong to the user.

    Args:
        old: text of the rig as its user left it, valid TOML
        new: text of the rig with the findings
        kept: keys of a servo that its findings replace or remove; its other keys stay
    """
    before, after = parsed(old), parsed(new)
    servos = [_merged(a, b, kept) for a, b in zip(before[SERVO], after[SERVO])]
    target = before | {key: after[key] for key in TOP}
    target |= {SERVO: servos + after[SERVO][len(servos) :]}
    target |= {MADE: after[MADE]} if MADE in after else {}
    try:
        document = tomlkit.parse(old)
        _change(document, target)
        text = document.as_string().rstrip("\r\n") + (old[len(old.rstrip("\r\n")) :] or "\n")
        return text if parsed(text) == target else new
    except (TOMLKitError, tomllib.TOMLDecodeError, RecursionError):
        return new


def _merged(old: Mapping[str, object], new: Mapping[str, object], kept: Sequence[str]) -> Document:
    """Return a servo's table: the findings, and the keys that its user added."""
    return dict(new) | {
        key: value for key, value in old.items() if key not in new and key not in kept
    }


def _change(document: tomlkit.TOMLDocument, target: Document) -> None:
    """Change the document into `target`; new servos stand after the others, new provenance last."""
    _set(document, {key: target[key] for key in TOP})
    servos = cast(AoT | Array, document[SERVO])
    for table, values in zip(servos, target[SERVO]):
        _set(table, values, remove=True)
    for values in target[SERVO][len(servos) :]:
        servos.append(_new(values, inline=isinstance(servos, Array)))
    for name, values in target.get(MADE, {}).items():
        made: Tables = document.setdefault(MADE, tomlkit.table(is_super_table=True))
        if name in made:
            _set(made[name], values, remove=True)
        else:
            made[name] = _new(values, inline=isinstance(made, InlineTable))


def _new(values: Mapping[str, object], inline: bool) -> Table | InlineTable:
    """Return a table with a blank line after it, or an inline table."""
    if inline:
        table: Table | InlineTable = tomlkit.inline_table()
        _set(table, values)
    else:
        table = tomlkit.table()
        _set(table, values)
        table.add(tomlkit.nl())
    return table


def _set(table: Tables, values: Mapping[str, object], remove: bool = False) -> None:
    """Set the values of a table; equal ones keep their form.

    `remove` removes the other keys.
    """
    for key in [key for key in table if remove and key not in values]:
        del table[key]
    for key, value in values.items():
        if key not in table:
            _add(table, key, tomlkit.value(written(value)))
        elif table[key] != value:
            table[key] = tomlkit.value(written(value))


def _add(table: Tables, key: str, item: Item) -> None:
    """Add a key after the last one, before comments and blank lines of the next table."""
    inside = table if isinstance(table, Container) else table.value
    rest = len(inside.body)
    while rest and inside.body[rest - 1][0] is None:
        rest -= 1
    behind = inside.body[rest:]
    del inside.body[rest:]
    inside.append(key, item)
    inside.body.extend(behind)
