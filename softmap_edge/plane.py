"""Markers in a plane: the coordinate across it is not measured, so it is neither predicted nor tested.

The run keeps the axis of the base frame that is not measured in its field `plane` ("x", "y" or "z"), and 0 as that
coordinate. A model's prediction for such a run has 0 there as well. So the error and every effect across the plane are
0, and they neither support nor exclude an effect. Pinned by tests/test_plane.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError

if TYPE_CHECKING:
    from softmap_edge.run import Run

Array = NDArray[np.float64]

PLANE = "plane"  # the field of a run with the axis that is not measured
AXES = "xyz"


def unmeasured(run: Run) -> int | None:
    """Return the axis of the base frame (0, 1, 2) that the markers of a run do not measure; None if they measure all.

    Raises:
        RunError: the field `plane` is not x, y or z.
    """
    field = getattr(run, "extra", {}).get(PLANE)
    if field is None or run.markers is None or field.dtype.kind != "U" or field.size != 1:
        return None  # an array of this name is a field of another program
    axis = str(field.reshape(-1)[0])
    if axis not in tuple(AXES):
        raise RunError(f'plane: {str(field)[:40]!r}, expected the axis that is not measured: "x", "y" or "z"')
    return AXES.index(axis)


def flat(points: Array, run: Run) -> Array:
    """Return points (..., 3) mm with 0 as the coordinate that a run does not measure; unchanged if it measures all."""
    axis = unmeasured(run)
    if axis is None:
        return points
    points = np.array(points, float)
    points[..., axis] = 0.0
    return points


def unmeasured_parameters(run: Run) -> tuple[str, ...]:
    """Return the parameters of the base's place that markers in a plane cannot identify."""
    axis = unmeasured(run)
    if axis is None:
        return ()
    return (f"mount.shift_{AXES[axis]}", *(f"mount.turn_{name}" for name in AXES if name != AXES[axis]))
