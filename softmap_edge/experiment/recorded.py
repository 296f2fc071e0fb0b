"""What a control loop recorded and what a camera saw meanwhile, as one run.

`softmap track S --sim --record s.mcap` leaves `s.mcap` and beside it `s.seen` (`kept.py`); whoever opens the first as a
run gets both. Pinned by tests/test_recorded.py and tests/test_record_robot.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.camera.frames import Frame, HostClock
from softmap_edge.errors import RunError
from softmap_edge.experiment.kept import read_kept, seen_file
from softmap_edge.model import Model
from softmap_edge.run import Run
from softmap_edge.servo.recording import Recording, read_recording


def open_recording(path: str | Path, model: Model | None = None) -> Run:
    """Return a recording as a run, with what was seen where that was kept beside it.

    Args:
        model: what the run is for. One without a calibration cannot read ticks: it gets mm, by the map that was driven
            with.

    Raises:
        RunError: no recording, damaged, torque was never on, or frames of several numbers of points.
    """
    file = Path(path)
    told = read_recording(file)
    kept = seen_file(file)
    if kept.exists():
        played = read_kept(kept)
        frames = [frame for _, frame in played.taken]
        run, _ = with_seen(told, frames, played.camera, played.vertices)
        run = replace(run, robot=played.robot)
    else:
        run = told.run()
    if model is None or model.calibration is not None or run.ticks is None:
        return run
    known, present = told.calibration, run.present_ticks
    return replace(
        run,
        command=known.commands(run.ticks),
        present=None if present is None else known.commands(present),
        command_unit=known.unit,
        ticks=None,
        present_ticks=None,
    )


def with_seen(
    told: Recording, frames: Sequence[Frame], camera: HostClock, vertices: int | None
) -> tuple[Run, NDArray[np.bool_]]:
    """Return a recording as a run with these frames, and which of them (K,) lie within it.

    Args:
        camera: the clock of the frames. vertices: how many points a frame of the whole body has; any other number are
            markers.

    Raises:
        RunError: as `Recording.run`, or frames of several numbers of points.
    """
    run = told.run()
    counts = {len(frame.points) for frame in frames}
    if len(counts) > 1:
        raise RunError(f"frames of {sorted(counts)} points; a camera's program sends one number of them throughout")
    taken = camera.times(frames) - told.begun
    inside = (taken > run.t[0]) & (taken < run.t[-1])
    points = np.array([frame.points for frame in frames], float).reshape(len(frames), -1, 3)[inside]
    whole = vertices is not None and points.shape[1] == vertices
    return replace(
        run,
        t_seen=taken[inside],
        vertices=points if len(points) and whole else None,
        markers=points if len(points) and not whole else None,
        visible=np.isfinite(points).all(axis=2) if len(points) else None,
    ), inside
