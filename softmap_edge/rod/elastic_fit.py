"""Fit an elastic-tendon rod to a run by bounded Levenberg-Marquardt on marker positions.

Several starts are used.

    minimise Σ |predicted(x) − seen|²  over x within bounds,
        x = the free parameters (`elastic.Coordinates`)

Slopes are exact (rust/rod/elastic_slopes.rs). Held-out error: each fold is predicted by a refit
without it. A fold is a part of the run's `block` labels, else a block of time. Labels are dealt in
turn, so no fold holds all moves of one kind. The uncertainty is the larger of two: of the
linearised fit, and of those refits (jackknife). The first takes frames as independent, but
neighbouring frames share the model-form error. A parameter is *not identified* by the run if it is
less certain than a guess (`Kind.doubt`). If it is correlated with another (`TRADED`), a tenth of
that is the limit. tests/rod/test_elastic.py pins exact recovery, the folds, and the identified
parameters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import RobotError, RunError
from softmap_edge.model.basis import Basis
from softmap_edge.model.elastic_rod import Coordinates, ElasticRodArrays
from softmap_edge.rod.covered_folds import search_folds
from softmap_edge.rod.descent import Term, descend
from softmap_edge.rod.fitted import Fitted, FittedNumber
from softmap_edge.rod.memory.memory import Memory
from softmap_edge.rod.memory.search import FRAMES, find_memory
from softmap_edge.rod.reference_run import ReferenceFrames
from softmap_edge.rod.static_map import StaticMap
from softmap_edge.run.folds import Folds

if TYPE_CHECKING:
    from softmap_edge.rod.robot import Robot

Floats = NDArray[np.float64]

STARTS = 4
# degrees of the polynomial added to a described rod while its delay is fitted
SUPPORT_DEGREES = (1, 2)
# markers times frames of a fit, above which frames are thinned evenly
MOST_SEEN, LEAST_FRAMES = 8000, 200
CHUNK = 4_000_000  # most slope values in memory
EXACT = 1e-4  # least camera noise, mm; keeps the uncertainty of a perfect fit above zero
TRADED = 0.995  # correlation of two parameters above which only their combination is identified


def fit_elastic(
    seen: ReferenceFrames, robot: Robot, parts: Folds, seed: int, static: bool
) -> Fitted:
    """Fit the free parameters of an elastic rod, then the drive's delay.

    The delay is fitted if the log identifies it and not `static`.

    Raises:
        RunError: a fold leaves too little data for the fit.
    """
    least, free = (
        min(len(train) for train, _ in parts) * seen.markers[0].size,
        len(robot.coordinates().labels),
    )
    if least < 2 * free:
        raise RunError(
            f"without one of the {len(parts)} parts that are held out in turn {least} coordinates "
            f"are left to fit {free} numbers from; record longer, label longer moves as one "
            "`block`, or make more of them known"
        )
    start, u = robot.start.copy(), seen.drive.commanded
    if not robot.angles_known:
        start[robot.layout.places()["angle"]] = _sides(robot, u, seen.markers)
    space = robot.coordinates(start)
    data = Data(space, u, seen.markers)
    x, agree = best_of(data, STARTS, seed)
    memory = Memory() if static or seen.slow else _memory(seen, robot, space.numbers(x), seed)
    if memory.names:
        data = Data(space, memory.acting(seen.drive), seen.markers)
        x = descend(data.term(), x, space.low, space.high)[0]
    residuals, refits = cross_validate(data, x, parts)
    return Fitted(
        rod=ElasticRodArrays.nominal(robot.layout, space.numbers(x), space.groups),
        memory=memory,
        residuals=residuals.reshape(seen.markers.shape),
        parts=parts,
        made_from={"robot": robot.name, "seed": seed, "starts": STARTS, "starts_that_agree": agree},
        numbers=numbers(data, x, refits),
    )


def _memory(seen: ReferenceFrames, robot: Robot, fitted: Floats, seed: int) -> Memory:
    """Find the drive's delay with the rod fitted to the commands, plus a small polynomial.

    Other memory is left to the diagnosis: the rod has its own laws for slack and friction.
    """
    few = seen.every(-(-len(seen.t) // FRAMES))
    rod, parts = robot.layout.compiled(fitted), search_folds(few, Basis(max(SUPPORT_DEGREES)))
    smallest = min(len(train) for train, _ in parts)
    degree = max(
        [
            d
            for d in SUPPORT_DEGREES
            if 2 * len(_core.monomial_degrees(seen.drive.channels, d)) < smallest
        ],
        default=1,
    )
    static = StaticMap(
        few.markers.reshape(len(few.markers), -1),
        parts,
        Basis(degree),
        base=lambda acting: rod.evaluate(np.ascontiguousarray(acting)),
    )
    return find_memory(few, static, seed, members=("delay",))


def fit_for(robot: Robot, seen: ReferenceFrames) -> ReferenceFrames:
    """Check that a run is of this robot, and thin its frames for a fit."""
    channels, markers = seen.drive.channels, seen.markers.shape[1]
    if (channels, markers) != (robot.layout.channels, len(robot.layout.at)):
        raise RobotError(
            f"the run has {channels} commands and {markers} markers, '{robot.name}' has "
            f"{robot.layout.channels} and {len(robot.layout.at)}; give each tendon its command "
            "and each marker its place in robot.toml"
        )
    free = len(robot.coordinates().labels)
    if len(seen.t) * 3 * markers < 4 * free or not free:
        raise RobotError(
            f"{len(seen.t)} usable frames of {markers} markers and {free} numbers to fit; give "
            "four coordinates "
            "for each number, and name in [fit] of robot.toml what is to be fitted, as angle = "
            '"each"'
        )
    every = -(-len(seen.t) // max(LEAST_FRAMES, MOST_SEEN // markers))
    return seen.every(every)


def _sides(robot: Robot, u: Floats, markers: Floats) -> Floats:
    """Return the side (tendons,) rad to which each tendon pulls the last marker (linear fit)."""
    centred, moved = u - u.mean(axis=0), markers[:, -1, :2] - markers[:, -1, :2].mean(axis=0)
    square = centred.T @ centred
    slope = np.linalg.solve(
        square + 1e-3 * np.trace(square) / len(square) * np.eye(len(square)), centred.T @ moved
    )
    pull = slope[list(robot.layout.channel)] * np.array(robot.layout.pull)[:, None]
    return np.asarray(np.arctan2(pull[:, 1], pull[:, 0]))


# --- the descent ---------------------------------------------------------------------------------


class Data:
    """Commands u (n, C) and markers (n, M, 3) mm, and the residuals of a rod."""

    def __init__(self, coordinates: Coordinates, u: Floats, markers: Floats) -> None:
        self.coordinates, self.u = coordinates, np.ascontiguousarray(u)
        self.seen = markers.reshape(len(markers), -1)

    def residuals(self, x: Floats, frames: NDArray[np.intp] | None = None) -> Floats:
        """Return predicted − seen (n, 3M) mm."""
        u, seen = (self.u, self.seen) if frames is None else (self.u[frames], self.seen[frames])
        layout = self.coordinates.layout
        return layout.compiled(self.coordinates.numbers(x)).evaluate(u) - seen

    def slopes(self, x: Floats, frames: NDArray[np.intp]) -> Floats:
        """Return the slopes (n·3M, D) of the residuals by x."""
        rod = self.coordinates.layout.compiled(self.coordinates.numbers(x))
        step = max(1, CHUNK // (rod.size * len(self.coordinates.start)))
        parts = [
            self.coordinates.slopes(
                x, rod.number_slopes(np.ascontiguousarray(self.u[frames[i : i + step]]))[1]
            )
            for i in range(0, len(frames), step)
        ]
        return np.concatenate(parts).reshape(-1, len(x))

    def term(self, frames: NDArray[np.intp] | None = None) -> Term:
        """Return the residuals of some frames in the form of `descend`."""
        some = np.arange(len(self.u)) if frames is None else frames

        def at(x: Floats, slopes_needed: bool) -> tuple[Floats, Floats]:
            return self.residuals(x, some).reshape(-1), self.slopes(
                x, some
            ) if slopes_needed else np.zeros((0, len(x)))

        return at


def best_of(data: Data, starts: int, seed: int) -> tuple[Floats, int]:
    """Fit from the file's start and random ones around it; return the best x and its count.

    The count is the number of starts that reach it.
    """
    space, rng = data.coordinates, np.random.default_rng(seed)
    tried = [np.zeros(len(space.labels))]
    tried += [rng.normal(size=len(space.labels)) * space.scatter for _ in range(starts - 1)]
    found = [descend(data.term(), x, space.low, space.high) for x in tried]
    best = min(found, key=lambda end: end[1])
    return best[0], sum(cost <= best[1] * 1.01 + 1e-12 for _, cost in found)


def cross_validate(data: Data, x: Floats, parts: Folds) -> tuple[Floats, Floats]:
    """Return predicted − seen (n, 3M) mm, each fold by a fit without it, and fits (folds, D)."""
    residuals, refits = np.empty_like(data.seen), []
    for train, test in parts:
        without = descend(data.term(train), x, data.coordinates.low, data.coordinates.high)[0]
        residuals[test] = data.residuals(without, test)
        refits.append(without)
    return residuals, np.stack(refits)


# --- identified numbers ---------------------------------------------------------------------------


def numbers(data: Data, x: Floats, refits: Floats) -> tuple[FittedNumber, ...]:
    """Return the fitted value of each free number."""
    space, everything = data.coordinates, np.arange(len(data.u))
    residual, jacobian = data.residuals(x).reshape(-1), data.slopes(x, everything)
    spread, traded = _linear(
        jacobian, space.doubt, float(residual @ residual) / max(1, len(residual) - len(x))
    )
    folds = len(refits)
    jackknife = np.sqrt((folds - 1.0) / folds * ((refits - refits.mean(axis=0)) ** 2).sum(axis=0))
    sigma = np.maximum(spread, jackknife)
    numbers = space.fitted_numbers(x, np.minimum(sigma, 1e3))
    at_bound = (x <= space.low + 1e-9) | (x >= space.high - 1e-9)
    found = []
    for i, (value, deviation, unit) in enumerate(numbers):
        partner = int(np.argmax(np.abs(traded[i])))
        note = ""
        if sigma[i] > space.doubt[i]:
            note = "not identified by this run"
        if abs(traded[i, partner]) > TRADED and sigma[i] > 0.1 * space.doubt[i]:
            note = f"identified only together with {space.labels[partner]}"
        found.append(FittedNumber(space.labels[i], value, deviation, unit, bool(at_bound[i]), note))
    return tuple(found)


def _linear(jacobian: Floats, doubt: Floats, variance: float) -> tuple[Floats, Floats]:
    """Return the standard deviation of each x by the linearised fit, and correlations.

    The correlations are without the diagonal.

    A prior of width ten `doubt` is added to the data, so unobserved directions stay finite.
    """
    scaled = jacobian * doubt  # x in units of doubt
    information = scaled.T @ scaled / max(variance, EXACT**2) + 1e-2 * np.eye(len(doubt))
    strength, directions = np.linalg.eigh(information)
    covariance = (directions / np.maximum(strength, 1e-2)) @ directions.T
    deviation = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(deviation, deviation)
    return deviation * doubt, correlation - np.diag(np.diag(correlation))
