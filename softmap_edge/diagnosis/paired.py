"""Paired replay: a reference run of the same commands measures the model error.

    seen'(t) = seen(t) - [reference(t + s) - model(reference)(t + s)]

The measurement is reduced by the model error on the reference at the same point of the replay.
There, command and history are the same. So the model error cancels, and so does every effect common
to both runs. The reference is interpolated linearly; s is the time shift at which the commands
agree. Of several references, the one with the closest commands is used. Effects that the reference
lacks, such as a weight found relative to it, are left out of model(reference). They make the
reference worse and the run better. Remaining uncertainty:
- the camera: the noise of a difference, twice that of one run where frames coincide. It follows
  from the replicates;
- a table: KEPT of its model-form error, plus the part from another gravity or load. An effect may
  move the effective command by 1-2 of 32 mm. An error that varies over 0.4 of the range then
  changes by about a sixth;
- a rod, whose stated error is mostly poor repeatability: per feature 2·(var a - cov(a, b)). a and b
  are the residuals of the reference and of the run; it is twice the part that they do not share.
Units: those of the commands, mm, s. Limits: an effect in both runs is not detected. One that acts
on top of another (more load on a softened body) is detected to first order. Pinned by
tests/diagnosis/test_paired.py and tests/rod/test_trunk.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError
from softmap_edge.run.folds import LEAST_FRAMES

if TYPE_CHECKING:
    from softmap_edge.diagnosis.record import Record

Floats = NDArray[np.float64]

AGREE = 0.01  # of the command range: largest RMS difference between runs of the same commands
KEPT = 0.2  # of a table's model-form error: part that remains under a changed condition
GAPS = 3.0  # median periods of the reference: longest gap for interpolation
LEAST_OVERLAP = 0.5  # of the frames of a run: least share that the reference covers
GRID = 200_000  # most rows for the search of the time shift
FLOOR = 0.01  # best repeatability of any robot, mm
# of the reference's error: most that remains without an effect that only the run has
ABSENT = 0.9


@dataclass(frozen=True)
class Replay:
    """How a reference matches a run: its time shift, and the RMS difference of commands."""

    run: str | list[str]  # hash of the reference, or of each if runs use different ones
    shift_s: float
    differ: float
    share: float
    unit: str
    frames: int
    absent: tuple[str, ...] = ()  # effects of the model that the reference lacks

    def __str__(self) -> str:
        own = " and ".join(self.absent)
        return (
            "All of this is relative to the reference run, whose commands agree within "
            f"{self.differ:.2g} {self.unit} RMS ({100 * self.share:.2g} % of their range): what "
            "acts alike in both runs cancels out and is not seen"
            + (
                f"; the model's own {own} is taken as absent there, where it raises the error"
                if own
                else ""
            )
        )


def pair(record: Record, references: Sequence[Record]) -> tuple[Replay, Floats, Floats]:
    """Match a run with its reference; of several, use the one whose commands agree best.

    Args:
        record: the run, K frames of F features.
        references: candidate reference runs, observed in the same way.

    Returns:
        tuple: how they match; the model error on the reference at the run's frames (K, F) mm, NaN
        where the reference has no data; and the remaining model-form error (V, 3) mm.

    Raises:
        SoftmapError: points of another kind or position, different commands, too little overlap.
    """
    found, refused = [], []
    for reference in references:
        try:
            found.append(_meet(record, reference))
        except SoftmapError as fault:
            refused.append(str(fault))
    if found:
        return min(found, key=lambda met: met[0].share)
    if len(refused) > 1:
        raise SoftmapError(
            f"none of the {len(refused)} reference runs stands for this run; of the last, "
            f"{refused[-1]}"
        )
    raise SoftmapError(refused[0])


def _meet(record: Record, reference: Record) -> tuple[Replay, Floats, Floats]:
    """Match a run with one reference."""
    _check_points(record, reference)
    # otherwise the encoder positions
    played = all(r.run.command is not None for r in (record, reference))
    ours, theirs = (
        np.asarray(r.run.command if played else r.u, float) for r in (record, reference)
    )
    shift = _shift(
        np.asarray(record.run.t, float), ours, np.asarray(reference.run.t, float), theirs
    )
    at = record.t_seen + shift
    differ, share = _differ(record.t_seen, at, record, reference, ours, theirs)
    inside = _read(at, reference.t_seen, reference.seen)
    met = np.isfinite(inside).any(axis=1)
    if met.sum() < max(LEAST_FRAMES, LEAST_OVERLAP * len(record)):
        raise SoftmapError(
            f"the reference run was seen at {int(met.sum())} of the {len(record)} frames of this "
            f"run, at least {max(LEAST_FRAMES, int(LEAST_OVERLAP * len(record)))} are needed; "
            "record both for as long, with the camera on, or diagnose without --reference"
        )
    absent = _absent(record, reference)
    base = _without(reference, absent)
    missed = _read(at, reference.t_seen, reference.seen - base)
    replay = Replay(
        reference.recorded_runs[0].hash(),
        shift,
        differ,
        share,
        record.model.command_unit,
        int(met.sum()),
        absent,
    )
    return replay, missed, _form_left(record, reference, missed)


def _absent(record: Record, reference: Record) -> tuple[str, ...]:
    """Return which of the model's own effects only the run has.

    Each increases the error of the reference and lowers that of the run.
    """
    absent: tuple[str, ...] = ()
    for name in record.model.chain_names:
        ours, theirs = (
            [r.rms_mm(r.seen - _without(r, out)) for out in (absent, (*absent, name))]
            for r in (record, reference)
        )
        if theirs[1] < ABSENT * theirs[0] and ours[1] > ours[0]:
            absent = (*absent, name)
    return absent


def _without(record: Record, absent: Sequence[str]) -> Floats:
    """Return the model's prediction for a run (K, F) mm without some of its own effects."""
    own = tuple(record.model.chain_names)
    names = tuple(name for name in own if name not in absent)
    params = record.own_values()
    return np.asarray(record.predict(names, record.layout(names).values(params)[None])[0])


def _check_points(record: Record, reference: Record) -> None:
    if record.features != reference.features or not np.array_equal(
        record.positions, reference.positions
    ):
        raise SoftmapError(
            f"the reference run shows {reference.features} features a frame, this run "
            f"{record.features}; both must be seen in the same way (vertices, or the same markers)"
        )
    rests = [r.run.marker_rest for r in (record, reference)]
    if rests[0] is not None and rests[1] is not None:
        apart = float(
            np.abs(np.asarray(rests[0], float) - np.asarray(rests[1], float)).max(initial=0.0)
        )
        if apart > 1.0:
            raise SoftmapError(
                f"the markers of the reference run sit up to {apart:.2g} mm from those of this "
                "run, 1 mm is allowed; record both with the markers in place, or diagnose "
                "without --reference"
            )


def _differ(
    t: Floats, at: Floats, record: Record, reference: Record, ours: Floats, theirs: Floats
) -> tuple[float, float]:
    """Return the RMS difference of the commands at the frames, for the worst channel.

    Also return it as a share of the range.
    """
    if ours.shape[1] != theirs.shape[1]:
        raise SoftmapError(
            f"the reference run has {theirs.shape[1]} commands a sample, this run "
            f"{ours.shape[1]}; it is another robot"
        )
    inside = (at >= reference.run.t[0]) & (at <= reference.run.t[-1])
    if not ours.shape[1] or not inside.any():
        return 0.0, 0.0
    t, at = t[inside], at[inside]
    columns = zip(ours.T, theirs.T)
    off = [
        np.interp(t, record.run.t, mine) - np.interp(at, reference.run.t, other)
        for mine, other in columns
    ]
    apart = np.sqrt(np.mean(np.square(off), axis=1))
    span = np.ptp(theirs, axis=0)
    share = apart / np.maximum(np.where(span > 1e-9, span, span.max(initial=0.0)), 1e-9)
    worst = int(np.argmax(share))
    if not share[worst] <= AGREE:
        unit = record.model.command_unit
        raise SoftmapError(
            f"the reference run does not play the commands of this run: channel {worst} differs "
            f"by {apart[worst]:.3g} {unit} RMS, {100 * share[worst]:.2g} % of its range, allowed "
            f"are {100 * AGREE:g} %; record both from one command file (`softmap next` writes "
            "one), give a reference that plays these commands (--reference takes several), or "
            "diagnose without --reference"
        )
    return float(apart[worst]), float(share[worst])


def _shift(t: Floats, u: Floats, t_ref: Floats, u_ref: Floats) -> float:
    """Return the shift (s) of a run's times at which the commands agree best with the reference.

    The shift is zero if the time stamps agree. Otherwise it is the lag with the least mean square
    difference over the overlap.
    """
    if not u.shape[1] or u.shape[1] != u_ref.shape[1] or min(len(t), len(t_ref)) < 2:
        return 0.0
    span = np.maximum(np.ptp(u_ref, axis=0), 1e-9)
    inside = (t >= t_ref[0]) & (t <= t_ref[-1])
    if inside.mean() >= LEAST_OVERLAP:
        columns = zip(u.T, u_ref.T)
        off = np.stack(
            [np.interp(t[inside], t_ref, theirs) - mine[inside] for mine, theirs in columns], axis=1
        )
        if np.all(np.sqrt(np.mean((off / span) ** 2, axis=0)) <= AGREE):
            return 0.0
    step = max(float(np.median(np.diff(t_ref))), (np.ptp(t) + np.ptp(t_ref)) / GRID, 1e-6)
    a, b = (_gridded(*pair, step) / span for pair in ((t, u), (t_ref, u_ref)))
    size = 1 << (len(a) + len(b) - 1).bit_length()
    lags = np.arange(-(len(a) - 1), len(b))  # row k of the run matches row k + lag of the reference
    both = np.fft.irfft(
        np.fft.rfft(b, size, axis=0) * np.conj(np.fft.rfft(a, size, axis=0)), size, axis=0
    ).sum(axis=1)
    first, last = np.maximum(0, -lags), np.minimum(len(a), len(b) - lags)
    sums = [np.r_[0.0, np.cumsum(np.sum(x**2, axis=1))] for x in (a, b)]
    squares = (
        sums[0][last]
        - sums[0][first]
        + sums[1][last + lags]
        - sums[1][first + lags]
        - 2.0 * both[lags]
    )
    count = last - first
    mean = np.where(count >= LEAST_OVERLAP * len(a), squares / np.maximum(count, 1), np.inf)
    if not np.isfinite(mean).any():
        return 0.0
    return float(t_ref[0] - t[0] + step * lags[int(np.argmin(mean))])


def _gridded(t: Floats, u: Floats, step: float) -> Floats:
    """Resample commands at regular times from the first."""
    grid = t[0] + step * np.arange(max(2, int(np.ptp(t) / step) + 1))
    return np.stack([np.interp(grid, t, column) for column in u.T], axis=1)


def _read(at: Floats, t: Floats, values: Floats) -> Floats:
    """Interpolate `values` (K, F) at t (K,) linearly to other times (n,).

    The result is NaN beyond the ends and across gaps.
    """
    if len(t) < 2:
        return np.where((at == t[:1])[:, None], values, np.nan)
    after = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    before = after - 1
    gap = t[after] - t[before]
    share = np.where(gap > 0, (at - t[before]) / np.maximum(gap, 1e-12), 0.0)
    share = np.where(np.abs(share - np.round(share)) < 1e-6, np.round(share), share)[:, None]
    with np.errstate(invalid="ignore"):
        lower = np.where(share < 1.0, (1.0 - share) * values[before], 0.0)
        upper = np.where(share > 0.0, share * values[after], 0.0)
    known = (share >= 0.0) & (share <= 1.0)
    known &= (gap <= GAPS * np.median(np.diff(t)))[:, None] | (share == 0.0) | (share == 1.0)
    return np.where(known, lower + upper, np.nan)


def _form_left(record: Record, reference: Record, missed: Floats) -> Floats:
    """Return the model error (V, 3) mm that remains in the difference of the runs."""
    if not record.error_is_noise:
        mine, theirs = record.form_error, reference.form_error
        return np.asarray(np.sqrt((KEPT * theirs) ** 2 + np.maximum(mine**2 - theirs**2, 0.0)))
    base = record.predict(record.model.chain_names, record.own()[None])[0]
    ours = record.seen - base
    both = np.isfinite(ours) & np.isfinite(missed)
    count = np.maximum(both.sum(axis=0), 1)
    a, b = (np.where(both, x, 0.0) for x in (missed, ours))
    a, b = (np.where(both, x - x.sum(axis=0) / count, 0.0) for x in (a, b))
    unshared = 2.0 * np.sum(a * (a - b), axis=0) / count
    return np.asarray(np.sqrt(np.maximum(unshared, FLOOR**2)).reshape(-1, 3))
