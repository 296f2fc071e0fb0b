"""Reports for a terminal: a comparison, two comparisons side by side, a diagnosis. Text only, no colour, 100 columns.

Takes the Python objects or the documents that `to_dict()` gives. Bars of one block share one scale, so that their
lengths may be compared; every number says its unit, and every error what it was measured on.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from softmap_edge.errors import ReportError
from softmap_edge.report.numbers import BAR, LARGEST, bar, fall, mm, number, percent, tamed

if TYPE_CHECKING:
    from softmap_edge.diagnosis.comparison import Bin, Comparison

WIDTH = 100
VERDICTS = {
    "identified": "identified",
    "ambiguous": "ambiguous: more than one effect fits",
    "partly_explained": "partly explained: something unknown is left",
    "nothing": "nothing above the floor",
    "cannot_tell": "these data cannot tell",
    "measurement_fault": "measurement fault",
}
# What each map is called when it stands in a report.
WHERE = {
    "section": "along the body",
    "direction": "direction of motion",
    "speed": "speed",
    "dwell": "time since the last motion",
    "history": "largest past |command|",
    "command": "command",
    "time": "time",
    "orientation": "orientation",
    "temperature": "temperature",
}


def comparison_text(comparison: Comparison) -> str:
    """Return the report of one comparison: figures first, then where the error lives.

    Args:
        comparison: what `compare` gave.

    Returns:
        str: lines of at most 100 columns.
    """
    error, floor = comparison.error, comparison.noise_floor_mm
    effects = ", ".join(comparison.bundle.get("effects", [])) or "none added"
    lines = [
        f"Model of '{comparison.bundle.get('robot', '?')}' (effects: {effects}) against a run of "
        f"'{comparison.run.get('robot', '?')}', {comparison.frames} frames seen",
        "",
        "Distance between predicted and measured points, mm (nothing was fitted here)",
    ]
    named = [
        ("rms", "rms_mm"),
        ("median", "median_mm"),
        ("95 %", "p95_mm"),
        ("max", "max_mm"),
        ("tip rms", "tip_rms_mm"),
    ]
    scale = max(error[key] for _, key in named)
    lines += [f"  {label:<12}{mm(error[key]):>7}  {bar(error[key], scale)}" for label, key in named]
    lines.append(f"  {'noise floor':<12}{mm(floor):>7}  {bar(floor or 0.0, scale)}")
    lines += _folded(f"floor: {comparison.made_from.get('noise_floor', 'origin not stated')}", 2)
    lines += ["", f"Where the error is (RMS mm; full bar = {mm(_top([comparison]))} mm)"]
    scale = _top([comparison])
    for name, rows in comparison.where.items():
        if len(rows) < 2:
            continue
        lines.append(f"  {WHERE.get(name, name)}")
        for row in rows:
            lines.append(f"    {row.label:<26}{mm(row.rms_mm):>7}  {bar(row.rms_mm, scale):<{BAR}}  {row.n:>5} frames")
    lines += ["", *_worst_lines(comparison)]
    return "\n".join(line.rstrip() for line in lines)


def pair_text(before: Comparison, after: Comparison) -> str:
    """Return two comparisons of one run side by side on one scale, and how far the error fell.

    Args:
        before, after: comparisons of the same run by two models.

    Returns:
        str: lines of at most 100 columns.

    Raises:
        ReportError: they are of different runs.
    """
    check_pair(before, after)
    floor = before.noise_floor_mm
    old, new = before.error["rms_mm"], after.error["rms_mm"]
    added = [name for name in after.bundle.get("effects", []) if name not in before.bundle.get("effects", [])]
    gone = [name for name in before.bundle.get("effects", []) if name not in after.bundle.get("effects", [])]
    change = "; ".join(f"{word}: {', '.join(names)}" for word, names in (("added", added), ("removed", gone)) if names)
    lines = [
        f"Two models of '{before.bundle.get('robot', '?')}' on one run, {before.frames} frames seen, nothing "
        + "is fitted here"
        + (f" ({change})" if change else ""),
        "",
        *_folded(_pair_sentence(old, new, floor), 0),
        "",
        f"  {'mm':<26}{'before':>8}{'after':>8}   {'fall':>6}",
    ]
    for label, key in (("rms", "rms_mm"), ("median", "median_mm"), ("95 %", "p95_mm"), ("max", "max_mm")):
        lines.append(_pair_row(label, before.error[key], after.error[key]))
    lines.append(_pair_row("tip rms", before.error["tip_rms_mm"], after.error["tip_rms_mm"]))
    lines += [f"  {'noise floor':<26}{mm(floor):>8}{mm(floor):>8}"]
    scale = _top([before, after])
    lines += ["", f"Where (RMS mm before, after; █ left, ░ fallen, ▓ risen; full bar = {mm(scale)} mm)"]
    for name, rows in before.where.items():
        partners = {row.label: row for row in after.where.get(name, [])}
        if len(rows) < 2:
            continue
        lines.append(f"  {WHERE.get(name, name)}")
        for row in rows:
            lines.append(_pair_line(row, partners.get(row.label), scale))
    return "\n".join(line.rstrip() for line in lines)


def check_pair(before: Comparison, after: Comparison) -> None:
    """Raise ReportError unless both comparisons are of the same run."""
    first, second = before.run.get("sha256"), after.run.get("sha256")
    if first != second:
        raise ReportError(
            f"before and after are of different runs ({str(first)[:8]}, {str(second)[:8]}); compare both models on one"
        )


def diagnosis_text(document: Mapping[str, Any]) -> str:
    """Return the report of a diagnosis document softmap.diagnosis/1.

    Args:
        document: what `Diagnosis.to_dict()` gave.

    Returns:
        str: lines of at most 100 columns.

    Raises:
        ReportError: it is not such a document.
    """
    check_diagnosis(document)
    lines = [f"Verdict: {VERDICTS.get(document['verdict'], document['verdict'])}"]
    lines += _folded(tamed(document.get("sentence", "")), 2)
    for title, key in (
        (f"Faults of the measurement ({PARAMETERS})", "faults"),
        (f"Missing effects, in order of importance ({PARAMETERS})", "effects"),
    ):
        rows = document.get(key) or []
        if rows:
            lines += ["", title]
        for row in rows:
            lines += _effect_lines(row)
    lines += _ladder_lines(document.get("error") or {})
    servos = [servo_row(row) for row in document.get("servo") or []]
    lines += _list_lines("Servos: between command and encoder", servos, ": ".join)
    lines += _list_lines("Rivals: what explains these data as well", document.get("rivals"), _rival)
    lines += _list_lines("Not testable with these data", untestable_rows(document), _untestable)
    lines += _list_lines("About the run", document.get("remarks"), tamed)
    lines += _unexplained_lines(document.get("unexplained") or {})
    lines += _list_lines("Next experiment", document.get("next"), _next)
    return "\n".join(line.rstrip() for line in lines)


def check_diagnosis(document: Any) -> None:
    """Raise ReportError unless `document` has the schema softmap.diagnosis/1 and its entries have its shape."""
    schema = document.get("schema") if isinstance(document, Mapping) else None
    if schema != "softmap.diagnosis/1" or not isinstance(document.get("verdict"), str):
        raise ReportError(f"this is no diagnosis: schema {schema!r}, expected 'softmap.diagnosis/1' with a verdict")
    for key in ("where", "error", "unexplained", "made_from"):
        _demand(document.get(key) or {}, Mapping, key)
    for key in ("effects", "faults", "servo", "rivals", "not_testable", "next"):
        for row in _demand(document.get(key) or [], list, key):
            _demand(row, Mapping, f"an entry of {key}")
    for text in _demand(document.get("remarks") or [], list, "remarks"):
        _demand(text, str, "a remark")
    named = [*(document.get("effects") or []), *(document.get("faults") or [])]
    for row in document.get("servo") or []:
        _demand(row.get("error") or {}, Mapping, "error of a servo")
        named += _demand(row.get("effects") or [], list, "effects of a servo")
    for row in named:
        _demand(_demand(row, Mapping, "an effect").get("displacement_mm") or {}, Mapping, "displacement_mm")
        _demand(row.get("name"), str, "the name of an effect")
        again = _demand(row.get("refitted") or {"params": {}}, Mapping, "refitted")
        params = _demand(row.get("params"), Mapping, "params"), _demand(again.get("params"), Mapping, "refitted params")
        for label, value in (item for group in params for item in group.items()):
            if number(_demand(value, Mapping, "an entry of params").get("value")) is None:
                raise ReportError(f"damaged diagnosis: {label} has no finite value; make it again")
    for row in document.get("rivals") or []:
        _demand(row.get("effects") or [], list, "effects of a rival")
    for row in _demand((document.get("error") or {}).get("ladder") or [], list, "ladder"):
        _demand(row, Mapping, "a step of the ladder")
    for moment in ("before", "after"):
        maps = _demand((document.get("where") or {}).get(moment) or {}, Mapping, f"where.{moment}")
        for name, rows in maps.items():
            for row in _demand(rows, list, f"where.{moment}.{name}"):
                if number(_demand(row, Mapping, f"a bin of {name}").get("rms_mm")) is None or "label" not in row:
                    raise ReportError(f"damaged diagnosis: a bin of {name} has no label or rms_mm; make it again")


def _demand(value: Any, kind: Any, name: str) -> Any:
    if not isinstance(value, kind):
        raise ReportError(
            f"damaged diagnosis: {name} is {type(value).__name__}, expected {kind.__name__}; make it again"
        )
    return value


PARAMETERS = "parameters fitted, ± 1 σ; ratios have no unit"
STATIC_ADDED = "+ static correction"
LADDER_NOTE = (
    "Measured at the middles of the body's sections, or at the markers; a comparison takes every point. "
    "A static correction is a polynomial of the command fitted to what is left: "
    "what it cannot remove depends on history or on conditions."
)


def ladder_steps(error: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Return the steps of a diagnosis's error ladder as (what, mm), the model alone first.

    Args:
        error: the entry `error` of a diagnosis document.

    Returns:
        list: steps whose value is a finite number, in the order in which things were added.
    """
    steps = [("model alone", error.get("model")), ("static correction only", error.get("static_residual"))]
    steps += [(f"+ {row.get('added', '?')}", row.get("value")) for row in error.get("ladder") or []]
    steps.append((STATIC_ADDED, error.get("with_static_residual")))
    return [(name, known) for name, value in steps if (known := number(value)) is not None]


def _top(comparisons: Sequence[Comparison]) -> float:
    values = [row.rms_mm for c in comparisons for rows in c.where.values() if len(rows) > 1 for row in rows]
    return max([v for v in values if math.isfinite(v)], default=0.0)


def _folded(text: str, indent: int) -> list[str]:
    pad = " " * indent
    return textwrap.wrap(text, WIDTH, initial_indent=pad, subsequent_indent=pad)


def _worst_lines(comparison: Comparison) -> list[str]:
    frame = comparison.worst.get("frame") or {}
    bins = comparison.worst.get("bins") or []
    named = "; ".join(f"{WHERE.get(b['where'], b['where'])} {b['label']} ({mm(b['rms_mm'])} mm)" for b in bins)
    lines = _folded(f"Worst: {named}." if named else "", 0)
    if frame:
        lines += _folded(
            f"Worst frame: number {frame['index']} at {frame['t_s']:.2f} s, {mm(frame['rms_mm'])} mm RMS.", 0
        )
    return lines


def _pair_sentence(old: float, new: float, floor: float | None) -> str:
    if new > old:
        return f"The error ROSE from {mm(old)} to {mm(new)} mm RMS: the second model is worse on this run."
    share, removable = fall(old, new), fall(old, new, floor) if floor and new > floor else None
    text = f"The error falls from {mm(old)} to {mm(new)} mm RMS ({percent(share)})"
    return text + (
        f"; of what lies above the camera's noise, {percent(removable)} is gone." if removable is not None else "."
    )


def _pair_row(label: str, old: float, new: float) -> str:
    return f"  {label:<26}{mm(old):>8}{mm(new):>8}   {percent(fall(old, new)):>6}"


def _pair_line(row: Bin, partner: Bin | None, scale: float) -> str:
    """One bin before and after on one line: solid is what is left, light what fell, dark what rose."""
    after = math.nan if partner is None else partner.rms_mm
    both = bar(max(row.rms_mm, after), scale, 40) if math.isfinite(after) else bar(row.rms_mm, scale, 40)
    kept = len(bar(min(row.rms_mm, after), scale, 40)) if math.isfinite(after) else 0
    shown = "█" * kept + ("▓" if after > row.rms_mm else "░") * (len(both) - kept)
    return f"    {row.label:<24}{mm(row.rms_mm):>8}{mm(after):>8}   {shown}"


def _effect_lines(row: Mapping[str, Any]) -> list[str]:
    shift = row.get("displacement_mm") or {}
    head = f"  {row.get('name', '?')}  ({row.get('family', '?')}, stage {row.get('stage', '?')})"
    held = shift.get("held_out")
    facts = [
        *([] if row.get("probability") is None else [f"probability {percent(row['probability'])} (fitted)"]),
        f"{percent(row.get('share'))} of what is explained (fitted)",
        f"moves the body by {mm(shift.get('fitted'))} mm RMS (fitted)"
        + ("" if held is None else f", {mm(held)} mm RMS (held out)"),
    ]
    lines = [head, *_folded(" · ".join(facts), 6)]
    for label, value in (row.get("params") or {}).items():
        bound = "   at its bound" if value.get("at_bound") else ""
        lines.append(f"      {label:<26} {parameter(value)}{bound}")
    return [*lines, *(f"      {line}" for line in again(row))]


def again(row: Mapping[str, Any]) -> list[str]:
    """Return a sentence on the numbers of the model that were fitted again with an effect, if there are any."""
    changed = (row.get("refitted") or {}).get("params") or {}
    return (
        [f"with {len(changed)} numbers of the model itself fitted again; `softmap add` brings them"] if changed else []
    )


def parameter(value: Mapping[str, Any]) -> str:
    """Return a fitted parameter as 'value ± sigma unit', with as many digits as its sigma allows."""
    best, sigma, unit = number(value.get("value")), value.get("sigma") or 0.0, str(value.get("unit") or "")
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


def servo_row(row: Mapping[str, Any]) -> tuple[str, str]:
    """Return what an entry of `servo` says as (channel, effects and the held-out error before and after)."""
    error, unit = row.get("error") or {}, str(row.get("unit") or "")
    found = [
        f"{label.split('[')[0]} {parameter(value)}"
        for effect in row.get("effects") or []
        for label, value in effect["params"].items()
    ]
    before, after = f"{mm(error.get('model'))} {unit}", f"{mm(error.get('value'))} {unit}"
    what = f"{', '.join(found)}; {before} to {after}" if found else f"follows its command to {before}"
    return f"channel {row.get('channel', '?')}", f"{what} (held-out RMS)"


def _ladder_lines(error: Mapping[str, Any]) -> list[str]:
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
        lines += _folded(f"floor: {error.get('floor_kind', 'origin not stated')}", 2)
    lines += _folded(LADDER_NOTE, 2)
    known = [("noise floor", error.get("noise_floor")), ("model's own held-out error", error.get("model_floor"))]
    told = [f"{name} {mm(value)} {unit} RMS" for name, value in known if number(value) is not None]
    return [*lines, *([f"  {' · '.join(told)}"] if told else [])]


def _list_lines(title: str, rows: Any, text: Any) -> list[str]:
    if not rows:
        return []
    lines = ["", title]
    for row in rows:
        wrapped = _folded(text(row), 4)
        lines += ["  · " + wrapped[0].lstrip(), *wrapped[1:]] if wrapped else []
    return lines


def _rival(row: Mapping[str, Any]) -> str:
    return f"{' + '.join(map(str, row.get('effects') or ['?']))}: {tamed(row.get('why', ''))}"


def untestable_rows(document: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return what a diagnosis cannot test as (effects, why, experiment), effects of one reason in one row."""
    rows: dict[tuple[str, str], list[str]] = {}
    for row in document.get("not_testable") or []:
        reason = (str(row.get("why") or ""), str(row.get("experiment") or ""))
        rows.setdefault(reason, []).append(str(row.get("name", "?")))
    return [(", ".join(names), *reason) for reason, names in rows.items()]


def _untestable(row: tuple[str, str, str]) -> str:
    names, why, experiment = row
    remedy = f" To test it: {experiment}." if experiment else ""
    return f"{names}: {why}".rstrip(". ") + "." + remedy.replace("..", ".")


def _next(row: Mapping[str, Any]) -> str:
    minutes, separation = row.get("minutes"), row.get("separation")
    took = f" ({minutes:g} min)" if isinstance(minutes, (int, float)) else ""
    apart = f", expected separation {separation:.3g} (chi², simulated)" if isinstance(separation, (int, float)) else ""
    settles = row.get("settles")
    named = ", ".join(map(str, settles)) if isinstance(settles, (list, tuple)) else str(settles or "")
    return f"{row.get('block', '?')}{took}{': settles ' + named if named else ''}{apart}"


def _unexplained_lines(left: Mapping[str, Any]) -> list[str]:
    if not left:
        return []
    chi, r2 = left.get("chi2_per_n"), left.get("blocked_r2")
    facts = [f"{mm(left.get('rms_mm'))} mm RMS beyond the noise (fitted)"]
    facts += [f"chi²/n {chi:.3g} (fitted; 1 is noise alone)"] if isinstance(chi, (int, float)) else []
    facts += [f"predictable share R² {r2:.2g} (held-out blocks)"] if isinstance(r2, (int, float)) else []
    by = left.get("predicted_by")
    named = ", ".join(map(str, by)) if isinstance(by, (list, tuple)) else str(by or "")
    facts += [f"follows {named}"] if named else []
    return ["", "Left unexplained", *_folded(" · ".join(facts), 2)]
