"""Imperfections of a finger from a workshop: several small static errors, 0.2 to 0.4 mm.

That is their sum.

    clamp       turned and shifted              curl        slightly curved at rest
    lengths     each cable has its own length   drums       each has its own radius
    winding     u + a sin(u/R + φ) + b sin(2u/R + ψ) + c u|u|/R: rope over rope on a drum that is
                not round
    rubber      modulus that varies along the body and from side to side

A trace of memory, as in every drive, is added (play of 0.02 mm, half a percent of creep). The
static errors are drawn at sizes of equal displacement, and scaled together. Units: mm, degrees.
Randomness only from the given generator. Pinned by tests/benches/test_bank_shop.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from benches.bank.law import Floats, Law, Numbers, Record
from benches.bank.laws_body import Askew, Curled, Prony
from benches.bank.laws_drive import Gear, Horns
from benches.bank.laws_shop import CableDrums
from benches.bank.section import Design


@dataclass(frozen=True)
class Winding(Law):
    """u + a sin(u/R + φ) + b sin(2u/R + ψ) + c u|u|/R, zero at home."""

    NAME, STRONG = "winding", ("first_mm", "second_mm", "layers")
    first_mm: Numbers
    second_mm: Numbers
    layers: Numbers
    radius_mm: float
    phase: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        first, second, layers = (s * rng.normal(size=channels) for s in (0.08, 0.04, 0.01))
        phase = rng.uniform(0, 2 * np.pi, 2 * channels)
        return cls(
            tuple(first), tuple(second), tuple(layers), float(rng.uniform(2.5, 9.0)), tuple(phase)
        )

    def drive(self, record: Record, u: Floats) -> Floats:
        one, two = np.array(self.phase).reshape(2, -1)
        turn = u / self.radius_mm
        first = np.array(self.first_mm) * (np.sin(turn + one) - np.sin(one))
        second = np.array(self.second_mm) * (np.sin(2 * turn + two) - np.sin(two))
        return np.asarray(
            u + first + second + np.array(self.layers) * u * np.abs(u) / self.radius_mm
        )


@dataclass(frozen=True)
class Rubber(Law):
    """log E + Σ a_k sin(kπ s/L + φ_k) + Σ b_k cos(α − ψ_k) sin(kπ s/L).

    It varies along the body, and from side to side.
    """

    NAME, STRONG, SHAPE = "uneven_rubber", ("along", "across"), True
    along: Numbers
    across: Numbers
    phase: Numbers
    side: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        angles = rng.uniform(0, 2 * np.pi, (2, 3))
        along, across = 0.03 * rng.normal(size=3), 0.04 * rng.normal(size=3)
        return cls(tuple(along), tuple(across), tuple(angles[0]), tuple(angles[1]))

    def design(self, design: Design) -> Design:
        x, y, _ = design.fibres()
        at = np.pi * design.middle[:, None] / design.place[-1]
        log = np.zeros_like(x)
        for k, (a, b, phase, side) in enumerate(
            zip(self.along, self.across, self.phase, self.side), start=1
        ):
            towards = (x * np.cos(side) + y * np.sin(side)) / design.radius[:, None]
            log = log + a * np.sin(k * at + phase) + b * towards * np.sin(k * at)
        return design.stiffer(np.exp(log))


def static(rng: np.random.Generator, channels: int) -> tuple[Law, ...]:
    """Draw the static imperfections of one finger, each at about 0.1 mm."""
    angle = rng.uniform(0, 2 * np.pi)
    shift = 0.05 * rng.normal(size=channels)
    return (
        Winding.draw(rng, channels),
        Horns(tuple(np.concatenate([shift, -shift + 0.02 * rng.normal(size=channels)]))),
        CableDrums(tuple(0.012 * rng.normal(size=2 * channels)), 75.0),
        Curled((0.25 * np.cos(angle), 0.25 * np.sin(angle)), float(rng.uniform(-0.3, 0.6))),
        Rubber.draw(rng, channels),
        Askew(tuple(0.06 * rng.normal(size=3)), tuple(0.06 * rng.normal(size=3))),
    )


def traces(rng: np.random.Generator, channels: int) -> tuple[Law, ...]:
    """Draw the trace of memory of every drive."""
    gap = tuple(rng.uniform(0.005, 0.015, channels))
    compliance = tuple(rng.uniform(0.002, 0.005, channels))
    return Gear(gap, 0.002), Prony(compliance, float(rng.uniform(4, 8)), (0.3, 0.4, 0.3))
