"""The model of slice A: made from the rod's own clean sweep, as that of any stranger's simulator.

`softmap_edge.sweep` makes the table of shapes and finds the stiffness by a known weight. It bends a
line of one compliance, and this finger is ten times stiffer at its base than at its tip: its answer
to gravity would be half a millimetre off. The owner of the simulator gives it as well, at an
equilibrium with tangent K (cables' own stiffness left out), force f and lengths L of the cables:

    displacement per unit of p at constant tension  −K⁻¹ ∂f/∂p,   per 1 N of a cable  −K⁻¹ ∂L/∂x,
    stretch of a cable                              ∂L/∂x · displacement + ∂L/∂p
    and what large loads do beyond                  `second_rod.py`

p are the fields that the library knows of those in `changes`. Units: mm, N, g. Pinned by
tests/benches/test_bank.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from benches.bank.body_rod import (
    HANGING,
    NAME,
    REACH,
    grid,
    guessed,
    hanging,
    kept,
    sources,
    stored,
    template,
)
from benches.bank.law import Floats
from benches.bank.newton_step import newton_step
from benches.bank.rod import Loads, Poses, assembled, guides, own_lengths, settle
from benches.bank.rotations import turn
from benches.bank.second_rod import CAUSES, NODES, bends, second_of
from benches.bank.section import GRAVITY, Design, finger
from softmap_edge import _core

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

SWEEP = 41  # commands a channel of the shapes, as `softmap build` takes them,
FIELDS = 13  # and of the fields
KNOWN = 30.0  # g, hung on for the calibration
TIP = 1e-3  # mm and rad of a step to points
HATS = 7  # stretches of the body that have a modulus of their own
LEAN = np.array([np.sin(0.6), 0.0, np.cos(0.6)])

Change = Callable[[Design, Loads, float], tuple[Design, Loads]]


@lru_cache(maxsize=1)
def model() -> Model:
    """Return the model of the clean rod. Grams are allowed: a known weight was hung on."""
    from softmap_edge.files.npz import Stored
    from softmap_edge.model.shapes import FieldArrays, Grid
    from softmap_edge.sweep.build import model_from_file

    made = model_from_file(stored("rod-sweep", (sources(), SWEEP, KNOWN), _sweep))
    names = [name for name in _core.FIELDS if name in changes()]
    found = kept("rod-fields", (sources(), SWEEP, FIELDS, *names), lambda: _answers(names))
    axis = np.linspace(-REACH, REACH, FIELDS)
    values = found["fields"]  # (names + 4 cables, S, 3N)
    size = np.sqrt(np.mean(values**2, axis=(1, 2), keepdims=True)) + 1e-12
    _, weight, modes = np.linalg.svd(
        (values / size).reshape(-1, values.shape[2]), full_matrices=False
    )
    modes = np.ascontiguousarray(modes[: int(np.sum(weight > 1e-3 * weight[0]))])
    grid, rows = Grid((axis, axis)), values @ modes.T
    coefficients = {name: Stored(rows[i]) for i, name in enumerate(names)}
    arrays = FieldArrays(grid, Stored(modes), coefficients)
    still = np.zeros(modes.shape[1])
    cables = _core.Cables(
        finger(1).cable,
        _numbers([np.linspace(-REACH, REACH, SWEEP)] * 2, found["pull"]),
        _numbers([axis] * 2, _whole(found["stretch"], names)),
        [grid.compiled(rows[len(names) + c], still, modes) for c in range(4)],
    )
    bent = kept("rod-second", (sources(), NODES, CAUSES), _bends)
    made = made.with_structure(fields=arrays.compiled(), cables=cables, second=second_of(bent))
    assert made.arrays is not None
    made = replace(made, arrays=replace(made.arrays, fields=arrays))
    return replace(made, error_per_g_mm=_leaning_error(made))


def _bends() -> dict[str, Any]:
    """Return what `second_rod.bends` finds."""

    def stiffer(design: Design, name: str, by: float) -> Design:
        return changes()[name][0](design, hanging(np.zeros((1, 2))), by)[0]

    return dict(bends(lambda *at: answers(*at, CAUSES), length_beyond, stiffer))


def _numbers(axes: list[Floats], values: Floats) -> Any:
    """Return the table of numbers (S, n) over a grid."""
    n = values.shape[1]
    return _core.Table(axes, np.ascontiguousarray(values), np.zeros(n), np.eye(n))


def _whole(stretch: Floats, names: Sequence[str]) -> Floats:
    """Return stretch (S, 4·(F + 4)) for all library fields, zero for those the rod lacks."""
    full = np.zeros((len(stretch), 4, len(_core.FIELDS) + 4))
    for i, name in enumerate(names):
        full[..., list(_core.FIELDS).index(name)] = stretch[..., i]
    full[..., len(_core.FIELDS) :] = stretch[..., len(names) :]
    return full.reshape(len(stretch), -1)


def _leaning_error(made: Model) -> float:
    """Return the growth (mm for each g of change) of model error in a finger at 34°.

    The finger leans by that angle.
    """
    from softmap_edge.run.run import Run

    u = np.random.default_rng(0).uniform(-12.0, 12.0, (40, 2))
    t, off = np.arange(40.0), []
    for gravity in (HANGING, LEAN):
        loads = replace(hanging(u), gravity=np.tile(gravity, (40, 1)))
        true = settle(finger(1), loads, guessed(loads.pull)).points(finger(1), *template())
        found = made.predict(Run(t=t, command=u, t_seen=t, gravity=gravity))
        off.append(np.mean(np.sum((true - found) ** 2, axis=2)))
    return float(np.sqrt(max(off[1] - off[0], 0.0)) / np.linalg.norm(LEAN - HANGING))


def _sweep() -> dict[str, Any]:
    """Return the contents of a sweep file: the grid, and a few shapes under a known weight."""
    place, around = template()
    design = finger(1)
    u = grid(np.linspace(-REACH, REACH, SWEEP))
    sweep = settle(design, hanging(u), guessed(hanging(u).pull)).points(design, place, around)
    hung = np.array([[12.0, 0.0], [0.0, -12.0], [-9.0, 9.0], [9.0, 6.0]])
    weighed = replace(hanging(hung), tip=np.tile(KNOWN * GRAVITY * HANGING, (4, 1)))
    loaded = settle(design, weighed, guessed(weighed.pull)).points(design, place, around)
    return {
        "command": u,
        "vertices": sweep,
        "robot": np.array(NAME),
        "gravity": HANGING,
        "load": np.full(4, KNOWN),
        "loaded_command": hung,
        "loaded_vertices": loaded,
        "mass": np.array(design.mass[1:].sum()),
    }


def changes() -> dict[str, tuple[Change, float]]:
    """Return, by the name of a field, what changes by how many units; half of it goes each way."""
    found: dict[str, tuple[Change, float]] = {}
    for axis, way in zip("xyz", np.eye(3)):
        found[f"gravity_{axis}"] = (
            lambda d, w, h, v=way: (d, replace(w, gravity=w.gravity + h * v)),
            1.0,
        )
        found[f"tip_force_{axis}"] = (
            lambda d, w, h, v=way: (d, replace(w, tip=w.tip + h * v)),
            1.0,
        )
    for k in range(HATS):
        found[f"stiff_{k}"] = (lambda d, w, h, k=k: (d.stiffer(np.exp(h * _hat(d, k))), w), 0.02)
    found["stiff_x"] = (
        lambda d, w, h: (d.stiffer(np.exp(h * d.fibres()[0] / d.radius[:, None])), w),
        0.02,
    )
    found["stiff_y"] = (
        lambda d, w, h: (d.stiffer(np.exp(h * d.fibres()[1] / d.radius[:, None])), w),
        0.02,
    )
    found["curve_x"] = (lambda d, w, h: (_curved(d, [0.0, 2 * h / d.place[-1] ** 2, 0.0]), w), 0.1)
    found["curve_y"] = (lambda d, w, h: (_curved(d, [-2 * h / d.place[-1] ** 2, 0.0, 0.0]), w), 0.1)
    found["twist"] = (lambda d, w, h: (_curved(d, [0.0, 0.0, np.radians(h) / d.place[-1]]), w), 0.1)
    for c in range(2):
        pair = np.radians(np.array([[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0]])[c])
        found[f"routing_{c}"] = (lambda d, w, h, p=pair: (d.turned_guides(h * p), w), 0.1)
    return found


def _hat(design: Design, k: int) -> Floats:
    """Return the k-th stretch's share (n,) at each element: cos² around its middle."""
    away = np.abs(design.middle / design.place[-1] * (HATS - 1) - k)
    return np.asarray(np.where(away < 1.0, np.cos(np.pi / 2 * np.minimum(away, 1.0)) ** 2, 0.0))


def _curved(design: Design, more: Sequence[float]) -> Design:
    return replace(design, rest=design.rest + np.asarray(more))


def _answers(names: Sequence[str]) -> dict[str, Any]:
    """Return `fields` (names + 4, S, 3N), `stretch` (S, 4, names + 4), `pull` (SWEEP², 4) N.

    They are on the coarse grid.
    """
    design = finger(1)
    fine = hanging(grid(np.linspace(-REACH, REACH, SWEEP)))
    pull = design.cable * length_beyond(design, fine, settle(design, fine, guessed(fine.pull)))
    loads = hanging(grid(np.linspace(-REACH, REACH, FIELDS)))
    fields, stretch = answers(design, loads, settle(design, loads, guessed(loads.pull)), names)
    return {"fields": fields, "stretch": stretch, "pull": pull}


def answers(
    design: Design, loads: Loads, poses: Poses, names: Sequence[str] = _core.LOADS
) -> tuple[Floats, Floats]:
    """Return displacements of the seen points (names + 4, S, 3N), and the stretch.

    They are per unit of fields and per 1 N of a cable; the stretch of the cables is (S, 4, names +
    4).
    """
    _, blocks, lengths, _ = assembled(design, loads, poses.x, poses.frame)
    none, told = np.zeros(lengths.shape[:1] + (4,), bool), length_beyond(design, loads, poses)
    moved, fields, stretch = [], [], []
    for name in names:
        change, size = changes()[name]
        ends = [change(design, loads, half) for half in (size / 2, -size / 2)]
        longer = [length_beyond(*end, poses) for end in ends]
        # at the same tension
        held = [(d, replace(w, pull=w.pull + told - more)) for (d, w), more in zip(ends, longer)]
        force = [assembled(*end, poses.x, poses.frame)[0] for end in held]
        moved.append(newton_step(blocks, (force[0] - force[1]) / size, lengths, none, design.cable))
        stretch.append((longer[0] - longer[1]) / size)
    for c in range(4):
        moved.append(newton_step(blocks, lengths[..., c], lengths, none, design.cable))
        stretch.append(np.zeros((len(loads.pull), 4)))
    for way, direct in zip(moved, stretch):
        fields.append(_carried(design, poses, way))
        direct += np.einsum("bnkc,bnk->bc", lengths, way)
    return np.stack(fields), np.stack(stretch, axis=2)


def length_beyond(design: Design, loads: Loads, poses: Poses) -> Floats:
    """Return by how much (B, 4) mm the cables are stretched; below zero they hang."""
    span = np.linalg.norm(np.diff(guides(design, poses.x, poses.frame), axis=2), axis=3).sum(axis=2)
    return np.asarray(span - own_lengths(design) + loads.pull - design.slack)


def _carried(design: Design, poses: Poses, way: Floats) -> Floats:
    """Return by how much (B, 3N) mm the seen points move per step `way` (B, n, 6) of the nodes."""
    size = TIP / np.maximum(np.abs(way).max(axis=(1, 2), keepdims=True), 1e-12)
    ends = []
    for sign in (0.5, -0.5):
        x, frame = poses.x.copy(), poses.frame.copy()
        x[:, 1:] += sign * size * way[..., :3]
        frame[:, 1:] = turn(sign * size * way[..., 3:]) @ frame[:, 1:]
        ends.append(replace(poses, x=x, frame=frame).points(design, *template()))
    return np.asarray(((ends[0] - ends[1]) / size).reshape(len(way), -1))
