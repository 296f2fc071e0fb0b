"""The limits of a rig for all of its servos: `[ceiling]` of its `rig.toml`.

Limits of a single servo stand in its `[[servo]]` table. The ceiling replaces softmap's own cautious
defaults; a bundle's `safety.toml` can only tighten it (`limits.py`). Pinned by
tests/robot/test_limits.py and tests/robot/test_rig_limits.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from softmap_edge import _core
from softmap_edge.errors import ServoError
from softmap_edge.files.atomic import Document
from softmap_edge.files.toml import TomlTable
from softmap_edge.robot.servo.loop_types import LoopLimits

if TYPE_CHECKING:
    from softmap_edge.robot.servo.rig import Rig

Value = float | tuple[float, float]

# Limits that a rig cannot set: its rate, counted or homed values, and a servo's own data.
OTHERS = ("servos", "period", "home", "fastest", "voltage")
AT_LEAST = ("low", "ramp", "band")  # of these the larger value is the stricter one
# Name: lowest and highest value, from the compiled guard, which checks them again together.
RANGES: Mapping[str, tuple[float, float]] = {
    "current_mA" if name == "current" else name: (low, high)
    for name, (low, high, _) in _core.limit_ranges().items()
    if name not in OTHERS
}
# limits of a single servo
OF_EACH = ("low", "high", "slew", "acceleration", "current_mA", "following", "warm", "hot")


@dataclass(frozen=True)
class Ceiling:
    """Limits by name (RANGES), as far as the rig sets them."""

    values: tuple[tuple[str, Value], ...] = ()

    def get(self, name: str) -> Value | None:
        """Return a limit; None if the rig does not set it."""
        return dict(self.values).get(name)

    def number(self, name: str) -> float | None:
        """Return a limit that is one number, None where the rig sets none."""
        value = self.get(name)
        return None if isinstance(value, tuple) else value

    def to_toml(self) -> list[str]:
        """Return the lines of its table; none if it is empty."""
        lines = [f"{name} = {list(v) if isinstance(v, tuple) else v!r}" for name, v in self.values]
        return ["", "[ceiling]", *lines] if lines else []


def read_ceiling(table: TomlTable) -> Ceiling:
    """Read the limits of a rig.

    Raises:
        RunError: a name is unknown, or a value is out of range.
        ServoError: a pair is invalid, or `warm` is above `hot`.
    """
    found: list[tuple[str, Value]] = []
    for name, (low, high) in RANGES.items():
        if name == "jump":
            pair = table.numbers(name, (2,))
            if pair is not None and not low <= pair[0] <= pair[1] <= high:
                raise ServoError(
                    f"{table.where}: jump = {pair.tolist()}, expected 0 ≤ warned ≤ refused ≤ "
                    f"{high:g} ticks"
                )
            if pair is not None:
                found.append((name, (float(pair[0]), float(pair[1]))))
        elif (value := table.number(name, None, low, high)) is not None:
            found.append((name, value))
    table.done()
    ceiling = Ceiling(tuple(found))
    warm, hot = ceiling.get("warm"), ceiling.get("hot")
    if isinstance(warm, float) and isinstance(hot, float) and warm > hot:
        raise ServoError(f"{table.where}: warm = {warm:g}, expected at most hot = {hot:g} °C")
    return ceiling


def check_against_rig(rig: Rig, limits: LoopLimits) -> None:
    """Reject limits of a robot that its rig does not allow.

    Raises:
        ServoError: a servo's home differs from the rig's, or a limit is above the ceiling.
    """
    for k, servo in enumerate(rig.servos):
        home = limits["servos"][k]["home"]
        if servo.home is not None and home != servo.home:
            raise ServoError(
                f"servo {servo.id}: the limits are about home at {home}, the rig's is "
                f"{servo.home}; make the limits of the rig (`combined`, or `servo_limits` with "
                "its home)"
            )
    for where, name, value, most in _both(rig, cast(Document, limits)):
        if value is not None and (value < most if name in AT_LEAST else value > most):
            raise ServoError(
                f"{where}{name} is {value:g}, the rig allows {most:g}; make the limits of the "
                "rig (`combined`), or change its [ceiling] knowingly"
            )


def _both(rig: Rig, limits: Document) -> Iterator[tuple[str, str, float | None, float]]:
    """Yield each limit that the rig sets: its servo, its name, its value and the ceiling."""
    for name in RANGES:
        most = rig.ceiling.get(name)
        if name not in OF_EACH:
            if isinstance(most, tuple):
                yield from (("", name, one, end) for one, end in zip(limits[name], most))
            elif most is not None:
                yield "", name, limits[name], most
            continue
        for servo, table in zip(rig.servos, limits["servos"]):
            value = table["current" if name == "current_mA" else name]
            if name in ("low", "high"):
                value -= table["home"]
            for end in (rig.ceiling.number(name), getattr(servo, name, None)):
                if end is not None:
                    yield f"servo {servo.id}: ", name, value, end
