"""Read the vertices of a PLY file: text or binary of both byte orders, any properties in any order.

Sizes in the header are compared with the bytes of the file before memory is allocated. Elements
before the vertices are skipped, including those with lists. So are lists among the properties of a
vertex. Elements after the vertices are not read.
"""

from __future__ import annotations

import itertools
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.cloud_files.columns import Triple, choose
from softmap_edge.errors import RegistrationError, brief

Floats = NDArray[np.float64]

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
} | {f"{word}{8 * n}": f"{word[0]}{n}" for word in ("int", "uint", "float") for n in (1, 2, 4, 8)}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MOST_HEADER = 1000  # lines
_MOST_LISTS = 1_000_000  # rows with lists that are read or skipped, one by one
_MOST_ITEMS = 1_000_000  # of one list
_MOST_POINTS = 10_000_000
_MOST_LINE = 1_000_000  # bytes of a row of text
_ROWS = 2000  # from which columns are decided


@dataclass
class _Element:
    """A table of the file: its number of rows, and the types of their properties.

    A list has two types: one of its length and one of its items.
    """

    name: str
    count: int
    properties: list[tuple[str, tuple[str, ...]]] = field(default_factory=list)

    @property
    def listed(self) -> bool:
        return any(len(types) > 1 for _, types in self.properties)

    @property
    def numbers(self) -> list[str]:
        """Names of the properties that are one number."""
        return [name for name, types in self.properties if len(types) == 1]

    def row(self, order: str) -> np.dtype[np.void]:
        return np.dtype(
            [(f"{k}", order + types[0]) for k, (_, types) in enumerate(self.properties)]
        )


def read_ply(path: Path, notes: list[str]) -> Floats:
    """Return the points (M, 3) mm of a PLY file.

    Args:
        path: the file.
        notes: receives a sentence for each choice of columns.

    Raises:
        RegistrationError: a damaged file, or one without places.
    """
    try:
        with path.open("rb") as file:
            order, elements = _header(file)
            before = list(itertools.takewhile(lambda e: e.name != "vertex", elements))
            if len(before) == len(elements):
                raise ValueError(
                    "it has no element vertex, but "
                    f"{', '.join(e.name for e in elements)[:80] or 'none'}"
                )
            vertex = elements[len(before)]
            _check(vertex, path.stat().st_size - file.tell())
            return _vertices(path, file, order, before, vertex, notes)
    except (ValueError, OverflowError, struct.error, IndexError) as fault:
        raise RegistrationError(
            f"{path}: cannot be read as PLY ({brief(fault)}); export it again"
        ) from None


def _header(file: BinaryIO) -> tuple[str, list[_Element]]:
    """Return the byte order ("" for text) and the elements."""
    if file.readline(20).strip() != b"ply":
        raise ValueError("it does not begin with 'ply'")
    order, elements = None, list[_Element]()
    for _ in range(_MOST_HEADER):
        words = file.readline(1000).decode("latin-1").split()
        match words:
            case ["end_header"]:
                if order is None:
                    raise ValueError("its header has no format")
                return order, elements
            case ["format", kind, *_] if kind in _ORDERS:
                order = _ORDERS[kind]
            case ["element", name, count] if (
                count.isascii() and count.isdigit() and len(count) < 16
            ):
                elements.append(_Element(name, int(count)))
            case ["property", "list", length, item, name] if elements and {length, item} <= set(
                _TYPES
            ):
                elements[-1].properties.append((name, (_TYPES[length], _TYPES[item])))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append((name, (_TYPES[kind],)))
            case ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ValueError(f"its header has the line {' '.join(words)[:60]!r}")
    raise ValueError(f"its header has more than {_MOST_HEADER} lines")


def _check(vertex: _Element, there: int) -> None:
    if len(vertex.numbers) < 3:
        raise ValueError(f"its vertices have {len(vertex.numbers)} numbers, x, y, z are needed")
    if vertex.listed and vertex.count > _MOST_LISTS:
        raise ValueError(
            f"{vertex.count} vertices with lists, at most {_MOST_LISTS} are read: leave the lists "
            "out"
        )
    if vertex.count > _MOST_POINTS:
        raise ValueError(f"{vertex.count} vertices, at most {_MOST_POINTS} are read: thin it out")
    least = vertex.count * 2 * len(vertex.properties)  # of text; a digit and a separator
    binary = vertex.count * vertex.row("").itemsize  # lists without items are the shortest
    if min(least, binary) > there + 1:
        raise ValueError(f"its header claims {vertex.count} vertices, {there} bytes are there")


def _vertices(
    path: Path,
    file: BinaryIO,
    order: str,
    before: list[_Element],
    vertex: _Element,
    notes: list[str],
) -> Floats:
    columns: Triple | None = None
    if order:
        for element in before:
            _pass_over(file, element, order)
        row = vertex.row(order)
        there = path.stat().st_size - file.tell()
        if vertex.count * row.itemsize > there:
            raise ValueError(
                f"its header claims {vertex.count} vertices of {row.itemsize} bytes, {there} are "
                "there"
            )
        if vertex.listed:
            values = _rows_with_lists(file.read(there), vertex, order)
            columns = _columns(vertex, list(values[:_ROWS].T), path, notes)
            return values[:, columns]
        table = (
            np.memmap(path, row, "r", file.tell(), (vertex.count,))
            if vertex.count
            else np.zeros(0, row)
        )
        columns = _columns(vertex, [table[name][:_ROWS] for name in row.names or ()], path, notes)
        return np.stack([np.asarray(table[f"{k}"], np.float64) for k in columns], axis=1)
    for _ in range(sum(element.count for element in before)):
        if not file.readline():
            raise ValueError("it ends before its vertices")
    lines = iter(lambda: file.readline(_MOST_LINE), b"")
    if vertex.listed:
        lines = (b" ".join(_numbers_of(line.split(), vertex)) for line in lines)
    first = [next(lines, b"").split() for _ in range(min(vertex.count, _ROWS))]
    if any(len(cells) != len(vertex.numbers) for cells in first):
        raise ValueError(f"rows of {len(vertex.numbers)} numbers are expected, others are there")
    columns = _columns(
        vertex, list(np.array(first, float).reshape(-1, len(vertex.numbers)).T), path, notes
    )
    rows = itertools.chain((b" ".join(cells) for cells in first), lines)
    values = (
        np.loadtxt(itertools.islice(rows, vertex.count), usecols=columns, ndmin=2)
        if vertex.count
        else np.zeros((0, 3))
    )
    if len(values) != vertex.count:
        raise ValueError(f"its header claims {vertex.count} vertices, {len(values)} are there")
    return np.asarray(values, np.float64)


def _columns(
    vertex: _Element, some: list[NDArray[np.generic]], path: Path, notes: list[str]
) -> Triple:
    sample = np.stack([np.asarray(column, np.float64) for column in some], axis=1)
    columns, sentence = choose(vertex.numbers, sample, str(path))
    notes += [f"{path.name}: {sentence}"] if sentence else []
    return columns


def _numbers_of(cells: list[bytes], vertex: _Element) -> list[bytes]:
    """Return the cells of a row of text without those of its lists."""
    kept, place = list[bytes](), 0
    for _, types in vertex.properties:
        if place >= len(cells):
            raise ValueError("a row ends within its numbers")
        if len(types) > 1:
            place += 1 + _length(float(cells[place]))
        else:
            kept.append(cells[place])
            place += 1
    if place != len(cells):
        raise ValueError(f"a row has {len(cells)} cells, its header and lists make {place}")
    return kept


def _rows_with_lists(content: bytes, vertex: _Element, order: str) -> Floats:
    """Return the numbers (M, C) of binary rows, without their lists."""
    parts: list[tuple[struct.Struct, int]] = []  # of a list: of its length, bytes of an item
    for _, types in vertex.properties:
        unpack = struct.Struct(order + np.dtype(types[0]).char)
        size = np.dtype(types[1]).itemsize if len(types) > 1 else 0
        parts.append((unpack, size))
    values = np.empty((vertex.count, len(vertex.numbers)))
    place = 0
    for row in values:
        column = 0
        for unpack, size in parts:
            (number,) = unpack.unpack_from(content, place)
            place += unpack.size
            if size:
                place += _length(number) * size
            else:
                row[column] = number
                column += 1
        if place > len(content):
            raise ValueError("a list goes beyond the end of the file")
    return values


def _length(number: float) -> int:
    """Return the number of items of a list."""
    if not 0 <= number <= _MOST_ITEMS or number != int(number):
        raise ValueError(f"a list of {number:g} items, 0 to {_MOST_ITEMS} are read")
    return int(number)


def _pass_over(file: BinaryIO, element: _Element, order: str) -> None:
    """Go to the end of a binary element."""
    if not element.listed:
        file.seek(element.count * element.row(order).itemsize, 1)
        return
    if element.count > _MOST_LISTS:
        raise ValueError(
            f"{element.count} rows of lists before its vertices, at most {_MOST_LISTS} are passed "
            "over"
        )
    for _ in range(element.count):
        for _, types in element.properties:
            number = np.frombuffer(file.read(np.dtype(types[0]).itemsize), order + types[0])[0]
            if len(types) > 1:
                file.seek(max(0, int(number)) * np.dtype(types[1]).itemsize, 1)
