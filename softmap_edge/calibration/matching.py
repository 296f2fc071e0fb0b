"""Find the model's command for each measured shape: the nearest of a grid, then the best between.

    j*(k) = argmin_j MAE(Y_k, f(u_j))  over the seen vertices
        nearest shape of the grid (SoftMap, Data Alignment)
    u*(k) = argmin_u Σ w (Y_k − f(u))²,  l ≤ u ≤ h
        Levenberg-Marquardt from there, w = 1 / sigma²

The paper stops at j*. Its error is up to half a step of the grid, and more between similar shapes.
f is the prior of the model, with its residual if any, in the orientation of the run, without loads.
A cloud does not show the roll of a round finger (`roll_seen` is false). The rotation of each
section about the body is then removed from residuals and slopes. Units: mm, and those of the
commands. Pinned by tests/calibration/test_calibration.py.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.geometry.rigid import rotation
from softmap_edge.model.orientation import priors_by_orientation
from softmap_edge.model.views import members, roll_seen, without_roll
from softmap_edge.run.run import known

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.model.predictors import Shape
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

# of the grid in each channel, and shapes at most; 41 is the grid of our own sweeps
STEPS, MOST_SHAPES = 41, 1700
FEW = 150  # points used for the nearest shape if it is refined afterwards
ROUNDS = 25  # of Levenberg-Marquardt
SETTLED = 1e-5  # of the range of a command: smaller steps end the iteration
EDGE = 1e-3  # of the range: closer to its end, a command counts as cut off
# of its range: a command that moves the shape over so much by less than MOVES of what is usual, on
# one
STEP = 0.025
MOVES = 0.2  # side or the other, is slack there: shapes do not determine it
USUAL = 200  # commands that say what is usual
CHUNK = 4_000_000  # numbers of one difference: 32 MB
LEAST_SEEN = 0.1  # share of the points that a matched frame must show


@dataclass(frozen=True, eq=False)
class Matches:
    """The commands whose shapes are nearest to those of K frames.

    Attributes:
        command: (K, C); NaN if a frame shows too few points.
        covariance: of each command, (K, C, C), from the noise and from the misfit of each section.
        mae_mm: mean absolute error after the fit, over the coordinates of the seen points, (K,) mm.
        edge: commands at the end of the model's range, (K,); the true command may lie beyond it.
        observed: commands that move the shape there, (K, C). If both tendons of a pair are slack,
            their command is a guess with the variance of the full range.
    """

    command: Floats
    covariance: Floats
    mae_mm: Floats
    edge: Mask
    observed: Mask


def match(model: Model, run: Run, refine: bool = True) -> Matches:
    """Find the command of a model behind each frame of a run.

    Args:
        model: its prior and residual are matched, its effects are not.
        run: with the model's own vertices or markers in the base frame, or with markers carried on
            its template.
        refine: continue between the shapes of the grid; without it, the result is that of the
            paper.

    Returns:
        Matches: one command for each frame.

    Raises:
        RunError: points of another robot or unit.
    """
    seen, weight = weighted(model, run)
    visible = weight > 0
    families = priors_by_orientation(model, run)
    if len(families) > 1:
        return _joined([(rows, match(model, run.at(rows), refine)) for rows, _ in families])
    shapes = Shapes(model, run, families[0][1])
    low, high = model.command_range.T
    grid = _grid(low, high)
    every = slice(None, None, max(1, seen.shape[1] // FEW) if refine else 1)
    u = grid[_nearest(shapes(grid)[:, every], seen[:, every], visible[:, every])]
    covariance = np.zeros((len(u), model.channels, model.channels))
    each = max(1, CHUNK // (3 * seen.shape[1] * (model.channels + 1)))
    for k in range(0, len(u), each):
        part = slice(k, k + each)
        if refine:
            u[part] = _refined(shapes, seen[part], weight[part], u[part], low, high)
        there, left, _ = _left(shapes, seen[part], weight[part], u[part])
        slopes = shapes.without_roll(shapes.slopes(u[part]), there, weight[part])
        covariance[part] = _covariance(
            shapes.member, slopes, left, weight[part], run.sigma is not None
        )
    observed = _observed(shapes, grid, u, low, high)
    covariance += _slack(observed, low, high)
    off = np.abs(shapes(u) - seen).sum(axis=2)
    count = visible.sum(axis=1)
    mae = np.where(visible, off, 0.0).sum(axis=1) / np.maximum(3 * count, 1)
    lost = count < max(3.0, LEAST_SEEN * visible.shape[1])
    u[lost], covariance[lost], mae[lost] = np.nan, np.nan, np.nan
    reach = EDGE * (high - low)
    # a slack command may have any value
    edge = (observed & ((u <= low + reach) | (u >= high - reach))).any(axis=1)
    return Matches(u, covariance, mae, np.asarray(edge, np.bool_), observed)


def linearised(
    model: Model, run: Run, matches: Matches, frames: Index, commands: Floats, turn: float
) -> Matches:
    """Return the matches, with some frames updated by one Gauss-Newton step.

    Commands that are slack in the map stay there, so model errors do not make them jump over the
    slack.

    Args:
        model: as for `match`.
        run: as for `match`.
        matches: of all frames of the run.
        frames: numbers of the frames to update, (F,).
        commands: commands of these frames by the map, (F, C); the step starts there.
        turn: rotation of all shapes about the axis of the base, rad.
    """
    command, covariance, observed = (
        matches.command.copy(),
        matches.covariance.copy(),
        matches.observed.copy(),
    )
    low, high = model.command_range.T
    some = run.at(frames)
    for rows, family in priors_by_orientation(model, some):
        shapes = Shapes(model, some, family).turned(turn)
        each = max(1, CHUNK // (3 * shapes.count * (model.channels + 1)))
        for part in np.array_split(rows, -(-len(rows) // each)):
            seen, weight = weighted(model, some.at(part))
            u, at = commands[part], frames[part]
            there, left, _ = _left(shapes, seen, weight, u)
            slopes = shapes.without_roll(shapes.slopes(u), there, weight)
            pull = np.einsum("kn,knxc,knx->kc", weight, slopes, left, optimize=True)
            step = np.einsum("kcd,kd->kc", _inverse(_squares(slopes, weight)), pull)
            left -= np.einsum("knxc,kc->knx", slopes, step)
            command[at] = u + step
            covariance[at] = _covariance(
                shapes.member, slopes, left, weight, some.sigma is not None
            )
            observed[at] = _observed(shapes, _grid(low, high), u, low, high)
    covariance[frames] += _slack(observed[frames], low, high)
    return replace(matches, command=command, covariance=covariance, observed=observed)


def weighted(model: Model, run: Run) -> tuple[Floats, Floats]:
    """Return the points that a run shows of a model, and their weights.

    Returns:
        tuple[Floats, Floats]: points (K, N, 3) mm, 0 where unseen, and weights (K, N), 1/mm².
    """
    points = np.asarray(model.points_in_mm(run), float)
    visible = known(run, points)
    sigma = (
        np.ones(visible.shape) if run.sigma is None else np.broadcast_to(run.sigma, visible.shape)
    )
    return np.where(visible[..., None], points, 0.0), visible / np.maximum(sigma, 1e-6) ** 2


def _slack(observed: Mask, low: Floats, high: Floats) -> Floats:
    """Return the covariance (K, C, C) of undetermined commands: that of their range."""
    return np.asarray(
        np.einsum("kc,cd->kcd", ~observed * (high - low) ** 2 / 12.0, np.eye(len(low)))
    )


def _joined(parts: list[tuple[NDArray[np.intp], Matches]]) -> Matches:
    """Return the matches of a run's frames from those of its parts, each with its rows."""
    order = np.argsort(np.concatenate([rows for rows, _ in parts]))
    names = [f.name for f in fields(Matches)]
    return Matches(
        **{n: np.concatenate([getattr(part, n) for _, part in parts])[order] for n in names}
    )


class Shapes:
    """The shapes (n, N, 3) mm of a model at commands (n, C), as the points of a run.

    Attributes:
        family: the prior, in the orientation of the run.
        carry: weights of a run's markers in the template; None for the model's own points.
        count: number of points N.
        member: section of each point, as a matrix of ones and zeros.
        roll_seen: whether the run shows the roll of the body.
        turn: rotation about the axis of the base, (3, 3); None without one.
    """

    turn: Floats | None = None

    def __init__(self, model: Model, run: Run, family: Shape) -> None:
        self.family = family
        self.carry = model.view(run).carry
        self.count = len(model.rest) if self.carry is None else len(self.carry)
        section = model.sections if self.carry is None else np.arange(self.count)
        self.member = members(section)
        self.roll_seen = roll_seen(model, run) or self.member.shape[1] < 2

    def __call__(self, u: Floats) -> Floats:
        points = np.asarray(self.family.evaluate(np.ascontiguousarray(u))).reshape(len(u), -1, 3)
        points = (
            points
            if self.carry is None
            else np.asarray(np.einsum("mn,knx->kmx", self.carry, points))
        )
        return points if self.turn is None else points @ self.turn.T

    def turned(self, angle: float) -> Shapes:
        """Return the same shapes rotated about the axis of the base by an angle in rad."""
        other = copy(self)
        other.turn = rotation(np.array([0.0, 0.0, angle])) if angle else None
        return other

    def slopes(self, u: Floats) -> Floats:
        """Return the derivatives of the shapes by the commands, (n, N, 3, C)."""
        found = np.asarray(self.family.jacobian(np.ascontiguousarray(u))).reshape(
            len(u), -1, 3, u.shape[1]
        )
        found = (
            found
            if self.carry is None
            else np.asarray(np.einsum("mn,knxc->kmxc", self.carry, found))
        )
        return (
            found if self.turn is None else np.asarray(np.einsum("ij,knjc->knic", self.turn, found))
        )

    def without_roll(self, moved: Floats, points: Floats, weight: Floats) -> Floats:
        """Return displacements (n, N, 3, m) without the rotation of each section about the body.

        It is the rotation of `points` (n, N, 3) that explains most of the displacement. If the run
        shows the roll, nothing is removed.
        """
        return moved if self.roll_seen else without_roll(self.member, moved, points, weight)


def _grid(low: Floats, high: Floats) -> Floats:
    """Return commands (G, C) that cover a range."""
    each = max(2, min(STEPS, int(MOST_SHAPES ** (1.0 / max(1, len(low))) + 1e-9)))
    axes = [np.linspace(a, b, each) for a, b in zip(low, high)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(low))


def _nearest(shapes: Floats, seen: Floats, visible: Mask) -> NDArray[np.intp]:
    """Return the shape (G, N, 3) with the smallest mean absolute error for each frame (K, N, 3)."""
    flat, each = (
        np.asarray(shapes.reshape(len(shapes), -1), np.float32),
        max(1, CHUNK // max(1, shapes.size)),
    )
    rows, shown = (
        seen.reshape(len(seen), -1).astype(np.float32),
        np.repeat(visible, 3, axis=1).astype(np.float32),
    )
    found = np.zeros(len(seen), np.intp)
    for k in range(0, len(seen), each):
        off = np.abs(flat - rows[k : k + each, None])
        found[k : k + each] = np.argmin((off @ shown[k : k + each, :, None])[..., 0], axis=1)
    return found


def _refined(
    shapes: Shapes, seen: Floats, weight: Floats, u: Floats, low: Floats, high: Floats
) -> Floats:
    """Return the best commands (k, C) within their range, from a start `u` (k, C)."""
    damping = np.full(len(u), 1e-3)
    points, left, cost = _left(shapes, seen, weight, u)
    for _ in range(ROUNDS):
        slopes = shapes.without_roll(shapes.slopes(u), points, weight)
        gradient = np.einsum("kn,knxc,knx->kc", weight, slopes, left, optimize=True)
        bend = _squares(slopes, weight)
        held = ((u <= low) & (gradient < 0)) | ((u >= high) & (gradient > 0))
        own = np.where(held, 1.0, damping[:, None] * np.einsum("kcc->kc", bend) + 1e-9)
        system = np.where(~held[:, :, None] & ~held[:, None], bend, 0.0) + own[:, :, None] * np.eye(
            u.shape[1]
        )
        tried = np.clip(
            u + np.linalg.solve(system, np.where(held, 0.0, gradient)[..., None])[..., 0], low, high
        )
        there, after, price = _left(shapes, seen, weight, tried)
        better, step = price < cost, np.abs(tried - u) / (high - low)
        u, cost = np.where(better[:, None], tried, u), np.where(better, price, cost)
        points, left = (
            np.where(better[:, None, None], new, old)
            for new, old in ((there, points), (after, left))
        )
        damping = np.where(better, 0.2 * damping, 8.0 * damping)
        if np.all((step.max(axis=1) < SETTLED) | (damping > 1e8)):
            break
    return u


def _left(shapes: Shapes, seen: Floats, weight: Floats, u: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the shapes at commands, their errors, and the weighted squares of these.

    Their shapes are (k, N, 3), (k, N, 3) and (k,). The errors are measured minus predicted.
    """
    points = shapes(u)
    left = shapes.without_roll((seen - points)[..., None], points, weight)[..., 0]
    return points, left, np.einsum("kn,knx,knx->k", weight, left, left, optimize=True)


def _squares(slopes: Floats, weight: Floats) -> Floats:
    return np.asarray(np.einsum("kn,knxc,knxd->kcd", weight, slopes, slopes, optimize=True))


def _inverse(bend: Floats) -> Floats:
    """Return the inverses of matrices (k, C, C), regularised for singular ones."""
    eye = np.eye(bend.shape[1])
    return np.asarray(
        np.linalg.inv(bend + 1e-6 * np.einsum("kcc->k", bend)[:, None, None] * eye + 1e-12 * eye)
    )


def _covariance(
    member: Floats, slopes: Floats, left: Floats, weight: Floats, known: bool
) -> Floats:
    """Return the covariance (k, C, C) of commands by independent noise or correlated errors.

    The larger of the two is returned. Correlated errors are common to a section. `known` states
    whether the weights are from a known noise.
    """
    inverse = _inverse(_squares(slopes, weight))
    cost = np.einsum("kn,knx,knx->k", weight, left, left, optimize=True)
    spread = cost / np.maximum(3.0 * (weight > 0).sum(axis=1) - slopes.shape[-1], 1.0)
    noise = inverse * (np.maximum(spread, 1.0) if known else spread)[:, None, None]
    each = np.einsum("kn,knxc,knx->knc", weight, slopes, left, optimize=True)
    parts = np.einsum("ns,knc->ksc", member, each)
    together = inverse @ np.einsum("ksc,ksd->kcd", parts, parts) @ inverse
    larger = np.einsum("kcc->k", together) > np.einsum("kcc->k", noise)
    return np.asarray(np.where(larger[:, None, None], together, noise))


def _observed(shapes: Shapes, grid: Floats, u: Floats, low: Floats, high: Floats) -> Mask:
    """Return which commands (K, C) move the shape as much as is usual, in both directions."""
    observed, some = np.ones(u.shape, bool), grid[:: max(1, len(grid) // USUAL)]
    for c, step in enumerate(np.diag(STEP * (high - low))):

        def moved(at: Floats, step: Floats = step) -> Floats:
            return np.asarray(np.sqrt(np.mean((shapes(at + step) - shapes(at)) ** 2, axis=(1, 2))))

        least = MOVES * float(np.median(moved(some)))
        observed[:, c] = (moved(u) > least) & (moved(u - step) > least)
    return observed
