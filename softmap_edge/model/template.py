"""The template of a bundle, `template.npz`, checked.

It holds points at rest, triangles, tip, form error, body and handles.

Pinned by tests/model/test_bundle.py, tests/geometry/test_handles.py and
tests/model/test_mutated_files.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import BundleError
from softmap_edge.geometry.sections import SECTIONS, BodyCoordinates
from softmap_edge.model.model import Arrays, Model

MOST_POINTS = {"vertices": 50_000, "markers": 1000}  # a feature map holds a weight for each of them


@dataclass(frozen=True, eq=False)
class Template:
    """The rest shape of a body and its features.

    It has points `rest` (N, 3) mm, `triangles` (F, 3), the indices `tip` and `form_error` mm of
    each feature; for a body without a mesh the places of its points along it; and `handles` where
    not all vertices are handles.
    """

    rest: NDArray[np.float64]
    triangles: NDArray[np.int32]
    tip: NDArray[np.int64]
    form_error: NDArray[np.float64]
    body: BodyCoordinates | None
    handles: NDArray[np.int64] | None


def template_arrays(model: Model) -> dict[str, NDArray[np.generic]]:
    """Return the arrays that keep a model's template."""
    found: dict[str, NDArray[np.generic]] = {
        "rest": model.rest.astype(np.float32),
        "triangles": model.triangles.astype(np.uint16 if len(model.rest) < 65536 else np.uint32),
        "tip": model.tip_indices.astype(np.uint32),
        "form_error_mm": model.form_error.astype(np.float32),
    }
    body = model.structure.body
    if body is not None:
        found |= {"section": body.section.astype(np.uint16), "along": body.along.astype(np.float32)}
        if body.angle is not None:
            found["angle"] = body.angle.astype(np.float32)
    if model.handles is not None:
        found["handles"] = model.handles.astype(np.uint32)
    return found


def template_from(bundle: str, arrays: Arrays) -> Template:
    """Return the template that arrays of finite numbers keep; `bundle` is named in errors.

    Raises:
        BundleError: an array has another shape or type, or points outside the vertices.
    """
    rest = np.asarray(arrays["rest"], float)
    if rest.ndim != 2 or rest.shape[1] != 3:
        raise BundleError(
            f"{bundle}: template 'rest' of shape {rest.shape}, expected (N, 3); build it again"
        )
    triangles = np.asarray(arrays["triangles"], np.int32).reshape(-1, 3)
    body = _body(bundle, arrays, len(rest)) if "section" in arrays else None
    what = "markers" if body is None and not len(triangles) else "vertices"
    if not 1 <= len(rest) <= MOST_POINTS[what]:
        raise BundleError(
            f"{bundle}: template of {len(rest)} {what}, allowed are 1 to {MOST_POINTS[what]}"
        )
    tip = np.asarray(arrays["tip"], np.int64)
    for name, index in (("triangles", triangles), ("tip", tip)):
        if index.size and not 0 <= index.min() <= index.max() < len(rest):
            raise BundleError(
                f"{bundle}: template '{name}' points outside its {len(rest)} vertices"
            )
    handles = _handles(bundle, arrays["handles"], len(rest)) if "handles" in arrays else None
    return Template(rest, triangles, tip, np.asarray(arrays["form_error_mm"], float), body, handles)


def _handles(bundle: str, stored: NDArray[np.generic], points: int) -> NDArray[np.int64]:
    """Read which vertices are handles; each one once."""
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
    """Read how the points lie along a body; as many sections as features are made of."""
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
