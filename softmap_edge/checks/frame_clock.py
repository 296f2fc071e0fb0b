"""Compare the clocks of frames and commands: find a rate error or a step from the motion alone.

    y(t) = W φ(t − d(t)) + e        d(t) = a,  a + b (t − t₀),  or  a + s [t ≥ t₁]

φ holds a polynomial of the commands, play and lag of several sizes, and gains and offsets that
change linearly with time. So memory and drift of the robot do not count as delay. Each block of
time has its own delay, fitted together with W: with M = 1 − φ(φᵀφ)⁻¹φᵀ and G the slopes of each
block, H δ = −Gᵀ M e, H = Gᵀ M G. Line and step are fitted to the blocks in the metric H. The
scatter of the blocks gives the uncertainty, so slow changes of the robot increase it. A change
that play and lag explain as well is not reported (`SEPARATE`), such as a step where the speed of
the moves changes. A rate error must also appear within halves of the run that have separate
delays, because memory that differs between parts of a protocol changes the delay between them.
b is the rate error: a clock that runs fast by 100 ppm stamps frames 100 µs later every second. The
constant a is latency, or one shift of the clock, and is not reported (`clock_shift`). A log that
stamps frames and commands in the same rows has one clock and is not examined. Units: s, mm.
Limits: 200 frames in 20 s, commands that explain half of the motion, a change of more than five
standard errors, one step. Pinned by tests/checks/test_frame_clock.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.files.atomic import Document
from softmap_edge.run.run import Run, known

Floats = NDArray[np.float64]

LEAST_FRAMES, LEAST_S = 200, 20.0
SEPARATE = 0.3  # of the information on a line or step that must remain after play and lag
FRAMES = 2000  # frames at most, evenly thinned
POINTS = 40  # points of the body at most, evenly thinned
ROWS = 3_000_000  # numbers in the columns of play and lag; longer runs are thinned
COMPONENTS = 4  # components of the motion of all points
FOLLOWS = 0.5  # of the variance that commands must explain
SURE = 5.0  # standard errors of a significant rate error
WITHIN = 3.0  # the same within halves of the run
STEP_SURE = 6.0  # standard errors of a significant step, whose time is searched for
STEP_OVER_LINE = 20.0  # block variances by which a step must fit better than a line
LEAST_CHANGE = 2e-3  # s over the run: smaller changes have no visible effect
DELAYS = np.arange(-0.5, 1.01, 0.04)  # s, trial delays
PLAYS, LAGS = (0.05, 0.15, 0.4), (0.3, 2.0, 10.0)  # of the range of a channel; s
BLOCK_FRAMES, MOST_BLOCKS, LEAST_BLOCKS = 25, 40, 8
MANY_CHANNELS = 3  # channels; with more, the polynomial is quadratic
ROUNDS = 3
NUDGE = 5e-3  # s, step of the numerical derivative
RARE = 3.0  # median deviations; frames with a larger error are down-weighted


@dataclass(frozen=True)
class FrameClock:
    """Rate error and step of the frames' clock against that of the commands.

    Attributes:
        fast_ppm, sigma_ppm: rate error (positive: fast) and its standard error; None if the moves
            do not identify it.
        step_s, step_sigma_s, at_s: size of a forward step, its standard error, and its time; None
            without a step.
        duration_s: time span of the frames.
    """

    fast_ppm: float | None
    sigma_ppm: float | None
    duration_s: float
    step_s: float | None = None
    step_sigma_s: float | None = None
    at_s: float | None = None

    @property
    def runs_fast(self) -> bool:
        """Return whether the rates differ significantly and by a visible amount."""
        if self.step_s is not None or self.fast_ppm is None or self.sigma_ppm is None:
            return False
        change = 1e-6 * abs(self.fast_ppm) * self.duration_s
        return abs(self.fast_ppm) > SURE * self.sigma_ppm and change > LEAST_CHANGE

    @property
    def differs(self) -> bool:
        """Return whether the clocks differ significantly."""
        return self.runs_fast or self.step_s is not None

    def __str__(self) -> str:
        if self.step_s is not None:
            return (
                f"the clock of the frames steps by {1e3 * self.step_s:+.1f} ± "
                f"{1e3 * (self.step_sigma_s or 0):.1f} ms against the commands at {self.at_s:.6g} "
                f"s: set seen.clock_step = [{self.at_s:.6g}, {self.step_s:.4f}] in the mapping, "
                "or cut the run there"
            )
        if self.fast_ppm is None or self.sigma_ppm is None:
            return "the moves of this run do not show how fast the clock of the frames runs"
        if not self.runs_fast:
            return (
                "the clocks of the frames and of the commands agree within "
                f"{abs(self.fast_ppm):.0f} ± {self.sigma_ppm:.0f} ppm; nothing is to be corrected"
            )
        late = 1e-6 * self.fast_ppm * self.duration_s
        way = "fast" if self.fast_ppm > 0 else "slow"
        return (
            f"the clock of the frames runs {abs(self.fast_ppm):.0f} ± {self.sigma_ppm:.0f} ppm "
            f"{way} against the commands ({abs(late):.3f} s over the run): set seen.fast_ppm = "
            f"{self.fast_ppm:.0f} in the mapping"
        )

    def to_dict(self) -> Document:
        """Return the estimate as plain numbers."""
        return {
            "fast_ppm": self.fast_ppm,
            "sigma_ppm": self.sigma_ppm,
            "step_s": self.step_s,
            "step_sigma_s": self.step_sigma_s,
            "at_s": self.at_s,
            "text": str(self) if self.differs else None,
        }


def frame_clock(run: Run) -> FrameClock | None:
    """Estimate rate error and step of the frames' clock against that of the commands.

    Args:
        run: a run with commands and points.

    Returns:
        FrameClock: the estimate; None if the run does not allow one.
    """
    with np.errstate(all="ignore"):  # a run may hold any numbers
        try:
            found = _found(run)
        except np.linalg.LinAlgError:
            return None
    numbers = (
        [] if found is None else [found.fast_ppm, found.sigma_ppm, found.step_s, found.step_sigma_s]
    )
    return found if all(number is None or np.isfinite(number) for number in numbers) else None


def _found(run: Run) -> FrameClock | None:
    motion = _motion(run)
    if motion is None:
        return None
    t, y = motion
    memory = _Memory(run)
    if len(t) < max(LEAST_FRAMES, 8 * memory.count):
        return None
    late = _constant(memory, t, y)
    if memory.errors(t - late, y).follows < FOLLOWS:
        return None
    delay = np.full(len(t), late)
    blocks = _Blocks(t)
    shape = _Line()
    for _ in range(ROUNDS):
        blocks.measure(memory, t, y, delay)
        shape = _best(blocks)
        delay = shape.at(t)
    blocks.measure(memory, t, y, delay)
    return _answer(_confirmed(_best(blocks), blocks), t, np.asarray(run.t_seen, float))


def _motion(run: Run) -> tuple[Floats, Floats] | None:
    """Return times (K,) s and components (K, P) mm of motion in frames with all chosen points."""
    seen = run.places
    given = run.command if run.command is not None else run.ticks
    if seen is None or given is None or run.timeless or run.channels == 0:
        return None
    if np.isin(run.t_seen, run.t).all():
        return None  # both have the same clock
    if run.frames < LEAST_FRAMES or len(run.t) < 3 or not np.ptp(given, axis=0).any():
        return None
    there = known(run, seen)
    often = there.mean(axis=0) > 0.9
    chosen = np.flatnonzero(often)
    often[
        np.delete(
            chosen, np.unique(np.linspace(0, len(chosen) - 1, min(len(chosen), POINTS)).astype(int))
        )
    ] = False
    rows = np.flatnonzero(there[:, often].all(axis=1)) if often.any() else np.zeros(0, int)
    rows = (
        rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), FRAMES)).astype(int))]
        if len(rows)
        else rows
    )
    t = np.asarray(run.t_seen, float)[rows]
    if len(rows) < LEAST_FRAMES or t[-1] - t[0] < LEAST_S:
        return None
    flat = np.asarray(seen[rows][:, often], float).reshape(len(rows), -1)
    flat = flat - flat.mean(axis=0)
    _, size, axes = np.linalg.svd(flat, full_matrices=False)
    keep = min(COMPONENTS, int((size > 0.02 * size[0]).sum()))
    return (t, flat @ axes[:keep].T) if size[0] > 0 else None


class _Memory:
    """The commands, with play and lag of several sizes, evaluated at any time."""

    def __init__(self, run: Run) -> None:
        given = run.command if run.command is not None else run.ticks
        assert given is not None
        self.t, u = np.asarray(run.t, float), np.asarray(given, float)
        span = np.ptp(u, axis=0)
        u = (u[:, span > 0] - u[:, span > 0].mean(axis=0)) / (0.5 * span[span > 0])
        thin = max(1, int(np.ceil(u.size * (1 + len(PLAYS) + len(LAGS)) / ROWS)))
        columns = [u[::thin]]
        for c in range(u.shape[1]):
            one = np.ascontiguousarray(u[:, c : c + 1])
            for name, sizes in (("backlash", 2.0 * np.array(PLAYS)), ("lag", np.array(LAGS))):
                made = _core.Chain([name], 1).rollout(
                    np.ascontiguousarray(sizes[:, None]), one, self.t
                )
                columns.append(np.asarray(made)[..., 0].T[::thin])
        self.channels, self.series, self.t = u.shape[1], np.hstack(columns), self.t[::thin]
        self.count = self.at(self.t[:1]).shape[1]

    def at(self, t: Floats) -> Floats:
        """Return the columns (K, F) at times (K,) s."""
        rows = np.stack([np.interp(t, self.t, column) for column in self.series.T], axis=1)
        u = rows[:, : self.channels]
        drift = (2 * (t - self.t[0]) / (self.t[-1] - self.t[0]) - 1)[:, None]
        products = [
            u[:, i] * u[:, j] for i in range(self.channels) for j in range(i, self.channels)
        ]
        if self.channels <= MANY_CHANNELS:
            products += [u[:, i] * p for i in range(self.channels) for p in list(products)]
        return np.column_stack([np.ones(len(rows)), rows, *products, drift, drift**2, drift * u])

    def errors(self, t: Floats, y: Floats) -> _Fitted:
        """Fit the columns at times (K,) s to y (K, P) mm."""
        columns = self.at(t)
        weight = np.ones((len(t), 1))
        for _ in range(2):  # down-weight frames with gross errors
            map_ = _ridge(columns * weight, y * weight)
            error = y - columns @ map_
            size = np.linalg.norm(error, axis=1)
            weight = np.minimum(1.0, RARE * np.median(size) / np.maximum(size, 1e-12))[:, None]
        slope = (self.at(t + NUDGE) - self.at(t - NUDGE)) @ map_ / (2 * NUDGE)
        return _Fitted(columns * weight, error * weight, slope * weight, y * weight)


@dataclass(frozen=True)
class _Fitted:
    """A map of columns (K, F) to the motion: weighted errors and slopes over time (K, P)."""

    columns: Floats
    error: Floats
    slope: Floats
    seen: Floats

    @property
    def follows(self) -> float:
        """The share of the variance that the map explains."""
        return 1.0 - float((self.error**2).sum()) / max(float((self.seen**2).sum()), 1e-300)


def _ridge(columns: Floats, y: Floats) -> Floats:
    gram = columns.T @ columns
    gram += 1e-6 * np.trace(gram) / len(gram) * np.eye(len(gram))
    return np.asarray(np.linalg.solve(gram, columns.T @ y))


def _constant(memory: _Memory, t: Floats, y: Floats) -> float:
    """Return the constant delay (s) that explains the most variance."""
    some = slice(None, None, max(1, len(t) // 600))
    return float(max(DELAYS, key=lambda late: memory.errors(t[some] - late, y[some]).follows))


@dataclass(frozen=True)
class _Estimate:
    """Fitted numbers, and the uncertainty of the last one."""

    value: Floats
    variance: float  # of the last number, for errors of unit variance
    sigma: float  # standard error of the last number, from the scatter of the blocks
    left: float  # sum of squared residuals


class _Blocks:
    """Delays of the blocks of time, with their information matrix H."""

    def __init__(self, t: Floats) -> None:
        self.count = int(np.clip(len(t) // BLOCK_FRAMES, LEAST_BLOCKS, MOST_BLOCKS))
        share = (t - t[0]) / (t[-1] - t[0])
        self.of: NDArray[np.int64] = np.minimum(
            (share * self.count).astype(np.int64), self.count - 1
        )
        self.t = np.bincount(self.of, t, self.count) / np.maximum(
            np.bincount(self.of, minlength=self.count), 1
        )
        self.weight: Floats = np.zeros((self.count, self.count))  # H
        self.alone: Floats = np.zeros(self.count)  # diagonal of H if the map were known
        self.pull = np.zeros(self.count)  # H δ
        self.inverse = self.weight

    def measure(self, memory: _Memory, t: Floats, y: Floats, delay: Floats) -> None:
        """Measure the delay of each block, linearised about an assumed delay (K,) s."""
        fitted = memory.errors(t - delay, y)
        q, _ = np.linalg.qr(fitted.columns)
        self.alone = np.asarray(
            np.bincount(self.of, (fitted.slope**2).sum(axis=1), self.count), float
        )
        self.weight = np.diag(self.alone)
        along = np.zeros(self.count)
        for slope, error in zip(fitted.slope.T, fitted.error.T):
            inner = np.stack(
                [np.bincount(self.of, column * slope, self.count) for column in q.T]
            )  # (F, B)
            self.weight -= inner.T @ inner
            along += np.bincount(self.of, slope * error, self.count)
        counts = np.maximum(np.bincount(self.of, minlength=self.count), 1)
        self.pull = self.weight @ (np.bincount(self.of, delay, self.count) / counts) - along
        self.inverse = np.asarray(np.linalg.pinv(self.weight, rcond=1e-6, hermitian=True), float)

    def fit(self, part: Floats, kind: str, pivot: float) -> _Line:
        """Fit a constant plus a multiple of `part` (B,) to the delays.

        The scatter of the delays gives the standard error.
        """
        ones = np.ones((self.count, 1))
        columns = ones if kind == "constant" else np.column_stack([ones, part])
        found = self._fitted(columns)
        known = np.linalg.pinv((columns * self.alone[:, None]).T @ columns, hermitian=True)[-1, -1]
        separate = known > SEPARATE * found.variance
        first, last = float(found.value[0]), float(found.value[-1])
        return _Line(
            kind,
            (first, last if kind != "constant" else 0.0),
            found.sigma if separate else np.inf,
            pivot,
            found.left,
        )

    def _fitted(self, columns: Floats) -> _Estimate:
        """Fit the coefficients of `columns` (B, n) to the delays."""
        inverse = np.linalg.pinv(columns.T @ self.weight @ columns, hermitian=True)
        value = inverse @ (columns.T @ self.pull)
        left = self.pull - self.weight @ (columns @ value)
        squares = max(float(left @ self.inverse @ left), 0.0)
        spread = squares / max(self.count - columns.shape[1] - 1, 1)
        last = float(inverse[-1, -1])
        return _Estimate(value, last, float(np.sqrt(max(spread * last, 0.0))), squares)

    def within_halves(self) -> tuple[float, float]:
        """Return the slope within halves of the run, each with its own constant, and its error.

        Memory that differs between parts of a protocol changes the delay between the halves. A
        clock with another rate changes it within them.
        """
        later = np.arange(self.count) >= self.count // 2
        part = self.t - np.where(later, self.t[later].mean(), self.t[~later].mean())
        found = self._fitted(np.column_stack([np.ones(self.count), later, part]))
        return float(found.value[-1]), found.sigma


@dataclass(frozen=True)
class _Line:
    """The delay over time: constant, a line, or a step."""

    kind: str = "constant"
    value: tuple[float, float] = (0.0, 0.0)  # the constant, and the slope or step
    sigma: float = 0.0  # of the slope or step
    pivot: float = 0.0  # s: where the line equals the constant, or the time of the step
    left: float = np.inf  # weighted sum of squares
    slope: float = 0.0  # of the line, also for a step
    slope_sigma: float = np.inf

    def at(self, t: Floats) -> Floats:
        """Return the delay (K,) s at times (K,) s."""
        constant, slope = self.value
        if self.kind == "line":
            return np.asarray(constant + slope * (t - self.pivot))
        if self.kind == "step":
            return np.asarray(constant + slope * (t >= self.pivot))
        return np.full(len(t), constant)


def _best(blocks: _Blocks) -> _Line:
    """Return the delay over time: a step or a line only if it is significant."""
    t = blocks.t
    middle = float(t.mean())
    flat, line = blocks.fit(t, "constant", 0.0), blocks.fit(t - middle, "line", middle)
    cuts = 0.5 * (t[2:-1] + t[1:-2])
    steps = [blocks.fit((t >= cut).astype(float), "step", float(cut)) for cut in cuts]
    step = min(
        (one for one in steps if np.isfinite(one.sigma)), key=lambda one: one.left, default=flat
    )
    clear = line.left - step.left > STEP_OVER_LINE * step.left / (blocks.count - 3)
    if (
        step.kind == "step"
        and clear
        and abs(step.value[1]) > max(STEP_SURE * step.sigma, LEAST_CHANGE)
    ):
        found = step
    else:
        found = line if abs(line.value[1]) > SURE * line.sigma else flat
    return replace(found, slope=line.value[1], slope_sigma=line.sigma)


def _confirmed(line: _Line, blocks: _Blocks) -> _Line:
    """Return the line, with the slope within halves where that does not confirm the rate."""
    slope, sigma = blocks.within_halves()
    if line.kind != "line" or np.sign(line.slope) * slope >= WITHIN * sigma:
        return line
    return replace(line, slope=slope, slope_sigma=sigma)


def _answer(shape: _Line, t: Floats, stamps: Floats) -> FrameClock:
    duration = float(t[-1] - t[0])
    known = np.isfinite(shape.slope_sigma)
    fast, sigma = (1e6 * shape.slope, 1e6 * shape.slope_sigma) if known else (None, None)
    if shape.kind != "step":
        return FrameClock(fast, sigma, duration)
    return FrameClock(fast, sigma, duration, shape.value[1], shape.sigma, _place(shape, stamps))


def _place(shape: _Line, t: Floats) -> float:
    """Return the time of the step: the gap in the time stamps nearest to the one from blocks."""
    apart = np.diff(t) - np.median(np.diff(t))
    near = np.abs(t[1:] - shape.pivot) < 2 * (t[-1] - t[0]) / LEAST_BLOCKS
    odd = np.where(near, np.sign(shape.value[1]) * apart, -np.inf)
    k = int(np.argmax(odd))
    return float(t[k + 1]) if odd[k] > 0.5 * abs(shape.value[1]) else shape.pivot
