"""Read a log in NumPy's formats: arrays of `.npz` by name, `.npy` as one array called `data`.

Nothing is unpickled: arrays of Python objects are left out and listed. Sizes are checked against
the archive before unpacking, and its checksums are checked. Arrays with named fields become one
column per field.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError, brief
from softmap_edge.files.npz import MOST_ARRAYS, array_header, fields_of
from softmap_edge.logs.readers.arrays import MOST_COLUMNS, ArrayColumns, columns_of_arrays
from softmap_edge.logs.readers.in_child import MOST

LIMIT = 2**29  # bytes of all unpacked arrays


def open_npz(path: Path) -> ArrayColumns:
    """Read the arrays of a log.

    Raises:
        RunError: the file is damaged, too large or a run, or no array in it holds columns of
            numbers.
    """
    arrays: dict[str, NDArray[np.generic]] = {}
    texts: dict[str, list[str]] = {}
    left_out: list[str] = []
    try:
        for name, array in _arrays(path, left_out):
            _sort(name, array, arrays, texts, left_out)
    except RunError:
        raise
    # damaged files raise a dozen kinds in zipfile, zlib, ast and tokenize
    except Exception as fault:
        why = brief(fault) or type(fault).__name__
        raise RunError(f"{path}: is a damaged NumPy file ({why}); save it again") from None
    if "t" in arrays and any(entry.startswith("command_unit ") for entry in left_out):
        raise RunError(
            f"{path}: is a run already; `softmap check {path.name}` reports what it can identify"
        )
    if sum(array.size for array in arrays.values()) > MOST:
        raise RunError(f"{path}: holds more than {MOST} numbers; split the log")
    return columns_of_arrays(path, arrays, texts, left_out=left_out)


def _arrays(path: Path, left_out: list[str]) -> Iterator[tuple[str, NDArray[np.generic]]]:
    """Yield every array of a file without Python objects, with its name."""
    with path.open("rb") as file:
        if file.read(6) == b"\x93NUMPY":
            size = path.stat().st_size
            if size > LIMIT:
                raise RunError(f"{path}: {size} bytes, at most {LIMIT} are read; split the log")
            file.seek(0)
            array = _array(file, size)
            if array is not None:
                yield "data", array
            else:
                left_out.append("the array (Python objects)")
            return
    with zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        total = sum(entry.file_size for entry in entries)
        if total > LIMIT or len(entries) > MOST_ARRAYS:
            raise RunError(
                f"{path}: {len(entries)} arrays of {total} bytes when unpacked, at most "
                f"{MOST_ARRAYS} of {LIMIT} are read"
            )
        for entry in entries:
            name = entry.filename.removesuffix(".npy")
            with archive.open(entry) as stream:
                array = _array(stream, entry.file_size)
                if array is not None and stream.read(1):
                    raise ValueError(f"'{name[:60]}' is longer than its shape")
            if array is None:
                left_out.append(f"{name} (Python objects, which are never read)")
            else:
                yield name, array


def _array(stream: IO[bytes], size: int) -> NDArray[np.generic] | None:
    """Return one array; None if it holds Python objects."""
    head = array_header(stream)
    if head.dtype.hasobject:
        return None
    if head.bytes > size:
        raise ValueError(
            f"shape {head.shape} of {head.dtype} needs {head.bytes} bytes, {size} are there"
        )
    data = bytearray(head.bytes)
    view, at = memoryview(data), 0
    while at < head.bytes:
        piece = stream.read(min(head.bytes - at, 2**22))
        if not piece:
            raise ValueError(f"{at} of {head.bytes} bytes are there")
        view[at : at + len(piece)] = piece
        at += len(piece)
    return np.ndarray(head.shape, head.dtype, data, order="F" if head.fortran else "C")


def _sort(
    name: str,
    array: NDArray[np.generic],
    arrays: dict[str, NDArray[np.generic]],
    texts: dict[str, list[str]],
    left_out: list[str],
) -> None:
    """Add an array to the numbers, to the texts, or to the list of those left out."""
    if name in arrays or name in texts:
        raise ValueError(f"two arrays are called '{name[:60]}'")
    if array.dtype.names is not None:
        for key, column in list(fields_of(array).items())[:MOST_COLUMNS]:
            _sort(f"{name}.{key}", column, arrays, texts, left_out)
    elif array.dtype.kind in "biuf":
        arrays[name] = array
    elif array.dtype.kind in "mM":
        arrays[name] = seconds_of(array)
    elif array.dtype.kind in "US" and array.ndim == 1:
        texts[name] = _texts(array)
    else:
        left_out.append(f"{name} ({_what(array)})")


def seconds_of(times: NDArray[np.generic]) -> NDArray[np.float64]:
    """Return dates (since 1970) or durations of any shape in s; NaN where missing."""
    absent = np.isnat(times)
    unit = f"{times.dtype.kind}8[ns]"
    seconds = times.astype(unit.replace("ns", "s"))
    rest = (times.astype(unit) - seconds.astype(unit)).astype(np.int64)
    return np.asarray(np.where(absent, np.nan, seconds.astype(np.int64) + 1e-9 * rest))


def _texts(array: NDArray[np.generic]) -> list[str]:
    if array.dtype.kind == "S":
        return [bytes(text).decode("utf-8", "replace") for text in array]
    points = np.ascontiguousarray(array).astype(array.dtype.newbyteorder("=")).view(np.uint32)
    if array.dtype.itemsize and points.size and int(points.max()) > 0x10FFFF:
        raise ValueError("it holds text that is not Unicode")
    return [str(text) for text in array]


def _what(array: NDArray[np.generic]) -> str:
    return {"c": "complex numbers", "V": "bytes"}.get(
        array.dtype.kind, f"text of shape {array.shape}"
    )
