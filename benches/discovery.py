"""Test two-level discovery on the built-in finger: named, open, or silent.

`python -m benches.discovery [--jobs N] [--out FILE]` prints one table and each wrong answer;
minutes. Runs are the standard protocol on the model itself, so only the laws differ. The laws are
those of the bank (no formula of the library), and the library's own static effects. Each run is a
pure function of its number.

    map        48 smooth static maps: static, or within ordinary imperfections, and never identified
    law        each static effect of the library: its name, or the name of one that moves this
               finger alike
    play       unequal play in two servos: named, each gap within 5 %
    unknown    laws of memory, coupling, rate and temperature: the right family, and no name
               identified
    strange    a hum, a body that bends irregularly, stick-slip, creep that grows with the
               temperature: flagged
    null       noise, jitter and a gain that is off by a little: silent
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benches.bank.judge import alike, wilson
from benches.bank.law import Law, Record
from benches.bank.laws_motion import (
    FadingMemory,
    Hooked,
    Hum,
    RateBend,
    RateSquare,
    SpeedyPlay,
    StickSlip,
    Stribeck,
    played,
)
from benches.bank.laws_odd import BendingNoise
from benches.bank.laws_static import CrossTerm, SmoothMap
from benches.bank.laws_wear import Bimetal, WarmCreep, WarmPlay
from benches.bank.odd import curved_share
from benches.bank.shop import unknown_family
from softmap_edge import Diagnosis, Run, _core, builtin_model, diagnose
from softmap_edge.diagnosis.families import families
from softmap_edge.run.protocol import standard_protocol
from softmap_edge.synthetic.finger import Camera

Floats = NDArray[np.float64]

# RMS motion of the points by a hidden law; for a map, by the part beyond offsets and gains.
MOVES_MM = (0.6, 1.8)
UNKNOWN: tuple[type[Law], ...] = (
    FadingMemory,
    SpeedyPlay,
    Hooked,
    Stribeck,
    CrossTerm,
    RateSquare,
    RateBend,
    Bimetal,
    WarmPlay,
)
STRANGE: tuple[type[Law], ...] = (Hum, BendingNoise, StickSlip, WarmCreep)
TURN_MM = 2.5  # radius of the eccentric spool: this protocol turns it one and a half times
STATIC = ("static map", "coupling")
GROUPS: dict[str, int] = {
    "map": 48,
    "law": 0,
    "play": 12,
    "unknown": 4 * len(UNKNOWN),
    "strange": 16,
    "null": 24,
}


@dataclass(frozen=True)
class Hidden:
    """A run with a hidden effect, and its check: None if the answer is right, else the fault."""

    name: str
    run: Run
    wrong: Callable[[Diagnosis], str | None]


def static_laws() -> tuple[str, ...]:
    """Return the static effects of the library that the shape of the built-in finger can show."""
    registry = {e["name"]: e for e in _core.effects()}
    members = {name for family in families() if family.kind == "static" for name in family.members}
    # these need declared cameras or an obstacle, or are another form of the dead zone
    apart = ("lens", "contact", "slack")
    return tuple(name for name in registry if name in members and name not in apart)


# --- runs ---------------------------------------------------------------------------------------


def protocol_run(warm: bool = False) -> Run:
    """Return the standard protocol in the rest shape; the room warms by 9 K and cools again."""
    model, shown = builtin_model(), standard_protocol(2)
    rest = np.broadcast_to(model.rest, (shown.frames, *model.rest.shape))
    share = (shown.t - shown.t[0]) / np.ptp(shown.t)
    room = 20.0 + 9.0 * np.sin(np.pi * share) ** 2 if warm else None
    return Run(
        shown.t,
        shown.command,
        shown.t_seen,
        vertices=rest,
        gravity=shown.gravity,
        robot=model.robot,
        temperature=room,
    )


def measured(run: Run, points: Floats, rng: np.random.Generator, noise_mm: float = 0.25) -> Run:
    """Return a run with the points that a camera sees."""
    return replace(
        run, vertices=Camera(vertex_mm=noise_mm).look(points, np.asarray(run.t_seen), rng)
    )


def points_of(run: Run, law: Law, acting: Floats) -> Floats:
    """Return the points (K, N, 3) mm under a law on the commands."""
    record = Record(
        run.t,
        acting,
        np.full(len(run.t), 20.0) if run.temperature is None else np.asarray(run.temperature),
    )
    return builtin_model().predict(replace(run, command=law.drive(record, acting)))


def strong(law: Law, run: Run, target_mm: float) -> Law:
    """Return a law scaled to move the points by `target_mm` RMS, or as far as possible."""
    plain = builtin_model().predict(run)
    for _ in range(6):
        moved = float(
            np.sqrt(np.mean(np.sum((points_of(run, law, run.command) - plain) ** 2, axis=2)))
        )
        law = law.scaled(float(np.clip(target_mm / max(moved, 1e-3), 0.2, 5.0)))
    return law


# --- groups -------------------------------------------------------------------------------------


def hidden(group: str, number: int) -> Hidden:
    """Return case `number` of a group."""
    rng = np.random.default_rng([31, list(GROUPS).index(group), number])
    return {
        "map": _map,
        "law": _law,
        "play": _play,
        "unknown": _unknown,
        "strange": _strange,
        "null": _null,
    }[group](number, rng)


def _map(number: int, rng: np.random.Generator) -> Hidden:
    run, law = protocol_run(), replace(SmoothMap.of(number, rng, 2), cable=False)
    law = strong(law, run, rng.uniform(*MOVES_MM) / max(curved_share(law), 0.3))

    def wrong(found: Diagnosis) -> str | None:
        if found.verdict == "nothing" and found.unexplained.ordinary_mm:
            return None
        return identified(found) or family_of(found, STATIC)

    return Hidden(
        f"{law.form} {np.round(law.amount, 3)}",
        measured(run, points_of(run, law, run.command), rng),
        wrong,
    )


def _law(number: int, rng: np.random.Generator) -> Hidden:
    run, name, model = protocol_run(), static_laws()[number], builtin_model()
    plain = model.predict(run)
    rows = [
        row for effect in _core.effects() if effect["name"] == name for row in effect["parameters"]
    ]
    like = alike(_core.effects(), orientations=2)[name] | {name}

    def seen(share: float) -> Floats:
        labels = _core.Chain([name], 2).labels
        by_name = {row["name"]: row for row in rows}
        params = {}
        for i, label in enumerate(labels):
            row = by_name[label.split(".")[1].split("[")[0]]
            end = row["high"] if row["log"] or i % 2 == 0 or row["low"] >= 0 else row["low"]
            place = row["log"] or row["null"] is None
            params[label] = row["start"] if place else row["null"] + share * (end - row["null"])
            params[label] = TURN_MM if label == "eccentric_pulley.radius" else params[label]
        return model.with_effects([name], params).predict(run)

    def moves(share: float) -> float:
        return float(np.sqrt(np.mean(np.sum((seen(share) - plain) ** 2, axis=2))))

    target = rng.uniform(*MOVES_MM)
    share = min(
        (s for s in np.linspace(0.05, 1.0, 20)), key=lambda s: abs(moves(float(s)) - target)
    )

    def wrong(found: Diagnosis) -> str | None:
        named = {effect.name for effect in (*found.effects, *found.faults)}
        sure = found.verdict in ("identified", "ambiguous", "measurement_fault")
        return None if named and named <= like and sure else "another answer"

    return Hidden(
        f"{name}, {moves(float(share)):.2f} mm", measured(run, seen(float(share)), rng), wrong
    )


def _play(number: int, rng: np.random.Generator) -> Hidden:
    run, first = protocol_run(), rng.uniform(0.4, 1.0)
    gaps = np.array([first, first * rng.uniform(1.3, 2.2)])[:: 1 if number % 2 else -1]
    points = builtin_model().predict(replace(run, command=played(run.command, gaps / 2)))

    def wrong(found: Diagnosis) -> str | None:
        if [effect.name for effect in found.effects] != ["backlash"]:
            return "another answer"
        numbers = found.effects[0].params
        both = [numbers.get(f"backlash.gap[{c}]", numbers.get("backlash.gap")) for c in (0, 1)]
        off = max(abs(n.value / gap - 1.0) for n, gap in zip(both, gaps) if n is not None)
        return None if off <= 0.05 else f"a gap is off by {off:.0%}"

    return Hidden(f"gaps {gaps.round(2)} mm", measured(run, points, rng), wrong)


def _unknown(number: int, rng: np.random.Generator) -> Hidden:
    kind, run = UNKNOWN[number % len(UNKNOWN)], protocol_run(warm=True)
    law: Law = (
        CrossTerm.of(number // len(UNKNOWN), rng, 2) if kind is CrossTerm else kind.draw(rng, 2)
    )
    law = strong(law, run, rng.uniform(*MOVES_MM))

    def wrong(found: Diagnosis) -> str | None:
        return identified(found) or family_of(found, unknown_family(law))

    return Hidden(law.NAME, measured(run, points_of(run, law, run.command), rng), wrong)


def _strange(number: int, rng: np.random.Generator) -> Hidden:
    kind, run = STRANGE[number % len(STRANGE)], protocol_run(warm=True)
    law: Law = kind.draw(rng, 2)
    if isinstance(law, BendingNoise):
        law = replace(law, memory_s=float(rng.choice([0.02, 0.2])))
    law = strong(law, run, rng.uniform(*MOVES_MM))

    def wrong(found: Diagnosis) -> str | None:
        return identified(found) or ("not flagged" if found.verdict == "nothing" else None)

    return Hidden(law.NAME, measured(run, points_of(run, law, run.command), rng), wrong)


def _null(number: int, rng: np.random.Generator) -> Hidden:
    run = protocol_run(warm=bool(number % 2))
    off = 1.0 + rng.uniform(-0.01, 0.01, 2) * (number % 3 == 0)
    points = builtin_model().predict(replace(run, command=run.command * off))

    def wrong(found: Diagnosis) -> str | None:
        silent = (
            found.verdict in ("nothing", "cannot_tell") and not found.effects and not found.faults
        )
        return None if silent else "something is claimed"

    return Hidden("nothing", measured(run, points, rng, float(rng.choice([0.1, 0.25, 0.5]))), wrong)


# --- scored -------------------------------------------------------------------------------------


def identified(found: Diagnosis) -> str | None:
    """Return the fault of a name reported as certain if no name is right."""
    return "a name is identified" if found.verdict == "identified" else None


def family_of(found: Diagnosis, right: Sequence[str]) -> str | None:
    """Return the fault of the first family, if any."""
    first = found.families[0].name if found.families else "none"
    return None if first in right else f"family {first}"


def judged(case: tuple[str, int]) -> dict[str, Any]:
    """Diagnose one case; return hidden law, result, and fault."""
    one = hidden(*case)
    found = diagnose(builtin_model(), one.run)
    return {
        "group": case[0],
        "number": case[1],
        "hidden": one.name,
        "verdict": found.verdict,
        "wrong": one.wrong(found),
        "families": [f"{family.name} ({family.law})" for family in found.families],
        "named": [effect.name for effect in (*found.effects, *found.faults)],
        "alternatives": [list(other.effects) for other in found.alternatives],
    }


def cases(groups: Sequence[str]) -> list[tuple[str, int]]:
    """Return the cases of some groups."""
    sizes = GROUPS | {"law": len(static_laws())}
    return [(group, number) for group in groups for number in range(sizes[group])]


def text(rows: Sequence[dict[str, Any]]) -> str:
    """Return the table, and each wrong answer."""
    lines = [f"{'group':<10}{'right':>7}{'of':>5}{'95 %':>12}{'identified':>12}"]
    for group in GROUPS:
        some = [row for row in rows if row["group"] == group]
        right = sum(row["wrong"] is None for row in some)
        if some:
            low, high = wilson(right, len(some))
            sure = sum(row["verdict"] == "identified" for row in some)
            lines.append(
                f"{group:<10}{right:>7}{len(some):>5}{f'{100 * low:.0f} to {100 * high:.0f}':>12}{sure:>12}"
            )
    for row in rows:
        if row["wrong"] is not None:
            lines.append(
                f"{row['group']} {row['number']}: {row['hidden']}: {row['wrong']}; "
                f"{row['verdict']}, {', '.join(row['families']) or 'no family'}; named "
                f"{', '.join(row['named']) or 'nothing'}; or {row['alternatives']}"
            )
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="benches.discovery", description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "--groups", default=",".join(GROUPS), help="some of the groups, with commas"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes at a time")
    parser.add_argument("--out", type=Path, help="JSON lines of all answers")
    args = parser.parse_args(argv)
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "RAYON_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # one process a core
    with ProcessPoolExecutor(args.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        rows = list(pool.map(judged, cases(args.groups.split(","))))
    if args.out is not None:
        args.out.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    print(text(rows))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
