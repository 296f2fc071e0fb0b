"""Whether limits are those of a bench: about the homes that are proved, and none above its ceiling.

Pinned by tests/robot/test_bench_limits.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from softmap_edge.errors import ServoError
from softmap_edge.robot.servo.rig import Rig
from softmap_edge.robot.servo.rig_ceiling import AT_LEAST, RANGES

SERVO = ("low", "high", "slew", "acceleration", "current_mA", "following", "warm", "hot")


def check_bench(rig: Rig, limits: Mapping[str, Any]) -> None:
    """Refuse limits of a robot that its bench does not allow.

    Raises:
        ServoError: a servo's home is another than the one of the rig, which is the one that is proved, or a limit lies
            above the ceiling.
    """
    for k, servo in enumerate(rig.servos):
        home = limits["servos"][k]["home"]
        if servo.home is not None and home != servo.home:
            raise ServoError(
                f"servo {servo.id}: the limits are about home at {home}, the rig's is {servo.home}; make the limits of "
                "the rig (`combined`, or `servo_limits` with its home)"
            )
    for where, name, value, most in _both(rig, limits):
        pairs = zip(value, most) if isinstance(value, (list, tuple)) else [(value, most)]
        for one, end in pairs:
            if one is not None and (one < end if name in AT_LEAST else one > end):
                raise ServoError(
                    f"{where}{name} is {one:g}, the rig allows {end:g}; make the limits of the rig (`combined`), or "
                    "change its [ceiling] knowingly"
                )


def _both(rig: Rig, limits: Mapping[str, Any]) -> Iterator[tuple[str, str, Any, Any]]:
    """Give each limit that the bench sets: of which servo, its name, its value and the ceiling."""
    for name in RANGES:
        most = rig.ceiling.get(name)
        if name not in SERVO:
            if most is not None:
                yield "", name, limits[name], most
            continue
        for servo, table in zip(rig.servos, limits["servos"]):
            value = table["current" if name == "current_mA" else name]
            if name in ("low", "high"):
                value -= table["home"]
            for end in (most, getattr(servo, name, None)):
                if end is not None:
                    yield f"servo {servo.id}: ", name, value, end
