"""A model's error while a robot runs: of the newest frames, over the last seconds, and since the beginning.

Positions of the servos come period by period, frames as they arrive; each frame is compared with what the model
predicts for it from all positions so far, so that memory is right. A frame waits until positions of its time are there.
Pinned by tests/test_live.py.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.camera.frames import Frame, host_times
from softmap_edge.diagnosis.comparison import aligned
from softmap_edge.errors import ComparisonError, RunError
from softmap_edge.model import Model
from softmap_edge.run import Run

Floats = NDArray[np.float64]

SCHEMA = "softmap.live/1"
RECENT = 5.0  # s
NOW = 0.5  # s
MOST = 200_000  # periods that are kept: half an hour at 100 Hz
FRESH = 64  # frames that are compared at a time, the newest: what a slow computer cannot follow is left out


@dataclass(frozen=True)
class Now:
    """Errors in mm (RMS over points; NaN where no frame was) now, over the last `RECENT` s and since the beginning."""

    seconds: float
    frames: int
    now_mm: float
    recent_mm: float
    whole_mm: float
    worst_mm: float
    left_out: int

    def to_dict(self) -> dict[str, Any]:
        """Return it as a document softmap.live/1."""
        told = {name: value for name, value in vars(self).items()}
        plain = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in told.items()}
        return {"schema": SCHEMA, **plain, "recent_s": RECENT}

    def __str__(self) -> str:
        def mm(value: float) -> str:
            return f"{value:.2f} mm" if math.isfinite(value) else "  –   "

        return (
            f"{self.seconds:7.1f} s  now {mm(self.now_mm)}  last {RECENT:g} s {mm(self.recent_mm)}  since the "
            f"beginning {mm(self.whole_mm)}, {self.frames} frames"
        )


class Live:
    """Compares `model` with what happens; `late` s is what the quickest frame takes.

    Raises:
        ComparisonError: the model has no calibration of the servos.
    """

    def __init__(self, model: Model, late: float = 0.0) -> None:
        if model.calibration is None:
            raise ComparisonError(
                "the bundle holds no calibration of the servos, so their ticks mean nothing to it; `softmap calibrate`"
            )
        self._model, self._late = model, late
        self._t: list[float] = []
        self._ticks: list[list[float]] = []
        self._stamps: list[tuple[float, float]] = []
        self._waiting: deque[Frame] = deque()
        self._errors: list[tuple[float, float, int]] = []  # s of the host, mean square mm², points
        self._square, self._points, self._worst, self.left_out = 0.0, 0, math.nan, 0

    def drove(self, periods: Iterable[dict[str, Any]]) -> None:
        """Take periods of a loop; those in which a servo was not heard count nothing.

        Raises:
            RunError: they are not of this robot, or damaged.
        """
        for period in periods:
            try:
                now, position = period["now"] * 1e-9, period["position"]
                if None in position or (self._t and now <= self._t[-1]):
                    continue
                ticks = [float(tick) for tick in position]
            except (KeyError, TypeError, ValueError) as fault:
                raise RunError(f"a period of the recording is damaged ({fault!s:.60})") from None
            if len(ticks) != self._model.channels:
                raise RunError(
                    f"the recording is of {len(ticks)} servos, the model takes {self._model.channels} commands"
                )
            self._t.append(now)
            self._ticks.append(ticks)
        if len(self._t) > MOST:  # what is older than that is forgotten by most effects as well
            del self._t[: -MOST // 2], self._ticks[: -MOST // 2]

    def saw(self, frames: Sequence[Frame]) -> None:
        """Take the frames that a camera keeps; those that were taken before count once."""
        newest = self._stamps[-1][0] if self._stamps else -math.inf
        for frame in frames:
            if frame.stamp > newest:
                self._stamps.append((frame.stamp, frame.arrived))
                self._waiting.append(frame)

    def compared(self) -> Now:
        """Compare what can be compared now, and return how far off the model is."""
        if self._waiting and len(self._t) > 1:
            known = np.array(self._stamps)
            taken = host_times(known[:, 0], known[:, 1], self._late)[-len(self._waiting) :]
            ready = int(np.searchsorted(taken, self._t[-1]))
            frames = [self._waiting.popleft() for _ in range(ready)]
            inside = [(t, frame) for t, frame in zip(taken[:ready], frames) if t > self._t[0]][-FRESH:]
            self.left_out += ready - len(inside)
            self._compare(inside)
        end = self._t[-1] if self._t else 0.0
        return Now(
            seconds=end - self._t[0] if self._t else 0.0,
            frames=len(self._errors),
            now_mm=self._since(end - NOW),
            recent_mm=self._since(end - RECENT),
            whole_mm=math.sqrt(self._square / self._points) if self._points else math.nan,
            worst_mm=self._worst,
            left_out=self.left_out,
        )

    def _compare(self, inside: list[tuple[float, Frame]]) -> None:
        if not inside:
            return
        points = np.array([frame.points for _, frame in inside], float)
        shown = np.isfinite(points).all(axis=2)
        if not shown.any():
            return
        ticks = np.rint(np.array(self._ticks)).astype(np.int64)
        vertices = not self._model.markers and points.shape[1] == len(self._model.rest)
        run = Run(
            t=np.array(self._t) - self._t[0],
            ticks=ticks,
            present_ticks=ticks,
            t_seen=np.array([t for t, _ in inside]) - self._t[0],
            vertices=points if vertices else None,
            markers=None if vertices else points,
            visible=shown,
            robot=self._model.robot,
        )
        predicted, seen, visible = aligned(self._model, run)
        squared = np.where(visible, np.sum((predicted - seen) ** 2, axis=2), 0.0).sum(axis=1)
        for (t, _), square, count in zip(inside, squared, visible.sum(axis=1)):
            if count:
                self._errors.append((t, float(square / count), int(count)))
                self._square, self._points = self._square + float(square), self._points + int(count)
                self._worst = max(math.sqrt(square / count), 0.0 if math.isnan(self._worst) else self._worst)

    def _since(self, begin: float) -> float:
        total, points = 0.0, 0
        for t, square, count in reversed(self._errors):
            if t < begin:
                break
            total, points = total + square * count, points + count
        return math.sqrt(total / points) if points else math.nan
