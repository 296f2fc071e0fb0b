"""Read the records of an MCAP file; check framing, checksums and closing statistics.

A closed MCAP file ends with a summary (message counts, places of the chunks), a footer and the
magic bytes. CRC-32 checksums of the data section and of the summary are present unless they are 0.
A truncated file has no end. After bytes that are not a record, reading continues at the next chunk.
A disk that lost its last blocks leaves zeros, so a record that ends in zeros and has no checksum of
its own is rejected. This module needs no package. Pinned by tests/files/test_mcap_damage.py.

Source of the format: MCAP, Foxglove, https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT = range(
    1, 10
)
STATISTICS, METADATA, DATA_END = 0x0B, 0x0C, 0x0F
READ = (FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, DATA_END)
LONGEST = 2**28 + 2**16  # bytes of the longest record that is read
_HEAD = struct.Struct("<BQ")  # kind, length
# first and last time, unpacked size, checksum, length of the compression's name
_CHUNK_HEAD = struct.Struct("<QQQII")
_FOOTER = struct.Struct("<BQQQI")  # kind, length, start of the summary and of its offsets, checksum
_STATISTICS = struct.Struct("<QHIIIIQQI")
_BLOCK = 2**20


class Damage(str):
    """A sentence on what is missing or wrong in a recording."""


@dataclass(frozen=True)
class Record:
    """A record: its kind, its start and end in the file, and its bytes.

    The bytes are empty for kinds that are not `READ`.
    """

    kind: int
    start: int
    end: int
    body: bytes = b""


@dataclass(frozen=True)
class Closing:
    """The statements at the end of a closed file.

    Attributes:
        data_end: end of the data section, bytes.
        data: whether the checksum of the data section matches; None without checksum.
        summary: the same for the summary.
        counts: messages by channel id; None if not stated.
        total: messages; None without valid statistics.
        spans: first and last time (ns) of each chunk, by its start in the file.
        defined: schemas and channels of the summary (kind, bytes).
    """

    data_end: int
    data: bool | None = None
    summary: bool | None = None
    counts: dict[int, int] | None = None
    total: int | None = None
    spans: dict[int, tuple[int, int]] = field(default_factory=dict)
    defined: tuple[tuple[int, bytes], ...] = ()


@dataclass(frozen=True)
class Chunk:
    """A chunk's header: times (ns), unpacked size and checksum, compression, packed bytes."""

    first: int
    last: int
    size: int
    crc: int
    compression: str
    data: bytes


def read_chunk(body: bytes) -> Chunk:
    """Return a chunk, still packed; raise ValueError if its parts do not fill it exactly."""
    if len(body) < _CHUNK_HEAD.size:
        raise ValueError("a chunk that is too short")
    first, last, size, crc, length = _CHUNK_HEAD.unpack_from(body)
    at = _CHUNK_HEAD.size + length
    if (
        length > 64
        or at + 8 > len(body)
        or int.from_bytes(body[at : at + 8], "little") != len(body) - at - 8
    ):
        raise ValueError("a chunk whose lengths contradict one another")
    name = body[_CHUNK_HEAD.size : at].decode("ascii", "replace")
    return Chunk(first, last, size, crc, name, body[at + 8 :])


def split(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield kind and bytes of each record in `data`.

    Raises:
        ValueError: the last record is incomplete.
    """
    at, size = 0, len(data)
    while at < size:
        if size - at < _HEAD.size:
            raise ValueError("a record that is cut")
        kind, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if length > size - at:
            raise ValueError("a record that is cut")
        yield kind, data[at : at + length]
        at += length


# --- the end of a file -----------------------------------------------------------------------
def read_closing(file: BinaryIO, size: int) -> Closing | None:
    """Return the statements at a file's end, checksums checked; None if the file was not closed."""
    tail = _FOOTER.size + len(MAGIC)
    if size < len(MAGIC) + tail:
        return None
    end = _piece(file, size - tail, tail)
    kind, length, start, _, stated = _FOOTER.unpack_from(end)
    if kind != FOOTER or length != _FOOTER.size - _HEAD.size or not end.endswith(MAGIC):
        return None
    footer = size - tail
    begins = start or footer
    if not len(MAGIC) <= begins <= footer or footer - begins > LONGEST:
        return Closing(footer, summary=False)
    summary = _piece(file, begins, footer - begins)
    found = zlib.crc32(end[: _FOOTER.size - 4], zlib.crc32(summary))
    sound = None if stated == 0 else found == stated
    # without a summary, writers differ in the bytes they checksum
    if start == 0 and sound is False:
        sound = None
    data_end, data = _data_section(file, begins)
    closing = Closing(data_end, data, sound)
    return closing if sound is False else _stated(closing, summary)


def _stated(closing: Closing, summary: bytes) -> Closing:
    counts = None
    total = None
    spans = {}
    defined = []
    try:
        for kind, body in split(summary):
            if kind == STATISTICS:
                total, *_, length = _STATISTICS.unpack_from(body)
                pairs = body[_STATISTICS.size : _STATISTICS.size + length]
                counts = dict(struct.iter_unpack("<HQ", pairs)) or None
            elif kind == CHUNK_INDEX:
                first, last, start = struct.unpack_from("<QQQ", body)
                spans[start] = (first, last)
            elif kind in (SCHEMA, CHANNEL):
                defined.append((kind, body))
    except (ValueError, struct.error):
        return Closing(closing.data_end, closing.data, False)
    return Closing(
        closing.data_end, closing.data, closing.summary, counts, total, spans, tuple(defined)
    )


def _data_section(file: BinaryIO, begins: int) -> tuple[int, bool | None]:
    """Return the end of the data section, before `begins`, and whether its checksum matches."""
    start = begins - _HEAD.size - 4
    if start < len(MAGIC):
        return begins, None
    kind, length, stated = struct.unpack("<BQI", _piece(file, start, _HEAD.size + 4))
    if kind != DATA_END or length != 4:
        return begins, None
    if stated == 0:
        return start, None
    # start of the checksum: with the magic bytes, as in most writers; after them; after the header
    header = len(MAGIC) + _HEAD.size + int.from_bytes(_piece(file, len(MAGIC) + 1, 8), "little")
    return start, any(
        _checksum(file, first, start) == stated
        for first in (0, len(MAGIC), header)
        if first < start
    )


def _checksum(file: BinaryIO, first: int, end: int) -> int:
    file.seek(first)
    crc, left = 0, end - first
    while left > 0 and (block := file.read(min(_BLOCK, left))):
        crc, left = zlib.crc32(block, crc), left - len(block)
    return crc


def _piece(file: BinaryIO, start: int, length: int) -> bytes:
    file.seek(start)
    return file.read(length)


# --- the data section ------------------------------------------------------------------------
class Walk:
    """Iterate over the records of a file's data section, up to `end`.

    `.gaps` are the byte ranges (from, to) that are not records; `.odd` is the number of skipped
    records of an unknown kind.
    """

    def __init__(self, file: BinaryIO, size: int, end: int | None = None) -> None:
        self._file, self._size, self._end = file, size, size if end is None else end
        self.gaps: list[tuple[int, int]] = []
        self.odd = 0

    def __iter__(self) -> Iterator[Record]:
        at = len(MAGIC)
        while at < self._end:
            record = self._record(at)
            if record is None or self._ends_in_zeros(record):
                begin, at = at, self._next_chunk(at + 1, self._end)
                self.gaps.append((begin, at))
                continue
            if record.kind in (DATA_END, FOOTER):
                return
            yield record
            at = record.end

    def _record(self, at: int) -> Record | None:
        """Return the record that begins at `at`; None if there is none."""
        head = _piece(self._file, at, _HEAD.size)
        if len(head) < _HEAD.size:
            return None
        kind, length = _HEAD.unpack(head)
        end = at + _HEAD.size + length
        if kind == 0 or end > self._size:
            return None
        if kind in READ:
            body = _piece(self._file, at + _HEAD.size, length) if length <= LONGEST else b""
            return Record(kind, at, end, body) if fits(kind, body, length) else None
        if not fits(kind, _piece(self._file, at + _HEAD.size, min(length, _BLOCK)), length):
            if self._next_chunk(at + 1, end) < end:  # a wrong length covers the next records
                return None
            self.odd += kind > DATA_END
        return Record(kind, at, end)

    def _ends_in_zeros(self, record: Record) -> bool:
        """Return whether a record ends in zeros and has no checksum.

        The zeros must continue after it, or the file must end there.
        """
        if record.kind not in (SCHEMA, CHANNEL, MESSAGE, CHUNK) or not record.body.endswith(b"\0"):
            return False
        if record.kind == CHUNK and (
            (chunk := read_chunk(record.body)).crc != 0 or chunk.compression
        ):
            return False  # checked when unpacked
        return _piece(self._file, record.end, 1) in (b"", b"\0")  # no record has kind 0

    def _next_chunk(self, at: int, end: int) -> int:
        """Return the start of the next chunk with consistent lengths, from `at` on, or `end`."""
        while at < end:
            block = _piece(self._file, at, _BLOCK + 256)
            found = _chunk_in(np.frombuffer(block, np.uint8), at, self._size)
            if found is not None and found < end:
                return found
            at += _BLOCK
        return end


def _chunk_in(
    block: np.ndarray[tuple[int], np.dtype[np.uint8]], offset: int, size: int
) -> int | None:
    """Return the start of the first chunk in a block that begins at `offset`.

    The file has `size` bytes.
    """
    head = _HEAD.size + _CHUNK_HEAD.size
    count = len(block) - head - 8
    if count <= 0:
        return None
    places = np.flatnonzero(block[:count] == CHUNK)
    places = places[(block[places + head - 4] <= 16) & (block[places + head - 3] == 0)]
    packed = places + head + block[places + head - 4]  # position of the number of packed bytes
    places, packed = places[packed + 8 <= len(block)], packed[packed + 8 <= len(block)]

    def number(
        at: np.ndarray[tuple[int], np.dtype[np.int64]],
    ) -> np.ndarray[tuple[int], np.dtype[np.uint64]]:
        numbers: np.ndarray[tuple[int], np.dtype[np.uint64]] = block[
            at[:, None] + np.arange(8)
        ].view("<u8")[:, 0]
        return numbers

    length, inside = number(places + 1), number(packed)
    fits = (length <= size) & (
        length == inside + (packed + 8 - places - _HEAD.size).astype(np.uint64)
    )
    fits &= places + offset + _HEAD.size + length.astype(np.int64) <= size
    return int(places[fits][0]) + offset if fits.any() else None


def fits(kind: int, body: bytes, length: int) -> bool:
    """Return whether the parts of a record fill its length; `body` may be only its beginning."""
    try:
        return _FITS[kind](body, length) if kind in _FITS else False
    except struct.error:
        return False


def _chunk_fits(body: bytes, length: int) -> bool:
    try:
        read_chunk(body)
    except ValueError:
        return False
    return len(body) == length


def _after_texts(body: bytes, at: int, texts: int) -> int:
    """Return the position after `texts` strings that begin at `at`."""
    for _ in range(texts):
        at += 4 + int(struct.unpack_from("<I", body, at)[0])
    return at


def _attachment_fits(body: bytes, length: int) -> bool:
    at = _after_texts(body, 16, 2)
    return at + 8 + int(struct.unpack_from("<Q", body, at)[0]) + 4 == length


_FITS: dict[int, Callable[[bytes, int], bool]] = {
    HEADER: lambda body, length: _after_texts(body, 0, 2) == length,
    FOOTER: lambda body, length: length == 20,
    SCHEMA: lambda body, length: _after_texts(body, 2, 3) <= length,
    CHANNEL: lambda body, length: _after_texts(body, 4, 3) <= length,
    MESSAGE: lambda body, length: 22 <= length == len(body),
    CHUNK: _chunk_fits,
    MESSAGE_INDEX: lambda body, length: _after_texts(body, 2, 1) == length,
    ATTACHMENT: _attachment_fits,
    METADATA: lambda body, length: _after_texts(body, 0, 2) == length,
    DATA_END: lambda body, length: length == 4,
}
