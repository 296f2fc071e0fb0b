"""The error of a model on a running robot: now, over the last seconds, and since the start.

Servo positions arrive every period, frames when they are ready. The chain of effects advances by
the new periods only and keeps its memory. A frame waits for the positions at its time, and is then
compared with the shape at the effective commands. So the error equals that of the complete run.
Effective commands are kept for `KEPT` s; a shape with memory uses only these. Known limit: a
user-defined effect cannot be advanced; with one, all positions are kept and rolled out each time.
Pinned by tests/robot/test_live.py.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.comparison.comparison import aligned
from softmap_edge.errors import ComparisonError, RunError
from softmap_edge.files.atomic import Document
from softmap_edge.model.chain_labels import valued
from softmap_edge.model.effect_info import registry
from softmap_edge.model.model import Model
from softmap_edge.robot.link.frames import Frame, HostClock
from softmap_edge.run.run import Run

Floats = NDArray[np.float64]

SCHEMA = "softmap.live/1"
RECENT = 5.0  # s
NOW = 0.5  # s
KEPT = 60.0  # s for which effective commands are kept; later frames are dropped
# s of effective commands about a frame: a clock may be shifted by 0.5 s
AROUND = 1.0
# newest frames compared at once; a slow computer drops the others
FRESH = 64


@dataclass(frozen=True)
class LiveError:
    """Errors in mm now, over the last `RECENT` s and since the beginning.

    RMS over points; NaN where there was no frame.
    """

    seconds: float
    frames: int
    now_mm: float
    recent_mm: float
    whole_mm: float
    worst_mm: float
    left_out: int

    def to_dict(self) -> Document:
        """Return it as a document softmap.live/1."""
        plain = {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in vars(self).items()
        }
        return {"schema": SCHEMA, **plain, "recent_s": RECENT}

    def __str__(self) -> str:
        def mm(value: float) -> str:
            return f"{value:.2f} mm" if math.isfinite(value) else "  –   "

        return (
            f"{self.seconds:7.1f} s  now {mm(self.now_mm)}  last {RECENT:g} s "
            f"{mm(self.recent_mm)}  since the beginning {mm(self.whole_mm)}, {self.frames} frames"
        )


class Live:
    """Compares `model` with the running robot; `late` is the least latency of a frame, s.

    Raises:
        ComparisonError: the model has no servo calibration.
    """

    def __init__(self, model: Model, late: float = 0.0) -> None:
        if model.calibration is None:
            raise ComparisonError(
                "the bundle holds no calibration of the servos, so their ticks mean nothing to it; "
                "`softmap model calibrate`"
            )
        self._acts, self._shape = _advancing(model), _shape(model)
        remembering = {info.name for info in registry().values() if info.remembers}
        self._remembers = not remembering.isdisjoint(model.chain_names)
        self._model, self._clock = model, HostClock(late)
        shift = dict(model.params).get("clock_shift.late", 0.0)
        self._ahead = max(0.0, -shift)  # s by which positions must be ahead of a frame
        self._begun = math.nan  # host time of the first period, s; all other times count from it
        self._t, self._acting = np.zeros(0), np.zeros((0, model.channels))
        self._waiting: deque[Frame] = deque()
        self._first: float | None = None  # time of the first frame, s
        # time s, mean square mm², points; of the last RECENT s
        self._errors: deque[tuple[float, float, int]] = deque()
        self._square = 0.0
        self._points = 0
        self._worst = math.nan
        self._frames = 0
        self.left_out = 0

    def drove(self, periods: Iterable[Document]) -> None:
        """Add periods of a loop; ignore those in which a servo did not reply.

        Raises:
            RunError: the periods are of another robot, or damaged.
        """
        times: list[float] = []
        rows: list[list[float]] = []
        last = float(self._t[-1]) if len(self._t) else -math.inf
        for period in periods:
            try:
                now, position = period["now"] * 1e-9, period["position"]
                if None in position:
                    continue
                ticks = [float(tick) for tick in position]
            except (KeyError, TypeError, ValueError) as fault:
                raise RunError(f"a period of the recording is damaged ({fault!s:.60})") from None
            if len(ticks) != self._model.channels:
                raise RunError(
                    f"the recording is of {len(ticks)} servos, the model takes "
                    f"{self._model.channels} commands"
                )
            self._begun = now if math.isnan(self._begun) else self._begun
            if now - self._begun > last:
                last = now - self._begun
                times.append(last)
                rows.append(ticks)
        if times and self._model.calibration is not None:
            t, u = np.array(times), self._model.calibration.commands(np.rint(rows))
            kept = self._t > t[-1] - KEPT
            self._acting = np.concatenate([self._acting[kept], self._acts(u, t)])
            self._t = np.concatenate([self._t[kept], t])

    def saw(self, frames: Sequence[Frame]) -> None:
        """Add the frames that a camera keeps; frames added before count once."""
        self._waiting.extend(self._clock.add(frames))

    def compared(self) -> LiveError:
        """Compare all frames that are ready, and return the model's errors."""
        if self._waiting and len(self._t) > 1:
            taken = self._clock.times(self._waiting) - self._begun
            ready = int(np.searchsorted(taken, self._t[-1] - self._ahead))
            frames = [self._waiting.popleft() for _ in range(ready)]
            inside = [
                (float(t), frame) for t, frame in zip(taken[:ready], frames) if t > self._t[0]
            ][-FRESH:]
            self.left_out += ready - len(inside)
            self._compare(inside)
        end = float(self._t[-1]) if len(self._t) else 0.0
        while self._errors and self._errors[0][0] < end - RECENT:
            self._errors.popleft()
        return LiveError(
            seconds=end,
            frames=self._frames,
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
        seen_at = np.array([t for t, _ in inside])
        self._first = float(seen_at[0]) if self._first is None else self._first
        if not shown.any():
            return
        begin, end = np.searchsorted(self._t, [seen_at[0] - AROUND, seen_at[-1] + AROUND])
        near = slice(0 if self._remembers else max(int(begin) - 1, 0), int(end) + 1)
        # drift is counted from the first frame, so it is zero there
        if self._first < seen_at[0]:
            seen_at = np.concatenate([[self._first], seen_at])
            points = np.concatenate([np.zeros_like(points[:1]), points])
            shown = np.concatenate([np.zeros_like(shown[:1]), shown])
        vertices = not self._model.markers and points.shape[1] == len(self._model.rest)
        run = Run(
            t=self._t[near],
            command=self._acting[near],
            command_unit=self._model.command_unit,
            t_seen=seen_at,
            vertices=points if vertices else None,
            markers=None if vertices else points,
            visible=shown,
            robot=self._model.robot,
        )
        predicted, seen, visible = aligned(self._shape, run)
        squared = np.where(visible, np.sum((predicted - seen) ** 2, axis=2), 0.0).sum(axis=1)
        for at, square, count in zip(seen_at, squared, visible.sum(axis=1)):
            if count:
                self._frames += 1
                self._errors.append((float(at), float(square / count), int(count)))
                self._square, self._points = self._square + float(square), self._points + int(count)
                self._worst = max(
                    math.sqrt(square / count), 0.0 if math.isnan(self._worst) else self._worst
                )

    def _since(self, begin: float) -> float:
        total, points = 0.0, 0
        for t, square, count in reversed(self._errors):
            if t < begin:
                break
            total, points = total + square * count, points + count
        return math.sqrt(total / points) if points else math.nan


def _channel(name: str) -> bool:
    """Return whether an effect changes the commands, and may have memory."""
    return registry()[name].on_commands


def _shape(model: Model) -> Model:
    """Return the model for effective commands: without ticks or effects that change commands."""
    names = tuple(name for name in model.chain_names if not _channel(name))
    rest = _core.Chain(list(names), model.channels)
    params = valued(rest, model.params, rest.null)
    return replace(model, chain_names=names, chain_params=params, calibration=None)


def _advancing(model: Model) -> Callable[[Floats, Floats], Floats]:
    """Return a function from new commands (n, C) at (n,) s to effective ones (n, C).

    It takes all earlier commands into account.
    """
    chain, params = model.chain, model.chain_params[None]
    own = {info.name for info in registry().values() if info.own} & set(model.chain_names)
    state: Floats | None = None
    before_u, before_t = np.zeros((0, model.channels)), np.zeros(0)

    def gravity(t: Floats) -> Floats:
        return np.ascontiguousarray(np.broadcast_to(model.gravity_reference, (len(t), 3)))

    def advanced(u: Floats, t: Floats) -> Floats:
        nonlocal state
        acting, state = chain.advance(params, np.ascontiguousarray(u), t, gravity(t), state=state)
        return np.asarray(acting[0])

    def roll_out(u: Floats, t: Floats) -> Floats:
        nonlocal before_u, before_t
        before_u, before_t = np.concatenate([before_u, u]), np.concatenate([before_t, t])
        return np.asarray(
            chain.rollout(params, before_u, before_t, gravity(before_t))[0, -len(t) :]
        )

    if not model.chain_names:
        return lambda u, t: u
    return roll_out if own else advanced
