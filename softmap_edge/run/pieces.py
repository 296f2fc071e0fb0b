"""Pieces: the recordings that a run was cut from or joined from, stored in the run's file.

A piece is the rows from `row` and the frames from `frame` up to those of the next piece. Its times
in the run are those of its recording plus `shift_s`. A run that was neither cut nor joined is one
piece: itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.run.run import PIECES, Run

_HASH = 64  # characters of a SHA-256 in hex


@dataclass(frozen=True)
class Piece:
    """A part of a recording: its `origin` (the recording's hash) and where it begins in the run."""

    origin: str
    row: int
    frame: int
    shift_s: float


def pieces(run: Run) -> tuple[Piece, ...]:
    """Return the pieces of a run, in order.

    Raises:
        RunError: the piece fields of the run are inconsistent.
    """
    there = [name for name in PIECES if name in run.extra]
    if not there:
        return (Piece(run.hash(), 0, 0, 0.0),)
    arrays = [np.atleast_1d(run.extra.get(name, np.zeros(0))) for name in PIECES]
    if len(there) < len(PIECES) or not _fit(run, arrays):
        raise RunError(
            f"{', '.join(there)}: do not fit the rows and frames of the run; cut or join its "
            "recordings again"
        )
    origin, row, frame, shift = arrays
    return tuple(
        Piece(str(o), int(r), int(f), float(s)) for o, r, f, s in zip(origin, row, frame, shift)
    )


def _fit(run: Run, arrays: Sequence[NDArray[np.generic]]) -> bool:
    """Return whether the piece fields (P,) belong to the run."""
    origin, row, frame, shift = arrays
    if len({array.shape for array in arrays}) > 1 or origin.ndim != 1 or not len(origin):
        return False
    if (
        origin.dtype.kind != "U"
        or {row.dtype.kind, frame.dtype.kind} - set("iu")
        or shift.dtype.kind != "f"
    ):
        return False
    named = all(
        len(text) == _HASH and not set(text) - set("0123456789abcdef") for text in origin.tolist()
    )
    rise = all(
        begins[0] == 0 and np.all(np.diff(begins.astype(float)) >= 0) for begins in (row, frame)
    )
    return bool(
        named
        and rise
        and row[-1] < len(run.t)
        and frame[-1] <= run.frames
        and np.isfinite(shift).all()
    )


def fields(parts: Sequence[Piece]) -> dict[str, NDArray[np.generic]]:
    """Return the fields of `Run.extra` that store the pieces."""
    values = (
        np.array([part.origin for part in parts]),
        np.array([part.row for part in parts], np.int64),
        np.array([part.frame for part in parts], np.int64),
        np.array([part.shift_s for part in parts], float),
    )
    return dict(zip(PIECES, values))


def within(parts: Sequence[Piece], rows: slice, frames: slice) -> list[Piece]:
    """Return the pieces with rows or frames in a part of their run, counted from its start."""
    found = []
    ends = [(part.row, part.frame) for part in parts[1:]] + [(rows.stop, frames.stop)]
    for part, (row_end, frame_end) in zip(parts, ends):
        if max(part.row, rows.start) < min(row_end, rows.stop) or max(
            part.frame, frames.start
        ) < min(frame_end, frames.stop):
            begins = max(part.row - rows.start, 0), max(part.frame - frames.start, 0)
            found.append(Piece(part.origin, *begins, part.shift_s))
    return found


def spans(run: Run) -> list[tuple[Piece, float, float]]:
    """Return each piece with the first and last time (s) of its rows, on its recording's clock."""
    parts = pieces(run)
    ends = [part.row for part in parts[1:]] + [len(run.t)]
    return [
        (
            part,
            float(run.t[part.row]) - part.shift_s,
            float(run.t[max(end - 1, part.row)]) - part.shift_s,
        )
        for part, end in zip(parts, ends)
    ]
