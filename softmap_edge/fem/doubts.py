"""Warn about values of a finger in a possibly wrong unit, and about lost commands.

Commands are lost in the stretch of its tendons.

Nothing is rejected: a body may be hard plastic. A warning is given for a value far outside the
range of soft bodies, with a unit that would explain it. The part of a command that only stretches
the tendons is computed from the tensions of a sweep.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.fem.bodies import Block, Tapered
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.groups import groups_without_region
from softmap_edge.fem.tendons import Tendon

Floats = NDArray[np.float64]

LOST = 0.5  # share of a command that only stretches the tendons, above which a warning is given


@dataclass(frozen=True)
class Typical:
    """The usual and the widest range of a property of soft bodies, and other units.

    Each is in the unit of the field.
    """

    usual: tuple[float, float]
    possible: tuple[float, float]
    unit: str
    of: str
    others: Mapping[str, float]


# Silicones of Shore 00-10 to A 50 are usual; thermoplastic elastomers reach 40 MPa, foams go down
# to 150 kg/m³.
YOUNG = Typical(
    (0.1, 0.6), (0.01, 40.0), "MPa", "soft silicones", {"kPa": 1e-3, "Pa": 1e-6, "GPa": 1e3}
)
DENSITY = Typical((950.0, 1300.0), (150.0, 3000.0), "kg/m3", "silicones", {"g/cm3": 1e3})
CABLE = Typical(
    (5.0, 100.0), (0.2, 1500.0), "N/mm", "a cable and its drive", {"N/m": 1e-3, "kN/mm": 1e3}
)
HEIGHT = Typical(
    (30.0, 400.0), (5.0, 2000.0), "mm", "fingers", {"m": 1e3, "cm": 10.0, "inches": 25.4}
)
COMMAND = Typical(
    (0.02, 0.2), (2e-4, 1.0), "of the tendon's length", "commands", {"m": 1e3, "cm": 10.0}
)


def doubts(finger: Finger) -> list[str]:
    """Return a sentence for each suspicious value of a finger and its mesh file.

    Raises:
        FingerError: its mesh file cannot be read.
    """
    found = [
        doubt("young_mpa", finger.young_mpa, YOUNG),
        doubt("density_kg_m3", finger.density_kg_m3, DENSITY) if finger.density_kg_m3 else "",
        doubt("stiffness_n_mm", finger.cable_stiffness_n_mm, CABLE) if _by_length(finger) else "",
        doubt("the height of the body", _height(finger), HEIGHT),
        *(_short(number, tendon) for number, tendon in enumerate(finger.tendons)),
        _commands(finger),
        *(_region(number, region.young_mpa) for number, region in enumerate(finger.regions)),
        groups_without_region(finger),
    ]
    return [sentence for sentence in found if sentence]


def doubt(name: str, value: float, typical: Typical) -> str:
    """Return a sentence if a value is implausible; else "".

    It states the ratio to usual values, and the unit it may be in.
    """
    low, high = typical.possible
    if low <= value <= high:
        return ""
    least, most = typical.usual
    ratio = value / most if value > high else least / value
    way = "times as much as" if value > high else "times less than"
    fits = [
        unit for unit, factor in typical.others.items() if least / 4 <= value * factor <= 4 * most
    ]
    unit = (
        f": is it in {fits[0]}? Then write {value * typical.others[fits[0]]:.4g}"
        if fits
        else ": check its unit"
    )
    usual = f"{typical.of} have ({least:g} to {most:g} {typical.unit})"
    return f"{name} = {value:g} is {float(f'{ratio:.2g}'):g} {way} {usual}{unit}"


def lost_in_tendons(finger: Finger, command: Floats, pull: Floats) -> str:
    """Return a sentence if the tendons' stretch absorbs most of the commands.

    Args:
        finger: a finger driven by lengths; with tensions nothing is lost.
        command: commands of a sweep, (S, C) mm.
        pull: pull of the tendons, (S, T) N.

    Returns:
        str: the sentence with the share and an example; "" if less is lost.
    """
    if not _by_length(finger) or not command.size:
        return ""
    shortened = np.zeros(pull.shape)
    for c, pair in enumerate(finger.pairs):
        for tendon, sign in zip(pair, (1.0, -1.0)):
            shortened[:, tendon] += sign * command[:, c]
    stretch = np.maximum(pull, 0.0) / finger.cable_stiffness_n_mm
    far = shortened >= 0.8 * shortened.max(initial=0.0)
    far &= shortened > 0.0
    if not far.any():
        return ""
    share = float(np.sum(stretch[far]) / np.sum(shortened[far]))
    if share < LOST:
        return ""
    row, tendon = (
        int(k) for k in np.unravel_index(np.argmax(np.where(far, shortened, -1.0)), far.shape)
    )
    return (
        f"most of the command is lost in the stretch of the tendons: {100 * share:.0f} %, as at "
        f"{shortened[row, tendon]:.3g} mm, where {max(pull[row, tendon], 0.0):.3g} N stretch "
        f"tendon {tendon} by {stretch[row, tendon]:.3g} mm; check young_mpa and [cable] "
        f"stiffness_n_mm = {finger.cable_stiffness_n_mm:g}"
    )


def _by_length(finger: Finger) -> bool:
    return bool(finger.tendons) and finger.command_unit == "mm"


def _height(finger: Finger) -> float:
    """Return the height of a body above its base, mm."""
    solid = finger.solid
    return (
        solid.height_mm if isinstance(solid, Tapered | Block) else float(solid.nodes()[:, 2].max())
    )


def _region(number: int, young: float) -> str:
    """Return a warning if the modulus of a region is too low; a part of a body may be hard."""
    return doubt(f"region[{number}].young_mpa", young, YOUNG) if young < YOUNG.possible[0] else ""


def _length(tendon: Tendon) -> float:
    guides = np.asarray(tendon.guides(50), float)
    return float(np.sum(np.linalg.norm(np.diff(guides, axis=0), axis=1)))


def _short(number: int, tendon: Tendon) -> str:
    length = _length(tendon)
    if length >= HEIGHT.possible[0] / 5:
        return ""
    return (
        f"tendon[{number}] is {length:.3g} mm long: are its points in m? Then multiply them by 1000"
    )


def _commands(finger: Finger) -> str:
    """Return a warning if command ranges are far smaller than the length of their tendons."""
    for number, (pair, limits) in enumerate(zip(finger.pairs, finger.command_range)):
        if not _by_length(finger):
            break
        length = _length(finger.tendons[pair[0]])
        most = max(map(abs, limits))
        if most < COMMAND.possible[0] * length:
            fits = (
                " are they in m? Then multiply them by 1000"
                if most * 1e3 <= length
                else " check their unit"
            )
            return (
                f"command[{number}].range_mm reaches {most:.3g} mm of a tendon of {length:.0f} "
                f"mm, so that the body hardly moves:{fits}"
            )
    return ""
