"""Score a diagnosis by family: the law's family, claims and false claims.

The document's `families` are a list of {name, …}, strongest first; a document without them names
none. *Claimed* is a name with a probability above one half, or a static map above the finger's own
background with an open law. A verdict is *falsely identified* if it is `identified` with a wrong
name for the hidden law. The right answers are in the truth of a case: `answers`, one for each
hidden law (`answers.py`). Pinned by tests/benches/test_bank_judge.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benches.bank.answers import fits_family, matches

SURE = 0.5  # probability above which a name is more than a candidate
STATIC = "static map"
# keys of a family's displacement of the finger
SIZES = ("moved_mm", "displacement_mm", "size_mm")


def names_alike(alike: Mapping[str, set[str]], truth: Mapping[str, Any]) -> dict[str, set[str]]:
    """Return, per hidden law, the right names: those of its answer and their equivalents."""
    found = {name: set(others) for name, others in alike.items()}
    for law, answer in zip(truth["hidden"], truth["answers"]):
        right = [name for name in alike if matches(name, answer["names"])]
        found[law] = {law}.union(*(alike[name] for name in right)) if right else {f"unknown {law}"}
    return found


def by_family(
    document: Mapping[str, Any], truth: Mapping[str, Any], like: Mapping[str, set[str]]
) -> dict[str, Any]:
    """Return the score of a diagnosis `document` by family.

    Args:
        document: document of the diagnosis.
        truth: truth of the case.
        like: right names of each hidden law (`names_alike`).
    """
    families = list(document.get("families") or [])
    said = [str(family["name"]) for family in families]
    named = [*document["effects"], *document["faults"]]
    right = set(truth["also"]).union(*(like[name] for name in truth["hidden"]))
    for answer in truth["answers"]:
        right |= {e["name"] for e in named if matches(e["name"], answer["also"])}
    identified = document["verdict"] == "identified"
    wrong = [e["name"] for e in named if e["name"] not in right]
    claims = [e["name"] for e in named if e.get("probability") is None or e["probability"] >= SURE]
    answered = document["verdict"] in truth["verdicts"] and not (identified and wrong)
    return {
        "families": said,
        "family_right": _family_right(said, truth["answers"]),
        "claimed": bool(claims)
        or any(_open_map(family, truth["background_mm"], bool(named)) for family in families),
        "identified": identified,
        "false_identified": identified and bool(wrong),
        "answered": answered,
        "beside": _beside(
            [e["name"] for e in named], [n for n in wrong if n in claims], truth, like, answered
        ),
    }


def _beside(
    named: list[str],
    wrong: list[str],
    truth: Mapping[str, Any],
    like: Mapping[str, set[str]],
    answered: bool,
) -> bool | None:
    """Return whether a pair's known law is named, the other left open, without wrong claims.

    None without an unknown law.
    """
    known = [name for name, answer in zip(truth["hidden"], truth["answers"]) if answer["names"]]
    if not known or len(known) == len(truth["hidden"]):
        return None
    return answered and not wrong and all(any(name in like[law] for name in named) for law in known)


def _family_right(said: list[str], answers: list[dict[str, Any]]) -> bool | None:
    """Return whether the first families are the hidden laws', one each; None if none are."""
    wanted = [answer for answer in answers if answer["families"]]
    if not wanted:
        return None
    if len(wanted) == 1:
        return bool(said) and fits_family(said[0], wanted[0])
    left = list(said[: len(wanted) + 1])
    for answer in wanted:
        found = next((name for name in left if fits_family(name, answer)), None)
        if found is None:
            return False
        left.remove(found)
    return True


def _open_map(family: Mapping[str, Any], background_mm: float, named: bool) -> bool:
    """Return whether a static map above the background is reported with its law open."""
    if str(family["name"]).lower().replace("_", " ") != STATIC or named:
        return False
    sizes = [float(family[key]) for key in SIZES if family.get(key) is not None]
    return not sizes or max(sizes) > background_mm
