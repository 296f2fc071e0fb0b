"""The body of a model: prior, fields, the points they move, and their positions along the body.

    effective command ─prior f(u_eff) + Σ cₖ·Sₖ(u_eff)─> points

Effects, calibration and limits are not part of it (`model.py`). Pinned by
tests/model/test_predictor.py and tests/geometry/test_markers.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.geometry.sections import (
    BodyCoordinates,
    FeatureMap,
    marker_features,
    section_features,
    upright,
)
from softmap_edge.model.predictors import Contact, Shape, stations

Floats = NDArray[np.float64]
NEWTON_PER_GRAM = 9.80665e-3  # standard gravity, exact by convention


class StructureFields(TypedDict, total=False):
    """Fields of a `Structure` by name."""

    prior: Shape
    fields: Mapping[str, Shape]
    rest: Floats
    triangles: NDArray[np.int32]
    tip_indices: NDArray[np.int64]
    gravity_reference: Floats
    command_range: Floats
    cables: _core.Cables | None
    second: _core.Second | None
    body: BodyCoordinates | None
    stiffness_known: bool
    residual: Shape | None


@dataclass(frozen=True, eq=False)
class Structure:
    """The body and its response to commands and loads.

    `prior` maps commands (n, C) to flattened points (n, 3N) mm; `fields` are displacements per 1 g
    or per 1 N; `rest` (N, 3) mm are the template's vertices or the markers at rest. `body` gives
    the points' positions along a body that is not along z or has no mesh. Without `stiffness_known`
    the fields have a nominal scale: loads declared by a run are not applied, and no fitted load is
        a
    weight in grams. `residual` is a learned correction of the prior, with the same commands and
    points.
    """

    prior: Shape
    fields: Mapping[str, Shape]
    rest: Floats
    triangles: NDArray[np.int32]
    tip_indices: NDArray[np.int64]
    gravity_reference: Floats  # (3,), base frame
    command_range: Floats  # (C, 2), in the model's command unit
    cables: _core.Cables | None = None  # response of tendons to loads; a rod has none
    second: _core.Second | None = None  # second order of loads
    body: BodyCoordinates | None = None
    stiffness_known: bool = True
    residual: Shape | None = None

    @property
    def channels(self) -> int:
        """Number of commands C."""
        return int(self.prior.channels)

    @property
    def markers(self) -> bool:
        """Whether the points are markers rather than vertices of a template."""
        return len(self.triangles) == 0 and self.body is None

    @cached_property
    def body_coordinates(self) -> BodyCoordinates:
        """The positions of the points along the body."""
        return upright(self.rest) if self.body is None else self.body

    @property
    def sections(self) -> NDArray[np.int64]:
        """Section (N,) of each point: slices along the body, or the marker's own number."""
        return np.arange(len(self.rest)) if self.markers else self.body_coordinates.section

    @property
    def arc_length(self) -> Floats:
        """Position (N,) mm of each point along the body."""
        return self.body_coordinates.along

    @cached_property
    def feature_map(self) -> FeatureMap:
        """The linear map from points to features."""
        return (
            marker_features(len(self.rest))
            if self.markers
            else section_features(self.body_coordinates)
        )

    @property
    def positions(self) -> NDArray[np.bool_]:
        """Which features (V,) are positions; the others are directions."""
        return self.feature_map.positions

    @cached_property
    def corrected_prior(self) -> Shape:
        """The prior with its residual: effective commands (n, C) to flattened points (n, 3N) mm."""
        return self.prior if self.residual is None else _core.Sum(self.prior, self.residual)

    @cached_property
    def contact(self) -> Contact | None:
        """The stations where an obstacle can stop the body; None for markers or no push fields."""
        return stations(self)

    @cached_property
    def weight_per_length(self) -> float:
        """The tip weight (g) that would move the tip sideways by the body's length, if linear.

        0 without fields. With unknown stiffness it is in the model's own scale of loads.
        """
        sideways = [
            self.fields[name] for name in ("tip_force_x", "tip_force_y") if name in self.fields
        ]
        home = np.zeros((1, self.channels))
        # mm/N
        moved = [
            field.evaluate(home).reshape(-1, 3)[self.tip_indices].mean(axis=0) for field in sideways
        ]
        most = max((float(np.linalg.norm(one)) for one in moved), default=0.0)
        return float(np.ptp(self.arc_length)) / most / NEWTON_PER_GRAM if most > 0 else 0.0
