"""Fit a rod to reference runs: the prior of a robot without a simulator.

The fit takes seconds and needs only numpy and the core.

Two rods (rust/rod/) turn commands into markers. If the robot's tendons are described (`robot.py`),
it is the elastic one, fitted by `elastic_fit.py`. Else it is a chain of chords whose bending angles
are a polynomial (`polynomial.py`). With both, the memory of the robot during the runs is identified
(`memory/`). Its law joins the chain by name, and its alternatives are kept. `static` leaves it out.
With an elastic rod only delays join; other memory is reported. Degree, ridge and law are those with
the lowest error. Frames closer than `gap_s` to a block are not used to predict it. These few
choices use the blocks of the stated error, so it is slightly low. Frames in `hold_out` are never
used. tests/rod/test_rod.py, tests/rod/test_elastic.py and tests/rod/test_learned_memory.py pin
exact recovery and the error on real data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge.alignment.base_motion import kept_places
from softmap_edge.checks.lost_points import without_lost
from softmap_edge.errors import RunError, SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.model.coverage import Coverage, apart, pairs_text
from softmap_edge.model.learned_in import LearnedIn
from softmap_edge.model.model import NOMINAL, Model
from softmap_edge.model.safety import derived
from softmap_edge.model.servo_calibration import from_home
from softmap_edge.model.shapes import BundleArrays, PriorArrays
from softmap_edge.model.structure import Structure
from softmap_edge.rod.elastic_fit import fit_elastic, fit_for
from softmap_edge.rod.fitted import Fitted, FittedNumber
from softmap_edge.rod.polynomial import fit_polynomial
from softmap_edge.rod.reference_run import ReferenceFrames, observe
from softmap_edge.rod.regression import rms
from softmap_edge.run.folds import folds
from softmap_edge.run.pieces import spans
from softmap_edge.run.plane import plane_of
from softmap_edge.run.rest_command import far_from_home
from softmap_edge.run.run import HOME_TICKS, Run
from softmap_edge.version import __version__

if TYPE_CHECKING:
    from softmap_edge.model.polynomial_rod import RodArrays
    from softmap_edge.rod.robot import Robot
    from softmap_edge.run.run import Source

Floats = NDArray[np.float64]

RATE_HZ = 20.0  # neighbouring frames are redundant; more only cost time
# share of the marker motion: a larger held-out error means commands explain little
USELESS = 0.8
DEPENDENT = 0.01  # of the largest singular value of the commands: below it, no motion
ROUNDED = 0.02  # smaller weights in such a direction are encoder rounding
TURNED_DEG = 10.0  # between orientations: from here the robot's weight bends it differently
GAP_S = 2.0  # unused time next to a held-out block, s
POOR = 0.4  # of the marker motion: a rod with the right commands leaves a tenth


@dataclass(frozen=True, eq=False)
class LearnedRod:
    """A rod fitted to runs, and its error on held-out frames.

    `chain_names` and `chain_params` (by label) are the effects of the bundle's chain. `learned_in`
    describes each of them and its alternatives. `error_mm` is the blocked cross-validation RMS over
    all markers, `per_fold_mm` (blocks,), `per_marker_mm` (K,). `form_error` (K, 3) mm is its RMS by
    marker and axis. `residuals` (n, K, 3) mm (predicted − seen) are those at the `frames` of each
    run. They are NaN where other blocks do not cover the command. `coverage` describes the commands
    of these frames. `numbers` are the fitted numbers of an elastic rod; `notes` are warnings.
    """

    rod: RodArrays
    input: Source
    chain_names: tuple[str, ...]
    chain_params: Mapping[str, float]
    error_mm: float
    per_fold_mm: Floats
    per_marker_mm: Floats
    form_error: Floats
    residuals: Floats
    frames: tuple[NDArray[np.intp], ...]
    coverage: Coverage
    made_from: Document
    numbers: tuple[FittedNumber, ...] = ()
    learned_in: tuple[LearnedIn, ...] = ()
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Summarise the fit and its error in a few lines."""
        memory = ", ".join(self.chain_names) or (
            "no law of memory" if self.learned_in else "no memory"
        )
        markers = ", ".join(f"{value:.2f}" for value in self.per_marker_mm)
        blocks = ", ".join(f"{value:.2f}" for value in self.per_fold_mm)
        lines = [
            f"{self.rod}, on the {self.input} command; {memory}",
            f"blocked cross-validation {self.error_mm:.2f} mm RMS (markers {markers}; blocks "
            f"{blocks})",
        ]
        lines += [str(one) for one in self.learned_in]
        return "\n".join([*lines, *(f"  {number}" for number in self.numbers), *self.notes])


class LearnOptions(TypedDict, total=False):
    """Options of `learn` by name."""

    blocks: int
    gap_s: float
    base: ArrayLike | None
    degree: int | None
    rate_hz: float
    static: bool
    seed: int


def learn(
    runs: Run | Sequence[Run],
    input: Source | None = None,
    blocks: int = 5,
    gap_s: float = GAP_S,
    hold_out: Sequence[tuple[float, float]] = (),
    *,
    base: ArrayLike | None = None,
    degree: int | None = None,
    rate_hz: float = RATE_HZ,
    robot: Robot | None = None,
    static: bool = False,
    seed: int = 0,
) -> LearnedRod:
    """Fit a rod and the memory of the robot to reference runs with markers.

    Args:
        runs: one or several of one robot, each with commands (T, C) and markers (K, M, 3) mm, base
            to tip, in the base frame (z along the rest axis). Memory begins in equilibrium in each.
        input: "goal" or "present"; None takes the present positions where every run has them.
        blocks: contiguous blocks of the cross-validation. A short run that visits its commands once
            gets more. An elastic rod uses the runs' `block` labels if they have any.
        gap_s: s, frames this close to a block are not used to predict it; at most half a block.
        hold_out: intervals (t0, t1) s of each run whose frames are not used.
        base: (3,) mm, the point from which the first chord starts; None is the origin of the base
            frame. It is not fitted, because markers do not identify it (on the trunk any depth from
            0 to 94 mm predicts equally well within 0.1 mm).
        degree: degree of the polynomial; None chooses among 1, 2, 3 (up to 5 for one command).
        rate_hz: limit of the frames used per second.
        robot: a description of the robot's tendons for an elastic rod; without it, a polynomial.
        static: learn only the static map, and leave all memory to the diagnosis.
        seed: seed of the scans, and of the starts of an elastic fit.

    Raises:
        RunError: a run has no markers or no commands, too few frames, or hardly moves.
        RobotError: a run is not of that robot.
    """
    together = [runs] if isinstance(runs, Run) else list(runs)
    if not together:
        raise RunError("no run to learn from; give one or more")
    cleared = [without_lost(run) for run in together]
    seen = observe([run for run, _ in cleared], input, hold_out, rate_hz)
    if robot is None:
        fitted = fit_polynomial(seen, blocks, gap_s, base, degree, static, seed)
    elif base is not None or degree is not None:
        raise SoftmapError(
            "base and degree belong to the polynomial rod; an elastic one has base_mm in its "
            "robot.toml"
        )
    else:
        seen = fit_for(robot, seen)
        fitted = fit_elastic(seen, robot, folds(seen.t, blocks, gap_s, seen.labels), seed, static)
    made_from: Document = {
        "softmap-edge": __version__,
        "run": together[0].hash(),
        "runs": [run.hash() for run in together],
        "pieces": [
            [part.origin, first, last] for run in together for part, first, last in spans(run)
        ],
        "frames": len(seen.t),
        "rate_hz": rate_hz,
        "blocks": len(fitted.parts),
        "gap_s": gap_s,
        "hold_out_s": [list(map(float, pair)) for pair in hold_out],
        "static": static,
        **kept_places(together),
    }
    return _learned(seen, fitted, made_from, [line for _, lines in cleared for line in lines])


def _learned(
    seen: ReferenceFrames, fitted: Fitted, made_from: Document, lost: Sequence[str]
) -> LearnedRod:
    """Assemble the fit, its errors and warnings."""
    residuals, memory = fitted.residuals, fitted.memory
    tested = residuals[np.isfinite(residuals).all(axis=(1, 2))]
    per_fold = [rms(residuals[test]) for _, test in fitted.parts]
    per_marker = [rms(tested[:, k]) for k in range(tested.shape[1])]
    notes = (*lost, *_notes(seen, fitted, rms(tested), float(made_from["gap_s"])), *memory.notes)
    more: Document = {
        "per_fold_mm": [round(error, 4) for error in per_fold],
        "per_marker_mm": [round(error, 4) for error in per_marker],
        "compliance": NOMINAL,
        "learned_in": [one.to_dict() for one in memory.learned_in],
        "notes": list(notes),
    }
    if memory.noise_mm is not None:
        more["noise_mm"] = float(f"{memory.noise_mm:.3g}")
    if fitted.numbers:
        more["numbers"] = [number.to_dict() for number in fitted.numbers]
    return LearnedRod(
        rod=fitted.rod,
        input=seen.source,
        chain_names=memory.names,
        chain_params=dict(memory.params),
        error_mm=rms(tested),
        per_fold_mm=np.array(per_fold),
        per_marker_mm=np.array(per_marker),
        form_error=np.sqrt((tested**2).mean(axis=0)),
        residuals=residuals,
        frames=seen.frames,
        coverage=Coverage.of(memory.acting(seen.drive), fitted.basis),
        made_from={**made_from, **fitted.made_from, **more},
        numbers=fitted.numbers,
        learned_in=memory.learned_in,
        notes=notes,
    )


def _notes(seen: ReferenceFrames, fitted: Fitted, error: float, gap_s: float) -> tuple[str, ...]:
    """Return the warnings about a rod."""
    notes, unit = [], seen.unit
    commands, stray = seen.drive.commands, seen.stray
    for c in np.flatnonzero(np.ptp(commands, axis=0) == 0):
        notes.append(
            f"command {c + 1} stays at {commands[0, c]:g} {unit}: the rod does not know what it "
            "does"
        )
    notes += [*_dependent(commands, unit), *_turned(seen.runs), *_from_home(commands, seen.runs[0])]
    notes += [*_apart(commands), *_flat(seen.runs), *_short(seen, fitted, gap_s)]
    if error > USELESS * stray:
        notes.append(
            f"the held-out error of {error:.2f} mm RMS is hardly below the {stray:.2f} mm RMS of "
            "a constant mean pose: the commands do not explain these markers, or the run is too "
            "short"
        )
    elif error > POOR * stray:
        notes.append(
            f"the held-out error of {error:.2f} mm RMS is a large part of the {stray:.2f} mm RMS "
            "of a constant mean pose: the mapping may miss a command or have a wrong rate, or "
            "the run is short"
        )
    vague = [number.label for number in fitted.numbers if number.note]
    if vague:
        notes.append(
            f"this run does not identify {', '.join(vague)}; make them known in robot.toml, or "
            "record other moves"
        )
    stuck = [
        number.label for number in fitted.numbers if number.at_bound and number.label != "slack"
    ]
    if stuck:
        notes.append(
            f"{', '.join(stuck)} went as far as the fit may go; start from better numbers in "
            "robot.toml"
        )
    return tuple(notes)


def _turned(runs: Sequence[Run]) -> list[str]:
    """Return a sentence if the robot had several orientations, which its model ignores."""
    every = [np.reshape(run.gravity, (-1, 3)) for run in runs if run.gravity is not None]
    if not every:
        return []
    rows = np.concatenate(every)
    units = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9)
    angle = float(np.degrees(np.arccos(np.clip(np.min(units @ units[0]), -1.0, 1.0))))
    if angle < TURNED_DEG:
        return []
    return [
        f"the runs were recorded in orientations {angle:.0f} degrees apart, and a learned model "
        "has one shape for each command: its weight may look like memory; learn from one "
        "orientation, or describe the robot in finger.toml"
    ]


def _apart(commands: Floats) -> list[str]:
    """Return a sentence if channels were moved one at a time.

    The rod then cannot learn their joint effect.
    """
    if _dependent(commands, ""):
        return []  # reported separately
    pairs = apart(commands)
    if not pairs:
        return []
    return [
        f"commands {pairs_text([(i + 1, j + 1) for i, j in pairs])} are never far from home at "
        "once: what they do together is extrapolated (by leverage), and `softmap compare` "
        "reports such frames; record them together too"
    ]


def _flat(runs: Sequence[Run]) -> list[str]:
    """Return a sentence if the markers of all runs have no third coordinate."""
    planes = [plane_of(run) for run in runs]
    return [f"{planes[0]}; no effect across it can be identified"] if planes and all(planes) else []


def _short(seen: ReferenceFrames, fitted: Fitted, asked: float) -> list[str]:
    """Return a sentence if blocks are shorter than the gap next to them.

    The gap was shortened or omitted.
    """
    counts = [len(train) for train, _ in fitted.parts]
    if seen.timeless or not counts:
        return []
    gap = float(fitted.made_from.get("gap_s", asked))
    if gap >= asked and min(counts) >= len(seen.t) // 4:
        return []
    block = seen.seconds / max(len(counts), 1)
    left = (
        f"the gap is {gap:.2g} s"
        if gap < asked
        else f"{min(counts)} of {len(seen.t)} frames are left to learn from"
    )
    return [
        f"blocks of {block:.2g} s are short for the gap of {asked:g} s that separates held-out "
        f"frames from the others: {left}, and the held-out error is less certain; record for "
        "longer, or in longer blocks"
    ]


def _rest(reach: Floats) -> Floats:
    """Return the command (C,) at rest: 0, or the middle of a range (C, 2) far from 0."""
    return np.where(far_from_home(reach), reach.mean(axis=1), 0.0)


def _from_home(commands: Floats, run: Run) -> list[str]:
    """Return a sentence if commands do not count from home, or from an assumed home."""
    unit, assumed = run.command_unit, run.extra.get(HOME_TICKS)
    if assumed is not None and assumed.any():
        ticks = ", ".join(f"{h:.0f}" for h in assumed)
        return [
            f"commands count ticks from home, which is taken to be {ticks}, the middle of their "
            "ranges; where the robot rests at other ticks, subtract those in the mapping "
            "(`offset`)"
        ]
    reach = np.stack([commands.min(axis=0), commands.max(axis=0)], axis=1)
    home = _rest(reach)
    far = np.flatnonzero(home)
    if not len(far):
        return []
    c = int(far[0])
    span = f"command {c + 1} goes from {reach[c, 0]:.6g} to {reach[c, 1]:.6g} {unit}"
    return [
        f"{span}, far from 0: effects such as gain, play and slack count from 0, which is home; "
        f"subtract home in the mapping (`offset`); the middle of its range ({home[c]:.6g} {unit}) "
        "is taken as the pose at rest"
    ]


def _dependent(commands: Floats, unit: str) -> list[str]:
    """Return a sentence for each constant sum of commands, and its consequence."""
    half = 0.5 * np.ptp(commands, axis=0)
    moving = np.flatnonzero(half > 0)
    centred = (commands - commands.mean(axis=0))[:, moving] / half[moving]
    values, directions = np.linalg.eigh(centred.T @ centred)
    still = np.sqrt(np.maximum(values, 0.0)) < DEPENDENT * np.sqrt(values[-1])
    if not still.any():
        return []
    sums = []
    for weights in _reduced(directions[:, still].T) / half[moving]:
        weights = weights / weights[np.argmax(np.abs(weights))]
        used = np.flatnonzero(np.abs(weights) > ROUNDED)
        level = float((commands[:, moving[used]] @ weights[used]).mean())
        level = 0.0 if abs(level) < ROUNDED * float(half[moving[used]].max()) else level
        terms = " ".join(_term(float(w), int(moving[c]) + 1) for c, w in zip(used, weights[used]))
        sums.append(f"{terms.removeprefix('+ ')} stays at {level:.3g} {unit}")
    return [
        f"the commands move in {len(moving) - int(still.sum())} of {len(moving)} directions "
        f"({'; '.join(sums)}): effects of one of these commands alone cannot be learned; move "
        "each alone, or keep to such moves"
    ]


def _term(weight: float, number: int) -> str:
    size = "" if abs(abs(weight) - 1.0) < ROUNDED else f"{abs(weight):.2g}·"
    return f"{'+' if weight > 0 else '-'} {size}u{number}"


def _reduced(rows: Floats) -> Floats:
    """Return a basis of the same space, made sparse by elimination."""
    rows = rows.copy()
    for i in range(len(rows)):
        pivot = int(np.argmax(np.abs(rows[i])))
        rows[i] /= rows[i, pivot]
        others = np.arange(len(rows)) != i
        rows[others] -= np.outer(rows[others, pivot], rows[i])
    return rows


def learn_model(
    runs: Run | Sequence[Run],
    input: Source | None = None,
    hold_out: Sequence[tuple[float, float]] = (),
    robot: Robot | None = None,
    **options: Unpack[LearnOptions],
) -> Model:
    """Learn a rod and return it as a model; the arguments are those of `learn`."""
    learned = learn(runs, input, hold_out=hold_out, robot=robot, **options)
    return learned_model(runs, learned)


def learned_model(runs: Run | Sequence[Run], learned: LearnedRod) -> Model:
    """Return the model of a rod that was learned from `runs`."""
    together, counted = from_home([runs] if isinstance(runs, Run) else runs)
    run, markers = together[0], len(learned.per_marker_mm)
    rod = learned.rod.compiled()
    commands = np.concatenate([one.commands(learned.input) for one in together])
    reach = np.stack([commands.min(axis=0), commands.max(axis=0)], axis=1)
    home = rod.evaluate(_rest(reach)[None]).reshape(-1, 3)
    model = Model(
        structure=Structure(
            prior=rod,
            fields=learned.rod.fields(),
            rest=np.asarray(home if run.marker_rest is None else run.marker_rest, float),
            triangles=np.zeros((0, 3), np.int32),
            tip_indices=np.array([markers - 1]),
            gravity_reference=_gravity(run),
            command_range=reach,
            stiffness_known=False,
        ),
        kind="rod",
        form_error=learned.form_error,
        vertex_error_mm=learned.error_mm,
        robot=run.robot or str(learned.made_from.get("robot", "robot")),
        command_unit=run.command_unit,
        calibration=counted,
        input=learned.input,
        output=run.output,
        made_from=learned.made_from,
        arrays=BundleArrays(PriorArrays(learned.rod, coverage=learned.coverage)),
    )
    return replace(
        model.with_effects(learned.chain_names, learned.chain_params), safety=derived(model)
    )


def _gravity(run: Run) -> Floats:
    if run.gravity is None:
        return np.array([0.0, 0.0, 1.0])  # hanging, like the built-in finger
    return np.asarray(run.gravity if run.gravity.ndim == 1 else run.gravity.mean(axis=0), float)
