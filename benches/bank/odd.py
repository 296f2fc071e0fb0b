"""Slice *odd*: causes of false claims.

Smooth maps, drifts, chance, other robots, robots that stand.

    null       nothing is hidden: clean, with background, with heavy tails, with slow jitter, with
               bodies that bend
               irregularly, with displaced frames, with a temperature that jumps and has no effect
    single     a law of the library under one of those conditions
    pair       a law of the library together with a map or a law that is in no library
    unknown    level *maps*: a smooth static map or a cross term; level *real*: a law that is in no
               library
    trap       a drift, a temperature that follows time by chance, another robot than the model's, a
               drive that is off

Units: mm, s, °C. A case is a pure function of (seeds, level, kind, number). Pinned by
tests/benches/test_bank_odd.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from benches.bank.answers import OPEN_VERDICTS, Answer, answer_for
from benches.bank.bodies import Body, body_of
from benches.bank.case import Case, drawn, place_of, seen, stream, strengthened, temperature
from benches.bank.law import Floats, Law, Record
from benches.bank.laws_body import BODY
from benches.bank.laws_drive import DRIVE, OffCentre
from benches.bank.laws_odd import (
    UNKNOWN_LAWS,
    BendingNoise,
    FrameNoise,
    LongerBody,
    MixedChannels,
    OtherModulus,
    Still,
    Stuck,
    TimelyGain,
    profile,
)
from benches.bank.laws_static import CrossTerm, SmoothMap, bent
from benches.bank.shop import unknown_family
from benches.bank.watch import LEVELS, Level, background, rms, sections
from softmap_edge.run.protocol import standard_protocol

Room = Callable[[Floats], Floats]

# RMS of the section centroids by the part of a map that offsets and gains cannot represent
BENT_MM = (0.5, 1.5)
CROSSED = 5  # one of so many maps is a cross term
EASY = replace(LEVELS["easy"], background=0.0)
REAL = replace(LEVELS["real"], moves_mm=(0.8, 2.5))
CONTROLS = tuple(
    (
        "gain",
        "backlash",
        "creep",
        "eccentric_pulley",
        "asymmetry",
        "hysteresis",
        "dead_zone",
        "lag",
        "saturation",
        "friction",
        "offset",
        "latency",
        "mullins",
        "coupling",
        "thermal_softening",
        "payload",
        "pre_curve",
        "mount",
        "anchor_slip",
        "tendon_stretch",
        "camera_drift",
        "stiffness_gradient",
        "rate_limit",
        "tendon_creep",
        "routing",
    )
)
BESIDE = (
    "backlash",
    "creep",
    "hysteresis",
    "lag",
    "friction",
    "payload",
    "mount",
    "thermal_softening",
    "latency",
)
COURSES = ("ramp", "step", "exponential")
KNOWN = {**DRIVE, **BODY}


def odd_case(seeds: str, level: str, kind: str, number: int) -> Case:
    """Make a case.

    Raises:
        KeyError: the kind is unknown.
        ArithmeticError: a body does not settle.
    """
    rng = stream(seeds, "odd", level, kind, number)
    body, hardness, room = body_of("odd"), _level(kind, number, rng), _room(kind, number)
    small: tuple[Law, ...] = background(hardness, rng, body.channels) if hardness.background else ()
    small += _restless(kind, number, body, rng)
    found = [
        (law, mm, answer) for law, mm, answer in _hidden(level, kind, number, body, hardness, rng)
    ]
    found.sort(key=lambda one: place_of(one[0]))
    return Case(
        f"{seeds}-odd-{level}-{kind}-{number:04d}",
        replace(hardness, name=level),
        kind,
        body,
        tuple(law for law, _, _ in found),
        small,
        tuple(mm for _, mm, _ in found),
        int(rng.integers(2**31)),
        bool(rng.integers(6) == 0),
        tuple(answer for _, _, answer in found),
        room,
    )


def _level(kind: str, number: int, rng: np.random.Generator) -> Level:
    """Return the camera and background of a case: in turn for nulls and singles, else drawn."""
    slow = replace(REAL, shiver_mm=0.10, shiver_deg=0.05, memory_s=float(rng.uniform(4.0, 12.0)))
    tails = replace(REAL, point_mm=0.15, tails=2.3)
    kinds = [EASY, REAL, tails, slow, REAL, replace(REAL, lost=0.03), REAL]
    chosen = (
        kinds[number % len(kinds)] if kind in ("null", "single") else kinds[int(rng.integers(4))]
    )
    return replace(chosen, moves_mm=REAL.moves_mm)


def _restless(kind: str, number: int, body: Body, rng: np.random.Generator) -> tuple[Law, ...]:
    """Return the noise of irregularly bending bodies: 0.15 to 0.4 mm of command a frame."""
    if kind not in ("null", "single") or number % 7 != 4:
        return ()
    size = tuple(rng.uniform(0.15, 0.4, body.channels) * (1.0 if kind == "null" else 0.5))
    return (BendingNoise(size, float(rng.choice([0.02, 0.2])), int(rng.integers(2**31))),)


def _room(kind: str, number: int) -> Room:
    """Return the temperature that the run declares."""
    if (
        kind in ("null", "single")
        and number % 7 == 6
        and not (kind == "single" and _needs_heat(number))
    ):
        return partial(_jumping, seed=number)
    if kind == "trap" and number % len(TRAPS) in HEATED:
        return partial(_by_chance, course=COURSES[HEATED.index(number % len(TRAPS))])
    return temperature


def _needs_heat(number: int) -> bool:
    return CONTROLS[number % len(CONTROLS)] == "thermal_softening"


def _jumping(t: Floats, seed: int) -> Floats:
    """Return temperatures (T,) °C that jump about every 7 s and have no effect."""
    levels = np.random.default_rng([seed, 31]).uniform(15.0, 45.0, 2000)
    return np.asarray(levels[np.clip((t / 7.0).astype(int), 0, 1999)])


def _by_chance(t: Floats, course: str) -> Floats:
    """Return a temperature (T,) °C that follows the gain by chance."""
    return np.asarray(20.0 + 10.0 * profile(course, t))


Hidden = tuple[Law, float, Answer]


def _hidden(
    level: str, kind: str, number: int, body: Body, hard: Level, rng: np.random.Generator
) -> list[Hidden]:
    """Return the hidden laws of a case, their displacement of the finger, and the right answers."""
    if kind == "null":
        return []
    if kind == "single":
        return [_known(CONTROLS[number % len(CONTROLS)], body, hard, rng)]
    if kind == "pair":
        beside = mapped(number, body, rng) if number % 2 else _strange(number // 2, body, hard, rng)
        return [_known(BESIDE[number % len(BESIDE)], body, hard, rng), beside]
    if kind == "unknown":
        return [mapped(number, body, rng) if level == "maps" else _strange(number, body, hard, rng)]
    if kind == "trap":
        return [TRAPS[number % len(TRAPS)](body, rng)]
    raise KeyError(f"no kind '{kind}'; there are null, single, pair, unknown, trap")


def _known(name: str, body: Body, hard: Level, rng: np.random.Generator) -> Hidden:
    """Draw a law of the library; a pulley turns one and a half times at least."""
    kind = SmallPulley if name == "eccentric_pulley" else KNOWN[name]
    law, moved = drawn(kind, body, hard, rng)
    return law, moved, answer_for(name)


class SmallPulley(OffCentre):
    """An eccentric spool for which the range of the protocol is 1.5 turns and more."""

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> SmallPulley:
        return cls(0.5, float(rng.uniform(1.9, 2.5)), tuple(rng.uniform(0, 2 * np.pi, channels)))


def _strange(number: int, body: Body, hard: Level, rng: np.random.Generator) -> Hidden:
    """Draw a law that is in no library."""
    law, moved = drawn(UNKNOWN_LAWS[number % len(UNKNOWN_LAWS)], body, hard, rng)
    return law, moved, Answer(unknown_family(law))


def mapped(number: int, body: Body, rng: np.random.Generator) -> Hidden:
    """Draw a smooth map (four of five) or a cross term, scaled by its curved part.

    Offsets and gains cannot represent that part.
    """
    crossed = number % CROSSED == CROSSED - 1
    count = number // CROSSED if crossed else number - number // CROSSED
    law: Law = (
        CrossTerm.of(count, rng, body.channels)
        if crossed
        else SmoothMap.of(count, rng, body.channels)
    )
    share = 1.0 if crossed else curved_share(law)
    target = float(rng.uniform(*BENT_MM)) / max(share, 0.2)
    plain = seen(body, (), standard_protocol(2), False, every=body.every, rough=True)
    law, moved = strengthened(law, target, body, plain)
    return law, moved, Answer(unknown_family(law))


def curved_share(law: Law) -> float:
    """Return the share of a map beyond offsets and gains, on the standard protocol.

    It is on the commands of that protocol.
    """
    protocol = standard_protocol(2)
    record = Record(protocol.t, protocol.command, temperature(protocol.t), protocol.gravity)
    u = law.drive(record, protocol.command)
    return bent(
        protocol.command, law.pull(record, np.concatenate([u, -u], axis=1))[:, : u.shape[1]]
    )


# --- traps --------------------------------------------------------------------------------------

Trap = Callable[[Body, np.random.Generator], Hidden]


def _scaled_trap(
    law: Law, low: float, high: float, answer: Answer, body: Body, rng: np.random.Generator
) -> Hidden:
    plain = seen(body, (), standard_protocol(2), False, every=body.every, rough=not law.SHAPE)
    law, moved = strengthened(law, float(rng.uniform(low, high)), body, plain)
    return law, moved, answer


def _frame(body: Body, rng: np.random.Generator) -> Hidden:
    law = FrameNoise.draw(rng, body.channels)
    answer = Answer(
        unknown_family(law),
        ("camera_drift", "mount"),
        ("camera_drift", "mount"),
        ("identified", "nothing", "measurement_fault", *OPEN_VERDICTS),
    )
    return _scaled_trap(law, 0.3, 1.0, answer, body, rng)


def _bending(body: Body, rng: np.random.Generator) -> Hidden:
    law = replace(
        BendingNoise.draw(rng, body.channels), memory_s=float(rng.choice([3.0, 20.0, 60.0, np.inf]))
    )
    return _scaled_trap(
        law, 0.4, 1.2, Answer(unknown_family(law), verdicts=("nothing", *OPEN_VERDICTS)), body, rng
    )


def _timely(course: str) -> Trap:
    def trap(body: Body, rng: np.random.Generator) -> Hidden:
        law = TimelyGain.of(course, rng)
        return _scaled_trap(
            law, 0.8, 2.0, Answer(unknown_family(law), verdicts=OPEN_VERDICTS), body, rng
        )

    return trap


def _modulus(body: Body, rng: np.random.Generator) -> Hidden:
    law = OtherModulus.draw(rng, body.channels)
    names = ("uniform_stiffness", "softness", "stiffness", "modulus", "uniform_softness")
    verdicts = ("identified", "nothing", *OPEN_VERDICTS)
    return _gross(law, Answer(unknown_family(law), names, names, verdicts), body)


def _longer(body: Body, rng: np.random.Generator) -> Hidden:
    law = LongerBody.draw(rng, body.channels)
    return _gross(
        law,
        Answer(unknown_family(law), ("scale",), (), ("measurement_fault", *OPEN_VERDICTS)),
        body,
    )


def _mixed(body: Body, rng: np.random.Generator) -> Hidden:
    law = MixedChannels.draw(rng, body.channels)
    names = ("coupling", "routing")
    verdicts = ("identified", "measurement_fault", *OPEN_VERDICTS)
    return _gross(law, Answer(unknown_family(law), names, names, verdicts), body)


def _still(body: Body, rng: np.random.Generator) -> Hidden:
    return _gross(
        Still.draw(rng, body.channels),
        Answer((), verdicts=("measurement_fault", "cannot_tell")),
        body,
    )


def _stuck(body: Body, rng: np.random.Generator) -> Hidden:
    law = Stuck.draw(rng, body.channels)
    answer = Answer(
        unknown_family(law), verdicts=("measurement_fault", "partly_explained", "cannot_tell")
    )
    return _gross(law, answer, body)


def _gross(law: Law, answer: Answer, body: Body) -> Hidden:
    """Return a law at its full size, and its displacement of the finger."""
    plain = seen(body, (), standard_protocol(2), False, every=body.every, rough=not law.SHAPE)
    there = seen(body, (law,), standard_protocol(2), False, every=body.every, rough=not law.SHAPE)
    return law, rms(sections(there - plain, body.place)), answer


TRAPS: tuple[Trap, ...] = (
    _frame,
    _timely("ramp"),
    _bending,
    _still,
    _modulus,
    _timely("step"),
    _mixed,
    _stuck,
    _longer,
    _timely("exponential"),
)
HEATED = (1, 5, 9)  # of the traps: those whose temperature follows the gain
