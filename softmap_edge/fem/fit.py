"""Fit the finger's own parameters to a run.

They are modulus, cable stiffness and pretension, with the pose of the camera's frame.

One shape per dwell (the mean of its settled frames) is compared with the simulator at the same
commands, gravity and load. Damped Gauss-Newton on scaled parameters x, each evaluation a
simulation:

    J(x, m) = Σ_k |f_k − R(m) F(solid(x, u_k, g_k, load_k))|² / s² + |x − x_start|²

f features (mm), m the six parameters of the frame (rad, mm; no prior), x = ln(value / start) over
half the log range for a stiffness, (value − start) over half the range for a length. The last term
is a weak prior at the bounds' half range. s is the residual itself. Standard deviations come from
the dwells (sandwich of the gradients of each, K/(K − P) for few), because frames of one dwell are
not independent. A parameter with a deviation above half of its half range is not identifiable: it
keeps its start value and is reported. Only the ratio of modulus and density is observable unless a
known load hangs on the finger, so density is never fitted. Units: mm, MPa, N/mm, g. Known limit:
effects that the finger lacks (backlash, creep, an unknown load) bias these parameters. Diagnose
with the fitted finger afterwards, and compare the error on the held-out dwells. Pinned by
tests/fem/test_refit_finger.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import RunError, SoftmapError
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator, tour
from softmap_edge.files.atomic import Document
from softmap_edge.geometry.rigid import RigidPose, rotation
from softmap_edge.geometry.sections import (
    attach,
    marker_features,
    section_features,
    seen_residual,
    upright,
)
from softmap_edge.run.conditions import conditions
from softmap_edge.run.run import Run, known

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]

SETTLED = 1.0  # s after the command stopped
# dwells for fit and validation, spread over commands and orientations
DWELLS, KEPT_OUT = 24, 12
FRAME_DWELLS = 3  # fewer shapes do not separate the frame from the finger
# fewer dwells do not show their scatter: deviations then come from the residual
SANDWICH = 8
ITERATIONS = 6
STEP = 0.08  # step of x: a tenth of the usual range, far above the solver's tolerance
SEEN = 0.5  # of the half range: deviation above which a parameter is not identifiable
# independent values per dwell: features of neighbouring sections are nearly the same
EVIDENCE = 6.0
FLOOR_MM = 0.02  # least residual that is trusted
TWINS = 0.95  # correlation above which only a combination of two parameters is identifiable
UNITS = {"young_mpa": "MPa", "cable_stiffness_n_mm": "N/mm", "pretension_mm": "mm"}
MOUNT = ("turn_x", "turn_y", "turn_z", "shift_x", "shift_y", "shift_z")


@dataclass(frozen=True)
class FingerNumber:
    """A fitted parameter: value ± sigma in its unit, its start, and why it is not fitted, if so."""

    value: float
    sigma: float | None
    unit: str
    start: float
    at_bound: bool = False
    note: str = ""


@dataclass(frozen=True)
class FingerFit:
    """A finger with fitted parameters, and its errors before and after.

    The errors are on held-out dwells.
    """

    finger: Finger
    numbers: dict[str, FingerNumber]
    mount: dict[str, FingerNumber]
    together: tuple[tuple[str, str, float], ...]  # pairs not separable, with correlation
    dwells: int
    kept_out: int
    # on held-out dwells, None without any: unchanged finger and frame
    as_it_was_mm: float | None
    frame_fitted_mm: float | None
    finger_fitted_mm: float | None

    def to_dict(self) -> Document:
        """Return the document softmap.refit-finger/1."""

        def rows(numbers: dict[str, FingerNumber]) -> dict[str, Document]:
            return {
                name: {k: v for k, v in vars(n).items() if k != "note" or v}
                for name, n in numbers.items()
            }

        return {
            "schema": "softmap.refit-finger/1",
            "finger": self.finger.name,
            "params": rows(self.numbers),
            "mount": rows(self.mount),
            "seen_only_together": [list(row) for row in self.together],
            "dwells": {"fitted": self.dwells, "kept_out": self.kept_out},
            "error": {
                "kind": "held-out rms",
                "unit": "mm",
                "as_it_was": self.as_it_was_mm,
                "frame_fitted": self.frame_fitted_mm,
                "finger_fitted": self.finger_fitted_mm,
            },
        }

    def __str__(self) -> str:
        lines = [f"{self.finger.name}: {self.dwells} dwells fitted, {self.kept_out} kept out"]
        for name, n in (*self.numbers.items(), *self.mount.items()):
            value = (
                f"{n.value:.4g}"
                + (f" ± {n.sigma:.2g}" if n.sigma is not None else "")
                + f" {n.unit}"
            )
            note = n.note or (
                "at its bound: widen it in [fit], or look for what is missing" if n.at_bound else ""
            )
            lines.append(
                f"  {name:<22} {value:<24} was {n.start:.4g}" + (f"   {note}" if note else "")
            )
        for one, other, correlation in self.together:
            lines.append(
                f"  {one} and {other} are seen only together (correlation {correlation:+.2f})"
            )
        lines.append("  density is as given: of modulus and density this run shows the ratio")
        if not self.mount:
            lines.append(
                f"  the camera's frame is taken as it is: {self.dwells} dwells do not distinguish "
                "it from the finger"
            )
        if self.finger_fitted_mm is None:
            return "\n".join(
                [
                    *lines,
                    "no dwell was left for validation: predict another run with the fitted finger",
                ]
            )
        lines.append(
            f"error on dwells kept out: {self.as_it_was_mm:.2f} mm as it was, "
            f"{self.frame_fitted_mm:.2f} with the frame fitted, {self.finger_fitted_mm:.2f} mm "
            "with the finger fitted"
        )
        return "\n".join(lines)


def fit_finger(finger: Finger, run: Run, progress: Progress | None = None) -> FingerFit:
    """Fit the parameters with bounds in `finger.fit`, and the camera's frame, to a run.

    Args:
        finger: the start of the fit; `finger.fit` maps names of parameters to (low, high).
        run: vertices of the finger's template or markers with `marker_rest`, commands in mm,
            dwells.
        progress: called with (what, completed share).

    Returns:
        FingerFit: the finger with its new parameters, their deviations, and errors on held-out
        dwells.

    Raises:
        SoftmapError: too few dwells, a run of another robot, nothing to fit, no equilibrium.
    """
    if not finger.fit:
        raise SoftmapError(
            f"{finger.name}: no [fit] table says which numbers may change; see the template's"
        )
    problem = _FitProblem(finger, run, progress or (lambda what, share: None))
    names, numbers = list(finger.fit), {}
    alone = _descend(problem, [])
    found = _descend(problem, names)
    while (deviation := found.deviation[: len(names)]).max(initial=0.0) > SEEN:
        name = names.pop(int(np.argmax(deviation)))
        start = float(getattr(finger, name))
        numbers[name] = FingerNumber(
            start, None, UNITS[name], start, note="not identifiable with this run: kept as it was"
        )
        found = _descend(problem, names)
    new = problem.finger(names, found.x)
    for i, name in enumerate(names):
        value, (low, high) = float(getattr(new, name)), finger.fit[name]
        slope = problem.half(name) * (value if low > 0 else 1.0)
        numbers[name] = FingerNumber(
            value,
            float(found.deviation[i] * slope),
            UNITS[name],
            float(getattr(finger, name)),
            at_bound=not low < value < high,
        )
    kept = problem.kept_out
    return FingerFit(
        finger=new,
        numbers={name: numbers[name] for name in finger.fit},
        mount=_mount_numbers(found.mount, found.deviation[len(names) :])
        if problem.frame_is_free
        else {},
        together=_together(names, found.covariance),
        dwells=len(problem.fitted),
        kept_out=len(kept),
        as_it_was_mm=problem.rms(kept, [], np.zeros(0), np.zeros(6)),
        frame_fitted_mm=problem.rms(kept, [], np.zeros(0), alone.mount),
        finger_fitted_mm=problem.rms(kept, names, found.x, found.mount),
    )


@dataclass(frozen=True, eq=False)
class _Dwells:
    """Commands and measurements at rest: one row per dwell."""

    command: Floats  # (D, C) mm
    gravity: Floats  # (D, 3) g
    load: Floats  # (D,) g
    points: Floats  # (D, M, 3) mm, NaN where hidden


def _settled(finger: Finger, run: Run) -> _Dwells:
    """Return the mean of the settled frames of each dwell.

    Raises:
        RunError: the run has no points, commands of another kind, or no dwell.
    """
    u = run.commands()
    if u.shape[1] != len(finger.pairs):
        raise RunError(
            f"the run has {u.shape[1]} commands a sample, {finger.name} takes {len(finger.pairs)}; "
            "give the finger.toml of the robot that was recorded"
        )
    if run.command_unit != finger.command_unit:
        raise RunError(
            f"the run's commands are in {run.command_unit}, {finger.name} takes "
            f"{finger.command_unit}; convert them where the log is imported"
        )
    state = conditions(run, u)
    still = (state.visit >= 0) & (state.dwell >= SETTLED)
    visits = [np.flatnonzero(still & (state.visit == v)) for v in np.unique(state.visit[still])]
    if not visits:
        raise RunError(
            f"the robot never stands still for {SETTLED:g} s; a fit of the finger's own numbers "
            "wants dwells of 2 s, better 20 of them in two orientations"
        )
    points = np.where(known(run, run.seen_points)[..., None], run.seen_points, np.nan)
    at = [int(v[-1]) for v in visits]
    gravity = (
        np.tile(finger.gravity, (len(visits), 1)) if state.gravity is None else state.gravity[at]
    )
    load = np.zeros(len(visits)) if run.load is None else np.interp(run.t_seen[at], run.t, run.load)
    return _Dwells(
        state.command[at], gravity, load, np.stack([_nanmean(points[v]) for v in visits])
    )


def _nanmean(frames: Floats) -> Floats:
    known = np.isfinite(frames)
    count = known.sum(axis=0)
    return np.where(
        count > 0, np.where(known, frames, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan
    )


def _spread(dwells: _Dwells) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the dwells to fit and those held out.

    Each next dwell is the farthest from all previous ones, for both in turn.
    """
    span = np.maximum(np.ptp(dwells.command, axis=0), 1e-9)
    heavy = dwells.load[:, None] / max(float(np.ptp(dwells.load)), 1e-9)
    places = np.hstack([dwells.command / span, dwells.gravity, heavy])
    order = [int(np.argmin(np.sum(dwells.command**2, axis=1)))]
    nearest = np.full(len(places), np.inf)
    while len(order) < min(len(places), DWELLS + KEPT_OUT):
        nearest = np.minimum(nearest, np.sum((places - places[order[-1]]) ** 2, axis=1))
        nearest[order] = -1.0
        order.append(int(np.argmax(nearest)))
    out = np.arange(len(order)) % 3 == 2 if len(order) > 2 else np.arange(len(order)) == 1
    return np.sort(np.array(order)[~out]), np.sort(np.array(order)[out])


class _FitProblem:
    """A finger, the dwells of a run, and the simulator; solved shapes are cached."""

    def __init__(self, finger: Finger, run: Run, report: Progress) -> None:
        self.start, self.report, self.dwells = finger, report, _settled(finger, run)
        self.fitted, self.kept_out = _spread(self.dwells)
        loads = np.round(np.column_stack([self.dwells.gravity, self.dwells.load]), 2)
        self.loads, self.group = np.unique(loads, axis=0, return_inverse=True)
        self.template = Simulator(finger).template
        rest, count = self.template.vertices, self.dwells.points.shape[1]
        self.map, self.carry = section_features(upright(rest)), None
        if run.markers is not None:
            if run.marker_rest is None:
                raise RunError(
                    "the run has markers but no `marker_rest` (M, 3) mm; give marker_rest_mm in "
                    "the mapping"
                )
            self.map, self.carry = (
                marker_features(count),
                attach(np.asarray(run.marker_rest, float), rest),
            )
        elif count != len(rest):
            raise RunError(
                f"the run has {count} points a frame, {finger.name} has {len(rest)}; it is "
                "another template"
            )
        self._solved: dict[tuple[Finger, int, bytes], Floats] = {}

    def half(self, name: str) -> float:
        """Return half the range of a parameter, of its logarithm if positive."""
        low, high = self.start.fit[name]
        return 0.5 * float(np.log(high / low)) if low > 0 else 0.5 * (high - low)

    def scaled(self, name: str, value: float) -> float:
        """Return x of a value."""
        start = float(getattr(self.start, name))
        return (
            float(np.log(value / start)) if self.start.fit[name][0] > 0 else value - start
        ) / self.half(name)

    def finger(self, names: Sequence[str], x: Floats) -> Finger:
        """Return the finger for scaled parameters x (P,)."""
        values = {}
        for name, step in zip(names, x * [self.half(name) for name in names]):
            start, (low, high) = float(getattr(self.start, name)), self.start.fit[name]
            values[name] = float(
                np.clip(start * np.exp(step) if low > 0 else start + step, low, high)
            )
        return self.start.replace(**values)

    def shapes(self, names: Sequence[str], batch: Floats, which: NDArray[np.intp]) -> Floats:
        """Return the simulated points (B, d, M, 3) mm for parameters x (B, P), on all cores.

        They are for the dwells `which`.
        """
        parts = [which[self.group[which] == g] for g in np.unique(self.group[which])]
        jobs = [(self.finger(names, x), part) for x in batch for part in parts]
        with ThreadPoolExecutor() as pool:
            solved = list(pool.map(lambda job: self._solve(*job), jobs))
        back = np.argsort(np.concatenate(parts))
        rows = [
            np.concatenate(solved[i : i + len(parts)])[back]
            for i in range(0, len(solved), len(parts))
        ]
        return np.stack(rows)

    def _solve(self, finger: Finger, part: NDArray[np.intp]) -> Floats:
        """Simulate dwells under one load, each from a near one."""
        group = int(self.group[part[0]])
        key = (finger, group, part.tobytes())
        if key not in self._solved:
            *gravity, mass = self.loads[group]
            order = tour(self.dwells.command[part])
            points = np.empty((len(part), len(self.template.vertices), 3))
            force = mass * 1e-3 * _core.STANDARD_GRAVITY * np.array(gravity)
            solver = Simulator(finger, self.template)
            points[order] = solver.path(
                self.dwells.command[part][order], gravity=gravity, load=force
            )
            self._solved[key] = (
                points if self.carry is None else np.einsum("mn,knc->kmc", self.carry, points)
            )
        return self._solved[key]

    def features(self, difference: Floats, which: NDArray[np.intp]) -> Floats:
        """Return the features (d, V, 3) mm of differences of points (d, M, 3); 0 if unseen."""
        seen = np.asarray(np.isfinite(self.dwells.points[which]).all(axis=2))
        if seen.all() or self.carry is not None:
            return self.map(np.where(seen[..., None], difference, 0.0))
        return np.nan_to_num(seen_residual(difference, upright(self.template.vertices), seen))

    @property
    def frame_is_free(self) -> bool:
        """Whether there are enough shapes to separate the camera's frame from the parameters."""
        return len(self.fitted) >= FRAME_DWELLS

    def rms(
        self, which: NDArray[np.intp], names: Sequence[str], x: Floats, mount: Floats
    ) -> float | None:
        """Return the RMS distance (mm) over visible section centroids or markers.

        Return None without dwells.
        """
        if not len(which):
            return None
        seen = self.dwells.points[which]
        off = self.features(seen - moved(self.shapes(names, x[None], which)[0], mount), which)[
            :, self.map.positions
        ]
        squares = np.sum(off**2, axis=2)
        return float(np.sqrt(squares[squares > 0].mean()))


def moved(points: Floats, mount: Floats) -> Floats:
    """Return points (..., 3) mm turned about the base and shifted.

    The rotation vector is mount[:3] (rad), the shift mount[3:] (mm).
    """
    return RigidPose(rotation(mount[:3]), mount[3:])(points)


@dataclass(frozen=True, eq=False)
class _Found:
    x: Floats  # (P,)
    mount: Floats  # (6,)
    covariance: Floats  # (P + 6, P + 6)

    @property
    def deviation(self) -> Floats:
        return np.sqrt(np.diag(self.covariance))


def _descend(problem: _FitProblem, names: Sequence[str]) -> _Found:
    """Fit the parameters `names` and the frame to the dwells by damped Gauss-Newton.

    Clipping enforces the bounds.
    """
    which, count = problem.fitted, len(names)
    low, high = (
        np.array([problem.scaled(name, problem.start.fit[name][i]) for name in names])
        for i in (0, 1)
    )
    low, high = np.r_[low, np.full(6, -np.inf)], np.r_[high, np.full(6, np.inf)]
    prior = np.r_[np.ones(count), np.full(6, 1e-9 if problem.frame_is_free else 1e12)]
    seen, y, damping = problem.dwells.points[which], np.zeros(count + 6), 1e-3

    def residual(y: Floats) -> Floats:
        shapes = problem.shapes(names, y[None, :count], which)[0]
        return problem.features(seen - moved(shapes, y[count:]), which).reshape(len(which), -1)

    left = residual(y)
    for iteration in range(ITERATIONS):
        problem.report(f"fit of {', '.join(names) or 'the frame'}", iteration / ITERATIONS)
        steps = np.r_[
            np.where(y[:count] + STEP > high[:count], -STEP, STEP),
            np.full(3, 1e-4),
            np.full(3, 1e-2),
        ]
        # all at once, on all cores
        problem.shapes(names, y[:count] + np.diag(steps[:count]), which) if count else None
        slopes = np.stack(
            [(residual(y + row) - left) / -step for row, step in zip(np.diag(steps), steps)]
        )
        weight = EVIDENCE / (left.shape[1] * max(float(np.mean(left**2)), FLOOR_MM**2))
        normal = weight * np.einsum("pkf,qkf->pq", slopes, slopes) + np.diag(prior)
        downhill = weight * np.einsum("pkf,kf->p", slopes, left) - prior * y
        cost = weight * np.sum(left**2) + np.sum(prior * y**2)
        for _ in range(4):
            ahead = np.clip(
                y + np.linalg.solve(normal + damping * np.diag(np.diag(normal)), downhill),
                low,
                high,
            )
            left_ahead = residual(ahead)
            better = weight * np.sum(left_ahead**2) + np.sum(prior * ahead**2) < cost
            if better:
                break
            damping *= 30.0
        if not better:
            break
        step = np.abs(ahead - y)
        y = ahead
        left = left_ahead
        damping = damping / 10.0
        if max(step[:count].max(initial=0.0), 30.0 * step[count:].max()) < 0.01:
            break
    gradients = weight * np.einsum("pkf,kf->pk", slopes, left)
    inverse = np.linalg.inv(normal)
    if len(which) < SANDWICH:
        return _Found(y[:count], y[count:], inverse)
    few = len(which) / max(1.0, len(which) - (count + 6) / EVIDENCE)
    return _Found(
        y[:count], y[count:], inverse @ (few * gradients @ gradients.T + np.diag(prior)) @ inverse
    )


def _mount_numbers(mount: Floats, deviation: Floats) -> dict[str, FingerNumber]:
    scale = np.r_[np.full(3, np.degrees(1.0)), np.ones(3)]
    units = ["deg"] * 3 + ["mm"] * 3
    return {
        n: FingerNumber(float(v * k), float(d * k), unit, 0.0)
        for n, v, d, k, unit in zip(MOUNT, mount, deviation, scale, units)
    }


def _together(names: Sequence[str], covariance: Floats) -> tuple[tuple[str, str, float], ...]:
    deviation = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(deviation, deviation)
    pairs = [(a, b) for a in range(len(names)) for b in range(a) if abs(correlation[a, b]) > TWINS]
    return tuple((names[b], names[a], float(correlation[a, b])) for a, b in pairs)
