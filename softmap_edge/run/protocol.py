"""Protocols of commands that show what a model lacks: the standard one, and a validation run.

A protocol is a list of blocks: home revisits, triangles of growing size, small loops at two
offsets, diagonals, staircases with long dwells, fast triangles. Each block is played in two
mounting orientations, because one alone cannot distinguish the weight of the body from a weight at
the tip. The validation run consists of circles, spirals and smooth random moves. A `Tape` records
the moves within the `Limits` of a robot; `experiment/blocks.py` holds single blocks. Units: s, mm
of tendon shortening (or the robot's own unit), gravity in g in the base frame, load in g. Limit:
straight moves at constant speed, without the ramps of a real servo. `tests/synthetic/test_truth.py`
pins frame counts, speeds and coverage.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError

Floats = NDArray[np.float64]

RATE = 50.0  # Hz, recording rate of commands
REACH = 12.0  # mm, largest command: leaves room for gain and offset inside a ±16 mm sweep
SLOW, FAST = 9.0, 55.0  # mm/s at this reach; at 55 mm/s a delay of 20 ms is 1.1 mm
SHARE = 0.75  # of the model's range that is used: leaves room for gain and offset
DWELL = 7.0  # s, long enough to see creep
STAIRS = 3  # channels; up to here each has its own staircase in each orientation
TURNING = 6.0  # s at home while the mounting is rotated; no frame is captured
LIMIT_MINUTES = 120.0  # duration of the longest protocol
HANGING = (0.0, 0.0, 1.0)
# second mounting: tilt from hanging, and direction outside the tendon planes
LEAN, AZIMUTH = np.radians(35.0), np.radians(25.0)
LEANING = (
    float(np.sin(LEAN) * np.cos(AZIMUTH)),
    float(np.sin(LEAN) * np.sin(AZIMUTH)),
    float(np.cos(LEAN)),
)


@dataclass(frozen=True)
class Protocol:
    """Commands to send and capture times.

    Attributes:
        t: (T,) s.
        command: (T, C) in `unit`.
        gravity: (T, 3) g, base frame.
        t_seen: (K,) s, capture times.
        block: (K,) labels.
        load: (T,) g at the tip, if part of the protocol.
        temperature: (T,) °C to reach, if part of the protocol.
        notes: times (s) of manual steps.
        unit: of the commands.
    """

    name: str
    t: Floats
    command: Floats
    gravity: Floats
    t_seen: Floats
    block: NDArray[np.str_]
    load: Floats | None = None
    temperature: Floats | None = None
    notes: tuple[tuple[float, str], ...] = ()
    unit: str = "mm"

    @property
    def frames(self) -> int:
        """Return the number of seen frames K."""
        return int(self.t_seen.size)

    @property
    def minutes(self) -> float:
        """Return the duration."""
        return float(self.t[-1] - self.t[0]) / 60.0


@dataclass(frozen=True)
class Limits:
    """Range and speed of a robot's commands.

    Home, low, high (C,) are in its unit, slow and fast (C,) in units per second.
    """

    home: Floats
    low: Floats
    high: Floats
    slow: Floats
    fast: Floats
    unit: str = "mm"

    @classmethod
    def even(cls, channels: int, reach: float = REACH) -> Limits:
        """Return ± `reach` mm for each of `channels`, at the usual speeds.

        Raises:
            SoftmapError: no channel, or an invalid reach.
        """
        if channels < 1 or not 0.0 < reach < 1e3:
            raise SoftmapError(
                f"a protocol needs at least 1 channel and 0 < reach < 1000 mm, got {channels} and "
                f"{reach}"
            )
        one = np.ones(channels)
        return cls(0.0 * one, -reach * one, reach * one, SLOW * one, FAST * one)

    @classmethod
    def of(cls, command_range: Floats, unit: str = "mm", fastest: float | None = None) -> Limits:
        """Return limits at three quarters of a model's `command_range` (C, 2).

        They lie on both sides of home, with matching speeds. Home is command 0, or the nearest
        command to it. `fastest` (units per second) bounds every speed.

        Raises:
            SoftmapError: no commands, a channel without range, or an invalid speed.
        """
        low, high = np.asarray(command_range, float).reshape(-1, 2).T
        if not low.size or not np.all(np.isfinite(low) & np.isfinite(high) & (high > low)):
            raise SoftmapError(
                f"commands from {low.tolist()} to {high.tolist()} leave no room to move; take a "
                "model with commands"
            )
        if fastest is not None and not 0.0 < fastest < 1e6:
            raise SoftmapError(
                f"a fastest speed of {fastest:g} {unit}/s is none; give a number above 0"
            )
        home = np.clip(0.0, low, high)
        up, down = SHARE * (high - home), SHARE * (home - low)
        slow, fast = (np.maximum(up, down) * speed / REACH for speed in (SLOW, FAST))
        if fastest is not None:
            slow, fast = np.minimum(slow, fastest / 2), np.minimum(fast, fastest)
        return cls(home, home - down, home + up, slow, fast, unit)

    @property
    def channels(self) -> int:
        """Number of commands C."""
        return len(self.home)

    @property
    def two_sided(self) -> NDArray[np.bool_]:
        """Return which channels (C,) can move to both sides of home."""
        least = 0.1 * (self.high - self.low)
        return np.asarray((self.home - self.low > least) & (self.high - self.home > least))

    def at(self, share: Floats) -> Floats:
        """Return the command (..., C) at `share` of the way from home to high (low if negative)."""
        up, down = self.high - self.home, self.home - self.low
        return np.asarray(self.home + np.where(share > 0, share * up, share * down))


def standard_protocol(
    channels: int = 2,
    seed: int = 0,
    reach: float = REACH,
    limits: Limits | None = None,
    back: bool = False,
    orientations: tuple[tuple[float, ...], tuple[float, ...]] = (HANGING, LEANING),
) -> Protocol:
    """Make the standard protocol: about 360 frames in 4 minutes, two orientations.

    Args:
        channels: C ≥ 1.
        seed: of the irregular frame times.
        reach: largest command, mm.
        limits: of a robot, in place of channels and reach.
        back: whether to return to the first orientation for triangles and the other side of the
            staircases, which separates orientation from time: 6 minutes.
        orientations: the two directions of gravity.

    Raises:
        SoftmapError: channels or reach are not usable.
    """
    limits = limits or Limits.even(channels, reach)
    directions = (*orientations, orientations[0]) if back else orientations
    return _in_orientations("standard protocol", limits, seed, _standard_blocks, directions)


def other_protocol(
    channels: int = 2, seed: int = 0, reach: float = REACH, limits: Limits | None = None
) -> Protocol:
    """Make a validation run of another kind: circles, spirals, smooth random moves.

    It has about 240 frames in 2 minutes, in the same two orientations. Arguments and errors are
    those of `standard_protocol`.
    """
    limits = limits or Limits.even(channels, reach)
    return _in_orientations("another kind of run", limits, seed, _other_blocks, (HANGING, LEANING))


class Tape:
    """Collect the corners of the command, the conditions and the capture times, move after move."""

    def __init__(
        self,
        limits: Limits,
        rng: np.random.Generator,
        gravity: tuple[float, ...],
        load: float = 0.0,
    ) -> None:
        self.limits, self.rng, self.channels = limits, rng, limits.channels
        self.slow, self.fast = limits.slow, limits.fast
        self.now = 0.0
        self.corners: list[tuple[float, Floats]] = [(0.0, limits.home)]
        self.turns: list[tuple[float, tuple[float, ...]]] = [(0.0, gravity)]
        self.loads: list[tuple[float, float]] = [(0.0, load)]
        self.warmth: list[tuple[float, float]] = []
        self.notes: list[tuple[float, str]] = []
        self.seen: list[tuple[float, str]] = []

    @property
    def here(self) -> Floats:
        return self.corners[-1][1]

    def _pause(self, note: str) -> float:
        """Rest at home for a manual step; return the time in the middle."""
        self.home()
        self.hold(TURNING, 0.0, "")
        self.notes.append((self.now - TURNING, note))
        return self.now - TURNING / 2

    def turn(self, gravity: tuple[float, ...]) -> None:
        """Rotate the mounting half-way through a pause at home."""
        if gravity != self.turns[-1][1]:
            down = " ".join(f"{x:.2f}" for x in gravity)
            self.turns.append(
                (self._pause(f"turn the robot until gravity points along {down}"), gravity)
            )

    def hang(self, load: float) -> None:
        """Set the load at the tip to `load` g half-way through a pause at home."""
        if load != self.loads[-1][1]:
            note = f"hang {load:g} g at the tip" if load else "take the load from the tip"
            self.loads.append((self._pause(note), load))

    def home(self) -> None:
        """Go home slowly, without captures."""
        self.to(self.limits.home, self.slow, 0.0, "")

    def look(self, start: float, end: float, rate: float, label: str) -> None:
        if rate <= 0.0:
            return
        last = self.seen[-1][0] if self.seen else -np.inf
        at = (
            max(start, last) + self.rng.uniform(0.1, 0.6) / rate
            if last > start - 1.0 / rate
            else start + 0.3 / rate
        )
        while at < end:
            self.seen.append((at, label))
            at += self.rng.uniform(0.75, 1.25) / rate

    def hold(self, seconds: float, rate: float, label: str) -> None:
        self.look(self.now, self.now + seconds, rate, label)
        self.now += seconds
        self.corners.append((self.now, self.here.copy()))

    def to(self, target: Floats, speed: Floats, rate: float, label: str) -> None:
        """Move straight to `target` (C,) mm; no channel exceeds its `speed` (C,) mm/s."""
        samples = int(np.ceil(float(np.max(np.abs(target - self.here) / speed)) * RATE - 1e-9))
        if samples <= 0:
            return
        seconds = samples / RATE
        self.look(self.now, self.now + seconds, rate, label)
        self.now += seconds
        self.corners.append((self.now, np.array(target, dtype=np.float64)))

    def follow(
        self, path: Callable[[Floats], Floats], seconds: float, rate: float, label: str
    ) -> None:
        """Follow `path`: phase (n,) in 0..1 → command (n, C) mm."""
        steps = max(2, int(np.ceil(seconds * RATE)))
        phase = np.arange(1, steps + 1) / steps
        self.look(self.now, self.now + seconds, rate, label)
        for p, command in zip(phase, path(phase)):
            self.corners.append((self.now + p * seconds, command))
        self.now += seconds

    def axis(self, channel: int, share: float) -> Floats:
        """Return the command (C,) with one channel at `share` of its reach."""
        target = np.zeros(self.channels)
        target[channel] = share
        return self.limits.at(target)

    def protocol(self, name: str) -> Protocol:
        times = np.array([time for time, _ in self.corners])
        corners = np.array([command for _, command in self.corners])
        t = np.arange(int(np.ceil(self.now * RATE)) + 1) / RATE
        command = np.stack(
            [np.interp(t, times, corners[:, c]) for c in range(self.channels)], axis=1
        )
        gravity, load = np.empty((t.size, 3)), np.empty(t.size)
        for start, direction in self.turns:
            gravity[t >= start] = direction
        for start, hung in self.loads:
            load[t >= start] = hung
        warmth = None if not self.warmth else np.interp(t, *np.array(self.warmth).T)
        seen = np.array([time for time, _ in self.seen])
        block = np.array([label for _, label in self.seen])
        load_known = load if len(self.loads) > 1 or self.loads[0][1] else None
        unit, notes = self.limits.unit, tuple(self.notes)
        return Protocol(name, t, command, gravity, seen, block, load_known, warmth, notes, unit)


def _in_orientations(
    name: str,
    limits: Limits,
    seed: int,
    blocks: Callable[[Tape, int], None],
    directions: tuple[tuple[float, ...], ...],
) -> Protocol:
    tape = Tape(limits, np.random.default_rng([seed, len(name)]), directions[0])
    for part, gravity in enumerate(directions):
        tape.turn(gravity)
        blocks(tape, part)
    return tape.protocol(name)


def _standard_blocks(tape: Tape, part: int) -> None:
    channels = range(tape.channels)
    home(tape, 5.0, 1.4)
    for channel in channels:
        triangles(tape, channel)
    if part < 2:
        home(tape, 4.0, 1.6)
        for channel in channels:
            small_loops(tape, channel)
        diagonals(tape)
    for channel in channels:
        # with many channels, each in one orientation only
        if tape.channels <= STAIRS or channel % 2 == part % 2:
            staircase(tape, channel, 1.0 if part == 0 else -1.0)
    for channel in channels if part < 2 else ():
        fast_triangles(tape, channel)
    home(tape, 6.0, 1.2)


def home(tape: Tape, seconds: float, rate: float) -> None:
    """Rest at the present place, which is home."""
    tape.hold(seconds, rate, "home")


def triangles(tape: Tape, channel: int) -> None:
    """Move one channel to both sides and back, in three sizes."""
    for size in (0.3, 0.62, 1.0):
        for end in (size, -size, 0.0):
            tape.to(tape.axis(channel, end), tape.slow, 2.3, f"triangle[{channel}]")


def small_loops(tape: Tape, channel: int) -> None:
    """Move one channel to and fro by small amounts, about two distant places."""
    for middle in (0.6, -0.4) if tape.limits.two_sided[channel] else (0.7, 0.3):
        for end in (middle - 0.12, middle + 0.12, middle - 0.12, middle):
            tape.to(tape.axis(channel, end), tape.slow, 2.3, f"small loop[{channel}]")
    tape.to(tape.limits.home, tape.slow, 2.3, f"small loop[{channel}]")


def diagonals(tape: Tape) -> None:
    """Move all channels together, then every second one against the others."""
    for sign in (1.0, -1.0):
        corner = 0.72 * np.array([1.0 if c % 2 == 0 else sign for c in range(tape.channels)])
        for share in (corner, -corner, 0.0 * corner):
            tape.to(tape.limits.at(share), tape.slow, 2.3, "diagonal")


def staircase(tape: Tape, channel: int, sign: float) -> None:
    """Rest on each step of a staircase, long enough to see creep."""
    sign = sign if tape.limits.two_sided[channel] else 1.0
    for level in (0.5, 1.0, 0.5, 0.0):
        tape.to(tape.axis(channel, sign * level), 2 * tape.slow, 0.0, "")
        tape.hold(DWELL, 0.65, f"staircase[{channel}]")


def fast_triangles(tape: Tape, channel: int) -> None:
    """Move one channel over most of its range at its highest speed, captured often."""
    for end in (0.85, -0.85, 0.85, -0.85, 0.0):
        tape.to(tape.axis(channel, end), tape.fast, 9.0, f"fast[{channel}]")
    tape.hold(1.2, 4.0, f"fast[{channel}]")


def _other_blocks(tape: Tape, part: int) -> None:
    tape.hold(5.0, 1.6, "home")
    tape.follow(circle(tape), 14.0, 2.0, "circle")
    tape.follow(spiral(tape), 20.0, 2.0, "spiral")
    tape.follow(wander(tape, 0.85), 14.0 + 2 * part, 2.0, "random")
    tape.follow(wander(tape, 0.7), 3.0, 7.0, "random fast")
    tape.hold(4.5, 1.6, "home")


def circle(tape: Tape) -> Callable[[Floats], Floats]:
    """Return a path of two turns that starts and ends at home.

    Each channel is a quarter turn behind the previous one.
    """
    shift = np.arange(tape.channels) * (np.pi / 2)

    def path(phase: Floats) -> Floats:
        grow = np.minimum(1.0, 6.0 * np.minimum(phase, 1.0 - phase))
        return tape.limits.at(0.75 * grow[:, None] * np.sin(4 * np.pi * phase[:, None] + shift))

    return path


def spiral(tape: Tape) -> Callable[[Floats], Floats]:
    """Return a path from home to home: five growing and shrinking turns, opposite in sense."""
    shift = np.arange(tape.channels) * (np.pi / 2)

    def path(phase: Floats) -> Floats:
        return tape.limits.at(
            0.95 * np.sin(np.pi * phase)[:, None] * np.sin(-10 * np.pi * phase[:, None] + shift)
        )

    return path


def wander(tape: Tape, size: float) -> Callable[[Floats], Floats]:
    """Return a smooth random path from home to home that stays within ± `size` of the reach."""
    waves = np.arange(1, 6)
    weight = tape.rng.normal(size=(waves.size, tape.channels)) / waves[:, None] ** 0.5

    def path(phase: Floats) -> Floats:
        raw = np.sin(np.pi * np.outer(phase, waves)) @ weight
        fine = np.sin(np.pi * np.outer(np.linspace(0.0, 1.0, 501), waves)) @ weight
        return tape.limits.at(size * raw / np.max(np.abs(fine), axis=0))

    return path
