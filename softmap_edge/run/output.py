"""Outputs of any kind: a force, an angle or a level in place of the positions of a body.

A run of outputs has no geometry. Each output is stored as one marker on a straight line of
markers, `mm_per_unit` mm along x per unit of the output, so every function for markers applies.
Reports convert the figures back (`Output.value`). Pinned by tests/run/test_output.py.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.atomic import Document

Floats = NDArray[np.float64]

# length of the line of markers: five times its motion, so a chord's angle is linear in the output
LENGTH_MM = 500.0
RANGE_MM = 100.0  # internal range of the outputs, in any unit: the motion of a usual finger
FARTHEST = 3.0  # ranges from zero: beyond, a chord's angle hardly depends on the output
DIGITS = 2  # digits of mm_per_unit, so that similar runs of one machine get the same scale
MOST = 64  # outputs of a run at most
_SCALES = (1e-12, 1e12)  # mm per unit: from pascals to gigapascals


@dataclass(frozen=True)
class Output:
    """The meaning of the markers in a run of outputs.

    Attributes:
        names: of the outputs, in the order of the markers.
        unit: of all outputs, as reports print it (N, deg, V).
        mm_per_unit: mm along x per unit.

    Raises:
        RunError: a name, the unit or the scale is invalid.
    """

    names: tuple[str, ...]
    unit: str
    mm_per_unit: float

    def __post_init__(self) -> None:
        named = [*self.names, self.unit]
        if not 1 <= len(self.names) <= MOST or len(set(self.names)) < len(self.names):
            raise RunError(f"output: {len(self.names)} names, expected 1 to {MOST} that differ")
        if not all(
            isinstance(text, str) and 1 <= len(text) <= 40 and text.isprintable() for text in named
        ):
            raise RunError("output: names and unit are texts of 1 to 40 printable characters")
        if not _SCALES[0] <= self.mm_per_unit <= _SCALES[1]:
            raise RunError(
                f"output: {self.mm_per_unit:g} mm stand for 1 {self.unit}; give a positive finite "
                "number"
            )

    def markers(self, values: ArrayLike) -> Floats:
        """Return outputs (K, Q) in `unit` as markers (K, Q, 3) mm."""
        rows = np.asarray(values, float)
        if rows.ndim != 2 or rows.shape[1] != len(self.names):
            raise RunError(
                f"output: shape {rows.shape}, expected (K, {len(self.names)}) for "
                f"{', '.join(self.names)}"
            )
        points = np.zeros((*rows.shape, 3))
        points[..., 0] = self.mm_per_unit * rows
        points[..., 2] = LENGTH_MM * np.arange(1, rows.shape[1] + 1) / rows.shape[1]
        return points

    def values(self, markers: Floats) -> Floats:
        """Return markers (…, 3) mm as outputs (…) in `unit`."""
        return np.asarray(markers[..., 0] / self.mm_per_unit)

    def value(self, mm: float) -> float:
        """Return an error or a displacement in mm, converted to `unit`."""
        return mm / self.mm_per_unit

    def rescaled(self, markers: Floats, other: Output) -> Floats:
        """Return markers (K, Q, 3) mm of this output in the scale of `other`."""
        points = np.array(markers, float)
        points[..., 0] *= other.mm_per_unit / self.mm_per_unit
        return points

    def to_dict(self) -> Document:
        """Return the record as stored in documents and manifests."""
        return asdict(self) | {"names": list(self.names)}

    @classmethod
    def from_dict(cls, document: Document) -> Output:
        """Read the result of `to_dict`.

        Raises:
            RunError: an entry is missing or of the wrong kind.
        """
        try:
            return cls(tuple(document["names"]), document["unit"], float(document["mm_per_unit"]))
        except (KeyError, TypeError, ValueError) as cause:
            raise RunError(
                f"output: damaged ({type(cause).__name__}: {cause}); import the run again"
            ) from None


def output_of(values: ArrayLike, unit: str, names: tuple[str, ...] = ()) -> Output:
    """Return the scale for outputs (K, Q) in `unit`: the largest range becomes `RANGE_MM`.

    Raises:
        RunError: no output moves, or a value is not finite.
    """
    rows = np.asarray(values, float)
    if rows.ndim != 2 or not rows.size or np.isinf(rows).any():
        raise RunError(
            f"output: shape {rows.shape}, expected (K, Q) finite numbers, one column an output"
        )
    some = rows[:, np.isfinite(rows).any(axis=0)]
    spread = float(np.max(np.nanmax(some, axis=0) - np.nanmin(some, axis=0), initial=0.0))
    if not spread > 0:
        raise RunError("output: no column moves; name the columns of what was measured")
    if (far := float(np.nanmax(np.abs(rows)))) > FARTHEST * spread:
        raise RunError(
            f"output: up to {far:.4g} {unit}, moving by {spread:.3g} {unit} only; subtract its "
            "mean (`offset` in a mapping)"
        )
    scale = float(f"{RANGE_MM / spread:.{DIGITS}g}")
    return Output(names or tuple(f"output {q + 1}" for q in range(rows.shape[1])), unit, scale)
