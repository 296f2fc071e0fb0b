"""Compile the predictors of a structure: of all points, of linear maps of them, or of contacts.

Contacts are the stations where obstacles stop the body.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.geometry.sections import FeatureMap

if TYPE_CHECKING:
    from softmap_edge.model.structure import Structure

Floats = NDArray[np.float64]
Shape = _core.Shape
Contact = tuple[Shape, dict[str, Shape], _core.Cables | None, _core.Second | None, list[float]]
_OUTSIDE = 0.75  # of a station's vertices, within its radius: a domed tip has many near its axis
_STATION_SHARE = 0.05  # of the length, on each side of a station


def all_points(structure: Structure) -> _core.Predictor:
    """Return the predictor of all points (N, 3) mm."""
    everywhere = np.ones(len(structure.rest), bool)
    return _predictor(
        structure,
        structure.corrected_prior,
        dict(structure.fields),
        everywhere,
        structure.cables,
        structure.second,
    )


def projected(structure: Structure, mapping: FeatureMap) -> _core.Predictor:
    """Return the predictor of the features (V, 3) mm that `mapping` computes from the points."""
    prior, fields, cables, second = _through(structure, mapping)
    return _predictor(structure, prior, fields, mapping.positions, cables, second)


def stations(structure: Structure) -> Contact | None:
    """Return the stations at which an obstacle can stop the body.

    They have centres, the fields that move these, and radii (mm).
    """
    if (
        not {name for name in _core.FIELDS if name.startswith("push")} <= set(structure.fields)
        or structure.markers
    ):
        return None
    share = structure.arc_length / max(float(np.max(structure.arc_length)), 1e-9)
    near = [np.abs(share - station) <= _STATION_SHARE for station in _core.STATIONS[:-1]]
    near.append(share >= 1.0 - 2 * _STATION_SHARE)
    if not all(n.any() for n in near):
        return None
    weights = np.stack([n / n.sum() for n in near])
    aside = structure.rest - (weights @ structure.rest)[:, None]
    reach = [
        float(np.quantile(np.linalg.norm(a[n][:, :2], axis=1), _OUTSIDE))
        for a, n in zip(aside, near)
    ]
    return *_through(
        structure, FeatureMap(weights, np.ones(len(weights), bool), np.arange(len(weights)))
    ), reach


def tip(
    structure: Structure,
    chain: _core.Chain,
    params: Floats,
    gravity: Floats,
    load: float,
    temperature: float,
) -> Shape:
    """Return the tip (3,) mm in the base frame for an effective command and shape effects.

    A network is not tabulated, so its slopes are exact.

    Args:
        structure: the body.
        chain: effects; command effects are ignored, because `acting` already includes them.
        params: of the chain, shape (P,).
        gravity: unit vector (3,), base frame.
        load: g at the tip.
        temperature: °C, NaN if unknown.
    """
    weights = np.zeros((1, len(structure.rest)))
    weights[0, structure.tip_indices] = 1.0 / len(structure.tip_indices)
    mapping = FeatureMap(weights, np.ones(1, bool), np.zeros(1, np.int64))
    prior, fields, cables, second = _through(structure, mapping, tables=False)
    predictor = _predictor(structure, prior, fields, mapping.positions, cables, second)
    return predictor.still(chain, params, gravity, load, temperature)


def _through(
    structure: Structure, mapping: FeatureMap, tables: bool = True
) -> tuple[Shape, dict[str, Shape], _core.Cables | None, _core.Second | None]:
    """Return prior with residual, fields, cables and second order, after a linear map.

    Networks are converted to `tables`.
    """
    matrix, zero = mapping.matrix(), np.zeros(3 * len(mapping.weights))
    seen = [
        shape.project(matrix, zero)
        for shape in (structure.prior, structure.residual)
        if shape is not None
    ]
    prior, *residual = [_seen(structure, shape) for shape in seen] if tables else seen
    if residual:
        prior = _core.Sum(prior, *residual)
    fields = {name: shape.project(matrix, zero) for name, shape in structure.fields.items()}
    cables = None if structure.cables is None else structure.cables.project(matrix, zero)
    return (
        prior,
        fields,
        cables,
        None if structure.second is None else structure.second.project(matrix),
    )


def _seen(structure: Structure, shape: Shape) -> Shape:
    """Return a shape with few outputs in the form for fits: a network as a table."""
    if not isinstance(shape, _core.Network):
        return shape
    from softmap_edge.model.onnx import tabulated

    return tabulated(shape, structure.command_range)


def _predictor(
    structure: Structure,
    prior: Shape,
    fields: dict[str, Shape],
    positions: NDArray[np.bool_],
    cables: _core.Cables | None,
    second: _core.Second | None,
) -> _core.Predictor:
    known = structure.stiffness_known
    return _core.Predictor(
        prior,
        fields,
        positions,
        structure.gravity_reference,
        cables,
        known,
        structure.contact,
        second,
    )
