"""Find the rigid transform from the camera or mocap frame to the base frame, and its sigma.

There are two ways. **Home frames**: the points at each rest at home are compared with the shape of
the model there. **Base points**: markers fixed to the base at known positions, or the clamped
vertices of the template.

    groups of frames (visits of home, or stretches of time) → a robust pose of each
    → one pose of all (`solve.py`)

Units: mm; degrees in reports. Limit: home frames alone attribute the rigid part of a wrong rest
shape (a twist, half of a pre-curve) to the frame. Pinned by tests/alignment/test_align.py over many
seeds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.checks import check_places, check_points_match
from softmap_edge.alignment.groups import GROUP_FRAMES, Moved, base_motion, follow, group
from softmap_edge.alignment.result import Alignment, base_markers
from softmap_edge.alignment.solve import solve
from softmap_edge.errors import AlignError
from softmap_edge.geometry.rigid import RigidPose
from softmap_edge.run.conditions import conditions
from softmap_edge.run.plane import unmeasured
from softmap_edge.run.run import Run, known

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

HOME = "home frames"
# of the largest |command|: closer to zero than this is at home (an encoder's offset included)
AT_HOME = 0.03
SETTLED = 1.0  # s after the last motion from which the robot rests
VISITS = 2  # least visits of home
STRETCHES = 12  # groups of time at most where the base is always seen
CLAMPED = 1e-6  # mm above the base: a vertex of a template that is clamped


def align_home(run: Run, model: Model) -> Alignment:
    """Find the frame from the points at home, while the robot rests.

    Args:
        run: seen in any frame, with at least two visits of home.
        model: of this robot.

    Raises:
        AlignError: home is not visited, the points do not determine all rotations, or they are
            mirrored, in another unit or of another robot; the message names the fault.
    """
    seen, visible = _seen(run, model.seen_points(run))
    visits = home_visits(run, model)
    inside = np.concatenate(visits)
    predicted = np.asarray(model.predict(run.at(inside)), float)
    check_points_match(predicted, seen.shape)
    target = np.zeros_like(seen)
    target[inside] = predicted
    groups = group(run, seen, visible, target, visits)
    form, section = _form(model, run)
    motion = None
    # the clamped ring shows whether the base moved
    if not model.markers and run.vertices is not None:
        ring = sorted(clamped_places(run, model))

        def motion(pose: RigidPose) -> Moved | None:
            return base_motion(
                run, seen[:, ring], visible[:, ring], model.rest[ring], model.rest, pose
            )

    found = solve(groups, form, section, HOME, f"the model of '{model.robot}'", motion)
    if run.robot and run.robot != model.robot:
        found.notes.append(
            f"the run is of '{run.robot}', the model of '{model.robot}'; sure that it is one robot?"
        )
    return found


def align_base(run: Run, places: dict[int, Floats], held: bool = False) -> Alignment:
    """Find the frame from points that are fixed to the base.

    Args:
        run: with markers or vertices.
        places: position of each base point in the base frame, (3,) mm, by the number of the point
            in the run. The numbers of `base_markers` follow those of the other points.
        held: also find a pose for every frame, to remove the motion of a base that moves.

    Raises:
        AlignError: fewer than three places, places on a line, or points that are mirrored or in
            another unit.
    """
    seen, visible = _seen(run, run.seen_points)
    base = base_markers(run)
    complete = np.all(np.isfinite(base), axis=2)
    seen = np.concatenate([seen, np.where(complete[..., None], base, 0.0)], axis=1)
    visible = np.concatenate([visible, complete], axis=1)
    names = sorted(places)
    outside = [n for n in names if not 0 <= n < seen.shape[1]]
    if outside:
        raise AlignError(
            f"base point {outside[0]}: the run has points 0 to {seen.shape[1] - 1}; name one of "
            "them"
        )
    target = np.array([places[n] for n in names])
    check_places(target)
    return _from_base(run, seen, visible, names, target, held)


def clamped_places(run: Run, model: Model) -> dict[int, Floats]:
    """Return the clamped vertices of a model's template as base points.

    Returns:
        dict[int, Floats]: places (3,) mm in the base frame, by vertex.

    Raises:
        AlignError: the model or the run has markers instead of vertices.
    """
    if model.markers or run.vertices is None:
        raise AlignError(
            "--base clamped needs a run and a model with vertices; name the base markers by their "
            "numbers"
        )
    model.seen_points(run)  # its own message for a run of another template
    low = float(model.rest[:, 2].min())
    return {int(n): model.rest[n] for n in np.flatnonzero(model.rest[:, 2] < low + CLAMPED)}


def home_visits(run: Run, model: Model) -> list[NDArray[np.int64]]:
    """Return the frames of each visit of home at rest.

    A run without motion commands is at rest throughout; it is divided into stretches of time.

    Raises:
        AlignError: fewer than two visits.
    """
    u = model.commands(run)
    state = conditions(run, u)
    top = float(np.abs(u).max(initial=0.0))
    if top == 0.0:  # never commanded: at rest always, and stretches of time stand for visits
        visits = np.array_split(np.arange(run.frames), _stretches(run.frames))
    else:
        home = np.abs(state.command).max(axis=1, initial=0.0) <= AT_HOME * top
        rest = home & ~state.moving & (state.dwell >= SETTLED)
        visits = [np.flatnonzero(rest & (state.visit == v)) for v in np.unique(state.visit[rest])]
    visits = [frames for frames in visits if len(frames) >= GROUP_FRAMES]
    if len(visits) < VISITS:
        held = "; ".join(f"{len(frames)} frames" for frames in visits) or "none"
        raise AlignError(
            f"too few home frames: {len(visits)} visits of home at rest ({held}), {VISITS} are "
            f"needed, each of {GROUP_FRAMES} frames at least {SETTLED:g} s after the last motion "
            f"and with every command within {AT_HOME * top:.3g} {model.command_unit} of zero; "
            "record home for 5 s at the start, at the end and in between, or name base markers "
            "(--base)"
        )
    return visits


# --- from points to a pose ----------------------------------------------------------------------


def _seen(run: Run, points: Floats) -> tuple[Floats, Mask]:
    if unmeasured(run) is not None:
        raise AlignError(
            "the markers of the run lie in a plane, and what is across it is not measured, so no "
            "frame follows from them; give the clamp and the axes in the mapping ([frame] "
            "origin_mm and axes), and import again"
        )
    visible = known(run, points)
    if not visible.any():
        raise AlignError("no point is visible in any frame of the run; check its field `visible`")
    return np.where(visible[..., None], points, 0.0), visible


def _stretches(frames: int) -> int:
    return max(1, min(STRETCHES, frames // GROUP_FRAMES))


def _form(model: Model, run: Run) -> tuple[Floats, NDArray[np.int64]]:
    """Return the model error (S, 3) mm at places along the body, and each point's place (N,)."""
    mapping, error = model.run_feature_map(run), model.run_form_error(run)
    count = int(mapping.positions.sum())
    section = model.sections if run.vertices is not None and not model.markers else np.arange(count)
    return error[mapping.positions], section


# --- points of the base -------------------------------------------------------------------------


def _from_base(
    run: Run, seen: Floats, visible: Mask, names: Sequence[int], target: Floats, held: bool
) -> Alignment:
    points, shown = seen[:, names], visible[:, names]
    usable = np.flatnonzero(shown.sum(axis=1) >= 3)
    if len(usable) < GROUP_FRAMES:
        raise AlignError(
            f"{len(usable)} frames show three of the {len(names)} base points, {GROUP_FRAMES} are "
            "needed; name markers that the cameras see"
        )
    parts = np.array_split(usable, _stretches(len(usable)))
    groups = group(run, points, shown, np.broadcast_to(target, points.shape), parts)
    form = np.full((len(names), 3), groups.noise)

    def motion(pose: RigidPose) -> Moved | None:
        some = np.where(visible[usable[::10], :, None], pose(seen[usable[::10]]), np.nan).reshape(
            -1, 3
        )
        far = some[np.isfinite(some).all(axis=1)]
        return base_motion(
            run, points, shown, target, far[np.argsort(-np.linalg.norm(far, axis=1))[:1]], pose
        )

    what = "the places of the base points"
    found = solve(groups, form, np.arange(len(names)), "base points", what, motion, measured=True)
    named = [names[i] for i in found.wrong_points]
    found = dataclasses.replace(found, wrong_points=named, used_frames=len(usable))
    if not held:
        return found
    frames, note = follow(points, shown, target, found.noise_mm, found.pose)
    return dataclasses.replace(found, frames=frames, notes=[*found.notes, note])
