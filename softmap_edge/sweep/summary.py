"""Summarise a sweep, and what its model cannot represent.

`softmap check` and `softmap show` print it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from softmap_edge.files.atomic import Document
from softmap_edge.geometry.centreline import find_centreline
from softmap_edge.sweep.sweep_file import ShapeSweep, is_own_sweep


def summary(sweep: ShapeSweep) -> Document:
    """Return the summary of a sweep, with units in the keys."""
    home = sweep.vertices[int(np.argmin(np.sum(sweep.command**2, axis=1)))]
    line = find_centreline(home, sweep.base)
    body = line.body()
    missing = (
        []
        if sweep.load is not None or "grams" in "".join(sweep.notes)
        else ["no known load: a load is named, its weight in grams is not"]
    )
    missing += (
        []
        if sweep.gravity is not None
        else ["no gravity: taken as hanging (along +z of the base frame)"]
    )
    return {
        "robot": sweep.robot,
        "channels": sweep.command.shape[1],
        "commands": len(sweep.command),
        "grid": None if sweep.axes is None else [len(axis) for axis in sweep.axes],
        "command_unit": sweep.command_unit,
        "command_range": [[float(c.min()), float(c.max())] for c in sweep.command.T],
        "points": sweep.vertices.shape[1],
        "triangles": len(sweep.triangles),
        "length_mm": round(line.length, 3),
        "lean_deg": round(line.lean_deg, 2),
        "bow_mm": round(line.bow_mm, 3),
        "sections": 0 if body is None else body.count,
        "moved_mm": round(float(np.linalg.norm(np.ptp(sweep.vertices, axis=0), axis=1).max()), 3),
        "gravity": None if sweep.gravity is None else sweep.gravity.tolist(),
        "known_load_g": None if sweep.load is None else sweep.load.tolist(),
        "notes": list(sweep.notes),
        "missing": missing,
    }


def read_summary(path: Path) -> Document:
    """Read a sweep file and return its summary; raise SoftmapError.

    The sweep may be imported, or made by `softmap model sweep`.
    """
    if not is_own_sweep(path):
        return summary(ShapeSweep.load_file(path))
    from softmap_edge.fem.simulator import Sweep

    own = Sweep.load(path)
    return summary(
        ShapeSweep(
            command=own.command,
            vertices=own.vertices,
            triangles=own.triangles,
            robot=own.finger.name,
            command_unit=own.finger.command_unit,
            gravity=own.gravity,
            base=np.zeros(3),
            axes=own.axes,
            notes=(
                "made by `softmap model sweep`: a model of it knows its finger, loads in grams "
                "included",
            ),
        )
    )


def sentences(document: Document) -> list[str]:
    """Return a summary in plain words, one line each."""
    d = document
    form = "scattered" if d["grid"] is None else "a grid of " + " × ".join(map(str, d["grid"]))
    lines = [
        f"robot     {d['robot']}",
        f"commands  {d['commands']} of {d['channels']} channels, {form}",
    ]
    for c, (low, high) in enumerate(d["command_range"]):
        lines.append(f"          channel {c}: {low:g} to {high:g} {d['command_unit']}")
    mesh = f"{d['triangles']} triangles" if d["triangles"] else "no mesh"
    parts = f"{d['sections']} sections" if d["sections"] else "each a feature of its own"
    lines.append(
        f"points    {d['points']}, {mesh}, {parts}; they move by up to {d['moved_mm']:g} mm"
    )
    lines.append(
        f"body      {d['length_mm']:g} mm from the base, leans {d['lean_deg']:g}° from z, bows by "
        f"{d['bow_mm']:g} mm at rest"
    )
    load = d["known_load_g"]
    lines.append(
        f"load      {'none is known' if load is None else ', '.join(f'{g:g} g' for g in load[:6])}"
    )
    lines += [f"note      {text}" for text in d["notes"]]
    return lines + [f"missing   {text}" for text in d["missing"]]
