"""The sections of the bank's rod finger: incompressible rubber fibres, and four cables.

The cables go through guides.

A cross-section is an area of fibres along the rod, each of neo-Hookean rubber that keeps its volume
(Poisson 0.5):

    energy per volume  w = E/6 (λ² + 2/λ − 3),  stress  P = E/3 (λ − λ⁻²),  λ = 1 + ε + κx Y − κy X

integrated with 3 Gauss points in the squared radius and 12 in angle. Shear and torsion are linear
with G = E/3 and a shear factor of 0.9. Below λ = 0.35 the stress goes on in a straight line.
Lengths mm, E and stress MPa, forces N, angles rad. The numbers are those of
`softmap_edge/data/finger.toml`, read from it. Pinned by tests/benches/test_bank_rod.py.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

GRAVITY = 9.80665e-3  # N per g of mass
SHEAR = 0.9
FLOOR = 0.35
AROUND = 12


@dataclass(frozen=True, eq=False)
class Design:
    """One rod finger at rest: `place` (n+1,) mm of the nodes, and by element what it is made of.

    `radius` (n,) mm · `young` (n, F) MPa by fibre · `rest` (n, 3) rad/mm its own curvature and
    twist · `guide` (4, m, 3) mm where the cables run, from the axis, at the first m nodes · `cable`
    (4,) N/mm · `slack` (4,) mm by which each cable is too long at rest · `mass` (n+1,) g at the
    nodes · `torn` (n, F) share of the stress that a fibre carries when it is drawn, 1 in sound
    rubber.
    """

    place: Floats
    radius: Floats
    young: Floats
    rest: Floats
    guide: Floats
    cable: Floats
    slack: Floats
    mass: Floats
    torn: Floats | float = 1.0

    @property
    def length(self) -> Floats:
        """Return the length (n,) mm of the elements."""
        return np.diff(self.place)

    @property
    def middle(self) -> Floats:
        """Return where (n,) mm along the rod the middles of the elements are."""
        return (self.place[1:] + self.place[:-1]) / 2

    def fibres(self) -> tuple[Floats, Floats, Floats]:
        """Return place X, Y (n, F) mm and area (n, F) mm² of the fibres."""
        square, weight = np.polynomial.legendre.leggauss(3)
        # of the radius; equal weights of the square are equal areas
        share = np.sqrt((square + 1) / 2)
        angle = (np.arange(AROUND) + 0.5) * 2 * np.pi / AROUND
        r = np.repeat(share, AROUND)
        x, y = r * np.tile(np.cos(angle), 3), r * np.tile(np.sin(angle), 3)
        area = np.pi * np.repeat(weight / 2, AROUND) / AROUND
        return np.outer(self.radius, x), np.outer(self.radius, y), np.outer(self.radius**2, area)

    def stiffer(self, factor: Floats) -> Design:
        """Return the design with the modulus times `factor` (n,) or (n, F)."""
        factor = np.asarray(factor, dtype=np.float64)
        return replace(self, young=self.young * (factor[:, None] if factor.ndim == 1 else factor))

    def half(self, side: float) -> Floats:
        """Return (n, F) which fibres lie on the half that faces `side` rad about the axis."""
        x, y, _ = self.fibres()
        return np.asarray(x * np.cos(side) + y * np.sin(side) > 0.0, dtype=np.float64)

    def turned_guides(self, angle: Floats) -> Design:
        """Return the design with each cable's guides turned by `angle` rad about the axis.

        The angle is (4,) or (4, m).
        """
        a = np.broadcast_to(np.asarray(angle, float).reshape(4, -1), self.guide.shape[:2])
        c, s = np.cos(a), np.sin(a)
        x, y, z = np.moveaxis(self.guide, 2, 0)
        return replace(self, guide=np.stack([c * x - s * y, s * x + c * y, z], axis=2))


def uniform(
    length: float,
    radius: float,
    young: float,
    elements: int,
    cable: float = 0.0,
    aside: float = 0.0,
) -> Design:
    """Return a plain rod without weight; cables, if any, run `aside` mm off the axis to the tip."""
    place = np.linspace(0.0, length, elements + 1)
    n = elements
    return Design(
        place=place,
        radius=np.full(n, radius),
        young=np.full((n, 3 * AROUND), young),
        rest=np.zeros((n, 3)),
        guide=_routes(np.full(n + 1, aside)),
        cable=np.full(4, cable),
        slack=np.zeros(4),
        mass=np.zeros(n + 1),
    )


@lru_cache(maxsize=8)
def finger(refine: int = 2) -> Design:
    """Return the built-in finger as a rod: 16 elements to the anchors, 3 in the tip.

    Each is times `refine`.
    """
    table = _numbers()
    anchor = table["tendon"][0]["route_mm"][-1][0]
    profile = np.array(table["profile_mm"])
    below, above = (
        np.linspace(0.0, anchor, 16 * refine + 1),
        np.linspace(anchor, profile[-1, 0], 3 * refine + 1),
    )
    place = np.concatenate([below, above[1:]])
    middle, length = (place[1:] + place[:-1]) / 2, np.diff(place)
    radius = np.interp(middle, profile[:, 0], profile[:, 1])
    route = np.array(table["tendon"][0]["route_mm"])
    grams = table["material"]["density_kg_m3"] * 1e-6 * np.pi * radius**2 * length
    return Design(
        place=place,
        radius=radius,
        young=np.full((middle.size, 3 * AROUND), table["material"]["young_mpa"]),
        rest=np.zeros((middle.size, 3)),
        guide=_routes(np.interp(below, route[:, 0], route[:, 1])),
        cable=np.full(4, table["cable"]["stiffness_n_mm"]),
        slack=np.full(4, -table["cable"]["pretension_mm"]),
        mass=np.concatenate([grams, [0.0]]) / 2 + np.concatenate([[0.0], grams]) / 2,
    )


def _routes(aside: Floats) -> Floats:
    """Return guides (4, m, 3) mm at 0, 90, 180 and 270 degrees."""
    angle = np.arange(4) * np.pi / 2
    around = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    return np.asarray(aside[None, :, None] * np.round(around, 12)[:, None, :])


@lru_cache(maxsize=1)
def _numbers() -> dict[str, Any]:
    return tomllib.loads(
        files("softmap_edge").joinpath("data/finger.toml").read_text(encoding="utf-8")
    )
