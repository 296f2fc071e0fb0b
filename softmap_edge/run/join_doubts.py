"""Report suspicious runs among those joined: consecutive in time, or with shared data.

Camera noise makes every frame different, so a sequence of equal frames in two runs is the same
recording. Frames that repeat within their own run, such as a simulation at rest, do not count.
Pinned by tests/run/test_join_doubts.py.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from softmap_edge.run import pieces as run_pieces
from softmap_edge.run.folds import GAP
from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
LONGEST_S = 3600.0  # s between two runs: a longer pause is no pause of one experiment
_NUMBERS = 24  # that must be equal: as many are no chance, even of coarse sensors
_AGREE = 1e-9  # of the pause


@dataclass(frozen=True)
class _Rows:
    """The measurements of a run: its name in messages, times (K,) s, and numbers (K, N)."""

    name: str
    t: Floats
    numbers: Floats


def join_doubts(runs: Sequence[Run], gap_s: float) -> list[str]:
    """Return sentences on suspicious runs among those joined.

    Args:
        runs: in the order of the joined run.
        gap_s: s between two runs in the joined run.
    """
    pairs = [_followed(k, one, runs[k + 1], gap_s) for k, one in enumerate(runs[:-1])]
    measured = [_measured(run) for run in runs]
    twice = [_twice(i, measured[i], j, measured[j]) for i, j in combinations(range(len(runs)), 2)]
    return [line for line in [*pairs, *twice] if line is not None]


def _followed(k: int, one: Run, other: Run, gap_s: float) -> str | None:
    """Return the sentence on two runs that are consecutive in time; None if they are not."""
    same_clock = run_pieces.pieces(one)[-1].origin == run_pieces.pieces(other)[0].origin
    if one.timeless or other.timeless or same_clock:
        return None
    end, begin = (
        float(max([one.t[-1], *one.t_seen[-1:]])),
        float(min([other.t[0], *other.t_seen[:1]])),
    )
    pause = begin - end
    if not 0.0 <= pause <= LONGEST_S or abs(pause - gap_s) <= _AGREE * gap_s:
        return None
    way = (
        f"--gap {pause:.6g} keeps the true pause"
        if pause >= GAP
        else "import their logs together, as parts of one log, to keep the true pause"
    )
    return (
        f"runs {k + 1} and {k + 2} follow one another on their own clocks ({end:.6g} s, then "
        f"{begin:.6g} s), and are joined {gap_s:g} s apart: if they are parts of one experiment, "
        f"{way}"
    )


# --- the same data twice -------------------------------------------------------------------
def _measured(run: Run) -> _Rows | None:
    """Return what a run saw, else what its sensors read; None of a run without measurements."""
    seen = run.places
    if seen is not None and len(seen):
        return _Rows("frames", run.t_seen, np.asarray(seen, float).reshape(len(seen), -1))
    read = (run.present, run.present_ticks, run.current)
    rows = [np.asarray(value, float) for value in read if value is not None]
    return _Rows("rows", run.t, np.concatenate(rows, axis=1)) if rows and rows[0].size else None


def _twice(i: int, one: _Rows | None, j: int, other: _Rows | None) -> str | None:
    """Return the sentence on data shared by two runs; None if there are none."""
    if (
        one is None
        or other is None
        or one.name != other.name
        or one.numbers.shape[1:] != other.numbers.shape[1:]
    ):
        return None
    length = max(2, -(-_NUMBERS // one.numbers.shape[1]))
    mine, theirs = _stretches(one.numbers, length), _stretches(other.numbers, length)
    shared = sorted(mine.keys() & theirs.keys(), key=lambda key: theirs[key])
    if not shared:
        return None
    first, second = ([rows[key] for key in shared] for rows in (mine, theirs))
    count = len({at + k for at in second for k in range(length)})
    spans = [(t[min(at)], t[max(at) + length - 1]) for t, at in ((one.t, first), (other.t, second))]
    where = " and ".join(
        f"{low:.6g} to {high:.6g} s of run {n + 1}" for (low, high), n in zip(spans, (i, j))
    )
    return (
        f"{count} {one.name} have equal values in runs {i + 1} and {j + 1} ({where}): they count "
        "twice; take them out of one run with `softmap run cut`"
    )


def _stretches(numbers: Floats, length: int) -> dict[bytes, int]:
    """Return the first row of each stretch of `length` rows of numbers (K, N), by content.

    Only stretches that occur once and are not at rest are returned.
    """
    rows = np.ascontiguousarray(np.where(np.isfinite(numbers), numbers, 0.0) + 0.0)
    moves = np.any(np.diff(rows, axis=0) != 0, axis=1)
    found: dict[bytes, int] = {}
    again: set[bytes] = set()
    for k in range(len(rows) - length + 1):
        if not moves[k : k + length - 1].all():
            continue
        key = hashlib.blake2b(rows[k : k + length].data, digest_size=16).digest()
        again |= {key} if key in found else set()
        found[key] = k
    return {key: k for key, k in found.items() if key not in again}
