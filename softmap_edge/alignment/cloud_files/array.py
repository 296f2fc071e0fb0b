"""Read a cloud that numpy saved: `.npy`, or `.npz` with `points` or a single array of places.

Sizes in a header are compared with the bytes of the file before memory is allocated. Objects are
never read.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.cloud_files.columns import choose
from softmap_edge.errors import RegistrationError, brief
from softmap_edge.files.npz import MOST_ARRAYS, OBJECTS, array_header, check_directory, fields_of

Floats = NDArray[np.float64]

MOST_BYTES = 256 << 20  # of an array; ten million points
_ROWS = 2000  # from which columns are decided


def read_npy(path: Path, notes: list[str]) -> Floats:
    """Return the points (M, 3) mm of an `.npy` file.

    Args:
        path: the file.
        notes: receives a sentence for each choice of columns.

    Raises:
        RegistrationError: a damaged file, or an array that cannot be places.
    """
    try:
        with path.open("rb") as stream:
            array = _array(stream, path.stat().st_size)
    except Exception as fault:
        raise RegistrationError(
            f"{path}: cannot be read as .npy ({brief(fault)}); save it again"
        ) from None
    return _points(array, path, "its array", notes)


def read_archive(path: Path, notes: list[str]) -> Floats:
    """Return the points (M, 3) mm of an `.npz`: `points`, or the one array that can be places.

    Args:
        path: the file.
        notes: receives a sentence for each choice of an array or of columns.

    Raises:
        RegistrationError: no such array or several, a damaged archive, or a run of several clouds.
    """
    arrays = _arrays(path)
    if "points" in arrays:
        _check_one(path, arrays)
        return _points(arrays["points"], path, "`points`", notes)
    fitting = {name: array for name, array in arrays.items() if _can_be_places(array)}
    if len(fitting) > 1:
        fitting = {name: array for name, array in fitting.items() if array.dtype.kind == "f"}
    if len(fitting) != 1:
        shown = (
            ", ".join(f"{name} {array.shape}" for name, array in arrays.items())[:200] or "nothing"
        )
        raise RegistrationError(
            f"{path}: holds {shown}; expected numbers `points` (M, 3) mm, or one such array alone"
        )
    ((name, array),) = fitting.items()
    notes.append(f"{path.name}: `{name:.40}` {array.shape} is taken for `points`")
    return _points(array, path, f"`{name:.40}`", notes)


def _can_be_places(array: NDArray[np.generic]) -> bool:
    if array.dtype.names:
        return {"x", "y", "z"} <= {name.lower() for name in array.dtype.names}
    return (
        array.dtype.kind in "fiu"
        and array.ndim in (2, 3)
        and 3 in (array.shape[-1], array.shape[0])
    )


def _check_one(path: Path, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """Reject an archive of several clouds."""
    seen = arrays["t_seen"].size if "t_seen" in arrays else 1
    clouds = max(seen, arrays["start"].size - 1 if "start" in arrays else 1)
    if clouds > 1 and "t_seen" in arrays:
        raise RegistrationError(
            f"{path}: a run of {clouds} clouds among other files; give it alone, or one cloud a "
            "file"
        )
    if clouds > 1:
        raise RegistrationError(
            f"{path}: `start` of {clouds} clouds without `t_seen`; add their times (K,) s, or "
            "give one cloud a file"
        )


def _arrays(path: Path) -> dict[str, NDArray[np.generic]]:
    try:
        check_directory(path, RegistrationError)
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            total = sum(entry.file_size for entry in entries)
            if total > MOST_BYTES or len(entries) > MOST_ARRAYS:
                raise ValueError(
                    f"{len(entries)} arrays of {total} bytes, at most {MOST_ARRAYS} of "
                    f"{MOST_BYTES} bytes are read"
                )
            found = {}
            for entry in entries:
                with archive.open(entry) as stream:
                    found[entry.filename.removesuffix(".npy")] = _array(stream, entry.file_size)
            return found
    except RegistrationError:
        raise
    except Exception as fault:
        raise RegistrationError(
            f"{path}: not a readable .npz archive ({brief(fault)}); save it again"
        ) from None


def _array(stream: IO[bytes], size: int) -> NDArray[np.generic]:
    """Return the array of a stream of `size` bytes."""
    if size > MOST_BYTES:
        raise ValueError(f"{size} bytes, at most {MOST_BYTES} are read")
    content = io.BytesIO(stream.read(size + 1))
    head = array_header(content)
    if head.dtype.hasobject:
        raise ValueError(OBJECTS)
    there = len(content.getbuffer()) - content.tell()
    if head.bytes != there:
        raise ValueError(
            f"shape {head.shape} of {head.dtype} does not fit the {there} bytes that are there"
        )
    array = (
        np.frombuffer(content.getbuffer(), head.dtype, offset=content.tell())
        if there
        else np.zeros(0, head.dtype)
    )
    return array.reshape(head.shape, order="F" if head.fortran else "C")


def _points(array: NDArray[np.generic], path: Path, what: str, notes: list[str]) -> Floats:
    """Return an array as points: its fields x, y, z, its rows, its pixels, or its columns."""
    if array.dtype.names:
        fields = {name.lower(): column for name, column in fields_of(array).items()}
        if not {"x", "y", "z"} <= set(fields) or any(
            fields[a].dtype.kind not in "fiu" for a in "xyz"
        ):
            raise RegistrationError(
                f"{path}: {what} has fields {', '.join(fields)[:80]}, expected x, y, z of numbers"
            )
        return np.stack([np.asarray(fields[a], np.float64).ravel() for a in "xyz"], axis=1)
    if array.dtype.kind not in "fiu" or array.ndim not in (2, 3) or not array.size:
        raise RegistrationError(
            f"{path}: {what} is {array.dtype} of shape {array.shape}, expected numbers (M, 3) in mm"
        )
    if array.ndim == 3 and array.shape[-1] >= 3:
        array = array.reshape(-1, array.shape[-1])  # an image of places
    if array.ndim == 2 and array.shape[0] == 3 and array.shape[1] > 3:
        notes.append(f"{path.name}: {what} of shape {array.shape} is taken as columns of x, y, z")
        array = array.T
    if array.ndim != 2 or array.shape[1] < 3 or array.shape[1] > 200:
        raise RegistrationError(
            f"{path}: {what} has shape {array.shape}, expected (M, 3) numbers in mm"
        )
    if array.shape[1] > 3:
        columns, sentence = choose([], np.asarray(array[:_ROWS], np.float64), str(path))
        notes.append(f"{path.name}: {sentence}")
        array = array[:, columns]
    return np.asarray(array, np.float64)
