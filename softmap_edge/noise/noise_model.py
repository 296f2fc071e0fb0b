"""The noise model: camera noise, and the model error as a nuisance.

    C = Σ ⊗ I + G ⊗ K(u, u)          features × frames
    Σ  noise covariance of a frame's features: from replicates (frames of one dwell), else from
       what no command can make of the body's shape, else from the high-frequency part of the run
    G  model-form error: the model's own held-out error of each feature, correlated along the body
    K  squared-exponential kernel over the command, rank <= 64 (Nyström on farthest-point inducing
       commands), times 1 + a·a' for two frames; a is the part of the error that grows with the lean
       of the base and differs between orientations

C is diagonalised. With Σ = L Lᵀ and spatial modes V (the span of the signatures), mode m has form
variance s_m in units of noise. Then C^(-1/2) = I + Q (diag(1/sqrt(1 + λ s_m)) - 1) Qᵀ over frames,
K = Q diag(λ) Qᵀ. The cost is linear in the number of frames.

Correlation in time is not filtered out; it is an inflation, by which n white numbers become n /
inflation (AR(1): (1+ρ)/(1-ρ)). Jitter of the frame lasts longer than a dwell (`jitter.py`), so its
six directions are inflated by 2τ times the frame rate, and the others are not. Motion of the body
while its commands are constant is not noise (`motion_at_rest.py`). The error of a rod is not smooth
in six commands, so its repeatable part counts as noise that is correlated in time (`rod_noise`).
Units: mm, s.

Limits: all modes share one kernel length (0.4 of the command range). Jitter is detected only if
poses are visited again. Pinned by tests/noise/test_noise.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import SoftmapError
from softmap_edge.noise.jitter import (
    COMMANDED,
    Along,
    commanded_modes,
    coordinates,
    frame_jitter,
    in_all,
    white_variance,
)
from softmap_edge.noise.memoryless import Repeats
from softmap_edge.noise.motion_at_rest import AtRest, MotionAtRest, motion_at_rest
from softmap_edge.noise.repeats import (
    LEAST_DWELL,
    Scatter,
    dwell_scatter,
    filled,
    rows_of,
    settled_dwells,
    undrifted,
)
from softmap_edge.noise.shape_manifold import shapes
from softmap_edge.run.conditions import Conditions

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

RANK = 64  # largest rank of the kernel over commands
KERNEL_LENGTH = 0.4  # of the command range: the error of a sweep varies over about half a range
BODY_LENGTH = 0.35  # of the body: how far model-form error is correlated along it
ENOUGH = 15  # degrees of freedom below which replicates are not trusted
MODES = 24  # largest number of spatial modes kept
FLOOR = 1e-3  # mm: no camera is better than this
GEOMETRY = 300  # frames over which a jitter's covariance is averaged


@dataclass(frozen=True)
class Noise:
    """Noise of the features of one frame.

    Attributes:
        covariance: (F, F) mm².
        source: how it was estimated, as a phrase.
        inflation: number of frames that count as one, because of correlation in time.
        measured: whether it is measured, by dwells or by what no command can make; else a guess.
        slow: the part of the covariance from a jitter of the frame, (F, F) mm²; None without
            jitter.
        memory_s: correlation time of that jitter, s.
        slow_inflation: number of frames that count as one in the directions of the jitter.
        moving: motion of the body while its commands are constant; it is not noise and not in the
            covariance.
    """

    covariance: Floats
    source: str
    inflation: float
    measured: bool = False  # by dwells, or by what no command can make: not a guess
    slow: Floats | None = None
    memory_s: float = 0.0
    slow_inflation: float = 1.0
    moving: tuple[MotionAtRest, ...] = ()

    @property
    def effective(self) -> Floats:
        """Covariance (F, F) mm² of frames that count as independent, apart from `inflation`."""
        if self.slow is None:
            return self.covariance
        return self.covariance + max(0.0, self.slow_inflation / self.inflation - 1.0) * self.slow

    @property
    def trace(self) -> float:
        """The variance in mm² of all features together."""
        return float(np.trace(self.covariance))

    def rms_mm(self, positions: Mask) -> float:
        """Return the RMS distance (mm) by noise alone, of the places marked by `positions` (V,)."""
        variance = np.diag(self.covariance).reshape(-1, 3)[positions]
        return float(np.sqrt(variance.sum(axis=1).mean()))


def estimate_noise(residual: Floats, t_seen: Floats, visit: NDArray[np.int64]) -> Noise:
    """Estimate the noise of the features from frames taken while nothing moved.

    Args:
        residual: measured minus predicted features, (K, F) mm; NaN where nothing was seen.
        t_seen: times of the frames, (K,) s.
        visit: number of the dwell of each frame, (K,); -1 while moving.

    Returns:
        Noise: from replicates if they give at least 15 degrees of freedom, else from second
            differences in time.

    Raises:
        SoftmapError: no replicates, and fewer than 5 frames.
    """
    found = dwell_scatter(residual, visit)
    if found.degrees >= ENOUGH:
        covariance = _shrunk(found.squares / found.degrees, found.degrees)
        return Noise(covariance, _degrees_text(found.degrees), _inflation(found.rho), True)
    return Noise(
        _high_frequency(filled(residual), t_seen),
        "high-frequency part of the run (no replicates)",
        1.0,
    )


def noise_off_shapes(seen: Floats, state: Conditions) -> Noise | None:
    """Estimate the noise of features (K, F) mm that also move, from what no command can make.

    Memory of the drive does not count; jitter of the frame does. In the directions in which
    commands move the body the noise is that of the others.

    Returns:
        Noise: None where less than half of the directions are left, or too few frames.
    """
    features = seen.shape[1]
    body = shapes(seen, state, settled_dwells(state))
    if body is None or features < 2 * body.scores.shape[1]:
        return None
    known = np.isfinite(body.remainder)
    if not known.any():
        return None
    rest = np.where(known, body.remainder, 0.0)
    frames = int(known.any(axis=1).sum())
    degrees = (frames - body.coefficients) * float(known[known.any(axis=1)].mean())
    squared = float(np.sum(rest**2))
    pooled = squared / (degrees * (features - body.scores.shape[1]))
    along = np.linalg.qr(body.tangents(_spread(len(seen))))[0]  # (n, F, b)
    covariance = rest.T @ rest / degrees
    covariance += pooled * np.einsum("nfb,ngb->fg", along, along) / len(along)
    rho = float(np.sum(rest[1:] * rest[:-1])) / max(squared, 1e-300)
    source = f"what no command can make of the body's shape ({frames} frames)"
    return Noise(_shrunk(covariance, int(degrees)), source, _inflation(rho), True)


def motion_left(
    residual: Floats, seen: Floats, positions: Mask, t_seen: Floats, state: Conditions
) -> AtRest:
    """Return the body's motion at rest that remains in a residual.

    Args:
        residual: measured minus predicted features, (K, F) mm; NaN where unseen.
        seen: measured features, (K, F) mm; NaN where unseen.
        positions: which features are places, (V,).
        t_seen: times of the frames, (K,) s.
        state: conditions of the frames.
    """
    dwell, modes = settled_dwells(state), _modes(seen, state)
    return motion_at_rest(residual, seen, positions, t_seen, state.command, dwell, modes)


def measure_noise(
    residual: Floats, seen: Floats, positions: Mask, t_seen: Floats, state: Conditions
) -> Noise:
    """Measure the noise of a run in dwells and between visits of one pose.

    Motion of the body at rest is left out.

    Args:
        residual: measured minus predicted features, (K, F) mm; NaN where unseen.
        seen: measured features, (K, F) mm; NaN where unseen.
        positions: which features are places, (V,).
        t_seen: times of the frames, (K,) s.
        state: conditions of the frames.

    Returns:
        Noise: without dwells the smaller of `estimate_noise` and `noise_off_shapes`.

    Raises:
        SoftmapError: no replicates, and fewer than 5 frames.
    """
    dwell = settled_dwells(state)
    plain = estimate_noise(residual, t_seen, dwell)
    if not plain.measured:
        off = noise_off_shapes(seen, state)
        # Motion inflates the one, and shapes that change inflate the other. With both it is no
        # guess.
        smaller = plain if off is None or plain.trace < off.trace else off
        return replace(smaller, measured=off is not None)
    moving = motion_left(residual, seen, positions, t_seen, state)
    body = shapes(seen, state, dwell)
    if body is None:
        values, along = moving.values, in_all(_modes(seen, state))
    else:  # the tangents of each pose hold its motion at rest; one pattern of it fits no pose
        values, along = residual, body.tangents
    white = white_variance(values, seen, positions, along, dwell)
    jitter = (
        None
        if white is None or body is None
        else frame_jitter(body.remainder, seen, positions, state, dwell, along, white)
    )
    if white is None or not (jitter or moving.found or moving.irregular):
        again = estimate_noise(moving.values, t_seen, dwell) if moving.found else plain
        return replace(again, moving=moving.found)
    fast = _white_scatter(values, seen, positions, along, white, dwell)
    covariance = _shrunk(fast.squares / fast.degrees, fast.degrees)
    fitted = Noise(covariance, plain.source, _inflation(fast.rho), True, moving=moving.found)
    if jitter is None:
        return fitted
    slow = jitter.of_features(filled(seen)[_spread(len(seen))], positions)
    count = max(1.0, 2.0 * jitter.memory_s * len(seen) / max(float(t_seen[-1] - t_seen[0]), 1e-9))
    kept = f" of {jitter.memory_s:g} s memory" if jitter.memory_s else ""
    source = f"{plain.source}, frame jitter{kept} ({jitter.revisits} revisits)"
    return replace(
        fitted,
        covariance=covariance + slow,
        source=source,
        slow=slow,
        memory_s=jitter.memory_s,
        slow_inflation=count,
    )


def _degrees_text(degrees: int) -> str:
    return f"replicates ({degrees} degrees of freedom)"


def _inflation(rho: float) -> float:
    """Return how many frames count as one if neighbours correlate by `rho`."""
    rho = float(np.clip(rho, 0.0, 0.95))
    return (1 + rho) / (1 - rho) if rho > 0.15 else 1.0


def _spread(frames: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, frames - 1, min(frames, GEOMETRY)).astype(np.intp))


def _modes(seen: Floats, state: Conditions) -> Floats:
    """Return the commanded modes (b, F) of features (K, F)."""
    return commanded_modes(seen, state.command, _most_modes(seen.shape[1]))


def _most_modes(features: int) -> int:
    """Return how many commanded modes the features show besides rigid motion and a remainder."""
    return max(2, min(COMMANDED, features // 3 - 2))


def _white_scatter(
    values: Floats,
    seen: Floats,
    positions: Mask,
    along: Along,
    white: Floats,
    dwell: NDArray[np.int64],
) -> Scatter:
    """Return the scatter of dwells without jitter of the frame and motion of the body.

    In the directions of both, it is the scatter of the white part alone.
    """
    squares, degrees, lag = np.zeros((seen.shape[1],) * 2), 0, np.zeros(2)
    for frames in rows_of(dwell, LEAST_DWELL):
        rest, order = undrifted(filled(values[frames]))
        shape = filled(seen[frames])
        found = coordinates(rest, shape, positions, along(frames), white)
        rest = rest - found.explained
        degrees += len(frames) - order
        flat = np.swapaxes(found.columns, 0, 1).reshape(seen.shape[1], -1)
        own = np.swapaxes(found.columns @ found.white, 0, 1).reshape(seen.shape[1], -1)
        squares += rest.T @ rest + own @ flat.T * (1.0 - order / len(frames))
        squared = float(np.sum(rest**2))
        lag += [float(np.sum(rest[1:] * rest[:-1])) + squared * order / len(frames), squared]
    return Scatter(squares, degrees, float(lag[0] / max(lag[1], 1e-300)))


def rod_noise(
    residual: Floats, t_seen: Floats, form_error: Floats, measured: Noise, repeats: Repeats | None
) -> Noise:
    """Return noise plus model error, for a model whose error is not smooth in its commands.

    The correlation time of the model error is that of the residual: the time at which its
    autocorrelation falls below 1/e.

    Args:
        residual: measured minus predicted features, (K, F) mm; NaN where unseen.
        t_seen: times of the frames, (K,) s.
        form_error: model error, (V, 3) mm.
        measured: noise from repeats, revisits or high frequencies.
        repeats: scatter of poses that were seen again, or None. With it, only the part of the model
            error that is a function of the commands counts; the rest is memory or noise.

    Returns:
        Noise: with the sum of both covariances.
    """
    clean = filled(residual)
    clean = clean - clean.mean(axis=0)
    period = float(np.median(np.diff(t_seen))) if len(t_seen) > 1 else 1.0
    power = float(np.mean(clean**2))
    tau = period
    for shift in range(1, len(clean) // 4):
        rho = float(np.mean(clean[shift:] * clean[:-shift])) / max(power, 1e-300)
        if rho < np.exp(-1.0):
            break
        tau = (shift + 1) * period
    own, source = form_error.ravel() ** 2, "the model's own held-out error"
    if repeats is not None:
        known = np.isfinite(residual)
        mean = np.where(known, residual, 0.0) ** 2
        static = np.maximum(
            mean.sum(axis=0) / np.maximum(known.sum(axis=0), 1) - repeats.variance, 0.0
        )
        # what is never seen has no repeatable part
        own = np.where(known.any(axis=0), np.minimum(own, static), own)
        source = "the repeatable part of the model error"
    inflation = max(1.0, 2.0 * tau / period)
    fast = float(np.trace(measured.covariance))
    mixed = (fast * measured.inflation + float(own.sum()) * inflation) / (fast + float(own.sum()))
    covariance = measured.covariance + np.diag(own)
    described = f"{measured.source}, and {source}, correlated over {tau:.2g} s"
    return replace(measured, covariance=covariance, source=described, inflation=mixed, slow=None)


def form_covariance(form_error: Floats, positions: Mask, section: NDArray[np.int64]) -> Floats:
    """Return the covariance (F, F) mm² of the model error.

    Neighbours along the body are correlated. Places and directions are independent, and so are the
    three components.

    Args:
        form_error: RMS of each component, (V, 3) mm.
        positions: which features are places, (V,).
        section: section of each feature, (V,).
    """
    place = section / max(1, int(section.max(initial=1)))
    # features come in groups that run along the body
    count = np.cumsum(np.r_[1, np.diff(section) < 0])
    near = np.exp(-0.5 * ((place[:, None] - place[None, :]) / BODY_LENGTH) ** 2)
    near *= (count[:, None] == count[None, :]) & (positions[:, None] == positions[None, :])
    covariance = np.zeros((form_error.size, form_error.size))
    for c in range(3):
        rows = np.arange(len(section)) * 3 + c
        covariance[np.ix_(rows, rows)] = near * np.outer(form_error[:, c], form_error[:, c])
    return covariance


@dataclass(frozen=True)
class Kernel:
    """The kernel over the commands of K frames, as Q diag(λ) Qᵀ.

    Attributes:
        basis: Q, (K, r).
        strength: λ, (r,).
    """

    basis: Floats
    strength: Floats


def scaled_commands(command: Floats, unit: Floats) -> Floats:
    """Return commands (K, C) in multiples of `unit` (C,); 0 for a channel whose unit is 0."""
    return np.asarray(command / np.where(unit > 1e-9, unit, np.inf))


def command_kernel(
    command: Floats, spread: Floats, leaning: Floats | None = None, rank: int = RANK
) -> Kernel:
    """Return the squared-exponential kernel over commands.

    Args:
        command: (K, C).
        spread: range of each channel, (C,), in the unit of the commands; it sets the kernel length.
        leaning: (K, d), or None. The kernel is multiplied by the products of its rows, so the error
            that grows with a lean differs between orientations. The rank may then be d times as
            large.
        rank: largest rank of the kernel.
    """
    if command.shape[0] == 0:
        return Kernel(np.zeros((0, 0)), np.zeros(0))
    x = (
        scaled_commands(command, spread * KERNEL_LENGTH)
        if command.shape[1]
        else np.zeros((len(command), 1))
    )
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
    """Convert feature differences to numbers of unit variance, if noise and model error are right.

    Attributes:
        project: map from features to noise-white spatial modes, (M, F).
        form: variance of the model error in each mode, (M,).
        kernel: kernel over the commands of the frames.
        level: variance of each mode by noise alone, (M,): 1, and less along a slow jitter of the
            frame, where several frames count as one. None without jitter.
    """

    project: Floats
    form: Floats
    kernel: Kernel
    level: Floats | None = None

    @property
    def numbers(self) -> float:
        """Independent numbers in a frame: the sum of squares of its modes under noise alone."""
        return float(len(self.form) if self.level is None else self.level.sum())

    def modes(self, difference: Floats) -> Floats:
        """Return the modes (..., K, M) of a difference (..., K, F) mm, in units of noise.

        Unseen values (NaN) count as no difference.
        """
        return np.asarray(np.where(np.isfinite(difference), difference, 0.0) @ self.project.T)

    def shrink(self, modes: Floats, kernel: Kernel | None = None) -> Floats:
        """Return `modes` (..., K, M), scaled down in the directions of the model error."""
        kernel = self.kernel if kernel is None else kernel
        if not len(kernel.strength) or not np.any(self.form > 0):
            return modes
        inside = kernel.basis.T @ modes  # (..., r, M)
        factor = 1.0 / np.sqrt(1.0 + kernel.strength[:, None] * self.form[None, :]) - 1.0
        return np.asarray(modes + kernel.basis @ (factor * inside))

    def squares(self, modes: Floats) -> Floats:
        """Return the sum of squares (...) of the shrunk modes, from `modes` (..., K, M).

        The shrunk modes are not computed: the basis of the kernel is orthonormal, so the part along
        it is scaled and the rest is unchanged.
        """
        flat = modes.reshape(*modes.shape[:-2], -1)
        energy = np.einsum("...n,...n->...", flat, flat)
        if not len(self.kernel.strength) or not np.any(self.form > 0):
            return np.asarray(energy)
        inside = self.kernel.basis.T @ modes
        forgiven = 1.0 - 1.0 / (1.0 + self.kernel.strength[:, None] * self.form[None, :])
        return np.asarray(energy - np.einsum("...rm,...rm,rm->...", inside, inside, forgiven))


def whitener(noise: Noise, form: Floats, signatures: Floats, kernel: Kernel) -> Whitener:
    """Build the whitener on the span of the signatures.

    Args:
        noise: noise of one frame.
        form: covariance of the model error, (F, F) mm²; zeros switch it off.
        signatures: feature differences that the candidates would cause, (S, K, F) mm.
        kernel: kernel over the commands of the frames.

    Returns:
        Whitener: with at most 24 modes.

    Raises:
        SoftmapError: noise and signatures differ in their number of features.
    """
    features = noise.covariance.shape[0]
    if signatures.shape[-1] != features:
        raise SoftmapError(
            f"signatures have {signatures.shape[-1]} features, the noise has {features}"
        )
    root = np.linalg.cholesky(noise.effective)
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
    level = (
        None if noise.slow is None else np.einsum("mf,fg,mg->m", project, noise.covariance, project)
    )
    return Whitener(project, np.einsum("mf,fg,mg->m", project, form, project), kernel, level)


def _distance2(a: Floats, b: Floats) -> Floats:
    return np.asarray(
        np.maximum(np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1)[None, :] - 2 * a @ b.T, 0.0)
    )


def _shrunk(covariance: Floats, degrees: int) -> Floats:
    """Shrink a covariance (F, F) from few replicates towards its diagonal.

    Few replicates leave directions without variance. The amount is that of oracle approximating
    shrinkage (Chen et al. 2010, doi:10.1109/TSP.2010.2053029) for the correlations. It is at least
    F / (F + degrees of freedom).
    """
    features = len(covariance)
    diagonal = np.diag(covariance).copy()
    size = np.sqrt(np.maximum(diagonal, FLOOR**2))
    squared = float(np.sum((covariance / np.outer(size, size)) ** 2))
    oracle = (squared + features**2) / ((degrees + 1) * max(squared - features, 1e-9))
    weight = float(np.clip(max(oracle, features / (features + degrees)), 0.05, 1.0))
    shared = 0.5 * features / (features + degrees)
    pooled = (1.0 - shared) * diagonal + shared * float(np.median(diagonal))
    shrunk = (1 - weight) * covariance
    shrunk.flat[:: features + 1] = pooled
    return np.asarray(shrunk + FLOOR**2 * np.eye(features))


def _high_frequency(residual: Floats, t_seen: Floats) -> Floats:
    """Return the noise covariance from clipped second differences r[k-1] - 2 r[k] + r[k+1].

    Their variance is 6 σ² for white noise.
    """
    if len(residual) < 5:
        raise SoftmapError(
            f"{len(residual)} seen frames are too few to estimate the noise; record at least 5, "
            "better 60"
        )
    step = np.diff(t_seen)
    regular = np.maximum(step[1:], step[:-1]) < 3 * np.median(step)
    second = (residual[:-2] - 2 * residual[1:-1] + residual[2:])[
        regular if regular.sum() >= 3 else slice(None)
    ]
    spread = 1.4826 * np.median(np.abs(second), axis=0) + FLOOR
    clipped = np.clip(second, -3 * spread, 3 * spread)
    return _shrunk(clipped.T @ clipped / (6.0 * len(clipped)), len(clipped))
