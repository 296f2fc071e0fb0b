"""The description of a tendon robot, read from `robot.toml`.

It holds segments, tendons, markers, and the parameters that a fit may change.

It is read by `softmap learn RUN --robot robot.toml`; examples/tdcr_robot.toml is the template.
Unknown keys are rejected; the error lists the valid ones. Units: mm, degrees; stiffness in mm²
(bending over tendon stiffness).
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RobotError, SoftmapError, brief
from softmap_edge.files.atomic import own_text
from softmap_edge.files.toml import TomlTable, parsed
from softmap_edge.model.elastic_rod import MODES, Coordinates, RodLayout

Floats = NDArray[np.float64]

SCHEMA = "softmap.robot/1"
EXAMPLE = "examples/tdcr_robot.toml shows the form"
_SIZE = 100_000  # limit of a description, bytes
_MOST = 64  # segments, tendons, commands


@dataclass(frozen=True, eq=False)
class Robot:
    """A tendon robot: its `layout`, the start (P,) of fits, and their `modes`.

    Modes define the parameters that a fit may change.

    With `angles_known` false, the tendons' angles are estimated from the run.
    """

    name: str
    layout: RodLayout
    start: Floats
    modes: dict[str, str]
    angles_known: bool = True

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Robot:
        """Read a `robot.toml`.

        Raises:
            RobotError: it cannot be read, or a key is unknown, missing or out of range; the message
                names it.
        """
        file = Path(path)
        try:
            if file.stat().st_size > _SIZE:
                raise RobotError(
                    f"{file}: {file.stat().st_size} bytes, a robot's file has at most {_SIZE}; "
                    f"{EXAMPLE}"
                )
            text = own_text(file, _SIZE)
        except OSError as cause:
            raise RobotError(
                f"{file}: cannot be read ({cause.strerror or cause}); give a robot.toml"
            ) from None
        except UnicodeDecodeError:
            raise RobotError(f"{file}: is not text; give a robot.toml, {EXAMPLE}") from None
        return cls.from_toml(text, str(file))

    @classmethod
    def from_toml(cls, text: str, where: str = "robot.toml") -> Robot:
        """Return the robot of a file's text; `where` is the prefix of error messages.

        Raises:
            RobotError: as for `load`.
        """
        try:
            top = TomlTable(parsed(text), where)
            return _robot(top)
        except (tomllib.TOMLDecodeError, RecursionError) as cause:
            raise RobotError(f"{where}: is not a TOML file ({brief(cause)}); {EXAMPLE}") from None
        except RobotError:
            raise
        except (SoftmapError, ValueError) as cause:
            raise RobotError(
                str(cause) if where in str(cause) else f"{where}: {brief(cause)}; {EXAMPLE}"
            ) from None

    def with_slack(self, slack: float) -> Robot:
        """Return the robot with other tendons, fixed in fits.

        0 is for cables, 1 for two-sided tendons.
        """
        start = self.start.copy()
        start[self.layout.places()["slack"]] = slack
        return replace(self, start=start, modes=self.modes | {"slack": "known"})

    def coordinates(self, start: Floats | None = None) -> Coordinates:
        """Return the free parameters around `start` (P,), by default that of the file."""
        return Coordinates(self.layout, self.start if start is None else start, self.modes)


def _robot(top: TomlTable) -> Robot:
    schema = top.get("schema", (str,), "")
    if schema != SCHEMA:
        raise RobotError(
            f"{top.where}: schema '{schema[:60]}', expected '{SCHEMA}'; put schema = \"{SCHEMA}\" "
            "in the first line"
        )
    name = top.get("name", (str,), "robot")
    if not 1 <= len(name) <= 100 or not name.isprintable():
        raise RobotError(
            f"{top.where}: name of {len(name)} characters, expected 1 to 100 that can be printed"
        )
    body, tendons, fit = (top.table(key) for key in ("body", "tendons", "fit"))
    segments = body.integer("segments", None, 1, 32)
    if segments is None:
        raise RobotError(f"{body.where}: segments is missing; say how many parts bend, each evenly")
    ends = _integers(tendons, "segment", None, segments)
    count = len(ends)
    channel = _integers(tendons, "command", list(range(1, count + 1)), _MOST)
    if len(channel) != count or sorted(set(channel)) != list(range(1, max(channel) + 1)):
        raise RobotError(
            f"{tendons.where}: command names {sorted(set(channel))} for {len(channel)} of {count} "
            "tendons; give each tendon the number of the command that draws it in, from 1, none "
            "left out"
        )
    layout = RodLayout(
        segments=segments,
        channels=max(channel),
        ends=tuple(end - 1 for end in ends),
        channel=tuple(c - 1 for c in channel),
        pull=tuple(_spread(tendons, "pull", count, 1.0, -1e4, 1e4).tolist()),
        at=_markers(body, segments),
    )
    angles_known = "angle_deg" in tendons.values
    start = np.concatenate(
        [
            _spread(tendons, "slack", 1, 0.0, 0.0, 1.0),
            np.deg2rad(_spread(tendons, "angle_deg", count, 0.0, -720.0, 720.0)),
            _spread(tendons, "radius_mm", count, None, 1e-2, 1e4),
            _spread(tendons, "pretension_mm", count, 0.0, -1e3, 1e3),
            _spread(body, "stiffness_mm2", segments, None, 1e-2, 1e5),
            _spread(body, "length_mm", segments, None, 0.1, 1e5),
            np.deg2rad(_spread(body, "rest_deg", 2 * segments, 0.0, -360.0, 360.0)),
            _spread(body, "base_mm", 3, 0.0, -1e5, 1e5),
            np.deg2rad(_spread(body, "tilt_deg", 2, 0.0, -180.0, 180.0)),
        ]
    )
    layout.compiled(start)  # the core makes the final check
    modes = {kind: fit.choice(kind, allowed, "known") for kind, allowed in MODES.items()}
    if not angles_known and modes["angle"] != "each":
        raise RobotError(
            f'{tendons.where}: angle_deg is missing and [fit] angle is not "each"; give one of them'
        )
    for table in (body, tendons, fit, top):
        table.done()
    return Robot(name, layout, start, modes, angles_known)


def _spread(
    table: TomlTable, key: str, count: int, default: float | None, low: float, high: float
) -> Floats:
    """Return `count` numbers within low … high: one for all, or a list of them.

    Nested lists are flattened.
    """
    value = table.get(key, (int, float, list), default)
    if value is None:
        raise RobotError(
            f"{table.where}: {key} is missing; give one number for all, or a list of {count}"
        )
    try:
        flat = np.array(value, float).reshape(-1)
    except (ValueError, TypeError, OverflowError):
        raise RobotError(
            f"{table.where}: {key} is not a list of numbers; give one number, or {count}"
        ) from None
    if len(flat) not in (1, count):
        raise RobotError(
            f"{table.where}: {key} has {len(flat)} numbers, expected one for all or {count}"
        )
    if not np.all((flat >= low) & (flat <= high)):
        wrong = float(flat[~((flat >= low) & (flat <= high))][0])
        raise RobotError(f"{table.where}: {key} holds {wrong:g}, expected {low:g} to {high:g}")
    return np.broadcast_to(flat, count).astype(float)


def _integers(table: TomlTable, key: str, default: Sequence[int] | None, most: int) -> list[int]:
    value = table.get(key, (list,), default)
    good = (
        isinstance(value, list)
        and 1 <= len(value) <= _MOST
        and all(type(v) is int and 1 <= v <= most for v in value)
    )
    if not good:
        raise RobotError(
            f"{table.where}: {key} is not a list of whole numbers 1 to {most}, one a tendon (1 to "
            f"{_MOST})"
        )
    return list(value)


def _markers(body: TomlTable, segments: int) -> tuple[float, ...]:
    """The positions of the markers, base to tip, in segments from the base."""
    value = body.get("markers", (list,), [float(segments)])
    try:
        at = np.array(value, float)
    except (ValueError, TypeError, OverflowError):
        at = np.zeros((0, 0))
    if at.ndim != 1 or not 1 <= len(at) <= 1000 or not np.all((at > 0) & (at <= segments)):
        raise RobotError(
            f"{body.where}: markers is not a list of places above 0 and up to {segments}, in "
            "segments from the base"
        )
    return tuple(at.tolist())
