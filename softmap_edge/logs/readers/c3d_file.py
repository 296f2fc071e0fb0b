"""Read the markers of a C3D file with PyPI's `c3d`.

Columns are `frame`, `time` and `LABEL.x`, `LABEL.y`, `LABEL.z`. A point with a negative residual,
or at exactly (0, 0, 0), was not seen. Analog channels are left out. Sizes are checked against the
file before reading, because a damaged header may state billions of frames.
"""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from softmap_edge.errors import RunError
from softmap_edge.logs.readers.columns import Array, HeldColumns

if TYPE_CHECKING:
    from c3d import Reader

LIMIT = 2**28  # bytes of one file: an hour of 50 markers at 100 Hz
_SIZES = 2  # bytes of the smallest coordinate
_UNITS = ("mm", "cm", "m", "in", "ft")


def open_c3d(path: Path) -> HeldColumns:
    """Read a C3D file.

    Raises:
        RunError: `c3d` is not installed, the file is absent, too large, damaged, or holds no
            markers.
    """
    try:
        import c3d
    except ImportError:
        raise RunError(
            f"{path}: C3D needs the package c3d; run pip install 'softmap-edge[logs]'"
        ) from None
    try:
        if path.stat().st_size > LIMIT:
            raise RunError(
                f"{path}: {path.stat().st_size} bytes, at most {LIMIT} are read; split the "
                "recording"
            )
        data = path.read_bytes()
    except OSError as cause:
        raise RunError(
            f"{path}: cannot be read ({cause.strerror or cause}); give the path of a log"
        ) from cause
    if len(data) < 512 or data[1] != 0x50:
        raise RunError(f"{path}: is not a C3D file (its second byte is not 0x50); export it again")
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # about absent analog data
            reader = c3d.Reader(io.BytesIO(data))
            labels, unit = _labels(reader), _text(reader, "UNITS").strip().lower()
            first, last, rate = (
                int(reader.first_frame),
                int(reader.last_frame),
                float(reader.point_rate),
            )
            _check(path, len(labels), first, last, rate, len(data))
            frames, points = _points(reader, len(labels))
    except RunError:
        raise
    except AssertionError as fault:
        raise RunError(f"{path}: {_inconsistent(str(fault))}") from None
    except Exception as fault:  # damaged files raise errors of struct, numpy, codecs and asserts
        raise RunError(
            f"{path}: is a damaged C3D file ({type(fault).__name__} while it is read); export it "
            "again"
        ) from None
    if not len(points):
        raise RunError(f"{path}: holds no frames; export it again")
    names = [f"{label}.{axis}" for label in labels for axis in "xyz"]
    units = dict.fromkeys(names, unit) if unit in _UNITS else {}
    time = (frames - first) / rate
    numbers = np.column_stack([frames, time, points.reshape(len(points), -1)])
    short = last - first + 1 - len(points)
    notes: tuple[str, ...] = (f"time counts frames at {rate:g} Hz, as the file states",)
    notes += (f"the file ends {short} frames early",) if short else ()
    return HeldColumns(path, ["frame", "time", *names], numbers, units, notes=notes)


def _inconsistent(fault: str) -> str:
    """Return why a file contradicts itself, from the words of the reader."""
    rates = re.search(r"frame rate! (\S+) header != (\S+) POINT:RATE", fault)
    if rates is None:
        return f"is a damaged C3D file ({fault[:80] or 'AssertionError'}); export it again"
    return (
        f"its header states {float(rates[1]):g} frames a second, its parameter POINT:RATE "
        f"{float(rates[2]):g}: the times of the frames are not known; correct one of them, or "
        "export it again"
    )


def _labels(reader: Reader) -> list[str]:
    count = int(reader.point_used)
    found: list[str] = []
    for name in ("LABELS", "LABELS2"):
        param = reader.get("POINT").get(name) if reader.get("POINT") else None
        if param is None or not param.bytes:
            continue
        width = int(param.dimensions[0]) if param.dimensions else len(param.bytes)
        raw = bytes(param.bytes)
        found += [
            raw[k : k + width].decode("utf-8", "replace") for k in range(0, len(raw), max(width, 1))
        ]
    found = ["".join(c for c in label if c.isprintable()).strip() for label in found[:count]]
    found += [""] * min(count - len(found), 2**16)
    taken: set[str] = set()  # a set, because a damaged file may state 65 535 labels
    unique: list[str] = []
    for k, label in enumerate(found):
        label = label or f"marker {k}"
        unique.append(label if label not in taken else f"{label} #{k}")
        taken.add(unique[-1])
    return unique


def _text(reader: Reader, name: str) -> str:
    group = reader.get("POINT")
    param = group.get(name) if group else None
    return bytes(param.bytes).decode("latin-1") if param is not None and param.bytes else ""


def _check(path: Path, count: int, first: int, last: int, rate: float, size: int) -> None:
    if count < 1:
        raise RunError(f"{path}: holds no markers; export the trajectories with it")
    if not 1e-3 <= rate <= 1e5:  # also false for NaN
        raise RunError(f"{path}: states {rate:g} frames a second; export it again")
    frames = last - first + 1
    if frames < 1 or frames * count * 4 * _SIZES > size:
        raise RunError(
            f"{path}: {frames} frames of {count} markers do not fit in {size} bytes; the file is "
            "damaged"
        )


def _points(reader: Reader, count: int) -> tuple[Array, Array]:
    """Frame numbers (K,), and (K, M, 3) in the file's unit, NaN where not seen."""
    frames: list[int] = []
    rows: list[Array] = []
    for frame, points, _ in reader.read_frames(copy=True, check_nan=False):
        frames.append(frame)
        rows.append(points[:, :4])
    if not rows:
        return np.zeros(0), np.zeros((0, count, 3))
    table = np.asarray(rows, float)
    places = table[..., :3]
    lost = (table[..., 3] < 0) | ~np.isfinite(places).all(axis=2) | (places == 0).all(axis=2)
    places[lost] = np.nan
    return np.asarray(frames, float), places
