"""Find the pose of the base in the frame of clouds: one rigid pose shared by all frames.

    min Σ_k Σ_i ρ(|q_i − S_k|),  q = R p + t    p: points of cloud k near the base,
                                                S_k: the surface at u_k + Δu

Only the body near the clamp is used. There a finger hardly bends, whatever the model error, and a
displaced base moves all of it alike. A constant error of a command also bends it there, so it is
fitted with the pose. Roll and height are not changed, because a round body shows neither. Groups of
frames give the uncertainty of the other numbers. Units: mm, rad; degrees in reports. Limit: model
error within ZONE of the clamp is attributed to the frame. Pinned by tests/alignment/test_align.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.alignment.checks import student
from softmap_edge.alignment.clouds import clouds_of
from softmap_edge.alignment.result import Alignment
from softmap_edge.errors import AlignError
from softmap_edge.geometry.rigid import RigidPose, jacobian, rotation, rotation_vector
from softmap_edge.model.orientation import priors_by_orientation

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]

RIM, ZONE = 0.03, 0.25  # of the template's height: bounds of the part that shows the base
WIDER = 1.3  # times ZONE: extent of the surface that its points are compared with
GATE = 8.0  # mm from the surface: points farther away belong to something else
FRAMES, POINTS = 96, 400  # frames, and points of each, that are used at most
LEAST = 200  # points near the base, in all frames
GROUPS = 8
ROUNDS, SETTLED = 30, 1e-5
TUKEY, TO_SIGMA = 4.685, 1.4826
IDENTIFIED = [0, 1, 3, 4]  # of turns and shifts: roll and height hardly show
# standard deviations, and mm at the tip, from which a base counts as displaced
CLEAR, LEAST_OFF = 4.0, 0.2


def align_clouds(run: Run, model: Model) -> Alignment:
    """Find the pose of the base in a run of clouds.

    Args:
        run: with `points` that are already near the base frame, and commands (or ticks, if the
            model is calibrated).
        model: of this robot, with a surface.

    Raises:
        AlignError: no surface, or too few points near the base.
    """
    if not len(model.triangles):
        raise AlignError(
            f"the model of '{model.robot}' has no surface; give the bundle of a finger with one"
        )
    some = np.unique(np.linspace(0, run.frames - 1, min(run.frames, FRAMES)).astype(int))
    few = run.at(some)
    shapes = np.asarray(model.with_residual(None).predict(few))
    low, height = float(model.rest[:, 2].min()), float(np.ptp(model.rest[:, 2]))
    near = model.rest[:, 2] <= low + WIDER * ZONE * height
    numbers = np.cumsum(near) - 1
    triangles = numbers[model.triangles[near[model.triangles].all(axis=1)]].tolist()
    slopes = _slopes(model, few)[:, near]
    surfaces = [_core.Surface(np.ascontiguousarray(shape[near]), triangles) for shape in shapes]
    zone = low + RIM * height, low + ZONE * height
    within = model.rest[(model.rest[:, 2] >= zone[0]) & (model.rest[:, 2] <= zone[1])]
    centre = within.mean(axis=0)
    reach = float(np.linalg.norm(within - centre, axis=1).max())
    clouds = [
        _near(cloud, surface, centre, reach, zone)
        for cloud, surface in zip(clouds_of(few), surfaces)
    ]
    count = sum(map(len, clouds))
    if count < LEAST:
        raise AlignError(
            f"{count} points within {GATE:g} mm of the lowest {ZONE * height:.0f} mm of the body, "
            f"{LEAST} or more show where the base stands; show the base to the cameras"
        )
    pose, step = RigidPose(np.eye(3), np.zeros(3)), np.zeros(6)
    for _ in range(ROUNDS):
        each = zip(clouds, surfaces, shapes[:, near], slopes)
        rows = [
            _row(pose(cloud), surface, shape, by, centre, reach)
            for cloud, surface, shape, by in each
        ]
        found = _Normal.of(rows)
        step = found.step()
        more = rotation(step[:3] / reach)
        pose = RigidPose(more, centre - more @ centre + step[3:]).after(pose)
        if np.abs(step).max() < SETTLED:
            break
    # of (turn · reach, shift at the centre) to the report
    lever = np.eye(6) / np.r_[np.full(3, reach), np.ones(3)]
    lever[3:, :3] = jacobian(-centre[None])[0][:, :3] / reach
    sigma = (
        np.sqrt(np.diag(lever @ found.covariance() @ lever.T))
        * np.r_[np.full(3, np.degrees(1.0)), np.ones(3)]
    )
    notes = ["roll and height hardly show in clouds of a finger's lower part, and stay as they are"]
    return Alignment(
        pose,
        sigma,
        "clouds near the base",
        len(found.pulls),
        len(some),
        count,
        [],
        found.left,
        found.scatter,
        1.0,
        None,
        notes,
    )


def in_base(run: Run, model: Model) -> tuple[Run, Alignment | None]:
    """Return a run of clouds in the base frame, and the pose if its base was clearly displaced.

    The base is displaced if a rotation or shift exceeds CLEAR standard deviations and moves the tip
    by more than LEAST_OFF mm. Other runs are returned unchanged, and so are clouds that show too
    little of the base.
    """
    if run.points is None:
        return run, None
    try:
        found = align_clouds(run, model)
    except AlignError:
        return run, None
    turn, shift = np.abs(rotation_vector(found.pose.rotation)), np.abs(found.pose.shift)
    size = np.r_[np.degrees(turn), shift]
    moved = np.r_[turn * float(np.ptp(model.rest[:, 2])), shift]
    clear = np.any((size > CLEAR * found.sigma)[IDENTIFIED] & (moved > LEAST_OFF)[IDENTIFIED])
    return (found.apply(run), found) if clear else (run, None)


def base_stood_off(pose: RigidPose) -> str:
    """Report that clouds were moved into the frame of their base, and how to treat other runs."""
    turn, shift = np.degrees(rotation_vector(pose.rotation)), pose.shift
    turned, shifted = (", ".join(f"{v + 0.0:.2f}" for v in numbers) for numbers in (turn, shift))
    return (
        f"the base is not at the origin of the clouds: these were turned by ({turned}) deg and "
        f"shifted by ({shifted}) mm first; do so with every run: softmap run align RUN --base "
        "clamped --bundle CALIBRATED --out RUN2"
    )


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations of G groups of frames for 6 + C numbers.

    The numbers are rotations and shifts, in mm at the rim, and then commands.

    Attributes:
        bends: matrices, (G, 6 + C, 6 + C).
        pulls: right-hand sides, (G, 6 + C).
        scatter: robust standard deviation of the distances, mm.
        left: RMS distance of the points that count, mm.
    """

    bends: Floats
    pulls: Floats
    scatter: float
    left: float

    @classmethod
    def of(cls, rows: list[tuple[Floats, Floats]]) -> _Normal:
        distance = np.concatenate([d for d, _ in rows])
        scatter = max(TO_SIGMA * float(np.median(distance)), 1e-9)
        groups = np.array_split(np.arange(len(rows)), min(GROUPS, len(rows)))
        size = rows[0][1].shape[1]
        bends, pulls = np.zeros((len(groups), size, size)), np.zeros((len(groups), size))
        for g, group in enumerate(groups):
            d, j = (np.concatenate([rows[k][i] for k in group]) for i in (0, 1))
            weight = (1.0 - np.minimum(d / (TUKEY * scatter), 1.0) ** 2) ** 2
            bends[g], pulls[g] = (j * weight[:, None]).T @ j, -(j * weight[:, None]).T @ d
        used = distance[distance < TUKEY * scatter]
        return cls(bends, pulls, scatter, float(np.sqrt(np.mean(used**2))))

    @property
    def inverse(self) -> Floats:
        """Inverse of the full matrix in the identified directions and the commands."""
        inverse = np.zeros(self.bends.shape[1:])
        identified = np.ix_(*[[*IDENTIFIED, *range(6, len(inverse))]] * 2)
        inverse[identified] = np.linalg.pinv(self.bends.sum(axis=0)[identified], hermitian=True)
        return inverse

    def step(self) -> Floats:
        """Return the Gauss-Newton step (6,)."""
        return np.asarray(self.inverse @ self.pulls.sum(axis=0), np.float64)[:6]

    def covariance(self) -> Floats:
        """Return the covariance (6, 6) by the noise and by the differences between groups."""
        count = len(self.pulls)
        apart = self.pulls - self.pulls.mean(axis=0)
        wander = self.inverse @ (apart.T @ apart) @ self.inverse * count / max(count - 1, 1)
        covariance = self.scatter**2 * self.inverse + student(max(count - 1, 1)) ** 2 * wander
        return np.asarray(covariance[:6, :6], np.float64)


def _near(
    cloud: Floats, surface: _core.Surface, centre: Floats, reach: float, zone: tuple[float, float]
) -> Floats:
    """Return at most POINTS points (m, 3) of a cloud near a surface, between two heights in mm."""
    some = np.asarray(cloud[np.linalg.norm(cloud - centre, axis=1) < reach + GATE], np.float64)
    if not len(some):
        return some
    places, distance = surface.nearest(np.ascontiguousarray(some))
    # beyond, the surface is cut
    some = some[(distance < GATE) & (places[:, 2] > zone[0]) & (places[:, 2] < zone[1])]
    return np.ascontiguousarray(some[:: max(1, len(some) // POINTS)])


def _slopes(model: Model, run: Run) -> Floats:
    """Return the derivative of the vertices by the commands in each frame, (K, N, 3, C)."""
    u = model.effective_commands(run)
    slopes = np.empty((len(u), *model.rest.shape, model.channels))
    for rows, family in priors_by_orientation(model, run):
        slopes[rows] = np.asarray(family.jacobian(np.ascontiguousarray(u[rows]))).reshape(
            -1, *slopes.shape[1:]
        )
    return slopes


def _row(
    points: Floats,
    surface: _core.Surface,
    vertices: Floats,
    slopes: Floats,
    centre: Floats,
    reach: float,
) -> tuple[Floats, Floats]:
    """Return the distances (m,) mm of points from a surface, and their slopes (m, 6 + C).

    The slopes are by rotation, shift and commands.

    Args:
        points: (m, 3) mm.
        surface: at the commands of the frame.
        vertices: of the surface, (N, 3) mm.
        slopes: derivative of the vertices by the commands, (N, 3, C).
        centre: centre of rotation, (3,) mm.
        reach: length in mm that scales rotations.
    """
    if not len(points):
        return np.zeros(0), np.zeros((0, 6 + slopes.shape[2]))
    places, distance = surface.nearest(np.ascontiguousarray(points))
    away = (points - places) / np.maximum(distance, 1e-12)[:, None]
    arm = points - centre
    nearest = np.argmin(np.linalg.norm(places[:, None] - vertices, axis=2), axis=1)
    by_command = -np.einsum("mx,mxc->mc", away, slopes[nearest])
    return distance, np.concatenate([np.cross(arm, away) / reach, away, by_command], axis=1)
