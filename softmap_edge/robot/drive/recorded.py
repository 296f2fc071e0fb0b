"""Combine the recording of a control loop and the stored camera frames into one run.

`softmap track S --sim --record s.mcap` leaves `s.mcap` and next to it `s.seen` (`observations.py`);
opening the first as a run reads both. Pinned by tests/robot/test_recorded.py and
tests/robot/test_record_robot.py.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RecordingWarning, RunError
from softmap_edge.files.printable import shell_file
from softmap_edge.model.model import Model
from softmap_edge.model.servo_calibration import TICKS, converted
from softmap_edge.robot.control.recording import Recording, read_recording
from softmap_edge.robot.drive.observations import read_kept, seen_file
from softmap_edge.robot.link.frames import Frame, HostClock
from softmap_edge.run.run import DAMAGE, Run

RECORDING = ".mcap"


def open_run(path: str | Path, model: Model | None = None) -> Run:
    """Return the run of a file: .npz, or a recording of a control loop (.mcap).

    A recording includes its stored frames, if there are any. A recording that is truncated, or
    damaged at one place, is read up to there, and a `RecordingWarning` is issued.

    Args:
        path: the file
        model: model that the run is for; if it is in mm and has no calibration, the run is in mm by
            the map in the recording

    Raises:
        RunError: it is neither, is damaged at an unknown place, torque was never on, its stored
            frames do not belong to it, or it was made by `softmap record`, which alone has the
            declarations.
    """
    run, incomplete = open_incomplete(path, model)
    if incomplete is not None:
        warnings.warn(RecordingWarning(incomplete), stacklevel=2)
    return run


def open_incomplete(path: str | Path, model: Model | None = None) -> tuple[Run, str | None]:
    """Return the run as `open_run` does, without a warning, and a sentence on missing data.

    The sentence is None if the run is complete.

    Raises:
        RunError: as `open_run`.
    """
    file = Path(path)
    if file.suffix.lower() != RECORDING:
        return Run.load(file), None
    recording = read_recording(file)
    if recording.doubtful:
        raise RunError(
            f"{recording.incomplete}; copy it again, or take it as it is "
            f"by `softmap servo replay {shell_file(file)} "
            "--run RUN.npz`"
        )
    return run_of(recording, model)


def run_of(recording: Recording, model: Model | None = None) -> tuple[Run, str | None]:
    """Return a recording as a run, and a sentence on missing data.

    The run has the frames of the `.seen` file, if there is one.

    Raises:
        RunError: as `open_run`, except for numbers that may be wrong.
    """
    kept_in = seen_file(recording.file)
    run, lacks = _seen(recording, kept_in) if kept_in.exists() else (recording.run(), None)
    if recording.incomplete is not None and not kept_in.exists():
        lacks = f"its file {kept_in.name} is missing, so the run has no seen frames"
    lacks = "; ".join(filter(None, [recording.incomplete, lacks])) or None
    if lacks is not None:
        run = replace(run, extra=run.extra | {DAMAGE: np.array(lacks)})
    if model is None or model.calibration is not None or model.command_unit == TICKS:
        return run, lacks
    return converted(model, run), lacks


def _seen(recording: Recording, kept_in: Path) -> tuple[Run, str | None]:
    """Return a recording with its stored frames, and a sentence on the missing part."""
    kept = read_kept(kept_in)
    if kept.clock:
        raise RunError(
            f"{recording.file}: of a command file that was cut; `softmap record COMMANDS "
            f"--recover {kept_in} --record {recording.file} --out RUN.npz` makes its run"
        )
    run, inside = with_seen(
        recording, [frame for _, frame in kept.taken], kept.camera, kept.vertices
    )
    if len(inside) and not inside.any():
        raise RunError(
            f"{kept_in}: none of its {len(inside)} frames was seen while {recording.file.name} "
            "was driven; is it that of another recording? Move it away, and the run counts as "
            "one without camera frames"
        )
    return replace(run, robot=kept.robot), kept.lacks


def with_seen(
    recording: Recording, frames: Sequence[Frame], camera: HostClock, vertices: int | None
) -> tuple[Run, NDArray[np.bool_]]:
    """Return a recording as a run with these frames, and which of them (K,) are within it.

    Args:
        camera: clock of the frames
        vertices: number of points in a frame of the full body; any other number are markers

    Raises:
        RunError: as `Recording.run`, or if frames have different numbers of points.
    """
    run = recording.run()
    counts = sorted({len(frame.points) for frame in frames})
    if len(counts) > 1:
        raise RunError(
            f"{recording.file}: frames of {counts} points; a camera's program sends one number of "
            "them throughout"
        )
    taken = camera.times(frames) - recording.begun
    inside = (taken > run.t[0]) & (taken < run.t[-1])
    if not inside.any():
        return run, inside
    points = np.array([frame.points for frame in frames], float)[inside]
    full_body = counts == [vertices]
    return replace(
        run,
        t_seen=taken[inside],
        vertices=points if full_body else None,
        markers=None if full_body else points,
        visible=np.isfinite(points).all(axis=2),
    ), inside
