"""Match the named cell groups of a mesh file with regions of another modulus.

The regions are those of a finger.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from softmap_edge.errors import FingerError
from softmap_edge.fem.bodies import Meshed
from softmap_edge.fem.finger import Finger
from softmap_edge.files.printable import listed
from softmap_edge.files.toml import quoted

_SHOWN = 6  # most groups listed in a message


def named_cells(finger: Finger) -> list[list[bool] | None]:
    """Return a mask of cells for each region; None for a region without a name.

    Raises:
        FingerError: the mesh file has no such group.
    """
    if not isinstance(finger.solid, Meshed) or all(
        region.name is None for region in finger.regions
    ):
        return [None] * len(finger.regions)
    groups = finger.solid.groups()
    for number, region in enumerate(finger.regions):
        if region.name is not None and region.name not in groups:
            there = (
                f"it names {', '.join(list(groups)[:_SHOWN])}"
                if groups
                else "all its cells are alike"
            )
            raise FingerError(
                f"region[{number}].name: {Path(finger.solid.file).name} has no group "
                f"'{region.name[:40]}'; {there}"
            )
    return [
        None if region.name is None else groups[region.name].tolist() for region in finger.regions
    ]


def groups_without_region(finger: Finger) -> str:
    """Return a sentence if groups of the mesh share one modulus without a region; else ""."""
    if not isinstance(finger.solid, Meshed):
        return ""
    groups = finger.solid.groups()
    named = {region.name for region in finger.regions}
    left = [name for name in groups if name not in named]
    if not left or (named & set(groups) and len(left) < 2):
        return ""
    share = 8**finger.solid.refine
    sizes = listed(
        (f"{name} ({np.count_nonzero(groups[name]) // share} cells)" for name in left), _SHOWN
    )
    return (
        f"{Path(finger.solid.file).name} names {len(groups)} group{'s' * (len(groups) > 1)} of "
        f"cells; {sizes} get young_mpa = {finger.young_mpa:g}. Give one a modulus of its own: "
        f"[[region]] with name = {quoted(left[-1])} and young_mpa"
    )
