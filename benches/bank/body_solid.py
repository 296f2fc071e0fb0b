"""Slice B: the built-in finger as finite elements on another mesh, of softer silicone, diagnosed with its own bundle.

Shapes come from dense sweeps of that other finger, one for each orientation of the protocols, interpolated by splines
in their leading modes; `interpolation_mm` measures by how much that misses an equilibrium. Where a law changes the
weights every frame is solved. A pair of cables is one command here: what a law does to single cables counts where they
pull.
Units: mm, g, N. Pinned by tests/test_bank.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from benches.bank.body_rod import kept
from benches.bank.law import Floats, Law
from benches.bank.laws_body import BODY
from benches.bank.laws_drive import DRIVE
from benches.bank.laws_unknown import UNKNOWN
from benches.bank.rod import Loads
from softmap_edge.bundle import builtin_model
from softmap_edge.protocol import HANGING, LEANING
from softmap_edge.solid.finger import Finger
from softmap_edge.solid.simulator import Simulator, tour

if TYPE_CHECKING:
    from softmap_edge.model import Model

SOFTER = 0.94  # modulus against the first finger's
LAYERS = 0.8  # layers against the first finger's
REACH, STEPS = 18.0, 25  # mm; commands a channel
NEAR = 0.02  # g: gravity this near to that of a sweep is that of the sweep
MODES = 40
NO_SHAPE = ("magnet", "crack")
WEIGHTS = ("gravity", "payload")


class SolidBody:
    """Slice B."""

    name, channels = "moe-finger", 2
    can = frozenset(
        name
        for name, law in {**DRIVE, **BODY, **UNKNOWN}.items()
        if name not in NO_SHAPE and (name in WEIGHTS or not law.SHAPE)
    )

    @property
    def place(self) -> Floats:
        return np.asarray(self.rest(False)[:, 2])

    def rest(self, marked: bool) -> Floats:
        rest = np.asarray(_first().template.vertices, float)
        return rest[_markers()] if marked else rest

    def points(self, laws: Sequence[Law], pull: Floats, gravity: Floats, marked: bool) -> Floats:
        u, loads = _commands(pull), Loads(pull, np.asarray(gravity, float), np.zeros((len(pull), 3)))
        for law in laws:
            loads = law.loads(loads, None)
        out = np.empty((len(u), len(self.rest(False)), 3))
        kinds, which = np.unique(
            np.round(np.concatenate([loads.gravity, loads.tip], axis=1), 9), axis=0, return_inverse=True
        )
        for i, kind in enumerate(kinds):
            rows = np.flatnonzero(which.reshape(-1) == i)
            swept = [k for k, g in enumerate((HANGING, LEANING)) if np.linalg.norm(kind[:3] - g) < NEAR]
            if swept and not kind[3:].any():
                out[rows] = _swept(swept[0], STEPS)(u[rows])
            else:
                out[rows] = _solved(u[rows], kind[:3], kind[3:])
        return out[:, _markers()] if marked else out

    def rough(self, laws: Sequence[Law], pull: Floats, gravity: Floats, marked: bool) -> Floats:
        return self.points((), pull, gravity, marked)

    def model(self) -> Model:
        return builtin_model()


def interpolation_mm(count: int = 20, seed: int = 0) -> float:
    """Return the RMS distance between what is interpolated and equilibria at commands off the grid."""
    u = np.random.default_rng(seed).uniform(-12.0, 12.0, (count, 2))
    off = _swept(0, STEPS)(u) - _solved(u, np.array(HANGING), np.zeros(3))
    return float(np.sqrt(np.mean(np.sum(off**2, axis=2))))


def _commands(pull: Floats) -> Floats:
    """Return the commands (K, 2) mm of pairs whose cables are shortened by `pull` (K, 4)."""
    first, second = pull[:, :2], pull[:, 2:]
    return np.where(first >= second, first, -second)


@lru_cache(maxsize=1)
def _first() -> Simulator:
    return Simulator(Finger.builtin())


@lru_cache(maxsize=1)
def _second() -> Simulator:
    finger = Finger.builtin()
    other = finger.replace(solid=finger.solid.along(LAYERS), young_mpa=finger.young_mpa * SOFTER)
    return Simulator(other, template=_first().template)


@lru_cache(maxsize=1)
def _markers() -> Any:
    """Return nine vertices: three around, at three heights."""
    rest = np.asarray(_first().template.vertices, float)
    found = []
    for z, turned in ((40.0, 0.2), (75.0, 1.1), (100.0, 0.6)):
        ring = np.flatnonzero(np.abs(rest[:, 2] - z) < 3.0)
        angle = np.arctan2(rest[ring, 1], rest[ring, 0])
        for k in range(3):
            away = np.abs(np.angle(np.exp(1j * (angle - turned - 2 * np.pi * k / 3))))
            found.append(int(ring[np.argmin(away)]))
    return np.array(found)


def _solved(u: Floats, gravity: Floats, tip: Floats) -> Floats:
    """Return equilibria (K, N, 3) mm at commands (K, 2), each from a near one."""
    places, which = np.unique(np.round(u, 3), axis=0, return_inverse=True)
    order = tour(places)
    points = np.empty((len(places), len(_first().template.vertices), 3))
    points[order] = _second().path(places[order], gravity=gravity, load=tip)
    return points[which.reshape(-1)]


@lru_cache(maxsize=4)
def _swept(orientation: int, steps: int) -> Any:
    """Return the function from commands (K, 2) mm to points (K, N, 3) mm in one orientation of the protocols."""
    from scipy.interpolate import RectBivariateSpline

    axis = np.linspace(-REACH, REACH, steps)

    def make() -> dict[str, Any]:
        gravity = np.array((HANGING, LEANING)[orientation])
        values = np.asarray(_second().sweep([axis, axis], gravity=gravity).vertices, float).reshape(steps**2, -1)
        mean = values.mean(axis=0)
        left, size, modes = np.linalg.svd(values - mean, full_matrices=False)
        return {"mean": mean, "weights": (left * size)[:, :MODES], "modes": modes[:MODES]}

    table = kept(f"solid{orientation}", (steps, SOFTER, LAYERS, REACH), make)
    splines = [RectBivariateSpline(axis, axis, w.reshape(steps, steps)) for w in table["weights"].T]

    def points(u: Floats) -> Floats:
        weights = np.stack([spline(u[:, 0], u[:, 1], grid=False) for spline in splines], axis=1)
        return np.asarray((table["mean"] + weights @ table["modes"]).reshape(len(u), -1, 3))

    return points
