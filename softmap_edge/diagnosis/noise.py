"""How far measurement and model may differ for no reason: camera noise, and the model's own error as a nuisance.

    C = Σ ⊗ I + G ⊗ K(u, u)          features × frames
    Σ  noise covariance of a frame's features, from replicates (frames of one dwell), else from the high-frequency part
    G  form error of the model: its own held-out error per feature, correlated along the body
    K  squared-exponential kernel over the command, rank <= 64 (Nyström on farthest-point inducing commands), times
       1 + a·a' of two frames: a is the error that grows with the lean of the base, another one in another orientation

Diagonalised: with Σ = L Lᵀ and spatial modes V (the span of the signatures), mode m has form variance s_m in units of
noise, and C^(-1/2) = I + Q (diag(1/sqrt(1 + λ s_m)) - 1) Qᵀ over frames, K = Q diag(λ) Qᵀ. All is linear in the frames.
Correlation in time is not filtered out; it inflates: n white numbers become n / inflation (AR(1): (1+ρ)/(1-ρ)).
Units: mm, s. Known limits: modes share one kernel length (0.4 of the command range); replicates of one dwell do not see
what drifts more slowly than a dwell. A rod's error is not smooth in six commands, so it counts as noise correlated
in time (`rod_noise`). Pinned by tests/test_noise.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

RANK = 64  # largest rank of the kernel over commands
KERNEL_LENGTH = 0.4  # of the command range: form error of a sweep varies over about half a range
BODY_LENGTH = 0.35  # of the body: how far form error is correlated along it
ENOUGH = 15  # degrees of freedom below which replicates are not trusted
MODES = 24  # largest number of spatial modes kept
FLOOR = 1e-3  # mm: no camera is better than this
LEAST_DWELL, LONG_DWELL = 3, 6  # frames of a dwell that tell of noise beside a drift, and beside one that bends


@dataclass(frozen=True)
class Noise:
    """Noise of one frame's features: covariance (F, F) mm², its source, and the inflation by correlation in time."""

    covariance: Floats
    source: str
    inflation: float
    replicates: bool = False  # whether dwells told it

    def rms_mm(self, positions: Mask) -> float:
        """Return the RMS distance in mm that noise alone gives the places among V features."""
        variance = np.diag(self.covariance).reshape(-1, 3)[positions]
        return float(np.sqrt(variance.sum(axis=1).mean()))


def estimate_noise(residual: Floats, t_seen: Floats, visit: NDArray[np.int64]) -> Noise:
    """Estimate the noise of the features from frames that were taken while nothing moved.

    Args:
        residual: measured minus predicted features (K, F) mm; NaN where nothing was seen.
        t_seen: times (K,) s.
        visit: which uninterrupted dwell each frame belongs to (K,), -1 while moving.

    Returns:
        Noise: from replicates where they give at least 15 degrees of freedom, else from second differences in time.
    """
    blocks = [np.flatnonzero(visit == v) for v in np.unique(visit) if v >= 0]
    scatter, degrees, lag = np.zeros((residual.shape[1],) * 2), 0, [0.0, 0.0]
    shown = np.maximum(np.isfinite(residual[visit >= 0]).mean(axis=0), 1e-3) if np.any(visit >= 0) else np.ones(0)
    for frames in blocks:
        if len(frames) < LEAST_DWELL:
            continue
        rest, order = undrifted(_filled(residual[frames]))
        rest[~np.isfinite(residual[frames])] = 0.0
        scatter += rest.T @ rest
        degrees += len(frames) - order
        lag[0] += float(np.sum(rest[1:] * rest[:-1])) + float(np.sum(rest**2)) * order / len(frames)
        lag[1] += float(np.sum(rest**2))
    if degrees >= ENOUGH:
        rho = float(np.clip(lag[0] / max(lag[1], 1e-300), 0.0, 0.95))
        inflation = (1 + rho) / (1 - rho) if rho > 0.15 else 1.0
        scatter = scatter / np.sqrt(np.outer(shown, shown))
        return Noise(_shrunk(scatter / degrees, degrees), f"replicates ({degrees} degrees of freedom)", inflation, True)
    return Noise(_high_frequency(_filled(residual), t_seen), "high-frequency part of the run (no replicates)", 1.0)


def undrifted(dwell: Floats) -> tuple[Floats, int]:
    """Return what a dwell (K, F) scatters about a quadratic in time, a line where it is short, and what that fits.

    Creep within a dwell is not noise.
    """
    tau, order = np.linspace(-1.0, 1.0, len(dwell)), 3 if len(dwell) >= LONG_DWELL else 2
    basis, _ = np.linalg.qr(np.vander(tau, order))
    return np.asarray(dwell - basis @ (basis.T @ dwell)), order


def _filled(residual: Floats) -> Floats:
    """Return residuals (K, F) with what was not seen between what was seen before and after: no jump.

    A marker that is hidden now and then would else be as noisy as the model is wrong there.
    """
    out, frames = np.zeros_like(residual), np.arange(len(residual))
    for column, filled in zip(residual.T, out.T):
        seen = np.isfinite(column)
        filled[:] = np.interp(frames, frames[seen], column[seen]) if seen.any() else 0.0
    return out


def rod_noise(residual: Floats, t_seen: Floats, form_error: Floats) -> Noise:
    """Return the noise of a model whose own error (V, 3) mm is much larger than the camera's and correlated in time.

    The correlation time comes from the residual (K, F) itself: 1/e of its autocorrelation, linear interpolation.
    """
    clean = np.where(np.isfinite(residual), residual, 0.0)
    clean = clean - clean.mean(axis=0)
    period = float(np.median(np.diff(t_seen))) if len(t_seen) > 1 else 1.0
    power = float(np.mean(clean**2))
    tau = period
    for shift in range(1, len(clean) // 4):
        rho = float(np.mean(clean[shift:] * clean[:-shift])) / max(power, 1e-300)
        if rho < np.exp(-1.0):
            break
        tau = (shift + 1) * period
    covariance = np.diag(np.maximum(form_error.ravel(), FLOOR) ** 2)
    inflation = max(1.0, 2.0 * tau / period)
    return Noise(covariance, f"the model's own held-out error, correlated over {tau:.2g} s", inflation)


def form_covariance(form_error: Floats, positions: Mask, section: NDArray[np.int64]) -> Floats:
    """Return the covariance (F, F) mm² of the model's own error over features, correlated along the body.

    `form_error` (V, 3) mm RMS per component, `positions` (V,), `section` (V,). Places and directions, and the three
    components, are independent; neighbours along the body are not.
    """
    place = section / max(1, int(section.max(initial=1)))
    count = np.cumsum(np.r_[1, np.diff(section) < 0])  # features come in groups that run along the body
    near = np.exp(-0.5 * ((place[:, None] - place[None, :]) / BODY_LENGTH) ** 2)
    near *= (count[:, None] == count[None, :]) & (positions[:, None] == positions[None, :])
    covariance = np.zeros((form_error.size, form_error.size))
    for c in range(3):
        rows = np.arange(len(section)) * 3 + c
        covariance[np.ix_(rows, rows)] = near * np.outer(form_error[:, c], form_error[:, c])
    return covariance


@dataclass(frozen=True)
class Kernel:
    """The kernel over the commands of some frames, as K = Q diag(λ) Qᵀ: `basis` Q (K, r), `strength` λ (r,)."""

    basis: Floats
    strength: Floats


def scaled_commands(command: Floats, unit: Floats) -> Floats:
    """Return commands (K, C) in multiples of `unit` (C,); a channel that is never moved tells nothing and is 0."""
    return np.asarray(command / np.where(unit > 1e-9, unit, np.inf))


def command_kernel(command: Floats, spread: Floats, leaning: Floats | None = None, rank: int = RANK) -> Kernel:
    """Return the squared-exponential kernel over commands (K, C), scaled by `spread` (C,), at rank <= `rank`.

    `leaning` (K, d): the kernel is multiplied by the products of its rows, so what grows with a lean is another error
    in another orientation; its rank is then up to d times as large.
    """
    if command.shape[0] == 0:
        return Kernel(np.zeros((0, 0)), np.zeros(0))
    x = scaled_commands(command, spread * KERNEL_LENGTH) if command.shape[1] else np.zeros((len(command), 1))
    centres = [int(np.argmax(np.sum((x - x.mean(axis=0)) ** 2, axis=1)))]
    far = np.sum((x - x[centres[0]]) ** 2, axis=1)
    while len(centres) < min(rank, len(x)) and far.max() > 1e-4:
        centres.append(int(np.argmax(far)))
        far = np.minimum(far, np.sum((x - x[centres[-1]]) ** 2, axis=1))
    z = x[centres]
    cross = np.exp(-0.5 * _distance2(x, z))
    inner = np.exp(-0.5 * _distance2(z, z))
    values, vectors = np.linalg.eigh(inner)
    keep = values > 1e-8 * values[-1]
    root = cross @ (vectors[:, keep] / np.sqrt(values[keep]))  # (K, r), root rootᵀ = Nyström kernel
    if leaning is not None:
        some = leaning[:, np.any(leaning != 0.0, axis=0)]
        root = (root[:, :, None] * some[:, None, :]).reshape(len(root), -1)
    basis, singular, _ = np.linalg.svd(root, full_matrices=False)
    strong = singular > 1e-4 * singular[0]
    return Kernel(np.ascontiguousarray(basis[:, strong]), singular[strong] ** 2)


@dataclass(frozen=True)
class Whitener:
    """Turns feature differences (..., K, F) into numbers (..., K, M) of unit variance, if noise and form are right.

    `project` (M, F) maps features to noise-white spatial modes, `form` (M,) is the form variance of each mode.
    """

    project: Floats
    form: Floats
    kernel: Kernel

    def modes(self, difference: Floats) -> Floats:
        """Return (..., K, M) modes in units of noise; what was not seen (NaN) counts as no difference."""
        return np.asarray(np.where(np.isfinite(difference), difference, 0.0) @ self.project.T)

    def shrink(self, modes: Floats, kernel: Kernel | None = None) -> Floats:
        """Return `modes` (..., K, M) with the form error's directions over the commands scaled down."""
        kernel = self.kernel if kernel is None else kernel
        if not len(kernel.strength) or not np.any(self.form > 0):
            return modes
        inside = kernel.basis.T @ modes  # (..., r, M)
        factor = 1.0 / np.sqrt(1.0 + kernel.strength[:, None] * self.form[None, :]) - 1.0
        return np.asarray(modes + kernel.basis @ (factor * inside))

    def squares(self, modes: Floats) -> Floats:
        """Return the sum of squares (...) of the shrunk `modes` (..., K, M), which are not needed for it.

        The kernel's basis is orthonormal: what lies along it is scaled, all else stays.
        """
        flat = modes.reshape(*modes.shape[:-2], -1)
        whole = np.einsum("...n,...n->...", flat, flat)
        if not len(self.kernel.strength) or not np.any(self.form > 0):
            return np.asarray(whole)
        inside = self.kernel.basis.T @ modes
        forgiven = 1.0 - 1.0 / (1.0 + self.kernel.strength[:, None] * self.form[None, :])
        return np.asarray(whole - np.einsum("...rm,...rm,rm->...", inside, inside, forgiven))


def whitener(noise: Noise, form: Floats, signatures: Floats, kernel: Kernel) -> Whitener:
    """Build the whitener on the span of the signatures.

    Args:
        noise: noise of one frame.
        form: covariance (F, F) mm² of the model's own error; zeros switch it off.
        signatures: feature differences (S, K, F) mm that candidates would make; their span is what is looked at.
        kernel: kernel over the commands of the frames.

    Returns:
        Whitener: with at most 24 modes.
    """
    features = noise.covariance.shape[0]
    if signatures.shape[-1] != features:
        raise SoftmapError(f"signatures have {signatures.shape[-1]} features, the noise has {features}")
    root = np.linalg.cholesky(noise.covariance)
    inverse = np.linalg.inv(root)
    gram = np.zeros((features, features))
    for signature in signatures:
        rows = np.where(np.isfinite(signature), signature, 0.0) @ inverse.T  # (K, F)
        power = float(np.vdot(rows, rows))
        if power > 0:
            gram += rows.T @ rows / power
    values, vectors = np.linalg.eigh(gram)
    order = np.argsort(-values)[: min(MODES, features)]
    total = max(float(values.sum()), 1e-300)
    keep = [int(i) for rank, i in enumerate(order) if rank < 3 or values[i] > 2e-4 * total]
    project = vectors[:, keep].T @ inverse
    return Whitener(project, np.einsum("mf,fg,mg->m", project, form, project), kernel)


def _distance2(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.maximum(np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1)[None, :] - 2 * a @ b.T, 0.0))


def _shrunk(covariance: Floats, degrees: int) -> Floats:
    """Shrink towards the diagonal: an estimate from few replicates has directions of no variance at all."""
    features = len(covariance)
    weight = float(np.clip(features / (features + degrees), 0.05, 1.0))
    diagonal = np.diag(covariance).copy()
    pooled = 0.5 * diagonal + 0.5 * float(np.median(diagonal))
    shrunk = (1 - weight) * covariance + weight * np.diag(pooled)
    return np.asarray(shrunk + FLOOR**2 * np.eye(features))


def _high_frequency(residual: Floats, t_seen: Floats) -> Floats:
    """Noise variance from second differences r[k-1] - 2 r[k] + r[k+1] (6 σ² for white noise), outliers clipped."""
    if len(residual) < 5:
        raise SoftmapError(
            f"{len(residual)} seen frames are too few to tell noise from physics; record at least 5, better 60"
        )
    step = np.diff(t_seen)
    regular = np.maximum(step[1:], step[:-1]) < 3 * np.median(step)
    second = (residual[:-2] - 2 * residual[1:-1] + residual[2:])[regular if regular.sum() >= 3 else slice(None)]
    spread = 1.4826 * np.median(np.abs(second), axis=0) + FLOOR
    clipped = np.clip(second, -3 * spread, 3 * spread)
    return _shrunk(clipped.T @ clipped / (6.0 * len(clipped)), len(clipped))
