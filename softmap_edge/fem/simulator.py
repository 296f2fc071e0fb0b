"""Simulate a finger: shapes over a grid or along a path, and responses.

Responses are to loads and changes of design.

    sweep = Simulator(Finger.builtin()).sweep([np.linspace(-16, 16, 41)] * 2)

Quasi-static finite elements in the compiled core; all local cores are used, Ctrl-C interrupts.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge import _core
from softmap_edge.errors import FingerError, SimulationError, SoftmapError, brief
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.groups import named_cells
from softmap_edge.files.npz import read_npz, write_npz
from softmap_edge.run.fields import unmasked
from softmap_edge.version import __version__

Floats = NDArray[np.float64]
Progress = Callable[[float], None]

SCHEMA = "softmap.sweep.file/2"
UNITS = {"command": "mm", "vertices": "mm", "pull": "N", "gravity": "g", "tip_force": "N"}
_NUMBERS = tuple(UNITS)


@dataclass(frozen=True)
class FingerTemplate:
    """A finger's surface at rest: vertices (N, 3) mm in the base frame, triangles (F, 3).

    Triangles are int32, with outward orientation.
    """

    vertices: Floats
    triangles: NDArray[np.int32]


@dataclass(frozen=True)
class Compliance:
    """The response of S equilibria to loads, changes of design and tensions.

    All (other) tensions of the T tendons are constant.

    fields: displacement (S, N, 3) mm per unit of those of `_core.FIELDS` that there are (per 1 g
    `gravity_x|y|z`, per 1 N on the tip `tip_force_x|y|z`; if asked for, the changes of design that
    `Simulator` names) and per 1 N in each tendon (`tension_0…`), by name · stretch: (S, T, F + T)
    mm of each tendon under the same, in the order of `_core.FIELDS` and of the tendons, zero where
    there is no field.
    """

    fields: dict[str, Floats]
    stretch: Floats


@dataclass(frozen=True)
class Bend:
    """Second derivatives of S equilibria by loads, moduli and tensions.

    They are given for each of the P pairs of `_core.LOADS`, `_core.MODULI` and the T tensions, row
    by row.

    fields: (S, P, N, 3) mm per unit of both · stretch: (S, P, T) mm of each tendon · growth: (S, L
    + M + T), relative growth of the responses to loads and tensions per unit of each.
    """

    fields: Floats
    stretch: Floats
    growth: Floats


@dataclass(frozen=True)
class Sweep:
    """Shapes over a grid of commands.

    One array a command, command (S, C) mm (N by tension), vertices (S, N, 3) mm, pull (S, T) N of
    the tendons (below zero: how slack), triangles (F, 3) int32 of the vertices; the finger, its
    gravity (3,) g and tip_force (3,) N.

    S runs over the grid in C order: the last axis is the fastest.
    """

    axes: tuple[Floats, ...]
    command: Floats
    vertices: Floats
    pull: Floats
    triangles: NDArray[np.int32]
    finger: Finger
    gravity: Floats
    tip_force: Floats

    @property
    def tension(self) -> Floats:
        """Tension (S, T) N of the tendons, zero when slack."""
        return np.maximum(self.pull, 0.0)

    def save(self, path: str | Path) -> None:
        """Write the sweep as `.npz` without pickles, with the finger's `finger.toml`."""
        arrays: dict[str, NDArray[np.generic]] = {
            f"axis{c}": axis for c, axis in enumerate(self.axes)
        }
        arrays |= {name: getattr(self, name) for name in (*_NUMBERS, "triangles")}
        units = UNITS | {"command": self.finger.command_unit}
        texts = {
            "schema": SCHEMA,
            "finger": self.finger.to_toml(),
            "units": json.dumps(units, sort_keys=True),
        }
        # The simulator applies no effects of the library; an imported sweep declares its own.
        texts |= {"effects": "[]", "written_by": f"softmap-edge {__version__}"}
        write_npz(Path(path), arrays | {name: np.array(text) for name, text in texts.items()})

    @classmethod
    def load(cls, path: str | Path) -> Sweep:
        """Read a sweep; raises SimulationError if the file is not one, damaged or newer."""
        content = read_npz(Path(path), SimulationError)
        schema = str(content.get("schema", "none"))[:80]
        if schema != SCHEMA:
            raise SimulationError(
                f"{path}: schema {schema!r}, expected {SCHEMA}; make it with `softmap model sweep`"
            )
        try:
            units = json.loads(str(content["units"]))
            finger = Finger.from_toml(str(content["finger"]))
            names = [f"axis{c}" for c in range(len(finger.pairs))]
            axes = tuple(_stored(content, name, "fiu").astype(np.float64) for name in names)
            numbers = {name: _stored(content, name, "fiu").astype(np.float64) for name in _NUMBERS}
            triangles = _stored(content, "triangles", "i").astype(np.int32)
        except (SoftmapError, KeyError, ValueError, TypeError, RecursionError) as error:
            raise SimulationError(
                f"{path}: not a sweep ({brief(error)}); make it with `softmap model sweep`"
            ) from None
        expected = UNITS | {"command": finger.command_unit}
        if units != expected:
            raise SimulationError(f"{path}: units {units!r:.120}, expected {expected}; convert it")
        sweep = cls(axes=axes, triangles=triangles, finger=finger, **numbers)
        sweep._check(path)
        return sweep

    def _check(self, path: str | Path) -> None:
        size = (
            math.prod(len(axis) for axis in self.axes)
            if all(axis.ndim == 1 for axis in self.axes)
            else -1
        )
        n = self.vertices.shape[1] if self.vertices.ndim == 3 else 0
        expected = {
            "command": (size, len(self.axes)),
            "vertices": (size, n, 3),
            "pull": (size, len(self.finger.tendons)),
            "triangles": (len(self.triangles) if self.triangles.ndim else -1, 3),
            "gravity": (3,),
            "tip_force": (3,),
        }
        for name, shape in expected.items():
            array = getattr(self, name)
            if array.shape != shape or not np.isfinite(array).all():
                raise SimulationError(
                    f"{path}: {name} of shape {array.shape}, expected finite numbers of shape "
                    f"{shape} for axes of {[axis.shape for axis in self.axes]}; make it again "
                    "with `softmap model sweep`"
                )
        if self.triangles.size and not 0 <= self.triangles.min() <= self.triangles.max() < n:
            raise SimulationError(
                f"{path}: triangles point outside the {n} vertices; make it again"
            )


def tensor_grid(axes: Sequence[Floats]) -> Floats:
    """Return the commands (S, C) of a grid of `axes`, the last one fastest.

    Without axes, it is one command without channels.
    """
    size = math.prod(len(axis) for axis in axes)
    columns = [column.ravel() for column in np.meshgrid(*axes, indexing="ij")]
    return np.stack(columns, axis=1) if columns else np.zeros((size, 0))


def tour(places: Floats) -> NDArray[np.intp]:
    """Return an order of the commands (K, C), each followed by the nearest remaining one."""
    left = np.ones(len(places), bool)
    order = [int(np.argmin(np.sum(places**2, axis=1)))]
    for _ in range(len(places) - 1):
        left[order[-1]] = False
        distance = np.sum((places - places[order[-1]]) ** 2, axis=1)
        order.append(int(np.argmin(np.where(left, distance, np.inf))))
    return np.array(order)


class Simulator:
    """The finite elements of one finger.

    finger: the finger to simulate · template: report these material points (embedded at rest)
    instead of the surface, so fingers on different meshes give the same vertices · change:
    differences of the body from the finger's file, in the units of the fields of a design:
    `stiff_0` … `stiff_6` and `stiff_x|y` are logarithms of the modulus (in seven stretches from
    base to tip; from the axis to the sides), `curve_x|y` mm of the tip and `twist` degrees at the
    tip at rest, `routing_c` degrees by which the tendons of command c are turned about the axis.
    Raises FingerError when the finger cannot be built or the template does not lie in it.
    """

    def __init__(
        self,
        finger: Finger,
        template: FingerTemplate | None = None,
        change: Mapping[str, float] | None = None,
    ) -> None:
        points = (
            None if template is None else np.ascontiguousarray(template.vertices, dtype=np.float64)
        )
        try:
            mesh = finger.solid.cells([z for tendon in finger.tendons for z in tendon.ends()])
            low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
            for number, region in enumerate(finger.regions):
                region.check_meets(f"region[{number}]", low, high)
            self.solid = _core.Solid(
                mesh=mesh,
                young=finger.young_mpa,
                poisson=finger.poisson,
                density=finger.density_kg_m3,
                regions=[
                    region.boxed(cells)
                    for region, cells in zip(finger.regions, named_cells(finger))
                ],
                cable_stiffness=finger.cable_stiffness_n_mm,
                ring=finger.guide_ring_mm,
                disc=finger.anchor_disc_mm,
                routes=[tendon.way() for tendon in finger.tendons],
                drive=_drive(finger).tolist(),
                by_tension=finger.command_unit == "N",
                pretension=finger.pretension_mm,
                load_at=finger.load_at_mm,
                points=points,
                change=[(name, float(by)) for name, by in (change or {}).items()],
            )
        except _core.CoreError as error:
            raise FingerError(f"{finger.name}: {error}") from None
        self.finger = finger
        self._template = template or FingerTemplate(self.solid.vertices, self.solid.triangles)

    @property
    def template(self) -> FingerTemplate:
        """The reported vertices at rest, and their triangles."""
        return self._template

    def rest(self) -> Floats:
        """Return the vertices (N, 3) mm under the finger's own gravity, without a command."""
        return np.ascontiguousarray(self.path(np.zeros((1, len(self.finger.pairs))))[0])

    def sweep(
        self,
        axes: Sequence[ArrayLike],
        gravity: ArrayLike | None = None,
        load: ArrayLike = (0.0, 0.0, 0.0),
        progress: Progress | None = None,
    ) -> Sweep:
        """Simulate every command of a grid.

        axes: one ascending array of mm (or N) for each command · gravity: (3,) g in the base frame,
        None for the finger's own · load: (3,) N on the tip · progress: called with the share done,
        0 to 1. Raises SimulationError.
        """
        grid = tuple(_array("axis", axis, (None,)) for axis in axes)
        with _core_faults():
            vertices, pull = self.solid.sweep(
                [axis.tolist() for axis in grid],
                self._gravity(gravity),
                _vector("load", load),
                progress,
            )
        return Sweep(
            axes=grid,
            command=tensor_grid(grid),
            vertices=vertices,
            pull=pull,
            triangles=self.template.triangles,
            finger=self.finger,
            gravity=np.array(self._gravity(gravity)),
            tip_force=np.array(_vector("load", load)),
        )

    def path(
        self,
        commands: ArrayLike,
        gravity: ArrayLike | None = None,
        load: ArrayLike = (0.0, 0.0, 0.0),
        progress: Progress | None = None,
    ) -> Floats:
        """Return the vertices (K, N, 3) mm along commands (K, C) mm.

        gravity: (3,) or one row for each command (K, 3) in g, None for the finger's own · load:
        (3,) N on the tip · progress: called with the share done. Raises SimulationError.
        """
        return self.path_and_pull(commands, gravity, load, progress)[0]

    def path_and_pull(
        self,
        commands: ArrayLike,
        gravity: ArrayLike | None = None,
        load: ArrayLike = (0.0, 0.0, 0.0),
        progress: Progress | None = None,
    ) -> tuple[Floats, Floats]:
        """Return the result of `path`, and the pull (K, T) N of the tendons (negative: slack)."""
        u = _array("commands", commands, (None, len(self.finger.pairs)))
        g = np.asarray(self.finger.gravity if gravity is None else gravity, dtype=np.float64)
        g = np.ascontiguousarray(np.broadcast_to(g, (len(u), 3))) if g.shape == (3,) else g
        rows = _array("gravity", g, (len(u), 3))
        with _core_faults():
            return self.solid.path(u, rows, _vector("load", load), progress)

    def path_from(
        self, other: Simulator, commands: ArrayLike, gravity: ArrayLike | None = None
    ) -> Floats:
        """Return the result of `path`, from the equilibria of `other` on a coarser mesh.

        `other` simulates the same finger.

        Use it for meshes on which the path from home would take hours. Raises SimulationError.
        """
        u = _array("commands", commands, (None, len(self.finger.pairs)))
        with _core_faults():
            return self.solid.path_from(other.solid, u, self._gravity(gravity), (0.0, 0.0, 0.0))

    def fields(
        self,
        commands: ArrayLike,
        gravity: ArrayLike | None = None,
        load: ArrayLike = (0.0, 0.0, 0.0),
        progress: Progress | None = None,
        design: bool = False,
    ) -> Compliance:
        """Return the response of equilibria to small loads and tensions.

        Equilibria are at commands (S, C) mm under `gravity` and `load`. With `design`, include
        responses to changes of design.

        Raises SimulationError.
        """
        u = _array("commands", commands, (None, len(self.finger.pairs)))
        with _core_faults():
            found = self.solid.fields(
                u, self._gravity(gravity), _vector("load", load), design, progress
            )
        return Compliance(found, found.pop("stretch"))

    def bends(self, commands: ArrayLike, progress: Progress | None = None) -> Bend:
        """Return the second derivatives by loads, moduli and tensions.

        Equilibria are at commands (S, C) mm under the finger's own gravity.

        Raises SimulationError.
        """
        u = _array("commands", commands, (None, len(self.finger.pairs)))
        with _core_faults():
            return Bend(*self.solid.bends(u, self._gravity(None), (0.0, 0.0, 0.0), progress))

    def _gravity(self, gravity: ArrayLike | None) -> tuple[float, float, float]:
        return _vector("gravity", self.finger.gravity if gravity is None else gravity)


def _stored(
    content: Mapping[str, NDArray[np.generic]], name: str, kinds: str
) -> NDArray[np.generic]:
    array = content[name]
    if array.dtype.kind not in kinds:
        raise SimulationError(f"{name} holds {array.dtype}, expected numbers")
    return array


def _drive(finger: Finger) -> Floats:
    """Return the command of each tendon (mm or N) per unit of each command, (T, C)."""
    drive = np.zeros((len(finger.tendons), len(finger.pairs)))
    for c, (pulled, *paid_out) in enumerate(finger.pairs):
        drive[pulled, c] = 1.0
        drive[paid_out, c] = -1.0
    return drive


def _array(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Floats:
    try:
        array = np.ascontiguousarray(unmasked(value))
    except (TypeError, ValueError):
        raise SimulationError(f"{name}: expected numbers of shape {_shape(shape)}") from None
    fits = array.ndim == len(shape) and all(s in (None, n) for s, n in zip(shape, array.shape))
    if not fits or not np.isfinite(array).all():
        raise SimulationError(
            f"{name}: got shape {array.shape}, expected finite numbers of shape {_shape(shape)}"
        )
    return array


def _vector(name: str, value: ArrayLike) -> tuple[float, float, float]:
    x, y, z = _array(name, value, (3,)).tolist()
    return x, y, z


def _shape(shape: tuple[int | None, ...]) -> str:
    return (
        "("
        + ", ".join("n" if s is None else str(s) for s in shape)
        + ("," if len(shape) == 1 else "")
        + ")"
    )


@contextmanager
def _core_faults() -> Iterator[None]:
    """Raise errors of the core as SimulationError."""
    try:
        yield
    except _core.CoreError as error:
        raise SimulationError(str(error)) from None
