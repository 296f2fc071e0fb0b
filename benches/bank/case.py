"""One case of the bank: a pure function of (set of seeds, slice, level, kind, number).

    null        nothing is hidden                      unknown      a law that no library has
    single  one law  removed  one law, diagnosed without its effect
    pair  two laws  untestable  a law that this very run cannot show, or not alone
    rivals      as untestable, then with the run that was asked for

Development seeds are for setting thresholds, reporting seeds for figures; no threshold may be set
on the latter. The strength of each law is scaled until the section centroids move by what the level
says on the standard protocol. Units: s, mm, g, °C. Pinned by tests/benches/test_bank.py.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benches.bank.answers import Answer, answer_for
from benches.bank.bodies import Body, body_of
from benches.bank.law import Floats, Law, Past, Record
from benches.bank.laws_body import BODY
from benches.bank.laws_drive import DRIVE
from benches.bank.laws_unknown import UNKNOWN
from benches.bank.watch import LEVELS, Level, background, looked, names, rms, sections
from softmap_edge.run.protocol import HANGING, Protocol, other_protocol, standard_protocol
from softmap_edge.run.run import Run

SEEDS = {"development": 20_000, "reporting": 70_000}
KINDS = ("null", "single", "pair", "unknown", "removed", "untestable", "rivals")
LAWS: dict[str, type[Law]] = {**DRIVE, **BODY}
GROSS = ("servo_swap",)  # as large as they are
ONE_POSE, AT_REST = ("gravity", "payload"), ("latency", "lag", "rate_limit")
TRIES = 6  # characters drawn until one can move the finger as far as the target
MARKED = 5  # one case in so many is seen by markers
NEAR = 0.1  # of how far a law is to move the finger, which is drawn anyway: near enough
PAIRS = 4  # pairs that are drawn until each law does something next to the other


def temperature(t: Floats) -> Floats:
    """Return the declared room temperature (T,) °C: up by 9 K, a halt, then half down, slowly."""
    knots = np.array([0.0, 0.15, 0.4, 0.55, 0.75, 1.0]) * max(float(t[-1]), 1.0)
    return np.asarray(np.interp(t, knots, [22.0, 22.0, 31.0, 31.0, 25.0, 27.0]))


@dataclass(frozen=True, eq=False)
class Case:
    """A finger with its secrets, before a camera."""

    name: str
    level: Level
    kind: str
    body: Body
    laws: tuple[Law, ...]  # hidden
    small: tuple[Law, ...]  # always there
    moved_mm: tuple[float, ...]  # by each hidden law alone, section centroids
    seed: int
    marked: bool  # seen by markers, not as a surface
    # the right answer for each hidden law, or for the complete run
    answers: tuple[Answer, ...] = ()
    room: Callable[[Floats], Floats] = temperature  # (T,) s to °C, as the run declares it

    @property
    def hidden(self) -> tuple[str, ...]:
        """Return the names of the hidden laws."""
        return names(self.laws)

    def run(self, protocol: Protocol, laws: Sequence[Law] | None = None) -> Run:
        """Record a protocol; without `laws` as it is, with `()` the twin that hides nothing.

        Same noise for both.
        """
        rng = np.random.default_rng([self.seed, protocol.frames])
        acting = (*self.small, *(self.laws if laws is None else laws))
        points = seen(self.body, acting, protocol, self.marked, room=self.room)
        noisy, visible = looked(points, protocol.t_seen, self.level, rng)
        kind = (
            {"markers": noisy, "marker_rest": self.body.rest(True)}
            if self.marked
            else {"vertices": noisy}
        )
        return Run(
            t=protocol.t,
            command=protocol.command,
            gravity=protocol.gravity,
            t_seen=protocol.t_seen,
            block=protocol.block,
            temperature=self.room(protocol.t),
            robot=self.body.name,
            visible=None if visible.all() else visible,
            **kind,
        )

    @property
    def seen_as(self) -> str:
        """Return what a diagnosis gets to see."""
        return "clouds" if self.level.clouds else "markers" if self.marked else "vertices"

    def background_mm(self) -> float:
        """Return the background's displacement of the section centroids, in mm RMS.

        It is on the standard protocol.
        """
        protocol, every = standard_protocol(2), 2 * self.body.every
        own = seen(self.body, self.small, protocol, False, every=every, room=self.room)
        return rms(
            sections(own - seen(self.body, (), protocol, False, every=every), self.body.place)
        )

    def to_dict(self) -> dict[str, Any]:
        """Return what was hidden."""
        told = [
            {"name": law.NAME, "params": law.params(), "moved_mm": round(mm, 4)}
            for law, mm in zip(self.laws, self.moved_mm)
        ]
        also = [name for law in self.laws for name in law.ALSO]
        return {"case": self.name, "laws": told, "also": also, "seen": self.seen_as}


def case(seeds: str, slice_: str, level: str, kind: str, number: int) -> Case:
    """Make a case.

    Raises KeyError for an unknown word, ArithmeticError if a body does not settle.
    """
    name = f"{seeds}-{slice_}-{level}-{kind}-{number:04d}"
    rng = stream(seeds, slice_, level, kind, number)
    body, hardness = body_of(slice_), LEVELS[level]
    small = background(hardness, rng, body.channels)
    for _ in range(PAIRS):
        wanted = [
            LAWS[one] if one in LAWS else UNKNOWN[one] for one in _wanted(kind, number, rng, body)
        ]
        found = [drawn(one, body, hardness, rng) for one in wanted]
        if len(found) < 2 or each_moves([law for law, _ in found], body, hardness):
            break
    found.sort(key=lambda pair: place_of(pair[0]))
    return Case(
        name,
        hardness,
        kind,
        body,
        tuple(law for law, _ in found),
        small,
        tuple(mm for _, mm in found),
        int(rng.integers(2**31)),
        bool(rng.integers(MARKED) == 0) and not hardness.clouds,
        tuple(answer_for(law.NAME, law.NAME in LAWS) for law, _ in found),
    )


def stream(seeds: str, slice_: str, level: str, kind: str, number: int) -> np.random.Generator:
    """Return the generator from which a case is drawn."""
    return np.random.default_rng(
        [SEEDS[seeds] + number, zlib.crc32(f"{slice_} {level} {kind}".encode())]
    )


def place_of(law: Law) -> int:
    """Return the place of a law in the chain from command to camera."""
    order = list(LAWS) + list(UNKNOWN)
    return order.index(law.NAME) if law.NAME in order else len(order)


def _wanted(kind: str, number: int, rng: np.random.Generator, body: Body) -> list[str]:
    """Return what a case hides: singles go round, pairs are drawn."""
    known = [name for name in LAWS if name in body.can]
    if kind == "null":
        return []
    if kind in ("single", "removed"):
        return [known[number % len(known)]]
    if kind == "pair":
        loose = [name for name in known if name not in (*GROSS, "clock_shift")]
        return [str(name) for name in rng.choice(loose, size=2, replace=False)]
    if kind == "unknown":
        strange = [name for name in UNKNOWN if name in body.can]
        return [strange[number % len(strange)]]
    if kind == "untestable":
        choice = (*ONE_POSE, *AT_REST)
        return [choice[number % len(choice)]]
    if kind == "rivals":
        return [ONE_POSE[number % 2]]
    raise KeyError(f"no kind '{kind}'; there are {', '.join(KINDS)}")


def protocol_of(kind: str, hidden: Sequence[str], number: int) -> Protocol:
    """Return the recording of a first diagnosis: the standard protocol, or a blind one.

    The latter cannot show the hidden effect.
    """
    whole = standard_protocol(2, seed=number % 16)
    if kind in ("untestable", "rivals") and set(hidden) <= set(ONE_POSE):
        return _in_one_pose(whole)
    return at_rest(number) if kind == "untestable" else whole


def _in_one_pose(whole: Protocol) -> Protocol:
    """Return the second half of the standard protocol: one orientation, leaning."""
    leaning = np.any(whole.gravity != HANGING, axis=1)
    start = float(whole.t[np.flatnonzero(leaning)[0]])
    later, frames = whole.t >= start, whole.t_seen >= start
    return Protocol(
        "one orientation",
        whole.t[later] - start,
        whole.command[later],
        whole.gravity[later],
        whole.t_seen[frames] - start,
        whole.block[frames],
    )


def at_rest(number: int) -> Protocol:
    """Return a grid of commands seen only when settled: no motion or dwell, one history."""
    rng = np.random.default_rng([number, 5])
    targets = rng.permutation(
        np.stack(np.meshgrid(*[np.linspace(-10, 10, 7)] * 2), axis=2).reshape(-1, 2)
    )
    corners, times, now, looks, labels = (
        [np.zeros(2)],
        [0.0],
        5.0,
        [1.0, 2.0, 3.0, 4.0],
        ["home"] * 4,
    )
    times.append(now)
    corners.append(np.zeros(2))
    for k, target in enumerate(targets):
        now += max(float(np.abs(target - corners[-1]).max()) / 9.0, 0.1)
        times.append(now)
        corners.append(target)
        now += 6.0
        times.append(now)
        corners.append(target)
        looks += [now - 0.6, now - 0.3, now - 0.05]
        labels += [f"row {k // 7}"] * 3
    t = np.arange(0.0, now, 0.02)
    command = np.stack([np.interp(t, times, [c[i] for c in corners]) for i in range(2)], axis=1)
    half = t > now / 2
    gravity = np.tile(HANGING, (len(t), 1)).astype(float)
    gravity[half] = standard_protocol(2).gravity[-1]
    return Protocol("at rest", t, command, gravity, np.array(looks), np.array(labels))


def judge_protocol(number: int) -> Protocol:
    """Return the run of another kind, on which the fall of the error is measured."""
    return other_protocol(2, seed=number % 16)


def seen(
    body: Body,
    laws: Sequence[Law],
    protocol: Protocol,
    marked: bool,
    every: int = 1,
    rough: bool = False,
    room: Callable[[Floats], Floats] = temperature,
) -> Floats:
    """Return true points (K, N, 3) mm of every `every`-th frame; `rough` are unsettled."""
    laws = sorted(laws, key=place_of)
    record = Record(protocol.t, protocol.command, room(protocol.t), protocol.gravity)
    u = protocol.command
    for law in laws:
        u = law.drive(record, u)
    pull = np.concatenate([u, -u], axis=1)
    for law in laws:
        pull = law.pull(record, pull)
    labelled = protocol.t_seen[::every]
    taken = labelled
    for law in laws:
        taken = law.clock(taken)
    at = np.stack([np.interp(taken, protocol.t, column) for column in pull.T], axis=1)
    gravity = protocol.gravity[np.searchsorted(protocol.t, labelled, side="right") - 1]
    if rough:
        points = body.rough(laws, at, gravity, marked)
    else:
        past = Past(protocol.t, pull, protocol.gravity, taken)
        points = body.points(laws, at, gravity, marked, past)
    for law in laws:
        points = law.seen(points, labelled)
    return points


def each_moves(laws: Sequence[Law], body: Body, level: Level) -> bool:
    """Return whether each law still acts alongside the others: half of its least alone."""
    protocol, rough = standard_protocol(2), not any(law.SHAPE for law in laws)

    def points(acting: Sequence[Law]) -> Floats:
        return seen(body, acting, protocol, False, every=body.every, rough=rough)

    try:
        whole = points(laws)
        moved = [whole - points([other for other in laws if other is not law]) for law in laws]
    except ArithmeticError:  # together they buckle the body
        return False
    return all(
        rms(sections(m, body.place)) >= 0.5 * level.moves_mm[0] or law.NAME == "twist"
        for m, law in zip(moved, laws)
    )


def drawn(kind: type[Law], body: Body, level: Level, rng: np.random.Generator) -> tuple[Law, float]:
    """Draw a law and scale it to move section centroids by the level's target, mm RMS."""
    low, high = level.moves_mm
    best: tuple[Law, float] | None = None
    plain = seen(body, (), standard_protocol(2), False, every=body.every, rough=not kind.SHAPE)
    for _ in range(TRIES):
        character = kind.draw(rng, body.channels)
        found = strengthened(character, float(rng.uniform(low, high)), body, plain)
        if kind.NAME in GROSS or low * 0.8 <= found[1] <= 1.2 * high:
            return found
        if best is None or abs(np.log(max(found[1], 1e-6) / low)) < abs(
            np.log(max(best[1], 1e-6) / low)
        ):
            best = found
    assert best is not None
    return best


def strengthened(
    character: Law,
    target: float,
    body: Body,
    plain: Floats,
    room: Callable[[Floats], Floats] = temperature,
) -> tuple[Law, float]:
    """Return a law scaled to move the section centroids by `target` mm RMS, and its displacement.

    `plain` are the points of the finger without the law on the standard protocol, every
    `body.every`-th frame, rough where the law leaves the body unchanged. A twist turns sections
    without moving their centres; for it the points count.
    """
    protocol, gross = standard_protocol(2), not character.STRONG or character.NAME in GROSS
    strength, tried = 1.0, [(0.0, 0.0)]  # strengths, and their displacements of the sections
    for _ in range(1 if gross else 7):
        acting, rough = (character.scaled(strength),), not character.SHAPE
        try:
            there = seen(body, acting, protocol, False, every=body.every, rough=rough, room=room)
        except ArithmeticError:  # at this strength the body buckles
            strength *= 0.6
            continue
        moved = there - plain
        reached = max(
            rms(sections(moved, body.place)), rms(moved) if character.NAME == "twist" else 0.0
        )
        tried.append((strength, reached))
        if abs(reached - target) < NEAR * target or gross:
            break
        step = np.clip(target / max(reached, 1e-6), 0.25, 4.0)
        if strength >= character.LIMIT and step > 1.0:
            break
        ahead = float(min(strength * step, character.LIMIT))
        below = max(s for s, r in tried if r < target)
        above = min((s for s, r in tried if r >= target), default=np.inf)
        strength = ahead if below < ahead < above else float((below + above) / 2)
    strength, reached = min(tried[1:] or tried, key=lambda pair: abs(pair[1] - target))
    return character.scaled(strength), reached
