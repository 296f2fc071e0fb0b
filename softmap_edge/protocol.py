"""The command records that show what a finger lacks: a standard protocol, and a run of another kind to judge by.

A protocol is a list of blocks: home revisits, triangles of growing size, small loops at two offsets,
diagonals, staircases with long dwells, fast triangles; each in two mounting orientations, because one cannot tell the
weight of the body from a weight at the tip. The other run holds circles, spirals and smooth random moves.
Units: s, mm of tendon shortening, gravity in g in the base frame. Limit: straight moves at constant speed, without the
ramps of a real servo; `tests/test_truth.py` pins the frame counts, speeds and coverage.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError

Floats = NDArray[np.float64]

RATE = 50.0  # Hz, rate at which commands are recorded
REACH = 12.0  # mm, largest command: leaves room for gain and offset inside a ±16 mm sweep
SLOW, FAST = 9.0, 55.0  # mm/s; at 55 mm/s a delay of 20 ms is 1.1 mm
DWELL = 7.0  # s, long enough to see creep
TURNING = 6.0  # s at home while the mounting is turned; no frame is taken
HANGING = (0.0, 0.0, 1.0)
LEAN, AZIMUTH = np.radians(35.0), np.radians(25.0)  # second mounting: off hanging, and out of the tendon planes
LEANING = (
    float(np.sin(LEAN) * np.cos(AZIMUTH)),
    float(np.sin(LEAN) * np.sin(AZIMUTH)),
    float(np.cos(LEAN)),
)


@dataclass(frozen=True)
class Protocol:
    """Commands to send and instants to look.

    `t` (T,) s, `command` (T, C) mm, `gravity` (T, 3) g in the base frame, `t_seen` (K,) s, `block` (K,) labels.
    """

    name: str
    t: Floats
    command: Floats
    gravity: Floats
    t_seen: Floats
    block: NDArray[np.str_]

    @property
    def frames(self) -> int:
        """Return the number of seen frames K."""
        return int(self.t_seen.size)


def standard_protocol(channels: int = 2, seed: int = 0, reach: float = REACH) -> Protocol:
    """Make the standard protocol: about 360 frames in 4 minutes, two orientations.

    Args: `channels` C ≥ 1; `seed` of the irregular frame times; `reach` mm, the largest command.
    Returns the protocol. Raises SoftmapError if channels or reach are not usable.
    """
    return _in_two_orientations("standard protocol", channels, seed, reach, _standard_blocks)


def other_protocol(channels: int = 2, seed: int = 0, reach: float = REACH) -> Protocol:
    """Make a run of another kind (circles, spirals, smooth random moves), to judge by what was never fitted.

    Args and errors as `standard_protocol`; returns about 240 frames in 2 minutes, the same two orientations.
    """
    return _in_two_orientations("another kind of run", channels, seed, reach, _other_blocks)


class _Tape:
    """Collects the corners of the command and the instants to look, one move after another."""

    def __init__(self, channels: int, reach: float, rng: np.random.Generator) -> None:
        self.channels, self.reach, self.rng = channels, reach, rng
        self.now = 0.0
        self.corners: list[tuple[float, Floats]] = [(0.0, np.zeros(channels))]
        self.turns: list[tuple[float, tuple[float, ...]]] = []
        self.seen: list[tuple[float, str]] = []

    @property
    def here(self) -> Floats:
        return self.corners[-1][1]

    def turn(self, gravity: tuple[float, ...]) -> None:
        """Turn the mounting half-way through a pause at home."""
        if self.turns:
            self.to(np.zeros(self.channels), SLOW, 0.0, "")
            self.hold(TURNING, 0.0, "")
        self.turns.append((self.now - TURNING / 2 if self.turns else 0.0, gravity))

    def look(self, start: float, end: float, rate: float, label: str) -> None:
        if rate <= 0.0:
            return
        last = self.seen[-1][0] if self.seen else -np.inf
        at = max(start, last) + self.rng.uniform(0.1, 0.6) / rate if last > start - 1.0 / rate else start + 0.3 / rate
        while at < end:
            self.seen.append((at, label))
            at += self.rng.uniform(0.75, 1.25) / rate

    def hold(self, seconds: float, rate: float, label: str) -> None:
        self.look(self.now, self.now + seconds, rate, label)
        self.now += seconds
        self.corners.append((self.now, self.here.copy()))

    def to(self, target: Floats, speed: float, rate: float, label: str) -> None:
        """Move straight to `target` mm; the fastest channel moves at `speed` mm/s."""
        samples = int(np.ceil(float(np.max(np.abs(target - self.here))) / speed * RATE - 1e-9))
        if samples <= 0:
            return
        seconds = samples / RATE
        self.look(self.now, self.now + seconds, rate, label)
        self.now += seconds
        self.corners.append((self.now, np.array(target, dtype=np.float64)))

    def follow(self, path: Callable[[Floats], Floats], seconds: float, rate: float, label: str) -> None:
        """Follow `path`: phase (n,) in 0..1 → command (n, C) mm."""
        steps = max(2, int(np.ceil(seconds * RATE)))
        phase = np.arange(1, steps + 1) / steps
        self.look(self.now, self.now + seconds, rate, label)
        for p, command in zip(phase, path(phase)):
            self.corners.append((self.now + p * seconds, command))
        self.now += seconds

    def axis(self, channel: int, value: float) -> Floats:
        target = np.zeros(self.channels)
        target[channel] = value
        return target

    def protocol(self, name: str) -> Protocol:
        times = np.array([time for time, _ in self.corners])
        corners = np.array([command for _, command in self.corners])
        t = np.arange(int(np.ceil(self.now * RATE)) + 1) / RATE
        command = np.stack([np.interp(t, times, corners[:, c]) for c in range(self.channels)], axis=1)
        gravity = np.empty((t.size, 3))
        for start, direction in self.turns:
            gravity[t >= start] = direction
        seen = np.array([time for time, _ in self.seen])
        block = np.array([label for _, label in self.seen])
        return Protocol(name, t, command, gravity, seen, block)


def _in_two_orientations(
    name: str, channels: int, seed: int, reach: float, blocks: Callable[[_Tape, int], None]
) -> Protocol:
    if channels < 1 or not 0.0 < reach < 1e3:
        raise SoftmapError(f"a protocol needs at least 1 channel and 0 < reach < 1000 mm, got {channels} and {reach}")
    tape = _Tape(channels, reach, np.random.default_rng([seed, len(name)]))
    for part, gravity in enumerate((HANGING, LEANING)):
        tape.turn(gravity)
        blocks(tape, part)
    return tape.protocol(name)


def _standard_blocks(tape: _Tape, part: int) -> None:
    home = np.zeros(tape.channels)
    tape.hold(5.0, 1.4, "home")
    for channel in range(tape.channels):
        _triangles(tape, channel)
    tape.hold(4.0, 1.6, "home")
    for channel in range(tape.channels):
        _small_loops(tape, channel)
    for sign in (1.0, -1.0):
        corner = 0.72 * tape.reach * np.array([1.0 if c % 2 == 0 else sign for c in range(tape.channels)])
        for target in (corner, -corner, home):
            tape.to(target, SLOW, 2.3, "diagonal")
    for channel in range(tape.channels):
        _staircase(tape, channel, 1.0 if part == 0 else -1.0)
    for channel in range(tape.channels):
        _fast_triangles(tape, channel)
    tape.hold(6.0, 1.2, "home")


def _triangles(tape: _Tape, channel: int) -> None:
    for size in (0.3, 0.62, 1.0):
        for end in (size, -size, 0.0):
            tape.to(tape.axis(channel, end * tape.reach), SLOW, 2.3, f"triangle[{channel}]")


def _small_loops(tape: _Tape, channel: int) -> None:
    for middle in (0.6, -0.4):
        for end in (middle - 0.12, middle + 0.12, middle - 0.12, middle):
            tape.to(tape.axis(channel, end * tape.reach), SLOW, 2.3, f"small loop[{channel}]")
    tape.to(np.zeros(tape.channels), SLOW, 2.3, f"small loop[{channel}]")


def _staircase(tape: _Tape, channel: int, sign: float) -> None:
    for level in (0.5, 1.0, 0.5, 0.0):
        tape.to(tape.axis(channel, sign * level * tape.reach), 2 * SLOW, 0.0, "")
        tape.hold(DWELL, 0.65, f"staircase[{channel}]")


def _fast_triangles(tape: _Tape, channel: int) -> None:
    for end in (0.85, -0.85, 0.85, -0.85, 0.0):
        tape.to(tape.axis(channel, end * tape.reach), FAST, 9.0, f"fast[{channel}]")
    tape.hold(1.2, 4.0, f"fast[{channel}]")


def _other_blocks(tape: _Tape, part: int) -> None:
    tape.hold(5.0, 1.6, "home")
    reach, shift = tape.reach, np.arange(tape.channels) * (np.pi / 2)

    def circle(phase: Floats) -> Floats:
        grow = np.minimum(1.0, 6.0 * np.minimum(phase, 1.0 - phase))
        return 0.75 * reach * grow[:, None] * np.sin(4 * np.pi * phase[:, None] + shift)

    def spiral(phase: Floats) -> Floats:
        return 0.95 * reach * np.sin(np.pi * phase)[:, None] * np.sin(-10 * np.pi * phase[:, None] + shift)

    tape.follow(circle, 14.0, 2.0, "circle")
    tape.follow(spiral, 20.0, 2.0, "spiral")
    tape.follow(_wander(tape, 0.85 * reach), 14.0 + 2 * part, 2.0, "random")
    tape.follow(_wander(tape, 0.7 * reach), 3.0, 7.0, "random fast")
    tape.hold(4.5, 1.6, "home")


def _wander(tape: _Tape, size: float) -> Callable[[Floats], Floats]:
    """Return a smooth random path that starts and ends at home and stays within ± size mm."""
    waves = np.arange(1, 6)
    weight = tape.rng.normal(size=(waves.size, tape.channels)) / waves[:, None] ** 0.5

    def path(phase: Floats) -> Floats:
        raw = np.sin(np.pi * np.outer(phase, waves)) @ weight
        fine = np.sin(np.pi * np.outer(np.linspace(0.0, 1.0, 501), waves)) @ weight
        return np.asarray(size * raw / np.max(np.abs(fine), axis=0), dtype=np.float64)

    return path
