"""Reads a topic of a rosbag2 recording in MCAP: one row a message, columns by `cdr.py`, and the time.

`time` is the message's own `header.stamp` in s (since 1970, or of a simulation), or the time at which it was logged
where it has none; `log_time` is the latter always. A recording that was cut off is read as far as it goes, and that is
said. Needs PyPI's `mcap`; messages are decoded here, so that a damaged one can neither run code nor fill the memory.
"""

from __future__ import annotations

import dataclasses
import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError, brief
from softmap_edge.logs.readers.cdr import CdrError, Types, parse_definition, read_message
from softmap_edge.logs.readers.columns import Array, HeldColumns

MAGIC = b"\x89MCAP0\r\n"
_CHUNK = 2**28  # bytes of one chunk when unpacked; writers use 1 to 16 MB
_NUMBERS = 2**27  # numbers of one topic: 1 GiB


@dataclasses.dataclass(frozen=True)
class Topic:
    """A topic: the type of its messages, and how many there are."""

    name: str
    type: str
    count: int
    readable: bool


def topics(path: Path) -> list[Topic]:
    """Return what was recorded.

    Raises:
        RunError: as `open_mcap`.
    """
    found: dict[str, Topic] = {}
    for channel, schema, message in _messages(path, []):
        had = found.get(channel.topic)
        readable = message is not None and channel.message_encoding == "cdr" and schema is not None
        count = (had.count if had else 0) + (message is not None)
        kind = "" if schema is None else schema.name
        found[channel.topic] = Topic(channel.topic, kind, count, readable or bool(had and had.readable))
    return list(found.values())


def open_mcap(path: Path, topic: str | None, most: int | None = None) -> HeldColumns:
    """Read the messages of a topic, of the only one if `topic` is None; `most` ends the reading early.

    Raises:
        RunError: `mcap` is not installed, the file is damaged, or the topic is not there or cannot be decoded.
    """
    if topic is None:
        found = topics(path)
        if len(found) != 1:
            named = ", ".join(f"{t.name} ({t.type})" for t in found)[:300] or "none"
            raise RunError(f'{path}: holds {len(found)} topics ({named}); say in the mapping which: topic = "…"')
        topic = found[0].name
    notes: list[str] = []
    index: dict[str, int] = {}  # column → place
    shapes: dict[tuple[str, ...], NDArray[np.int64]] = {}  # names of a message → the places of its numbers
    rows: list[tuple[NDArray[np.int64], Array]] = []
    known: dict[int, tuple[str, Types]] = {}
    seen: set[str] = set()
    for channel, schema, message in _messages(path, notes):
        seen.add(channel.topic)
        if channel.topic != topic or message is None:
            continue
        if channel.id not in known:
            known[channel.id] = _definition(path, channel, schema)
        try:
            numbers = read_message(*known[channel.id], message.data)
        except CdrError as fault:
            raise RunError(
                f"{path}: topic {topic[:60]}, message {len(rows) + 1}: {fault}; the file is damaged"
            ) from None
        logged = 1e-9 * message.log_time
        stamp = numbers.get("header.stamp", 0.0)
        numbers = {"time": 0.0} | numbers | {"time": stamp or logged, "log_time": logged}
        names = tuple(numbers)
        if names not in shapes:
            shapes[names] = np.array([index.setdefault(name, len(index)) for name in names])
        rows.append((shapes[names], np.array(list(numbers.values()))))
        if (len(rows) + 1) * len(index) > _NUMBERS:
            raise RunError(f"{path}: topic {topic[:60]} holds more than {_NUMBERS} numbers; cut the recording")
        if most is not None and len(rows) >= most:
            break
    if not rows:
        listed = ", ".join(sorted(seen))[:200] or "none"
        raise RunError(f"{path}: no message of topic {topic[:60]}; there are {listed}; change `topic` in the mapping")
    table = np.full((len(rows), len(index)), np.nan)
    for k, (places, values) in enumerate(rows):
        table[k, places] = values
    if len(np.unique(table[:, 0])) == 1 < len(table):  # stamps that nobody set
        table[:, 0] = table[:, index["log_time"]]
    return HeldColumns(path, list(index), table, where="message", notes=tuple(notes))


def _definition(path: Path, channel: Any, schema: Any) -> tuple[str, Types]:
    if channel.message_encoding != "cdr" or schema is None or schema.encoding != "ros2msg":
        how = f"{channel.message_encoding or 'no encoding'}, {schema.encoding if schema else 'no schema'}"
        raise RunError(f"{path}: topic {channel.topic[:60]} is {how[:80]}, expected cdr and ros2msg, as rosbag2 writes")
    try:
        return schema.name, parse_definition(schema.name, schema.data.decode("utf-8", "replace"))
    except CdrError as fault:
        raise RunError(f"{path}: topic {channel.topic[:60]}: {fault}; the file is damaged") from None


def _messages(path: Path, notes: list[str]) -> Iterator[tuple[Any, Any, Any]]:
    """Every message with its channel and schema, and each channel once without one."""
    try:
        from mcap.records import Channel, Chunk, Message, Schema
        from mcap.stream_reader import breakup_chunk
    except ImportError:
        raise RunError(f"{path}: MCAP needs the package mcap; run pip install 'softmap-edge[logs]'") from None
    channels: dict[int, Any] = {}
    schemas: dict[int, Any] = {}
    try:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise RunError(f"{path}: is no MCAP file (its first bytes are others); give the .mcap of the recording")
            file.seek(0)
            for record in _records(file, path.stat().st_size, notes):
                if isinstance(record, Chunk):
                    inner = breakup_chunk(dataclasses.replace(record, compression="", data=_unpacked(path, record)))
                else:
                    inner = [record]
                for item in inner:
                    if isinstance(item, Schema):
                        schemas[item.id] = item
                    elif isinstance(item, Channel):
                        if item.id not in channels:
                            yield item, schemas.get(item.schema_id), None
                        channels[item.id] = item
                    elif isinstance(item, Message):
                        if item.channel_id not in channels:
                            raise RunError(f"{path}: a message belongs to no channel; the file is damaged")
                        channel = channels[item.channel_id]
                        yield channel, schemas.get(channel.schema_id), item
    except OSError as cause:
        raise RunError(f"{path}: cannot be read ({cause.strerror or cause}); give the path of a log") from cause
    except (RunError, GeneratorExit):
        raise
    except Exception as fault:  # struct, lz4, zstandard: whatever a damaged file meets
        raise RunError(
            f"{path}: is a damaged MCAP file ({brief(fault) or type(fault).__name__}); copy it again"
        ) from None


def _records(file: BinaryIO, size: int, notes: list[str]) -> Iterator[Any]:
    """The records of a file, chunks unopened, as far as it goes."""
    from mcap.exceptions import EndOfFile, RecordLengthLimitExceeded
    from mcap.stream_reader import StreamReader

    records = StreamReader(file, emit_chunks=True, record_size_limit=size).records
    while True:
        try:
            record = next(records)
        except StopIteration:
            return
        except (EndOfFile, RecordLengthLimitExceeded, struct.error):  # the last record is not whole
            notes.append("the recording was cut off; it is read as far as it goes")
            return
        yield record


def _unpacked(path: Path, chunk: Any) -> bytes:
    """The bytes of a chunk, at most as many as it states."""
    size = int(chunk.uncompressed_size)
    if size > _CHUNK:
        raise RunError(f"{path}: a chunk of {size} bytes, at most {_CHUNK} are unpacked; the file is damaged")
    if chunk.compression == "":
        return bytes(chunk.data)
    if chunk.compression == "zstd":
        import zstandard

        window = 2**27
        with zstandard.ZstdDecompressor(max_window_size=window).stream_reader(io.BytesIO(chunk.data)) as stream:
            data = bytes(stream.read(size + 1))
    elif chunk.compression == "lz4":
        import lz4.frame

        data = bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1))
    else:
        raise RunError(f"{path}: chunks packed by {chunk.compression[:20]} are not read; record with zstd or lz4")
    if len(data) != size:
        raise RunError(f"{path}: a chunk holds {len(data)} bytes, but states {size}; the file is damaged")
    return data
