"""The right answers for a hidden law: families, names of effects, verdicts.

The hidden laws of slices A and B have the library's names. Those of the other slices define their
answers here. Names are patterns of `fnmatch`, because the library's name of friction along the body
was not decided. `FAMILY` holds the families of DISCOVERY §7; a law that two of them describe has
both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from typing import Any

Names = tuple[str, ...]

MAP: Names = ("static map",)
SHAPE: Names = ("body", "static shape")
FAMILY: dict[str, Names] = {
    "offset": (*MAP, "static shape"),
    "gain": MAP,
    "cable_gain": MAP,
    "latency": ("delay",),
    "lag": ("delay",),
    "rate_limit": ("delay", "rate"),
    "saturation": MAP,
    "eccentric_pulley": MAP,
    "servo_swap": ("coupling", "static map"),
    "backlash": ("memory",),
    "friction": ("memory",),
    "body_friction": ("memory",),
    "dead_zone": MAP,
    "tendon_stretch": MAP,
    "tendon_creep": ("creep",),
    "coupling": ("coupling", "static shape"),
    "anchor_slip": ("step", "time"),
    "hysteresis": ("memory",),
    "creep": ("creep",),
    "mullins": ("softening", "memory"),
    "thermal_softening": ("temperature",),
    "asymmetry": MAP,
    "gravity": ("load",),
    "payload": ("load",),
    "stiffness_gradient": SHAPE,
    "stiff_section": SHAPE,
    "one_sided_stiffness": SHAPE,
    "twist": SHAPE,
    "pre_curve": SHAPE,
    "kink": SHAPE,
    "routing": (*SHAPE, "coupling"),
    "contact": SHAPE,
    "mount": ("frame",),
    "scale": ("frame",),
    "camera_drift": ("frame drift",),
    "clock_shift": ("delay",),
    "frayed_cable": ("step", "time"),
    "chatter": ("memory", "rate", "delay"),
    "leaking_cell": ("memory", "creep"),
    "magnet": (*SHAPE, "load"),
    "crack": SHAPE,
    "gate": ("coupling", "memory"),
}
NAMES: dict[str, Names] = {
    "cable_gain": ("gain", "asymmetry", "cable_gain"),
    "body_friction": ("friction", "*_friction"),
    "dead_zone": ("dead_zone", "slack"),
}
ALSO: dict[str, Names] = {"cable_gain": ("gain", "asymmetry")}
UNKNOWN_VERDICTS: Names = ("partly_explained", "measurement_fault")
OPEN_VERDICTS: Names = ("partly_explained", "ambiguous", "cannot_tell")
LAW_OPEN: Names = ("partly_explained", "ambiguous")


@dataclass(frozen=True)
class Answer:
    """The right answer for one hidden law.

    Any of `families`, any of `names` (none: no name of the library is right), names that are
    allowed in addition, and the verdicts.
    """

    families: Names
    names: Names = ()
    also: Names = ()
    verdicts: Names = LAW_OPEN

    def to_dict(self) -> dict[str, Any]:
        """Return the answer as JSON data."""
        return {key: list(value) for key, value in asdict(self).items()}


def answer_for(law: str, known: bool = True) -> Answer:
    """Return the right answer for a law by its name; `known` to the library."""
    if not known:
        return Answer(FAMILY.get(law, ()), verdicts=UNKNOWN_VERDICTS)
    return Answer(
        FAMILY.get(law, ()), NAMES.get(law, (law,)), ALSO.get(law, ()), ("identified", "ambiguous")
    )


def matches(name: str, patterns: Names | list[str]) -> bool:
    """Return whether a name is one of `patterns`."""
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def fits_family(said: str, right: Mapping[str, Any]) -> bool:
    """Return whether a reported family is one of a stored answer."""
    return said.lower().replace("_", " ") in right["families"]
