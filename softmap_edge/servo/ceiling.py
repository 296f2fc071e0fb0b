"""What a bench allows all of its servos at most: `[ceiling]` of its `rig.toml`; a servo's own stands behind its id.

It stands in place of softmap's own cautious defaults; a bundle's `safety.toml` can only tighten it (`combined.py`).
Pinned by tests/test_limits.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from softmap_edge.errors import ServoError
from softmap_edge.toml_table import TomlTable

Value = float | tuple[float, float]

FARTHEST = 1_048_575.0  # ticks: 256 turns
# Name: lowest and highest value. The compiled guard checks them again, together.
RANGES: Mapping[str, tuple[float, float]] = {
    "current_mA": (1.0, 6000.0),
    "low": (-FARTHEST, -1.0),  # ticks about home
    "high": (1.0, FARTHEST),
    "slew": (1.0, 20_000.0),  # ticks/s
    "acceleration": (1.0, 1e6),  # ticks/s²
    "following": (1.0, 4096.0),  # ticks
    "warm": (20.0, 80.0),  # °C
    "hot": (30.0, 80.0),
    "stale": (0.001, 2.0),  # s, as all down to `ramp`
    "hold": (0.001, 60.0),
    "slacken": (0.1, 60.0),
    "late": (0.001, 0.5),
    "silent": (0.001, 1.0),
    "grace": (0.001, 2.0),
    "ramp": (0.0, 10.0),
    "jump": (0.0, FARTHEST),  # ticks, a pair: told, refused
    "jog_travel": (1.0, 4096.0),  # ticks
    "jog_slew": (1.0, 1000.0),  # ticks/s
    "jog_current": (0.0, 1000.0),  # mA
    "band": (0.0, 100.0),  # the commands' unit
    "turns": (0.1, 100.0),  # 1/s
    "burst": (1.0, 100.0),
}


@dataclass(frozen=True)
class Ceiling:
    """Limits by name (RANGES), as far as the bench sets them."""

    values: tuple[tuple[str, Value], ...] = ()

    def get(self, name: str) -> Value | None:
        """Return a limit, None where the bench says nothing."""
        return dict(self.values).get(name)

    def to_toml(self) -> list[str]:
        """Return the lines of its table, none where it is empty."""
        lines = [f"{name} = {list(v) if isinstance(v, tuple) else v!r}" for name, v in self.values]
        return ["", "[ceiling]", *lines] if lines else []


def read_ceiling(table: TomlTable) -> Ceiling:
    """Read the limits of a bench.

    Raises:
        RunError: an unknown name, or a value out of range. ServoError: a pair that is none.
    """
    found: list[tuple[str, Value]] = []
    for name, (low, high) in RANGES.items():
        if name == "jump":
            pair = table.numbers(name, (2,))
            if pair is not None and not low <= pair[0] <= pair[1] <= high:
                raise ServoError(f"{table.where}: jump = {pair.tolist()}, expected 0 ≤ told ≤ refused ≤ {high:g} ticks")
            if pair is not None:
                found.append((name, (float(pair[0]), float(pair[1]))))
        elif (value := table.number(name, None, low, high)) is not None:
            found.append((name, value))
    table.done()
    return Ceiling(tuple(found))
