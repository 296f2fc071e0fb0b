"""Join runs of one robot: rows and frames in sequence, with a block border at each gap.

Pieces of one recording keep its clock, and a piece that begins where the previous one ends
continues it. So cutting a run and joining its pieces restores the run. Any other run begins
`gap_s` after the end of the previous one. A prediction continues through such a gap, so memory
after it is that of a robot which waited there. Commands that learn from several runs take them
separately, each starting in equilibrium. Pinned by tests/run/test_run_parts.py.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.atomic import Document
from softmap_edge.run import pieces as run_pieces
from softmap_edge.run.blocks import joined_blocks
from softmap_edge.run.fields import BY_ROW, SEEN
from softmap_edge.run.fits import check_fit
from softmap_edge.run.folds import GAP
from softmap_edge.run.run import BASE_MARKERS, MAX_NUMBERS, PIECES, Run

Floats = NDArray[np.float64]
# s between runs of different recordings: ten times the gap next to a block of a diagnosis
GAP_S = 10.0
NEXT = 1.5  # usual steps of rows within which a piece continues the one before it
SLACK = 1e-6  # s by which times of one recording may differ after a shift and its inverse
STACKED = tuple(name for name in BY_ROW if name not in ("t", "gravity"))


@dataclass(frozen=True)
class _Placed:
    """A run with its place in the joined run.

    `shift_s` is added to its times; its first `skip` rows repeat the previous run.
    """

    run: Run
    shift_s: float
    skip: int
    follows: bool  # whether it continues the previous run without a gap


def join_runs(runs: Sequence[Run], gap_s: float = GAP_S, drop: Collection[str] = ()) -> Run:
    """Return several runs of one robot as one.

    Args:
        runs: two or more, in the order of the joined run.
        gap_s: s between the end of a run and the beginning of the next, if they come from different
            recordings.
        drop: fields to omit, such as one that some runs lack.

    Raises:
        RunError: the runs are from different robots, a field is missing in some of them, or they
            hold the same frames.
    """
    if len(runs) < 2:
        raise RunError(f"{len(runs)} run{'s' * (len(runs) != 1)} to join; give two or more")
    if not (np.isfinite(gap_s) and gap_s >= GAP):
        raise RunError(
            f"gap_s: {gap_s:g} s, expected {GAP:g} s or more: folds leave out that much next to a "
            "block"
        )
    runs = [_without(run, drop) for run in runs]
    runs = [runs[0], *(_in_scale(run, runs[0]) for run in runs[1:])]
    check_fit(runs)
    _check_size(runs)
    placed = _placed(runs, gap_s)
    change: Document = {
        "t": np.concatenate([one.run.t[one.skip :] + one.shift_s for one in placed]),
        "t_seen": np.concatenate([one.run.t_seen + one.shift_s for one in placed]),
        "block": joined_blocks([one.run for one in placed], [one.follows for one in placed]),
        "robot": next((run.robot for run in runs if run.robot is not None), None),
        "extra": _extra(placed) | run_pieces.fields(_pieces(placed)),
    }
    return replace(runs[0], **change, **_by_row(placed), **_seen(runs), **_frames(runs))


def _without(run: Run, drop: Collection[str]) -> Run:
    """Return a run without some fields."""
    needed = {"t", "t_seen", "command", "ticks", "start", *SEEN} & set(drop)
    if needed:
        raise RunError(f"drop: {', '.join(sorted(needed))} cannot be left out of a run")
    known: Document = {
        name: None for name in drop if name in run.__dataclass_fields__ and name not in run.extra
    }
    extra = {name: array for name, array in run.extra.items() if name not in drop}
    return replace(run, **known, extra=extra)


def _in_scale(run: Run, first: Run) -> Run:
    """Return a run of outputs in the scale of the first one, if both have the same outputs."""
    own, other = run.output, first.output
    if (
        own is None
        or other is None
        or (own.names, own.unit) != (other.names, other.unit)
        or run.markers is None
    ):
        return run
    return replace(run, markers=own.rescaled(run.markers, other), output=other)


def _check_size(runs: Sequence[Run]) -> None:
    """Raise RunError if the joined run would exceed the size limit of a run file."""
    numbers = sum(array.size for run in runs for array in run.arrays().values())
    if numbers > MAX_NUMBERS:
        raise RunError(
            f"{numbers:.3g} numbers in all, at most {MAX_NUMBERS:.3g} are read; join fewer runs"
        )


# --- where each run stands ------------------------------------------------------------------
def _placed(runs: Sequence[Run], gap_s: float) -> list[_Placed]:
    """Return the runs in sequence; pieces of one recording are placed by its clock."""
    _check_apart(runs)
    found = [_Placed(runs[0], 0.0, 0, False)]
    for run in runs[1:]:
        before = found[-1]
        end = _end(before.run) + before.shift_s
        shift = _on_its_clock(before, run)
        if (
            shift is None
            or _begin(run) + shift < before.run.t_seen[-1:].max(initial=-np.inf) + before.shift_s
        ):
            found.append(
                _Placed(run, end + gap_s - float(min([run.t[0], *run.t_seen[:1]])), 0, False)
            )
            continue
        last_row = float(before.run.t[-1]) + before.shift_s
        skip = int(np.searchsorted(run.t + shift, last_row + SLACK))
        follows = skip > 0 or float(run.t[0]) + shift - last_row <= NEXT * _step(before.run)
        found.append(_Placed(run, shift, skip, follows))
    return found


def _step(run: Run) -> float:
    """Return the usual time step (s) between rows; 0 for a single row."""
    return float(np.median(np.diff(run.t))) if len(run.t) > 1 else 0.0


def _begin(run: Run) -> float:
    """Return the time (s) of the first frame, or of the first row without frames."""
    return float(run.t_seen[0]) if run.frames else float(run.t[0])


def _end(run: Run) -> float:
    """Return the time (s) of the last row or frame."""
    return float(max([run.t[-1], *run.t_seen[-1:]]))


def _on_its_clock(before: _Placed, run: Run) -> float | None:
    """Return the shift (s) of a run on the clock of the previous recording.

    None if it belongs to another recording.
    """
    last, first = run_pieces.pieces(before.run)[-1], run_pieces.pieces(run)[0]
    if last.origin != first.origin:
        return None
    return last.shift_s + before.shift_s - first.shift_s


def _check_apart(runs: Sequence[Run]) -> None:
    """Raise RunError if two runs hold the same frames of one recording."""
    known: list[tuple[str, float, float, int]] = []
    for number, run in enumerate(runs, start=1):
        parts = run_pieces.pieces(run)
        ends = [part.frame for part in parts[1:]] + [run.frames]
        for part, end in zip(parts, ends):
            if part.frame == end:
                continue
            low, high = (float(run.t_seen[k]) - part.shift_s for k in (part.frame, end - 1))
            for origin, start, stop, other in known:
                if origin == part.origin and low <= stop and start <= high:
                    raise RunError(
                        f"runs {other} and {number} both hold {max(low, start):g} to "
                        f"{min(high, stop):g} s of recording {origin[:12]}; the same frames would "
                        "count twice, so give each once"
                    )
            known.append((part.origin, low, high, number))


def _pieces(placed: Sequence[_Placed]) -> list[run_pieces.Piece]:
    """Return the pieces of the joined run; a piece that continues the previous one is merged."""
    found: list[run_pieces.Piece] = []
    rows = frames = 0
    for one in placed:
        parts = run_pieces.pieces(one.run)
        for part in parts[one.follows :]:
            begin = rows + max(part.row - one.skip, 0), frames + part.frame
            found.append(run_pieces.Piece(part.origin, *begin, part.shift_s + one.shift_s))
        rows, frames = rows + len(one.run.t) - one.skip, frames + one.run.frames
    return found


# --- the fields -----------------------------------------------------------------------------
def _by_row(placed: Sequence[_Placed]) -> Document:
    """Return the fields that have an entry for each row."""
    found: Document = {}
    for name in STACKED:
        rows = [(one.run.array(name), one.skip) for one in placed]
        parts = [values[skip:] for values, skip in rows if values is not None]
        found |= {name: np.concatenate(parts)} if parts else {}
    gravity = [one.run.gravity for one in placed if one.run.gravity is not None]
    if gravity:
        same = all(rows.ndim == 1 and np.array_equal(rows, gravity[0]) for rows in gravity)
        full = [
            np.broadcast_to(rows, (len(one.run.t), 3))[one.skip :]
            for rows, one in zip(gravity, placed)
        ]
        found["gravity"] = gravity[0] if same else np.concatenate(full)
    return found


def _seen(runs: Sequence[Run]) -> Document:
    """Return the seen data: points, their visibility and their sigma."""
    found: Document = {}
    places = [run.places for run in runs if run.places is not None]
    if runs[0].seen is not None and places:
        found[runs[0].seen] = np.concatenate(places)
    clouds = [
        (run.points, run.start) for run in runs if run.points is not None and run.start is not None
    ]
    if clouds:
        counts = np.concatenate([np.diff(start) for _, start in clouds])
        found |= {
            "points": np.concatenate([points for points, _ in clouds]),
            "start": np.r_[0, np.cumsum(counts)],
        }
    if any(run.visible is not None for run in runs):
        found["visible"] = np.concatenate([_visible(run) for run in runs])
    sigma = [run.sigma for run in runs if run.sigma is not None]
    if sigma:
        one = all(value.ndim == 0 and value == sigma[0] for value in sigma)
        full = [
            value if value.ndim else np.full(_visible(run).shape, float(value))
            for value, run in zip(sigma, runs)
        ]
        found["sigma"] = sigma[0] if one else np.concatenate(full)
    return found


def _visible(run: Run) -> NDArray[np.bool_]:
    """Return which points (K, N) are not hidden."""
    if run.visible is not None:
        return run.visible
    count = 0 if run.places is None else run.places.shape[1]
    return np.ones((run.frames, count), bool)


def _frames(runs: Sequence[Run]) -> Document:
    """Return the frame of aligned runs if all share it, with the largest of their uncertainties."""
    first, sigma = runs[0].frame, [run.frame_sigma for run in runs if run.frame_sigma is not None]
    same = first is not None and all(
        run.frame is not None and np.array_equal(run.frame, first) for run in runs
    )
    return {
        "frame": first if same else None,
        "frame_sigma": np.max(sigma, axis=0) if sigma else None,
    }


def _extra(placed: Sequence[_Placed]) -> dict[str, NDArray[np.generic]]:
    """Return the fields of `extra`: joined if per row or per frame, else the common value."""
    found = {}
    for name in sorted({name for one in placed for name in one.run.extra} - set(PIECES)):
        arrays = [one.run.extra.get(name) for one in placed]
        known = [array for array in arrays if array is not None]
        in_all = len(known) == len(placed)
        if in_all and all(
            array.shape == known[0].shape and np.array_equal(array, known[0]) for array in known
        ):
            found[name] = known[0]
        elif name in ("made_by", "made_from"):
            continue  # kept per recording: the hash represents it
        elif (
            in_all
            and name != BASE_MARKERS
            and all(a.ndim and len(a) == len(o.run.t) for a, o in zip(known, placed))
        ):
            found[name] = _stacked(name, [array[one.skip :] for array, one in zip(known, placed)])
        elif in_all and all(a.ndim and len(a) == o.run.frames for a, o in zip(known, placed)):
            found[name] = _stacked(name, known)
        else:
            raise RunError(
                f"{name}: differs between the runs; leave it out (--drop {name}), or give runs of "
                "one robot"
            )
    return found


def _stacked(name: str, arrays: Sequence[NDArray[np.generic]]) -> NDArray[np.generic]:
    """Return arrays concatenated; raise RunError if their other axes differ."""
    if len({(array.shape[1:], array.dtype.kind) for array in arrays}) > 1:
        raise RunError(
            f"{name}: shapes {[array.shape for array in arrays]} do not fit together; leave it "
            f"out (--drop {name})"
        )
    return np.concatenate(arrays)
