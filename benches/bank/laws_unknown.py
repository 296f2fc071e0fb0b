"""Causes outside any library: does a diagnosis report an unexplained error?

    frayed_cable   one cable rubs through and grows longer by a step after each so many mm of travel
                   under load
    chatter        stick-slip: after each reversal the drive rings at a few hertz and dies out
    leaking_cell   a cell on one side, filled by each stroke beyond a size, leaks for half a minute
    magnet         a magnet beside the tip: a force that falls with the fourth power of the distance
    crack  one element torn on one side: its fibres carry nothing when drawn, all when pressed
    gate           a cam that shifts the spool only while both channels are pulled and the last move
                   was outwards

Units: s, mm, N. Pinned by tests/benches/test_bank.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from benches.bank.law import Floats, Law, Record, chosen
from benches.bank.rod import Loads, Poses
from benches.bank.section import Design


@dataclass(frozen=True)
class Frayed(Law):
    """Longer by δ after each `every_mm` of travel of one cable under load."""

    NAME, STRONG, LIMIT = "frayed_cable", ("step_mm",), 6.0
    cable: int
    every_mm: float
    step_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(int(rng.integers(2 * channels)), float(rng.uniform(25.0, 45.0)), 0.5)

    def pull(self, record: Record, d: Floats) -> Floats:
        mine = d[:, self.cable]
        travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(mine)) * (mine[1:] > 1.0))])
        out = d.copy()
        out[:, self.cable] -= self.step_mm * np.floor(travel / self.every_mm)
        return out


@dataclass(frozen=True)
class Chatter(Law):
    """A sin(2π f τ) e^{−τ/T}, τ since the last reversal of each channel, |v| above 2 mm/s."""

    NAME, STRONG, LIMIT = "chatter", ("size_mm",), 5.0
    size_mm: float
    hertz: float
    decay_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(1.5, float(rng.uniform(0.5, 1.2)), float(rng.uniform(1.5, 3.0)))

    def drive(self, record: Record, u: Floats) -> Floats:
        out = u.copy()
        step = (record.t[-1] - record.t[0]) / (len(record.t) - 1)
        for c, column in enumerate(u.T):
            since, way, ring = 1e9, 0.0, np.zeros(len(u))
            for k in range(1, len(u)):
                speed = (column[k] - column[k - 1]) / step
                since += step
                if abs(speed) > 2.0 and speed * way <= 0.0:
                    since, way = 0.0, np.sign(speed)
                ring[k] = (
                    way
                    * np.sin(2 * np.pi * self.hertz * since)
                    * np.exp(-min(since / self.decay_s, 50.0))
                )
            out[:, c] += self.size_mm * ring
        return out


@dataclass(frozen=True)
class Leak(Law):
    """u + A p towards one side.

    p' = (1 − p)/0.3 s where |u| of either channel is beyond `beyond_mm`, else −p/τ.
    """

    NAME, STRONG, LIMIT = "leaking_cell", ("size_mm",), 5.0
    size_mm: float
    towards: float
    beyond_mm: float
    tau_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(
            3.0,
            float(rng.uniform(0, 2 * np.pi)),
            float(rng.uniform(8.0, 10.0)),
            float(rng.uniform(8.0, 15.0)),
        )

    def drive(self, record: Record, u: Floats) -> Floats:
        step = (record.t[-1] - record.t[0]) / (len(record.t) - 1)
        filling = np.any(np.abs(u) > self.beyond_mm, axis=1)
        p, cell = 0.0, np.zeros(len(u))
        for k, fills in enumerate(filling):
            p += step * ((1.0 - p) / 0.3 if fills else -p / self.tau_s)
            cell[k] = p
        way = np.array([np.cos(self.towards), np.sin(self.towards)])
        return np.asarray(u + self.size_mm * cell[:, None] * np.resize(way, u.shape[1]))


@dataclass(frozen=True)
class Magnet(Law):
    """F = A (m − x)/|m − x| / (1 + (|m − x|/r)²)² on the tip, by its place without the magnet."""

    NAME, STRONG, SHAPE, LIMIT = "magnet", ("newton",), True, 6.0
    newton: float
    at_mm: tuple[float, float, float]
    reach_mm: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        angle = rng.uniform(0, 2 * np.pi)
        return cls(
            0.5, (38 * np.cos(angle), 38 * np.sin(angle), 118.0), float(rng.uniform(12.0, 18.0))
        )

    def loads(self, loads: Loads, poses: Poses | None) -> Loads:
        assert poses is not None
        way = np.array(self.at_mm) - poses.x[:, -1]
        far = np.linalg.norm(way, axis=1)[:, None]
        force = self.newton * way / np.maximum(far, 1.0) / (1.0 + (far / self.reach_mm) ** 2) ** 2
        return replace(loads, tip=loads.tip + force)


@dataclass(frozen=True)
class Crack(Law):
    """In `width` elements the fibres of one half keep e^{−a} of their stress when drawn."""

    NAME, STRONG, SHAPE, LIMIT = "crack", ("log",), True, 4.0
    log: float
    at_mm: float
    side: float

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(
            1.5, float(rng.uniform(20.0, 45.0)), float(rng.choice([0.0, 0.5, 1.0, 1.5]) * np.pi)
        )

    def design(self, design: Design) -> Design:
        near = np.abs(design.middle - self.at_mm) < 8.0
        return replace(design, torn=np.exp(-self.log * near[:, None] * design.half(self.side)))


@dataclass(frozen=True)
class Gate(Law):
    """u_c + A while |u_0 u_1| > 4 mm² and the last move was outwards, with 0.3 s to engage."""

    NAME, STRONG, LIMIT = "gate", ("size_mm",), 5.0
    size_mm: float
    channel: int

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Self:
        return cls(4.0, int(rng.integers(channels)))

    def drive(self, record: Record, u: Floats) -> Floats:
        step = (record.t[-1] - record.t[0]) / (len(record.t) - 1)
        size = np.linalg.norm(u, axis=1)
        outwards, on, out = False, 0.0, u.copy()
        both = np.prod(np.abs(u), axis=1) > 4.0
        for k in range(1, len(u)):
            if abs(size[k] - size[k - 1]) > 1e-9:
                outwards = bool(size[k] > size[k - 1])
            on += step / 0.3 * (float(both[k] and outwards) - on)
            out[k, self.channel] += self.size_mm * on
        return out


UNKNOWN: dict[str, type[Law]] = chosen((Frayed, Chatter, Leak, Magnet, Crack, Gate))
