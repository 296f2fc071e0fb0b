"""Write the report of a diagnosis document for a terminal: text only, no colour, 100 columns.

Bars of one block share a scale, so their lengths are comparable. Every number has its unit, and
every error the data it was measured on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeVar

from softmap_edge.diagnosis.document import VERDICTS, Diagnosis
from softmap_edge.diagnosis.family_text import LEARNED, family_lines, learned_line
from softmap_edge.diagnosis.findings import Certificate, read
from softmap_edge.files.atomic import Document
from softmap_edge.files.numbers import LARGEST, bar, folded, mm, number, percent, tamed
from softmap_edge.run.in_unit import PLACES, in_unit, output_of, unit_of

Row = TypeVar("Row")


def diagnosis_text(document: Document) -> str:
    """Return the report of a diagnosis document.

    Args:
        document: the result of `Diagnosis.to_dict()`, of this or the previous schema.

    Returns:
        str: lines of at most 100 columns.

    Raises:
        ReportError: not a diagnosis document.
    """
    known = Diagnosis.from_dict(document).to_dict()
    document, unit = in_unit(known), unit_of(known["made_from"])
    lines = [f"Verdict: {VERDICTS.get(document['verdict'], document['verdict'])}"]
    lines += folded(tamed(document.get("sentence", "")), 2)
    lines += family_lines(document, unit)
    for title, key in (
        (f"Faults of the measurement ({PARAMETERS})", "faults"),
        (f"Missing effects, in order of importance ({PARAMETERS})", "effects"),
    ):
        rows = document.get(key) or []
        if rows:
            lines += ["", title]
        for row in rows:
            lines += _effect_lines(row, unit)
    lines += _list_lines(LEARNED, document.get("learned_in"), learned_line)
    lines += _ladder_lines(document.get("error") or {})
    lines += _noise_lines(known["made_from"], unit)
    servos = [servo_row(row) for row in document.get("servo") or []]
    lines += _list_lines("Servos: between command and encoder", servos, ": ".join)
    lines += _list_lines(
        "Alternatives: other explanations of these data", document["alternatives"], _alternative
    )
    lines += _list_lines("Not testable with these data", untestable_rows(document), _untestable)
    lines += _list_lines("About the run", document.get("remarks"), tamed)
    lines += _unexplained_lines(document.get("unexplained") or {}, unit)
    lines += _list_lines("Next experiment", document.get("next"), _next)
    return "\n".join(line.rstrip() for line in lines)


PARAMETERS = "fitted, ± 1 σ of the scatter alone; ratios have no unit"
FEW = 3  # effects with one reason that a row names before the reason
STATIC_ADDED = "+ static baseline"
STATIC_NOTE = (
    "The static baseline is a polynomial of the command, fitted to the remaining error: "
    "what it cannot remove depends on history or on conditions."
)
OUTPUT_NOTE = f"Measured over all outputs. {STATIC_NOTE}"
LADDER_NOTE = (
    "Measured at the middles of the body's sections, or at the markers; a comparison takes every "
    f"point. {STATIC_NOTE}"
)


def ladder_steps(error: Document) -> list[tuple[str, float]]:
    """Return the steps of a diagnosis's error ladder as (what, mm), the model alone first.

    Args:
        error: the entry `error` of a diagnosis document.

    Returns:
        list: the steps with finite values, in the order of addition.
    """
    steps = [
        ("model alone", error.get("model")),
        ("static baseline only", error.get("static_residual")),
    ]
    steps += [(f"+ {row.get('added', '?')}", row.get("value")) for row in error.get("ladder") or []]
    steps.append((STATIC_ADDED, error.get("with_static_residual")))
    return [(name, known) for name, value in steps if (known := number(value)) is not None]


def _effect_lines(row: Document, place_unit: str) -> list[str]:
    shift = row.get("displacement_mm") or {}
    head = f"  {row.get('name', '?')}  ({row.get('family', '?')}, stage {row.get('stage', '?')})"
    held = shift.get("held_out")
    facts = [
        *(
            []
            if row.get("probability") is None
            else [f"probability {percent(row['probability'])} (fitted)"]
        ),
        f"{percent(row.get('share'))} of the explained error",
        f"effect size {mm(shift.get('fitted'))} {place_unit} RMS (fitted)"
        + ("" if held is None else f", {mm(held)} {place_unit} RMS (held out)"),
    ]
    lines = [head, *folded(" · ".join(facts), 6)]
    for label, value in (row.get("params") or {}).items():
        bound = "   at its bound" if value.get("at_bound") else ""
        lines.append(f"      {label:<26} {parameter(value)}{bound}")
    return [*lines, *(part for line in [*again(row), *confirmed(row)] for part in folded(line, 6))]


def again(row: Document) -> list[str]:
    """Return a sentence on the model parameters refitted with an effect, if any."""
    changed = (row.get("refitted") or {}).get("params") or {}
    return (
        [f"with {len(changed)} numbers of the model itself fitted again; `softmap add` brings them"]
        if changed
        else []
    )


def confirmed(row: Document) -> list[str]:
    """Return a sentence on the evidence of the withheld blocks for an effect, if known."""
    return (
        [str(read(Certificate, row["certificate"], "certificate"))]
        if row.get("certificate")
        else []
    )


def parameter(value: Document) -> str:
    """Return a fitted parameter as 'value ± sigma unit', with as many digits as sigma allows."""
    best, sigma, unit = (
        number(value.get("value")),
        value.get("sigma") or 0.0,
        str(value.get("unit") or ""),
    )
    unit = "" if unit == "1" else unit  # a plain number
    if best is None:
        return "–"
    if isinstance(value.get("meaning"), str):
        return f"{best:.0f}: {value['meaning']}"
    if number(sigma) is None or sigma <= 0:
        return f"{best:.4g} {unit}".rstrip() + " (uncertainty not known)"
    if max(abs(best), sigma) >= LARGEST:
        return f"{best:.3g} ± {sigma:.2g} {unit}".rstrip()
    digits = min(max(1 - math.floor(math.log10(sigma)), 0), 9)
    return f"{best:.{digits}f} ± {sigma:.{digits}f} {unit}".rstrip()


def servo_row(row: Document) -> tuple[str, str]:
    """Format an entry of `servo` as (channel, effects and held-out error before and after)."""
    error, unit = row.get("error") or {}, str(row.get("unit") or "")
    found = [
        f"{label.split('[')[0]} {parameter(value)}"
        for effect in row.get("effects") or []
        for label, value in effect["params"].items()
    ]
    before, after = f"{mm(error.get('model'))} {unit}", f"{mm(error.get('value'))} {unit}"
    what = (
        f"{', '.join(found)}; {before} to {after}" if found else f"follows its command to {before}"
    )
    return f"channel {row.get('channel', '?')}", f"{what} (held-out RMS)"


def _ladder_lines(error: Document) -> list[str]:
    steps = ladder_steps(error)
    if not steps:
        return []
    unit, kind = error.get("unit", "mm"), error.get("kind", "held-out rms")
    on = f" on {error['held_out_on']}" if error.get("held_out_on") else ""
    scale = max(value for _, value in steps)
    lines = ["", f"Error ladder ({kind}{on}, {unit})"]
    lines += [f"  {name:<30}{mm(value):>8}  {bar(value, scale, 40)}" for name, value in steps]
    floor = number(error.get("floor"))
    if floor is not None:
        lines.append(f"  {'floor':<30}{mm(floor):>8}  {'░' * len(bar(floor, scale, 40))}")
        lines += folded(f"floor: {error.get('floor_kind', 'origin not stated')}", 2)
    lines += folded(LADDER_NOTE if unit == PLACES else OUTPUT_NOTE, 2)
    known = [
        ("noise floor", error.get("noise_floor")),
        ("model's own held-out error", error.get("model_floor")),
    ]
    parts = [f"{name} {mm(value)} {unit} RMS" for name, value in known if number(value) is not None]
    return [*lines, *([f"  {' · '.join(parts)}"] if parts else [])]


def _noise_lines(made_from: Document, unit: str) -> list[str]:
    """Return the noise of a point of each run, as `check` and `compare` report it."""
    output, values = output_of(made_from), made_from.get("noise_of_points_mm")
    given = (
        [value for value in values if number(value) is not None] if isinstance(values, list) else []
    )
    if not given:
        return []
    sizes = ", ".join(mm(value if output is None else output.value(value)) for value in given)
    return folded(
        f"noise of a point, as `softmap check` and `softmap compare` report it: {sizes} {unit} RMS",
        2,
    )


def _list_lines(title: str, rows: Sequence[Row] | None, text: Callable[[Row], str]) -> list[str]:
    if not rows:
        return []
    lines = ["", title]
    for row in rows:
        wrapped = folded(text(row), 4)
        lines += ["  · " + wrapped[0].lstrip(), *wrapped[1:]] if wrapped else []
    return lines


def alternative_name(row: Document) -> str:
    """Return the name of an alternative: its effects, or the family without a known law."""
    return " + ".join(map(str, row.get("effects") or [])) or str(row.get("family") or "?")


def _alternative(row: Document) -> str:
    return f"{alternative_name(row)}: {tamed(row.get('why', ''))}"


def untestable_rows(document: Document) -> list[tuple[str, str, str]]:
    """Return what a diagnosis cannot test as (effects, why, experiment).

    Effects with the same reason share a row: more than FEW are counted, then named.
    """
    rows: dict[tuple[str, str], list[str]] = {}
    for row in document.get("not_testable") or []:
        reason = (str(row.get("why") or ""), str(row.get("experiment") or ""))
        rows.setdefault(reason, []).append(str(row.get("name", "?")))
    return [_grouped(names, *reason) for reason, names in rows.items()]


def _grouped(names: Sequence[str], why: str, experiment: str) -> tuple[str, str, str]:
    """Return effects with one reason as a row: many by their number, their names after it."""
    if len(names) <= FEW:
        return ", ".join(names), why, experiment
    return f"{len(names)} effects", f"{why.rstrip('. ')}: {', '.join(names)}", experiment


def _untestable(row: tuple[str, str, str]) -> str:
    names, why, experiment = row
    remedy = f" To test it: {experiment}." if experiment else ""
    return f"{names}: {why}".rstrip(". ") + "." + remedy.replace("..", ".")


def _next(row: Document) -> str:
    minutes, separation = row.get("minutes"), row.get("separation")
    # a limit of the model has no recording
    took = f" ({minutes:g} min)" if isinstance(minutes, (int, float)) and minutes else ""
    apart = (
        f", expected separation {separation:.3g} (chi², simulated)"
        if isinstance(separation, (int, float))
        else ""
    )
    settles = row.get("settles")
    named = (
        ", ".join(map(str, settles)) if isinstance(settles, (list, tuple)) else str(settles or "")
    )
    return f"{row.get('block', '?')}{took}{': settles ' + named if named else ''}{apart}"


def _unexplained_lines(left: Document, unit: str) -> list[str]:
    if not left:
        return []
    chi, r2 = left.get("chi2_per_n"), left.get("blocked_r2")
    facts = [f"{mm(left.get('rms_mm'))} {unit} RMS beyond the noise (fitted)"]
    facts += (
        [f"chi²/n {chi:.3g} (fitted; 1 is noise alone)"] if isinstance(chi, (int, float)) else []
    )
    facts += (
        [f"predictable share R² {r2:.2g} (held-out blocks)"] if isinstance(r2, (int, float)) else []
    )
    ordinary = number(left.get("ordinary_mm"))
    facts += (
        [f"ordinary imperfections of this robot: {mm(ordinary)} {unit} RMS, no discovery"]
        if ordinary
        else []
    )
    by = left.get("predicted_by")
    named = ", ".join(map(str, by)) if isinstance(by, (list, tuple)) else str(by or "")
    facts += [f"follows {named}"] if named else []
    return ["", "Unexplained error", *folded(" · ".join(facts), 2)]
