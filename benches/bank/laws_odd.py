"""What a diagnosis meets outside the textbook: unknown laws, drifts, chance, wrong models, robots that stand.

Laws with a family
    hum              A sin(2π f t) on one channel, 0.13 to 3 Hz
    stick_slip       the drive stands until it is w behind, then jumps to where it should be, but for a rest
    overshoot        y = u + a (u − play(u))
    stribeck         −F sgn(v) (1 + e^{−(v/v₀)²}), smoothed at rest
    speedy_play      play whose gap grows with speed
    snap             a buckled guide: A (1 + tanh(·)) that trips at one command and back at another
    hooked           play of one channel drags the other
    fading_memory    u (1 + a e^{−since/τ}), since the last reversal: gain that recovers after a turn
    rate_square      u − c v|v|
    rate_bend        u − c v |u|
    warm_creep       creep whose strength follows the temperature
    bimetal          an offset that follows the temperature of the body
    warm_play        play that grows with the temperature
    big_creep        creep that grows with the square of the bend
    fatigue          gain that falls with the path travelled
    torn             one cable tears at one instant
    clutch           the drum slips a little each time it is pulled beyond a limit, and stays there
    mounted_gain     other gains in the other mounting
    held             the servo takes a new command twice a second only
    steps            commands rounded to a grid

Drifts, chance and faults
    frame_noise      the frame wanders, with a memory or without end
    bending_noise    the body bends by itself, with a memory or without end
    timely_gain      gain along a line, a step or an exponential in time
    other_modulus, longer_body, mixed_channels   another robot than the model's
    still, stuck     the drive is off, or off for a part of the run

Units: s, mm, °C. Randomness only from the generator that is given, or from a stored seed. Pinned by
tests/test_bank_odd.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from benches.bank.law import Floats, Law, Numbers, Record, slow
from benches.bank.rotations import turn
from benches.bank.section import Design


def step_s(record: Record) -> float:
    """Return the time between two rows of a record, s."""
    return float((record.t[-1] - record.t[0]) / (len(record.t) - 1))


def speed(record: Record, u: Floats) -> Floats:
    """Return the speed (T, C) mm/s of commands, over 60 ms."""
    kernel = np.ones(3) / 3.0
    padded = np.pad(np.diff(u, axis=0, prepend=u[:1]), ((1, 1), (0, 0)), mode="edge") / step_s(record)
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


def wandering(t: Floats, memory_s: float, count: int, seed: int) -> Floats:
    """Return `count` Ornstein-Uhlenbeck processes of variance 1 at t (T,) s, from zero; without end for infinity.

    A walk without end has the variance t/100 s.
    """
    rng = np.random.default_rng(seed)
    gap = np.diff(t, prepend=t[0])
    if np.isinf(memory_s):
        return np.asarray(np.cumsum(rng.normal(size=(len(t), count)) * np.sqrt(gap / 100.0)[:, None], axis=0))
    out, state = np.empty((len(t), count)), rng.normal(size=count)
    for k, keep in enumerate(np.exp(-gap / memory_s)):
        state = keep * state + np.sqrt(1.0 - keep * keep) * rng.normal(size=count)
        out[k] = state
    return out - out[0] if memory_s > 2.0 else out


def _one(rng: np.random.Generator, channels: int) -> Numbers:
    """Draw one channel that acts alone, or all with other strengths."""
    size = rng.uniform(0.4, 1.0, channels) if rng.uniform() < 0.5 else np.eye(channels)[int(rng.integers(channels))]
    return tuple(size / size.max())


# --- laws with a family -------------------------------------------------------------------------


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
        return cls(tuple(size), float(0.13 * (3.0 / 0.13) ** rng.uniform()), float(rng.uniform(0, 2 * np.pi)))

    def drive(self, record: Record, u: Floats) -> Floats:
        return np.asarray(u + np.array(self.size_mm) * np.sin(2 * np.pi * self.hertz * record.t + self.phase)[:, None])


@dataclass(frozen=True)
class StickSlip(Law):
    """y stands while |u − y| ≤ w, else jumps to u, but for `rest` of the gap."""

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
        return cls(_one(rng, channels), float(rng.uniform(5.0, 20.0)))

    def drive(self, record: Record, u: Floats) -> Floats:
        v = speed(record, u)
        return np.asarray(
            u - np.array(self.size_mm) * np.tanh(v / 0.5) * (1 + 2 * np.exp(-((v / self.at_mm_s) ** 2))) / 3
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
        return cls(2.0 * float(rng.choice([-1.0, 1.0])), c, d, up, up - float(rng.uniform(3.0, 6.0)))

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
    """u_c + a (u_d − play(u_d, w)): what one channel's play holds back pulls at the other."""

    NAME, STRONG = "hooked", ("share",)
    share: Numbers
    half_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(_one(rng, channels), float(rng.uniform(1.0, 2.5)))

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
        return cls(tuple(3.0 * np.array(_one(rng, channels))))

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
        return cls(tuple(3.0 * np.array(_one(rng, channels))))

    def drive(self, record: Record, u: Floats) -> Floats:
        v = slow(record.t, speed(record, u), 0.05) / 50.0
        return np.asarray(u - np.array(self.amount) * v * np.abs(u) / 6.0)


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
        return cls(tuple(0.4 * np.array(_one(rng, channels))), float(rng.uniform(4.0, 25.0)))

    def drive(self, record: Record, u: Floats) -> Floats:
        cubed = u**3 / 144.0
        return np.asarray(u + np.array(self.amount) * (slow(record.t, cubed, self.tau_s) - 0.5 * cubed))


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
        return np.asarray(u * (1.0 - self.amount * (path / max(float(path[-1]), 1e-9)) ** self.power)[:, None])


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
    """y = u − s, s follows so that |y| stays below a limit: a drum that slips and does not come back by itself."""

    NAME, STRONG, LIMIT = "clutch", ("lost_mm",), 9.0
    lost_mm: Numbers  # of a reach of 12 mm

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(_one(rng, channels))

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


# --- drifts, chance and faults ------------------------------------------------------------------


@dataclass(frozen=True)
class FrameNoise(Law):
    """The frame of the camera turns and shifts as `wandering`."""

    NAME, STRONG = "frame_noise", ("shift_mm", "turn_deg")
    shift_mm: float
    turn_deg: float
    memory_s: float
    seed: int

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        memory = float(rng.choice([10.0, 30.0, 80.0, np.inf]))
        return cls(0.4, 0.25, memory, int(rng.integers(2**31)))

    def seen(self, points: Floats, t: Floats) -> Floats:
        at = wandering(t, self.memory_s, 6, self.seed)
        turned = np.einsum("kij,knj->kni", turn(np.radians(self.turn_deg) * at[:, :3]), points)
        return np.asarray(turned + self.shift_mm * at[:, None, 3:])


@dataclass(frozen=True)
class BendingNoise(Law):
    """The body bends by itself, as if commands wandered."""

    NAME, STRONG = "bending_noise", ("size_mm",)
    size_mm: Numbers
    memory_s: float
    seed: int

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        memory = float(rng.choice([0.02, 0.3, 3.0, 20.0, np.inf]))
        return cls(_one(rng, channels), memory, int(rng.integers(2**31)))

    def drive(self, record: Record, u: Floats) -> Floats:
        return np.asarray(u + np.array(self.size_mm) * wandering(record.t, self.memory_s, u.shape[1], self.seed))


def profile(kind: str, t: Floats) -> Floats:
    """Return a course (T,) from 0 to 1 in time: a `ramp`, a `step` or an `exponential` approach."""
    share = (t - t[0]) / max(float(np.ptp(t)), 1e-9)
    return np.asarray(
        {"ramp": share, "step": (share > 0.55).astype(float), "exponential": -np.expm1(-4.0 * share)}[kind]
    )


@dataclass(frozen=True)
class TimelyGain(Law):
    """u (1 + a p(t)), p as `profile`."""

    NAME, STRONG = "timely_gain", ("amount",)
    amount: float
    course: str

    @classmethod
    def of(cls, course: str, rng: np.random.Generator) -> Self:
        """Draw the amount for one course."""
        return cls(0.2 * float(rng.choice([-1.0, 1.0])), course)

    def drive(self, record: Record, u: Floats) -> Floats:
        return np.asarray(u * (1.0 + self.amount * profile(self.course, record.t))[:, None])


@dataclass(frozen=True)
class OtherModulus(Law):
    """Another silicone."""

    NAME, STRONG, SHAPE = "other_modulus", ("log",), True
    log: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(float(rng.choice([-0.6, 0.5]) * rng.uniform(0.7, 1.3)))

    def design(self, design: Design) -> Design:
        return design.stiffer(np.full(len(design.radius), np.exp(self.log)))


@dataclass(frozen=True)
class LongerBody(Law):
    """A body that was drawn longer by a share, thinner by its root."""

    NAME, STRONG, SHAPE = "longer_body", ("more",), True
    more: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(0.12 * float(rng.choice([-1.0, 1.0])))

    def design(self, design: Design) -> Design:
        return replace(design, place=design.place * (1.0 + self.more), radius=design.radius / np.sqrt(1.0 + self.more))


@dataclass(frozen=True)
class MixedChannels(Law):
    """The horns stand turned: each servo drives a bit of the other's pair."""

    NAME, STRONG = "mixed_channels", ("turn_deg",)
    turn_deg: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(float(rng.choice([-1.0, 1.0]) * rng.uniform(12.0, 30.0)))

    def drive(self, record: Record, u: Floats) -> Floats:
        angle = np.radians(self.turn_deg)
        return np.asarray(np.cos(angle) * u + np.sin(angle) * np.roll(u, 1, axis=1) * np.array([-1.0, 1.0]))


@dataclass(frozen=True)
class Still(Law):
    """The drive was never engaged."""

    NAME, STRONG = "still", ()

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls()

    def drive(self, record: Record, u: Floats) -> Floats:
        return np.zeros_like(u)


@dataclass(frozen=True)
class Stuck(Law):
    """The drive stands where it was for a part of the run, then goes on."""

    NAME, STRONG = "stuck", ()
    start: float
    share: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(float(rng.uniform(0.2, 0.5)), float(rng.uniform(0.15, 0.35)))

    def drive(self, record: Record, u: Floats) -> Floats:
        since = (record.t - record.t[0]) / np.ptp(record.t)
        rows = np.flatnonzero((since >= self.start) & (since < self.start + self.share))
        out = u.copy()
        out[rows] = u[rows[0]]
        return out


UNKNOWN_LAWS: tuple[type[Law], ...] = (
    Hum, StickSlip, WarmCreep, SpeedyPlay, RateSquare, MountedGain, Fatigue, Torn, Overshoot, Hooked, Stribeck, Snap,
    BigCreep, Bimetal, FadingMemory, RateBend, WarmPlay, Clutch, Held, Steps,
)  # fmt: skip
