"""The words of a diagnosis: its verdict, its sentence, and doubts about what it names.

Every error says mm RMS, and fitted or held out. Pinned by tests/test_report.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from softmap_edge.diagnosis.evidence import LEFT_R2, Leftover, Untestable

GROSS = 2.0  # times as far as any physics that faults must move the body for them to be the verdict
UNTESTABLE_SHARE = 1 / 3  # of the candidates that may be untestable before "nothing" becomes "cannot tell"


@dataclass(frozen=True)
class OwnMisfit:
    """Effects that the model has already, which fit the run much better with other numbers: mm RMS, after held out."""

    names: tuple[str, ...]
    before_mm: float
    after_mm: float

    def __str__(self) -> str:
        return (
            f"the model's own {' + '.join(self.names)} does not fit this run: "
            f"`softmap refit` alone takes its {self.before_mm:.2f} mm RMS (nothing fitted) to "
            f"{self.after_mm:.2f} mm RMS (held out)"
        )


def verdict_of(
    physics: list[dict[str, Any]],
    faults: list[dict[str, Any]],
    doubts: list[Any],
    unknown: bool,
    hidden: list[Untestable],
    count: int,
) -> str:
    """Return the verdict on entries of effects and faults; `physics` is `faults` where these may be physics.

    Args:
        doubts: rivals and whatever else speaks against what is named. unknown: whether something else is left.
        hidden: effects that the run could not have shown, of `count` candidates.
    """
    if unknown:
        return "partly_explained"
    if physics and faults and physics is not faults and _moved(faults) > GROSS * _moved(physics):
        return "measurement_fault"
    if physics:
        return "ambiguous" if doubts else "identified"
    if faults:
        return "measurement_fault"
    return "cannot_tell" if len(hidden) >= UNTESTABLE_SHARE * count else "nothing"


def _moved(entries: list[dict[str, Any]]) -> float:
    return max(float(e["displacement_mm"]["fitted"]) for e in entries)


def sentence_of(
    verdict: str,
    physics: list[dict[str, Any]],
    faults: list[dict[str, Any]],
    rivals: list[dict[str, Any]],
    left: Leftover,
    hidden: list[Untestable],
    error: dict[str, Any],
    demoted: Sequence[str],
) -> str:
    """Return the verdict as a sentence: what is named, its rivals, by how much the held-out error falls."""
    names = " + ".join([*map(_said, faults), *(e["name"] for e in physics)])
    at_fault = " + ".join(map(_said, faults))
    wrong = f"the measurement is at fault ({at_fault})" if faults else ""
    lacks = f"the model lacks {' + '.join(e['name'] for e in physics)}" if physics else ""
    found = ", and ".join(filter(None, [wrong, lacks]))
    found = found[:1].upper() + found[1:]
    after = error["ladder"][-1]["value"] if error["ladder"] else error["model"]
    fall = f"the held-out error falls from {error['model']:.2f} to {after:.2f} mm RMS"
    judge = error["held_out_on"]
    lost = f" Dropped, because the error on {judge} did not fall: {', '.join(demoted)}." if demoted else ""
    cannot = f" These data cannot show {', '.join(h.name for h in hidden)}." if hidden else ""
    by = left.predicted_by if left.blocked_r2 >= LEFT_R2 else "none of its conditions"
    unknown = f"{left.rms_mm:.2f} mm RMS (fitted) are left that {by} predicts"
    if verdict == "identified":
        return f"{found}; {fall}.{lost}"
    if verdict == "ambiguous":
        also = "; ".join(dict.fromkeys(" + ".join(r["effects"]) for r in rivals))
        other = f"a rival that these data do not rule out ({also})" if rivals else "something that looks like it"
        return f"{found} or {other}; {fall}.{lost}"
    if verdict == "partly_explained" and names:
        return f"{found}, and something is missing that is not among the candidates: {unknown}; {fall}.{lost}"
    if verdict == "partly_explained":
        return f"Something that is not among the candidates is missing: {unknown}.{lost}"
    if verdict == "measurement_fault":
        return f"{found if physics else f'The measurement is at fault, not the model: {names}'}; {fall}.{lost}"
    if verdict == "cannot_tell":
        return (
            f"Nothing above the floor is seen, and these data could not show {', '.join(h.name for h in hidden)}.{lost}"
        )
    stays = f"{error['model']:.2f} mm RMS (held out)"
    return f"Nothing above the floor: no candidate explains the {stays} that are left.{cannot}{lost}"


def _said(fault: dict[str, Any]) -> str:
    """Name a fault, and what its case means where it has one."""
    meanings = [p["meaning"] for p in fault["params"].values() if p.get("meaning")]
    return ": ".join([fault["name"], *meanings])


def at_bounds(entries: list[dict[str, Any]]) -> list[str]:
    """Return a doubt for each number that the fit left at its bound."""
    return [
        f"{label} is at its bound of {p['value']:.3g}{'' if p['unit'] == '1' else ' ' + p['unit']}: "
        "the true value lies beyond, or another effect acts"
        for entry in entries
        for label, p in entry["params"].items()
        if p["at_bound"]
    ]
