"""How a run's points are seen by a model: as its features, or as markers attached to its template.

A run of vertices or of the model's own markers gives the model's features; markers on a template
are features of their own. Vertices laid onto clouds (`run register`) have `roll_seen = false`: what
a round finger does about its own axis is not in them, so of its features the places of sections
count and the directions do not. Units: mm. Pinned by tests/geometry/test_markers.py and
tests/diagnosis/test_clouds_diagnosis.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import RunError
from softmap_edge.geometry.sections import (
    FeatureMap,
    attach,
    marker_features,
    other_unit,
    seen_residual,
)
from softmap_edge.model.predictors import projected
from softmap_edge.run.run import ROLL_SEEN, Run

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class View:
    """What stands between a model and the features of a run.

    `carry` (M, N) carries markers on the template, None where points are the model's own; `mapping`
    makes features of the run's points; `rows` are those among the model's own features; `predictor`
    gives the features.
    """

    carry: Floats | None
    mapping: FeatureMap
    rows: NDArray[np.intp]
    predictor: _core.Predictor


def key_of(model: Model, run: Run) -> tuple[bytes, bool]:
    """Return a key that distinguishes the views of a model on different runs.

    Raises:
        RunError: the run does not give the places of its markers on the template.
    """
    if model.markers or run.markers is None:
        return b"", roll_seen(model, run)
    if run.marker_rest is None:
        raise RunError(
            f"the run has {run.markers.shape[1]} markers but no `marker_rest` (M, 3) mm, so it is "
            f"not known which place on the model of '{model.robot}' each one is; give "
            "marker_rest_mm in the mapping, or with --bundle a model learnt from such markers"
        )
    return run.marker_rest.tobytes(), True


def view_of(model: Model, run: Run) -> View:
    """Return how a model sees a run; made once for each `key_of`."""
    if not model.markers and run.markers is not None:
        carry = attach(np.asarray(run.marker_rest, float), model.rest, run.marker_names)
        all_rows = FeatureMap(carry, np.ones(len(carry), bool), np.arange(len(carry)))
        return View(
            carry,
            marker_features(len(carry)),
            np.zeros(0, np.intp),
            projected(model.structure, all_rows),
        )
    own, rows = model.structure.feature_map, np.arange(len(model.structure.positions))
    if not roll_seen(model, run):
        rows = np.flatnonzero(own.positions)
        own = FeatureMap(own.weights[rows], own.positions[rows], own.section[rows])
    return View(None, own, rows, model.points if model.markers else projected(model.structure, own))


def laid(run: Run) -> bool:
    """Return whether a run's vertices were fitted to clouds.

    Those do not show the roll of a round finger.
    """
    return run.vertices is not None and not bool(np.all(run.extra.get(ROLL_SEEN, True)))


def roll_seen(model: Model, run: Run) -> bool:
    """Return whether a run shows the roll of the body about its own axis.

    True also if the model has no features of roll.
    """
    return not laid(run) or bool(model.structure.positions.all())


def seen_features(model: Model, run: Run) -> Floats:
    """Return the measured features (K, V, 3) mm; NaN where too little was seen."""
    seen, visible, view = points_in_mm(model, run), run.visible, model.view(run)
    if visible is None or bool(np.all(visible)):
        return view.mapping(seen)
    if view.carry is not None or model.markers:
        return np.where(visible[..., None], seen, np.nan)
    missed = seen_residual(seen - model.predict(run), model.structure.body_coordinates, visible)
    return model.features(run) + missed[:, view.rows]


def seen_points(model: Model, run: Run) -> Floats:
    """Return a run's points (K, N, 3) mm after checking that they are points of this robot."""
    seen, carry = run.seen_points, model.view(run).carry
    count = len(model.rest) if carry is None else seen.shape[1]
    if seen.shape[1] != count:
        raise RunError(
            f"the run has {seen.shape[1]} points a frame, this model of '{model.robot}' has "
            f"{count}; it is a run of another robot or template"
        )
    return in_scale_of(model, run, np.asarray(seen, float))


def in_scale_of(model: Model, run: Run, seen: Floats) -> Floats:
    """Return the markers of a run of outputs in the scale of the model's own; places are unchanged.

    Raises:
        RunError: one of the two is of outputs and the other is not, or they are of other outputs.
    """
    ours, theirs = model.output, run.output
    if ours is None and theirs is None:
        return seen
    if ours is None or theirs is None or ours.unit != theirs.unit:
        of = [
            "places" if o is None else f"{', '.join(o.names)} in {o.unit}" for o in (theirs, ours)
        ]
        raise RunError(
            f"the run is of {of[0]}, this model of '{model.robot}' of {of[1]}; take the model of "
            "this run"
        )
    return seen if ours.mm_per_unit == theirs.mm_per_unit else theirs.rescaled(seen, ours)


def points_in_mm(model: Model, run: Run) -> Floats:
    """Return the same after checking that the points are as large as the robot.

    Otherwise an effect would stand for a wrong unit.
    """
    seen = seen_points(model, run)
    rest = model.rest if model.view(run).carry is None else np.asarray(run.marker_rest, float)
    shown = seen if run.visible is None else np.where(run.visible[..., None], seen, np.nan)
    if (found := other_unit(shown, rest)) is not None:
        raise RunError(
            f"wrong units: the run's points spread {found[0]:.3g} times as far as those of "
            f"'{model.robot}', which looks like {found[1]}; give the points in mm (`unit` of the "
            "mapping)"
        )
    return seen


def form_error(model: Model, run: Run) -> Floats:
    """Return the model error, held out, (V, 3) mm for a run's features in its orientations."""
    view = model.view(run)
    error = model.form_error[view.rows]
    if view.carry is not None:
        error = np.full((len(view.carry), 3), model.vertex_error_mm / np.sqrt(3.0))
    return np.asarray(error * np.sqrt(np.mean(np.sum(leaning(model, run) ** 2, axis=1))))


def leaning(model: Model, run: Run) -> Floats:
    """Return (K, 4) of each seen frame: 1, and the error for leaning along x, y, z.

    The latter are relative to the error in the reference orientation.

    What a model errs for a lean is another number in another orientation, though the command be the
    same.
    """
    rows = np.zeros((len(run.t_seen), 4))
    rows[:, 0] = 1.0
    if run.gravity is not None and model.error_per_g_mm:
        away = np.broadcast_to(run.gravity, (len(run.t), 3)) - model.gravity_reference
        near = np.clip(np.searchsorted(run.t, run.t_seen), 0, len(run.t) - 1)
        rows[:, 1:] = model.error_per_g_mm / max(model.vertex_error_mm, 1e-9) * away[near]
    return rows


def members(section: NDArray[np.int64]) -> Floats:
    """Return which points lie in which section, (N, S) of ones and zeros."""
    return np.asarray((section[:, None] == np.unique(section)).astype(float))


def without_roll(member: Floats, moved: Floats, points: Floats, weight: Floats) -> Floats:
    """Return displacements without the best-fitting turn of each section about the body's axis.

    Args:
        member: (N, S) of `members`, two sections or more.
        moved: (K, N, 3, m) mm, m displacements of each point.
        points: (K, N, 3) mm, where they are. weight: (K, N) of each in the least squares.
    """
    centre = np.einsum("ns,knx->ksx", member / member.sum(axis=0), points)
    along = np.gradient(centre, axis=1)
    turn = np.cross(member @ along, points - member @ centre)  # (K, N, 3)
    size = np.einsum("ns,kn,knx,knx->ks", member, weight, turn, turn, optimize=True)
    angle = np.einsum("ns,kn,knx,knxm->ksm", member, weight, turn, moved, optimize=True)
    angle /= np.maximum(size, 1e-12)[..., None]
    return np.asarray(moved - turn[..., None] * (member @ angle)[:, :, None])
