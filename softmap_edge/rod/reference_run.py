"""What of a reference run a rod is learned from: its frames, thinned and checked, and the commands behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import RunError
from softmap_edge.folds import Folds
from softmap_edge.rod.regression import Drive, rms
from softmap_edge.run import Run, Source, known

Floats = NDArray[np.float64]

SLOW = 0.25  # s between frames from which a log tells nothing of delay and lag
STILL = 0.005  # of the robot's length: markers that stray less from their mean teach nothing


class Rod(Protocol):
    """The numbers of a rod of any kind: what makes a model of it, and what a bundle keeps."""

    def compiled(self) -> _core.Shape:
        """Return the compiled rod."""

    def fields(self) -> Mapping[str, _core.Shape]:
        """Return its load fields by name."""

    def to_arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return the arrays of `prior.npz`."""


@dataclass(frozen=True)
class Number:
    """A fitted number: `value` ± `sigma` (one standard deviation) in `unit`; `note` says why it is not told, if so."""

    label: str
    value: float
    sigma: float
    unit: str
    at_bound: bool
    note: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return it as documents have it, to six digits."""
        return asdict(self) | {"value": float(f"{self.value:.6g}"), "sigma": float(f"{self.sigma:.3g}")}

    def __str__(self) -> str:
        text = f"{self.label:<14} {self.value:9.3f} ± {self.sigma:<8.3g} {self.unit:<6}"
        return " ".join([text, "at its bound" if self.at_bound else "", self.note]).rstrip()


@dataclass(frozen=True, eq=False)
class Seen:
    """What of a run is learned from: frames (n,), their markers (n, K, 3) mm, and the commands behind them."""

    run: Run
    source: Source
    frames: NDArray[np.intp]
    markers: Floats
    drive: Drive

    @property
    def t(self) -> Floats:
        """Times (n,) s of the frames."""
        return self.run.t_seen[self.frames]

    @property
    def slow(self) -> bool:
        """Whether nothing is known of delay and lag: the log has no time, or its frames are too far apart."""
        return self.run.timeless or len(self.frames) < 2 or float(np.median(np.diff(self.t))) > SLOW

    @property
    def stray(self) -> float:
        """RMS distance of the markers from their mean, mm."""
        return rms(self.markers - self.markers.mean(axis=0))


@dataclass(frozen=True, eq=False)
class Fitted:
    """A rod, its drive (delay and lag, s), its held-out residuals (n, K, 3) mm and the folds that gave them."""

    rod: Rod
    pair: tuple[float, float]
    residuals: Floats
    parts: Folds
    made_from: Mapping[str, Any]
    numbers: tuple[Number, ...] = ()


def observe(run: Run, input: Source | None, hold_out: Sequence[tuple[float, float]], rate_hz: float) -> Seen:
    """Return the frames to learn from; raise RunError where the run lacks markers, commands or motion."""
    source: Source = input or ("goal" if run.present is None else "present")
    commands, t = np.ascontiguousarray(run.commands(source)), np.ascontiguousarray(run.t)
    if run.markers is None or commands.shape[1] == 0 or len(t) < 2:
        raise RunError("a rod is learned from markers and at least two rows of commands; this run lacks one of them")
    if not np.ptp(commands, axis=0).any():
        raise RunError(
            f"nothing moves: each of the {commands.shape[1]} commands stays as it is in all {len(t)} rows (the first "
            f"at {commands[0, 0]:g} {run.command_unit}); record a run that goes through the robot's range"
        )
    frames = _usable(run, hold_out, rate_hz)
    markers = np.asarray(run.markers[frames], float)
    if len(frames):
        stray, length = rms(markers - markers.mean(axis=0)), float(np.linalg.norm(markers[:, -1].mean(axis=0)))
        if stray < STILL * length:
            raise RunError(
                f"the robot hardly moves: its markers stray {stray:.3g} mm from their mean (RMS), the last one is "
                f"{length:.3g} mm from the base, and under {100 * STILL:g} % of that a model learns noise; record a "
                "run that goes through the robot's range, or correct the markers' unit"
            )
    return Seen(run, source, frames, markers, Drive(commands, t, run.t_seen[frames]))


def _usable(run: Run, hold_out: Sequence[tuple[float, float]], rate_hz: float) -> NDArray[np.intp]:
    assert run.markers is not None
    keep = known(run, run.markers).all(axis=1)
    for low, high in hold_out:
        keep &= (run.t_seen < low) | (run.t_seen >= high)
    slot = np.floor((run.t_seen - run.t_seen[:1]) * rate_hz + 1e-6)
    index = np.flatnonzero(keep)
    if len(index):
        index = index[np.concatenate([[True], np.diff(slot[index]) > 0])]
    return index
