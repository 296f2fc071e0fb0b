"""Scores of the diagnoses of cases, and their table: goal, measured, 95 % interval, n.

A law counts as named if it has the largest share of the explained error and is unique: every
alternative contains it, or a structural equivalent under the conditions of the run (`alike`: by the
registry, not by the diagnosis). Two equivalent hidden laws need one name. A law that the library or
this model does not have is reported as *not in the library*. A run is *flagged* if the diagnosis
reports an unknown error, or a fault of the measurement that no effect names. Intervals are
Wilson's:

    (p + z²/2n ± z √(p(1−p)/n + z²/4n²)) / (1 + z²/n),   z = 1.96

Fall = (before − after)/(before − floor) of the RMS error (mm) over all visible points of a run of
another kind; the floor is the same finger without hidden laws. Pinned by
tests/benches/test_bank.py.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

Row = Mapping[str, Any]


def alike(registry: Sequence[Row], orientations: int, roll: bool = True) -> dict[str, set[str]]:
    """Return the equivalents of each effect without a declared load, including itself.

    `orientations` of the run, and whether it shows the `roll` of the body.
    """
    found = {effect["name"]: {effect["name"]} for effect in registry}
    resolved = {
        word
        for word, seen in (("roll", roll), ("orientation", orientations > 1), ("base", True))
        if seen
    }
    for effect in registry:
        for other, resolved_by in effect["alike"].items():
            if other in found and resolved_by not in resolved:
                found[effect["name"]].add(other)
                found[other].add(effect["name"])
    return found


def judged(
    hidden: Sequence[str],
    document: Mapping[str, Any],
    alike: Mapping[str, set[str]],
    expressible: set[str],
    also: Sequence[str] = (),
) -> dict[str, Any]:
    """Score a diagnosis `document` on a finger with `hidden` laws.

    `alike` are the structural equivalents of each effect, `expressible` the effects of the library
    that this model supports, `also` further effects of the hidden laws, which may be named.
    """
    groups = [sorted(document[kind], key=lambda e: -e["share"]) for kind in ("effects", "faults")]
    entries = [
        e
        for group in groups[:: -1 if document["verdict"] == "measurement_fault" else 1]
        for e in group
    ]
    named = [e["name"] for e in entries]
    others = [set(a["effects"]) for a in document["alternatives"] if a["effects"]]
    like = {name: alike.get(name, {name}) for name in hidden}
    right = [e["name"] in also or any(e["name"] in like[name] for name in hidden) for e in entries]
    top = named[0] if named else None
    alone = bool(named) and any(
        top in like[n] and all(other & like[n] for other in others) for n in hidden
    )
    said = set(named).union(*others)
    open_ = {h["name"] for h in document["not_testable"]}
    settles = {name for block in document["next"] for name in block["settles"]}
    asked = all(like[n] & settles for n in hidden)
    nameless = document["verdict"] == "measurement_fault" and not named
    honest = document["verdict"] in ("ambiguous", "cannot_tell", "nothing") and all(
        like[n] & (open_ | settles | (said if others else set())) for n in hidden
    )
    return {
        "verdict": document["verdict"],
        "named": named,
        "alternatives": [sorted(other) for other in others],
        "why": [a["why"] for a in document["alternatives"]],
        "not_testable": sorted(open_),
        "next": [{"block": b["block"], "settles": b["settles"]} for b in document["next"]],
        "in_library": all(like[n] & expressible for n in hidden),
        "first": alone,
        "equivalent": any(top in like[n] for n in hidden),
        "exact": _told(set(named), like, also),
        "inside": any(_told(s, like, also) for s in [set(named), *others]),
        "claims": [
            {
                "name": e["name"],
                "probability": e["probability"],
                "true": ok,
                "itself": e["name"] in {*hidden, *also},
            }
            for e, ok in zip(entries, right)
        ],
        "flagged": document["verdict"] == "partly_explained" or nameless,
        "asked": asked,
        "cannot": honest and asked,
    }


def _told(named: set[str], like: Mapping[str, set[str]], also: Sequence[str]) -> bool:
    """Whether each hidden law has its own name among those named, and there are no others.

    Equivalent hidden laws share a name.
    """
    left, hidden = set(named), list(like)
    apart = [
        n for i, n in enumerate(hidden) if not any(n in like[earlier] for earlier in hidden[:i])
    ]
    for names in (like[n] for n in apart):
        if not left & names:
            return False
        left.remove(min(left & names, key=lambda name: (name in also, name)))
    rest = left - set(also)
    return rest <= set().union(*like.values()) and len(rest) <= len(hidden) - len(apart)


def wilson(hits: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """Return the 95 % interval of a share."""
    if n == 0:
        return 0.0, 1.0
    p = hits / n
    middle, half = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, float((middle - half) / (1 + z * z / n))), min(
        1.0, float((middle + half) / (1 + z * z / n))
    )


def calibration_error(claims: Sequence[Row], bins: int = 10) -> float:
    """Return the expected calibration error of claims `{probability, itself}`.

    It is Σ share |mean p − share true| by bin.

    A probability belongs to one effect, not to its structural equivalents. A rod's claims have
    none.
    """
    claims = [c for c in claims if c["probability"] is not None]
    if not claims:
        return 0.0
    p = np.array([c["probability"] for c in claims])
    true = np.array([c["itself"] for c in claims], float)
    which = np.minimum((p * bins).astype(int), bins - 1)
    return float(
        sum(abs(p[which == b].sum() - true[which == b].sum()) for b in range(bins)) / len(p)
    )


def confusion(rows: Sequence[Row]) -> dict[str, Counter[str]]:
    """Return, per law hidden alone, counts of first names (`-` nothing, `+?` flagged)."""
    found: dict[str, Counter[str]] = {}
    for row in rows:
        if row["kind"] == "single":
            top = row["named"][0] if row["named"] else "-"
            found.setdefault(row["hidden"][0], Counter())[
                top + ("+?" if row["flagged"] else "")
            ] += 1
    return found


Measure = tuple[str, str, Callable[[Row], bool], Callable[[Row], bool]]


def _is(*kinds: str, known: bool | None = True) -> Callable[[Row], bool]:
    return lambda row: row["kind"] in kinds and (known is None or row["in_library"] == known)


def _scored(row: Row) -> bool:
    return row["kind"] == "single" and bool(row["scored"])


def _unknown(row: Row) -> bool:
    return row["kind"] == "unknown" and row["family_right"] is not None


SHARES: tuple[Measure, ...] = (
    ("single, twice its background: right name first", "≥ 90 %", _scored, lambda r: r["first"]),
    (
        "single, twice its background: right family",
        "≥ 97 %",
        lambda r: _scored(r) and r["family_right"] is not None,
        lambda r: r["family_right"],
    ),
    (
        "'identified' that is false",
        "≤ 2 %",
        lambda r: r["identified"],
        lambda r: r["false_identified"],
    ),
    (
        "nothing hidden, a name or an open map claimed",
        "≤ 3 %",
        _is("null", known=None),
        lambda r: r["claimed"],
    ),
    (
        "unknown law: left open, or flagged",
        "≥ 97 %",
        _is("unknown", known=None),
        lambda r: r["answered"],
    ),
    ("unknown law: right family", "≥ 90 %", _unknown, lambda r: r["family_right"]),
    (
        "known law with an unknown one: named, the rest open",
        "≥ 80 %",
        lambda r: r["beside"] is not None,
        lambda r: r["beside"],
    ),
    ("trap: right answer", "≥ 97 %", _is("trap", known=None), lambda r: r["answered"]),
    (
        "single effect, alone in first place",
        "≥ 98 % easy, ≥ 90 % real",
        _is("single"),
        lambda r: r["first"],
    ),
    ("exact set, pairs", "≥ 93 % A, B; ≥ 80 %", _is("pair"), lambda r: r["exact"]),
    ("truth inside the reported set", "≥ 97 %", _is("single", "pair"), lambda r: r["inside"]),
    (
        "nothing hidden, something claimed",
        "≤ 1 %",
        _is("null", known=None),
        lambda r: bool(r["named"]),
    ),
    ("false 'unknown' flags", "≤ 5 %", _is("null", "single", "pair"), lambda r: r["flagged"]),
    ("unknown law flagged", "≥ 97 %", _is("unknown", known=None), lambda r: r["flagged"]),
    (
        "true effect removed: flagged, or its equivalent named",
        "≥ 85 %",
        _is("removed", known=None),
        lambda r: r["flagged"] or r["equivalent"],
    ),
    (
        "not in the library: flagged, or its equivalent named",
        "≥ 85 %",
        lambda r: _is("single", "pair", known=False)(r) and r["beside"] is None,
        lambda r: r["flagged"] or r["equivalent"],
    ),
    (
        "not identifiable: left open, with the right experiment",
        "≥ 98 %",
        _is("untestable", known=None),
        lambda r: r["cannot"],
    ),
    (
        "alternatives resolved after the suggested experiment",
        "≥ 97 %",
        _is("rivals"),
        lambda r: r["at_first"]["asked"] and r["first"],
    ),
    (
        "clouds: twist is reported as not testable",
        "100 %",
        lambda r: r["seen"] == "clouds",
        lambda r: "twist" in r["not_testable"],
    ),
)


def table(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the measures of cases, one dict each: measure, goal, value, low, high, n."""
    done = [row for row in rows if "failed" not in row]
    found = []
    for what, goal, among, hit in SHARES:
        mine = [row for row in done if among(row)]
        if mine:
            hits = sum(bool(hit(row)) for row in mine)
            low, high = wilson(hits, len(mine))
            found.append(
                dict(
                    measure=what, goal=goal, value=hits / len(mine), low=low, high=high, n=len(mine)
                )
            )
    claims = [c for row in done if _is("null", "single", "pair")(row) for c in row["claims"]]
    strange = [
        c for row in done if _is("removed", "unknown", known=None)(row) for c in row["claims"]
    ]
    if claims:
        true = sum(c["true"] for c in claims)
        low, high = wilson(true, len(claims))
        found.append(
            dict(
                measure="claims that are true",
                goal="≥ 95 %",
                value=true / len(claims),
                low=low,
                high=high,
                n=len(claims),
            )
        )
        found.append(
            dict(
                measure="calibration error (ECE), removed and unknown laws counted",
                goal="≤ 3 %",
                value=calibration_error([*claims, *strange]),
                n=len(claims) + len(strange),
            )
        )
    fell = [
        row["fall"]
        for row in done
        if row["kind"] == "single" and row["in_library"] and row["fall"] is not None
    ]
    if fell:
        low, high = np.quantile(fell, [0.25, 0.75])
        found.append(
            dict(
                measure="fall of the held-out error, single (median, quartiles)",
                goal="≥ 90 %",
                value=float(np.median(fell)),
                low=float(low),
                high=float(high),
                n=len(fell),
            )
        )
    for what, key in (
        ("processor time of a diagnosis (median)", "seconds"),
        ("of its truth (median)", "truth_seconds"),
    ):
        times = [row[key] for row in done if row["kind"] in ("null", "single", "pair")]
        if times:
            low, high = np.quantile(times, [0.05, 0.95])
            goal = "≤ 2" if key == "seconds" else "-"
            value = float(np.median(times))
            found.append(
                dict(
                    measure=what, goal=goal, value=value, low=low, high=high, n=len(times), unit="s"
                )
            )
    return found


def parts_of(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the cases by slice and level, `A/real`."""
    found: dict[str, list[Row]] = {}
    for row in sorted(rows, key=lambda row: (row["slice"], row["level"])):
        found.setdefault(f"{row['slice']}/{row['level']}", []).append(row)
    return found


def text(rows: Sequence[Row]) -> str:
    """Return the table by slice and level, and the confusion matrix."""
    lines = []
    codes = {row.get("code") for row in rows}
    if len(codes) > 1:
        lines += [f"made by {len(codes)} states of the code: run the bank again before you compare"]
    for part, mine in parts_of(rows).items():
        lines += ["", f"slice {part}: {len(mine)} cases"]
        lines.append(f"  {'measure':<56}{'goal':<28}{'measured':>9}   95 % interval       n")
        for m in table(mine):
            scale, unit = (1.0, "s") if m.get("unit") == "s" else (100.0, "%")
            between = f"{scale * m['low']:6.1f} … {scale * m['high']:5.1f}" if "low" in m else ""
            lines.append(
                f"  {m['measure']:<56}{m['goal']:<28}{scale * m['value']:7.1f} {unit}  "
                f"{between:<16}{m['n']:>6}"
            )
        failed = [row for row in mine if "failed" in row]
        lines += [f"  failed: {row['case']}: {row['failed']}" for row in failed]
    done = [row for row in rows if "failed" not in row]
    lines += [
        "",
        "hidden alone → named first (`-` nothing, `?` something unknown is flagged as well)",
    ]
    for name, said in sorted(confusion(done).items()):
        known = all(
            row["in_library"] for row in done if row["kind"] == "single" and row["hidden"] == [name]
        )
        told = ", ".join(f"{what} {count}" for what, count in said.most_common())
        lines.append(f"  {name + ('' if known else ' (not in the library)'):<44}{told}")
    return "\n".join(lines)
