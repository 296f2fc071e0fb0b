"""Read the arrays of a MATLAB file in a child process.

v4 to v7 are read with scipy, v7.3 and other HDF5 files with h5py. Arrays of numbers, also within
structs and groups, are named by their path: `u`, `log.time`, `log.signals[0].values`. Values
without plain numbers (tables, timetables, timeseries, other objects, functions, cells) are left out
and listed. Links to other files, external data and dynamically loaded HDF5 filters are not followed.
zlib's checksums are checked, and those of HDF5 where present.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.logs.readers.arrays import ArrayColumns, columns_of_arrays
from softmap_edge.logs.readers.columns import as_floats_or_booleans
from softmap_edge.logs.readers.hdf5_attributes import described
from softmap_edge.logs.readers.in_child import MOST, Answer, read_in_child

if TYPE_CHECKING:
    from h5py import Dataset, Group

LIMIT = 2**30  # bytes of one file
_DEEPEST = 8  # nested structs
_ENTRIES = 4096  # arrays, structs and groups of one file
_STRUCTS = 256  # elements of an array of structs
_EXPORT = "save its numbers as arrays (for a timetable: t = seconds(tt.Time); u = tt.u;)"


def open_matlab(path: Path) -> ArrayColumns:
    """Read a MATLAB file of v4 to v7.

    Raises:
        RunError: scipy is not installed, the file is damaged or too large, or it holds no column of
                numbers.
    """
    return _opened(path, "MATLAB file", read_v7)


def open_hdf5(path: Path) -> ArrayColumns:
    """Read a MATLAB file of v7.3 or another HDF5 file.

    Raises:
        RunError: h5py is not installed, the file is damaged or too large, or it holds no column of
            numbers.
    """
    return _opened(path, "HDF5 file", read_hdf5)


def _opened(path: Path, what: str, parse: Callable[[Path], Answer]) -> ArrayColumns:
    if path.stat().st_size > LIMIT:
        raise RunError(
            f"{path}: {path.stat().st_size} bytes, at most {LIMIT} are read; split the log"
        )
    answer = read_in_child(path, what, parse)
    left_out = [str(entry) for entry in answer.document["left_out"]]
    try:
        return columns_of_arrays(
            path,
            answer.arrays,
            answer.document["texts"],
            notes=[str(note) for note in answer.document["notes"]],
            left_out=left_out,
            units=answer.document["units"],
        )
    except RunError as fault:
        opaque = any("an object" in entry for entry in left_out)
        raise RunError(f"{fault}; {_EXPORT}" if opaque else str(fault)) from None


class _Found:
    """The results of traversing a file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.arrays: dict[str, NDArray[np.generic]] = {}
        self.texts: dict[str, list[str]] = {}
        self.units: dict[str, str] = {}
        self.notes: list[str] = []
        self.left_out: list[str] = []
        self.numbers = self.entries = 0

    def enter(self, depth: int) -> None:
        """Count an entry; raise RunError if a file has too many or nests them too deeply."""
        self.entries += 1
        if depth > _DEEPEST or self.entries > _ENTRIES:
            raise RunError(
                f"{self.path}: holds more than {_ENTRIES} arrays, or structs within more than "
                f"{_DEEPEST} structs; save the signals of the log alone"
            )

    def number(self, count: int) -> None:
        """Count numbers before they are read; raise RunError if a file holds too many."""
        self.numbers += count
        if self.numbers > MOST:
            raise RunError(
                f"{self.path}: holds more than {MOST} numbers; save the signals of the log alone"
            )

    def leave(self, name: str, why: str) -> None:
        """Record that a variable is left out."""
        self.left_out.append(f"{name} ({why})")

    def answer(self) -> Answer:
        """Return the results as the child's answer."""
        document = {"texts": self.texts, "left_out": self.left_out[:100]}
        document |= {"units": self.units, "notes": self.notes[:100]}
        return Answer(dict(self.arrays), document)


# --- v4 to v7, in the child ----------------------------------------------------------------
def read_v7(path: Path) -> Answer:
    """Read every array of numbers in a MATLAB file; runs in the child.

    Raises:
        RunError: as `open_matlab`.
    """
    try:
        import scipy.io
    except ImportError:
        raise RunError(
            f"{path}: MATLAB files need scipy; run pip install 'softmap-edge[logs]'"
        ) from None
    found = _Found(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sizes = scipy.io.whosmat(path)
        for _, shape, kind in sizes:
            found.number(
                int(np.prod(shape, dtype=object)) if kind not in ("struct", "cell", "object") else 0
            )
        found.numbers = 0
        held = scipy.io.loadmat(path, verify_compressed_data_integrity=True)
    for name, value in held.items():
        if not name.startswith("__") and name != "None":
            _take(name, value, found, 0)
        elif name == "None":
            found.leave("a variable", "an object such as a table, timetable or timeseries")
    return found.answer()


def _take(name: str, value: Any, found: _Found, depth: int) -> None:
    """Add one value of a file: numbers, text, or a struct of these."""
    found.enter(depth)
    kind = type(value).__name__
    if kind != "ndarray":
        found.leave(
            name,
            "a function" if kind == "MatlabFunction" else f"an object, {_class_of(value, kind)}",
        )
    elif value.dtype.names is not None:
        _take_struct(name, value, found, depth)
    elif value.dtype.kind in "biuf":
        found.number(value.size)
        found.arrays[name] = as_floats_or_booleans(value)
    elif value.dtype.kind == "U":
        found.leave(name, "text")
    elif value.dtype.kind == "O":
        _take_cells(name, value, found)
    else:
        found.leave(name, "complex numbers" if value.dtype.kind == "c" else "no numbers")


def _class_of(value: Any, kind: str) -> str:
    name = getattr(value, "classname", None)
    # scipy's form of values that it cannot open
    if name is None and "s2" in (value.dtype.names or ()) and value.size:
        name = value.reshape(-1)[0]["s2"]
    text = kind
    if isinstance(name, bytes):
        text = name.decode("latin-1")
    elif isinstance(name, str):
        text = str(name)
    return "".join(c for c in text if c.isprintable())[:40]


def _take_struct(name: str, value: NDArray[np.void], found: _Found, depth: int) -> None:
    """Add the fields of a struct, or of each element of an array of structs."""
    if value.size > _STRUCTS:
        found.leave(name, f"{value.size} structs")
        return
    for k, one in enumerate(value.reshape(-1)):
        here = name if value.size == 1 else f"{name}[{k}]"
        for key in value.dtype.names or ():
            _take(f"{here}.{key}", one[key], found, depth + 1)


def _take_cells(name: str, value: NDArray[np.generic], found: _Found) -> None:
    """Add cells of texts as a label column; leave out others."""
    cells = [_cell_text(cell) for cell in value.reshape(-1)] if value.size < MOST // 32 else [None]
    if (
        value.size > 1
        and value.size == max(value.shape)
        and all(cell is not None for cell in cells)
    ):
        found.texts[name] = [str(cell) for cell in cells]
    else:
        found.leave(name, "cells")


def _cell_text(cell: object) -> str | None:
    if not isinstance(cell, np.ndarray) or cell.dtype.kind != "U" or cell.size > 1:
        return None
    return str(cell.reshape(-1)[0])[:200] if cell.size else ""


# --- HDF5, in the child --------------------------------------------------------------------
def read_hdf5(path: Path) -> Answer:
    """Read every array of numbers in an HDF5 file; runs in the child.

    Raises:
        RunError: as `open_hdf5`.
    """
    try:
        import h5py
    except ImportError:
        raise RunError(
            f"{path}: HDF5 files need h5py; run pip install 'softmap-edge[logs]'"
        ) from None
    with path.open("rb") as file:
        matlab = file.read(10) == b"MATLAB 7.3"
    found = _Found(path)
    with h5py.File(path, "r") as file:
        _take_group(h5py, "", file, found, 0, matlab)
    return found.answer()


def _take_group(
    h5py: ModuleType, name: str, group: Group, found: _Found, depth: int, matlab: bool
) -> None:
    """Add the contents of a group, without following links out of it."""
    for key in group:
        here = f"{name}.{key}" if name else key
        if matlab and key.startswith("#"):  # MATLAB's internal data
            continue
        found.enter(depth)
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            found.leave(here, "a link")
            continue
        entry = group[key]
        if isinstance(entry, h5py.Group):
            _take_group(h5py, here, entry, found, depth + 1, matlab)
        elif isinstance(entry, h5py.Dataset):
            _take_dataset(h5py, here, entry, found, matlab)


def _take_dataset(h5py: ModuleType, name: str, entry: Dataset, found: _Found, matlab: bool) -> None:
    kind = entry.attrs.get("MATLAB_class", b"") if matlab else b""
    kind = kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)
    if entry.is_virtual or entry.external:
        found.leave(name, "kept in another file")
    elif kind == "char" or entry.attrs.get("MATLAB_empty", 0):
        found.leave(name, "text" if kind == "char" else "empty")
    elif kind in ("cell", "function_handle") or "MATLAB_object_decode" in entry.attrs:
        found.leave(
            name,
            {"cell": "cells", "function_handle": "a function"}.get(kind, f"an object, {kind[:40]}"),
        )
    elif entry.dtype.names is not None and entry.ndim == 1 and not matlab:
        found.number(entry.size * len(entry.dtype.names))
        table = entry[()]
        for key in table.dtype.names:
            if table.dtype[key].kind in "biuf":
                found.arrays[f"{name}.{key}"] = as_floats_or_booleans(table[key])
    elif entry.dtype.kind in "biuf" and entry.shape is not None:
        found.number(entry.size)
        if matlab:
            values = as_floats_or_booleans(np.asarray(entry[()]))
            found.arrays[name] = (values.astype(bool) if kind == "logical" else values).T
        else:
            _take_described(name, entry, found)
    elif (
        h5py.check_string_dtype(entry.dtype) is not None
        and entry.ndim == 1
        and entry.size < MOST // 32
    ):
        found.texts[name] = [_text(one) for one in entry[()]]
    else:
        found.leave(name, "structs or cells" if entry.dtype.kind == "O" else "no numbers")


def _take_described(name: str, entry: Dataset, found: _Found) -> None:
    """Add an array of numbers as its attributes describe it."""
    what = described(name, entry)
    found.notes += what.notes
    if what.fault is not None:
        found.leave(name, what.fault)
        return
    stored = np.asarray(entry[()])
    found.arrays[name] = stored if stored.dtype.kind == "b" else what.values(stored)
    if what.unit is not None:
        found.units[name] = what.unit


def _text(value: object) -> str:
    return value.decode("utf-8", "replace")[:200] if isinstance(value, bytes) else str(value)[:200]
