"""The hidden laws sample by sample, for an emulated finger that moves in real time.

A law gives the same result for a complete record and for a stream
(tests/robot/test_emulated_finger.py). As in `robot/emulated/laws.py`, each law starts in
equilibrium with its first sample, and the effect library is never called.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from softmap_edge.robot.emulated.laws import (
    BoucWen,
    Floats,
    LatePackets,
    Law,
    ManyPlays,
    ThreeTerms,
    TwoPoles,
)

Step = Callable[[float, Floats], Floats]


def streamed(laws: Sequence[Law]) -> Step:
    """Return the laws in series as a function (t s, u (C,) mm) → (C,) mm; t increases."""
    steps = [_MEMORY.get(type(law), _still)(law) for law in laws]

    def step(t: float, u: Floats) -> Floats:
        for one in steps:
            u = one(t, u)
        return u

    return step


def _still(law: Law) -> Step:
    return lambda t, u: law.command(np.array([t]), u[None])[0]


def _pole(tau: float) -> Step:
    before: list[tuple[float, Floats, Floats]] = []

    def step(t: float, u: Floats) -> Floats:
        if not before:
            before.append((t, u, u))
            return u
        then, was, x = before[0]
        ratio = (t - then) / max(tau, 1e-9)
        keep = float(np.exp(-ratio))
        mean = -float(np.expm1(-ratio)) / ratio if ratio > 1e-12 else 1.0
        x = keep * x + (mean - keep) * was + (1.0 - mean) * u
        before[0] = (t, u, x)
        return x

    return step


def _poles(law: TwoPoles) -> Step:
    servo, cable = _pole(law.servo_s), _pole(law.cable_s)
    return lambda t, u: cable(t, servo(t, u))


def _terms(law: ThreeTerms) -> Step:
    poles = [_pole(factor * law.middle_s) for factor in (0.2, 1.0, 5.0)]
    compliance, weights = np.array(law.compliance), law.weights
    return lambda t, u: u + compliance * sum(w * pole(t, u) for w, pole in zip(weights, poles))


def _plays(law: ManyPlays) -> Step:
    half = np.outer(np.array(law.half_width_mm), 1.0 + law.spread * np.linspace(-1.0, 1.0, 8))
    plays: list[Floats] = []

    def step(t: float, u: Floats) -> Floats:
        play = plays.pop() if plays else np.repeat(u[:, None], 8, axis=1)
        play = np.minimum(np.maximum(play, u[:, None] - half), u[:, None] + half)
        plays.append(play)
        return np.asarray(play.mean(axis=1))

    return step


def _bouc_wen(law: BoucWen) -> Step:
    known: list[tuple[Floats, Floats]] = []

    def step(t: float, u: Floats) -> Floats:
        was, z = known.pop() if known else (u, np.zeros(len(u)))
        move = (u - was) / law.saturation_mm
        parts = max(1, int(np.ceil(20.0 * float(np.max(np.abs(move))))))
        for _ in range(parts):
            z = z + move / parts * (
                1.0 - np.abs(z) ** law.sharpness * (1.0 + np.sign(move * z)) / 2.0
            )
        known.append((u, z))
        return np.asarray(u - np.array(law.share) * law.saturation_mm * z)

    return step


def _packets(law: LatePackets) -> Step:
    rng = np.random.default_rng(law.seed)
    under_way: deque[tuple[float, Floats]] = deque()
    # last sample, arrival of the last packet, held value
    known: list[tuple[float, Floats, float, Floats]] = []

    def step(t: float, u: Floats) -> Floats:
        if not known:
            known.append((t, u, -np.inf, u))
            known_sent[0] = t
        then, was, arrived, held = known.pop()
        while known_sent[0] <= t:
            share = (known_sent[0] - then) / (t - then) if t > then else 1.0
            late = law.delay_s + law.spread_s * rng.uniform(-1.0, 1.0)
            arrived = max(arrived, known_sent[0] + max(late, 0.0))
            under_way.append((arrived, was + share * (u - was)))
            known_sent[0] += law.period_s
        while under_way and under_way[0][0] <= t:
            held = under_way.popleft()[1]
        known.append((t, u, arrived, held))
        return held

    known_sent = [0.0]
    return step


_MEMORY: dict[type[Law], Callable[..., Step]] = {
    TwoPoles: _poles,
    ThreeTerms: _terms,
    ManyPlays: _plays,
    BoucWen: _bouc_wen,
    LatePackets: _packets,
}
