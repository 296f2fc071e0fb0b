"""Recordings of clouds or vertices that teach together, as one run. Pinned by tests/test_evaluate.py."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from softmap_edge.registration.clouds import clouds_of
from softmap_edge.residual import APART
from softmap_edge.run import Run
from softmap_training.errors import TrainingError

ROWS = ("ticks", "present_ticks", "command", "present", "current", "temperature", "load")  # of a run, one a time


def joined(runs: Sequence[Run]) -> Run:
    """Return runs of clouds, or of vertices, as one, a minute apart.

    Raises:
        TrainingError: they are of other channels, units or fields, or show neither.
    """
    first = runs[0]
    there = [name for name in ROWS if getattr(first, name) is not None]
    for run in runs:
        fields = [name for name in ROWS if getattr(run, name) is not None]
        if fields != there or run.channels != first.channels or run.command_unit != first.command_unit:
            raise TrainingError(
                f"a run of {run.channels} channels with {', '.join(fields)} beside one of {first.channels} "
                f"with {', '.join(there)}; runs that teach together are recorded alike"
            )
        if (run.points is None) != (first.points is None) or (run.vertices is None) != (first.vertices is None):
            raise TrainingError("a run of clouds beside one without; `softmap register` makes vertices of clouds")
    if len(runs) == 1:
        return first
    begins = np.cumsum([0.0, *(float(run.t[-1] - run.t[0]) + APART for run in runs[:-1])])
    shifts = [begin - run.t[0] for begin, run in zip(begins, runs)]
    leans = [np.broadcast_to(run.gravity, (len(run.t), 3)) for run in runs if run.gravity is not None]
    if leans and len(leans) < len(runs):
        raise TrainingError("some of the runs declare gravity and some do not; declare it in all")
    steady = bool(leans) and all((row == leans[0][0]).all() for row in leans)
    rows: dict[str, Any] = {name: np.concatenate([getattr(run, name) for run in runs]) for name in there}
    return replace(
        first, t=np.concatenate([run.t + by for run, by in zip(runs, shifts)]),
        t_seen=np.concatenate([run.t_seen + by for run, by in zip(runs, shifts)]),
        gravity=leans[0][0] if steady else np.concatenate(leans) if leans else None, block=None,
        **rows, **_seen(runs),
    )  # fmt: skip


def _seen(runs: Sequence[Run]) -> dict[str, Any]:
    """Return what runs of one kind show, one after the other."""
    if runs[0].points is not None:
        clouds = [cloud for run in runs for cloud in clouds_of(run)]
        start = np.concatenate([[0], np.cumsum([len(cloud) for cloud in clouds])])
        return {"points": np.concatenate([np.zeros((0, 3)), *clouds]), "start": start}
    vertices = [run.seen_points for run in runs]
    visible = [np.ones(v.shape[:2], bool) if run.visible is None else run.visible for v, run in zip(vertices, runs)]
    sigma = [run.sigma for run in runs if run.sigma is not None]
    if sigma and len(sigma) < len(runs):
        raise TrainingError("some of the runs give `sigma` and some do not; give it in all or in none")
    each = [np.broadcast_to(s, v.shape[:2]) for s, v in zip(sigma, vertices)]
    return {
        "vertices": np.concatenate(vertices),
        "visible": np.concatenate(visible),
        "sigma": np.concatenate(each) if each else None,
    }
