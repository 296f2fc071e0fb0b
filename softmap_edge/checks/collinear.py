"""Find tied channels, and conditions that cannot be separated from time or from the commands.

    time:      R² of a condition on (1, t), on (1, t, t²) if monotonic, on one exponential or on
               one step
    commands:  R² of a condition on a polynomial of the commands

Both R² are adjusted for the number of columns. From CONFUSED on, the run cannot separate the two.
A condition that returns, such as a temperature that rises and falls, is not tested against a
parabola in time, because drift is monotonic. Tied channels are the null space of the standardised
commands, split into groups that share a null vector. Units: °C, g, V, s. Limit: a condition that
depends on earlier commands (motor heating) is not tested. Pinned by
tests/checks/test_collinear.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from softmap_edge.noise.floor import commanded
from softmap_edge.run.conditions import TURNED
from softmap_edge.run.run import Run

Floats = NDArray[np.float64]

CONFUSED = 0.95  # R² from which this run cannot separate two influences
TAUS = (0.1, 0.3, 1.0)  # of the duration: time constants of the trial exponentials
STEPS = 60  # instants at which a step is tried
# degree of the polynomial in the commands; with more channels than MANY it is 2
DEGREE, MANY = 3, 3
# °C, g, V, g: smaller changes are ignored
LEAST = {"temperature": 0.5, "load": 0.5, "voltage": 0.1, "orientation": TURNED}
REMEDY = {
    "temperature": {
        "time": "warm up and cool down",
        "commands": "repeat the same moves at another temperature",
    },
    "orientation": {
        "time": "return to the first orientation and repeat",
        "commands": "repeat the same moves in each orientation",
    },
    "load": {
        "time": "take the load off again and repeat",
        "commands": "repeat the same moves with each load",
    },
    "voltage": {
        "time": "return to the first voltage and repeat",
        "commands": "repeat the same moves at each voltage",
    },
}
# of the largest singular value of the standardised commands: a direction below it never moves
TIED = 0.05
PART = 0.05  # of a null vector: a channel with a smaller weight is not part of it
NOTHING = 0.02  # of a channel's standard deviation: a smaller sum counts as zero
EQUAL = 0.05  # weights that differ less are equal


@dataclass(frozen=True)
class Collinear:
    """A declared `condition` that this run cannot separate from time or the commands (`with_`).

    `like` is the law of `with_` that the condition follows: "a line", "an exponential", "one step"
    or "a polynomial".
    """

    condition: str
    with_: str
    r2: float
    like: str

    @property
    def remedy(self) -> str:
        """Return what to record to separate the two."""
        return REMEDY[self.condition][self.with_]

    def __str__(self) -> str:
        other = "the commands" if self.with_ == "commands" else self.with_
        return (
            f"{self.condition} and {other} cannot be distinguished in this run: {self.condition} "
            f"follows {self.like} of {other} (R² {self.r2:.2f}); {self.remedy}"
        )


@dataclass(frozen=True)
class TiedChannels:
    """Channels that move in fewer directions than their number, so their effects are inseparable.

    If exactly one weighted sum of them is constant, `weights` are its weights, the largest being 1;
    else empty. `total` is the value of that sum, in the unit of the commands.
    """

    channels: tuple[int, ...]
    moving: int
    weights: tuple[float, ...] = ()
    total: float = 0.0

    @property
    def remedy(self) -> str:
        """Return what to record, or what to expect."""
        named = ", ".join(map(str, self.channels))
        return (
            f"move channels {named} each alone, or expect only their differences to be identified"
        )

    def __str__(self) -> str:
        named = ", ".join(map(str, self.channels))
        directions = f"({self.moving} of {len(self.channels)} directions move)"
        w = np.array(self.weights)
        if len(w) == 0:
            return f"channels {named} depend on one another {directions}"
        if np.all(np.abs(w - 1.0) < EQUAL):
            return f"channels {named} add up to {self.total:.3g} {directions}"
        if len(w) == 2:
            ratio = -w[1] / w[0]
            how = (
                "move together"
                if abs(ratio - 1.0) < EQUAL
                else f"move in proportion, 1 to {1.0 / ratio:.3g}"
            )
            return f"channels {named} {how} {directions}"
        terms = " ".join(f"{x:+.2g}·u{c}" for c, x in zip(self.channels, w)).replace("-", "−")
        return f"channels {named} are tied, {terms} is {self.total:.3g} {directions}"


def collinear_conditions(run: Run) -> list[Collinear]:
    """Return declared conditions of a run that cannot be separated from time or from the commands.

    Args:
        run: any run; only its seen frames count.

    Returns:
        list: one entry for each pair, time first; empty if every condition is constant or varies
        independently.
    """
    if run.frames < 8:
        return []
    found = []
    commands = _polynomial(_at_frames(run, commanded(run)))
    for name, values in _conditions(run):
        time = max(_time_fits(np.asarray(run.t_seen), values), key=lambda fit: fit[0])
        if time[0] >= CONFUSED:
            found.append(Collinear(name, "time", time[0], time[1]))
        if commands.shape[1] > 1 and (r2 := _r2(commands, values)) >= CONFUSED:
            found.append(Collinear(name, "commands", r2, "a polynomial"))
    return found


def tied_channels(command: Floats) -> list[TiedChannels]:
    """Return the groups of channels that move in too few directions, from commands (T, C)."""
    spread = command.std(axis=0) if len(command) else np.zeros(command.shape[1])
    alive = np.flatnonzero(spread > 1e-9 * max(float(spread.max(initial=0.0)), 1e-300))
    if len(alive) < 2:
        return []
    scaled = (command[:, alive] - command[:, alive].mean(axis=0)) / spread[alive]
    _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
    null = directions[singular < TIED * singular[0]]  # (n, C)
    return [
        _tie(alive[group], null[:, group], command[:, alive[group]])
        for group in _groups(null.T @ null)
    ]


def _tie(channels: NDArray[np.intp], null: Floats, command: Floats) -> TiedChannels:
    """Return a group of channels from its null vectors (n, m).

    The vectors belong to the standardised commands `command` (T, m).
    """
    _, singular, vectors = np.linalg.svd(null, full_matrices=False)
    dimension = int((singular > 0.5).sum())
    named = tuple(int(c) for c in channels)
    if dimension != 1:
        return TiedChannels(named, len(named) - dimension)
    weights = vectors[0] / command.std(axis=0)
    weights = weights / weights[int(np.argmax(np.abs(weights)))]
    total = float((command @ weights).mean())
    zero = abs(total) < NOTHING * float(np.abs(weights * command.std(axis=0)).max())
    return TiedChannels(
        named, len(named) - 1, tuple(float(x) for x in weights), 0.0 if zero else total
    )


def _groups(projector: Floats) -> list[NDArray[np.intp]]:
    """Return connected groups of two or more channels in the null space's projector (C, C)."""
    joined = np.abs(projector) > PART
    left, found = set(np.flatnonzero(np.diag(projector) > PART).tolist()), []
    while left:
        group, ahead = set[int](), {min(left)}
        while ahead:
            one = ahead.pop()
            group.add(one)
            ahead |= {int(c) for c in np.flatnonzero(joined[one]) if int(c) in left} - group
        left -= group
        if len(group) > 1:
            found.append(np.array(sorted(group), np.intp))
    return found


# --- conditions -----------------------------------------------------------------------------------


def _at_frames(run: Run, rows: Floats) -> Floats:
    """Return rows (T, n) interpolated to the seen frames, (K, n)."""
    return (
        np.stack([np.interp(run.t_seen, run.t, c) for c in rows.T], axis=1)
        if rows.shape[1]
        else rows[: run.frames]
    )


def _conditions(run: Run) -> Iterator[tuple[str, Floats]]:
    """Yield name and values (K, n) at the seen frames of each declared condition that changes."""
    given: dict[str, NDArray[np.generic] | None] = {
        "temperature": run.temperature,
        "orientation": run.gravity,
        "load": run.load,
        "voltage": run.extra.get("voltage"),
    }
    for name, raw in given.items():
        if raw is None or raw.dtype.kind not in "fiu" or raw.shape[:1] != run.t.shape:
            continue
        rows = np.asarray(raw, float).reshape(len(run.t), -1)
        values = _at_frames(
            run, rows if name == "orientation" else rows.mean(axis=1, keepdims=True)
        )
        if np.isfinite(values).all() and float(np.ptp(values, axis=0).max()) >= LEAST[name]:
            yield name, values


def _time_fits(t: Floats, values: Floats) -> Iterator[tuple[float, str]]:
    """Yield R² and the name of each law of time for a condition (K, n)."""
    s = (t - t[0]) / max(float(t[-1] - t[0]), 1e-12)
    one = np.ones_like(s)
    yield _r2(np.stack([one, s], axis=1), values), "a line"
    parabola = np.stack([one, s, s * s], axis=1)
    weights = np.linalg.lstsq(parabola, values, rcond=None)[0]
    slopes = weights[1] + np.array([[0.0], [2.0]]) * weights[2]  # at both ends
    if np.all(slopes[0] * slopes[1] >= 0.0):
        yield _r2(parabola, values), "a parabola"
    for tau in TAUS:
        yield _r2(np.stack([one, np.exp(-s / tau)], axis=1), values), "an exponential"
    for at in np.unique(np.linspace(0, len(s), STEPS + 2).astype(int)[1:-1]):
        yield _r2(np.stack([one, np.arange(len(s)) >= at], axis=1), values), "one step"


def _polynomial(command: Floats) -> Floats:
    """Return the monomials (K, m) of commands (K, C), constant first, of degree 3 (2 if many)."""
    span = np.ptp(command, axis=0) if len(command) else np.zeros(command.shape[1])
    x = (
        (command - command.mean(axis=0))[:, span > 0] / np.maximum(span[span > 0], 1e-12)
        if len(command)
        else command
    )
    channels, one = x.shape[1], np.ones((len(command), 1))
    if channels > MANY:
        return np.concatenate([one, x, x**2], axis=1)
    sets = [
        c for n in range(1, DEGREE + 1) for c in combinations_with_replacement(range(channels), n)
    ]
    return np.concatenate(
        [one, *(np.prod(x[:, list(c)], axis=1, keepdims=True) for c in sets)], axis=1
    )


def _r2(columns: Floats, values: Floats) -> float:
    """Return the adjusted share of the variance of values (K, n) that columns (K, m) explain."""
    freedom = len(columns) - columns.shape[1]
    if freedom < 1:
        return 0.0
    left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    total = float(np.sum((values - values.mean(axis=0)) ** 2))
    if total <= 0.0:
        return 0.0
    return float(1.0 - np.sum(left**2) / freedom * (len(columns) - 1) / total)
