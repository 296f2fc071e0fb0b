"""Slice *shop*: fingers from a workshop, seen by a slow camera.

Their laws have numbers for each servo and each cable.

Every finger has static imperfections of 0.2 to 0.4 mm RMS of its section centroids
(`imperfect.py`). The frame jitters with a memory of 3 to 10 s. A hidden law moves the finger 2.2 to
6 times as far as the imperfections do. A law that cannot reach that size at a plausible strength
gets its largest plausible strength, and is not scored below twice the background. Units: mm, s. A
case is a pure function of (seeds, level, kind, number). Pinned by tests/benches/test_bank_shop.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benches.bank.answers import FAMILY, Answer, answer_for
from benches.bank.bodies import Body, body_of
from benches.bank.case import Case, drawn, each_moves, place_of, seen, stream
from benches.bank.imperfect import static, traces
from benches.bank.law import Law
from benches.bank.laws_odd import UNKNOWN_LAWS
from benches.bank.laws_shop import SHOP
from benches.bank.laws_static import CrossTerm, SmoothMap
from benches.bank.laws_unknown import UNKNOWN
from benches.bank.watch import LEVELS, Level, rms, sections
from softmap_edge.run.protocol import standard_protocol

BACKGROUND_MM = (0.2, 0.4)
TIMES = (2.2, 6.0)  # as far as its imperfections
LEAST_MM = (0.6, 1.4)
PAIRS = 4
MARKED = 5
STRANGE: tuple[type[Law], ...] = (
    SmoothMap,
    UNKNOWN_LAWS[1],
    CrossTerm,
    UNKNOWN_LAWS[0],
    UNKNOWN["gate"],
    UNKNOWN_LAWS[2],
    UNKNOWN["leaking_cell"],
    *UNKNOWN_LAWS[3:],
    UNKNOWN["crack"],
    UNKNOWN["magnet"],
    UNKNOWN["frayed_cable"],
)


def shop_case(seeds: str, level: str, kind: str, number: int) -> Case:
    """Make a case.

    Raises:
        KeyError: the kind is unknown.
        ArithmeticError: a body does not settle.
    """
    rng = stream(seeds, "shop", level, kind, number)
    body = body_of("shop")
    wanted = float(rng.uniform(*BACKGROUND_MM))
    small = imperfections(body, wanted, rng)
    hardness = replace(
        LEVELS["real"],
        name=level,
        shiver_mm=float(rng.uniform(0.05, 0.12)),
        shiver_deg=float(rng.uniform(0.03, 0.06)),
        memory_s=float(rng.uniform(3.0, 10.0)),
        background=0.0,
        moves_mm=tuple(max(t * wanted, least) for t, least in zip(TIMES, LEAST_MM)),
    )
    found = hidden_laws(kind, number, body, hardness, rng)
    return Case(
        f"{seeds}-shop-{level}-{kind}-{number:04d}",
        hardness,
        kind,
        body,
        tuple(law for law, _ in found),
        small,
        tuple(mm for _, mm in found),
        int(rng.integers(2**31)),
        bool(rng.integers(MARKED) == 0),
        tuple(answer_of(law) for law, _ in found),
    )


def imperfections(body: Body, wanted_mm: float, rng: np.random.Generator) -> tuple[Law, ...]:
    """Draw imperfections that move section centroids by `wanted_mm` RMS.

    It is on the standard protocol.
    """
    protocol, every = standard_protocol(2), 2 * body.every
    laws = static(rng, body.channels)
    plain = seen(body, (), protocol, False, every=every)
    strength = 1.0
    for _ in range(3):
        there = seen(body, [law.scaled(strength) for law in laws], protocol, False, every=every)
        reached = rms(sections(there - plain, body.place))
        if abs(reached - wanted_mm) < 0.1 * wanted_mm:
            break
        strength *= wanted_mm / reached
    return (*(law.scaled(strength) for law in laws), *traces(rng, body.channels))


def hidden_laws(
    kind: str, number: int, body: Body, level: Level, rng: np.random.Generator
) -> list[tuple[Law, float]]:
    """Draw the hidden laws of a case, in the order of the chain.

    Singles and unknown laws in turn, pairs at random.
    """
    for _ in range(PAIRS):
        if kind == "null":
            return []
        if kind == "single":
            return [drawn(SHOP[number % len(SHOP)], body, level, rng)]
        if kind == "unknown":
            return [drawn(STRANGE[number % len(STRANGE)], body, level, rng)]
        if kind != "pair":
            raise KeyError(f"no kind '{kind}'; there are null, single, pair, unknown")
        first, second = rng.choice(len(SHOP), size=2, replace=False)
        found = [drawn(SHOP[int(one)], body, level, rng) for one in (first, second)]
        if each_moves([law for law, _ in found], body, level):
            break
    return sorted(found, key=lambda pair: place_of(pair[0]))


def answer_of(law: Law) -> Answer:
    """Return the right answer for a hidden law of this slice."""
    if type(law) in SHOP:
        return answer_for(law.NAME)
    return Answer(unknown_family(law))


def unknown_family(law: Law) -> tuple[str, ...]:
    """Return the families of a law that is in no library."""
    return ODD_FAMILY.get(law.NAME) or FAMILY.get(law.NAME, ())


ODD_FAMILY: dict[str, tuple[str, ...]] = {
    "smooth_map": ("static map",),
    "cross_term": ("coupling",),
    "steps": ("static map", "memory"),
    "hum": ("time", "hum", "noise"),
    "stick_slip": ("memory",),
    "overshoot": ("memory",),
    "stribeck": ("memory", "rate"),
    "speedy_play": ("memory", "rate", "delay"),
    "snap": ("memory", "coupling"),
    "hooked": ("memory", "coupling"),
    "fading_memory": ("memory",),
    "rate_square": ("rate", "delay"),
    "rate_bend": ("rate", "delay"),
    "warm_creep": ("creep", "temperature"),
    "bimetal": ("temperature", "time"),
    "warm_play": ("memory", "temperature"),
    "big_creep": ("creep",),
    "fatigue": ("time", "softening", "step"),
    "torn": ("step", "time"),
    "clutch": ("memory", "step", "time"),
    "mounted_gain": ("load",),
    "held": ("delay",),
    "frame_noise": ("frame drift", "frame", "time"),
    "bending_noise": ("time", "noise", "step"),
    "timely_gain": ("time", "temperature", "step"),
    "other_modulus": ("body", "static shape", "load"),
    "longer_body": ("static map", "static shape", "body", "frame"),
    "mixed_channels": ("coupling", "frame", "static shape"),
    "still": (),
    "stuck": ("step", "time"),
}
