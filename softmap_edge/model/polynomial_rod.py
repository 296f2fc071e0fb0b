"""The polynomial rod in Python: chords whose bending angles are polynomials of the commands.

    v (rad) ≈ polynomial(q),   length (mm) ≈ quadratic(v),   q = (u_eff − centre)/scale

`rod/polynomial.py` fits its weights. Pinned by tests/rod/test_rod.py and
tests/rod/test_pulled_rod.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import SoftmapError
from softmap_edge.files.npz import Arrays
from softmap_edge.model.basis import RIDGE, Basis
from softmap_edge.model.elastic_rod import ElasticRodArrays

Floats = NDArray[np.float64]

MOST_INTERVALS = 64  # spline intervals per command
# servos hold, so a load bends each chord into an S and its ends keep their directions
LOCK = 1.0


@dataclass(frozen=True, eq=False)
class Weights:
    """A fitted polynomial rod.

    Attributes:
        centre, scale: of the commands, (C,).
        angles: weights (1 + F, 2K), rad.
        lengths: weights (1 + G, K), mm.
    """

    centre: Floats
    scale: Floats
    angles: Floats
    lengths: Floats


@dataclass(frozen=True, eq=False)
class PolynomialRodArrays:
    """The numbers of a polynomial rod.

    Attributes:
        base: (3,) mm.
        centre, scale: of the commands, (C,), in command units.
        degree: of the polynomial.
        angles: (1 + F, 2K) rad.
        lengths: (1 + G, K) mm.
        compliance: nominal, of its load fields, N⁻¹·mm⁻².
        lock: how far tendons hold each chord's mean bending against a load, from 0 (not at all) to
            1 (holding motors and inextensible tendons).
        pulled: whether the polynomial is in the pulls of two cables per command.
        intervals: of the splines, if the map is a sum of splines.
    """

    base: Floats
    centre: Floats
    scale: Floats
    degree: int
    angles: Floats
    lengths: Floats
    compliance: float
    lock: float = LOCK
    pulled: bool = False
    intervals: int = 0

    @property
    def basis(self) -> Basis:
        """The terms of its map."""
        return Basis(self.degree, self.pulled, self.intervals)

    def compiled(self) -> _core.Rod:
        """Return the compiled rod: commands (n, C) to markers (n, 3K) mm."""
        return compiled(
            Weights(self.centre, self.scale, self.angles, self.lengths), self.base, self.basis
        )

    def fields(self) -> dict[str, _core.RodField]:
        """Return its load fields by name, for a nominal weight of 1 N.

        Units: mm per N of tip force, mm per g.
        """
        rod = self.compiled()
        return {name: _core.RodField(rod, name, self.compliance, self.lock) for name in _core.LOADS}

    def to_npz(self) -> Arrays:
        """Return the arrays of `prior.npz`."""
        return {
            "base": self.base,
            "centre": self.centre,
            "scale": self.scale,
            "angles": self.angles,
            "lengths": self.lengths,
            "degree": np.array([self.degree]),
            "compliance": np.array([self.compliance]),
            "lock": np.array([self.lock]),
            "pulled": np.array([self.pulled]),
            "intervals": np.array([self.intervals]),
        }

    def __str__(self) -> str:
        """Return a one-line description."""
        return f"rod of {self.lengths.shape[1]} chords, {self.basis}"

    @classmethod
    def from_npz(cls, arrays: Mapping[str, NDArray[np.generic]]) -> PolynomialRodArrays:
        """Read the arrays of `prior.npz`.

        Raises:
            SoftmapError: an array is missing or has the wrong number of axes.
        """
        axes = {
            "base": 1,
            "centre": 1,
            "scale": 1,
            "angles": 2,
            "lengths": 2,
            "degree": 1,
            "compliance": 1,
            "lock": 1,
        }
        # absent from files of earlier versions
        axes |= {name: 1 for name in ("pulled", "intervals") if name in arrays}
        values: dict[str, Floats] = {}
        for name, ndim in axes.items():
            if name not in arrays or np.ndim(arrays[name]) != ndim:
                got = f"of {np.ndim(arrays[name])} axes" if name in arrays else "missing"
                raise SoftmapError(
                    f"rod: array '{name}' is {got}, expected {ndim} axes; learn the bundle again"
                )
            values[name] = np.ascontiguousarray(arrays[name], float)
        single = {name: values.pop(name).tolist() for name in ("degree", "compliance", "lock")}
        single |= {name: values.pop(name, np.zeros(1)).tolist() for name in ("pulled", "intervals")}
        for name, value in single.items():
            if len(value) != 1:
                raise SoftmapError(
                    f"rod: '{name}' holds {len(value)} numbers, expected one; learn the bundle "
                    "again"
                )
        (degree,), (compliance,), (lock,), (pulled,), (intervals,) = single.values()
        if not 0 <= intervals <= MOST_INTERVALS or intervals % 1:
            raise SoftmapError(
                f"rod: {intervals:g} intervals, expected 0 to {MOST_INTERVALS}; learn the bundle "
                "again"
            )
        if degree not in range(1, len(RIDGE) + 1):
            raise SoftmapError(
                f"rod: degree {degree}, expected 1 to {len(RIDGE)}; learn the bundle again"
            )
        return cls(
            degree=int(degree),
            compliance=compliance,
            lock=lock,
            pulled=pulled == 1.0,
            intervals=int(intervals),
            **values,
        )


def compiled(weights: Weights, base: Floats, basis: Basis) -> _core.Rod:
    """Return the compiled rod: commands (n, C) to markers (n, 3K) mm."""
    return _core.Rod(
        base,
        weights.centre,
        weights.scale,
        basis.degree,
        weights.angles,
        weights.lengths,
        basis.pulled,
        basis.intervals,
    )


RodArrays = ElasticRodArrays | PolynomialRodArrays


def read_rod(arrays: Mapping[str, NDArray[np.generic]]) -> RodArrays:
    """Read the rod of either kind from the arrays of `prior.npz`.

    Raises:
        SoftmapError: an array is missing, or holds values invalid for a rod.
    """
    if "numbers" in arrays:
        return ElasticRodArrays.from_npz(arrays)
    return PolynomialRodArrays.from_npz(arrays)
