"""Read a topic of a rosbag2 MCAP recording: one row per message, columns from `cdr.py`, and time.

`time` is the message's `header.stamp` in s (since 1970, or of a simulation), or the log time if the
message has none; `log_time` is always the log time. Every checksum in the file is checked. A chunk
that fails is skipped, a truncated one is read as far as possible, and both are reported (`Damage`).
Needs PyPI's `mcap`; messages are decoded here, so a damaged one can neither run code nor exhaust
memory.
"""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from softmap_edge.errors import RecordingWarning, RunError
from softmap_edge.files.mcap_records import MAGIC
from softmap_edge.logs.readers.cdr import CdrError, Types, parse_definition, read_message
from softmap_edge.logs.readers.mcap_messages import Messages
from softmap_edge.logs.readers.messages import (
    MessageRows,
    TopicColumns,
    no_message,
    several_topics,
)

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

__all__ = ["MAGIC", "Topic", "open_mcap", "topics"]


@dataclasses.dataclass(frozen=True)
class Topic:
    """A topic: its message type and number of messages."""

    name: str
    type: str
    count: int
    readable: bool


def topics(path: Path, shown: Path | None = None) -> list[Topic]:
    """Return the recorded topics; issue a `RecordingWarning` for a damaged or truncated file.

    Raises:
        RunError: as `open_mcap`.
    """
    found: dict[str, Topic] = {}
    messages = Messages(path, shown)
    for channel, schema, message in messages:
        had = found.get(channel.topic)
        readable = message is not None and channel.message_encoding == "cdr" and schema is not None
        count = (had.count if had else 0) + (message is not None)
        kind = "" if schema is None else schema.name
        found[channel.topic] = Topic(
            channel.topic, kind, count, readable or bool(had and had.readable)
        )
    damage = messages.account.damage
    if damage is not None and not messages.account.counts:
        raise RunError(f"{damage}; nothing of it is left")
    if damage is not None:
        warnings.warn(RecordingWarning(damage), stacklevel=2)
    return list(found.values())


def open_mcap(
    path: Path,
    topic: str | None,
    most: int | None = None,
    shown: Path | None = None,
    frame: str | None = None,
) -> TopicColumns:
    """Read the messages of a topic.

    Damaged or missing parts are reported as a `Damage` among the notes and as a `RecordingWarning`.

    Args:
        path: the recording.
        topic: None for the only one.
        most: limits the number of messages.
        shown: the path in messages about damage, for example that of the packed file.
        frame: the only frame whose places are read; None for all.

    Raises:
        RunError: `mcap` is not installed, the file is damaged, the topic is absent or cannot be
            decoded, or nothing is in the frame.
    """
    if topic is None:
        found = topics(path, shown)
        if len(found) != 1:
            raise several_topics(path, {one.name: one.type for one in found})
        topic = found[0].name
    messages = Messages(path, shown)
    rows = MessageRows(path, topic, frame)
    known: dict[int, tuple[str, Types]] = {}
    seen: set[str] = set()
    for channel, schema, message in messages:
        seen.add(channel.topic)
        if channel.topic != topic or message is None:
            continue
        if channel.id not in known:
            known[channel.id] = _definition(path, channel, schema)
        try:
            content = read_message(*known[channel.id], message.data, frame=frame)
        except CdrError as fault:
            raise RunError(
                f"{path}: topic {topic[:60]}, message {rows.count + 1}: {fault}; the file is "
                "damaged"
            ) from None
        rows.add(content, 1e-9 * message.log_time)
        if most is not None and len(rows.rows) >= most:
            break
    notes = list[str](messages.account.remarks)
    if most is None and (damage := messages.account.damage) is not None:
        notes.insert(0, damage)
        if not rows.count:
            raise RunError(f"{damage}; nothing of topic {topic[:60]} is left")
        warnings.warn(RecordingWarning(damage), stacklevel=2)
    if not rows.count:
        raise no_message(path, topic, seen)
    return rows.columns(tuple(notes))


def _definition(path: Path, channel: Channel, schema: Schema | None) -> tuple[str, Types]:
    if channel.message_encoding != "cdr" or schema is None or schema.encoding != "ros2msg":
        how = (
            f"{channel.message_encoding or 'no encoding'}, "
            f"{schema.encoding if schema else 'no schema'}"
        )
        raise RunError(
            f"{path}: topic {channel.topic[:60]} is {how[:80]}, expected cdr and ros2msg, as "
            "rosbag2 writes"
        )
    try:
        return schema.name, parse_definition(schema.name, schema.data.decode("utf-8", "replace"))
    except CdrError as fault:
        raise RunError(
            f"{path}: topic {channel.topic[:60]}: {fault}; the file is damaged"
        ) from None
