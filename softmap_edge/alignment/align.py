"""Align: the rigid transform from the camera's or mocap's frame to the robot's base, and how well it is known.

Two ways to find it. From **home frames**: what is seen each time the robot rests at home, against the model's shape
there. From **base points**: markers fixed to the base at known places, or the clamped vertices of the template.

    groups of frames (visits of home; stretches of time) → a robust pose each → one pose of all
    Σ = T² · max(scatter of the groups' poses, sensor noise)/groups + shape     six numbers: turns, then shifts
    T  widens for few groups: Student's 97.5 % over 1.96, so that ± 2 σ holds 95 %
    shape: model and robot differ at home; the model's own error, as large as what is left there, correlated along it;
           of base points, what is left over the coordinates that the pose did not take (3 N − 6), each point for itself

Turns and shifts are small, about the axes and the origin of the base frame, as those of the effect `mount`.
Units: mm; degrees in what is told. Limits: what is rigid in the robot's own rest shape (a twist, half of a pre-curve)
is taken for the frame where only home frames are given. Pinned by tests/test_align.py over many seeds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.alignment.checks import (
    check_mirror,
    check_places,
    check_scale,
    check_turns,
    check_whole,
    student,
)
from softmap_edge.alignment.groups import (
    GROUP_FRAMES,
    Groups,
    Moved,
    base_motion,
    find_motion,
    follow,
    group,
    small_pose,
)
from softmap_edge.alignment.rigid import Pose, gain, kabsch, refined, robust, rotation_vector
from softmap_edge.diagnosis.conditions import conditions
from softmap_edge.diagnosis.noise import form_covariance
from softmap_edge.errors import AlignError
from softmap_edge.run import BASE_MARKERS, Run, known

if TYPE_CHECKING:
    from softmap_edge.model import Model

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SCHEMA = "softmap.align/1"
HOME = "home frames"
AT_HOME = 0.03  # of the largest |command|: closer to zero than this is at home (an encoder's offset included)
SETTLED = 1.0  # s after the last motion from which the robot rests
VISITS = 2  # least visits of home
STRETCHES = 12  # groups of time at most where the base is always seen
CLAMPED = 1e-6  # mm above the base: a vertex of a template that is clamped


@dataclass(frozen=True, eq=False)
class Alignment:
    """A transform found, p_base = rotation · p_seen + shift; prints itself, and `to_dict()` is softmap.align/1.

    `sigma` (6,): standard deviations of turns about x, y, z of the base frame (deg), then of shifts (mm).
    `moved`: how the base or home moved within the run, None where it did not. `frames`: a pose for each frame of the
    run, where it was asked for.
    """

    pose: Pose
    sigma: Floats
    method: str
    groups: int
    used_frames: int
    points: int
    wrong_points: list[int]
    residual_mm: float
    noise_mm: float
    scale: float
    moved: Moved | None
    notes: list[str] = field(default_factory=list)
    frames: Pose | None = None

    def apply(self, run: Run) -> Run:
        """Return the run in the base frame, with the transform and its sigma as `frame` and `frame_sigma`."""
        return in_frame(run, self.pose, self.sigma, self.frames)

    def to_dict(self) -> dict[str, Any]:
        """Return the document softmap.align/1."""
        turn = np.degrees(rotation_vector(self.pose.rotation))
        return {
            "schema": SCHEMA,
            "method": self.method,
            "groups": self.groups,
            "frames": self.used_frames,
            "points": self.points,
            "wrong_points": self.wrong_points,
            "transform": {
                "rotation": self.pose.rotation.tolist(),
                "turn_deg": turn.tolist(),
                "shift_mm": self.pose.shift.tolist(),
            },
            "sigma": {"turn_deg": self.sigma[:3].tolist(), "shift_mm": self.sigma[3:].tolist()},
            "residual_mm": self.residual_mm,
            "noise_mm": self.noise_mm,
            "scale": self.scale,
            "moved": None if self.moved is None else self.moved.to_dict(),
            "removed_by_frame": self.frames is not None,
            "notes": self.notes,
        }

    def __str__(self) -> str:
        turn, s = np.degrees(rotation_vector(self.pose.rotation)), self.sigma
        wrong = f"; left aside as wrong: {len(self.wrong_points)}" if self.wrong_points else ""
        lines = [
            f"Aligned by {self.method}: {self.used_frames} frames in {self.groups} groups, {self.points} points{wrong}",
            f"  {'':<8}{'x':>18}{'y':>18}{'z':>18}",
            "  turned  " + "".join(f"{a:10.3f} ± {b:<5.2g}" for a, b in zip(turn, s[:3])) + " deg, rotation vector",
            "  shifted " + "".join(f"{a:10.3f} ± {b:<5.2g}" for a, b in zip(self.pose.shift, s[3:])) + " mm",
            f"  left between points and places {self.residual_mm:.3f} mm RMS; noise of a frame {self.noise_mm:.3f} mm",
        ]
        if self.moved is not None:
            lines.append(f"  {self.moved}")
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])


def in_frame(run: Run, pose: Pose, sigma: Floats, frames: Pose | None = None) -> Run:
    """Return the run with all that was seen, and what stood on the base, taken by a pose; `frame` says so.

    Args:
        sigma: (6,) of the pose, deg and mm. frames: a pose for each frame, which takes what is seen in it instead.
    """
    change: dict[str, Any] = {}
    for name in ("vertices", "markers", "points"):
        seen = getattr(run, name)
        if seen is not None:
            change[name] = (frames or pose)(seen) if seen.ndim == 3 else pose(seen)
    base = base_markers(run)
    if base.shape[1]:
        change["extra"] = run.extra | {BASE_MARKERS: (frames or pose)(base)}
    if run.cameras is not None:  # they look from where they stood, at points that have other numbers now
        looking = Pose(run.cameras[:, :, :3], run.cameras[:, :, 3]).after(pose.inverse())
        change["cameras"] = np.concatenate([looking.rotation, looking.shift[:, :, None]], axis=2)
    before = Pose(np.eye(3), np.zeros(3)) if run.frame is None else Pose(run.frame[:, :3], run.frame[:, 3])
    whole = pose.after(before)
    change |= {"frame": np.column_stack([whole.rotation, whole.shift]), "frame_sigma": sigma}
    return dataclasses.replace(run, **change)


def align_home(run: Run, model: Model) -> Alignment:
    """Find the frame from what is seen at home, command at rest.

    Args:
        run: seen in any frame, with at least two visits of home. model: of this robot.

    Raises:
        AlignError: home is not visited, the points do not tell every turn, are mirrored, of other units or of another
            robot; the message says which.
    """
    seen, visible = _seen(run, model.seen_points(run))
    visits = home_visits(run, model)
    inside = np.concatenate(visits)
    predicted = np.asarray(model.predict(run.at(inside)), float)
    check_whole(predicted, seen.shape)
    target = np.zeros_like(seen)
    target[inside] = predicted
    groups = group(run, seen, visible, target, visits)
    form, section = _form(model, run)
    motion = None
    if not model.markers and run.vertices is not None:  # the clamped ring says whether it is the base that moved
        ring = sorted(clamped_places(run, model))

        def motion(pose: Pose) -> Moved | None:
            return base_motion(run, seen[:, ring], visible[:, ring], model.rest[ring], model.rest, pose)

    found = _solve(groups, form, section, HOME, f"the model of '{model.robot}'", motion)
    if run.robot and run.robot != model.robot:
        found.notes.append(f"the run is of '{run.robot}', the model of '{model.robot}'; sure that it is one robot?")
    return found


def align_base(run: Run, places: dict[int, Floats], held: bool = False) -> Alignment:
    """Find the frame from points that are fixed to the base.

    Args:
        run: with markers or vertices. places: base-frame position (3,) mm of each named point of the run; those of its
            `base_markers` are counted on behind the others.
        held: also find a pose for every frame, so that a base that moves is held still.

    Raises:
        AlignError: fewer than three places, places on a line, mirrored or in other units.
    """
    seen, visible = _seen(run, run.seen_points)
    base = base_markers(run)
    whole = np.all(np.isfinite(base), axis=2)
    seen = np.concatenate([seen, np.where(whole[..., None], base, 0.0)], axis=1)
    visible = np.concatenate([visible, whole], axis=1)
    names = sorted(places)
    outside = [n for n in names if not 0 <= n < seen.shape[1]]
    if outside:
        raise AlignError(f"base point {outside[0]}: the run has points 0 to {seen.shape[1] - 1}; name one of them")
    target = np.array([places[n] for n in names])
    check_places(target)
    return _from_base(run, seen, visible, names, target, held)


def base_markers(run: Run) -> Floats:
    """Return the markers on the base (K, B, 3) mm that an import keeps beside those of the robot; B = 0 without any.

    Raises:
        AlignError: the field has another shape.
    """
    base = run.extra.get(BASE_MARKERS)
    if base is None:
        return np.zeros((run.frames, 0, 3))
    if base.ndim != 3 or base.shape[0] != run.frames or base.shape[2] != 3 or base.dtype.kind != "f":
        raise AlignError(f"{BASE_MARKERS}: {base.dtype} of shape {base.shape}, expected ({run.frames}, B, 3) mm")
    return np.asarray(base, float)


def clamped_places(run: Run, model: Model) -> dict[int, Floats]:
    """Return the clamped vertices of a model's template as base points.

    Raises:
        AlignError: the model or the run has markers, not vertices.
    """
    if model.markers or run.vertices is None:
        raise AlignError("--base clamped needs a run and a model with vertices; name the base markers by their numbers")
    model.seen_points(run)  # its own message for a run of another template
    low = float(model.rest[:, 2].min())
    return {int(n): model.rest[n] for n in np.flatnonzero(model.rest[:, 2] < low + CLAMPED)}


def home_visits(run: Run, model: Model) -> list[NDArray[np.int64]]:
    """Return the frames of each visit of home at rest; a run that is never commanded rests always.

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
            f"too few home frames: {len(visits)} visits of home at rest ({held}), {VISITS} are needed, each of "
            f"{GROUP_FRAMES} frames at least {SETTLED:g} s after the last motion and with every command within "
            f"{AT_HOME * top:.3g} {model.command_unit} of zero; record home for 5 s at the start, at the end and in "
            "between, or name base markers (--base)"
        )
    return visits


# --- from points to a pose ----------------------------------------------------------------------


def _seen(run: Run, points: Floats) -> tuple[Floats, Mask]:
    visible = known(run, points)
    if not visible.any():
        raise AlignError("no point is visible in any frame of the run; check its field `visible`")
    return np.where(visible[..., None], points, 0.0), visible


def _stretches(frames: int) -> int:
    return max(1, min(STRETCHES, frames // GROUP_FRAMES))


def _form(model: Model, run: Run) -> tuple[Floats, NDArray[np.int64]]:
    """Return the model's own error (S, 3) mm at the places along its body, and the place (N,) of each point."""
    mapping, error = model.run_feature_map(run), model.run_form_error(run)
    count = int(mapping.positions.sum())
    section = model.sections if run.vertices is not None and not model.markers else np.arange(count)
    return error[mapping.positions], section


def _solve(
    groups: Groups,
    form: Floats,
    section: NDArray[np.int64],
    method: str,
    what: str,
    motion: Callable[[Pose], Moved | None] | None = None,
    measured: bool = False,
) -> Alignment:
    """Fit one pose to all groups and one to each; weigh what they tell.

    `motion` says whether the base moved; `measured`: the target points were measured one by one, as with a ruler.
    """
    # A median of frames is 1.25 times as uncertain as their mean.
    sensor = 1.2533 * groups.noise / np.sqrt(np.maximum(groups.count, 1))
    own = np.sqrt((form**2).mean(axis=1))[section]  # (N,) mm a coordinate
    seen = groups.count > 0
    if seen.any(axis=0).sum() < 3:
        raise AlignError("fewer than three points are seen; three that are not on one line give a frame")
    check_scale(groups.source, groups.target, seen, what)
    flat = groups.source.reshape(-1, 3), groups.target.reshape(-1, 3)
    sigma = np.sqrt(sensor**2 + own**2)
    pose, _ = robust(*flat, sigma.ravel(), seen.ravel())
    check_mirror(*flat, sigma.ravel(), seen.ravel(), pose, what)
    tukey = refined(groups.source, groups.target, sigma, seen, pose)[1]
    # What wanders between visits, as the tip of a robot with play does, says little of the base; and points of one
    # place along the body are off together, so that many of them say no more than one.
    wander = _wander(groups, tukey > 0, pose)
    tukey = refined(groups.source, groups.target, np.sqrt(sigma**2 + wander**2), seen, pose)[1]
    together = np.bincount(section, seen.any(axis=0))[section]
    inlier, weight = tukey > 0, tukey / (sensor**2 + together * (own**2 + wander**2))
    pose = kabsch(*flat, weight.ravel())
    residual = np.where(inlier[..., None], pose(groups.source) - groups.target, 0.0)
    left = float(np.sqrt((residual**2).sum() / max(1, inlier.sum())))
    scale = check_scale(groups.source, groups.target, inlier, what, left)
    poses = np.stack([small_pose(groups, g, weight[g], pose) for g in range(len(weight))])
    place = (groups.target * seen[..., None]).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)[:, None]
    answer = gain(place, weight.mean(axis=0))  # (6, N, 3)
    noise = np.einsum("inc,n,jnc->ij", answer, (sensor**2).mean(axis=0), answer)  # of one group
    number = int(np.isfinite(poses).all(axis=1).sum())
    scatter = np.cov(poses[np.isfinite(poses).all(axis=1)].T) if number > 1 else np.zeros((6, 6))
    spread = np.maximum(np.diag(scatter), np.diag(noise))
    shape = (_ruler_covariance(answer, residual, inlier) if measured
             else _shape_covariance(answer, form, section, residual, inlier))  # fmt: skip
    variance = student(number - 1) ** 2 * spread / max(1, number) + np.diag(shape)
    check_turns(place[seen.any(axis=0)], np.sqrt(variance[:3]), answer)
    moved = find_motion(poses, noise, groups.t, place, "home")
    notes: list[str] = []
    if motion is not None:
        home, moved = moved, motion(pose)
        if moved is None and home is not None:
            notes.append(
                f"home wanders by {home.farthest_mm:.2f} mm at the far end, the base does not: creep or play; "
                "--base clamped takes the frame from the base alone"
            )
    if moved is not None:
        variance = variance + spread  # which of its places is meant is not known better than they scatter
    units = np.r_[np.full(3, np.degrees(1.0)), np.ones(3)]
    wrong = [int(n) for n in np.flatnonzero(seen.any(axis=0) & (inlier.sum(axis=0) < 0.5 * seen.sum(axis=0)))]
    return Alignment(
        pose, np.sqrt(variance) * units, method, number, int(groups.count.max(axis=1).sum()),
        int(seen.any(axis=0).sum()), wrong, left, float(groups.noise * np.sqrt(3.0)), scale, moved, notes,
    )  # fmt: skip


def _wander(groups: Groups, inlier: Mask, pose: Pose) -> Floats:
    """Return how far each point (N,) is scattered between the groups, mm a coordinate, beside the rigid pose."""
    count = inlier.sum(axis=0)
    left = np.where(inlier[..., None], pose(groups.source) - groups.target, 0.0)
    mean = left.sum(axis=0) / np.maximum(count, 1)[:, None]
    square = np.where(inlier[..., None], (left - mean) ** 2, 0.0).sum(axis=(0, 2)) / 3.0
    return np.asarray(np.sqrt(square / np.maximum(count - 1, 1)))


def _shape_covariance(
    answer: Floats, form: Floats, section: NDArray[np.int64], residual: Floats, inlier: Mask
) -> Floats:
    """Return the covariance (6, 6) from model and robot differing in shape, scaled to what is left after the pose."""
    left = residual.sum(axis=0) / np.maximum(inlier.sum(axis=0), 1)[:, None]  # (N, 3) mean over the groups
    places = form_covariance(form, np.ones(len(form), bool), np.arange(len(form)))
    onto = np.zeros((len(form), 3, 6))
    np.add.at(onto, section, np.moveaxis(answer, 0, -1))
    expected = float((form[section] ** 2).sum(axis=1)[inlier.any(axis=0)].mean())
    found = float((left**2).sum(axis=1)[inlier.any(axis=0)].mean())
    flat = onto.reshape(-1, 6)
    return np.asarray(found / max(expected, 1e-12) * flat.T @ places @ flat)


def _ruler_covariance(answer: Floats, residual: Floats, inlier: Mask) -> Floats:
    """Return the covariance (6, 6) from places that were measured one by one, as wrong as what is left shows.

    The pose takes six of the 3 N coordinates, so that of three or four places most of their error is not left.
    """
    known = inlier.any(axis=0)
    left = residual.sum(axis=0) / np.maximum(inlier.sum(axis=0), 1)[:, None]  # (N, 3) mean over the groups
    freedom = max(1, 3 * int(known.sum()) - 6)
    square = student(freedom) ** 2 * float((left[known] ** 2).sum()) / freedom
    return np.asarray(square * np.einsum("inc,jnc->ij", answer[:, known], answer[:, known]))


# --- points of the base -------------------------------------------------------------------------


def _from_base(run: Run, seen: Floats, visible: Mask, names: Sequence[int], target: Floats, held: bool) -> Alignment:
    points, shown = seen[:, names], visible[:, names]
    usable = np.flatnonzero(shown.sum(axis=1) >= 3)
    if len(usable) < GROUP_FRAMES:
        raise AlignError(
            f"{len(usable)} frames show three of the {len(names)} base points, {GROUP_FRAMES} are needed; name markers "
            "that the cameras see"
        )
    parts = np.array_split(usable, _stretches(len(usable)))
    groups = group(run, points, shown, np.broadcast_to(target, points.shape), parts)
    form = np.full((len(names), 3), groups.noise)

    def motion(pose: Pose) -> Moved | None:
        some = np.where(visible[usable[::10], :, None], pose(seen[usable[::10]]), np.nan).reshape(-1, 3)
        far = some[np.isfinite(some).all(axis=1)]
        return base_motion(run, points, shown, target, far[np.argsort(-np.linalg.norm(far, axis=1))[:1]], pose)

    what = "the places of the base points"
    found = _solve(groups, form, np.arange(len(names)), "base points", what, motion, measured=True)
    named = [names[i] for i in found.wrong_points]
    found = dataclasses.replace(found, wrong_points=named, used_frames=len(usable))
    if not held:
        return found
    frames, note = follow(points, shown, target, found.noise_mm, found.pose)
    return dataclasses.replace(found, frames=frames, notes=[*found.notes, note])
