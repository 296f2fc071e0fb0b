"""Find, report and remove samples that repeat because they are read more slowly than logged.

A held encoder lags by half its period on average. It is reconstructed by straight lines between
the rows where new values arrive. Real rest is kept: only gaps up to three typical holds are
bridged, and a typical hold over 0.25 s means a robot at rest. Slow motion of a coarse encoder also
repeats, but irregularly, so new values must be evenly spaced. Channels read in turn (a bus that
asks one motor per row) are reconstructed separately. A frame of markers that repeats the previous
one bit for bit is an old picture if the noise makes a repeat improbable (`chance.py`), or if new
pictures arrive regularly and differ by more than the digits of the file. It is left out, unless it
lasts longer than 0.25 s. A resting finger with coarse digits also repeats; its frames are kept.
Pinned by tests/logs/test_import_held.py and tests/logs/test_old_pictures.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.logs.chance import digit_of, is_improbable

Array = NDArray[np.float64]
DIGITS = 2.0  # digits of the file: new pictures of a slow camera differ by more
CATCHES_UP = 2.0  # usual moves: jump after a frozen camera resumes
LONGEST_HOLD = 0.25  # s: an encoder polled more slowly than 4 Hz is not reconstructed
_FRESH = 0.7  # of the rows: with a larger share of new values, repeats are chance
_FEW = 10  # frames: too few to distinguish an old picture from a synthetic log
_EVEN = 0.8  # of the gaps between new values are within a row of a multiple of the typical gap


@dataclass(frozen=True)
class Held:
    """What was held: the typical time between new values, and the share of repeated rows.

    The time is in s; 0 if nothing was held.
    """

    hold_s: float = 0.0
    share: float = 0.0
    in_turn: bool = False  # whether channels are read one after the other

    def __str__(self) -> str:
        return self.text()

    def text(self, beat: str | None = None) -> str:
        """Return a sentence on what was held, with the time between new values.

        `beat` replaces this time in a log without time.
        """
        how = "each channel in turn " if self.in_turn else ""
        beat = beat or f"every {self.hold_s * 1e3:.0f} ms"
        return f"{100 * self.share:.0f} % of the rows repeat the one before (read {how}{beat})"


def unhold(t: Array, rows: Array) -> tuple[Array, Held]:
    """Replace held samples by lines between the rows where new values arrive.

    Args:
        t: (T,) s.
        rows: (T, C).

    Returns:
        The reconstructed rows, and what was held.
    """
    if len(rows) < 3 or rows.shape[1] == 0:
        return rows, Held()
    new = np.vstack([np.ones((1, rows.shape[1]), bool), np.diff(rows, axis=0) != 0])
    knots, hold = _knots(t, np.flatnonzero(new.any(axis=1)))
    if knots is not None:
        lines = [np.interp(t, t[knots], rows[knots, c]) for c in range(rows.shape[1])]
        return np.stack(lines, axis=1), Held(hold, 1.0 - float(new.any(axis=1).mean()))
    done, holds = rows.copy(), []
    for c in range(rows.shape[1]):
        fresh = np.flatnonzero(new[:, c])
        knots, hold = _knots(t, fresh)
        if knots is not None:
            done[:, c] = np.interp(t, t[knots], rows[knots, c])
            holds.append(hold)
    if not holds:
        return rows, Held()
    return done, Held(float(np.median(holds)), 1.0 - float(new.mean()), in_turn=True)


def _knots(t: Array, fresh: NDArray[np.int64]) -> tuple[NDArray[np.int64] | None, float]:
    """Return the rows to connect by lines, and the typical hold (s); None if nothing is held."""
    if len(fresh) < 3 or len(fresh) > _FRESH * len(t):
        return None, 0.0
    gaps = np.diff(fresh)
    typical, hold = int(np.median(gaps)), float(np.median(np.diff(t[fresh])))
    if typical < 2 or hold > LONGEST_HOLD or not _on_a_beat(gaps):
        return None, 0.0
    # the value did not change: keep it until one hold before the next
    still = np.flatnonzero(gaps > 3 * typical)
    return np.union1d(fresh, fresh[still + 1] - typical), hold


def _on_a_beat(gaps: NDArray[np.int64]) -> bool:
    """Return whether new values arrive at regular intervals.

    Otherwise slow motion passes the steps of an encoder.
    """
    typical = int(np.median(gaps))
    slack = 0 if typical < 4 else 1  # with a beat of 3 rows, every gap is within one
    beats = np.maximum(np.rint(gaps / typical), 1.0)  # a gap of far less is no beat
    return bool((np.abs(gaps - typical * beats) <= slack).mean() >= _EVEN)


def repeated_frames(t: Array, points: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Find frames that repeat the previous one.

    Args:
        t: (K,) s.
        points: (K, ...) coordinates, NaN where nothing was seen.

    Returns:
        Two (K,) masks: old pictures of a hold of at most 0.25 s, and frames of longer rest that
        only a frozen camera or a simulation explains.
    """
    flat = points.reshape(len(points), -1)
    same = (flat[1:] == flat[:-1]) | (np.isnan(flat[1:]) & np.isnan(flat[:-1]))
    again = np.r_[False, same.all(axis=1)]
    if len(t) < _FEW:
        return np.zeros(len(t), bool), np.zeros(len(t), bool)
    first = np.flatnonzero(~again)  # where each picture is new
    ends = np.r_[first[1:], len(t)] - 1
    long = np.repeat(t[ends] - t[first] > LONGEST_HOLD, ends - first + 1)
    improbable = is_improbable(flat)
    if not improbable and not (_knots(t, first)[0] is not None and _beyond_digits(flat, first)):
        return np.zeros(len(t), bool), again & long & _catches_up(flat, first, ends)
    return again & ~long, again & long & (improbable | _catches_up(flat, first, ends))


def _beyond_digits(flat: Array, first: NDArray[np.int64]) -> bool:
    """Return whether many new pictures, at rows `first`, differ by more than the digits."""
    digit = np.array([digit_of(column) for column in flat.T])
    moved = np.nan_to_num(np.abs(np.diff(flat[first], axis=0))) > DIGITS * digit
    return bool((moved & (digit > 0)).any(axis=1).mean() > 0.1)


def _catches_up(
    flat: Array, first: NDArray[np.int64], ends: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return for each row whether a move longer than usual follows its picture.

    The picture is shown from `first` to `ends`.
    """
    moved = np.nan_to_num(np.abs(np.diff(flat[first], axis=0)))
    usual = np.quantile(moved, 0.9, axis=0) if len(moved) else np.zeros(flat.shape[1])
    far = (moved > CATCHES_UP * usual) & (usual > 0)
    return np.repeat(np.r_[far.any(axis=1), False], ends - first + 1)
