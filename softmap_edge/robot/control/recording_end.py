"""Detect a recording that ended before its loop, and report the cause and the last recorded time.

Pinned by tests/robot/test_record_cut.py and tests/robot/test_recording_damage.py.
"""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

from softmap_edge import _core
from softmap_edge.errors import SoftmapError

LOOP = "/loop"


def system_words(fault: str) -> str:
    """Return the operating system's text for a failed write, in the form of the other messages."""
    words = re.sub(r" \(os error \d+\)$", "", fault.strip())
    return words[:1].lower() + words[1:] if words[1:2].islower() else words


def broken_recording(file: Path, fault: str | None, lost: int, ended: bool) -> str | None:
    """Return why a recording ended early, as text; None if it did not.

    Args:
        file: the recording
        fault: why its loop could not write on
        lost: number of periods that came faster than the disk could write
        ended: whether the loop has ended, so that the file must exist
    """
    if fault is not None:
        return (
            f"{system_words(fault)}: {file}{_up_to(file)}; the recording broke off, and what it "
            "has is kept"
        )
    if ended and not file.exists():
        return (
            f"{file}: the recording is gone; the file was moved or removed while the robot was "
            "driven"
        )
    if lost:
        return f"{file}: {lost} periods are missing; the disk was too slow for them"
    return None


def _up_to(file: Path) -> str:
    """Return the time up to which a recording is readable, as text."""
    times: list[int] = []
    with contextlib.suppress(SoftmapError):
        times = [time for topic, time, _ in _core.read_recording(str(file)) if topic == LOOP]
    return (
        f", recorded up to {(times[-1] - times[0]) * 1e-9:.1f} s"
        if times
        else ", nothing was recorded"
    )
