"""Gather decoded messages of a topic as a table: a row per message, columns by name.

There are also `time` and `log_time`.

A field of the messages that is called `time` or `log_time` itself becomes the column `time
(field)`. Also the errors of readers of recordings whose topic is not there, or not named.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.logs.readers.columns import Array, HeldColumns

OWN = ("time", "log_time")  # columns of every topic
NUMBERS = 2**27  # numbers of one topic: 1 GiB


def several_topics(path: Path, types: Mapping[str, str]) -> RunError:
    """Return the error that a mapping must name one of the topics (name → type) of a recording."""
    named = ", ".join(f"{name} ({kind})" for name, kind in types.items())[:300] or "none"
    return RunError(
        f'{path}: holds {len(types)} topics ({named}); name one in the mapping: topic = "…"'
    )


def no_message(path: Path, topic: str, there: Iterable[str]) -> RunError:
    """Return the error of a topic without messages in a recording, and the topics with some."""
    listed = ", ".join(sorted(there))[:200]
    if not listed:
        return RunError(f"{path}: holds no message of any topic; give the recording of a run")
    return RunError(
        f"{path}: no message of topic {topic[:60]}; there are {listed}; change `topic` in the "
        "mapping"
    )


class MessageRows:
    """The messages of a topic so far; a number that a message lacks is NaN in its row."""

    def __init__(self, path: Path, topic: str) -> None:
        self.path, self.topic = path, topic
        self.index: dict[str, int] = {}  # column → place
        # names of a message → the places of its numbers
        self.shapes: dict[tuple[str, ...], NDArray[np.int64]] = {}
        self.rows: list[tuple[NDArray[np.int64], Array]] = []

    def add(self, numbers: dict[str, float], logged: float) -> None:
        """Add a message.

        Args:
            numbers: of the message, by name.
            logged: when it was recorded, s.

        Raises:
            RunError: the topic holds too many numbers.
        """
        stamp = numbers.get("header.stamp", 0.0)
        if not numbers.keys().isdisjoint(OWN):
            numbers = {
                f"{name} (field)" if name in OWN else name: value for name, value in numbers.items()
            }
        numbers = {"time": stamp or logged} | numbers | {"log_time": logged}
        names = tuple(numbers)
        if names not in self.shapes:
            self.shapes[names] = np.array(
                [self.index.setdefault(name, len(self.index)) for name in names]
            )
        self.rows.append((self.shapes[names], np.array(list(numbers.values()))))
        if (len(self.rows) + 1) * len(self.index) > NUMBERS:
            raise RunError(
                f"{self.path}: topic {self.topic[:60]} holds more than {NUMBERS} numbers; cut the "
                "recording"
            )

    def columns(self, notes: tuple[str, ...] = (), by_time: bool = False) -> HeldColumns:
        """Return the table; there must be a row. `by_time` puts rows in the order of `log_time`."""
        table = np.full((len(self.rows), len(self.index)), np.nan)
        for k, (places, values) in enumerate(self.rows):
            table[k, places] = values
        if by_time:
            table = table[np.argsort(table[:, self.index["log_time"]], kind="stable")]
        if len(np.unique(table[:, 0])) == 1 < len(table):  # stamps that were never set
            table[:, 0] = table[:, self.index["log_time"]]
        notes += tuple(
            f"the messages have a field '{name}' of their own; it is the column '{name} (field)'"
            for name in OWN
            if f"{name} (field)" in self.index
        )
        return HeldColumns(self.path, list(self.index), table, where="message", notes=notes)
