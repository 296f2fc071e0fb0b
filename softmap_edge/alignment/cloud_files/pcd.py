"""Read the points of a PCD file, version 0.6 or 0.7: text, binary or compressed.

Any fields in any order are read. Sizes in the header are compared with the bytes of the file before
memory is allocated. The viewpoint is not applied.
"""

from __future__ import annotations

import itertools
import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.cloud_files.columns import choose
from softmap_edge.errors import RegistrationError, brief

Floats = NDArray[np.float64]

_MOST_HEADER = 100  # lines
_MOST_POINTS = 10_000_000
_MOST_COMPRESSED = 16 << 20  # bytes; they are unpacked one by one
_LZF_GROWS = 300  # by which LZF unpacks at most: 3 bytes stand for up to 264
_ROWS = 2000  # from which columns are decided
_KNOWN = (
    "VERSION",
    "FIELDS",
    "COLUMNS",
    "SIZE",
    "TYPE",
    "COUNT",
    "WIDTH",
    "HEIGHT",
    "VIEWPOINT",
    "POINTS",
    "DATA",
)


def is_pcd(head: bytes) -> bool:
    """Return whether the first bytes of a file are those of PCD."""
    lines = (
        line.split()
        for line in head[:4000].splitlines()
        if line.strip() and not line.startswith(b"#")
    )
    first = next(lines, [])
    return head.startswith(b"# .PCD") or (bool(first) and first[0] in (b"VERSION", b"FIELDS"))


def read_pcd(path: Path, notes: list[str]) -> Floats:
    """Return the points (M, 3) mm of a PCD file.

    Args:
        path: the file.
        notes: receives a sentence for each choice of columns.

    Raises:
        RegistrationError: a damaged file, or one without places.
    """
    try:
        with path.open("rb") as file:
            header = _header(file)
            row, count = _row(header), _count(header)
            read = {"ascii": _text, "binary": _binary, "binary_compressed": _compressed}
            kind = header["DATA"][0]
            if kind not in read:
                raise ValueError(f"DATA {kind[:40]!r}, known are {', '.join(read)}")
            columns = read[kind](path, file, row, count)
    except (ValueError, OverflowError, IndexError, struct.error) as fault:
        raise RegistrationError(
            f"{path}: cannot be read as PCD ({brief(fault)}); export it again"
        ) from None
    sample = np.stack([np.asarray(column[:_ROWS], np.float64) for column in columns], axis=1)
    chosen, sentence = choose(list(row.names or ()), sample, str(path))
    notes += [f"{path.name}: {sentence}"] if sentence else []
    return np.stack([np.asarray(columns[k], np.float64) for k in chosen], axis=1)


def _header(file: BinaryIO) -> dict[str, list[str]]:
    header: dict[str, list[str]] = {}
    for _ in range(_MOST_HEADER):
        words = file.readline(10_000).decode("latin-1").split()
        if not words or words[0].startswith("#"):
            continue
        if words[0] not in _KNOWN or len(words) < 2:
            raise ValueError(f"its header has the line {' '.join(words)[:60]!r}")
        header["FIELDS" if words[0] == "COLUMNS" else words[0]] = words[1:]
        if words[0] == "DATA":
            return header
    raise ValueError("its header has no DATA line")


def _integers(words: list[str]) -> list[int]:
    if not all(word.isascii() and word.isdigit() and len(word) < 16 for word in words):
        raise ValueError(f"whole numbers are expected, {' '.join(words)[:60]!r} is there")
    return [int(word) for word in words]


def _row(header: dict[str, list[str]]) -> np.dtype[np.void]:
    """Return the type of one point: for each of FIELDS, a field with COUNT numbers."""
    names = header.get("FIELDS", [])
    sizes, kinds = _integers(header.get("SIZE", [])), header.get("TYPE", [])
    counts = _integers(header.get("COUNT", ["1"] * len(names)))
    if not 3 <= len(names) == len(sizes) == len(kinds) == len(counts) <= 200:
        raise ValueError(
            f"{len(names)} FIELDS, {len(sizes)} SIZE, {len(kinds)} TYPE, {len(counts)} COUNT"
        )
    if not all(1 <= count <= 10_000 for count in counts):
        raise ValueError(f"COUNT {' '.join(map(str, counts))[:60]}, 1 to 10000 are expected")
    types = [kind.lower() + str(size) for kind, size in zip(kinds, sizes)]
    if bad := [
        t for t in types if t not in ("f4", "f8", *(f"{k}{n}" for k in "iu" for n in (1, 2, 4, 8)))
    ]:
        raise ValueError(f"numbers of type {bad[0][:20]!r}")
    once = [
        name if names.index(name) == k and name != "_" else f"_{k}" for k, name in enumerate(names)
    ]
    return np.dtype(
        [
            (name, f"<{t}", (n,)) if n > 1 else (name, f"<{t}")
            for name, t, n in zip(once, types, counts)
        ]
    )


def _count(header: dict[str, list[str]]) -> int:
    (width,), (height,) = (
        _integers(header.get("WIDTH", ["0"])[:1]),
        _integers(header.get("HEIGHT", ["1"])[:1]),
    )
    count = _integers(header["POINTS"][:1])[0] if "POINTS" in header else width * height
    if "WIDTH" in header and count != width * height:
        raise ValueError(f"POINTS {count}, WIDTH × HEIGHT {width * height}")
    if count > _MOST_POINTS:
        raise ValueError(f"{count} points, at most {_MOST_POINTS} are read: thin it out")
    return count


def _first(table: NDArray[np.void]) -> list[NDArray[np.generic]]:
    """Return the columns of a table; of a field with several numbers, only the first."""
    columns = [table[name] for name in table.dtype.names or ()]
    return [column if column.ndim == 1 else column[:, 0] for column in columns]


def _text(
    path: Path, file: BinaryIO, row: np.dtype[np.void], count: int
) -> list[NDArray[np.generic]]:
    there = path.stat().st_size - file.tell()
    each = [int(np.prod(row[name].shape, dtype=int)) for name in row.names or ()]
    if 2 * count * sum(each) > there + 1:
        raise ValueError(f"its header claims {count} points, {there} bytes are there")
    if count * len(each) > 4 * _MOST_POINTS:
        raise ValueError(f"{count} points of {len(each)} fields as text; save it as binary")
    places = [int(n) for n in np.cumsum([0, *each[:-1]])]
    lines = itertools.islice(iter(lambda: file.readline(100_000), b""), count)
    values = np.loadtxt(lines, usecols=places, ndmin=2) if count else np.zeros((0, len(places)))
    if len(values) != count:
        raise ValueError(f"its header claims {count} points, {len(values)} are there")
    return list(values.T)


def _binary(
    path: Path, file: BinaryIO, row: np.dtype[np.void], count: int
) -> list[NDArray[np.generic]]:
    there = path.stat().st_size - file.tell()
    if count * row.itemsize > there:
        raise ValueError(
            f"its header claims {count} points of {row.itemsize} bytes, {there} are there"
        )
    return _first(np.memmap(path, row, "r", file.tell(), (count,)) if count else np.zeros(0, row))


def _compressed(
    path: Path, file: BinaryIO, row: np.dtype[np.void], count: int
) -> list[NDArray[np.generic]]:
    """Return the columns of a compressed file, which stores field after field."""
    packed, size = struct.unpack("<II", file.read(8))
    there = path.stat().st_size - file.tell()
    if packed > there or packed > _MOST_COMPRESSED:
        raise ValueError(
            f"{packed} compressed bytes, {there} are there and {_MOST_COMPRESSED} are read at most"
        )
    if size != count * row.itemsize or size > _LZF_GROWS * max(packed, 1):
        raise ValueError(
            f"{packed} bytes that claim to unpack to {size}, {count} points have "
            f"{count * row.itemsize}"
        )
    content, columns, at = unpack_lzf(file.read(packed), size), [], 0
    for name in row.names or ():
        kind = row[name]
        column = np.frombuffer(content, kind.base, count * int(np.prod(kind.shape, dtype=int)), at)
        columns.append(column.reshape(count, -1)[:, 0] if count else column)
        at += count * kind.itemsize
    return columns


def unpack_lzf(packed: bytes, size: int) -> bytearray:
    """Unpack `size` bytes packed by LZF (Lehmann): literal runs, and copies of earlier bytes.

    Raises:
        ValueError: the data end early, copy from before their beginning, or give another size.
    """
    out, at = bytearray(), 0
    while at < len(packed) and len(out) <= size:
        head = packed[at]
        at += 1
        if head < 32:  # the next head + 1 bytes
            out += packed[at : at + head + 1]
            at += head + 1
            continue
        length = head >> 5
        if length == 7:
            length += packed[at]
            at += 1
        start = len(out) - ((head & 31) << 8) - packed[at] - 1
        at += 1
        if start < 0:
            raise ValueError("compressed data that point before their beginning")
        piece = out[start : start + length + 2]
        times = -(-(length + 2) // len(piece))  # a copy may overlap its own output
        out += (piece * times)[: length + 2]
    if len(out) != size or at > len(packed):
        raise ValueError(f"compressed data of {len(out)} bytes, {size} are expected")
    return out
