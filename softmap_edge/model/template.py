"""The template of a bundle, `template.npz`, checked.

It holds points at rest, triangles, tip, model-form error, body and handles. Pinned by
tests/model/test_bundle.py, tests/geometry/test_handles.py and tests/model/test_mutated_files.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import BundleError
from softmap_edge.files.npz import Arrays, array_of
from softmap_edge.geometry.sections import SECTIONS, BodyCoordinates
from softmap_edge.model.model import Model

MOST_POINTS = {"vertices": 50_000, "markers": 1000}  # points; a feature map holds a weight for each


@dataclass(frozen=True, eq=False)
class Template:
    """The rest shape of a body and its features.

    It has points `rest` (N, 3) mm, `triangles` (F, 3), the indices `tip`, and `form_error` mm per
    feature; for a body without a mesh the positions of its points along it; and `handles`, if not
    all vertices are handles.
    """

    rest: NDArray[np.float64]
    triangles: NDArray[np.int32]
    tip: NDArray[np.int64]
    form_error: NDArray[np.float64]
    body: BodyCoordinates | None
    handles: NDArray[np.int64] | None

    @classmethod
    def of(cls, model: Model) -> Template:
        """Return the template of a model."""
        body = model.structure.body
        return cls(
            model.rest, model.triangles, model.tip_indices, model.form_error, body, model.handles
        )

    def to_npz(self) -> Arrays:
        """Return the arrays of `template.npz`."""
        found: Arrays = {
            "rest": self.rest.astype(np.float32),
            "triangles": self.triangles.astype(np.uint16 if len(self.rest) < 65536 else np.uint32),
            "tip": self.tip.astype(np.uint32),
            "form_error_mm": self.form_error.astype(np.float32),
        }
        if self.body is not None:
            found["section"] = self.body.section.astype(np.uint16)
            found["along"] = self.body.along.astype(np.float32)
            if self.body.angle is not None:
                found["angle"] = self.body.angle.astype(np.float32)
        if self.handles is not None:
            found["handles"] = self.handles.astype(np.uint32)
        return found

    @classmethod
    def from_npz(cls, bundle: str, arrays: Arrays) -> Template:
        """Read the arrays of `template.npz`, finite numbers; errors refer to `bundle`.

        Raises:
            SoftmapError: an array is missing, has another shape or type, or points outside the
                vertices.
        """
        rest = np.asarray(array_of(arrays, "rest"), float)
        if rest.ndim != 2 or rest.shape[1] != 3:
            raise BundleError(
                f"{bundle}: template 'rest' of shape {rest.shape}, expected (N, 3); build it again"
            )
        triangles = np.asarray(array_of(arrays, "triangles"), np.int32).reshape(-1, 3)
        body = _body(bundle, arrays, len(rest)) if "section" in arrays else None
        what = "markers" if body is None and not len(triangles) else "vertices"
        if not 1 <= len(rest) <= MOST_POINTS[what]:
            raise BundleError(
                f"{bundle}: template of {len(rest)} {what}, allowed are 1 to {MOST_POINTS[what]}"
            )
        tip = np.asarray(array_of(arrays, "tip"), np.int64)
        for name, index in (("triangles", triangles), ("tip", tip)):
            if index.size and not 0 <= index.min() <= index.max() < len(rest):
                raise BundleError(
                    f"{bundle}: template '{name}' points outside its {len(rest)} vertices"
                )
        form_error = np.asarray(array_of(arrays, "form_error_mm"), float)
        handles = _handles(bundle, arrays["handles"], len(rest)) if "handles" in arrays else None
        return cls(rest, triangles, tip, form_error, body, handles)


def _handles(bundle: str, stored: NDArray[np.generic], points: int) -> NDArray[np.int64]:
    """Read the indices of the handles, each once."""
    handles = np.asarray(stored, np.int64)
    if (
        handles.ndim != 1
        or not len(handles)
        or not np.all(np.diff(handles, prepend=-1, append=points) > 0)
    ):
        raise BundleError(
            f"{bundle}: template 'handles' of shape {handles.shape}, expected 1 to {points} of "
            f"its vertices 0 to {points - 1}, ascending; build it again"
        )
    return handles


def _body(bundle: str, arrays: Arrays, points: int) -> BodyCoordinates:
    """Read the points' positions along a body, with as many sections as features require."""
    for name in ("section", "along", "angle"):
        if name in arrays and arrays[name].shape != (points,):
            raise BundleError(
                f"{bundle}: template '{name}' of shape {arrays[name].shape}, expected "
                f"({points},); build it again"
            )
    section = np.asarray(arrays["section"], np.int64)
    if (
        arrays["section"].dtype.kind not in "iu"
        or not 0 <= section.min() <= section.max() < SECTIONS
    ):
        raise BundleError(
            f"{bundle}: template 'section' holds other than whole numbers below {SECTIONS}"
        )
    angle = np.asarray(arrays["angle"], float) if "angle" in arrays else None
    return BodyCoordinates(section, np.asarray(arrays["along"], float), angle)
