"""Read point clouds from files as a run: one frame a file, or a run that holds clouds. Units: mm.

PLY, PCD, text (CSV, XYZ, PTS, COLMAP, OBJ vertices), NPY and NPZ are recognised by their content,
not by their name. No code in a file is run, and sizes in a file are checked before memory is
allocated. A file without times is one frame; the frames are then one second apart. Pixels without
depth are left out and counted (`unseen.py`). Columns are found by their names, or else by their
values (`columns.py`). Pinned by tests/alignment/test_clouds.py and
tests/alignment/test_clouds_of_others.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.cloud_files.array import read_archive, read_npy
from softmap_edge.alignment.cloud_files.pcd import is_pcd, read_pcd
from softmap_edge.alignment.cloud_files.ply import read_ply
from softmap_edge.alignment.cloud_files.text import read_text
from softmap_edge.alignment.cloud_files.unseen import left_out
from softmap_edge.errors import RegistrationError
from softmap_edge.files.npz import archive_names
from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Reader = Callable[[Path, list[str]], Floats]

MOST_BYTES = 512 << 20  # of one cloud's file; ten million points as text
READ = "PLY, PCD, CSV, XYZ, OBJ, NPY or NPZ"
_HEAD = 4096  # bytes from which a kind of file is recognised
_OTHERS = [
    (b"LASF", "a LAS or LAZ file"),
    (b"ASTM-E57", "an E57 file"),
    (b"\x89HDF", "an HDF5 file"),
    (b"MATLAB 5", "a MATLAB file"),
    (b"\x1f\x8b", "compressed by gzip; unpack it first"),
    (b"\x28\xb5\x2f\xfd", "compressed by zstd; unpack it first"),
    (b"#ROSBAG", "a ROS 1 bag"),
    (b"\x89MCAP", "an MCAP recording"),
    (b"SQLite format", "an SQLite file"),
    (b"glTF", "a glTF file"),
    (b"OFF", "an OFF mesh"),
    (b"solid", "an STL mesh"),
    (b"# vtk DataFile", "a VTK file"),
    (b"<", "an XML file"),
    (b"{", "a JSON file"),
    (b"[", "a JSON file"),
]


def read_clouds(paths: Sequence[str | Path], notes: list[str] | None = None) -> Run:
    """Read clouds: one run (.npz with `points` and `start`), or one frame from each file.

    Args:
        paths: PLY, PCD, CSV, XYZ, OBJ, NPY or NPZ files of points (M, 3) mm.
        notes: receives a sentence for each part that was left out, and for each choice of columns.

    Returns:
        Run: with `points` and `start`; without commands if the files hold none.

    Raises:
        RegistrationError: a file is not a cloud, or a run among other files; the message names it
            and its contents.
        RunError: a run with an invalid field.
    """
    files = [Path(path) for path in paths]
    found: list[str] = [] if notes is None else notes
    if len(files) == 1 and "t_seen.npy" in archive_names(files[0]):
        run = Run.load(files[0])
        if run.points is None:
            raise RegistrationError(
                f"{files[0]}: a run without clouds (`points`, `start`); nothing to register"
            )
        run, text = with_depth(run)
        found += [f"{files[0].name}: {text}"] if text else []
        return run
    frames = [_cloud(path, found) for path in files]
    start = np.cumsum([0, *map(len, frames)])
    return Run(
        t=np.arange(float(len(frames))),
        t_seen=np.arange(float(len(frames))),
        points=np.vstack(frames),
        start=start,
    )


def clouds_of(run: Run) -> list[Floats]:
    """Return the measured points (M, 3) mm of each frame of a run, without pixels that lack depth.

    Raises:
        RegistrationError: the run holds no clouds.
    """
    return [cloud[left_out(cloud)[0]] for cloud in _clouds(run)]


def with_depth(run: Run) -> tuple[Run, str]:
    """Return a run of clouds without pixels that lack depth, and a sentence on them ("" if none).

    Raises:
        RegistrationError: the run holds no clouds.
    """
    clouds = _clouds(run)
    found = [left_out(cloud) for cloud in clouds]
    lost = [(k, text) for k, (_, text) in enumerate(found) if text]
    if not lost:
        return run, ""
    start = np.cumsum([0, *(int(good.sum()) for good, _ in found)])
    kept = replace(
        run, points=np.vstack([cloud[good] for cloud, (good, _) in zip(clouds, found)]), start=start
    )
    return (
        kept,
        f"{len(lost)} of {len(found)} clouds, the first is cloud {lost[0][0]}: {lost[0][1]}",
    )


def _clouds(run: Run) -> list[Floats]:
    """Return the clouds of a run as they are stored."""
    if run.points is None or run.start is None:
        raise RegistrationError("the run holds no clouds (`points`, `start`); nothing to register")
    return [run.points[a:b] for a, b in zip(run.start[:-1], run.start[1:])]


def _cloud(path: Path, notes: list[str]) -> Floats:
    """Return the measured points (M, 3) mm of one file."""
    if not path.is_file():
        raise RegistrationError(
            f"{path}: {'not a file' if path.exists() else 'there is no such file'}; give a cloud"
        )
    if path.stat().st_size > MOST_BYTES:
        raise RegistrationError(
            f"{path}: {path.stat().st_size >> 20} MB, at most {MOST_BYTES >> 20} are read; thin "
            "it out"
        )
    own: list[str] = []
    try:
        with np.errstate(all="ignore"):  # of numbers in a damaged file
            points = _reader(path)(path, own)
        good, text = left_out(points)
        if not good.any():
            raise RegistrationError(
                f"{path}: no point in it was seen{f' ({text})' if text else ''}; nothing to "
                "register"
            )
    except RegistrationError as fault:
        raise RegistrationError("; ".join([str(fault), *own])) from None
    finally:
        notes += own
    notes += [f"{path.name}: {text}"] if text else []
    return np.asarray(points[good])


def _reader(path: Path) -> Reader:
    """Return the reader of a file, by its first bytes."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if head.startswith((b"ply\n", b"ply\r")):
        return read_ply
    if head.startswith(b"PK\x03\x04"):
        return read_archive
    if head.startswith(b"\x93NUMPY"):
        return read_npy
    if is_pcd(head):
        return read_pcd
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if not text:
        raise RegistrationError(f"{path}: an empty file; save the cloud again as {READ}")
    for mark, what in _OTHERS:
        if text.startswith(mark):
            raise RegistrationError(
                f"{path}: {what}; clouds are read as {READ}: save it as one of them"
            )
    return read_text
