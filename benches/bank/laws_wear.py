"""Laws of heat, wear and mounting that are in no library.

    warm_creep       creep whose strength follows the temperature
    bimetal          an offset that follows the temperature of the body
    warm_play        play that grows with the temperature
    big_creep        creep that grows with the cube of the bend
    fatigue          gain that falls with the path travelled
    torn             one cable tears at one instant
    clutch           the drum slips a little each time it is pulled beyond a limit, and stays there
    mounted_gain     different gains in the second mounting
    held             the servo takes a new command only twice a second
    steps            commands rounded to a grid

Units: s, mm, °C. Randomness only from the given generator. Pinned by
tests/benches/test_bank_odd.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from benches.bank.law import Floats, Law, Numbers, Record, slow
from benches.bank.laws_motion import played, some


@dataclass(frozen=True)
class WarmCreep(Law):
    """u + a (T − T₀)/9 (pole(u) − u/2)."""

    NAME, STRONG = "warm_creep", ("amount",)
    amount: float
    tau_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.4, float(rng.uniform(4.0, 12.0)))

    def drive(self, record: Record, u: Floats) -> Floats:
        warm = (record.temperature - record.temperature[0])[:, None] / 9.0
        return np.asarray(u + self.amount * warm * (slow(record.t, u, self.tau_s) - u))


@dataclass(frozen=True)
class Bimetal(Law):
    """u + A (1 − e^{−(T − T₀)/5}) one way, T late by 5 s."""

    NAME, STRONG = "bimetal", ("size_mm",)
    size_mm: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(rng.normal(size=channels)))

    def drive(self, record: Record, u: Floats) -> Floats:
        warm = slow(record.t, record.temperature - record.temperature[0], 5.0)
        return np.asarray(u - np.array(self.size_mm) * np.expm1(-warm / 5.0)[:, None])


@dataclass(frozen=True)
class WarmPlay(Law):
    """Play of half gap w (T − T₀)/9: brass and plastic."""

    NAME, STRONG = "warm_play", ("half_mm",)
    half_mm: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(rng.uniform(0.5, 1.5, channels)))

    def drive(self, record: Record, u: Floats) -> Floats:
        warm = np.maximum(record.temperature - record.temperature[0], 0.0)[:, None] / 9.0
        return played(u, np.array(self.half_mm) * warm)


@dataclass(frozen=True)
class BigCreep(Law):
    """u + a pole(u |u|²)/h²: creep of large bends."""

    NAME, STRONG = "big_creep", ("amount",)
    amount: Numbers
    tau_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(0.4 * np.array(some(rng, channels))), float(rng.uniform(4.0, 25.0)))

    def drive(self, record: Record, u: Floats) -> Floats:
        cubed = u**3 / 144.0
        return np.asarray(
            u + np.array(self.amount) * (slow(record.t, cubed, self.tau_s) - 0.5 * cubed)
        )


@dataclass(frozen=True)
class Fatigue(Law):
    """u (1 − a (S/S_end)^p), S the path of both channels."""

    NAME, STRONG, LIMIT = "fatigue", ("amount",), 3.0
    amount: float
    power: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.3, float(rng.uniform(0.6, 2.0)))

    def drive(self, record: Record, u: Floats) -> Floats:
        path = np.cumsum(np.abs(np.diff(record.u, axis=0, prepend=record.u[:1])).sum(axis=1))
        return np.asarray(
            u * (1.0 - self.amount * (path / max(float(path[-1]), 1e-9)) ** self.power)[:, None]
        )


@dataclass(frozen=True)
class Torn(Law):
    """From t* one cable pulls no farther than `left_mm`; stronger is less."""

    NAME, STRONG, LIMIT = "torn", ("lost_mm",), 12.0
    cable: int
    when: float
    lost_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(int(rng.integers(2 * channels)), float(rng.uniform(0.3, 0.6)), 1.0)

    def pull(self, record: Record, d: Floats) -> Floats:
        late = record.t > record.t[0] + self.when * np.ptp(record.t)
        out = d.copy()
        out[late, self.cable] = np.minimum(out[late, self.cable], 12.0 - self.lost_mm)
        return out


@dataclass(frozen=True)
class Clutch(Law):
    """y = u − s, s follows so that |y| stays below a limit: a drum that slips for good."""

    NAME, STRONG, LIMIT = "clutch", ("lost_mm",), 9.0
    lost_mm: Numbers  # of a reach of 12 mm

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(some(rng, channels))

    def drive(self, record: Record, u: Floats) -> Floats:
        out = np.empty_like(u)
        for c, (column, lost) in enumerate(zip(u.T, self.lost_mm)):
            hold, slipped, line = 12.0 - lost, 0.0, []
            for want in column.tolist():
                slipped = min(max(slipped, want - hold), want + hold)
                line.append(want - slipped)
            out[:, c] = line
        return out


@dataclass(frozen=True)
class MountedGain(Law):
    """u (1 ± a): more in the first mounting, less in the other."""

    NAME, STRONG = "mounted_gain", ("amount",)
    amount: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(0.1 * rng.uniform(0.5, 1.0, channels) * rng.choice([-1.0, 1.0])))

    def drive(self, record: Record, u: Floats) -> Floats:
        assert record.gravity is not None
        first = np.all(np.abs(record.gravity - record.gravity[0]) < 1e-9, axis=1)
        return np.asarray(u * (1.0 + np.where(first, 1.0, -1.0)[:, None] * np.array(self.amount)))


@dataclass(frozen=True)
class Held(Law):
    """The newest of the commands at multiples of the period; stronger is longer."""

    NAME, STRONG, LIMIT = "held", ("period_s",), 4.0
    period_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(float(rng.uniform(0.3, 0.6)))

    def drive(self, record: Record, u: Floats) -> Floats:
        since = record.t - record.t[0]
        every = max(self.period_s, 1e-6)
        held = np.floor(since / every + 1e-9) * every
        return np.stack([np.interp(held, since, column) for column in u.T], axis=1)


@dataclass(frozen=True)
class Steps(Law):
    """Commands rounded to a grid; stronger is coarser."""

    NAME, STRONG, LIMIT = "steps", ("grid_mm",), 5.0
    grid_mm: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(rng.uniform(1.0, 2.0, channels)))

    def drive(self, record: Record, u: Floats) -> Floats:
        grid = np.maximum(np.array(self.grid_mm), 1e-9)
        return np.asarray(np.round(u / grid) * grid)
