"""Unpacks a log that was packed as a file: `.mcap.zstd` of rosbag2, `.csv.gz`.

The unpacked file lies in a temporary folder as long as the object that `unpack` returns is kept. At most LIMIT bytes
are unpacked, and never more than half of what is free on the disk; checksums that the packing carries are checked.
"""

from __future__ import annotations

import gzip
import shutil
import tempfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from softmap_edge.errors import RunError, brief

ZSTD = b"\x28\xb5\x2f\xfd"
GZIP = b"\x1f\x8b\x08"
LIMIT = 2**32  # bytes when unpacked
_PIECE = 2**20  # bytes at a time
_WINDOW = 2**27  # bytes that zstd may look back: what `zstd -d` takes
_ENDINGS = (".zstd", ".zst", ".gz")


@dataclass(frozen=True)
class Unpacked:
    """A file that was unpacked, and the folder that holds it."""

    file: Path
    folder: tempfile.TemporaryDirectory[str]


def unpack(path: Path) -> Unpacked:
    """Unpack a file packed by zstd or gzip into a temporary folder, under its name without the last ending.

    Raises:
        RunError: `zstandard` is not installed, or the file is damaged or too large.
    """
    name = path.name.removesuffix(path.suffix) if path.suffix.lower() in _ENDINGS else path.name
    folder = tempfile.TemporaryDirectory(prefix="softmap-")
    room = min(LIMIT, shutil.disk_usage(folder.name).free // 2)
    try:
        plain = Path(folder.name) / name
        with path.open("rb") as packed, plain.open("wb") as file, _stream(path, packed) as stream:
            _copy(path, stream, file, room)
    except (EOFError, gzip.BadGzipFile, zlib.error) as fault:
        raise RunError(f"{path}: is a damaged packed file ({brief(fault)}); copy it again") from None
    except OSError as cause:
        raise RunError(f"{path}: cannot be unpacked ({cause.strerror or cause}); unpack it yourself") from cause
    return Unpacked(plain, folder)


def _stream(path: Path, packed: BinaryIO) -> Any:
    """Open the packed file for reading."""
    start = packed.read(4)
    packed.seek(0)
    if start.startswith(GZIP):
        return gzip.GzipFile(fileobj=packed)
    try:
        import zstandard
    except ImportError:
        raise RunError(
            f"{path}: files packed by zstd need zstandard; run pip install 'softmap-edge[logs]', or zstd -d {path.name}"
        ) from None
    return zstandard.ZstdDecompressor(max_window_size=_WINDOW).stream_reader(packed, read_across_frames=True)


def _copy(path: Path, stream: Any, plain: BinaryIO, room: int) -> None:
    total = 0
    while True:
        try:
            piece = stream.read(_PIECE)
        except Exception as fault:
            if type(fault).__name__ != "ZstdError":
                raise
            raise RunError(f"{path}: is a damaged packed file ({brief(fault)}); copy it again") from None
        if not piece:
            return
        total += len(piece)
        if total > room:
            raise RunError(f"{path}: holds more than {room} bytes when unpacked; unpack it yourself and split it")
        plain.write(piece)
