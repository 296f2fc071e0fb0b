"""Hidden laws between the command and the cables: servo, spool, gear, cable.

offset            horns askew, each cable of a pair by another length, in encoder steps
gain              spool of another radius, its lever an arc: R sin(u/R)
latency           bus packets at a fixed period, each late by its own delay, held until the next
lag               position loop of second order, overdamped, with a cable drum behind it
rate_limit        speed = v tanh(e/(v τ)): a motor that runs out of voltage, not a clipped slope
saturation        soft end stop: the logarithm of exponentials
eccentric_pulley  true circle off its centre: A cos + A²/4ρ cos 2·, zero at home
servo_swap        plugs exchanged, or one reversed
backlash          gear in a gap with springy flanks and a damped follower, not a rigid play
friction          six Dahl elements along each cable, their limit grows with the wrap before them
dead_zone         cables too long at rest: the solver's own slack, cable by cable
tendon_stretch    softer cables in the equilibrium of the body
tendon_creep      two Kelvin-Voigt terms in each cable that is pulled
coupling          a guide drags its neighbour: bilinear, not a matrix
anchor_slip       one cable lets go smoothly while it is pulled hard
clock_shift       frames labelled late, by a shift that wanders
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import tanh
from typing import Self

import numpy as np

from benches.bank.law import Floats, Law, Numbers, Record, chosen, per_channel, slow
from benches.bank.section import Design


@dataclass(frozen=True)
class Horns(Law):
    """d_c + round(s b_c)/s for each of the four cables."""

    NAME, STRONG = "offset", ("shift_mm",)
    shift_mm: Numbers  # of the four cables
    steps_per_mm: float = 280.0

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        pair = np.array(per_channel(rng, channels))
        return cls(tuple(np.concatenate([pair, -pair * rng.uniform(0.85, 1.0, channels)])))

    def pull(self, record: Record, d: Floats) -> Floats:
        return np.asarray(
            np.round((d + np.array(self.shift_mm)) * self.steps_per_mm) / self.steps_per_mm
        )


@dataclass(frozen=True)
class Lever(Law):
    """u + e R sin(u/R)."""

    NAME, STRONG = "gain", ("excess",)
    excess: Numbers
    lever_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(
            tuple(0.1 * np.array(per_channel(rng, channels))), float(rng.uniform(60.0, 90.0))
        )

    def drive(self, record: Record, u: Floats) -> Floats:
        return np.asarray(u + np.array(self.excess) * self.lever_mm * np.sin(u / self.lever_mm))


@dataclass(frozen=True)
class Packets(Law):
    """The newest packet that has arrived is held."""

    NAME, STRONG, LIMIT = "latency", ("delay_s",), 2.5
    delay_s: float
    period_s: float
    spread_s: float
    seed: int

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.15, float(rng.uniform(0.012, 0.025)), 0.008, int(rng.integers(2**31)))

    def drive(self, record: Record, u: Floats) -> Floats:
        t = record.t
        sent = np.arange(t[0], t[-1] + self.period_s, self.period_s)
        late = self.delay_s + self.spread_s * np.random.default_rng(self.seed).uniform(
            -1, 1, sent.size
        )
        arrives = np.maximum.accumulate(sent + np.maximum(late, 0.0))
        newest = np.searchsorted(arrives, t, side="right") - 1
        packets = np.stack([np.interp(sent, t, column) for column in u.T], axis=1)
        return np.where(newest[:, None] < 0, u[:1], packets[np.maximum(newest, 0)])


@dataclass(frozen=True)
class Loop(Law):
    """y'' = ω²(u − y) − 2ζω y', ω = 1/τ, exact for linear commands, then a drum with τ/4.

    They are linear between samples.
    """

    NAME, STRONG, LIMIT = "lag", ("tau_s",), 3.0
    tau_s: float
    damping: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.15, float(rng.uniform(1.3, 1.8)))

    def drive(self, record: Record, u: Floats) -> Floats:
        from scipy.signal import cont2discrete, lfilter

        step = (record.t[-1] - record.t[0]) / (len(record.t) - 1)
        omega = 1.0 / self.tau_s
        b, a, _ = cont2discrete(
            ([omega**2], [1.0, 2 * self.damping * omega, omega**2]), step, method="foh"
        )
        y = lfilter(np.ravel(b), a, u - u[0], axis=0) + u[0]
        return slow(record.t, y, self.tau_s / 4)


@dataclass(frozen=True)
class Motor(Law):
    """y' = v tanh((u − y)/(v τ)); stronger is slower."""

    NAME, STRONG, LIMIT = "rate_limit", ("slowness",), 12.0
    slowness: float  # s/mm, 1/v
    tau_s: float = 0.004

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(1.0 / 25.0)

    def drive(self, record: Record, u: Floats) -> Floats:
        speed, step = 1.0 / self.slowness, (record.t[-1] - record.t[0]) / (len(record.t) - 1)
        out = np.empty_like(u)
        for c, column in enumerate(u.T):
            y, line = float(column[0]), []
            for want in column.tolist():
                for _ in range(8):
                    y += step / 8 * speed * tanh((want - y) / (speed * self.tau_s))
                line.append(y)
            out[:, c] = line
        return out


@dataclass(frozen=True)
class Stops(Law):
    """w log((1 + e^{(u+c)/w})/(1 + e^{(u−c)/w})) − c: u within ±c, soft by w.

    A stronger one is a nearer stop.
    """

    NAME, STRONG, LIMIT = "saturation", ("lost_mm",), 2.4
    lost_mm: Numbers  # of a reach of 12 mm
    soft_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(
            tuple(4.0 * np.array(per_channel(rng, channels, False))), float(rng.uniform(0.15, 0.4))
        )

    def drive(self, record: Record, u: Floats) -> Floats:
        c, w = 12.0 - np.array(self.lost_mm), self.soft_mm
        return np.asarray(w * (np.logaddexp(0.0, (u + c) / w) - np.logaddexp(0.0, (u - c) / w)) - c)


@dataclass(frozen=True)
class OffCentre(Law):
    """A spool whose axis is off its centre by A."""

    NAME, STRONG, LIMIT = "eccentric_pulley", ("aside_mm",), 5.0
    aside_mm: float
    radius_mm: float
    phase: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.5, float(rng.uniform(2.0, 3.2)), tuple(rng.uniform(0, 2 * np.pi, channels)))

    def drive(self, record: Record, u: Floats) -> Floats:
        def wound(angle: Floats) -> Floats:
            second = self.aside_mm**2 / (4 * self.radius_mm) * np.cos(2 * angle)
            return np.asarray(self.aside_mm * np.sin(angle) + second)

        phase = np.array(self.phase)
        return np.asarray(u + wound(u / self.radius_mm + phase) - wound(phase))


@dataclass(frozen=True)
class Plugs(Law):
    """The plugs are exchanged, or one channel runs backwards."""

    NAME, STRONG = "servo_swap", ()
    which: int

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(int(rng.integers(0, channels + 1)))

    def drive(self, record: Record, u: Floats) -> Floats:
        if self.which == u.shape[1]:
            return np.asarray(u[:, ::-1])
        sign = np.ones(u.shape[1])
        sign[self.which] = -1.0
        return u * sign


@dataclass(frozen=True)
class Gear(Law):
    """y' = (e − clip(e, ±w))/τ, e = u − y: flanks with a spring, a follower with a damper."""

    NAME, STRONG, LIMIT = "backlash", ("half_gap_mm",), 5.0
    half_gap_mm: Numbers
    tau_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(
            tuple(0.6 * np.array(per_channel(rng, channels, False))),
            float(rng.uniform(0.002, 0.006)),
        )

    def drive(self, record: Record, u: Floats) -> Floats:
        step = (record.t[-1] - record.t[0]) / (len(record.t) - 1)
        keep, w = np.exp(-step / self.tau_s), np.array(self.half_gap_mm)
        y, out = u[0].copy(), np.empty_like(u)
        for k, want in enumerate(u):
            e = want - y
            y = y + (1.0 - keep) * (e - np.minimum(np.maximum(e, -w), w))
            out[k] = y
        return out


@dataclass(frozen=True)
class DahlElements(Law):
    """u − mean_j w_j z_j, z_j' = v/w_j (1 − z_j sgn v), w_j = μ (j/6)(|u| + u₀)."""

    NAME, STRONG, LIMIT = "friction", ("mu",), 6.0
    mu: Numbers
    start_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(
            tuple(0.15 * np.array(per_channel(rng, channels, False))), float(rng.uniform(1.0, 2.5))
        )

    def drive(self, record: Record, u: Floats) -> Floats:
        share = np.arange(1, 7) / 6.0
        z, out = np.zeros((u.shape[1], 6)), np.empty_like(u)
        out[0] = u[0]
        moved = np.diff(u, axis=0)
        # (T, C, 6)
        limit = np.array(self.mu)[:, None] * share * (np.abs(u)[..., None] + self.start_mm)
        for k, step in enumerate(moved):
            sign = np.sign(step)[:, None]
            keep = np.exp(-np.abs(step)[:, None] / limit[k + 1])
            z = np.where(sign == 0.0, z, sign + (z - sign) * keep)
            out[k + 1] = u[k + 1] - np.mean(limit[k + 1] * z, axis=1)
        return out


@dataclass(frozen=True)
class LongCables(Law):
    """Cables that are too long at rest."""

    NAME, STRONG, SHAPE, LIMIT = "dead_zone", ("slack_mm",), True, 5.0
    slack_mm: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(0.8 * rng.uniform(0.8, 1.2, 2 * channels)))

    def design(self, design: Design) -> Design:
        return replace(design, slack=design.slack + np.array(self.slack_mm))


@dataclass(frozen=True)
class SoftCables(Law):
    """k/(1 + s)."""

    NAME, STRONG, SHAPE, LIMIT = "tendon_stretch", ("softer",), True, 6.0
    softer: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(np.tile(2.0 * np.array(per_channel(rng, channels, False)), 2)))

    def design(self, design: Design) -> Design:
        return replace(design, cable=design.cable / (1.0 + np.array(self.softer)))


@dataclass(frozen=True)
class CableCreep(Law):
    """d − a ⟨d⟩ late by τ and by 5 τ, of cables that are pulled."""

    NAME, STRONG, LIMIT = "tendon_creep", ("loss",), 2.5
    loss: Numbers
    tau_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(
            tuple(np.tile(0.12 * np.array(per_channel(rng, channels, False)), 2)),
            float(rng.uniform(10.0, 30.0)),
        )

    def pull(self, record: Record, d: Floats) -> Floats:
        taut = np.maximum(d, 0.0)
        late = 0.6 * slow(record.t, taut, self.tau_s) + 0.4 * slow(record.t, taut, 5 * self.tau_s)
        return np.asarray(d - np.array(self.loss) * late)


@dataclass(frozen=True)
class Drag(Law):
    """u_i + c_i u_j (1 + |u_i|/40)."""

    NAME, STRONG, LIMIT = "coupling", ("share",), 2.5
    share: Numbers

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(tuple(0.12 * np.array(per_channel(rng, channels))))

    def drive(self, record: Record, u: Floats) -> Floats:
        return np.asarray(
            u + np.array(self.share) * np.roll(u, 1, axis=1) * (1.0 + np.abs(u) / 40.0)
        )


@dataclass(frozen=True)
class LetsGo(Law):
    """One cable grows by δ over a second of hard pulling after t*; the other stays wound."""

    NAME, STRONG, LIMIT = "anchor_slip", ("slip_mm",), 4.0
    cable: int
    when: float  # share of the record
    slip_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(int(rng.integers(2 * channels)), float(rng.uniform(0.25, 0.6)), 1.5)

    def pull(self, record: Record, d: Floats) -> Floats:
        step = (record.t[-1] - record.t[0]) / (len(record.t) - 1)
        hard = (d[:, self.cable] > 5.0) & (record.t > record.t[0] + self.when * np.ptp(record.t))
        gone = np.minimum(np.cumsum(hard) * step, 1.0)
        out = d.copy()
        out[:, self.cable] -= self.slip_mm * gone
        return out


@dataclass(frozen=True)
class WrongClock(Law):
    """Frames were taken before the time on their label, by a shift that wanders by a tenth."""

    NAME, STRONG, LIMIT = "clock_shift", ("shift_s",), 2.5
    shift_s: float
    phase: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.15, float(rng.uniform(0, 2 * np.pi)))

    def clock(self, t: Floats) -> Floats:
        return np.asarray(t - self.shift_s * (1.0 + 0.1 * np.sin(t / 40.0 + self.phase)))


DRIVE: dict[str, type[Law]] = chosen(
    (
        Horns,
        Lever,
        Packets,
        Loop,
        Motor,
        Stops,
        OffCentre,
        Plugs,
        Gear,
        DahlElements,
        LongCables,
        SoftCables,
        CableCreep,
        Drag,
        LetsGo,
        WrongClock,
    )
)
