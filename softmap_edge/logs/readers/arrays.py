"""Convert named arrays (.npz, .mat, HDF5, Parquet) to columns: `u`, `u[0]`, `markers[2].x`.

    (K,)       name                       (K, C)     name[0] … name[C-1]
    (K, M, 3)  name[0].x, .y, .z, …       (K, A, B)  name[0,0] … name[A-1,B-1]

Rows run along the axis that is as long as a vector of the file, else along the longest one. So
MATLAB's row and column vectors are both read. Arrays of different lengths are separate tables: a
`[[log]]` lists columns of one length.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.printable import listed
from softmap_edge.logs.readers.columns import Array, Cells, Declared, as_floats, quiet

if TYPE_CHECKING:
    from softmap_edge.logs.time_text import TimeText

MOST_COLUMNS = 4096  # of one array, and of all arrays in a file
_SHOWN = 6  # arrays that a note lists


@dataclass(frozen=True)
class ArrayColumns:
    """The columns of a file of arrays; they may differ in length."""

    path: Path
    names: list[str]
    columns: list[Array]  # (rows,) each
    texts: dict[int, list[str]] = field(default_factory=dict)  # columns of text, by position
    units: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    where: str = "row"
    declared: Declared = field(default_factory=Declared)

    @property
    def clocks(self) -> dict[int, TimeText]:
        """Columns of dates or times as text: none."""
        return {}

    @property
    def head_line(self) -> None:
        """Line number of the column names: none."""

    def read(self, places: list[int], label: int | None = None, rows: int | None = None) -> Cells:
        """Return the cells of columns of one length.

        Raises:
            RunError: the columns differ in length.
        """
        asked = [*places, *([] if label is None else [label])]
        lengths = {len(self.columns[k]) for k in asked}
        if len(lengths) > 1:
            raise RunError(
                f"{self.path}: {self._lengths(asked)}: give each length a [[log]] of its own, "
                "with its time"
            )
        columns = [self.columns[k][:rows] for k in places]
        numbers = quiet(np.stack(columns, axis=1)) if places else np.zeros((0, 0))
        labels = None if label is None else self._labels(label, rows)
        if not places and labels is not None:
            numbers = np.empty((len(labels), 0))
        return Cells(numbers, labels, np.arange(1, len(numbers) + 1), self.notes)

    def groups(self) -> list[list[int]]:
        """Return the columns' positions grouped by length (two rows or more), the longest first."""
        lengths = sorted({len(column) for column in self.columns if len(column) > 1}, reverse=True)
        return [
            [k for k, column in enumerate(self.columns) if len(column) == length]
            for length in lengths
        ]

    def _lengths(self, asked: list[int]) -> str:
        first = {len(self.columns[k]): self.names[k] for k in reversed(asked)}
        return " and ".join(
            f"{name[:40]} has {length} rows" for length, name in list(first.items())[:3]
        )

    def _labels(self, label: int, rows: int | None) -> NDArray[np.generic]:
        texts = self.texts.get(label)
        return np.array(
            [f"{x:g}" for x in self.columns[label][:rows]] if texts is None else texts[:rows]
        )


def columns_of_arrays(
    path: Path,
    arrays: Mapping[str, NDArray[np.generic]],
    texts: Mapping[str, list[str]] | None = None,
    labels: Mapping[str, Sequence[str]] | None = None,
    notes: Sequence[str] = (),
    left_out: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
) -> ArrayColumns:
    """Name the columns of arrays.

    Args:
        path: the file.
        arrays: numbers by name, of shape (K,), (K, C), (K, M, 3) or (K, A, B); others are left out.
        texts: columns of text, by name.
        labels: names for the columns of a two-dimensional array, in place of their numbers.
        notes: sentences on changes made by the reader.
        left_out: arrays without numbers, with the reason.
        units: of the arrays, by name, where the file states them.

    Raises:
        RunError: the file holds no column.
    """
    usual = _vector_lengths(arrays, texts or {})
    names: list[str] = []
    columns: list[Array] = []
    booleans: set[int] = set()
    stated: dict[str, str] = {}
    remarks, absent = list(notes), list(left_out)
    for name, array in arrays.items():
        shaped, turned = _rows_first(array, usual)
        if shaped is None or len(names) + shaped[0].size > MOST_COLUMNS:
            absent.append(f"{name} ({_why(array)})")
            continue
        named = _names(name, shaped, (labels or {}).get(name))
        flat = shaped.reshape(len(shaped), -1)
        if array.dtype.kind == "b":
            booleans |= set(range(len(names), len(names) + len(named)))
        names += named
        if units and name in units:
            stated |= dict.fromkeys(named, units[name])
        columns += [as_floats(flat[:, k]) for k in range(flat.shape[1])]
        remarks += [f"{name}: rows run along its axis {turned} ({_shape(array)})"] if turned else []
    held: dict[int, list[str]] = {}
    for name, column in (texts or {}).items():
        held[len(names)] = column
        names.append(name)
        columns.append(np.full(len(column), np.nan))
    if not any(len(column) > 1 for column in columns):
        why = f": {_listed(absent)}" if absent else ""
        raise RunError(
            f"{path}: holds no columns of numbers{why}; save each signal as an array of numbers"
        )
    remarks += [f"left out: {_listed(absent)}"] if absent else []
    return ArrayColumns(
        path,
        names,
        columns,
        held,
        stated,
        tuple(remarks),
        declared=Declared(booleans=frozenset(booleans)),
    )


def _vector_lengths(
    arrays: Mapping[str, NDArray[np.generic]], texts: Mapping[str, list[str]]
) -> set[int]:
    """Return the lengths of a file's vectors: times, single channels and labels."""
    vectors = [
        array.size for array in arrays.values() if array.size > 1 and array.size == max(array.shape)
    ]
    return {*vectors, *(len(column) for column in texts.values())}


def _rows_first(
    array: NDArray[np.generic], usual: set[int]
) -> tuple[NDArray[np.generic] | None, int]:
    """Return an array with its rows along the first axis, and the axis where they were."""
    if array.size > 1 and array.size == max(array.shape):  # a vector of any shape
        return array.reshape(-1), 0
    if array.ndim not in (2, 3) or array.size < 2:
        return None, 0
    shape = array.shape
    known = [axis for axis in range(array.ndim) if shape[axis] in usual]
    axis = known[0] if known else int(np.argmax(shape))
    turned = np.moveaxis(array, axis, 0)
    if turned.ndim == 3 and turned.shape[2] != 3 and turned.shape[1] == 3:
        turned = np.swapaxes(turned, 1, 2)
    return turned, axis


def _names(name: str, array: NDArray[np.generic], labels: Sequence[str] | None) -> list[str]:
    if array.ndim == 1:
        return [name]
    if array.ndim == 2:
        count = array.shape[1]
        known = (
            labels
            if labels is not None and len(set(labels)) == len(labels) == count
            else range(count)
        )
        return [f"{name}[{label}]" for label in known]
    if array.shape[2] == 3:
        return [f"{name}[{k}].{axis}" for k in range(array.shape[1]) for axis in "xyz"]
    return [f"{name}[{i},{j}]" for i in range(array.shape[1]) for j in range(array.shape[2])]


def _why(array: NDArray[np.generic]) -> str:
    if array.size == 1:
        return f"one number, {float(array.reshape(-1)[0]):g}"
    return "empty" if array.size == 0 else f"an array of {_shape(array)}"


def _shape(array: NDArray[np.generic]) -> str:
    return " × ".join(map(str, array.shape))


def _listed(absent: Sequence[str]) -> str:
    return listed((entry[:120] for entry in absent), _SHOWN)
