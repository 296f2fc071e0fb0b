"""Hidden laws as in a workshop: own numbers per servo and cable, worn teeth, friction.

backlash          worn teeth: a gap for each servo that changes along the turn
friction          in the sheaths: each cable Dahl's law with a limit that grows with its own pull
body_friction     in the guides along the body, capstan by capstan: hysteretic in shape
                  (`friction_rod.py`)
hysteresis        Bouc-Wen with other shares for each servo
dead_zone         each of the four cables too long by another length, in the equilibrium
gain              drums of other radii, their levers arcs
cable_gain        each of the four cables winds otherwise: an odd and an even part
tendon_stretch    each of the four cables softer by another factor
offset            cut to other lengths, one by one
lag, rate_limit   position loops of other speeds; one servo with less voltage
creep             other compliances for each channel
tendon_creep      each cable another loss
saturation        one servo meets its stop early, or both at other places
coupling          one guide drags its neighbour, hardly the other way round

The names of the library that are right for each are in `answers.py`. Units: s, mm. Pinned by
tests/benches/test_bank_shop.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from benches.bank.body_rod import guessed
from benches.bank.friction_rod import along
from benches.bank.law import Floats, Law, Numbers, Past, Record, slow
from benches.bank.laws_body import (
    Askew,
    BoucWen,
    Curled,
    Drifting,
    Falling,
    Hung,
    OgdenRoxburgh,
    Prony,
    Warm,
)
from benches.bank.laws_drive import (
    CableCreep,
    Drag,
    Horns,
    LetsGo,
    Lever,
    LongCables,
    Motor,
    Packets,
    SoftCables,
    Stops,
)


def unequal(rng: np.random.Generator, count: int, least: float = 0.15) -> Numbers:
    """Draw one number each, the largest 1 and the others anywhere from `least`."""
    size = rng.uniform(least, 1.0, count)
    size[rng.integers(count)] = 1.0
    return tuple(size)


@dataclass(frozen=True)
class WornGear(Law):
    """Play of each servo; its half gap is w (1 + 0.2 cos(y/R + φ)) at the gear's position y."""

    NAME, STRONG, LIMIT = "backlash", ("half_gap_mm",), 6.0
    half_gap_mm: Numbers
    radius_mm: float
    phase: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        gap = 0.6 * np.array(unequal(rng, channels, 0.0 if rng.uniform() < 0.3 else 0.2))
        return cls(
            tuple(gap), float(rng.uniform(6.0, 10.0)), tuple(rng.uniform(0, 2 * np.pi, channels))
        )

    def drive(self, record: Record, u: Floats) -> Floats:
        out = np.empty_like(u)
        for c, column in enumerate(u.T):
            y, line, phase = float(column[0]), [], self.phase[c]
            for want in column.tolist():
                half = self.half_gap_mm[c] * (1.0 + 0.2 * np.cos(y / self.radius_mm + phase))
                y = min(max(y, want - half), want + half)
                line.append(y)
            out[:, c] = line
        return out


@dataclass(frozen=True)
class SheathFriction(Law):
    """d_i − μ_i (⟨d_i⟩ + d₀) z_i, z_i by Dahl over 2/(1 − μ_i) of that limit; four cables.

    Each cable has its own numbers.

    Over less of it, a cable would move on while its servo turns back.
    """

    NAME, STRONG, LIMIT = "friction", ("mu",), 5.0
    mu: Numbers
    start_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(
            tuple(0.12 * np.array(unequal(rng, 2 * channels, 0.3))), float(rng.uniform(1.5, 3.0))
        )

    def pull(self, record: Record, d: Floats) -> Floats:
        limit = np.array(self.mu) * (np.maximum(d, 0.0) + self.start_mm)
        over = np.maximum(2.0 * limit / np.maximum(1.0 - np.array(self.mu), 0.1), 1e-9)
        z, out = np.zeros(d.shape[1]), d.copy()
        for k, step in enumerate(np.diff(d, axis=0)):
            sign = np.sign(step)
            slid = sign + (z - sign) * np.exp(-np.abs(step) / over[k + 1])
            z = np.where(sign == 0.0, z, slid)
            out[k + 1] -= limit[k + 1] * z
        return out


@dataclass(frozen=True)
class GuideFriction(Law):
    """Capstan after capstan along the body, each cable with a different μ."""

    NAME, STRONG, SHAPE, LIMIT = "body_friction", ("mu", "tight"), True, 3.5
    mu: Numbers
    tight: float
    give_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        mu = tuple(0.2 * np.array(unequal(rng, 2 * channels, 0.6)))
        return cls(mu, float(rng.uniform(0.005, 0.02)), float(rng.uniform(0.2, 0.5)))

    def tension(self, past: Past) -> Floats:
        return along(np.array(self.mu), self.tight, self.give_mm, past, guessed)


@dataclass(frozen=True)
class UnevenWen(BoucWen):
    """Bouc-Wen, a different share for each servo."""

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        share = tuple(0.3 * np.array(unequal(rng, channels)))
        return cls(
            share,
            float(rng.uniform(3.0, 5.0)),
            float(rng.uniform(0.8, 1.5)),
            float(rng.uniform(0.4, 0.6)),
        )


@dataclass(frozen=True)
class UnevenSlack(LongCables):
    """Cables that are too long at rest, each by a different length."""

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(np.array(unequal(rng, 2 * channels, 0.25))))


@dataclass(frozen=True)
class Drums(Lever):
    """Drums of other radii."""

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        sign = rng.choice([-1.0, 1.0], channels)
        return cls(tuple(0.12 * sign * unequal(rng, channels)), float(rng.uniform(60.0, 90.0)))


@dataclass(frozen=True)
class CableDrums(Law):
    """d_i + g_i R sin(d_i/R), four cables, four numbers."""

    NAME, STRONG = "cable_gain", ("excess",)
    excess: Numbers
    lever_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        sign = rng.choice([-1.0, 1.0])
        return cls(
            tuple(0.12 * sign * np.array(unequal(rng, 2 * channels))),
            float(rng.uniform(60.0, 90.0)),
        )

    def pull(self, record: Record, d: Floats) -> Floats:
        return np.asarray(d + np.array(self.excess) * self.lever_mm * np.sin(d / self.lever_mm))


@dataclass(frozen=True)
class UnevenStretch(SoftCables):
    """Four cables, each softer by a different factor."""

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(2.0 * np.array(unequal(rng, 2 * channels, 0.3))))


@dataclass(frozen=True)
class CutLengths(Horns):
    """Four cables, each cut to a different length."""

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        shift = np.array(unequal(rng, channels, 0.3)) * rng.choice([-1.0, 1.0], channels)
        return cls(tuple(np.concatenate([shift, -shift * rng.uniform(0.7, 1.0, channels)])))


@dataclass(frozen=True)
class UnevenLoop(Law):
    """Two poles for each servo, τ and τ/3."""

    NAME, STRONG, LIMIT = "lag", ("tau_s",), 3.5
    tau_s: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(0.2 * np.array(unequal(rng, channels, 0.3))))

    def drive(self, record: Record, u: Floats) -> Floats:
        lines = [
            slow(record.t, slow(record.t, u[:, c], tau), tau / 3)
            for c, tau in enumerate(self.tau_s)
        ]
        return np.stack(lines, axis=1)


@dataclass(frozen=True)
class WeakServo(Law):
    """One motor is slower than the other (`Motor` of slice A for each)."""

    NAME, STRONG, LIMIT = "rate_limit", ("slowness",), 12.0
    slowness: Numbers  # s/mm

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(np.array(unequal(rng, channels, 0.4)) / 20.0))

    def drive(self, record: Record, u: Floats) -> Floats:
        return np.concatenate(
            [Motor(s).drive(record, u[:, c : c + 1]) for c, s in enumerate(self.slowness)], axis=1
        )


@dataclass(frozen=True)
class UnevenProny(Prony):
    """Creep by three terms, a different compliance for each channel."""

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        weight = np.array([0.3, 0.45, 0.25]) * rng.uniform(0.8, 1.25, 3)
        share = tuple(0.18 * np.array(unequal(rng, channels)))
        return cls(share, float(rng.uniform(3.0, 8.0)), tuple(weight / weight.sum()))


@dataclass(frozen=True)
class UnevenCableCreep(CableCreep):
    """A different loss for each cable."""

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(
            tuple(0.15 * np.array(unequal(rng, 2 * channels, 0.3))), float(rng.uniform(10.0, 30.0))
        )


@dataclass(frozen=True)
class UnevenStops(Stops):
    """One servo meets its stop early, the other late or never."""

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        lost = 4.0 * np.array(unequal(rng, channels, 0.0 if rng.uniform() < 0.4 else 0.3))
        return cls(tuple(lost), float(rng.uniform(0.15, 0.4)))


@dataclass(frozen=True)
class OneWayDrag(Drag):
    """One guide drags its neighbour; there is hardly any drag in the other direction."""

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        sign = rng.choice([-1.0, 1.0], channels)
        return cls(tuple(0.14 * sign * unequal(rng, channels, 0.05)))


SHOP: tuple[type[Law], ...] = (
    WornGear,
    SheathFriction,
    UnevenSlack,
    Drums,
    GuideFriction,
    UnevenWen,
    UnevenLoop,
    CableDrums,
    UnevenProny,
    OneWayDrag,
    UnevenStretch,
    CutLengths,
    UnevenStops,
    Packets,
    OgdenRoxburgh,
    UnevenCableCreep,
    LetsGo,
    WeakServo,
    Hung,
    Warm,
    Curled,
    Askew,
    Drifting,
    Falling,
)
