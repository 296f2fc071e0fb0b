"""The blocks of commands to choose an experiment from.

Each block declares its moves and the one condition that it changes.

A block starts and ends at home. It changes at most one condition (`changes`): the orientation, the
load at the tip, or the temperature. The effects of two changed conditions could not be separated. A
block repeats its moves in the usual condition, so it alone holds both. `plan` plays blocks in
sequence. Units: s, mm (or the robot's own unit), g, °C. Moves are those of `run/protocol.py`,
within the limits of a robot. Known limit: a warm-up is planned as a linear rise; a real one follows
the thermometer. Pinned by tests/experiment/test_experiment.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError, no_name
from softmap_edge.run import protocol as moves
from softmap_edge.run.conditions import NEAR
from softmap_edge.run.protocol import HANGING, LEAN, LIMIT_MINUTES, Limits, Protocol, Tape

if TYPE_CHECKING:
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Vector = tuple[float, ...]

KNOWN_LOAD = 10.0  # load added at the tip, g
WARMER, ROOM = 5.0, 22.0  # temperature rise, and start where none is declared, °C
WARM_UP = 600.0  # duration, s
LONG = 40.0  # s of rest at the end of the range
# azimuths of the lean, degrees; the first is that of the standard protocol
TILTS = (25.0, 205.0, 115.0)


@dataclass(frozen=True)
class Setting:
    """The conditions of a robot: gravity (3,) in g, load in g, and all past orientations."""

    gravity: Vector = HANGING
    load: float = 0.0
    temperature: float = ROOM
    seen: tuple[Vector, ...] = (HANGING,)

    @classmethod
    def after(cls, runs: Sequence[Run], usual: Floats) -> Setting:
        """Return the setting of a robot after some runs.

        Where they declare no gravity, it is `usual` (3,).
        """
        down = [np.atleast_2d(run.gravity) for run in runs if run.gravity is not None]
        last = runs[-1].load if runs else None
        warm = next(
            (run.temperature for run in reversed(runs) if run.temperature is not None), None
        )
        rows = np.concatenate(down) if down else np.atleast_2d(np.asarray(usual, float))
        return cls(
            _vector(rows[-1]),
            0.0 if last is None or not len(last) else float(last[-1]),
            ROOM if warm is None or not len(warm) else float(warm[-1]),
            tuple(_vector(row) for row in np.unique(np.round(rows, 9), axis=0)),
        )

    def leaning(self) -> Vector:
        """Return a new direction of gravity, 35° from the usual one, if there is one."""
        down = np.array(self.gravity) / max(float(np.linalg.norm(self.gravity)), 1e-12)
        x = np.array([1.0, 0.0, 0.0]) if abs(down[0]) < 0.9 else np.array([0.0, 0.0, 1.0])
        x = (x - (x @ down) * down) / np.linalg.norm(x - (x @ down) * down)
        y = np.cross(down, x)
        others = []
        for azimuth in np.radians(TILTS):
            side = np.cos(azimuth) * x + np.sin(azimuth) * y
            others.append(np.cos(LEAN) * down + np.sin(LEAN) * side)
        near = [max(float(other @ np.array(s)) for s in self.seen) > NEAR for other in others]
        return _vector(others[near.index(False) if False in near else 0])


@dataclass(frozen=True)
class Block:
    """A block: `moves` adds its moves to a tape, in a setting.

    `changes` is the condition that it changes.
    """

    name: str
    moves: Callable[[Tape, Setting], None]
    changes: Literal["nothing", "orientation", "load", "temperature"] = "nothing"
    channels: int = 1  # channels that it needs

    def plan(self, limits: Limits, setting: Setting | None = None, seed: int = 0) -> Protocol:
        """Return the block as a protocol, for a robot with these limits in its conditions."""
        return plan([self], limits, setting, seed)


def plan(
    blocks: Sequence[Block],
    limits: Limits,
    setting: Setting | None = None,
    seed: int = 0,
    name: str = "",
) -> Protocol:
    """Return blocks in sequence as a protocol; each change is reverted before the next.

    Args:
        blocks: at least one block.
        limits: limits of the robot.
        setting: its conditions; hanging, without load, by default.
        seed: seed of the irregular frame times.
        name: name of the protocol; the names of the blocks by default.

    Raises:
        SoftmapError: no block, one that needs more channels, or more than two hours.
    """
    if not blocks:
        raise SoftmapError(f"no block is asked for; there are {', '.join(BLOCKS)}")
    setting = setting or Setting()
    named = name or " + ".join(block.name for block in blocks)
    tape = Tape(limits, np.random.default_rng([seed, len(named)]), setting.gravity, setting.load)
    # the body cools slowly, so warm blocks are last
    for block in sorted(blocks, key=lambda block: block.changes == "temperature"):
        if block.channels > limits.channels:
            raise SoftmapError(
                f"'{block.name}' moves {block.channels} channels together, the robot has "
                f"{limits.channels}; take another block"
            )
        tape.turn(setting.gravity)
        tape.hang(setting.load)
        block.moves(tape, setting)
        tape.home()
        if tape.now > LIMIT_MINUTES * 60:
            raise SoftmapError(f"{named}: more than {LIMIT_MINUTES:g} minutes; take fewer blocks")
    return tape.protocol(named)


def chosen(names: Iterable[str]) -> list[Block]:
    """Return blocks by their names.

    Raises:
        SoftmapError: an unknown block.
    """
    found = []
    for name in names:
        if name not in BLOCKS:
            raise SoftmapError(no_name("block", name, BLOCKS))
        found.append(BLOCKS[name])
    return found


# --- the moves ----------------------------------------------------------------------------------


def _each(move: Callable[[Tape, int], None]) -> Callable[[Tape, Setting], None]:
    """Rest at home, move one channel after the other, and rest at home."""

    def moved(tape: Tape, setting: Setting) -> None:
        moves.home(tape, 3.0, 1.6)
        for channel in range(tape.channels):
            move(tape, channel)
        moves.home(tape, 3.0, 1.6)

    return moved


def _home_revisits(tape: Tape, setting: Setting) -> None:
    for channel in range(tape.channels):
        for end in (0.6, -0.6):
            moves.home(tape, 4.0, 1.6)
            tape.to(tape.axis(channel, end), tape.slow, 2.3, "home revisit")
            tape.to(tape.limits.home, tape.slow, 2.3, "home revisit")
    moves.home(tape, 4.0, 1.6)


def _levels(tape: Tape, channel: int) -> None:
    for level in (1 / 3, 2 / 3, 1.0, -1 / 3, -2 / 3, -1.0):
        tape.to(tape.axis(channel, level), 2 * tape.slow, 0.0, "")
        tape.hold(2.0, 1.6, f"level[{channel}]")


def _fast_and_slow(tape: Tape, channel: int) -> None:
    for end in (0.85, -0.85, 0.0):
        tape.to(tape.axis(channel, end), tape.slow, 2.3, f"slow[{channel}]")
    moves.fast_triangles(tape, channel)


def _stairs(tape: Tape, channel: int) -> None:
    moves.staircase(tape, channel, 1.0)


def _long_dwell(tape: Tape, channel: int) -> None:
    tape.to(tape.axis(channel, 1.0), 2 * tape.slow, 0.0, "")
    tape.hold(LONG, 0.5, f"long dwell[{channel}]")
    tape.to(tape.limits.home, 2 * tape.slow, 0.0, "")
    tape.hold(LONG / 2, 0.5, f"long dwell[{channel}]")


def _diagonals(tape: Tape, setting: Setting) -> None:
    moves.home(tape, 3.0, 1.6)
    moves.diagonals(tape)
    moves.home(tape, 3.0, 1.6)


def _circle(tape: Tape, setting: Setting) -> None:
    moves.home(tape, 3.0, 1.6)
    tape.follow(moves.circle(tape), 14.0, 2.0, "circle")
    moves.home(tape, 3.0, 1.6)


def _sample(tape: Tape, label: str) -> None:
    """Home and one triangle per channel: the moves repeated where a condition changes."""
    tape.hold(5.0, 1.6, f"{label} home")
    for channel in range(tape.channels):
        for end in (0.85, -0.85, 0.0):
            tape.to(tape.axis(channel, end), tape.slow, 2.3, f"{label} triangle[{channel}]")


def _another_orientation(tape: Tape, setting: Setting) -> None:
    _sample(tape, "upright")
    tape.turn(setting.leaning())
    _sample(tape, "leaning")


def _known_load(tape: Tape, setting: Setting) -> None:
    _sample(tape, "unloaded")
    tape.hang(setting.load + KNOWN_LOAD)
    _sample(tape, "loaded")


def _warm_up(tape: Tape, setting: Setting) -> None:
    note = (
        f"warm the robot by {WARMER:g} °C from here on, and log a thermometer next to the silicone"
    )
    tape.notes.append((tape.now, note))
    start = tape.now
    while tape.now - start < WARM_UP:
        _sample(tape, "warming")
        tape.hold(20.0, 0.2, "warming")
    tape.warmth += [(start, setting.temperature), (tape.now, setting.temperature + WARMER)]


BLOCKS: dict[str, Block] = {
    block.name: block
    for block in (
        Block("home revisits", _home_revisits),
        Block("levels of both signs", _each(_levels)),
        Block("triangles of growing size", _each(moves.triangles)),
        Block("small loops at two offsets", _each(moves.small_loops)),
        Block("fast and slow triangles", _each(_fast_and_slow)),
        Block("staircase with long dwells", _each(_stairs)),
        Block("a long dwell", _each(_long_dwell)),
        Block("diagonals", _diagonals, channels=2),
        Block("circle", _circle, channels=2),
        Block("another orientation", _another_orientation, "orientation"),
        Block("a known 10 g", _known_load, "load"),
        Block("a warm-up", _warm_up, "temperature"),
    )
}


def _vector(v: Floats) -> Vector:
    return tuple(float(x) for x in v)
