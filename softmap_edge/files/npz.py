"""Array archives (`.npz`): equal bytes for equal content; reading one never runs code."""

from __future__ import annotations

import contextlib
import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError, brief
from softmap_edge.files.atomic import replacement_of

Arrays = dict[str, NDArray[np.generic]]  # content of an archive, by name
Floats = NDArray[np.float64]

MAX_BYTES = 4 << 30
MOST_ARRAYS = 1000
OBJECTS = "it holds Python objects, which are never read"
_MOST_DIRECTORY = 1 << 20  # bytes of an archive's table of contents; 1000 arrays need 0.1 MB
_END, _END_BYTES, _LONGEST_COMMENT = b"PK\5\6", 22, 1 << 16  # of the record that ends an archive
# of the preceding record in an archive of more than 4 GiB
_ZIP64, _ZIP64_BYTES = b"PK\6\7", 20
_LONGEST_HEADER = 1 << 14  # bytes of an array's header; NumPy reads at most 10 000 characters
STEP = "_step"  # suffix of the name of an array's steps
_EPOCH = (1980, 1, 1, 0, 0, 0)
DOCUMENTS = (".json", ".html", ".toml", ".svg")  # reports and settings of this package, no logs


def write_npz(path: Path, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """Write `arrays` to `path`, replacing it only when complete; equal content gives equal bytes.

    Tables of whole numbers are stored column by column: steps vary smoothly within a column, so the
    file is a fifth smaller.
    """
    with (
        replacement_of(path) as partial,
        zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive,
    ):
        for name in sorted(arrays):
            buffer = io.BytesIO()
            order: Literal["F", "C"] = "F" if np.asarray(arrays[name]).dtype.kind == "i" else "C"
            # ascontiguousarray would add an axis to a scalar
            array = np.asarray(arrays[name], order=order)
            np.lib.format.write_array(buffer, array, allow_pickle=False)
            archive.writestr(
                zipfile.ZipInfo(f"{name}.npy", _EPOCH),
                buffer.getvalue(),
                zipfile.ZIP_DEFLATED,
                compresslevel=9,
            )


def read_npz(
    path: Path,
    error: type[SoftmapError] = SoftmapError,
    limit: int = MAX_BYTES,
    numbers: int | None = None,
) -> dict[str, NDArray[np.generic]]:
    """Read every array of `path`.

    Args:
        path: the archive.
        error: raised with one line if the archive is damaged, too large or holds objects.
        limit: largest unpacked size, bytes.
        numbers: largest count of numbers in all arrays, checked before any is unpacked.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise error(f"{path}: no file that can be read at will; give an .npz file")
    try:
        check_directory(path, error)
        with zipfile.ZipFile(path) as archive:
            count, total = (
                len(archive.infolist()),
                sum(entry.file_size for entry in archive.infolist()),
            )
            if count > MOST_ARRAYS:
                raise error(
                    f"{path.name}: {count} arrays, at most {MOST_ARRAYS} are read; make it again"
                )
            if total > limit:
                raise error(f"{path.name}: {total} bytes when unpacked, at most {limit} are read")
            if numbers is not None:
                _check_numbers(archive, path, error, numbers)
            arrays = {}
            for entry in archive.infolist():
                with archive.open(entry) as stream:
                    arrays[entry.filename.removesuffix(".npy")] = _read_array(
                        stream.read(), entry.filename, path, error
                    )
            return arrays
    except FileNotFoundError:
        raise error(f"{path}: no such file; check its name and folder") from None
    except IsADirectoryError:
        raise error(f"{path}: a folder, not an .npz file; give the file") from None
    except SoftmapError:
        raise
    except Exception as fault:  # damaged files raise a dozen kinds in zipfile and zlib
        if path.suffix.lower() == ".npz":
            remedy = "make it again or copy it again"
        elif path.suffix.lower() in DOCUMENTS:
            remedy = "give a run (.npz) or a recording (.mcap)"
        else:
            remedy = "a log becomes a run with `softmap import`"
        raise error(
            f"{path.name}: not a readable .npz archive ({brief(fault)}); {remedy}"
        ) from None


def _check_numbers(
    archive: zipfile.ZipFile, path: Path, error: type[SoftmapError], most: int
) -> None:
    """Reject an archive whose arrays claim more than `most` numbers of eight bytes.

    Only the start of each array is unpacked. An array counts at least an eighth of the bytes that
    its table of contents states; no more bytes than these are unpacked later.
    """
    total = 0
    for entry in archive.infolist():
        claimed = 0
        with archive.open(entry) as stream, contextlib.suppress(Exception):
            # a damaged start, or a shape without its bytes, is reported when the array is read
            head = array_header(io.BytesIO(stream.read(_LONGEST_HEADER)))
            if head.bytes <= entry.file_size:
                claimed = int(np.prod(head.shape, dtype=object))
        total += max(claimed, entry.file_size // 8)
    if total > most:
        raise error(
            f"{path}: {total:.3g} numbers, at most {most:.3g} are read; cut it into shorter runs"
        )


def archive_names(path: Path) -> set[str]:
    """Return the names in an archive; an empty set if it is not a readable archive."""
    if not path.is_file():  # reading a pipe or a device may never end
        return set()
    try:
        check_directory(path)
        with zipfile.ZipFile(path) as archive:
            return set(archive.namelist())
    # damaged files raise a dozen kinds in zipfile; the reader of the file reports the fault
    except Exception:
        return set()


def check_directory(path: Path, error: type[SoftmapError] = SoftmapError) -> None:
    """Reject an archive whose table of contents is too large.

    `zipfile` would allocate memory for each of its entries.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - _END_BYTES - _LONGEST_COMMENT - _ZIP64_BYTES))
        tail = file.read()
    # without a comment, as zipfile looks first
    plain = tail[-_END_BYTES:].startswith(_END) and tail.endswith(b"\0\0")
    place = len(tail) - _END_BYTES if plain else tail.rfind(_END)
    if place < 0:
        return  # not an archive; zipfile reports it
    if tail[max(0, place - _ZIP64_BYTES) : place].startswith(_ZIP64):
        raise error(
            f"{path.name}: an archive in the ZIP64 form for more than 4 GiB, which is not read; "
            "make it smaller"
        )
    entries = int.from_bytes(tail[place + 12 : place + 16], "little")
    if entries > _MOST_DIRECTORY:
        raise error(
            f"{path.name}: its table of contents has {entries} bytes, at most {_MOST_DIRECTORY} "
            f"are read; an .npz file holds up to {MOST_ARRAYS} arrays"
        )


@dataclass(frozen=True)
class ArrayHeader:
    """An array's header in NumPy's format: shape, whether columns run first (Fortran), and type."""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[np.generic]

    @property
    def bytes(self) -> int:
        """The size of the array in bytes; it may exceed the file."""
        return int(np.prod(self.shape, dtype=object)) * self.dtype.itemsize


def array_header(stream: IO[bytes]) -> ArrayHeader:
    """Read the header of an array in NumPy's format; the stream then stands at the numbers.

    Raises:
        ValueError: another version of the format, a damaged header, or a negative length.
    """
    version = np.lib.format.read_magic(stream)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    if version not in read:
        raise ValueError(f"array format {version}")
    shape, fortran, dtype = read[version](stream)
    if any(n < 0 for n in shape):
        raise ValueError(f"shape {shape}")
    return ArrayHeader(shape, fortran, dtype)


@dataclass(frozen=True, eq=False)
class Stored:
    """Numbers as stored in an archive: unchanged, or as whole numbers of steps.

    `array` is stored under a name; `step`, which broadcasts to it, under `name_step`.
    """

    array: NDArray[np.generic]
    step: NDArray[np.generic] | None = None

    @classmethod
    def in_steps(cls, values: Floats, step: Floats | float, kind: type) -> Stored:
        """Return `values` as whole numbers of steps; the rounding error is half a step at most.

        `step` is one number or broadcasts to the values. It is increased where values would not fit
        into `kind` (np.int8 or np.int16).
        """
        step = np.asarray(step, np.float64)
        alike = (
            tuple(axis for axis, length in enumerate(step.shape) if length == 1)
            if step.ndim
            else None
        )
        largest = np.max(np.abs(values), axis=alike, keepdims=step.ndim > 0, initial=0.0)
        # increase it by more than float32 may round it down
        exact = np.maximum(
            np.float32((1.0 + 1e-6) * np.maximum(step, largest / np.iinfo(kind).max)),
            np.float32(1e-30),
        )
        return cls(np.round(values / exact.astype(np.float64)).astype(kind), np.asarray(exact))

    @classmethod
    def from_npz(cls, arrays: Mapping[str, NDArray[np.generic]], name: str) -> Stored:
        """Read the numbers called `name`.

        Raises:
            SoftmapError: they are missing, or their steps do not match.
        """
        array, step = array_of(arrays, name), arrays.get(f"{name}{STEP}")
        if step is not None and not _broadcasts(step.shape, array.shape):
            raise SoftmapError(f"steps {step.shape} of '{name}' {array.shape}")
        return cls(array, step)

    def to_npz(self, name: str) -> Arrays:
        """Return the arrays to store for the numbers called `name`."""
        return {name: self.array} | ({} if self.step is None else {f"{name}{STEP}": self.step})

    @property
    def values(self) -> Floats:
        """The numbers, steps multiplied out."""
        values = np.asarray(self.array, np.float64)
        return values if self.step is None else values * np.asarray(self.step, np.float64)


def _broadcasts(shape: tuple[int, ...], to: tuple[int, ...]) -> bool:
    try:
        return np.broadcast_shapes(shape, to) == to
    except ValueError:
        return False


def fields_of(array: NDArray[np.generic]) -> Arrays:
    """Return the fields of a structured array by name; empty for any other array."""
    names, fields = array.dtype.names, array.dtype.fields
    if names is None or fields is None:
        return {}
    return {name: array.getfield(*fields[name][:2]) for name in names}


def array_of(arrays: Mapping[str, NDArray[np.generic]], name: str) -> NDArray[np.generic]:
    """Return the array of that name; raise SoftmapError if there is none."""
    if name not in arrays:
        raise SoftmapError(f"array '{name}' is missing")
    return arrays[name]


def _read_array(
    data: bytes, name: str, path: Path, error: type[SoftmapError]
) -> NDArray[np.generic]:
    stream = io.BytesIO(data)
    try:
        head = array_header(stream)
        if head.dtype.hasobject:
            raise ValueError(OBJECTS)
        there = len(data) - stream.tell()
        if head.bytes != there:
            raise ValueError(
                f"shape {head.shape} of {head.dtype} needs {head.bytes} bytes, {there} are there"
            )
        stream.seek(0)
        array: NDArray[np.generic] = np.asarray(
            np.lib.format.read_array(stream, allow_pickle=False), order="C"
        )
        if (
            head.dtype.kind == "U"
            and array.size
            and int(_code_points(array).max(initial=0)) > 0x10FFFF
        ):
            raise ValueError("it holds text that is not Unicode")
        return array
    except Exception as fault:
        raise error(
            f"{path.name}: array {name!r:.60} is not readable ({brief(fault)}); make the file again"
        ) from None


def _code_points(array: NDArray[np.generic]) -> NDArray[np.uint32]:
    """Return the characters of a text array as code points.

    NumPy reads damaged characters, but Python raises SystemError.
    """
    native = np.ascontiguousarray(array).astype(array.dtype.newbyteorder("="), copy=False)
    return native.reshape(-1).view(np.uint32)
