"""Level 1 of a diagnosis: the families of effects, and their columns about a state.

A family is a bank of columns X = (∂f/∂v_c) · b(t) about the effective command v(t). Fields of the
body are columns as well. `representatives.py` fits them. The columns, the families and the normal
equations are compiled (`rust/families/`). Pinned by tests/diagnosis/test_two_levels.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.diagnosis.fit import Fit, Problem
from softmap_edge.diagnosis.record import SLOPE, Record
from softmap_edge.model.effect_info import registry

Floats = NDArray[np.float64]
Commands = list[Floats]  # effective commands (T, C) of each run

TURNED = 2  # decimals of the direction of gravity: nearer ones are one orientation
WARMED = 0.5  # least warming of a run, K
REACH = 0.15  # of a parameter's range: where the signature of a field is evaluated
FAR = 0.5  # the same for an effect on commands, whose form changes with its size
PLACES = (0.2, 0.5, 0.8)  # of the range of a location parameter: where signatures are evaluated
AT_BOUND = 1e-6  # of the scale of a parameter
FREE_MM = 0.9  # effect size of one such column, mm RMS
MAPPED = ("static map", "coupling")  # families whose columns span a learned static map


CURVES: dict[str, Callable[[Floats], Floats]] = {  # of a channel
    "u": lambda x: x,
    "u²": np.square,
    "|u|": np.abs,
    "u|u|": lambda x: x * np.abs(x),
    "u³": lambda x: x**3,
}
PRODUCTS: dict[str, Callable[[Floats, Floats], Floats]] = {  # of a channel and of another one
    "v²": lambda x, y: y**2,
    "uv": lambda x, y: x * y,
    "v³": lambda x, y: y**3,
    "u²v": lambda x, y: x**2 * y,
    "uv²": lambda x, y: x * y**2,
}


@dataclass(frozen=True)
class Family:
    """A family of effects as the registry declares it."""

    name: str
    kind: str  # its input: "static", "memory", "time" or "condition"
    members: tuple[str, ...]  # candidates for its law
    fields: tuple[str, ...] = ()  # effects whose signatures are among its columns
    modes: int = 0  # free shapes among its columns
    # experiment that separates it from similar families, and the minutes
    experiment: tuple[str, float] = ("", 0.0)


@cache
def families() -> tuple[Family, ...]:
    """Return the families of the registry, in its order."""
    return tuple(
        Family(
            row["name"],
            row["kind"],
            tuple(row["members"]),
            tuple(row["fields"]),
            row["modes"],
            tuple(row["experiment"]),
        )
        for row in _core.families()
    )


@cache
def _homes() -> dict[str, Family]:
    return {effect: family for family in reversed(families()) for effect in family.members}


def home(effect: str) -> Family | None:
    """Return the first family that an effect may be a law of.

    None for a gross fault and for a user's own effect.
    """
    return _homes().get(effect)


@dataclass(frozen=True, eq=False)
class Columns:
    """The columns of a family about a state: column j is base[which_j] · weight_j.

    The first `commanded` of them act on commands.
    """

    base: Floats  # (s, K, F) mm
    which: NDArray[np.intp]  # (n,)
    weight: Floats  # (n, K)
    commanded: int

    def with_slopes(self, slopes: Floats) -> Columns:
        """Return the columns for other slopes over the commands, (C, K, F)."""
        return replace(self, base=np.concatenate([slopes, self.base[len(slopes) :]]))

    def shift(self, theta: Floats, first: int = 0) -> Floats:
        """Return the change of features (K, F) mm by columns from `first` on.

        Their coefficients are `theta` (n,).
        """
        out = np.zeros(self.base.shape[1:])
        for which, weight, value in zip(self.which[first:], self.weight[first:], theta[first:]):
            out += self.base[which] * (value * weight)[:, None]
        return out


class FeatureBody:
    """Data of level 1: the map from effective commands to features, and each family's columns."""

    def __init__(self, problem: Problem, candidates: Sequence[str]) -> None:
        self.problem, self.record, self.candidates = problem, problem.record, set(candidates)
        self.parts: list[Record] = list(self.record.parts)
        every = np.concatenate([part.u for part in self.parts])
        low, high = every.min(axis=0), every.max(axis=0)
        self.middle, self.half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-6)
        self.step = np.maximum(SLOPE * self.record.spread, 1e-3)
        self.weights = np.ascontiguousarray(problem.gain * problem.whitener.project.T)
        # user-defined effects, of any family
        self.own = [info.name for info in registry().values() if info.own]
        # ordinary static imperfections of the robot without the effects found, RMS
        self.ordinary_mm = 0.0
        self.free_map = isinstance(self.record.model.prior, _core.Rod)  # learned from logs
        self.learned = [f for f in families() if f.name in MAPPED and self.record.remapped]
        self._signatures: dict[str, Floats] = {}

    # --- commands and features ------------------------------------------------------------------

    def effective(self, fit: Fit) -> Commands:
        """Return the effective commands of a fit at full rate."""
        names, params = fit.space.names, fit.space.params(fit.x[None])[0]
        out = []
        for part, column in zip(self.parts, self.record.layout(names).columns):
            chain, run = _core.Chain(list(names), part.u.shape[1]), part.run
            own = np.ascontiguousarray(params[column][: len(chain.labels)])
            t = np.asarray(run.t, float)
            rows = chain.rollout(
                own[None],
                np.ascontiguousarray(part.u),
                t,
                gravity=declared(run.gravity, len(t), 3),
                load=declared(run.load, len(t)),
                temperature=declared(run.temperature, len(t)),
            )
            out.append(np.ascontiguousarray(rows[0]))
        return out

    def features(self, commands: Commands) -> Floats:
        """Return the features (K, F) mm of the prior at effective commands."""
        rows = [
            p.model.features_at(seen_commands(p, v), p.run).reshape(p.frames, -1)
            for p, v in zip(self.parts, commands)
        ]
        return np.concatenate(rows)

    def slopes(self, commands: Commands) -> Floats:
        """Return the slopes (C, K, F) of the features over effective commands."""
        rows = [
            p.model.slopes_at(seen_commands(p, v), self.step, p.run)
            for p, v in zip(self.parts, commands)
        ]
        return np.concatenate(
            [row.reshape(len(self.half), *p.seen.shape) for row, p in zip(rows, self.parts)], axis=1
        )

    def modes(self, difference: Floats) -> Floats:
        """Return feature differences (..., K, F) as modes (..., K, M); 0 if unseen or unknown."""
        known = np.isfinite(self.record.seen) & np.isfinite(difference)
        return np.asarray(np.where(known, difference, 0.0) @ self.weights)

    # --- columns --------------------------------------------------------------------------------

    def series(self, commands: Commands) -> list[_core.Series]:
        """Return effective commands with the conditions of their runs, as banks take them."""
        every, orientations = self._orientations
        rows, free = zip(self.parts, commands, self._temperatures, orientations), self.free_map
        return [
            _core.Series(
                v,
                np.asarray(part.run.t, float),
                self.middle,
                self.half,
                warm,
                orientation,
                every,
                free,
            )
            for part, v, warm, orientation in rows
        ]

    @cached_property
    def _temperatures(self) -> list[Floats | None]:
        """Temperature (T,) °C of each run; None where not all of them warm.

        A bank scales the range of one run.
        """
        rows = [declared(part.run.temperature, len(part.run.t)) for part in self.parts]
        known = [row for row in rows if row is not None and np.ptp(row) >= WARMED]
        return list(known) if len(known) == len(rows) else [None] * len(rows)

    @cached_property
    def _orientations(self) -> tuple[NDArray[np.int64] | None, list[NDArray[np.int64] | None]]:
        """Codes of all orientations, and the orientation of each sample (T,) of a run.

        None if there is only one.
        """
        rows = [declared(part.run.gravity, len(part.run.t), 3) for part in self.parts]
        known = [np.round(row, TURNED) for row in rows if row is not None]
        if len(known) < len(rows):
            return None, [None] * len(rows)
        every, codes = np.unique(np.concatenate(known), axis=0, return_inverse=True)
        if len(every) < 2:
            return None, [None] * len(rows)
        ends = np.cumsum([len(row) for row in known])
        return np.arange(len(every)), list(np.split(codes.reshape(-1).astype(np.int64), ends[:-1]))

    def columns(self, family: Family, commands: Commands, slopes: Floats) -> Columns | None:
        """Return a family's columns at effective commands with `slopes` (C, K, F), if any."""
        bank = _core.Bank(family.name, len(self.half))
        series = self.series(commands)
        found = [
            bank.columns(one, np.asarray(part.t_seen, float))
            for one, part in zip(series, self.parts)
        ]
        # one of the runs does not declare the required field
        if len({len(which) for which, _ in found}) > 1:
            found = [(which[:0], weight[:0]) for which, weight in found]
        which, weight = (
            np.asarray(found[0][0], np.intp),
            np.concatenate([w for _, w in found], axis=1),
        )
        fields = self._fields(family)
        if len(fields):
            times = [np.asarray(part.t_seen, float) for part in self.parts]
            modulation = np.concatenate(
                [bank.modulation(one, at) for one, at in zip(series, times)], axis=1
            )
            extra = len(slopes) + np.repeat(np.arange(len(fields)), len(modulation))
            commanded, which = len(which), np.concatenate([which, extra])
            weight = np.concatenate([weight, np.tile(modulation, (len(fields), 1))])
            return Columns(np.concatenate([slopes, fields]), which, weight, commanded)
        return Columns(slopes, which, weight, len(which)) if len(which) else None

    def _fields(self, family: Family) -> Floats:
        """Return the fields (s, K, F) mm of a family: signatures of its effects, or free shapes."""
        if family.name not in self._signatures:
            singles = [self.single(name) for name in family.fields if name in self.candidates]
            rows = [field for own in singles if own is not None for field in own.base]
            rows += self._free_shapes(family.modes) if family.modes else []
            self._signatures[family.name] = (
                np.stack(rows) if rows else np.zeros((0, *self.record.seen.shape))
            )
        return self._signatures[family.name]

    def single(self, effect: str) -> Columns | None:
        """Return the signature of each parameter of an effect as columns;

        None if all are zero here.
        """
        if effect not in self._signatures:
            found = self._signature(effect)
            self._signatures[effect] = (
                np.stack(found) if found else np.zeros((0, *self.record.seen.shape))
            )
        rows = self._signatures[effect]
        if not len(rows):
            return None
        return Columns(rows, np.arange(len(rows)), np.ones((len(rows), len(self.record))), 0)

    def curves(self, commands: Commands, slopes: Floats) -> dict[str, Columns]:
        """Return smooth static maps of one form as columns.

        Each is a curve of a channel, or a coupling from one channel to another.
        """
        seen = np.concatenate([seen_commands(p, v) for p, v in zip(self.parts, commands)])
        x, channels = (seen - self.middle) / self.half, len(self.half)
        found = {}
        for name in [name for name in CURVES if name != "u"]:
            found[name] = Columns(
                slopes, np.arange(channels), (self.half * CURVES[name](x)).T.copy(), channels
            )
        for name, product in PRODUCTS.items() if channels > 1 else ():
            pairs = [(c, k) for c in range(channels) for k in range(channels) if k != c]
            weight = np.stack([self.half[c] * product(x[:, c], x[:, k]) for c, k in pairs])
            found[name] = Columns(slopes, np.array([c for c, _ in pairs]), weight, len(pairs))
        return found

    def _free_shapes(self, count: int) -> list[Floats]:
        """Return the leading spatial modes of the candidates' signatures, as constant shapes."""
        shapes = np.linalg.pinv(self.weights)[:count]
        size = [self.record.rms_mm(np.tile(s, (len(self.record), 1))) for s in shapes]
        return [
            np.tile(FREE_MM * s / max(mm, 1e-9), (len(self.record), 1))
            for s, mm in zip(shapes, size)
        ]

    def _signature(self, name: str) -> list[Floats]:
        """Return the signature (K, F) mm of each amount of an effect.

        If it has a location, use several values of it.
        """
        record = self.record
        own = tuple(record.model.chain_names)
        layout = record.layout((*own, name))
        known = record.own_values()
        null = np.array([known.get(label, n) for label, n in zip(layout.labels, layout.null)])
        mine = [i for i, label in enumerate(layout.labels) if label.split(".")[0] == name]
        base = record.predict(layout.names, null[None])[0]

        def moved(i: int, at: Floats, reach: float = REACH) -> Floats:
            row = at.copy()
            far = layout.high[i] if abs(layout.high[i] - null[i]) > 1e-12 else layout.low[i]
            row[i] = null[i] + reach * (far - null[i])
            return np.asarray(record.predict(layout.names, row[None])[0] - base)

        alone = {i: moved(i, null) for i in mine}
        channel = registry()[name].on_commands
        amounts = [i for i in mine if np.abs(alone[i]).max() > 1e-9]
        places = [i for i in mine if i not in amounts]
        rows = []
        for i in amounts:
            rows += [alone[i], *([moved(i, null, FAR)] if channel else [])] if not places else []
            for place in places[:1]:
                for share in PLACES:
                    at = null.copy()
                    at[place] = layout.low[place] + share * (layout.high[place] - layout.low[place])
                    rows.append(moved(i, at))
        return rows

    # --- normal equations -----------------------------------------------------------------------

    def level(self) -> _core.Level:
        """Return empty normal equations on the folds of the problem."""
        return self._level.fresh()

    @cached_property
    def _level(self) -> _core.Level:
        problem, whitener = self.problem, self.problem.whitener
        folds = [
            (train, test, a.basis, a.strength, b.basis, b.strength)
            for (train, test), (a, b) in zip(problem.folds, problem.fold_kernels)
        ]
        return _core.Level(whitener.form, (whitener.kernel.basis, whitener.kernel.strength), folds)

    def add(self, level: _core.Level, name: str, columns: Columns) -> None:
        """Add columns to normal equations."""
        used = np.unique(columns.which)
        place = np.searchsorted(used, columns.which)
        level.add(
            name,
            np.ascontiguousarray(self.modes(columns.base[used])),
            place,
            np.ascontiguousarray(columns.weight),
        )

    def add_fit(self, level: _core.Level, name: str, fit: Fit) -> bool:
        """Add slopes of a fit over parameters not at a bound; return whether there are any."""
        free = np.flatnonzero(np.minimum(fit.x - fit.space.low, fit.space.high - fit.x) > AT_BOUND)
        if len(free):
            ones = np.ones((len(free), len(self.record)))
            level.add(name, np.ascontiguousarray(-fit.slopes[free]), np.arange(len(free)), ones)
        return bool(len(free))


def seen_commands(part: Record, commands: Floats) -> Floats:
    """Return effective commands (T, C) at the frame times, (K, C)."""
    t = np.asarray(part.run.t, float)
    rows = [np.interp(part.t_seen, t, column) for column in commands.T]
    return np.ascontiguousarray(np.reshape(rows, (commands.shape[1], part.frames)).T)


def declared(values: object, *shape: int) -> Floats | None:
    """Return what a run declares for each sample, in a `shape` (T,) or (T, 3).

    None if it declares nothing.
    """
    return (
        None
        if values is None
        else np.ascontiguousarray(np.broadcast_to(np.asarray(values, float), shape))
    )
