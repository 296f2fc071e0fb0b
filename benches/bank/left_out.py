"""Leave one bank out: each slice with the constants that are best on all other slices.

Rows of several folders, each scored with one set of constants (`--set`), are compared case by case.
For each slice the constants are taken under which most answers of the other slices are right; every
slice has the same weight. The table gives the share of right answers with these and with the
shipped constants. The odds are fitted in the same way, to the claims of the other slices; *exactly
right* is the error that as many claims show by chance. The constants that ship are those of
decision.py. Pinned by tests/benches/test_bank_judge.py.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from benches.bank.judge import calibration_error, parts_of, wilson
from softmap_edge.diagnosis import decision

Row = dict[str, Any]

BASES = (0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2)  # odds against every name that are tried
DOUBTS = (0.15, 0.25, 0.35, 0.5, 0.7, 1.0, 1.5)  # the same for each doubt


def answer_is_right(row: Row) -> bool | None:
    """Return whether the answer to a case is right; None where the case does not count."""
    if row["kind"] == "null":
        return not row["claimed"]
    if row["beside"] is not None:
        return bool(row["beside"])
    if row["kind"] == "single":
        return bool(row["first"]) and not row["false_identified"] if row["scored"] else None
    if row["kind"] == "pair":
        return bool(row["exact"])
    if row["kind"] in ("unknown", "trap"):
        return bool(row["answered"])
    return None


def share_right(rows: Iterable[Row]) -> tuple[int, int]:
    """Return how many answers are right, of how many that count."""
    answers = [right for row in rows if (right := answer_is_right(row)) is not None]
    return sum(answers), len(answers)


def chosen(sets: Mapping[str, Mapping[str, Sequence[Row]]], part: str) -> str:
    """Return the constants with the largest mean share of right answers on all parts but one.

    Args:
        sets: rows by constants and by part; the shipped constants come first and win a tie.
        part: the part that is left out.
    """

    def mean(parts: Mapping[str, Sequence[Row]]) -> float:
        shares = [
            hits / count
            for name, rows in parts.items()
            if name != part
            for hits, count in [share_right(rows)]
            if count
        ]
        return float(np.mean(shares)) if shares else 0.0

    return max(sets, key=lambda name: mean(sets[name]))


def doubts_of(probability: float) -> float:
    """Return the doubts about a claim, in units of one alternative, from its probability.

    It is by the shipped odds.
    """
    return max(0.0, (1.0 / probability - 1.0 - decision.ODDS_BASE) / decision.ODDS_DOUBT)


def fitted_odds(claims: Sequence[Row]) -> tuple[float, float]:
    """Return the odds against every name, and for each doubt, under which claims are likeliest."""
    doubts = np.array([doubts_of(claim["probability"]) for claim in claims])
    true = np.array([claim["itself"] for claim in claims], bool)

    def unlikely(odds: tuple[float, float]) -> float:
        p = 1.0 / (1.0 + odds[0] + odds[1] * doubts)
        return -float(np.sum(np.log(np.where(true, p, 1.0 - p))))

    return min(product(BASES, DOUBTS), key=unlikely)


def claims_of(rows: Iterable[Row]) -> list[Row]:
    """Return the claims that have a probability."""
    return [claim for row in rows for claim in row["claims"] if claim["probability"] is not None]


def with_odds(claims: Sequence[Row], base: float, doubt: float) -> list[Row]:
    """Return claims with the probabilities that other odds give."""
    return [
        {**c, "probability": 1.0 / (1.0 + base + doubt * doubts_of(c["probability"]))}
        for c in claims
    ]


def by_chance(claims: Sequence[Row], draws: int = 200) -> float:
    """Return the mean calibration error of as many claims with exact probabilities.

    This is the error by chance.
    """
    rng, p = np.random.default_rng(0), np.array([claim["probability"] for claim in claims])
    luck = rng.uniform(size=(draws, len(p))) < p
    return float(
        np.mean(
            [
                calibration_error([{"probability": q, "itself": t} for q, t in zip(p, row)])
                for row in luck
            ]
        )
    )


def text(sets: Mapping[str, Sequence[Row]]) -> str:
    """Return the tables of right answers and calibration, parts with others' constants."""
    shared = set.intersection(
        *({row["case"] for row in rows if "failed" not in row} for rows in sets.values())
    )
    by_part = {
        name: parts_of([row for row in rows if row["case"] in shared])
        for name, rows in sets.items()
    }
    shipped = next(iter(by_part))
    lines = [f"answers that are right, {len(shared)} cases, per cent (95 %)", ""]
    lines += [f"{'constants':<26}" + "".join(f"{part:>22}" for part in by_part[shipped])]
    for name, parts in by_part.items():
        lines.append(
            f"{name:<26}"
            + "".join(f"{_share(parts.get(part, [])):>22}" for part in by_part[shipped])
        )
    best = {part: chosen(by_part, part) for part in by_part[shipped]}
    lines.append(
        f"{'best on the other slices':<26}"
        + "".join(f"{_share(by_part[best[part]][part]):>22}" for part in best)
    )
    lines += [
        f"{'':<26}" + "".join(f"{best[part]:>22}" for part in best),
        "",
        "calibration error, per cent",
        "",
    ]
    claims = {part: claims_of(rows) for part, rows in by_part[shipped].items()}
    claims = {part: own for part, own in claims.items() if own}
    claims["all"] = [claim for own in claims.values() for claim in own]
    lines.append(
        f"{'odds':<26}" + "".join(f"{f'{part} ({len(own)})':>22}" for part, own in claims.items())
    )
    lines.append(
        f"{'shipped':<26}"
        + "".join(f"{100 * calibration_error(own):>22.0f}" for own in claims.values())
    )
    lines.append(
        f"{'exactly right':<26}"
        + "".join(f"{100 * by_chance(own):>22.0f}" for own in claims.values())
    )
    del claims["all"]
    fits = {
        part: fitted_odds([c for other, own in claims.items() if other != part for c in own])
        for part in claims
    }
    again = {part: with_odds(own, *fits[part]) for part, own in claims.items()}
    again["all"] = [claim for own in again.values() for claim in own]
    lines.append(
        f"{'fitted to the others':<26}"
        + "".join(f"{100 * calibration_error(own):>22.0f}" for own in again.values())
    )
    lines.append(
        f"{'':<26}" + "".join(f"{f'{base:g}, {doubt:g}':>22}" for base, doubt in fits.values())
    )
    return "\n".join(lines)


def _share(rows: Sequence[Row]) -> str:
    hits, count = share_right(rows)
    low, high = wilson(hits, count)
    return (
        f"{100 * hits / count:.0f} ({100 * low:.0f} to {100 * high:.0f}), {count}" if count else "-"
    )
