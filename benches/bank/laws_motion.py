"""Laws of motion that are in no library: other memories, and other responses to speed.

    hum              A sin(2π f t) on one channel, 0.13 to 3 Hz
    stick_slip       the drive stands until it is w behind, then jumps almost to its target
    overshoot        y = u + a (u − play(u))
    stribeck         −F sgn(v) (1 + 2 e^{−(v/v₀)²})/3, smoothed at rest
    speedy_play      play whose gap grows with speed
    snap             a buckled guide: a shift that trips at one command and returns at another
    hooked           play of one channel drags the other
    fading_memory    u (1 + a e^{−path/p}), the path since the last reversal: a gain that recovers
                     after a turn
    rate_square      u − c v|v|
    rate_bend        u − c v |u|

Units: s, mm. Randomness only from the given generator. Pinned by tests/benches/test_bank_odd.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from benches.bank.law import Floats, Law, Numbers, Record, slow


def step_s(record: Record) -> float:
    """Return the time between two rows of a record, s."""
    return float((record.t[-1] - record.t[0]) / (len(record.t) - 1))


def speed(record: Record, u: Floats) -> Floats:
    """Return the speed (T, C) mm/s of commands, over 60 ms."""
    kernel = np.ones(3) / 3.0
    padded = np.pad(np.diff(u, axis=0, prepend=u[:1]), ((1, 1), (0, 0)), mode="edge") / step_s(
        record
    )
    return np.stack([np.convolve(column, kernel, mode="valid") for column in padded.T], axis=1)


def played(u: Floats, half: Floats) -> Floats:
    """Return u (T, C) behind a play of half gaps (T, C) or (C,) mm."""
    half = np.broadcast_to(half, u.shape)
    out = np.empty_like(u)
    for c in range(u.shape[1]):
        y, line = float(u[0, c]), []
        for want, w in zip(u[:, c].tolist(), half[:, c].tolist()):
            y = min(max(y, want - w), want + w)
            line.append(y)
        out[:, c] = line
    return out


def some(rng: np.random.Generator, channels: int) -> Numbers:
    """Draw one channel that acts alone, or all with different strengths."""
    size = (
        rng.uniform(0.4, 1.0, channels)
        if rng.uniform() < 0.5
        else np.eye(channels)[int(rng.integers(channels))]
    )
    return tuple(size / size.max())


@dataclass(frozen=True)
class Hum(Law):
    """u_c + A sin(2π f t + φ)."""

    NAME, STRONG = "hum", ("size_mm",)
    size_mm: Numbers
    hertz: float
    phase: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        size = np.eye(channels)[int(rng.integers(channels))]
        return cls(
            tuple(size),
            float(0.13 * (3.0 / 0.13) ** rng.uniform()),
            float(rng.uniform(0, 2 * np.pi)),
        )

    def drive(self, record: Record, u: Floats) -> Floats:
        return np.asarray(
            u
            + np.array(self.size_mm)
            * np.sin(2 * np.pi * self.hertz * record.t + self.phase)[:, None]
        )


@dataclass(frozen=True)
class StickSlip(Law):
    """y stands while |u − y| ≤ w, else jumps to u, except for `rest` of the gap."""

    NAME, STRONG = "stick_slip", ("width_mm",)
    width_mm: Numbers
    rest: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(1.5 * rng.uniform(0.6, 1.0, channels)), float(rng.uniform(0.0, 0.4)))

    def drive(self, record: Record, u: Floats) -> Floats:
        out = np.empty_like(u)
        for c, (column, width) in enumerate(zip(u.T, self.width_mm)):
            y, line = float(column[0]), []
            for want in column.tolist():
                if abs(want - y) > width:
                    y = want - self.rest * width * np.sign(want - y)
                line.append(y)
            out[:, c] = line
        return out


@dataclass(frozen=True)
class Overshoot(Law):
    """u + a (u − play(u, w))."""

    NAME, STRONG = "overshoot", ("amount",)
    amount: float
    half_mm: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(1.0, tuple(rng.uniform(0.4, 1.2, channels)))

    def drive(self, record: Record, u: Floats) -> Floats:
        return np.asarray(u + self.amount * (u - played(u, np.array(self.half_mm))))


@dataclass(frozen=True)
class Stribeck(Law):
    """u − F tanh(v/0.5) (1 + 2 e^{−(v/v₀)²})/3."""

    NAME, STRONG = "stribeck", ("size_mm",)
    size_mm: Numbers
    at_mm_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(some(rng, channels), float(rng.uniform(5.0, 20.0)))

    def drive(self, record: Record, u: Floats) -> Floats:
        v = speed(record, u)
        return np.asarray(
            u
            - np.array(self.size_mm)
            * np.tanh(v / 0.5)
            * (1 + 2 * np.exp(-((v / self.at_mm_s) ** 2)))
            / 3
        )


@dataclass(frozen=True)
class SpeedyPlay(Law):
    """Play of half gap a (w + |v|/v₀)."""

    NAME, STRONG = "speedy_play", ("amount",)
    amount: float
    least_mm: float
    per_mm_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(1.0, float(rng.uniform(0.05, 0.15)), float(rng.uniform(0.03, 0.06)))

    def drive(self, record: Record, u: Floats) -> Floats:
        return played(u, self.amount * (self.least_mm + self.per_mm_s * np.abs(speed(record, u))))


@dataclass(frozen=True)
class Snap(Law):
    """u_c + A s, s trips to 1 above u_d = up, back to 0 below u_d = down, within 0.1 s."""

    NAME, STRONG = "snap", ("size_mm",)
    size_mm: float
    channel: int
    watches: int
    up_mm: float
    down_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        up = float(rng.uniform(2.0, 5.0))
        c, d = int(rng.integers(channels)), int(rng.integers(channels))
        return cls(
            2.0 * float(rng.choice([-1.0, 1.0])), c, d, up, up - float(rng.uniform(3.0, 6.0))
        )

    def drive(self, record: Record, u: Floats) -> Floats:
        on, line = float(u[0, self.watches] > self.up_mm), []
        for want in u[:, self.watches].tolist():
            on = 1.0 if want > self.up_mm else 0.0 if want < self.down_mm else on
            line.append(on)
        out = u.copy()
        out[:, self.channel] += self.size_mm * slow(record.t, np.array(line), 0.05)
        return out


@dataclass(frozen=True)
class Hooked(Law):
    """u_c + a (u_d − play(u_d, w)): the part held back by one channel's play pulls at the other."""

    NAME, STRONG = "hooked", ("share",)
    share: Numbers
    half_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(some(rng, channels), float(rng.uniform(1.0, 2.5)))

    def drive(self, record: Record, u: Floats) -> Floats:
        held = u - played(u, np.full(u.shape[1], self.half_mm))
        return np.asarray(u + np.array(self.share) * np.roll(held, 1, axis=1))


@dataclass(frozen=True)
class FadingMemory(Law):
    """u (1 + a e^{−path/p}), the path travelled by a channel since its last reversal."""

    NAME, STRONG = "fading_memory", ("amount",)
    amount: float
    path_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.3 * float(rng.choice([-1.0, 1.0])), float(rng.uniform(2.0, 6.0)))

    def drive(self, record: Record, u: Floats) -> Floats:
        out = u.copy()
        for c, column in enumerate(u.T):
            path, way, gain, past = 1e3, 0.0, [], float(column[0])
            for now in column.tolist():
                moved, past = now - past, now
                if moved * way < 0.0:
                    path = 0.0
                way, path = (moved if moved else way), path + abs(moved)
                gain.append(np.exp(-path / self.path_mm))
            out[:, c] *= 1.0 + self.amount * np.array(gain)
        return out


@dataclass(frozen=True)
class RateSquare(Law):
    """u − c v|v|, v after a pole of 50 ms."""

    NAME, STRONG = "rate_square", ("amount",)
    amount: Numbers  # mm at 50 mm/s

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(3.0 * np.array(some(rng, channels))))

    def drive(self, record: Record, u: Floats) -> Floats:
        v = slow(record.t, speed(record, u), 0.05) / 50.0
        return np.asarray(u - np.array(self.amount) * v * np.abs(v))


@dataclass(frozen=True)
class RateBend(Law):
    """u − c v |u|/h: a damper that works in the bent finger alone."""

    NAME, STRONG = "rate_bend", ("amount",)
    amount: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(3.0 * np.array(some(rng, channels))))

    def drive(self, record: Record, u: Floats) -> Floats:
        v = slow(record.t, speed(record, u), 0.05) / 50.0
        return np.asarray(u - np.array(self.amount) * v * np.abs(u) / 6.0)
