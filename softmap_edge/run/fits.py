"""Check whether runs can be joined: one robot and unit, equal channels, points and conditions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from softmap_edge.errors import RunError
from softmap_edge.run.fields import FieldName, RealField
from softmap_edge.run.run import Run

REST_MM = 1e-6  # mm by which the markers at rest may differ
# fields that belong to the robot, equal in all runs
ONCE: tuple[RealField, ...] = ("marker_rest", "cameras")
OPTIONAL: tuple[FieldName, ...] = (
    "present",
    "present_ticks",
    "current",
    "temperature",
    "load",
    "gravity",
    "sigma",
    "frame_sigma",
    "frame",
)


def check_fit(runs: Sequence[Run]) -> None:
    """Raise RunError with both values if a run does not match the first one."""
    for number, run in enumerate(runs[1:], start=2):
        for what, first, other in _facts(runs[0], run):
            if first != other:
                raise RunError(
                    f"run {number} has {_text(other)} {what}, the first run {_text(first)}; join "
                    "runs of one robot, recorded and imported in the same way"
                )
    for number, run in enumerate(runs, start=1):
        for name in OPTIONAL:
            _check_held(name, number, run, runs[0])
        for own in ONCE:
            _check_held(own, number, run, runs[0])
            _check_equal(own, number, run, runs[0])


def _facts(one: Run, other: Run) -> Iterator[tuple[str, object, object]]:
    """Yield the properties that must agree, as (name, value of the first run, of the other)."""
    if one.robot is not None and other.robot is not None:
        yield "as its robot", one.robot, other.robot
    yield "as the kind of its commands", _kind(one), _kind(other)
    yield "command channels", one.channels, other.channels
    yield "as the unit of its commands", one.command_unit, other.command_unit
    yield "as what was seen", _seen(one), _seen(other)
    yield "points a frame", _count(one), _count(other)
    yield "as the names of its markers", one.marker_names, other.marker_names
    yield "as its outputs", _outputs(one), _outputs(other)
    yield "as its time", _time(one), _time(other)


def _outputs(run: Run) -> str | None:
    """Return names and unit of the outputs; None for positions."""
    return None if run.output is None else f"{', '.join(run.output.names)} in {run.output.unit}"


def _time(run: Run) -> str:
    """Return the kind of a run's times."""
    return "rows without time" if run.timeless else "seconds"


def _text(value: object) -> str:
    """Return a value as printed in a message."""
    return (
        ", ".join(value[:6]) + ", …" * (len(value) > 6) if isinstance(value, list) else str(value)
    )


def _kind(run: Run) -> str:
    """Return whether the commands are in ticks or in the command unit."""
    return "ticks" if run.ticks is not None else "commands"


def _seen(run: Run) -> str:
    """Return the kind of points that a run holds."""
    return run.seen or "nothing"


def _count(run: Run) -> int:
    """Return the number of points in a frame; 0 for clouds."""
    return 0 if run.places is None else int(run.places.shape[1])


def _check_held(name: FieldName, number: int, run: Run, first: Run) -> None:
    """Raise RunError if a field is in one of two runs only."""
    if (first.array(name) is None) != (run.array(name) is None):
        holds, lacks = (1, number) if run.array(name) is None else (number, 1)
        raise RunError(
            f"{name}: run {holds} holds it, run {lacks} does not; declare it in both, or leave it "
            f"out (--drop {name})"
        )


def _check_equal(name: RealField, number: int, run: Run, other: Run) -> None:
    """Raise RunError if a field of two runs differs although it must agree."""
    first, value = other.array(name), run.array(name)
    if first is None or value is None:
        return
    if first.shape != value.shape or not np.allclose(first, value, rtol=0.0, atol=REST_MM):
        off = (
            f"by up to {np.abs(first - value).max():.3g} mm"
            if first.shape == value.shape
            else "in their number"
        )
        raise RunError(
            f"{name}: that of run {number} differs from that of run 1 {off}; join runs of one "
            f"set-up, or leave it out (--drop {name})"
        )
