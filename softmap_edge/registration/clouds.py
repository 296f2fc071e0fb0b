"""Point clouds from files, as a run: PLY (meshio), CSV or NPZ, one frame a file, or a run that holds them. mm.

Nothing in a file is ever run. A file without times stands for one frame; frames are a second apart then. Points that
are not finite are left out (depth cameras write them where they saw nothing), which is told. The columns of a CSV are
those that its header names x, y, z; the first three without such a header. Pinned by tests/test_clouds.py.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RegistrationError, brief
from softmap_edge.npz import read_npz
from softmap_edge.run import Run

Floats = NDArray[np.float64]

MOST_BYTES = 512 << 20  # of one cloud's file; ten million points as text
KINDS = (".ply", ".csv", ".npz")
AXIS = re.compile(r"([xyz])(?:[ _](mm|m|cm|um)| ?[(\[](mm|m|cm|um)[)\]])?")  # how a header names a column


def read_clouds(paths: Sequence[str | Path], notes: list[str] | None = None) -> Run:
    """Read clouds: one run (.npz with `points` and `start`), or one frame from each of the files.

    Args:
        paths: files .ply, .csv (columns named x, y, z, or these first) or .npz (`points` (P, 3) mm).
        notes: what was left out or taken for granted is added to them, as sentences.

    Returns:
        Run: with `points` and `start`; without commands where the files hold none.

    Raises:
        RegistrationError: a file is no cloud, or a run beside others; the message says which and what it holds.
        RunError: it is a run, and one of its fields is wrong.
    """
    files = [Path(path) for path in paths]
    if len(files) == 1 and files[0].suffix.lower() == ".npz" and _holds(files[0], "t_seen"):
        run = Run.load(files[0])
        if run.points is None:
            raise RegistrationError(f"{files[0]}: a run without clouds (`points`, `start`); nothing to register")
        return run
    said: list[str] = [] if notes is None else notes
    frames = [_cloud(path, said) for path in files]
    start = np.cumsum([0, *map(len, frames)])
    return Run(
        t=np.arange(float(len(frames))), t_seen=np.arange(float(len(frames))), points=np.vstack(frames), start=start
    )


def clouds_of(run: Run) -> list[Floats]:
    """Return the clouds (M, 3) mm of a run, one a frame."""
    if run.points is None or run.start is None:
        raise RegistrationError("the run holds no clouds (`points`, `start`); nothing to register")
    return [run.points[a:b] for a, b in zip(run.start[:-1], run.start[1:])]


def _holds(path: Path, name: str) -> bool:
    return name in read_npz(path, RegistrationError)


def _cloud(path: Path, notes: list[str]) -> Floats:
    """Return the finite points (M, 3) of one file."""
    if path.suffix.lower() not in KINDS:
        raise RegistrationError(f"{path}: clouds are read from {', '.join(KINDS)}; save it as one of them")
    if not path.is_file():
        raise RegistrationError(f"{path}: there is no such file")
    if path.stat().st_size > MOST_BYTES:
        raise RegistrationError(
            f"{path}: {path.stat().st_size >> 20} MB, at most {MOST_BYTES >> 20} are read; thin it out"
        )
    read = {".ply": _ply, ".csv": lambda path: _csv(path, notes), ".npz": _npz}
    points = np.asarray(read[path.suffix.lower()](path), np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise RegistrationError(f"{path}: points of shape {points.shape}, expected (M, 3) numbers in mm")
    finite = np.isfinite(points).all(axis=1)
    if not finite.any():
        raise RegistrationError(f"{path}: no finite point in it; nothing to register")
    if not finite.all():
        notes.append(f"{path.name}: {(~finite).sum()} of {len(points)} points are not finite and are left out")
    return np.asarray(points[finite])


def _npz(path: Path) -> Any:
    arrays = read_npz(path, RegistrationError)
    if "points" not in arrays or arrays["points"].dtype.kind not in "fiu":
        raise RegistrationError(f"{path}: holds {', '.join(arrays) or 'nothing'}, expected numbers `points` (M, 3) mm")
    clouds = max(
        arrays["t_seen"].size if "t_seen" in arrays else 1, arrays["start"].size - 1 if "start" in arrays else 1
    )
    if clouds > 1 and "t_seen" in arrays:
        raise RegistrationError(
            f"{path}: a run of {clouds} clouds beside other files; give it alone, or one cloud a file"
        )
    if clouds > 1:
        raise RegistrationError(
            f"{path}: `start` of {clouds} clouds without `t_seen`; add their times (K,) s, or give one cloud a file"
        )
    return arrays["points"]


def _csv(path: Path, notes: list[str]) -> Any:
    try:
        with path.open(encoding="utf-8-sig") as lines:
            first = lines.readline()
        named = any(c.isalpha() for c in first.replace("e", "").replace("E", "").replace("nan", ""))
        split = next((mark for mark in ",;\t" if mark in first), None)
        columns = _named(path, first.split(split), notes) if named else (0, 1, 2)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a file without rows; that is said below
            return np.loadtxt(
                path, delimiter=split, skiprows=int(named), usecols=columns, ndmin=2, encoding="utf-8-sig"
            )
    except (ValueError, UnicodeDecodeError, IndexError) as error:
        raise RegistrationError(f"{path}: no columns x, y, z of numbers ({brief(error)}); export it again") from None


def _named(path: Path, header: list[str], notes: list[str]) -> tuple[int, ...]:
    """Return which columns a header names x, y, z; the first three, with a note, where it names none of them."""
    found: dict[str, list[int]] = {axis: [] for axis in "xyz"}
    units: set[str] = set()
    for k, name in enumerate(header):
        if match := AXIS.fullmatch(name.strip().strip("\"'#/ ").lower()):
            found[match[1]].append(k)
            units |= {match[2] or match[3]} - {None}
    shown = f"its header '{', '.join(name.strip() for name in header)[:60]}'"
    if not any(found.values()):
        notes.append(f"{path.name}: {shown} names no x, y, z; the first three columns are taken for them")
        return 0, 1, 2
    if any(len(columns) != 1 for columns in found.values()):
        raise RegistrationError(f"{path}: {shown} names not each of x, y, z once; name three columns x, y, z, in mm")
    if units - {"mm"}:
        raise RegistrationError(f"{path}: {shown} says {', '.join(sorted(units))}; clouds are read in mm, convert it")
    return tuple(columns[0] for columns in found.values())


def _ply(path: Path) -> Any:
    try:
        import meshio
    except ImportError:
        raise RegistrationError("PLY files need meshio: pip install 'softmap-edge[mesh]'") from None
    try:
        with warnings.catch_warnings(), redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            warnings.simplefilter("ignore")
            return np.asarray(meshio.ply.read(str(path)).points)
    # A parser may fail in any way on a damaged file; all of them mean the same here.
    except (Exception, SystemExit) as error:
        raise RegistrationError(
            f"{path}: cannot be read as PLY ({type(error).__name__}: {brief(error)}); export it again"
        ) from None
