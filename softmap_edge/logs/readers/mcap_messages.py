"""Read the messages of an MCAP file whose checksums match, and count the others.

A chunk with a wrong checksum, size or compression is skipped, and later ones are still read. A
chunk without a checksum is skipped if the checksum of all data fails. Pinned by
tests/files/test_mcap_damage.py and tests/logs/test_import_mcap.py.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from softmap_edge.errors import RunError, brief
from softmap_edge.files.mcap_records import (
    CHANNEL,
    CHUNK,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    SCHEMA,
    Chunk,
    Record,
    Walk,
    fits,
    read_chunk,
    read_closing,
    split,
)
from softmap_edge.logs.readers.mcap_account import Account, Lost
from softmap_edge.logs.readers.packed import ZSTD_WINDOW

if TYPE_CHECKING:
    from mcap.records import Channel, Message, Schema

    Item = tuple[Channel, Schema | None, Message | None]  # without message: a new channel

_LARGEST = 2**28  # bytes of one unpacked chunk; writers use 1 to 16 MB


class Bad(ValueError):
    """The reason why a chunk is skipped."""


class Messages:
    """Iterate over a file's messages with channel and schema; each new channel comes once alone.

    `.account` holds the skipped parts; it is complete after all messages are read.

    Raises:
        RunError: `mcap` is not installed, the file is not an MCAP file, or no checksum confirms its
            messages.
    """

    def __init__(self, path: Path, shown: Path | None = None) -> None:
        self._path, self._shown = path, shown or path  # the file, and the path given by the user
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._spare: tuple[dict[int, Channel], dict[int, Schema]] = {}, {}  # from the summary
        self.account = Account(self._shown, 0, None)

    def __iter__(self) -> Iterator[Item]:
        try:
            import mcap.records  # noqa: F401 - imported here, once
        except ImportError:
            raise RunError(
                f"{self._path}: MCAP needs the package mcap; run pip install 'softmap-edge[logs]'"
            ) from None
        try:
            yield from self._read()
        except OSError as cause:
            raise RunError(
                f"{self._path}: cannot be read ({cause.strerror or cause}); give the path of a log"
            ) from cause

    def _read(self) -> Iterator[Item]:
        with self._path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise RunError(
                    f"{self._path}: is not an MCAP file (it begins with other bytes); give the .mcap "
                    "of the recording"
                )
            size = self._path.stat().st_size
            closing = read_closing(file, size)
            self.account = account = Account(self._shown, size, closing)
            for kind, body in () if closing is None else closing.defined:
                self._define(kind, body, *self._spare)
            walk = Walk(file, size, None if closing is None else closing.data_end)
            account.gaps = walk.gaps
            for record in walk:
                account.odd = walk.odd
                yield from self._record(record)
            account.odd = walk.odd
            account.settle()

    def _record(self, record: Record) -> Iterator[Item]:
        account = self.account
        if record.kind == CHUNK:
            account.settle()
            yield from self._chunk(record)
        elif record.kind == MESSAGE_INDEX:
            account.indexed += (len(record.body) - 6) // 16
        elif record.kind == MESSAGE and account.chunks and not self._sound:
            account.strays += 1
        elif record.kind == MESSAGE and self._sound is False:
            raise RunError(
                f"{self._path}: the checksum of its data does not match, so any of its messages "
                "may be wrong; copy it again"
            )
        elif record.kind in (SCHEMA, CHANNEL, MESSAGE):
            account.unchecked += record.kind == MESSAGE
            yield from self._item(record.kind, record.body)

    @property
    def _sound(self) -> bool | None:
        """Return whether the checksum of all data matches; None if the file has none."""
        return None if self.account.closing is None else self.account.closing.data

    def _chunk(self, record: Record) -> Iterator[Item]:
        account = self.account
        account.chunks += 1
        chunk = read_chunk(record.body)
        try:
            data = unpacked(chunk)
            items = list(split(data))
            if not all(
                fits(kind, body, len(body))
                for kind, body in items
                if kind in (SCHEMA, CHANNEL, MESSAGE)
            ):
                raise Bad("its records do not fill it")
            if chunk.crc == 0 and data and self._sound is False:
                raise Bad("it carries no checksum, and that of the data does not match")
        except ValueError as fault:
            stated = {} if account.closing is None else account.closing.spans
            span = stated.get(record.start, (chunk.first, chunk.last))
            account.lost.append(Lost(record.start, record.end, brief(fault), span))
            return
        account.unchecked += chunk.crc == 0 and len(data) > 0
        for kind, body in items:
            yield from self._item(kind, body)

    def _item(self, kind: int, body: bytes) -> Iterator[Item]:
        if kind == MESSAGE:
            message = self._message(body)
            channel = self._channels.get(message.channel_id) or self._spare[0].get(
                message.channel_id
            )
            if channel is None:
                self.account.strays += 1
                return
            self.account.took(message.channel_id, message.log_time)
            yield channel, self._schema(channel), message
        elif kind in (SCHEMA, CHANNEL):
            new = self._define(kind, body, self._channels, self._schemas)
            if new is not None:
                yield new, self._schema(new), None

    def _schema(self, channel: Channel) -> Schema | None:
        return self._schemas.get(channel.schema_id) or self._spare[1].get(channel.schema_id)

    def _define(
        self, kind: int, body: bytes, channels: dict[int, Channel], schemas: dict[int, Schema]
    ) -> Channel | None:
        """Store a schema or a channel; return the channel if it is new.

        If an id is defined several times, the first definition counts.
        """
        from mcap.data_stream import ReadDataStream
        from mcap.exceptions import McapError
        from mcap.records import Channel, Schema

        stream = ReadDataStream(io.BytesIO(body))
        try:
            if kind == SCHEMA:
                schema = Schema.read(stream)
                self.account.clashes += schemas.setdefault(schema.id, schema) != schema
                return None
            channel = Channel.read(stream)
        except (McapError, ValueError, struct.error):
            self.account.clashes += 1
            return None
        self.account.clashes += channels.get(channel.id, channel) != channel
        return channels.setdefault(channel.id, channel) if channel.id not in channels else None

    @staticmethod
    def _message(body: bytes) -> Message:
        from mcap.data_stream import ReadDataStream
        from mcap.records import Message

        message: Message = Message.read(ReadDataStream(io.BytesIO(body)), len(body))
        return message


def unpacked(chunk: Chunk) -> bytes:
    """Return the bytes of a chunk, limited to the stated size, with their checksum checked.

    Raises:
        Bad: they cannot be unpacked, or do not match their size or checksum.
    """
    if chunk.size > _LARGEST:
        raise Bad(f"a chunk of {chunk.size} bytes, at most {_LARGEST} are unpacked")
    try:
        data = _unpack(chunk)
    except ImportError:
        raise RunError(
            f"chunks packed by {chunk.compression} need a package; run pip install "
            "'softmap-edge[logs]'"
        ) from None
    except Bad:
        raise
    except Exception as fault:  # a damaged chunk raises any error of lz4 or zstandard
        raise Bad(f"it cannot be unpacked: {brief(fault) or type(fault).__name__}") from None
    if len(data) != chunk.size:
        raise Bad(f"a chunk holds {len(data)} bytes, but states {chunk.size}")
    if chunk.crc != 0 and zlib.crc32(data) != chunk.crc:
        raise Bad("its checksum does not match")
    return data


def _unpack(chunk: Chunk) -> bytes:
    if chunk.compression == "":
        return chunk.data
    if chunk.compression == "zstd":
        import zstandard

        unpacker = zstandard.ZstdDecompressor(max_window_size=ZSTD_WINDOW)
        with unpacker.stream_reader(io.BytesIO(chunk.data)) as stream:
            return bytes(stream.read(chunk.size + 1))
    if chunk.compression == "lz4":
        import lz4.frame

        return bytes(
            lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=chunk.size + 1)
        )
    raise Bad(f"chunks packed by {chunk.compression[:20]!r} are not read; record with zstd or lz4")
