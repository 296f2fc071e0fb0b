"""The official Bouc–Wen benchmark: displacement in, restoring force out.

    r = u − m ÿ,  m = 2 kg;   r = k y + c ẏ + z,   ż = α ẏ − β (γ |ẏ| |z|^(ν−1) z + δ ẏ |z|^ν)

ÿ comes from the FFT of the mean of the four estimation periods, without lines above `BAND_HZ` (they
hold noise). The validation sets are not fitted: r is derived from their own displacement, for the
sweep without `EDGE_S` at its ends. The structure oscillates at tens of Hz, and our effects have the
time scale of a finger, so 1 s of the log counts as `SLOWED` s. Displacements are in mm, forces in
N.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.optimize import least_squares

from benches.outside.case import Case, Floats, along_x, text
from softmap_edge import Model, Run, learn_model

RATE_HZ, MASS, PERIOD = 750.0, 2.0, 8192
BAND_HZ, EDGE_S = 250.0, 1.0
FINER = 4  # command rows per sample: 750 Hz give five samples of the fastest cycle
SLOWED = 40.0
FRAMES = 2048  # samples of a run that are used


def case(folder: Path) -> Case:
    """Return the case of the official files."""
    force, displacement = (
        _signal(folder / f"{name}est_multisine.mat").reshape(-1, PERIOD) for name in "uy"
    )
    fit = _run(force[-1], displacement.mean(axis=0), periodic=True)
    held = {
        name: _run(
            *(_signal(folder / f"{x}val_{name}.mat") for x in "uy"), periodic=name == "multisine"
        )
        for name in ("multisine", "sinesweep")
    }

    def model() -> Model:
        return learn_model(fit)

    return Case(
        name="Bouc–Wen",
        about=text("bouc_wen"),
        values=along_x,
        fit=fit,
        held=held,
        model=model,
        law=lambda: fitted_law(fit, held),
        law_name="Bouc–Wen, 6 numbers",
        unit="NRMSE",
        expected="memory, its law unknown or open",
        per_library_law=True,
    )


def _signal(file: Path) -> Floats:
    """Return the only signal of a file."""
    (name,) = (key for key in loadmat(file) if not key.startswith("__"))
    return np.asarray(loadmat(file)[name], float).ravel()


def _run(force: Floats, displacement: Floats, periodic: bool) -> Run:
    """Return displacement and restoring force as a run; periodic ones after one period.

    The omitted period is complete.
    """
    count = len(displacement)
    acceleration, fine = _derivative(displacement, periodic), _finer(displacement, periodic)
    restoring = force - MASS * acceleration
    start = count if periodic else 0
    step = SLOWED / RATE_HZ
    t = np.arange(len(fine) + start * FINER) * step / FINER
    command = np.concatenate([fine, fine]) if periodic else fine
    edge = 0 if periodic else int(EDGE_S * RATE_HZ)
    frames = np.unique(np.linspace(edge, count - 1 - edge, FRAMES).astype(int))
    return Run.of_outputs(
        restoring[frames, None],
        "N",
        ["restoring force"],
        t=t,
        t_seen=(frames + start) * step,
        command=1e3 * command[:, None],
        robot="bouc-wen",
    )


def _mirrored(x: Floats) -> Floats:
    """Return a signal and its odd mirror about its ends, so that neither it nor its slope jumps."""
    line = np.linspace(x[0], x[-1], len(x))
    return np.concatenate([x - line, -(x - line)[-2:0:-1]])


def _derivative(x: Floats, periodic: bool) -> Floats:
    """Return the second derivative of a signal, from its lines up to `BAND_HZ`."""
    wave = x if periodic else _mirrored(x)
    hertz = np.fft.rfftfreq(len(wave), 1.0 / RATE_HZ)
    lines = np.where(hertz <= BAND_HZ, -((2 * np.pi * hertz) ** 2), 0.0) * np.fft.rfft(wave)
    return np.fft.irfft(lines, len(wave))[: len(x)]


def _finer(x: Floats, periodic: bool) -> Floats:
    """Return a signal at `FINER` times its rate, exact for periodic band-limited signals."""
    wave = x if periodic else _mirrored(x)
    lines = np.fft.rfft(wave)
    lines[np.fft.rfftfreq(len(wave), 1.0 / RATE_HZ) > BAND_HZ] = 0.0
    fine = np.fft.irfft(
        np.concatenate([lines, np.zeros(len(wave) * FINER // 2 + 1 - len(lines))]),
        len(wave) * FINER,
    )
    fine *= FINER
    return fine[: len(x) * FINER] + (
        0.0
        if periodic
        else np.interp(
            np.arange(len(x) * FINER) / FINER, np.arange(len(x)), np.linspace(x[0], x[-1], len(x))
        )
    )


# --- the law itself --------------------------------------------------------------------------
def fitted_law(fit: Run, held: Mapping[str, Run]) -> dict[str, Floats]:
    """Return the prediction of the benchmark's law, fitted to the estimation run.

    Its six numbers are fitted by least squares.

    γ, δ, ν are searched; k, c, α are solved for at each step.
    """

    def columns(run: Run, x: Floats) -> Floats:
        y, rate = run.commands()[:, 0], np.gradient(run.commands()[:, 0], run.t)
        rows = np.stack([y, rate, hysteresis(y, *x)], axis=1)
        at = np.clip(np.searchsorted(run.t, run.t_seen + 1e-9) - 1, 0, None)
        return rows[at]

    def off(x: Floats) -> Floats:
        a, seen = columns(fit, x), fit.outputs[:, 0]
        return np.asarray(a @ np.linalg.lstsq(a, seen, rcond=None)[0] - seen)

    best = least_squares(
        off,
        [1.0, -1.0, 1.0],
        bounds=([0.01, -5.0, 0.6], [10.0, 5.0, 1.6]),
        diff_step=1e-3,
        max_nfev=20,
    )
    weights = np.linalg.lstsq(columns(fit, best.x), fit.outputs[:, 0], rcond=None)[0]
    return {name: (columns(run, best.x) @ weights)[:, None] for name, run in held.items()}


def hysteresis(y: Floats, gamma: float, delta: float, power: float) -> Floats:
    """Return ζ (T,) along y (T,) mm: dζ = dy − γ|dy

    ζ|^(ν−1)ζ − δ dy|ζ|^ν.

    By the explicit midpoint rule; y is a displacement.
    """
    found, zeta = np.empty(len(y)), 0.0
    for k, step in enumerate(np.diff(y, prepend=y[0]).tolist()):
        slope = _slope(zeta, step, gamma, delta, power)
        zeta += _slope(zeta + 0.5 * slope, step, gamma, delta, power)
        found[k] = zeta
    return found


def _slope(zeta: float, step: float, gamma: float, delta: float, power: float) -> float:
    size = abs(zeta) ** power
    return step - gamma * abs(step) * (size if zeta > 0 else -size) - delta * step * size
