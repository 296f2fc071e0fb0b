"""Unpack a compressed log: `.mcap.zstd` of rosbag2, `.csv.gz`.

The unpacked file stays in a temporary folder as long as the object returned by `unpack` exists. At
most LIMIT bytes are unpacked, for a text log no more than the limit of a text log, and never more
than half of the free disk space. A file that expands more than `_DENSEST`-fold is rejected early.
Checksums of the compressed file are checked.
"""

from __future__ import annotations

import gzip
import re
import shutil
import tempfile
import weakref
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from softmap_edge.errors import RunError, brief
from softmap_edge.files.refusals import NO_ROOM, refusal

if TYPE_CHECKING:
    from zstandard import ZstdDecompressor

ZSTD = b"\x28\xb5\x2f\xfd"
_SKIPPED = re.compile(rb"[\x50-\x5f]\x2a\x4d\x18")  # an empty frame, as pzstd writes first
GZIP = b"\x1f\x8b\x08"
LIMIT = 2**32  # bytes when unpacked
_UNSUSPECTED = 2**28  # unpacked bytes; below this size the compression ratio is not checked
# compression ratio that a log of one repeated line reaches, but no recording
_DENSEST = 200
# number of frames, and mean bytes per frame if there are more
_FRAMES, _FRAME = 10_000, 2**12
_NESTED = ("zstd", "gzip")  # rejected inside a compressed file
_PIECE = 2**20  # bytes at a time
_SMALL = 2**11  # packed bytes at a time: each block of 4 bytes may expand to 128 KiB
ZSTD_WINDOW = 2**27  # bytes that zstd may look back: the limit of `zstd -d`
_ENDINGS = (".zstd", ".zst", ".gz")


@dataclass(frozen=True, eq=False)
class Unpacked:
    """An unpacked file; its folder is deleted together with this object."""

    file: Path

    def __post_init__(self) -> None:
        weakref.finalize(self, shutil.rmtree, self.file.parent, True)


def unpack(path: Path) -> Unpacked:
    """Unpack a zstd or gzip file to a temporary folder; the name loses its last ending.

    Raises:
        RunError: `zstandard` is not installed, or the file is damaged or too large.
    """
    name = path.name.removesuffix(path.suffix) if path.suffix.lower() in _ENDINGS else path.name
    found = Unpacked(Path(tempfile.mkdtemp(prefix="softmap-")) / name)
    try:
        _unpack(path, found.file)
    except BaseException:
        shutil.rmtree(found.file.parent, True)
        raise
    return found


def skipped_frames(start: bytes) -> int:
    """Return the length in bytes of the empty frames at the start of a file."""
    at = 0
    while _SKIPPED.match(start, at):
        at += 8 + int.from_bytes(start[at + 4 : at + 8], "little")
    return at


def _unpack(path: Path, file: Path) -> None:
    """Write the unpacked content of `path` to `file`."""
    room = min(LIMIT, shutil.disk_usage(file.parent).free // 2)
    total = 0
    try:
        with path.open("rb") as packed, file.open("wb") as plain:
            for piece in _pieces(path, packed):
                plain.write(piece[: max(room - total, 0)])
                if total == 0:
                    plain.flush()
                    room = min(room, _limit_of(path, file))
                total += len(piece)
                if total > room:
                    raise RunError(
                        f"{path}: holds more than {room} bytes when unpacked; unpack it yourself "
                        "and split it"
                    )
                if total > _UNSUSPECTED and total > _DENSEST * packed.tell():
                    raise RunError(
                        f"{path}: unpacks to more than {_DENSEST} times its size, as no recording "
                        "does; unpack it yourself and look at it"
                    )
    except (EOFError, gzip.BadGzipFile, zlib.error) as fault:
        raise RunError(
            f"{path}: is a damaged packed file ({brief(fault)}); copy it again"
        ) from None
    except OSError as cause:
        where = file.parent if cause.errno in NO_ROOM else path
        raise RunError(f"{path}: cannot be unpacked: {refusal(cause, where)}") from cause


def _limit_of(path: Path, file: Path) -> int:
    """Return the largest size of a file that is read, from its first bytes.

    Raises:
        RunError: its format is not supported.
    """
    from softmap_edge.logs.readers.kinds import BINARY, kind_of  # that module imports this one
    from softmap_edge.logs.readers.lines import LIMIT as TEXT

    with file.open("rb") as start:
        if start.read(2) == b"PK":  # its directory is at the end
            return LIMIT
    try:
        kind = kind_of(file)
    except RunError as fault:
        raise RunError(str(fault).replace(str(file), str(path))) from None
    return LIMIT if kind in BINARY or kind in _NESTED else TEXT


def _pieces(path: Path, packed: BinaryIO) -> Iterator[bytes]:
    """Yield the unpacked content of a file piece by piece."""
    start = packed.read(4)
    packed.seek(0)
    if start.startswith(GZIP):
        with gzip.GzipFile(fileobj=packed) as stream:
            while piece := stream.read(_PIECE):
                yield piece
        return
    try:
        import zstandard
    except ImportError:
        raise RunError(
            f"{path}: files packed by zstd need zstandard; run pip install 'softmap-edge[logs]', "
            f"or zstd -d {path.name}"
        ) from None
    try:
        yield from _frames(zstandard.ZstdDecompressor(max_window_size=ZSTD_WINDOW), packed)
    except zstandard.ZstdError as fault:
        raise RunError(
            f"{path}: is a damaged packed file ({brief(fault)}); copy it again"
        ) from None


def _frames(packer: ZstdDecompressor, packed: BinaryIO) -> Iterator[bytes]:
    """The content of frames of zstd; a piece of _SMALL bytes holds 64 MiB at most."""
    frame, count, total = None, 0, 0
    while piece := packed.read(_SMALL):
        while piece:
            if frame is None:
                frame, count = packer.decompressobj(), count + 1
                if count > _FRAMES and total < count * _FRAME:
                    raise EOFError(f"more than {count - 1} frames of less than {_FRAME} bytes")
            plain = frame.decompress(piece)
            total += len(plain)
            yield plain
            ended = frame.eof
            piece = frame.unused_data if ended else b""
            frame = None if ended else frame
    if frame is not None:
        raise EOFError("it ends early")
