"""A model's view of a run's points: as its features, or as markers attached to its template.

A run of vertices or of the model's own markers gives the model's features; markers on a template
are features of their own. Vertices fitted to clouds (`run register`) have `roll_seen = false`: they
do not show rotation of a round finger about its own axis. So only the positions of sections count,
not the directions. Units: mm. Pinned by tests/geometry/test_markers.py and
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
    """The maps between a model and the features of a run.

    `carry` (M, N) gives markers on the template, None if points are the model's own. `mapping`
    gives features of the run's points, `rows` their indices among the model's features. `predictor`
    gives the features.
    """

    carry: Floats | None
    mapping: FeatureMap
    rows: NDArray[np.intp]
    predictor: _core.Predictor


def key_of(model: Model, run: Run) -> tuple[bytes, bool]:
    """Return a key that distinguishes a model's views of different runs.

    Raises:
        RunError: the run does not give its markers' positions on the template.
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
    """Return a model's view of a run, made once for each `key_of`."""
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
    """Return whether a run's vertices were fitted to clouds, which do not show roll."""
    return run.vertices is not None and not bool(np.all(run.extra.get(ROLL_SEEN, True)))


def roll_seen(model: Model, run: Run) -> bool:
    """Return whether a run shows the body's roll about its own axis, or the model has no roll."""
    return not laid(run) or bool(model.structure.positions.all())


def seen_features(model: Model, run: Run) -> Floats:
    """Return the measured features (K, V, 3) mm; NaN where too few points were seen."""
    seen, visible, view = points_in_mm(model, run), run.visible, model.view(run)
    if visible is None or bool(np.all(visible)):
        return view.mapping(seen)
    if view.carry is not None or model.markers:
        return np.where(visible[..., None], seen, np.nan)
    missed = seen_residual(seen - model.predict(run), model.structure.body_coordinates, visible)
    return model.features(run) + missed[:, view.rows]


def seen_points(model: Model, run: Run) -> Floats:
    """Return a run's points (K, N, 3) mm after checking that they belong to this robot."""
    seen, carry = run.seen_points, model.view(run).carry
    count = len(model.rest) if carry is None else seen.shape[1]
    if seen.shape[1] != count:
        raise RunError(
            f"the run has {seen.shape[1]} points a frame, this model of '{model.robot}' has "
            f"{count}; it is a run of another robot or template"
        )
    return in_scale_of(model, run, np.asarray(seen, float))


def in_scale_of(model: Model, run: Run, seen: Floats) -> Floats:
    """Return markers (K, N, 3) of outputs in the model's own scale; positions are unchanged.

    Raises:
        RunError: only one of the two has outputs, or their outputs differ.
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
    """Return the run's points (K, N, 3) mm after checking that their size fits the robot.

    A wrong unit would otherwise be explained by an effect.
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
    """Return the held-out model error (V, 3) mm of a run's features in its orientations."""
    view = model.view(run)
    error = model.form_error[view.rows]
    if view.carry is not None:
        error = np.full((len(view.carry), 3), model.vertex_error_mm / np.sqrt(3.0))
    return np.asarray(error * np.sqrt(np.mean(np.sum(leaning(model, run) ** 2, axis=1))))


def leaning(model: Model, run: Run) -> Floats:
    """Return (K, 4) for each seen frame: 1, and the relative error for a lean along x, y, z.

    The latter are relative to the error in the reference orientation. The error of a lean differs
    between orientations, even for the same command.
    """
    rows = np.zeros((len(run.t_seen), 4))
    rows[:, 0] = 1.0
    if run.gravity is not None and model.error_per_g_mm:
        away = np.broadcast_to(run.gravity, (len(run.t), 3)) - model.gravity_reference
        near = np.clip(np.searchsorted(run.t, run.t_seen), 0, len(run.t) - 1)
        rows[:, 1:] = model.error_per_g_mm / max(model.vertex_error_mm, 1e-9) * away[near]
    return rows


def members(section: NDArray[np.int64]) -> Floats:
    """Return the membership of points in sections, (N, S) of ones and zeros."""
    return np.asarray((section[:, None] == np.unique(section)).astype(float))


def without_roll(member: Floats, moved: Floats, points: Floats, weight: Floats) -> Floats:
    """Return displacements without each section's best-fitting rotation about the body's axis.

    Args:
        member: (N, S) of `members`, two sections or more.
        moved: (K, N, 3, m) mm, m displacements of each point.
        points: positions (K, N, 3) mm.
        weight: least-squares weight of each, (K, N).
    """
    centre = np.einsum("ns,knx->ksx", member / member.sum(axis=0), points)
    along = np.gradient(centre, axis=1)
    turn = np.cross(member @ along, points - member @ centre)  # (K, N, 3)
    size = np.einsum("ns,kn,knx,knx->ks", member, weight, turn, turn, optimize=True)
    angle = np.einsum("ns,kn,knx,knxm->ksm", member, weight, turn, moved, optimize=True)
    angle /= np.maximum(size, 1e-12)[..., None]
    return np.asarray(moved - turn[..., None] * (member @ angle)[:, :, None])
