"""Slice A: the rod finger as a body that laws change.

Every frame of every case is solved to an equilibrium, so that nothing is interpolated in what is
seen; a table of strains over commands only says where Newton starts, and how strong a law of the
command has to be. The rod has 16 + 3 elements, with which its tip is 0.06 mm from where it would be
with four times as many: truth and model share that body. Units: mm, g, N. Pinned by
tests/benches/test_bank.py.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from benches.bank.friction_rod import dragged
from benches.bank.law import Floats, Law, Past
from benches.bank.rod import Loads, Poses, laid, settle, strains
from benches.bank.section import finger

NAME = "rod-finger"
REACH = 16.0
SOURCES = (
    "section.py",
    "rod.py",
    "newton_step.py",
    "rotations.py",
    "body_rod.py",
    "model_rod.py",
    "second_rod.py",
)
HANGING = np.array([0.0, 0.0, 1.0])
RINGS, AROUND = 14, 12
GRID = 9  # commands a channel from which Newton starts
KEPT = Path("out/bank/kept")  # sweeps of clean fingers, which every process would compute again


def template() -> tuple[Floats, Floats]:
    """Return the finger's seen points: place (N,) mm along it, offset (N, 2) mm from the axis."""
    design = finger(1)
    place = np.repeat(np.linspace(0.0, design.place[-1], RINGS), AROUND)
    radius = np.interp(place, design.middle, design.radius)
    angle = np.tile(np.arange(AROUND) * 2 * np.pi / AROUND, RINGS)
    return place, radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def markers() -> tuple[Floats, Floats]:
    """Return nine marker points on the surface, as `template`: three on each of three rings."""
    design = finger(1)
    place = np.repeat([40.0, 75.0, 108.0], 3)
    angle = np.tile(np.arange(3) * 2 * np.pi / 3, 3) + np.repeat([0.2, 1.1, 0.6], 3)
    radius = np.interp(place, design.middle, design.radius)
    return place, radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def rest(points: tuple[Floats, Floats]) -> Floats:
    """Return where points (N, 3) mm are before any load."""
    return np.concatenate([points[1], points[0][:, None]], axis=1)


def solved(laws: Sequence[Law], pull: Floats, gravity: Floats, past: Past | None = None) -> Poses:
    """Return the finger in equilibrium under pulls (K, 4) mm and gravity (K, 3) g.

    The gravity is declared; `laws` make the finger.
    """
    design = finger(1)
    for law in laws:
        design = law.design(design)
    loads = Loads(pull, np.asarray(gravity, float), np.zeros((len(pull), 3)))
    poses = guessed(pull)
    if any(law.NAME == "magnet" for law in laws):
        poses = settle(design, loads, poses)
    for law in laws:
        loads = law.loads(loads, poses)
    poses = settle(design, loads, poses)
    for law in laws:
        tension = None if past is None else law.tension(past)
        if tension is not None:
            return dragged(design, replace(loads, tension=tension), poses)
    return poses


def guessed(pull: Floats) -> Poses:
    """Return the rough state of the plain finger under pulls (K, 4) mm.

    Its strains are interpolated in a small table.
    """
    from scipy.interpolate import RegularGridInterpolator

    half = pull.shape[1] // 2
    first, second = pull[:, :half], pull[:, half:]
    u = np.where(first >= second, first, -second)
    axis, table = _table()
    values = RegularGridInterpolator([axis] * half, table, bounds_error=False, fill_value=None)(u)
    return laid(finger(1), values.reshape(len(u), -1, 6))


@lru_cache(maxsize=1)
def _table() -> tuple[Floats, Floats]:
    axis = np.linspace(-18.0, 18.0, GRID)
    table = kept(
        "rod-start",
        (sources(), GRID),
        lambda: {"strain": strains(finger(1), settle(finger(1), hanging(grid(axis))))},
    )
    return axis, table["strain"].reshape(GRID, GRID, -1)


def grid(axis: Floats) -> Floats:
    return np.stack([g.ravel() for g in np.meshgrid(axis, axis, indexing="ij")], axis=1)


def hanging(u: Floats) -> Loads:
    pull = np.concatenate([u, -u], axis=1)
    return Loads(pull, np.tile(HANGING, (len(u), 1)), np.zeros((len(u), 3)))


@lru_cache(maxsize=1)
def sources() -> str:
    """Return a digest of what the rod is: other sources, other sweeps."""
    files = [Path(__file__).with_name(n) for n in SOURCES]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def stored(name: str, of: tuple[object, ...], make: Callable[[], dict[str, Any]]) -> Path:
    """Return the archive of what `make` computes, written once for the same `of`."""
    path = KEPT / f"{name}-{hashlib.sha256(repr(of).encode()).hexdigest()[:12]}.npz"
    if not path.exists():
        KEPT.mkdir(parents=True, exist_ok=True)
        half = path.with_suffix(f".{os.getpid()}.npz")
        np.savez(half, **make())
        half.replace(path)
    return path


def kept(name: str, of: tuple[object, ...], make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return what `make` computes, as `stored`."""
    with np.load(stored(name, of, make), allow_pickle=False) as archive:
        return dict(archive)
