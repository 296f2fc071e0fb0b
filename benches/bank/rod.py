"""The bank's finger: a geometrically exact Cosserat rod with exact cables, in NumPy.

It is solved for many commands at once.

Every node has a place x and a frame R. An element with ends i, j has the rotation vector θ =
log(RᵢᵀRⱼ), the mid frame Rₘ = Rᵢ exp(θ/2), and the strains (J. C. Simo, Comput. Methods Appl. Mech.
Eng. 49, 1985, at the middle)

    γ = Rₘᵀ(xⱼ − xᵢ)/ℓ − e₃  (shear, shear, stretch),      κ = θ/ℓ  (bending, bending, twist)

A cable is a straight line from guide to guide with tension T = k⟨L − L₀ + d − s⟩₊: shortened by d,
never pushing. What is found is the minimum of

    Σ ℓ W(γ, κ − κ₀) + Σ T²/(2k) − Σ m g·x − F·x_tip + Σ c/2 ⟨gap⟩²
        (fibres of `section.py`; weights are dead)

by Newton's method with a block-tridiagonal solve, the stiff cables joined by Woodbury's formula,
and steps shortened until the energy falls; a row that does not settle takes its load in smaller
parts. mm, N, MPa, rad, g. Limits: sections stay plane and rigid in their plane. Pinned by
tests/benches/test_bank_rod.py: the elastica, order of convergence, work of the cables, symmetry,
gradient by differences, the project's own finite elements.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benches.bank.newton_step import newton_step
from benches.bank.rotations import hat, into, log, out_of, transposed, turn
from benches.bank.section import FLOOR, GRAVITY, SHEAR, Design

Floats = NDArray[np.float64]

TOLERANCE = 1e-6  # N and N·mm/10 of what is out of balance, of forces of about 1 N
STEPS = 60
LONGEST = (4.0, 0.12)  # mm and rad of one node in one step
WALL = 2.0  # N/mm of each node that is pressed into an obstacle


@dataclass(frozen=True, eq=False)
class Loads:
    """The loads on each of B rods.

    `pull` (B, 4) mm of shortening of the cables, `gravity` (B, 3) g, `tip` (B, 3) N.

    `plane` (normal (3,), place mm) is an obstacle: the rod's surface beyond normal·x = place is
    pushed back. `tension` (B, 4, m-1) is that of each cable along its segments, relative to that at
    the base; None is 1.
    """

    pull: Floats
    gravity: Floats
    tip: Floats
    plane: tuple[Floats, float] | None = None
    tension: Floats | None = None

    def rows(self, which: NDArray[np.intp], share: float = 1.0) -> Loads:
        """Return some rows; of everything but the obstacle the `share`."""
        return replace(
            self,
            pull=share * self.pull[which],
            gravity=share * self.gravity[which],
            tip=share * self.tip[which],
            tension=None if self.tension is None else self.tension[which],
        )


@dataclass(frozen=True, eq=False)
class Poses:
    """B settled rods: `x` (B, n+1, 3) mm, `frame` (B, n+1, 3, 3), `tension` (B, 4) N, `error`.

    `error` (B,) is the imbalance.
    """

    x: Floats
    frame: Floats
    tension: Floats
    error: Floats

    def points(self, design: Design, place: Floats, around: Floats) -> Floats:
        """Return material points (B, N, 3) mm by their places at rest.

        `place` (N,) mm along, `around` (N, 2) mm from the axis.

        A section keeps its volume: it thins by 1/√(1+ε). Frames between nodes turn by their share
        of the element.
        """
        at = np.clip(
            np.searchsorted(design.place, place, side="right") - 1, 0, len(design.length) - 1
        )
        share = (place - design.place[at]) / design.length[at]
        theta = log(transposed(self.frame[:, at]) @ self.frame[:, at + 1])
        frame = self.frame[:, at] @ turn(theta * share[:, None])
        chord = self.x[:, at + 1] - self.x[:, at]
        middle = self.frame[:, at] @ turn(theta / 2)
        # An element is an arc: half the square of its share falls inside the chord.
        sag = np.cross(theta, into(middle, chord)) * (share * (share - 1) / 2)[:, None]
        line = self.x[:, at] + share[:, None] * chord + out_of(middle, sag)
        stretch = np.linalg.norm(chord, axis=2) / design.length[at]
        offset = (
            np.concatenate([around, np.zeros((len(place), 1))], axis=1)
            / np.sqrt(stretch)[..., None]
        )
        return np.asarray(line + out_of(frame, offset))


def straight(design: Design, count: int) -> Poses:
    """Return `count` rods as they are made."""
    x = np.zeros((count, len(design.place), 3))
    x[..., 2] = design.place
    frame = np.broadcast_to(np.eye(3), (count, len(design.place), 3, 3)).copy()
    return Poses(x, frame, np.zeros((count, 4)), np.full(count, np.inf))


def laid(design: Design, strain: Floats) -> Poses:
    """Return the rods (not settled) of strains (B, n, 6).

    They are shear, shear, stretch, bending, bending, twist.
    """
    poses, length = straight(design, len(strain)), design.length
    theta = strain[..., 3:] * length[:, None]
    whole, half = turn(theta), turn(theta / 2)
    chord = (strain[..., :3] + [0.0, 0.0, 1.0]) * length[:, None]
    for j in range(len(length)):
        here = poses.frame[:, j]
        poses.frame[:, j + 1] = here @ whole[:, j]
        poses.x[:, j + 1] = poses.x[:, j] + out_of(here @ half[:, j], chord[:, j])
    return poses


def strains(design: Design, poses: Poses) -> Floats:
    """Return the strains (B, n, 6) of rods, as `laid` takes them."""
    return _strains(design, poses.x, poses.frame)[3]


def settle(design: Design, loads: Loads, start: Poses | None = None, parts: int = 8) -> Poses:
    """Find the equilibria of B rods.

    Args: `start` from where (as they are made without it, with the load in `parts`).
    Raises ArithmeticError: a rod does not settle.
    """
    count = len(loads.pull)
    every = np.arange(count)
    if start is None:
        poses = straight(design, count)
        for part in range(1, parts):
            poses = _newton(design, loads.rows(every, part / parts), poses, STEPS // 3)
        poses = _newton(design, loads, poses, STEPS)
    else:
        poses = _newton(design, loads, start, STEPS)
    lost = np.flatnonzero(poses.error > TOLERANCE)
    if lost.size and parts < 100:
        again = settle(design, loads.rows(lost), None, 4 * parts)
        for whole, part in zip((poses.x, poses.frame, poses.tension, poses.error), _arrays(again)):
            whole[lost] = part
    elif lost.size:
        raise ArithmeticError(
            f"{lost.size} of {count} rods do not settle, the first at pulls "
            f"{loads.pull[lost[0]].tolist()} mm: {poses.error[lost[0]]:.2g} N are out of balance"
        )
    return poses


def _arrays(poses: Poses) -> tuple[Floats, ...]:
    return poses.x, poses.frame, poses.tension, poses.error


def _newton(design: Design, loads: Loads, start: Poses, steps: int) -> Poses:
    x, frame, tension, error = (a.copy() for a in _arrays(start))
    open_ = np.arange(len(x))
    energy = energy_of(design, loads, x, frame)
    for _ in range(steps):
        here = loads.rows(open_)
        force, blocks, cables, pull = assembled(design, here, x[open_], frame[open_])
        tension[open_] = pull
        error[open_] = np.max(np.abs(force) * [1, 1, 1, 0.1, 0.1, 0.1], axis=(1, 2))
        going = error[open_] > TOLERANCE
        if not going.any():
            break
        open_, here = open_[going], here.rows(np.flatnonzero(going))
        blocks = tuple(b[going] for b in blocks)
        step = newton_step(blocks, force[going], cables[going], pull[going] > 0.0, design.cable)
        slope = np.sum(step * force[going], axis=(1, 2))
        step[slope > 0.0] *= -1.0  # uphill: a tangent that is not definite
        size = np.maximum(
            np.linalg.norm(step[..., :3], axis=2).max(axis=1) / LONGEST[0],
            np.linalg.norm(step[..., 3:], axis=2).max(axis=1) / LONGEST[1],
        )
        step /= np.maximum(size, 1.0)[:, None, None]
        fall = -np.abs(slope) / np.maximum(size, 1.0)
        share, wait = np.ones(len(open_)), np.arange(len(open_))
        for _ in range(12):
            rows = open_[wait]
            s = share[wait][:, None, None] * step[wait]
            new_x = x[rows].copy()
            new_x[:, 1:] += s[..., :3]
            new_frame = frame[rows].copy()
            new_frame[:, 1:] = turn(s[..., 3:]) @ new_frame[:, 1:]
            value = energy_of(design, here.rows(wait), new_x, new_frame)
            good = value <= energy[rows] + 1e-4 * share[wait] * fall[wait] + 1e-9 * (
                1.0 + np.abs(energy[rows])
            )
            x[rows[good]], frame[rows[good]], energy[rows[good]] = (
                new_x[good],
                new_frame[good],
                value[good],
            )
            wait = wait[~good]
            if not wait.size:
                break
            share[wait] *= 0.5
    return Poses(x, frame, tension, error)


# --- the rod -------------------------------------------------------------------------------------


def _strains(design: Design, x: Floats, frame: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return mid frames (B, n, 3, 3), θ (B, n, 3), chords (B, n, 3), strains (B, n, 6).

    The chords are in the mid frame.
    """
    theta = log(transposed(frame[:, :-1]) @ frame[:, 1:])
    middle = frame[:, :-1] @ turn(theta / 2)
    chord = into(middle, np.diff(x, axis=1))
    length = design.length[:, None]
    gamma = chord / length - [0.0, 0.0, 1.0]
    return middle, theta, chord, np.concatenate([gamma, theta / length], axis=2)


def _section(design: Design, strain: Floats) -> tuple[Floats, Floats, Floats]:
    """Return energy per length (B, n), forces and moments (B, n, 6), tangent (B, n, 6, 6)."""
    bend = strain[..., 3:] - design.rest
    x, y, area = design.fibres()
    lever = np.stack([np.ones_like(x), y, -x], axis=2)  # (n, F, 3)
    stretch = 1.0 + np.einsum(
        "nfk,bnk->bnf", lever, np.stack([strain[..., 2], bend[..., 0], bend[..., 1]], axis=2)
    )
    bound = np.maximum(stretch, FLOOR)
    below = stretch - bound
    whole_fibre = design.young * area / 3.0  # (n, F) N
    modulus = whole_fibre * np.where(stretch > 1.0, design.torn, 1.0)
    rate = modulus * (1.0 + 2.0 * bound**-3)
    force = modulus * (bound - bound**-2) + rate * below
    stored = (
        modulus / 2 * (bound**2 + 2.0 / bound - 3.0)
        + (modulus * (bound - bound**-2) + rate * below / 2) * below
    )
    whole = np.sum(whole_fibre, axis=1)  # G·A
    polar = np.sum(whole_fibre * (x**2 + y**2), axis=1)  # G·J
    shear = SHEAR * whole[:, None] * strain[..., :2]
    energy = (
        stored.sum(axis=2)
        + np.sum(shear * strain[..., :2], axis=2) / 2
        + polar * bend[..., 2] ** 2 / 2
    )
    out = np.zeros_like(strain)
    out[..., :2] = shear
    out[..., 2:5] = np.einsum("nfk,bnf->bnk", lever, force)
    out[..., 5] = polar * bend[..., 2]
    tangent = np.zeros((*strain.shape, 6))
    pairs = np.einsum("nfk,nfl->nfkl", lever, lever).reshape(*x.shape, 9)
    tangent[..., 2:5, 2:5] = np.einsum("bnf,nfk->bnk", rate, pairs, optimize=True).reshape(
        *strain.shape[:2], 3, 3
    )
    tangent[..., 0, 0] = tangent[..., 1, 1] = SHEAR * whole
    tangent[..., 5, 5] = polar
    return np.asarray(energy), out, tangent


def energy_of(design: Design, loads: Loads, x: Floats, frame: Floats) -> Floats:
    """Return the total energy (B,) N·mm."""
    *_, strain = _strains(design, x, frame)
    total = np.asarray(_section(design, strain)[0] @ design.length)
    points = guides(design, x, frame)
    span = np.linalg.norm(np.diff(points, axis=2), axis=3).sum(axis=2)
    total += np.sum(
        design.cable
        / 2
        * np.maximum(span - own_lengths(design) + loads.pull - design.slack, 0.0) ** 2,
        axis=1,
    )
    total -= GRAVITY * np.einsum("bk,bik,i->b", loads.gravity, x, design.mass) + np.sum(
        loads.tip * x[:, -1], axis=1
    )
    if loads.plane is not None:
        total += WALL / 2 * np.sum(np.maximum(_gap(design, loads, x), 0.0) ** 2, axis=1)
    return total


def _gap(design: Design, loads: Loads, x: Floats) -> Floats:
    """Return how deep (B, n+1) mm the surface at each node lies in the obstacle."""
    assert loads.plane is not None
    normal, place = loads.plane
    return np.asarray(x @ normal + np.append(design.radius, design.radius[-1]) - place)


def guides(design: Design, x: Floats, frame: Floats) -> Floats:
    """Return the guides (B, 4, m, 3) mm."""
    m = design.guide.shape[1]
    return np.asarray(x[:, None, :m] + np.einsum("bmij,cmj->bcmi", frame[:, :m], design.guide))


def own_lengths(design: Design) -> Floats:
    """Return the length (4,) mm of the cables of a straight rod."""
    points = design.guide + design.place[: design.guide.shape[1], None] * np.array([0.0, 0.0, 1.0])
    return np.asarray(np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1))


@dataclass(frozen=True, eq=False)
class Balance:
    """The forces on the free nodes of B rods.

    `slope` (B, n, 6) of the energy, its tangent `blocks` (below, diagonal, above) (B, n, 6, 6)
    without the cables' own stiffness, slopes (B, n, 6, 4) of the cables' `lengths`, the same
    `drawn` by the tension of each segment, and the tension `pull` (B, 4) N at the base.
    """

    slope: Floats
    blocks: tuple[Floats, Floats, Floats]
    lengths: Floats
    drawn: Floats
    pull: Floats


def assembled(
    design: Design, loads: Loads, x: Floats, frame: Floats
) -> tuple[Floats, tuple[Floats, Floats, Floats], Floats, Floats]:
    """Return slope, blocks, lengths and pull of `balance`."""
    found = balance(design, loads, x, frame)
    return found.slope, found.blocks, found.lengths, found.pull


def balance(design: Design, loads: Loads, x: Floats, frame: Floats) -> Balance:
    """Return the forces on rods at places x (B, n+1, 3) and frames (B, n+1, 3, 3)."""
    middle, theta, chord, strain = _strains(design, x, frame)
    _, sigma, law = _section(design, strain)
    local, force = _element(design.length, theta, chord, sigma, law)
    spatial = out_of(middle[:, :, None], force.reshape(*force.shape[:2], 4, 3)).reshape(force.shape)
    ends = local.reshape(*local.shape[:2], 4, 3, 12)
    ends = (middle[:, :, None] @ ends).reshape(local.shape)
    ends = transposed(
        (middle[:, :, None] @ transposed(ends).reshape(*local.shape[:2], 4, 3, 12)).reshape(
            local.shape
        )
    )
    b, nodes = x.shape[:2]
    slope = np.zeros((b, nodes, 6))
    slope[:, :-1] += spatial[..., :6]
    slope[:, 1:] += spatial[..., 6:]
    pull, lengths, drawn = _cables(design, loads, x, frame, ends)
    slope += np.einsum("bnkc,bc->bnk", drawn, pull)
    slope[..., :3] -= GRAVITY * loads.gravity[:, None] * design.mass[:, None]
    slope[:, -1, :3] -= loads.tip
    diagonal = np.zeros((b, nodes, 6, 6))
    diagonal[:, :-1] += ends[..., :6, :6]
    diagonal[:, 1:] += ends[..., 6:, 6:]
    if loads.plane is not None:
        normal = loads.plane[0]
        gap = _gap(design, loads, x)
        slope[..., :3] += WALL * np.maximum(gap, 0.0)[..., None] * normal
        diagonal[..., :3, :3] += WALL * (gap > 0.0)[..., None, None] * np.outer(normal, normal)
    blocks = ends[:, 1:, 6:, :6], diagonal[:, 1:], ends[:, 1:, :6, 6:]
    return Balance(slope[:, 1:], blocks, lengths[:, 1:], drawn[:, 1:], pull)


def _element(
    length: Floats, theta: Floats, chord: Floats, sigma: Floats, law: Floats
) -> tuple[Floats, Floats]:
    """Return tangents (B, n, 12, 12) and forces (B, n, 12) of elements.

    They are on (xᵢ, spin of i, xⱼ, spin of j), all in the mid frame.

    With D = wⱼ − wᵢ and τ = ½ tan(h/2) a, h = |θ|/2, the mid frame spins by (wᵢ + wⱼ)/2 − τ × D,
    and θ changes by K⁻¹D, K⁻¹ = h/sin h (1 − aaᵀ) + aaᵀ. The change of K⁻¹ itself, of order h, is
    left out of the tangent.
    """
    h = np.linalg.norm(theta, axis=2)[..., None] / 2
    axis = theta / np.maximum(2 * h, 1e-300)
    tau = 0.5 * np.tan(h / 2) * axis
    ratio = (h / np.maximum(np.sin(h), 1e-300))[..., None]
    ratio = np.where(h[..., None] < 1e-9, 1.0, ratio)
    inverse = ratio * np.eye(3) + (1.0 - ratio) * axis[..., :, None] * axis[..., None, :]
    eye, tilt = np.eye(3) / 2, hat(tau)
    spin = np.zeros((*theta.shape, 12))  # of the mid frame
    spin[..., 3:6], spin[..., 9:] = eye + tilt, eye - tilt
    apart = np.zeros_like(spin)  # D
    apart[..., 3:6], apart[..., 9:] = -np.eye(3), np.eye(3)
    chords = hat(chord) @ spin
    chords[..., :3] -= np.eye(3)
    chords[..., 6:9] += np.eye(3)
    map_ = np.concatenate([chords, inverse @ apart], axis=2)  # ℓ × strains, (B, n, 6, 12)
    force = (transposed(map_) @ sigma[..., None])[..., 0]
    tangent = transposed(map_) @ law @ map_ / length[:, None, None]
    n = hat(sigma[..., :3])
    couple = np.cross(sigma[..., :3], chord)
    of_couple = n @ chords
    of_tilt = -hat(couple) @ (apart / 8) + tilt @ of_couple
    turned_force = -n @ spin
    rows = (
        -turned_force,
        -hat(force[..., 3:6]) @ spin + of_couple / 2 - of_tilt,
        turned_force,
        -hat(force[..., 9:]) @ spin + of_couple / 2 + of_tilt,
    )
    return tangent + np.concatenate(rows, axis=2), force


def _cables(
    design: Design, loads: Loads, x: Floats, frame: Floats, ends: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return tension (B, 4) N and slopes (B, n+1, 6, 4) of the cables' lengths.

    Also the same weighted by the tension of each segment; add the contributions of taut lines to
    `ends`.
    """
    m = design.guide.shape[1]
    arm = np.einsum("bmij,cmj->bcmi", frame[:, :m], design.guide)
    line = np.diff(x[:, None, :m] + arm, axis=2)
    span = np.linalg.norm(line, axis=3)
    along = line / span[..., None]
    stretch = span.sum(axis=2) - own_lengths(design) + loads.pull - design.slack
    pull = design.cable * np.maximum(stretch, 0.0)
    slopes = drawn = _by_node(x, arm, along)
    held = np.broadcast_to(pull[..., None], span.shape)
    if loads.tension is not None:
        pull = pull * span.sum(axis=2) / np.sum(loads.tension * span, axis=2)
        drawn, held = (
            _by_node(x, arm, along * loads.tension[..., None]),
            pull[..., None] * loads.tension,
        )
    moved = np.zeros((*along.shape, 12))
    moved[..., :3], moved[..., 6:9] = -np.eye(3), np.eye(3)
    moved[..., 3:6], moved[..., 9:] = hat(arm[:, :, :-1]), -hat(arm[:, :, 1:])
    across = moved - along[..., :, None] * (along[..., None, :] @ moved)
    across *= np.sqrt(held / span)[..., None, None]
    rows = np.moveaxis(across, 1, 2).reshape(len(x), m - 1, 12, 12)  # 4 cables of 3 rows
    ends[:, : m - 1] += transposed(rows) @ rows
    own = held[..., None, None]
    for block, lever, sign in (
        (slice(3, 6), arm[:, :, :-1], -1.0),
        (slice(9, 12), arm[:, :, 1:], 1.0),
    ):
        turn_ = lever[..., :, None] * along[..., None, :] - np.sum(lever * along, axis=3)[
            ..., None, None
        ] * np.eye(3)
        ends[:, : m - 1, block, block] += np.sum(sign * own * turn_, axis=1)
    return pull, slopes, drawn


def _by_node(x: Floats, arm: Floats, along: Floats) -> Floats:
    """Return slopes (B, n+1, 6, 4) of Σ lengths by the nodes.

    They are of segments along (B, 4, m-1, 3) at arms (B, 4, m, 3).
    """
    m = arm.shape[2]
    at = np.zeros_like(arm)  # slope by the guide's place
    at[:, :, 1:] += along
    at[:, :, :-1] -= along
    slopes = np.zeros((*x.shape[:2], 6, 4))
    slopes[:, :m, :3] = np.moveaxis(at, 1, 3)
    slopes[:, :m, 3:] = np.moveaxis(np.cross(arm, at), 1, 3)
    return slopes
