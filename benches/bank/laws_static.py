"""Smooth static maps of the command in no library: 15 forms, in several patterns.

On both channels, on one, or with other signs.

u + a h f(u/h; b, φ), h = 12 mm: a is the amount, b > 0 the sharpness, φ a phase. Each is zero at
home. `bent` is the part that offsets and gains cannot represent. It makes a map non-linear, and it
is what is scaled.

Units: mm. Randomness only from the given generator. Pinned by tests/benches/test_bank_odd.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from benches.bank.law import Floats, Law, Numbers, Record

H = 12.0  # mm
LEAST_SLOPE = 0.1  # mm/mm
# x (T, C), sharpness, phase → added mm per mm of amount
Form = Callable[[Floats, float, float], Floats]


def _knee(x: Floats, b: float, phase: float) -> Floats:
    soft, at = 0.1 + 0.3 / b, 0.3 * np.cos(phase)
    return np.asarray(soft * (np.logaddexp(0.0, (x - at) / soft) - np.logaddexp(0.0, -at / soft)))


def _bump(x: Floats, b: float, phase: float) -> Floats:
    at, wide = 0.6 * np.cos(phase), 0.35 + 0.5 / b
    return np.asarray(np.exp(-(((x - at) / wide) ** 2)) - np.exp(-((at / wide) ** 2)))


def _slopes(x: Floats, b: float, phase: float) -> Floats:
    at, wide = 0.3 * np.sin(phase), 0.4 + 0.6 / b
    return np.asarray(wide * (np.log(np.cosh((x - at) / wide)) - np.log(np.cosh(at / wide))))


def _mix(x: Floats, b: float, phase: float) -> Floats:
    c = np.cos(phase * np.arange(1.0, 5.0) * b)
    return np.asarray(sum(c[n] * x ** (n + 2) for n in range(4)))


def _crank(x: Floats, b: float, phase: float) -> Floats:
    def reach(angle: Floats | float) -> Floats:
        return np.asarray(np.sin(angle) + np.sqrt((1.5 + b) ** 2 - np.cos(angle) ** 2))

    start = 0.5 * np.sin(phase)
    return np.asarray((reach(start + 1.1 * x) - reach(start)) / np.cos(start) - 1.1 * x)


FORMS: dict[str, Form] = {
    "layered drum": lambda x, b, p: x * np.abs(x),
    "odd power": lambda x, b, p: x * np.abs(x) ** (0.4 + b),
    "even power": lambda x, b, p: (x * x + 0.04) ** (0.5 + b / 4) - 0.04 ** (0.5 + b / 4),
    "sinh": lambda x, b, p: np.sinh(b * x) / b - x,
    "cosh": lambda x, b, p: (np.cosh(b * x) - 1.0) / b,
    "tanh": lambda x, b, p: np.tanh(b * x) / b - x,
    "soft dead zone": lambda x, b, p: -x / (1.0 + (b * x) ** 2 * 4.0),
    "logarithm": lambda x, b, p: np.sign(x) * np.log1p(2 * b * np.abs(x)) / (2 * b) - x,
    "part of a turn": lambda x, b, p: np.sin((1.0 + b / 2) * x + p) - np.sin(p),
    "one-sided knee": _knee,
    "bump": _bump,
    "two slopes": _slopes,
    "polynomial": _mix,
    "crank": _crank,
    "gain by distance": lambda x, b, p: (
        x * np.sum(x * x, axis=1, keepdims=True) ** (b / 2) / 2.0 ** (b / 2)
    ),
}
CROSSED: dict[str, Callable[[Floats, Floats, float], Floats]] = {
    "other squared": lambda x, y, b: y * y,
    "product": lambda x, y, b: x * y,
    "other's size": lambda x, y, b: x * np.sqrt(y * y + 0.05 / b),
    "other cubed": lambda x, y, b: y * y * y,
    "other's square times own": lambda x, y, b: x * y * y,
    "soft neighbour": lambda x, y, b: np.tanh(2 * b * y) * (1.0 + 0.5 * x),
}


def bent(plain: Floats, mapped: Floats) -> float:
    """Return the part of mapped − plain (T, C) mm beyond offsets and gains, in RMS.

    Those are the channels' own.
    """
    more = mapped - plain
    left = np.empty_like(more)
    for c, (u, d) in enumerate(zip(plain.T, more.T)):
        columns = np.stack([np.ones_like(u), u], axis=1)
        left[:, c] = d - columns @ np.linalg.lstsq(columns, d, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2) / max(float(np.mean(more**2)), 1e-12)))


def rises(law: SmoothMap) -> bool:
    """Return whether a map rises everywhere: one that runs backwards is no smooth map."""
    u = np.linspace(-H, H, 241)[:, None] * np.ones((1, len(law.amount)))
    return bool(np.min(np.diff(u + law.added(u), axis=0)) > LEAST_SLOPE * 2 * H / 240)


@dataclass(frozen=True)
class SmoothMap(Law):
    """u_c + a_c h f(u/h); on the cables of one side alone where `cable` is set."""

    NAME, STRONG, LIMIT = "smooth_map", ("amount",), 30.0
    form: str
    amount: Numbers
    sharp: float
    phase: float
    cable: bool = False

    @classmethod
    def of(cls, number: int, rng: np.random.Generator, channels: int) -> Self:
        """Draw map `number`: all forms in turn, then patterns (equal, one, different, one side)."""
        names = list(FORMS)
        pattern = number // len(names) % 4
        size = np.array(
            [
                np.ones(channels),
                np.eye(channels)[number % channels],
                1.0 - 1.6 * np.eye(channels)[0],
                rng.uniform(0.4, 1.0, channels),
            ]
        )[pattern]
        sign = float(rng.choice([-1.0, 1.0]))
        return cls(
            names[number % len(names)],
            tuple(0.1 * sign * size),
            float(rng.uniform(0.6, 2.2)),
            float(rng.uniform(0, 2 * np.pi)),
            pattern == 3,
        )

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls.of(int(rng.integers(60)), rng, channels)

    def scaled(self, s: float) -> Self:
        """Return the same map, s times as strong, or as strong as it can be while rising."""
        law = super().scaled(s)
        while not rises(law):
            law = Law.scaled(law, 0.9)
        return law

    def added(self, u: Floats) -> Floats:
        """Return what the map adds (T, C) mm to u."""
        return np.asarray(
            np.array(self.amount) * H * FORMS[self.form](u / H, self.sharp, self.phase)
        )

    def drive(self, record: Record, u: Floats) -> Floats:
        return u if self.cable else np.asarray(u + self.added(u))

    def pull(self, record: Record, d: Floats) -> Floats:
        if not self.cable:
            return d
        half = d.shape[1] // 2
        return np.concatenate([d[:, :half] + self.added(d[:, :half]), d[:, half:]], axis=1)


@dataclass(frozen=True)
class CrossTerm(Law):
    """u_c + a_c h f(u_c/h, u_d/h), d the next channel."""

    NAME, STRONG, LIMIT = "cross_term", ("amount",), 6.0
    form: str
    amount: Numbers
    sharp: float

    @classmethod
    def of(cls, number: int, rng: np.random.Generator, channels: int) -> Self:
        """Draw cross term `number`: the forms go round, then one channel or both."""
        names = list(CROSSED)
        both = number // len(names) % 2
        size = np.ones(channels) if both else np.eye(channels)[number % channels]
        return cls(
            names[number % len(names)],
            tuple(0.1 * size * rng.choice([-1.0, 1.0], channels)),
            float(rng.uniform(0.6, 2.2)),
        )

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls.of(int(rng.integers(12)), rng, channels)

    def drive(self, record: Record, u: Floats) -> Floats:
        added = CROSSED[self.form](u / H, np.roll(u, 1, axis=1) / H, self.sharp)
        return np.asarray(u + np.array(self.amount) * H * added)
