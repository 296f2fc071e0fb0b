"""Collect decoded messages of a topic in a table: one row per message, columns by name.

The frame of each place is counted, and messages of frames that were not asked for are left out.
The table also has the columns `time` and `log_time`. A message field called `time` or `log_time`
becomes the column `time (field)`. The module also defines the errors for absent and unspecified
topics.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.printable import listed
from softmap_edge.logs.readers.cdr import Message, frame_path
from softmap_edge.logs.readers.columns import Array, HeldColumns

OWN = ("time", "log_time")  # columns of every topic
_FIRST_S = 60.0  # s: a clock that starts at 0 is below this at the second message
NUMBERS = 2**27  # numbers of one topic: 1 GiB
_FRAMES = 2**16  # different frames of all structs of one topic
_NAMED = 4  # frames that are listed


@dataclass(frozen=True)
class TopicColumns(HeldColumns):
    """The messages of a topic.

    Attributes:
        topic: its name.
        stamped: whether `time` is the messages' own stamp; otherwise it is the log time.
        frames: number of messages in each frame, by the start of the names of columns; the frame
            is "" in messages that name none.
    """

    topic: str = ""
    stamped: bool = False
    frames: dict[str, Counter[str]] = field(default_factory=dict)

    def frames_of(self, column: str) -> Counter[str]:
        """Return the number of messages in each frame that a column has; empty for no frame."""
        path = frame_path(column, self.frames)
        return Counter() if path is None else self.frames[path]


def several_topics(path: Path, types: Mapping[str, str]) -> RunError:
    """Return the error that a mapping must select one of a recording's topics (name → type)."""
    named = ", ".join(f"{name} ({kind})" for name, kind in types.items())[:300] or "none"
    return RunError(
        f'{path}: holds {len(types)} topics ({named}); name one in the mapping: topic = "…"'
    )


def no_message(path: Path, topic: str, there: Iterable[str]) -> RunError:
    """Return the error for a topic without messages; it lists the topics that have some."""
    listed = ", ".join(sorted(there))[:200]
    if not listed:
        return RunError(f"{path}: holds no message of any topic; give the recording of a run")
    return RunError(
        f"{path}: no message of topic {topic[:60]}; there are {listed}; change `topic` in the "
        "mapping"
    )


def frames_listed(counts: Mapping[str, int]) -> str:
    """Return frames with their numbers of messages, the most frequent first."""
    ordered = sorted(counts.items(), key=lambda one: (-one[1], one[0]))
    return listed([f"{name[:60] or 'not named'} ({count})" for name, count in ordered], _NAMED)


class MessageRows:
    """The messages of a topic so far; NaN for a number that a message lacks.

    With `frame`, only messages and elements in this frame are kept.
    """

    def __init__(self, path: Path, topic: str, frame: str | None = None) -> None:
        self.path, self.topic, self.frame = path, topic, frame
        self.count = 0  # messages, including those in other frames
        self.frames: dict[str, Counter[str]] = {}
        self.others: Counter[str] = Counter()
        self._different = 0  # frames of all structs
        self.index: dict[str, int] = {}  # column → position
        # names of a message → positions of its numbers
        self.shapes: dict[tuple[str, ...], NDArray[np.int64]] = {}
        self.rows: list[tuple[NDArray[np.int64], Array]] = []
        self.unset = 0  # messages with a stamp of 0

    def add(self, message: Message, logged: float) -> None:
        """Add a message.

        Args:
            message: its numbers and frames.
            logged: time of recording, s.

        Raises:
            RunError: the topic holds too many numbers, or names too many frames.
        """
        self.count += 1
        self._count_frames(message)
        numbers = message.numbers
        if self.frame is not None and not numbers:
            return
        stamp = numbers.get("header.stamp", 0.0)
        if not numbers.keys().isdisjoint(OWN):
            numbers = {
                f"{name} (field)" if name in OWN else name: value for name, value in numbers.items()
            }
        self.unset += "header.stamp" in numbers and not stamp
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

    def _count_frames(self, message: Message) -> None:
        """Count the frames of a message.

        Raises:
            RunError: the topic names too many frames.
        """
        for path, name in message.frames.items():
            known = self.frames.setdefault(path, Counter())
            self._different += name not in known
            known[name] += 1
        self._different += len(message.others.keys() - self.others.keys())
        self.others += message.others
        if self._different > _FRAMES:
            raise RunError(
                f"{self.path}: topic {self.topic[:60]} names more than {_FRAMES} frames; cut the "
                "recording"
            )

    def columns(self, notes: tuple[str, ...] = (), by_time: bool = False) -> TopicColumns:
        """Return the table; `by_time` sorts the rows by `log_time`.

        Raises:
            RunError: no message is in the frame that was asked for.
        """
        if self.frame is not None:
            notes += self._of_frame(self.frame)
        table = np.full((len(self.rows), len(self.index)), np.nan)
        for k, (places, values) in enumerate(self.rows):
            table[k, places] = values
        if by_time:
            table = table[np.argsort(table[:, self.index["log_time"]], kind="stable")]
        unstamped = self._one_clock(table)
        notes += unstamped
        notes += tuple(
            f"the messages have a field '{name}' of their own; it is the column '{name} (field)'"
            for name in OWN
            if f"{name} (field)" in self.index
        )
        stamped = "header.stamp" in self.index and not unstamped
        return TopicColumns(
            self.path,
            list(self.index),
            table,
            where="message",
            notes=notes,
            topic=self.topic,
            stamped=stamped,
            frames=self.frames,
        )

    def _of_frame(self, frame: str) -> tuple[str, ...]:
        """Return the sentence on what other frames were left out.

        Raises:
            RunError: nothing is in this frame.
        """
        named = frames_listed(self.others)
        if not self.rows:
            there = f"its frames are {named}" if self.others else "its messages name no frame"
            raise RunError(
                f"{self.path}: topic {self.topic[:60]}: frame_id = '{frame[:60]}', but none of "
                f"{self.count} messages is in it; {there}; change frame_id in the mapping"
            )
        if not self.others:
            return ()
        return (
            f"topic {self.topic[:60]}: places in other frames than {frame[:60]} were left out, as "
            f"the mapping asks: {named}",
        )

    def _one_clock(self, table: Array) -> tuple[str, ...]:
        """Make `time` the log time, unless all messages have a stamp of their own; a note on it.

        Stamps and log times are two clocks, which differ by the delay of the messages.
        """
        same = len(np.unique(table[:, 0])) == 1 < len(table)  # stamps that were never set
        if not self.unset and not same:
            return ()
        if self.unset == 1 and self._starts_at_zero(table):
            table[0, 0] = 0.0
            return ()
        table[:, 0] = table[:, self.index["log_time"]]
        if not self.unset:
            return (f"topic {self.topic[:60]}: the stamp never changes; time is the log time",)
        return (
            f"topic {self.topic[:60]}: {self.unset} of {len(table)} messages have no stamp "
            "(header.stamp is 0); time is the log time in all of them",
        )

    def _starts_at_zero(self, table: Array) -> bool:
        """Return whether the first stamp is 0 because the clock of a simulation starts there."""
        stamps = table[:, self.index["header.stamp"]]
        return bool(stamps[0] == 0 and len(stamps) > 1 and 0 < np.nanmin(stamps[1:]) < _FIRST_S)
