"""Word a diagnosis: its verdict, its sentence, and doubts about the named effects.

Every error is in mm RMS, and marked as fitted or held out. Pinned by tests/report/test_report.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from softmap_edge.diagnosis.findings import (
    Alternative,
    ErrorLadder,
    FamilyFinding,
    Finding,
    Unexplained,
    Untestable,
)

GROSS = 2.0  # ratio of fault to physics effect size that makes a fault the verdict
# of the candidates: more untestable ones turn "nothing" into "inconclusive"
UNTESTABLE_SHARE = 1 / 3
NAMED = 6  # effects without a test that the sentence names
LEFT_R2 = 0.12  # share above which a condition is named as a predictor of the unexplained error


@dataclass(frozen=True)
class OwnMisfit:
    """The model's own effects, if other parameters fit the run much better.

    Errors are in mm RMS; the error after the fit is held out.
    """

    names: tuple[str, ...]
    before_mm: float
    after_mm: float

    def __str__(self) -> str:
        return (
            f"the model's own {' + '.join(self.names)} does not fit this run: `softmap model "
            f"refit` alone takes its {self.before_mm:.2f} mm RMS (nothing fitted) to "
            f"{self.after_mm:.2f} mm RMS (held out)"
        )


def verdict_of(
    physics: Sequence[Finding],
    faults: Sequence[Finding],
    doubtful: bool,
    unknown: bool,
    detected: bool,
    hidden: int,
    count: int,
) -> str:
    """Return the verdict.

    Args:
        physics: effects found, or faults that may be physics.
        faults: measurement faults.
        doubtful: whether there is evidence against a name.
        unknown: whether an unexplained error remains.
        detected: whether a family was detected.
        hidden: number of effects that the run could not show.
        count: number of candidates.
    """
    if unknown:
        return "partly_explained"
    if physics and faults and physics is not faults and _moved(faults) > GROSS * _moved(physics):
        return "measurement_fault"
    if physics or (detected and not faults):
        return "ambiguous" if doubtful else "identified"
    if faults:
        return "measurement_fault"
    return "cannot_tell" if hidden >= UNTESTABLE_SHARE * count else "nothing"


def _moved(findings: Sequence[Finding]) -> float:
    return max(f.displacement_mm.fitted or 0.0 for f in findings)


def sentence_of(
    verdict: str,
    physics: Sequence[Finding],
    faults: Sequence[Finding],
    families: Sequence[FamilyFinding],
    alternatives: Sequence[Alternative],
    left: Unexplained,
    hidden: Sequence[Untestable],
    error: ErrorLadder,
    demoted: Sequence[str],
    hint: str = "",
) -> str:
    """Return the verdict as a sentence: named effects, alternatives, fall of the held-out error.

    `hint` is the nearest family if none is accepted.
    """
    fall = f"the held-out error falls from {error.before:.2f} to {error.after:.2f} mm RMS"
    lost = (
        f" Dropped, because the error on {error.held_out_on} did not fall: {', '.join(demoted)}."
        if demoted
        else ""
    )
    found = _found(physics, faults, families)
    if verdict == "identified":
        return f"{found}; {fall}.{lost}"
    if verdict == "ambiguous":
        others = dict.fromkeys(
            " + ".join(a.effects) if a.effects else f"a law of the family {a.family}"
            for a in alternatives
        )
        other = (
            f", or an alternative that these data cannot exclude ({'; '.join(others)})"
            if others
            else ""
        )
        return f"{found}{other}; {fall}.{lost}"
    if verdict == "partly_explained":
        by = (
            left.predicted_by if (left.blocked_r2 or 0.0) >= LEFT_R2 and left.predicted_by else None
        )
        rest = f"{left.rms_mm:.2f} mm RMS (fitted) remain unexplained"
        rest += f" and follow {by}" if by else ""
        falls = f"; {fall}" if physics or faults else ""
        nearest = f" (nearest family: {hint})" if hint else ""
        return f"{found or f'Something unknown is missing{nearest}'}; {rest}{falls}.{lost}"
    if verdict == "measurement_fault":
        fault = f"The measurement is at fault, not the model: {_names(faults)}"
        return f"{found if physics else fault}; {fall}.{lost}"
    first = sorted(hidden, key=lambda one: one.of_model)  # another recording can show the others
    names = ", ".join(h.name for h in first[:NAMED])
    names += f" and {len(hidden) - NAMED} more effects" if len(hidden) > NAMED else ""
    above = "the noise floor"
    if left.ordinary_mm is not None and left.ordinary_mm > (error.floor or 0.0):
        above += (
            f" and the ordinary imperfections of a robot ({left.ordinary_mm:.2f} mm RMS, static)"
        )
    if verdict == "cannot_tell":
        return f"No effect exceeds {above}. These data cannot show {names}.{lost}"
    stays = f"{error.before:.2f} mm RMS (held out)"
    cannot = f" These data cannot show {names}." if hidden else ""
    return f"No effect exceeds {above}: no candidate explains the remaining {stays}.{cannot}{lost}"


def _found(
    physics: Sequence[Finding], faults: Sequence[Finding], families: Sequence[FamilyFinding]
) -> str:
    """Return the findings: faults, named effects by family, families of open or unknown law."""
    parts = [f"the measurement is at fault ({_names(faults)})"] if faults else []
    named = {f.name for f in (*physics, *faults)}
    settled = [
        f.name
        for f in physics
        if not any(f.name in g.effects and g.law != "identified" for g in families)
    ]
    if settled:
        parts.append(f"the model lacks {' + '.join(settled)}")
    for family in families:
        if family.law == "open":
            fits = [e for e in family.effects if e not in named] + [
                e for e in family.effects if e in named
            ]
            among = (
                f"; candidates: {', '.join([*fits, *family.generic])}"
                if (*fits, *family.generic)
                else ""
            )
            kind = (
                "a static, non-linear map of the commands"
                if family.name == "static map"
                else family.name
            )
            parts.append(f"{kind} of {family.moved_mm:.2f} mm RMS, law open{among}")
        elif family.law == "unknown":
            others = f" (or {', '.join(family.alternatives)})" if family.alternatives else ""
            share = (
                f", {100.0 * family.law_share:.0f} % of it" if family.law_share is not None else ""
            )
            near = (
                f" (nearest in the library: {', '.join(family.effects)}{share})"
                if family.effects
                else ""
            )
            parts.append(
                f"an unknown law of the family {family.name}{others}, {family.moved_mm:.2f} mm "
                f"RMS{near}"
            )
    text = "; and ".join(parts)
    return text[:1].upper() + text[1:]


def _names(faults: Sequence[Finding]) -> str:
    """Return the names of faults, with the meaning of a case if there is one."""
    return " + ".join(
        ": ".join([f.name, *(p.meaning for p in f.params.values() if p.meaning)]) for f in faults
    )


def at_bounds(findings: Sequence[Finding]) -> list[str]:
    """Return a doubt for each parameter at its bound."""
    return [
        f"{label} is at its bound of {p.value:.3g}{'' if p.unit == '1' else ' ' + p.unit}: "
        "the true value lies beyond, or another effect acts"
        for finding in findings
        for label, p in finding.params.items()
        if p.at_bound
    ]


def unconfirmed(claims: Sequence[Finding | FamilyFinding]) -> list[str]:
    """Return a doubt for each claim that the withheld blocks do not confirm."""
    return [
        f"{c.name} is {c.certificate}"
        for c in claims
        if c.certificate is not None and c.certificate.refuted
    ]
