"""Fit a rod to a reference run: the prior of a robot that has no simulator. Seconds; numpy and the core only.

The rod (rust/rod/) turns commands into bending angles of K chords by a polynomial, then into markers. Its weights are
found by ridge regression, and with them the delay and lag of the drive, which stay effects of the chain.

    v (rad) ≈ polynomial(q),   length (mm) ≈ quadratic(v),   q = (u_eff − centre)/scale

Penalty: n · ridge · RIDGE[degree of the monomial] on all weights but the intercept, n frames. Degree, ridge, delay and
lag are those with the lowest blocked cross-validation error: contiguous blocks in time, and frames closer than `gap_s`
to a block are not used to predict it. These few choices are made on the blocks that give the stated error, so it is
slightly low; frames in `hold_out` are never looked at.
Known limit: memory other than delay and lag is not fitted; one marker at the end of each chord, base to tip.
tests/test_rod.py pins exact recovery and the error on real data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softmap_edge import __version__, _core
from softmap_edge.errors import RunError, SoftmapError
from softmap_edge.rod_fit import Drive, Regression, choose_degree, fit_drive, folds, normalise, refine_drive, rms

if TYPE_CHECKING:
    from softmap_edge.model import Model
    from softmap_edge.run import Run, Source

Floats = NDArray[np.float64]
Arrays = dict[str, NDArray[np.generic]]

DEGREES = (1, 2, 3)
RATE_HZ = 20.0  # neighbouring frames say the same; more only cost time
LOCK = 1.0  # the servos hold, so a load bends each chord into an S and leaves its ends' directions alone
TIP_PER_NEWTON = 0.1  # nominal: 1 N across the tip moves it by a tenth of the length; the stiffness itself is not seen


@dataclass(frozen=True, eq=False)
class RodParameters:
    """The numbers of a rod.

    `base` (3,) mm, `centre` and `scale` (C,) in command units, `degree`, `angles` (1 + F, 2K) rad, `lengths` (1 + G, K)
    mm, the nominal `compliance` of its load fields in N⁻¹·mm⁻² and their `lock`: how far the tendons hold each chord's
    mean bending against a load, 0 (not at all) to 1 (motors that hold, tendons that do not stretch).
    """

    base: Floats
    centre: Floats
    scale: Floats
    degree: int
    angles: Floats
    lengths: Floats
    compliance: float
    lock: float = LOCK

    def compiled(self) -> _core.Rod:
        """Return the compiled rod: commands (n, C) to markers (n, 3K) mm."""
        return _core.Rod(self.base, self.centre, self.scale, self.degree, self.angles, self.lengths)

    def fields(self) -> dict[str, _core.RodField]:
        """Return its load fields by name: mm per N of tip force, mm per g for a nominal weight of 1 N."""
        rod = self.compiled()
        return {name: _core.RodField(rod, name, self.compliance, self.lock) for name in _core.FIELDS}

    def to_arrays(self) -> Arrays:
        """Return the arrays of `prior.npz`."""
        arrays: Arrays = {name: getattr(self, name) for name in ("base", "centre", "scale", "angles", "lengths")}
        single = {"degree": self.degree, "compliance": self.compliance, "lock": self.lock}
        return arrays | {name: np.array([value]) for name, value in single.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]]) -> RodParameters:
        """Read the arrays of `prior.npz`.

        Raises:
            SoftmapError: an array is missing or has the wrong number of axes.
        """
        axes = {"base": 1, "centre": 1, "scale": 1, "angles": 2, "lengths": 2, "degree": 1, "compliance": 1, "lock": 1}
        values: dict[str, Floats] = {}
        for name, ndim in axes.items():
            if name not in arrays or np.ndim(arrays[name]) != ndim:
                got = f"of {np.ndim(arrays[name])} axes" if name in arrays else "missing"
                raise SoftmapError(f"rod: array '{name}' is {got}, expected {ndim} axes; learn the bundle again")
            values[name] = np.ascontiguousarray(arrays[name], float)
        single = {name: values.pop(name).tolist() for name in ("degree", "compliance", "lock")}
        for name, value in single.items():
            if len(value) != 1:
                raise SoftmapError(f"rod: '{name}' holds {len(value)} numbers, expected one; learn the bundle again")
        (degree,), (compliance,), (lock,) = single.values()
        if degree not in (1, 2, 3, 4):
            raise SoftmapError(f"rod: degree {degree}, expected 1 to 4; learn the bundle again")
        return cls(degree=int(degree), compliance=compliance, lock=lock, **values)


@dataclass(frozen=True, eq=False)
class LearnedRod:
    """A rod fitted to a run, and how well it predicts what it has not seen.

    `chain_names` and `chain_params` (by label, s) are the delay and lag of the drive that belong in the bundle's chain.
    `error_mm` is the blocked cross-validation RMS over all markers, `per_fold_mm` (blocks,), `per_marker_mm` (K,);
    `form_error` (K, 3) mm is its RMS by marker and axis; `residuals` (n, K, 3) mm (predicted − seen) at `frames` (n,).
    """

    rod: RodParameters
    input: Source
    chain_names: tuple[str, ...]
    chain_params: Mapping[str, float]
    error_mm: float
    per_fold_mm: Floats
    per_marker_mm: Floats
    form_error: Floats
    residuals: Floats
    frames: NDArray[np.intp]
    made_from: Mapping[str, Any]

    def to_arrays(self) -> Arrays:
        """Return the arrays of `prior.npz` (delay and lag live in `effects.json`)."""
        return self.rod.to_arrays()

    def __str__(self) -> str:
        """Say in a few lines what was fitted and how far it is off."""
        drive = ", ".join(f"{label} {value:.3f} s" for label, value in self.chain_params.items()) or "no delay, no lag"
        markers = ", ".join(f"{value:.2f}" for value in self.per_marker_mm)
        blocks = ", ".join(f"{value:.2f}" for value in self.per_fold_mm)
        return (
            f"rod of {len(self.per_marker_mm)} chords, degree {self.rod.degree}, on the {self.input} command; {drive}\n"
            f"blocked cross-validation {self.error_mm:.2f} mm RMS (markers {markers}; blocks {blocks})"
        )


def learn(
    run: Run,
    input: Source | None = None,
    blocks: int = 5,
    gap_s: float = 2.0,
    hold_out: Sequence[tuple[float, float]] = (),
    *,
    base: ArrayLike | None = None,
    degree: int | None = None,
    rate_hz: float = RATE_HZ,
) -> LearnedRod:
    """Fit a rod, its degree and the delay and lag of the drive to a reference run with markers.

    Args:
        run: commands (T, C) and markers (K, M, 3) mm, base to tip, in the base frame (z along the rest axis).
        input: "goal" or "present"; None takes the present positions where the run has them.
        blocks: contiguous blocks of the cross-validation.
        gap_s: s, frames this close to a block are not used to predict it.
        hold_out: intervals (t0, t1) s whose frames are not used at all.
        base: (3,) mm, the point from which the first chord starts; None is the origin of the base frame. It is not
            fitted: markers do not tell it (on the trunk any depth from 0 to 94 mm predicts equally well within 0.1 mm).
        degree: of the polynomial; None chooses among 1, 2, 3.
        rate_hz: at most so many frames a second are used.

    Raises:
        RunError: the run has no markers or no commands, or too few frames.
    """
    source: Source = input or ("goal" if run.present is None else "present")
    commands, t = np.ascontiguousarray(run.commands(source)), np.ascontiguousarray(run.t)
    if run.markers is None or commands.shape[1] == 0 or len(t) < 2:
        raise RunError("a rod is learned from markers and at least two rows of commands; this run lacks one of them")
    frames = _usable(run, hold_out, rate_hz)
    degrees: tuple[int, ...] = DEGREES if degree is None else (degree,)
    parts = folds(run.t_seen[frames], blocks, gap_s)
    smallest = min(len(train) for _, train in parts)
    degrees = tuple(d for d in degrees if 2 * len(_core.monomial_degrees(commands.shape[1], d)) < smallest)
    if not degrees:
        raise RunError(
            f"{len(frames)} usable frames leave {smallest} to learn from beside a block, too few for a polynomial of "
            f"{commands.shape[1]} commands; record longer, use fewer blocks or a smaller gap_s"
        )
    drive = Drive(commands, t, run.t_seen[frames])
    markers = np.asarray(run.markers[frames], float)
    fit = Regression(markers, _base(base), parts)
    delay, lag = fit_drive(fit, drive, degrees[-1])
    u = drive.at([(delay, lag)])[0]
    chosen, ridge = choose_degree(fit, u, degrees)
    delay, lag = refine_drive(fit, drive, chosen, ridge, delay, lag)
    u = drive.at([(delay, lag)])[0]
    residuals = fit.cross_validate(normalise(u), chosen, ridge)
    weights = fit.weights(u, chosen, ridge)
    rod = RodParameters(
        fit.base, weights.centre, weights.scale, chosen, weights.angles, weights.lengths, _nominal(fit.lengths)
    )
    params = {"latency.delay": delay, "lag.tau": lag}
    made_from = {
        "softmap-edge": __version__, "run": run.hash(), "frames": len(frames), "rate_hz": rate_hz, "degree": chosen,
        "ridge": ridge, "blocks": blocks, "gap_s": gap_s, "hold_out_s": [list(map(float, pair)) for pair in hold_out],
        "per_fold_mm": [round(rms(residuals[test]), 4) for test, _ in parts],
        "per_marker_mm": [round(rms(residuals[:, k]), 4) for k in range(residuals.shape[1])],
        "compliance": "nominal: 1 N across the tip moves it by a tenth of the length; no load is known in grams",
    }  # fmt: skip
    return LearnedRod(
        rod=rod,
        input=source,
        chain_names=tuple(label.split(".")[0] for label, value in params.items() if value > 0),
        chain_params={label: value for label, value in params.items() if value > 0},
        error_mm=rms(residuals),
        per_fold_mm=np.array([rms(residuals[test]) for test, _ in parts]),
        per_marker_mm=np.array([rms(residuals[:, k]) for k in range(residuals.shape[1])]),
        form_error=np.sqrt((residuals**2).mean(axis=0)),
        residuals=residuals,
        frames=frames,
        made_from=made_from,
    )


def learn_model(
    run: Run, input: Source | None = None, hold_out: Sequence[tuple[float, float]] = (), **options: Any
) -> Model:
    """Learn a rod and return it as a model; arguments as for `learn`."""
    from softmap_edge.model import Model

    learned = learn(run, input, hold_out=hold_out, **options)
    rod, markers = learned.rod.compiled(), len(learned.per_marker_mm)
    commands = run.commands(learned.input)
    home = rod.evaluate(np.zeros((1, commands.shape[1]))).reshape(-1, 3)
    model = Model(
        kind="rod",
        prior=rod,
        fields=learned.rod.fields(),
        rest=np.asarray(home if run.marker_rest is None else run.marker_rest, float),
        triangles=np.zeros((0, 3), np.int32),
        form_error=learned.form_error,
        vertex_error_mm=learned.error_mm,
        tip_indices=np.array([markers - 1]),
        gravity_reference=_gravity(run),
        command_range=np.stack([commands.min(axis=0), commands.max(axis=0)], axis=1),
        robot=run.robot or "robot",
        command_unit=run.command_unit,
        input=learned.input,
        made_from=learned.made_from,
        arrays={"prior": learned.to_arrays(), "fields": {}},
    )
    return model.with_effects(learned.chain_names, learned.chain_params)


def rod_from_arrays(arrays: Mapping[str, NDArray[np.generic]]) -> tuple[_core.Rod, dict[str, _core.RodField]]:
    """Return the compiled rod and its load fields from the arrays of `prior.npz`."""
    parameters = RodParameters.from_arrays(arrays)
    return parameters.compiled(), parameters.fields()


# --- which frames -----------------------------------------------------------------------------


def _usable(run: Run, hold_out: Sequence[tuple[float, float]], rate_hz: float) -> NDArray[np.intp]:
    assert run.markers is not None
    keep = np.all(np.isfinite(run.markers), axis=(1, 2))
    if run.visible is not None:
        keep &= np.all(run.visible, axis=1)
    for low, high in hold_out:
        keep &= (run.t_seen < low) | (run.t_seen >= high)
    slot = np.floor((run.t_seen - run.t_seen[:1]) * rate_hz + 1e-6)
    index = np.flatnonzero(keep)
    if len(index):
        index = index[np.concatenate([[True], np.diff(slot[index]) > 0])]
    return index


def _base(base: ArrayLike | None) -> Floats:
    point = np.zeros(3) if base is None else np.array(base, float)
    if point.shape != (3,) or not np.all(np.isfinite(point)):
        raise SoftmapError(f"base of shape {point.shape}: expected three finite numbers in mm")
    return point


def _nominal(lengths: Floats) -> float:
    """Return the nominal compliance c (N⁻¹·mm⁻²): 1 N across straight locked chords moves the tip by c·Σ l_k³/12."""
    mean = lengths.mean(axis=0)
    return float(12.0 * TIP_PER_NEWTON * mean.sum() / (mean**3).sum())


def _gravity(run: Run) -> Floats:
    if run.gravity is None:
        return np.array([0.0, 0.0, 1.0])  # hanging, as the built-in finger
    return np.asarray(run.gravity if run.gravity.ndim == 1 else run.gravity.mean(axis=0), float)
