"""Data sets of machines whose memory was always present.

They are a tendon-sheath joint at two bends (ViO-Com) and a friction damper (ARTS).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benches.outside.case import Case, Floats, along_x, text
from benches.outside.rate_free import at_frames, cubic, fitted, play, stop
from softmap_edge import Run, learn_model


def bent(markers: Floats) -> Floats:
    """Return the bending (K, M) in degrees of markers on a circle about the base."""
    return np.degrees(np.arctan2(markers[..., 0], markers[..., 2]))


def vio(folder: Path, name: str) -> Case:
    """Return the case of one bend of the sheath, vio000 or vio090."""
    fit, held = (Run.load(folder / f"{name}_{part}.npz") for part in ("fit", "held"))
    std = float(np.std(bent(np.asarray(held.markers))))
    straight = name == "vio000"

    def columns(run: Run, x: Floats) -> Floats:
        return cubic(at_frames(run, play(run.commands()[:, 0], x[0]), x[1]) / 60.0)

    def law() -> dict[str, Floats]:
        seen = bent(np.asarray(fit.markers))
        starts = [[20.0, 0.02], [45.0, 0.02], [70.0, 0.02]]
        return fitted(columns, fit, seen, {"held": held}, starts, [0.0, 0.0], [110.0, 0.6])

    return Case(
        name=f"ViO-Com {int(name[3:])}°",
        about=text(
            "vio",
            bend="the sheath straight" if straight else "the sheath bent by 90°",
            gap=45 if straight else 58,
            std=std,
            tenth=0.1 * std,
        ),
        values=bent,
        fit=fit,
        held={"held": held},
        model=lambda: learn_model(fit),
        law=law,
        law_name="play, delay, cubic map",
        unit="NRMSE",
        expected="play (backlash)",
    )


def arts(folder: Path) -> Case:
    """Return the case of the damper."""
    fit, held = (Run.load(folder / f"arts_30lb_05hz_1in_{part}.npz") for part in ("fit", "held"))

    def columns(run: Run, x: Floats) -> Floats:
        u = run.commands()[:, 0]
        free = play(u, x[0])
        rows = (u, stop(free, x[1]), stop(u, x[2]))
        now = [at_frames(run, row) for row in rows]
        return np.column_stack(
            [cubic(now[0] / 25.0), cubic(at_frames(run, free) / 25.0)[:, 1:], now[1], now[2]]
        )

    def law() -> dict[str, Floats]:
        starts = [[5.0, 2.0, 2.0], [15.0, 5.0, 2.0], [2.0, 10.0, 4.0]]
        return fitted(
            columns,
            fit,
            along_x(fit.markers),
            {"held": held},
            starts,
            [0.0, 0.1, 0.1],
            [45.0, 25.0, 25.0],
        )

    return Case(
        name="ARTS damper",
        about=text("arts"),
        values=along_x,
        fit=fit,
        held={"held": held},
        model=lambda: learn_model(fit),
        law=law,
        law_name="stop and gap, cubic map",
        unit="NRMSE",
        expected="memory; the law a pair or open",
        per_library_law=True,
    )
