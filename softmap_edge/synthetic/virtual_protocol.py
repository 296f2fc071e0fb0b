"""Commands for learning a robot.

They are held commands on a grid, others for validation, and paths for tests of memory.

    grid        each command of a grid of 7 a channel, in a drawn order, reached from a drawn
                neighbour, held, seen once
    validation  24 drawn commands between the nodes of the grid, reached and seen in the same way
    paths  circles, spirals, smooth random moves and reversals: never part of what is learned from

Friction depends on the direction of approach: from one side only, it would look like part of the
shape. The paper states only that the real finger was moved over "a representative grid of servo
commands"; 7 per channel, the holds and the neighbours are our choice. Units and limits as in
`run/protocol.py`; pinned by tests/synthetic/test_virtual.py.
"""

from __future__ import annotations

import math

import numpy as np

from softmap_edge.errors import SoftmapError
from softmap_edge.fem.simulator import tensor_grid
from softmap_edge.run.protocol import (
    HANGING,
    Floats,
    Limits,
    Protocol,
    Tape,
    circle,
    diagonals,
    home,
    small_loops,
    spiral,
    triangles,
    wander,
)

KINDS = ("grid", "validation", "paths")
NODES = 7  # nodes per channel of the grid
MOST_HELD = 1000  # most commands: three hours are too long for a protocol
OTHERS = 24
HOLD, LOOK = 1.0, 0.9  # s that a command is held, and s until its capture
RATE = 2.0  # frame rate of the paths, 1/s
REACH = 0.85  # of the limits: range of random moves


def virtual_protocol(
    kind: str, seed: int, limits: Limits, gravity: tuple[float, ...] = HANGING
) -> Protocol:
    """Make the commands of one of the `KINDS` within the limits of a robot.

    `seed` draws orders, neighbours and paths; each kind draws its own. `gravity` (3,) g is the one
    orientation. Returns the protocol. Raises SoftmapError for an unknown kind, a negative seed, or
    channels that make too many commands.
    """
    if kind not in KINDS:
        raise SoftmapError(f"no protocol '{kind}'; there are {', '.join(KINDS)}")
    if seed < 0:
        raise SoftmapError(f"seed {seed} is negative; give 0 or more")
    if NODES**limits.channels > MOST_HELD:
        raise SoftmapError(
            f"a grid of {NODES} a channel has {NODES**limits.channels} commands for "
            f"{limits.channels} channels, at most {MOST_HELD} are held; take a robot of fewer "
            "channels, or commands of your own"
        )
    rng = np.random.default_rng([seed, 41, KINDS.index(kind)])
    tape = Tape(limits, rng, gravity)
    if kind == "grid":
        _grid(tape)
    elif kind == "validation":
        for share in rng.uniform(-1.0, 1.0, (OTHERS, limits.channels)):
            near = np.clip(
                share + rng.uniform(-1.0, 1.0, limits.channels) * 2.0 / (NODES - 1), -1.0, 1.0
            )
            _held(tape, near, share)
    else:
        _paths(tape)
    return tape.protocol(kind)


def _grid(tape: Tape) -> None:
    size, channels = NODES - 1, tape.channels
    nodes = tensor_grid([np.arange(float(NODES))] * channels)
    ways = tensor_grid([np.arange(-1.0, 2.0)] * channels)
    ways = np.delete(ways, len(ways) // 2, axis=0)  # all directions except staying
    for node in tape.rng.permutation(nodes):
        inside = ways[((node + ways >= 0) & (node + ways <= size)).all(axis=1)]
        near = node + inside[tape.rng.integers(len(inside))]
        _held(tape, 2.0 * near / size - 1.0, 2.0 * node / size - 1.0)


def _held(tape: Tape, near: Floats, share: Floats) -> None:
    """Go to `near`, then to `share` (C,) of the reach, hold it, and capture once at the end."""
    tape.to(tape.limits.at(near), 2 * tape.slow, 0.0, "")
    tape.to(tape.limits.at(share), tape.slow, 0.0, "")
    tape.seen.append((tape.now + LOOK, "held"))
    tape.hold(HOLD, 0.0, "")


def _paths(tape: Tape) -> None:
    seconds = 16.0 * math.sqrt(tape.channels)
    home(tape, 3.0, RATE)
    tape.follow(circle(tape), seconds, RATE, "circle")
    tape.follow(wander(tape, REACH), seconds, RATE, "random")
    for channel in range(tape.channels):
        triangles(tape, channel)
        small_loops(tape, channel)
    diagonals(tape)
    tape.follow(spiral(tape), seconds, RATE, "spiral")
    tape.follow(wander(tape, REACH), seconds, RATE, "random")
    home(tape, 3.0, RATE)
