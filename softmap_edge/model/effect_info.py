"""Declarations of compiled and user-defined effects, by name in the order of their stages.

Pinned by tests/model/test_look.py and tests/model/test_own_effect.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from softmap_edge import _core


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect: no change at `null`, range `low` to `high`, fits begin at `start`.

    `per_channel`, `per_cable` and `per_pair` state what has a separate number; `shared` numbers are
    equal unless split. If the data require it, a fit exceeds `high`: up to `half_ranges` of the
    command, or up to the weight that displaces the body by so many of its `lengths`. While a static
    map is fitted as well, `high` is `map_half_ranges` of the command, or `map_high`, unless both
    are 0. An `instant` is a time of the run, in seconds.
    """

    name: str
    unit: str
    null: float
    start: float
    low: float
    high: float
    doc: str
    log: bool = False
    integer: bool = False
    instant: bool = False
    per_channel: bool = False
    shared: bool = False
    per_cable: bool = False
    per_pair: bool = False
    half_ranges: float = 0.0
    lengths: float = 0.0
    map_half_ranges: float = 0.0
    map_high: float = 0.0


@dataclass(frozen=True)
class EffectInfo:
    """The declaration of an effect.

    `stage` is its place in the chain. `role` is the input of its law ("channel", "shape", "prior"
    or "sensing"), `kind` "effect" or "fault". `experiment` is the block that shows it, and its
    minutes. `alike` lists effects of the same form and the condition that separates them ("never"
    if none does). `needs` are fields of a run.
    """

    name: str
    family: str
    stage: str
    role: str
    kind: str
    remembers: bool
    own: bool
    formula: str
    doc: str
    signature: str
    reference: str
    experiment: tuple[str, float]
    alike: Mapping[str, str]
    needs: tuple[str, ...]
    parameters: tuple[Parameter, ...]

    @property
    def is_fault(self) -> bool:
        """Whether it is a fault of set-up or measurement, not physics of the robot."""
        return self.kind == "fault"

    @property
    def on_commands(self) -> bool:
        """Whether its law changes commands."""
        return self.role == "channel"

    @property
    def on_outputs(self) -> bool:
        """Whether it can act on outputs without a body: on the command or the clock."""
        return self.on_commands or (self.role == "sensing" and self.family == "delay")

    @property
    def needs_time(self) -> bool:
        """Whether it is a delay, rate or time constant; an instant may also be a row."""
        units = [parameter.unit for parameter in self.parameters if not parameter.instant]
        return any(unit == "s" or unit.endswith(("/s", "/min")) for unit in units)


Registry = Mapping[str, EffectInfo]


def registry() -> dict[str, EffectInfo]:
    """Return the declarations of all effects by name, user-defined ones last in their stage."""
    found = {}
    for row in _core.effects():
        parameters = tuple(Parameter(**parameter) for parameter in row["parameters"])
        lists = {"parameters": parameters, "needs": tuple(row["needs"])}
        found[row["name"]] = EffectInfo(**row | lists)
    return found


def effects_that(role: str) -> set[str]:
    """Return the names of the effects with a role."""
    return {info.name for info in registry().values() if info.role == role}
