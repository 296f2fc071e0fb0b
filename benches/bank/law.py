"""A hidden law of the bank: one cause, its place in the finger, and its strength.

    command ─drive─> spools (T, C) ─pull─> cables (T, 4) ─rod or finite elements (body, loads)─>
    points ─seen─> camera

A law overrides the one place where it acts. All memory starts in equilibrium with the first command
held for ever. Units: s, mm, g, °C, degrees. Randomness only from the generator that `draw` is
given. No law calls the effect library, and each has another form than the library's (the table in
docs/benchmarks/bank.md). Pinned by tests/benches/test_bank.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from benches.bank.rod import Loads, Poses
from benches.bank.section import Design

Floats = NDArray[np.float64]
Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Record:
    """The inputs of a law: t (T,) s, u (T, C) mm, temperature (T,) °C, gravity (T, 3) g."""

    t: Floats
    u: Floats
    temperature: Floats
    gravity: Floats | None = None


@dataclass(frozen=True, eq=False)
class Past:
    """History of the cables up to the seen frames.

    `t` (T,) s with even steps, `pull` (T, 4) mm, `gravity` (T, 3) g; `taken` (K,) s, when the
    frames were exposed.
    """

    t: Floats
    pull: Floats
    gravity: Floats
    taken: Floats


@dataclass(frozen=True)
class Law:
    """One hidden cause.

    `NAME` is the library's name for it, `STRONG` the fields that grow with strength.
    """

    NAME: ClassVar[str]
    STRONG: ClassVar[tuple[str, ...]]
    LIMIT: ClassVar[float] = 4.0  # the largest strength that is still plausible, of that as drawn
    ALSO: ClassVar[tuple[str, ...]] = ()  # effects of the library that it is as well
    # whether the body itself is another, so that a sweep of the plain one says nothing
    SHAPE: ClassVar[bool] = False

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        """Draw a character at about the middle of the plausible range."""
        raise NotImplementedError

    def scaled(self, s: float) -> Self:
        """Return the same law, s times as strong."""
        changed: dict[str, Any] = {}
        for name in self.STRONG:
            value = getattr(self, name)
            changed[name] = tuple(s * x for x in value) if isinstance(value, tuple) else s * value
        return replace(self, **changed)

    def drive(self, record: Record, u: Floats) -> Floats:
        """Return where the spools (T, C) mm are, from where they should be."""
        return u

    def pull(self, record: Record, d: Floats) -> Floats:
        """Return by how much the cables (T, 4) mm are shortened, from what the spools ask for."""
        return d

    def design(self, design: Design) -> Design:
        """Return what the rod is really made of."""
        return design

    def loads(self, loads: Loads, poses: Poses | None) -> Loads:
        """Return the true loads; `poses` are those of the finger without this law."""
        return loads

    def tension(self, past: Past) -> Floats | None:
        """Return the tension (K, 4, segments) along each cable at the seen frames.

        It is relative to that at its base.
        """
        return None

    def seen(self, points: Floats, t: Floats) -> Floats:
        """Return where points (K, N, 3) mm appear at t (K,) s."""
        return points

    def clock(self, t: Floats) -> Floats:
        """Return when frames (K,) s that are labelled t were really taken."""
        return t

    def params(self) -> dict[str, Any]:
        """Return the numbers of the law, units in the names."""
        return {
            k: [float(x) for x in v] if isinstance(v, tuple) else v for k, v in asdict(self).items()
        }


def per_channel(rng: np.random.Generator, channels: int, signs: bool = True) -> Numbers:
    """Draw one number a channel, sizes within 0.5..1, the largest 1.

    Signs are random, or all positive without `signs`.
    """
    size = rng.uniform(0.5, 1.0, channels)
    sign = rng.choice([-1.0, 1.0], channels) if signs else np.ones(channels)
    return tuple(size / size.max() * sign)


def slow(t: Floats, x: Floats, tau: float) -> Floats:
    """Return y (T, ...) with y' = (x − y)/τ, y(0) = x(0), exact for linear x.

    It is linear between even steps of t.
    """
    from scipy.signal import lfilter

    ratio = (t[-1] - t[0]) / (len(t) - 1) / max(tau, 1e-9)
    keep = np.exp(-ratio)
    mean = -np.expm1(-ratio) / ratio
    y = lfilter([1.0 - mean, mean - keep], [1.0, -keep], x - x[0], axis=0)
    return np.asarray(y + x[0])


def chosen(laws: Sequence[type[Law]]) -> dict[str, type[Law]]:
    """Return laws by name."""
    return {law.NAME: law for law in laws}
