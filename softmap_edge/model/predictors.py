"""Compiles the predictors of a model: of all its points, of a linear map of them, of where obstacles stop the body."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.geometry.sections import FeatureMap
from softmap_edge.model.onnx import tabulated

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

Floats = NDArray[np.float64]
Shape = Any  # a compiled shape: _core.Table, _core.Rod, _core.RodField
Contact = tuple[Shape, dict[str, Shape], _core.Cables | None, _core.Second | None, list[float]]
_OUTSIDE = 0.75  # of a station's vertices lie within its radius: a domed tip has many near its axis
_STATION_SHARE = 0.05  # of the length to each side of a station


def whole(model: Model) -> _core.Predictor:
    """Return the predictor of all points (N, 3) mm."""
    everywhere = np.ones(len(model.rest), bool)
    prior = model.prior if model.residual is None else _core.Sum(model.prior, model.residual)
    return _predictor(model, prior, dict(model.fields), everywhere, model.cables, model.second)


def projected(model: Model, mapping: FeatureMap) -> _core.Predictor:
    """Return the predictor of the features (V, 3) mm that `mapping` makes of the points."""
    prior, fields, cables, second = _through(model, mapping)
    return _predictor(model, prior, fields, mapping.positions, cables, second)


def stations(model: Model) -> Contact | None:
    """Return where an obstacle can stop the body: middles of its stations, how fields move them, and their radii mm."""
    if not {name for name in _core.FIELDS if name.startswith("push")} <= set(model.fields) or model.markers:
        return None
    share = model.along / max(float(np.max(model.along)), 1e-9)
    near = [np.abs(share - station) <= _STATION_SHARE for station in _core.STATIONS[:-1]]
    near.append(share >= 1.0 - 2 * _STATION_SHARE)
    if not all(n.any() for n in near):
        return None
    weights = np.stack([n / n.sum() for n in near])
    aside = model.rest - (weights @ model.rest)[:, None]
    reach = [float(np.quantile(np.linalg.norm(a[n][:, :2], axis=1), _OUTSIDE)) for a, n in zip(aside, near)]
    return *_through(model, FeatureMap(weights, np.ones(len(weights), bool), np.arange(len(weights)))), reach


def tip(model: Model, gravity: Floats, load: float, temperature: float) -> Shape:
    """Return the tip (3,) mm as a shape of what acts, in the base frame, under the model's own shape effects.

    A network stays one: its slopes are exact.

    Args:
        gravity: (3,) unit vector, base frame. load: g at the tip. temperature: °C, NaN where it is not known.
    """
    weights = np.zeros((1, len(model.rest)))
    weights[0, model.tip_indices] = 1.0 / len(model.tip_indices)
    mapping = FeatureMap(weights, np.ones(1, bool), np.zeros(1, np.int64))
    prior, fields, cables, second = _through(model, mapping, tables=False)
    predictor = _predictor(model, prior, fields, mapping.positions, cables, second)
    return predictor.still(model.chain, model.chain_params, gravity, load, temperature)


def _through(
    model: Model, mapping: FeatureMap, tables: bool = True
) -> tuple[Shape, dict[str, Shape], _core.Cables | None, _core.Second | None]:
    """Return prior with residual, fields, cables and second order as seen through a linear map; networks as
    `tables`."""
    matrix, zero = mapping.matrix(), np.zeros(3 * len(mapping.weights))
    seen = [shape.project(matrix, zero) for shape in (model.prior, model.residual) if shape is not None]
    prior, *residual = [_seen(model, shape) for shape in seen] if tables else seen
    if residual:
        prior = _core.Sum(prior, *residual)
    fields = {name: shape.project(matrix, zero) for name, shape in model.fields.items()}
    cables = None if model.cables is None else model.cables.project(matrix, zero)
    return prior, fields, cables, None if model.second is None else model.second.project(matrix)


def _seen(model: Model, shape: Shape) -> Shape:
    """Return a shape of few outputs as fits want it: a network as a table."""
    return tabulated(shape, model.command_range) if isinstance(shape, _core.Network) else shape


def _predictor(
    model: Model,
    prior: Shape,
    fields: dict[str, Shape],
    positions: NDArray[np.bool_],
    cables: _core.Cables | None,
    second: _core.Second | None,
) -> _core.Predictor:
    known = model.stiffness_known
    return _core.Predictor(prior, fields, positions, model.gravity_reference, cables, known, model.contact, second)
