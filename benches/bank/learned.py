"""Slice *learned*: robots whose law was always present, with a model learned from them.

It is learned from their own recordings.

A finger has play, friction, slack, creep or lag, and the static imperfections of slice *shop*. A
motion capture sees it by five balls along its body. Its frame is turned about the axis by any
angle, tilted by some degrees, and has an origin that is some millimetres off. A model is learned
from a reference run (level *one*), or from that and a second run of half the size and twice the
speed (level *two*). Then a run of another kind is diagnosed. One orientation, 22 °C. A law without
memory (slack) is part of a learned static map, so nothing remains to be named. The background of a
finger is the error of a cubic map of the commands, fitted to it without its law. Units: mm, s,
degrees. A case is a pure function of (seeds, level, kind, number). Pinned by
tests/benches/test_bank_learned.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benches.bank import body_rod
from benches.bank.answers import Answer, answer_for
from benches.bank.bodies import RodBody, body_of
from benches.bank.case import Case, place_of, seen, stream, strengthened
from benches.bank.law import Floats, Law, Past
from benches.bank.laws_body import OgdenRoxburgh
from benches.bank.laws_drive import Packets
from benches.bank.laws_odd import UNKNOWN_LAWS
from benches.bank.laws_shop import (
    GuideFriction,
    SheathFriction,
    UnevenLoop,
    UnevenProny,
    UnevenSlack,
    UnevenWen,
    WornGear,
)
from benches.bank.rotations import turn
from benches.bank.section import finger
from benches.bank.shop import BACKGROUND_MM, imperfections, unknown_family
from benches.bank.watch import Level, rms, sections
from softmap_edge.run.protocol import HANGING, RATE, Protocol, standard_protocol
from softmap_edge.run.run import Run

BALLS_MM = (22.0, 44.0, 66.0, 88.0, 108.0)
SEEN_HZ = 7.0
MOVES_MM = (2.8, 5.5)
REACH = 11.0  # mm
CAMERA = Level("learned", 0.15, 0.0, 0.0, 0.0, 0.0, 0.0, MOVES_MM)
SINGLES: tuple[type[Law], ...] = (
    WornGear,
    SheathFriction,
    UnevenLoop,
    UnevenProny,
    UnevenSlack,
    GuideFriction,
    UnevenWen,
    Packets,
    WornGear,
    OgdenRoxburgh,
)
COUPLES: tuple[tuple[type[Law], type[Law]], ...] = (
    (WornGear, UnevenLoop),
    (WornGear, UnevenProny),
    (SheathFriction, Packets),
    (UnevenWen, UnevenLoop),
    (UnevenProny, Packets),
    (WornGear, Packets),
)
WITH_MEMORY = (
    "stick_slip",
    "overshoot",
    "stribeck",
    "speedy_play",
    "hooked",
    "fading_memory",
    "rate_square",
    "snap",
    "big_creep",
    "clutch",
    "rate_bend",
)
STRANGE = tuple(law for law in UNKNOWN_LAWS if law.NAME in WITH_MEMORY)
ABSORBED = ("dead_zone",)  # laws without memory: a learned static map contains them


class BalledBody(RodBody):
    """The rod finger, seen by five balls close to its axis."""

    def points(
        self,
        laws: Sequence[Law],
        pull: Floats,
        gravity: Floats,
        marked: bool,
        past: Past | None = None,
    ) -> Floats:
        if not marked:
            return super().points(laws, pull, gravity, marked, past)
        return body_rod.solved(laws, pull, gravity, past).points(finger(1), *balls())

    def rest(self, marked: bool) -> Floats:
        return body_rod.rest(balls()) if marked else super().rest(marked)


def balls() -> tuple[Floats, Floats]:
    """Return place (5,) mm of the balls along the body and offset (5, 2) mm from its axis."""
    angle = np.array([0.3, 2.0, 4.1, 5.2, 1.0])
    return np.array(BALLS_MM), 1.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@dataclass(frozen=True)
class Capture(Law):
    """R p + s: the frame of a motion capture, turned about the axis and not quite along it."""

    NAME, STRONG = "capture", ()
    about_deg: float
    tilt_deg: tuple[float, float]
    shift_mm: tuple[float, float, float]

    @classmethod
    def draw(cls, rng: np.random.Generator, channels: int) -> Capture:
        x, y, *shift = (float(v) for v in rng.normal(size=5))
        return cls(
            float(rng.uniform(0, 360)),
            (1.5 * x, 1.5 * y),
            (2 * shift[0], 2 * shift[1], 2 * shift[2]),
        )

    def seen(self, points: Floats, t: Floats) -> Floats:
        frame = turn(np.radians([*self.tilt_deg, 0.0])) @ turn(
            np.radians([0.0, 0.0, self.about_deg])
        )
        return np.asarray(points @ frame.T + np.array(self.shift_mm))


def warm(t: Floats) -> Floats:
    """Return the temperature (T,) of a room of constant temperature, °C."""
    return np.full(len(t), 22.0)


def learned_case(seeds: str, level: str, kind: str, number: int) -> tuple[Case, dict[str, Run]]:
    """Make a case and its runs.

    Raises:
        KeyError: the kind is unknown.
        ArithmeticError: a body does not settle.
    """
    rng = stream(seeds, "learned", level, kind, number)
    small = imperfections(body_of("shop"), float(rng.uniform(*BACKGROUND_MM)), rng)
    found = sorted(
        (_strong(law, rng) for law in _wanted(kind, number)), key=lambda pair: place_of(pair[0])
    )
    mine = Case(
        f"{seeds}-learned-{level}-{kind}-{number:04d}",
        CAMERA,
        kind,
        BalledBody(),
        tuple(law for law, _ in found),
        (*small, Capture.draw(rng, 2)),
        tuple(mm for _, mm in found),
        int(rng.integers(2**31)),
        True,
        tuple(_answer(law, kind) for law, _ in found),
        warm,
    )
    protocols = {"taught": reference(number, 1.0, 1.0, 90.0)}
    if level == "two":
        protocols["taught_2"] = reference(number + 1, 0.5, 2.0, 60.0)
    protocols |= {"first": targets(number, 0.9, 1.0, 60.0), "judge": circles(number, 40.0)}
    return mine, {
        name: replace(mine.run(protocol), marker_rest=None) for name, protocol in protocols.items()
    }


def uncubed_mm(mine: Case, number: int) -> float:
    """Return a cubic's error for a finger without its law: section centroids, mm RMS."""
    protocol, every = reference(number, 1.0, 1.0, 90.0), 5
    points = seen(mine.body, mine.small, protocol, False, every=every, room=mine.room)
    x, y = (np.interp(protocol.t_seen[::every], protocol.t, u) / REACH for u in protocol.command.T)
    columns = np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)
    places = sections(points, mine.body.place)
    flat = places.reshape(len(places), -1)
    left = flat - columns @ np.linalg.lstsq(columns, flat, rcond=None)[0]
    return rms(left.reshape(places.shape))


def _wanted(kind: str, number: int) -> tuple[type[Law], ...]:
    if kind == "null":
        return ()
    if kind == "single":
        return (SINGLES[number % len(SINGLES)],)
    if kind == "pair":
        return COUPLES[number % len(COUPLES)]
    if kind == "unknown":
        return (STRANGE[number % len(STRANGE)],)
    raise KeyError(f"no kind '{kind}'; there are null, single, pair, unknown")


def _strong(kind: type[Law], rng: np.random.Generator) -> tuple[Law, float]:
    body = body_of("shop")
    plain = seen(body, (), standard_protocol(2), False, every=body.every, rough=not kind.SHAPE)
    return strengthened(kind.draw(rng, body.channels), float(rng.uniform(*MOVES_MM)), body, plain)


def _answer(law: Law, kind: str) -> Answer:
    if kind == "unknown":
        return Answer(unknown_family(law))
    answer = answer_for(law.NAME)
    return (
        replace(answer, verdicts=("nothing", "cannot_tell", *answer.verdicts))
        if law.NAME in ABSORBED
        else answer
    )


# --- what is recorded ---------------------------------------------------------------------------


def reference(number: int, size: float, speed: float, seconds: float) -> Protocol:
    """Return a reference run: sums of sines, or targets with stays, in turn."""
    make = sines if number % 2 else targets
    return make(number + 7, size, speed, seconds)


def sines(number: int, size: float, speed: float, seconds: float) -> Protocol:
    """Return a run of three sines a channel, periods of 3 to 30 s at speed 1."""
    rng = np.random.default_rng([number, 1])
    t = np.arange(0.0, seconds, 1.0 / RATE)
    columns = []
    for _ in range(2):
        period, phase = (
            np.array([27.0, 9.0, 3.6]) * rng.uniform(0.8, 1.2, 3) / speed,
            rng.uniform(0, 2 * np.pi, 3),
        )
        waves = np.sin(2 * np.pi * t[:, None] / period + phase) @ np.array([0.55, 0.35, 0.2])
        columns.append(REACH * size * (waves - waves[0] * np.exp(-t / 2.0)))
    return _protocol("sines", t, np.stack(columns, axis=1), rng)


def targets(number: int, size: float, speed: float, seconds: float) -> Protocol:
    """Return a run through random targets at 4 to 25 mm/s, with stays of up to 4 s."""
    rng = np.random.default_rng([number, 2])
    corners, times = [np.zeros(2), np.zeros(2)], [0.0, 2.0]
    while times[-1] < seconds:
        target = rng.uniform(-REACH * size, REACH * size, 2) * (rng.uniform(size=2) < 0.85)
        moved = float(np.abs(target - corners[-1]).max())
        times.append(times[-1] + max(moved / (speed * rng.uniform(4.0, 25.0)), 0.1))
        times.append(times[-1] + float(rng.choice([0.05, 0.5, 4.0 / speed])))
        corners += [target, target]
    t = np.arange(0.0, seconds, 1.0 / RATE)
    u = np.stack([np.interp(t, times, [corner[c] for corner in corners]) for c in range(2)], axis=1)
    return _protocol("targets", t, u, rng)


def circles(number: int, seconds: float) -> Protocol:
    """Return a run of circles that grow and shrink, in both directions."""
    rng = np.random.default_rng([number, 3])
    t = np.arange(0.0, seconds, 1.0 / RATE)
    size = REACH * 0.9 * np.sin(np.pi * t / seconds) * (0.8 + 0.2 * np.cos(2 * np.pi * t / 11.0))
    angle = 14.0 * np.sin(2 * np.pi * t / seconds + 0.3) + rng.uniform(0, 2 * np.pi)
    return _protocol(
        "circles", t, size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), rng
    )


def _protocol(name: str, t: Floats, u: Floats, rng: np.random.Generator) -> Protocol:
    at = np.arange(0.2, t[-1] - 0.2, 1.0 / SEEN_HZ)
    at = at + rng.uniform(-0.02, 0.02, len(at))
    label = np.array([f"{name} {int(time / 10.0)}" for time in at])
    return Protocol(name, t, u, np.tile(HANGING, (len(t), 1)).astype(float), at, label)
