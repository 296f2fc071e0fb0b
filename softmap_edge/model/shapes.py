"""The arrays of a bundle as types, and the shapes, fields and cables compiled from them.

Only this module reads `prior.npz`, `fields.npz` and `residual.npz` and knows the names of their
arrays. Arrays may be whole numbers of steps (`npz.Stored`). S is the number of commands, C that of
channels, M = 3N that of coordinates of N points in mm, m modes, T tendons, L the loads of
`_core.LOADS`. Units of fields: those of `_core.FIELDS`. Rods have their own types
(`elastic_rod.py`, `polynomial_rod.py`). Pinned by tests/model/test_bundle_arrays.py and
tests/model/test_bundle.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import SoftmapError
from softmap_edge.files.npz import STEP, Arrays, Stored, array_of

if TYPE_CHECKING:
    from softmap_edge.model.coverage import Coverage
    from softmap_edge.model.polynomial_rod import RodArrays

Floats = NDArray[np.float64]
Numbers = NDArray[np.generic]  # of any width, as stored
ReadArrays = Mapping[str, NDArray[np.generic]]

_TENSION = "tension_"  # prefix of the field of a tendon, before its number
_FIELD, _STRETCH = "coefficients_", "stretch_"  # prefixes of a field's name


# --- over which commands numbers are given ------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Grid:
    """Commands on a grid: ascending `axes` (S_c,), one per channel; the last one varies fastest."""

    axes: tuple[Numbers, ...] = ()

    def compiled(self, coefficients: Floats, mean: Floats, modes: Floats) -> _core.Table:
        """Return the table of coefficients (S, m) of modes (m, M) about a mean (M,)."""
        return _core.Table([_float(axis) for axis in self.axes], coefficients, mean, modes)

    def table(self, numbers: Floats) -> _core.Table:
        """Return the table of numbers (S, n), each as its own mode."""
        width = numbers.shape[1]
        return self.compiled(numbers, np.zeros(width), np.eye(width))

    def to_npz(self, before: str = "") -> Arrays:
        """Return the arrays `axis0…`, their names prefixed by `before`."""
        return {f"{before}axis{c}": axis for c, axis in enumerate(self.axes)}

    @classmethod
    def from_npz(cls, arrays: ReadArrays, before: str = "") -> Grid:
        """Read the arrays `axis0…`, as many as there are."""
        axes: list[Numbers] = []
        while f"{before}axis{len(axes)}" in arrays:
            axes.append(arrays[f"{before}axis{len(axes)}"])
        return cls(tuple(axes))


@dataclass(frozen=True, eq=False)
class Nodes:
    """Scattered commands: `nodes` (n, C), `scale` (C,), power of the kernel (1 or 3)."""

    nodes: Numbers
    scale: Numbers
    power: int

    def compiled(self, coefficients: Floats, mean: Floats, modes: Floats) -> _core.Scattered:
        """Return the family of coefficients (n + 1 + C, m) of modes (m, M) about a mean (M,)."""
        nodes, scale = _float(self.nodes), _float(self.scale)
        return _core.Scattered(nodes, scale, self.power, coefficients, mean, modes)

    def to_npz(self) -> Arrays:
        """Return the arrays `nodes`, `scale` and `power`."""
        return {"nodes": self.nodes, "scale": self.scale, "power": np.array(self.power)}

    @classmethod
    def from_npz(cls, arrays: ReadArrays) -> Nodes:
        """Read the arrays `nodes`, `scale` and `power`; raise SoftmapError if one is missing."""
        nodes, scale = (array_of(arrays, name) for name in ("nodes", "scale"))
        return cls(nodes, scale, int(_single(arrays, "power")))


def _over(arrays: ReadArrays) -> Grid | Nodes:
    return Nodes.from_npz(arrays) if "nodes" in arrays else Grid.from_npz(arrays)


# --- shapes -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ModeArrays:
    """A shape in modes, mean + coefficients(u) · modes: a table over a grid, or a scattered family.

    `mean` (M,) mm, `modes` (m, M), `coefficients` (S, m) over a grid or (n + 1 + C, m) over nodes.
    """

    over: Grid | Nodes
    mean: Numbers
    modes: Stored
    coefficients: Stored

    def compiled(self) -> _core.Table | _core.Scattered:
        """Return the compiled shape."""
        mean = _float(self.mean)
        return self.over.compiled(self.coefficients.values, mean, self.modes.values)

    def to_npz(self) -> Arrays:
        """Return its arrays by name."""
        return {
            **self.over.to_npz(),
            "mean": self.mean,
            **self.modes.to_npz("modes"),
            **self.coefficients.to_npz("coefficients"),
        }

    @classmethod
    def from_npz(cls, arrays: ReadArrays) -> ModeArrays:
        """Read a shape in modes.

        Raises:
            SoftmapError: an array is missing, or its steps do not match.
        """
        modes, coefficients = (Stored.from_npz(arrays, name) for name in ("modes", "coefficients"))
        return cls(_over(arrays), array_of(arrays, "mean"), modes, coefficients)


@dataclass(frozen=True, eq=False)
class NetworkArrays:
    """A network: the bytes of its ONNX file, and the grid of the numbers stored with it."""

    onnx: bytes
    grid: Grid = Grid()

    def compiled(self) -> _core.Network:
        """Return the compiled network."""
        return _core.Network(self.onnx)

    def to_npz(self) -> Arrays:
        """Return the arrays stored next to its file."""
        return self.grid.to_npz()


# --- priors -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class TrainedOver:
    """The model error without a trained prior: `form_error` (V, 3) mm, and that of vertices, mm."""

    form_error: Floats
    vertex_error_mm: float

    def to_npz(self) -> Arrays:
        """Return the arrays of `prior.npz`."""
        return {"form_before": self.form_error, "error_before_mm": np.array(self.vertex_error_mm)}

    @classmethod
    def from_npz(cls, arrays: ReadArrays) -> TrainedOver | None:
        """Read the arrays of `prior.npz`; None if its prior was not trained."""
        if not {"form_before", "error_before_mm"} <= set(arrays):
            return None
        return cls(_float(arrays["form_before"]), _single(arrays, "error_before_mm"))


@dataclass(frozen=True, eq=False)
class NumbersBefore:
    """A rod before an effect changed its law: its `numbers` (P,) and `form_error` (V, 3) mm."""

    numbers: Floats
    form_error: Floats

    def to_npz(self) -> Arrays:
        """Return the arrays of `prior.npz`."""
        return {"numbers_before": self.numbers, "error_before_mm": self.form_error}

    @classmethod
    def from_npz(cls, arrays: ReadArrays) -> NumbersBefore | None:
        """Read the arrays of `prior.npz`; None if no effect changed its numbers."""
        if not {"numbers_before", "error_before_mm"} <= set(arrays):
            return None
        return cls(_float(arrays["numbers_before"]), _float(arrays["error_before_mm"]))


@dataclass(frozen=True, eq=False)
class PriorArrays:
    """A prior and its companions in `prior.npz`.

    `pull` (S, T) N is the tension of each tendon over the grid of a simulated prior, negative where
    slack. `coverage` holds the commands that a rod was learned from. `before` is the model from
    before its prior was trained, or before an effect changed the numbers of its rod.
    """

    shape: ModeArrays | NetworkArrays | RodArrays
    pull: Stored | None = None
    coverage: Coverage | None = None
    before: TrainedOver | NumbersBefore | None = None

    @property
    def grid(self) -> Grid | None:
        """The grid of a table, or the one of a network; None for scattered families and rods."""
        over = self.shape.over if isinstance(self.shape, ModeArrays) else None
        over = self.shape.grid if isinstance(self.shape, NetworkArrays) else over
        return over if isinstance(over, Grid) else None

    def tensions(self) -> _core.Table | None:
        """Return the tensions (n, T) N over commands; None without tendons or their tension."""
        if self.grid is None or self.pull is None or self.pull.array.size == 0:
            return None
        return self.grid.table(self.pull.values)

    @property
    def in_steps(self) -> bool:
        """Whether some arrays are whole numbers of steps, as from schema 3 on."""
        stored = [self.pull]
        if isinstance(self.shape, ModeArrays):
            stored += [self.shape.modes, self.shape.coefficients]
        return any(one is not None and one.step is not None for one in stored)

    def to_npz(self) -> Arrays:
        """Return the arrays of `prior.npz`."""
        arrays = self.shape.to_npz()
        arrays |= {} if self.pull is None else self.pull.to_npz("pull")
        arrays |= {} if self.coverage is None else self.coverage.to_npz()
        return arrays | ({} if self.before is None else self.before.to_npz())

    @classmethod
    def from_npz(cls, shape: ModeArrays | NetworkArrays, arrays: ReadArrays) -> PriorArrays:
        """Read the companions of a shape that is not a rod from `prior.npz`."""
        pull = Stored.from_npz(arrays, "pull") if "pull" in arrays else None
        return cls(shape, pull=pull, before=TrainedOver.from_npz(arrays))


# --- fields -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PairArrays:
    """Second derivatives for P pairs of causes.

    `weights` (S, P, m'), `stretch` (S, P, T) mm, `growth` (S, causes).
    """

    weights: Stored
    stretch: Stored
    growth: Stored

    def rows(self) -> Floats:
        """Return all numbers of each command (S, n) in the form of `_core.Second`."""
        growth = self.growth.values
        pairs = np.concatenate([self.weights.values, self.stretch.values], axis=2)
        return np.concatenate([pairs.reshape(len(growth), -1), growth], axis=1)

    def to_npz(self, before: str) -> Arrays:
        """Return the arrays, their names prefixed by `before`."""
        return {
            **self.weights.to_npz(f"{before}weights"),
            **self.stretch.to_npz(f"{before}stretch"),
            **self.growth.to_npz(f"{before}growth"),
        }

    @classmethod
    def from_npz(cls, arrays: ReadArrays, before: str) -> PairArrays:
        """Read the arrays; raise SoftmapError if one is missing."""
        weights, stretch, growth = (
            Stored.from_npz(arrays, before + name) for name in ("weights", "stretch", "growth")
        )
        return cls(weights, stretch, growth)


@dataclass(frozen=True, eq=False)
class SecondArrays:
    """The second order of loads and moduli beyond their fields, over its own grid.

    `modes` (m', m) are combinations of the fields' modes. `pairs` are those of loads and tensions,
    `moduli` those with a modulus (absent in bundles of earlier versions).
    """

    grid: Grid
    modes: Numbers
    pairs: PairArrays
    moduli: PairArrays | None = None

    def compiled(self, modes: Floats) -> _core.Second:
        """Return the compiled second order; `modes` (m, M) are those of the fields."""
        own = _float(self.modes) @ modes
        axes = [_float(axis) for axis in self.grid.axes]
        moduli = None if self.moduli is None else self.moduli.rows()
        tendons = self.pairs.stretch.array.shape[2]
        return _core.Second(axes, self.pairs.rows(), tendons, own, moduli)

    def to_npz(self) -> Arrays:
        """Return the arrays `second_…`."""
        return {
            **self.grid.to_npz("second_"),
            "second_modes": self.modes,
            **self.pairs.to_npz("second_"),
            **({} if self.moduli is None else self.moduli.to_npz("second_moduli_")),
        }

    @classmethod
    def from_npz(cls, arrays: ReadArrays) -> SecondArrays | None:
        """Read the arrays `second_…`; None if absent.

        Raises:
            SoftmapError: some are missing.
        """
        if "second_weights" not in arrays:
            return None
        moduli = "second_moduli_weights" in arrays
        return cls(
            Grid.from_npz(arrays, "second_"),
            array_of(arrays, "second_modes"),
            PairArrays.from_npz(arrays, "second_"),
            PairArrays.from_npz(arrays, "second_moduli_") if moduli else None,
        )


@dataclass(frozen=True, eq=False)
class FieldArrays:
    """Displacements per unit of a load or design change, in shared `modes` (m, M).

    `coefficients` by name of a field, including `tension_0…` of the tendons: (S, m) over a grid, or
    (n + 1 + C, m) over nodes. For tendons that respond to loads: `stiffness` (T,) N/mm; `stretch`
    (S, T·(L + T)) mm of each under each load and tension; `stretch_of` (S, T) under other fields,
    by name. Empty for a rod, which computes its own fields.
    """

    over: Grid | Nodes = Grid()
    modes: Stored | None = None
    coefficients: Mapping[str, Stored] = field(default_factory=dict)
    stiffness: Numbers | None = None
    stretch: Stored | None = None
    stretch_of: Mapping[str, Stored] = field(default_factory=dict)
    second: SecondArrays | None = None

    def compiled(self) -> dict[str, _core.Shape]:
        """Return the compiled fields by name, without those of tensions."""
        names = sorted(name for name in self.coefficients if not name.startswith(_TENSION))
        modes = self._modes() if names else np.zeros((0, 0))
        return {name: self.over.compiled(*self._about_zero(name, modes)) for name in names}

    def cables(self, pull: _core.Table | None) -> _core.Cables | None:
        """Return the compiled cables; None if tendons do not respond to loads.

        Args:
            pull: the tensions of the prior (`PriorArrays.tensions`).

        Raises:
            SoftmapError: an array is missing, or the fields are not on a grid.
        """
        if self.stiffness is None:
            return None
        if pull is None or self.stretch is None or not isinstance(self.over, Grid):
            raise SoftmapError("'stiffness' without 'pull', 'stretch' and fields on a grid")
        grid, stiffness, modes = self.over, _float(self.stiffness), self._modes()
        stretch = grid.table(self._full_stretch(self.stretch.values, stiffness.size))
        tensions = [
            grid.compiled(*self._about_zero(f"{_TENSION}{i}", modes)) for i in range(stiffness.size)
        ]
        return _core.Cables(stiffness, pull, stretch, tensions)

    def second_order(self) -> _core.Second | None:
        """Return the compiled second order of loads; None for a bundle without it."""
        return None if self.second is None else self.second.compiled(self._modes())

    def _modes(self) -> Floats:
        if self.modes is None:
            raise SoftmapError("array 'modes' is missing")
        return self.modes.values

    def _about_zero(self, name: str, modes: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the coefficients of a field, its mean (zero), and its modes."""
        if name not in self.coefficients:
            raise SoftmapError(f"array '{_FIELD}{name}' is missing")
        return self.coefficients[name].values, np.zeros(modes.shape[1]), modes

    def _full_stretch(self, stored: Floats, tendons: int) -> Floats:
        """Return the stretch (S, T·(F + T)) of every tendon for each field and each tension.

        The fields are those of `_core.FIELDS`; zero for those that a bundle lacks.
        """
        loads, fields = len(_core.LOADS), len(_core.FIELDS)
        given = stored.reshape(len(stored), tendons, loads + tendons)
        full = np.zeros((len(stored), tendons, fields + tendons))
        full[..., :loads], full[..., fields:] = given[..., :loads], given[..., loads:]
        for f, name in enumerate(_core.FIELDS):
            if name in self.stretch_of:
                full[..., f] = self.stretch_of[name].values
        return full.reshape(len(full), -1)

    def to_npz(self) -> Arrays:
        """Return the arrays of `fields.npz`."""
        arrays = self.over.to_npz()
        arrays |= {} if self.modes is None else self.modes.to_npz("modes")
        for before, group in ((_FIELD, self.coefficients), (_STRETCH, self.stretch_of)):
            for name, numbers in group.items():
                arrays |= numbers.to_npz(before + name)
        arrays |= {} if self.stiffness is None else {"stiffness": self.stiffness}
        arrays |= {} if self.stretch is None else self.stretch.to_npz("stretch")
        return arrays | ({} if self.second is None else self.second.to_npz())

    @classmethod
    def from_npz(cls, arrays: ReadArrays) -> FieldArrays:
        """Read the arrays of `fields.npz`.

        Raises:
            SoftmapError: some arrays are missing, or the steps of one do not match.
        """

        def group(before: str) -> dict[str, Stored]:
            names = [name for name in arrays if name.startswith(before)]
            return {
                name.removeprefix(before): Stored.from_npz(arrays, name)
                for name in names
                if not name.endswith(STEP)
            }

        return cls(
            over=_over(arrays),
            modes=Stored.from_npz(arrays, "modes") if "modes" in arrays else None,
            coefficients=group(_FIELD),
            stiffness=arrays.get("stiffness"),
            stretch=Stored.from_npz(arrays, "stretch") if "stretch" in arrays else None,
            stretch_of=group(_STRETCH),
            second=SecondArrays.from_npz(arrays),
        )


@dataclass(frozen=True, eq=False)
class BundleArrays:
    """The arrays that a structure was compiled from, as stored in its bundle."""

    prior: PriorArrays
    fields: FieldArrays = FieldArrays()
    residual: ModeArrays | NetworkArrays | None = None

    def compiled_fields(self) -> Mapping[str, _core.Shape]:
        """Return the compiled fields by name; a rod computes its own."""
        shape = self.prior.shape
        if isinstance(shape, ModeArrays | NetworkArrays):
            return self.fields.compiled()
        return shape.fields()

    def contents(self) -> dict[str, Arrays]:
        """Return the arrays of its archives, by name without `.npz`."""
        found = {"prior": self.prior.to_npz(), "fields": self.fields.to_npz()}
        return found | ({} if self.residual is None else {"residual": self.residual.to_npz()})

    def networks(self) -> dict[str, bytes]:
        """Return its ONNX files, by name without `.onnx`."""
        shapes = {"prior": self.prior.shape, "residual": self.residual}
        return {
            name: shape.onnx for name, shape in shapes.items() if isinstance(shape, NetworkArrays)
        }


Pairs = tuple[list[tuple[int, int]], list[int]]  # of causes, and causes with stored growth


def pairs_of(loads: int, moduli: int, tensions: int) -> tuple[Pairs, Pairs]:
    """Return the pairs of causes for `_core.Second`, and the causes whose growth is stored.

    Causes are loads, then moduli, then tensions. The first pairs are those among loads and
    tensions, then those of each modulus with all of these and with moduli from itself on.
    """
    plain = [*range(loads), *range(loads + moduli, loads + moduli + tensions)]
    own = list(range(loads, loads + moduli))
    return (
        ([(k, l) for i, k in enumerate(plain) for l in plain[i:]], plain),
        ([(k, l) for i, k in enumerate(own) for l in plain + own[i:]], own),
    )


def _float(array: NDArray[np.generic]) -> Floats:
    return np.asarray(array, np.float64)


def _single(arrays: ReadArrays, name: str) -> float:
    array = array_of(arrays, name)
    if array.size != 1:
        raise SoftmapError(f"array '{name}' holds {array.size} numbers, expected one")
    return float(_float(array).item())
