"""Slice B: the built-in finger as finite elements, diagnosed with its own bundle.

It is on another mesh, of softer silicone.

Shapes come from dense sweeps of that other finger, one for each orientation of the protocols,
interpolated by splines in their leading modes; `interpolation_mm` measures by how much that misses
an equilibrium. Where a law changes weights, modulus, cables or their routes, every frame is solved.
A pair of cables is one command here: what a law does to single cables counts where they pull.
Curvature and twist at rest, a plane and torn fibres are for slice A alone. Units: mm, g, N. Pinned
by tests/benches/test_bank.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from benches.bank import section
from benches.bank.body_rod import kept
from benches.bank.law import Floats, Law, Past
from benches.bank.laws_body import BODY
from benches.bank.laws_drive import DRIVE
from benches.bank.laws_unknown import UNKNOWN
from benches.bank.rod import Loads
from softmap_edge.fem.finger import Finger, Region
from softmap_edge.fem.simulator import Simulator, tour
from softmap_edge.model.bundle import builtin_model
from softmap_edge.run.protocol import HANGING, LEANING

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

SOFTER = 0.94  # modulus against the first finger's
LAYERS = 0.8  # layers against the first finger's
REACH, STEPS = 18.0, 25  # mm; commands a channel
NEAR = 0.02  # g: gravity this near to that of a sweep is that of the sweep
# distinct decimals of a command, mm: points are off by 0.008 mm RMS, the tip by 0.04 at
# most
SAME = 2
MODES = 40
ONLY_A = ("magnet", "crack", "contact", "twist", "pre_curve", "kink")
SLICES = 12  # of the body, each of one modulus, of two where a side differs


class SolidBody:
    """Slice B."""

    name, channels, every = "moe-finger", 2, 12
    can = frozenset({*DRIVE, *BODY, *UNKNOWN} - {*ONLY_A})

    @property
    def place(self) -> Floats:
        return np.asarray(self.rest(False)[:, 2])

    def rest(self, marked: bool) -> Floats:
        rest = np.asarray(_first().template.vertices, float)
        return rest[_markers()] if marked else rest

    def points(
        self,
        laws: Sequence[Law],
        pull: Floats,
        gravity: Floats,
        marked: bool,
        past: Past | None = None,
    ) -> Floats:
        u, loads = (
            _commands(pull),
            Loads(pull, np.asarray(gravity, float), np.zeros((len(pull), 3))),
        )
        for law in laws:
            loads = law.loads(loads, None)
        other = _made(tuple(law for law in laws if law.SHAPE))
        out = np.empty((len(u), len(self.rest(False)), 3))
        weights = np.round(np.concatenate([loads.gravity, loads.tip], axis=1), 9)
        kinds, which = np.unique(weights, axis=0, return_inverse=True)
        for i, kind in enumerate(kinds):
            rows = np.flatnonzero(which.reshape(-1) == i)
            swept = [
                k for k, g in enumerate((HANGING, LEANING)) if np.linalg.norm(kind[:3] - g) < NEAR
            ]
            if other is None and swept and not kind[3:].any():
                out[rows] = _swept(swept[0], STEPS)(u[rows])
            else:
                out[rows] = _solved(other or _second(), u[rows], kind[:3], kind[3:])
        return out[:, _markers()] if marked else out

    def rough(self, laws: Sequence[Law], pull: Floats, gravity: Floats, marked: bool) -> Floats:
        return self.points((), pull, gravity, marked)

    def model(self) -> Model:
        return builtin_model()


def interpolation_mm(count: int = 20, seed: int = 0) -> float:
    """Return the RMS distance of interpolated points from equilibria at commands off the grid."""
    u = np.random.default_rng(seed).uniform(-12.0, 12.0, (count, 2))
    off = _swept(0, STEPS)(u) - _solved(_second(), u, np.array(HANGING), np.zeros(3))
    return float(np.sqrt(np.mean(np.sum(off**2, axis=2))))


def _commands(pull: Floats) -> Floats:
    """Return the commands (K, 2) mm of pairs whose cables are shortened by `pull` (K, 4)."""
    first, second = pull[:, :2], pull[:, 2:]
    return np.where(first >= second, first, -second)


@lru_cache(maxsize=1)
def _first() -> Simulator:
    return Simulator(Finger.builtin())


def _plain() -> Finger:
    finger = Finger.builtin()
    return finger.replace(solid=finger.solid.along(LAYERS), young_mpa=finger.young_mpa * SOFTER)


@lru_cache(maxsize=1)
def _second() -> Simulator:
    return Simulator(_plain(), template=_first().template)


@lru_cache(maxsize=2)
def _made(laws: tuple[Law, ...]) -> Simulator | None:
    """Return the second finger as `laws` make it, from the rod's design.

    None where they leave its body.
    """
    before = after = section.finger(1)
    for law in laws:
        after = law.design(after)
    if after is before:
        return None
    finger, ratio = _plain(), np.log(after.young / before.young)
    x, y, _ = before.fibres()
    side = float(np.degrees(np.arctan2(np.sum(ratio * y), np.sum(ratio * x))))
    towards = before.half(np.radians(side)) > 0.0
    edges = np.linspace(0.0, before.place[-1], SLICES + 1)
    regions = []
    for low, high in zip(edges[:-1], edges[1:]):
        here = (before.middle >= low) & (before.middle < high)
        for mask, angle in ((towards, side), (~towards, side + 180.0)):
            young = finger.young_mpa * np.exp(ratio[here][mask[here]].mean())
            regions.append(
                Region(
                    float(young),
                    z=(float(low), float(high)),
                    side_deg=(angle + 180.0) % 360.0 - 180.0,
                )
            )
    turned = [
        np.arctan2(a[:, 1], a[:, 0]) - np.arctan2(b[:, 1], b[:, 0])
        for a, b in zip(after.guide, before.guide)
    ]
    tendons = []
    for tendon, angle in zip(finger.tendons, np.degrees(np.angle(np.exp(1j * np.array(turned))))):
        tendons.append(
            replace(
                tendon, angle_deg=tendon.angle_deg + angle[0], turn_deg=float(angle[-1] - angle[0])
            )
        )
    changed = finger.replace(
        regions=tuple(regions) if np.ptp(ratio) > 1e-9 else (),
        tendons=tuple(tendons),
        cable_stiffness_n_mm=float(after.cable.mean()),
        pretension_mm=float(-after.slack.mean()),
        bounds=(),  # those of a calibration of the first finger
    )
    return Simulator(changed, template=_first().template)


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


def _solved(simulator: Simulator, u: Floats, gravity: Floats, tip: Floats) -> Floats:
    """Return equilibria (K, N, 3) mm at commands (K, 2), each from a near one.

    Those of the last loads are known.
    """
    places, which = np.unique(np.round(u, SAME), axis=0, return_inverse=True)
    known = _known(simulator, tuple(gravity), tuple(tip))
    new = np.array([place for place in places if tuple(place) not in known]).reshape(-1, 2)
    if len(new):
        new = new[tour(new)]
        known.update(zip(map(tuple, new), simulator.path(new, gravity=gravity, load=tip)))
    return np.stack([known[tuple(place)] for place in places])[which.reshape(-1)]


@lru_cache(maxsize=4)
def _known(
    simulator: Simulator, gravity: tuple[float, ...], tip: tuple[float, ...]
) -> dict[tuple[float, ...], Floats]:
    """Return the equilibria (N, 3) mm found so far, by commands: runs often share parts."""
    return {}


@lru_cache(maxsize=4)
def _swept(orientation: int, steps: int) -> Any:
    """Return the function from commands (K, 2) mm to points (K, N, 3) mm.

    It is in one orientation of the protocols.
    """
    from scipy.interpolate import RectBivariateSpline

    axis = np.linspace(-REACH, REACH, steps)

    def make() -> dict[str, Any]:
        gravity = np.array((HANGING, LEANING)[orientation])
        values = np.asarray(_second().sweep([axis, axis], gravity=gravity).vertices, float).reshape(
            steps**2, -1
        )
        mean = values.mean(axis=0)
        left, size, modes = np.linalg.svd(values - mean, full_matrices=False)
        return {"mean": mean, "weights": (left * size)[:, :MODES], "modes": modes[:MODES]}

    # another simulator, another sweep
    probe = np.round(_second().path(np.array([[9.0, -4.0]])), 4).tobytes()
    table = kept(f"solid-{orientation}", (steps, SOFTER, LAYERS, REACH, probe), make)
    splines = [RectBivariateSpline(axis, axis, w.reshape(steps, steps)) for w in table["weights"].T]

    def points(u: Floats) -> Floats:
        weights = np.stack([spline(u[:, 0], u[:, 1], grid=False) for spline in splines], axis=1)
        return np.asarray((table["mean"] + weights @ table["modes"]).reshape(len(u), -1, 3))

    return points
