"""One self-contained HTML page about a comparison, two comparisons or a diagnosis: verdict, pictures, evidence, origin.

The page loads nothing: pictures are inside it, there is no script, and its content policy forbids both. Whatever comes
from a file (robot names, sentences, labels) is escaped. The pictures need matplotlib, which is an extra.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from softmap_edge.comparison.comparison import Comparison
from softmap_edge.comparison.in_unit import comparison_in_unit, series_in_unit
from softmap_edge.comparison.series import Series
from softmap_edge.comparison.text import check_pair
from softmap_edge.diagnosis.document import VERDICTS, Diagnosis
from softmap_edge.diagnosis.text import (
    LADDER_NOTE,
    OUTPUT_NOTE,
    STATIC_ADDED,
    again,
    confirmed,
    ladder_steps,
    moved_by,
    parameter,
)
from softmap_edge.errors import ReportError
from softmap_edge.files.atomic import write_atomically
from softmap_edge.files.numbers import fall, mm, number, percent, tamed
from softmap_edge.report.families import family_section, learned_section
from softmap_edge.report.html_open import open_questions
from softmap_edge.report.style import PAGE, TONES, cards, escaped, picture, section
from softmap_edge.run.in_unit import PLACES, in_unit, unit_of

INSTALL = "pip install 'softmap-edge[report]'"


@dataclass(frozen=True)
class Story:
    """What one page is about; `before` and `after` are comparisons of the same run."""

    before: Comparison | None
    after: Comparison | None
    diagnosis: Mapping[str, Any] | None
    series: Series | None
    floor: tuple[float, str] | None = None
    ways: Mapping[str, float | None] | None = None
    ways_on: str = ""
    unit: str = PLACES  # of every figure on the page but those of commands

    @property
    def places(self) -> bool:
        """Whether the page is about a body; outputs have no shape to draw."""
        return self.unit == PLACES


def write_html(
    path: str | Path,
    comparison: Comparison | Sequence[Comparison] | None = None,
    diagnosis: Any = None,
    series: Series | None = None,
    floor: tuple[float, str] | None = None,
    ways: tuple[Mapping[str, float | None], str] | None = None,
) -> Path:
    """Write one self-contained HTML page.

    Args:
        path: the file to write.
        comparison: one comparison, or two of the same run (before, after).
        diagnosis: a Diagnosis or its document softmap.diagnosis/2 (or /1).
        series: errors over time and over the body (`compare.series`), for the pictures that need them.
        ways: errors in mm RMS of a model made in several ways, by name, and the run that they were measured on
            (`adapt`).
        floor: the lowest error that a model can reach, mm, and its name, if known better than from the camera's noise.

    Returns:
        Path: the file.

    Raises:
        ReportError: matplotlib is not installed, nothing to show, or the comparisons are of different runs.
    """
    given = [comparison] if isinstance(comparison, Comparison) else list(comparison or [])
    if len(given) > 2:
        raise ReportError(f"{len(given)} comparisons given; a page shows one, or two of the same run (before, after)")
    if not given and diagnosis is None:
        raise ReportError("nothing to show; give a comparison, a diagnosis or both")
    if len(given) == 2:
        check_pair(*given)
    if diagnosis is not None:
        diagnosis = diagnosis.to_dict() if hasattr(diagnosis, "to_dict") else diagnosis
        diagnosis = Diagnosis.from_dict(diagnosis).to_dict()
    unit = unit_of(given[0].made_from if given else (diagnosis or {}).get("made_from") or {})
    shown = [comparison_in_unit(one) for one in given]
    measured, on = (None, "") if ways is None else ways
    story = Story(
        before=shown[0] if shown else None,
        after=shown[1] if len(shown) > 1 else None,
        diagnosis=None if diagnosis is None else in_unit(diagnosis),
        series=None if series is None else series_in_unit(series),
        floor=floor,
        ways=measured,
        ways_on=on,
        unit=unit,
    )
    figures = loaded_figures()
    sections = [
        _hero(story),
        family_section(story.diagnosis or {}, story.unit),
        learned_section(story.diagnosis or {}),
        _loops(story),
        _sheet(story),
        _where(story, figures),
        _ladder(story, figures),
        _ways(story),
        _effects(story),
        open_questions(story.diagnosis or {}),
        _time(story, figures),
        _body(story, figures),
        _tip(story, figures),
        _origin(story),
    ]
    page = PAGE.replace("@TITLE@", escaped(_title(story))).replace("@BODY@", "\n".join(s for s in sections if s))
    target = Path(path)
    write_atomically(target, page)
    return target


def loaded_figures() -> ModuleType:
    """Return the module of pictures. Raises ReportError when matplotlib is not installed."""
    try:
        from softmap_edge.report import figures
    except ImportError as missing:
        if (missing.name or "").split(".")[0] != "matplotlib":
            raise
        raise ReportError(
            f"the HTML report needs matplotlib: {INSTALL} (the text and --json work without it)"
        ) from None
    return figures


def _title(story: Story) -> str:
    robot = (story.before.bundle if story.before else {}).get("robot")
    return f"{'Diagnosis' if story.diagnosis else 'Comparison'}{f' of {robot}' if robot else ''}"


def _kind(story: Story) -> str:
    """Whether the shown errors are held out, in the words of a caption."""
    known = {"held out": "held out: this run was not fitted", "fitted": "fitted: this run took part"}
    if story.series is not None and story.series.kind in known:
        return known[story.series.kind]
    return "measured; whether this run took part in a fit is not recorded here"


def _short(story: Story) -> str:
    """The same for the captions, where the top of the page has said it in full."""
    return f"; {story.series.kind}" if story.series is not None and story.series.kind != "measured" else ""


def _hero(story: Story) -> str:
    verdict = str(story.diagnosis["verdict"]) if story.diagnosis else ""
    badge = ""
    if story.diagnosis:
        tone = TONES.get(verdict, "calm")
        badge = f'<span class="badge {tone}">{escaped(VERDICTS.get(verdict, verdict))}</span>'
    sentence = tamed(story.diagnosis.get("sentence") or "") if story.diagnosis else ""
    shown = cards(_cards(story))
    about = " · ".join(_about(story))
    return (
        f'<header><p class="eyebrow">SOFTMAP-Edge · {escaped(_title(story))}</p>{badge}'
        f'<h1>{escaped(sentence or _sentence(story))}</h1><p class="about">{about}</p></header>'
        f'<div class="cards">{shown}</div>'
    )


def _about(story: Story) -> list[str]:
    if story.before is None:
        return []
    model = ", ".join(map(str, (story.after or story.before).bundle.get("effects") or [])) or "none"
    return [
        f"robot {escaped(story.before.bundle.get('robot', '?'))}",
        f"run of {escaped(story.before.run.get('robot', '?'))}, {story.before.frames} frames",
        f"effects in the model: {escaped(model)}",
        escaped(_kind(story)),
    ]


def _sentence(story: Story) -> str:
    if story.before is None:
        return VERDICTS.get(str((story.diagnosis or {}).get("verdict")), "")
    old = story.before.error["rms_mm"]
    kind = story.series.kind if story.series else ""
    told = {"held out": "a run that was not fitted", "fitted": "the run that was fitted"}.get(kind, "nothing is fitted")
    if story.after is None:
        text = f"The model is off by {mm(old)} {story.unit} RMS over {story.before.frames} frames ({told})"
        floor, most = story.before.noise_floor_mm, "at most " * story.before.floor_is_bound
        return text + (f"; {_noise(story)} is {most}{mm(floor)} {story.unit}." if floor is not None else ".")
    new = story.after.error["rms_mm"]
    if new > old:
        return f"The error rises from {mm(old)} to {mm(new)} {story.unit} RMS ({told}): the second model is worse."
    return f"The error falls from {mm(old)} to {mm(new)} {story.unit} RMS ({told})."


def _cards(story: Story) -> list[tuple[str, str, str, str]]:
    """(label, value, note, tone) of the figures at the top."""
    error = (story.diagnosis or {}).get("error") or {}
    old: Any
    new: Any
    if story.before is not None:
        old, new = story.before.error["rms_mm"], story.after.error["rms_mm"] if story.after else None
        floor, origin = story.floor or (story.before.noise_floor_mm, f"noise, RMS; {story.before.floor_kind}")
        kind = story.series.kind if story.series else ""
        told = {"held out": "a run not fitted", "fitted": "the run fitted"}.get(kind, "this run")
        note = f"all {_things(story)}, {told}"
    else:
        told = str(error.get("kind", "held out"))
        steps = [value for name, value in ladder_steps(error) if name.startswith("+") and name != STATIC_ADDED]
        old, new = number(error.get("model")), steps[-1] if steps else None
        floor, origin, note = (
            number(error.get("floor")),
            str(error.get("floor_kind") or "floor"),
            told,
        )
    rows = [("error before" if new is not None else "error", f"{mm(old)} {story.unit}", f"RMS, {note}", "before")]
    if number(new) is not None and number(old) is not None:
        share = fall(old, new, floor if floor is not None and (story.floor or new > floor) else None)
        rows.append(("error after", f"{mm(new)} {story.unit}", f"RMS, {note}", "after"))
        rows.append(
            (
                "of the removable error gone",
                percent(share),
                f"{percent(fall(old, new))} of the raw error; {told}",
                "after",
            )
        )
    rows.append(("floor", f"{mm(floor)} {story.unit}", origin, "floor"))
    if story.before is not None and story.after is None:
        tip = story.before.error["tip_rms_mm"]
        most = f"{mm(story.before.error['p95_mm'])} {story.unit}"
        if story.places:
            rows.insert(1, ("error of the tip", f"{mm(tip)} mm", f"RMS, {told}", "before"))
        rows.insert(1 + story.places, (f"95 % of {_things(story)} within", most, told, "before"))
    return rows


def _time(story: Story, figures: ModuleType) -> str:
    if story.series is None or story.series.timeless:
        return ""
    image = picture(figures.over_time(story.series, story.unit), "RMS error of each frame over time, before and after")
    return section(
        "Error over time", image, f"RMS over the {_things(story)} of a frame, {escaped(story.unit)}{_short(story)}."
    )


def _loops(story: Story) -> str:
    if story.series is None:
        return ""
    from softmap_edge.report.loop_figure import loop_section

    return loop_section(story.series, story.unit, story.diagnosis, _short(story))


def _things(story: Story) -> str:
    """The compared quantity: the points of a body, or outputs."""
    return "points" if story.places else "outputs"


def _noise(story: Story) -> str:
    """The meaning of the floor, in a sentence."""
    return "the camera's noise" if story.places else "the sensor's noise"


def _sheet(story: Story) -> str:
    if story.series is None or not story.places:
        return ""
    from softmap_edge.report.sheet import sheet

    commands = " and every frame at its command" if story.series.command.shape[1] else ""
    note = f"Measured poses{commands}, coloured by their error on one scale{_short(story)}."
    return section("Where the error is", picture(sheet(story.series), "Error of poses and commands"), note)


def _body(story: Story, figures: ModuleType) -> str:
    if story.series is None or not story.places:
        return ""
    image = picture(figures.body(story.series), "RMS error of each point, drawn on the body")
    markers = story.series.triangles is None
    drawn = "markers at their mean places, axes of different scale" if markers else "shape at rest, base left"
    note = f"RMS over all frames of each point, mm, one colour scale, {drawn}{_short(story)}."
    return section("Error on the body", image, note)


def _tip(story: Story, figures: ModuleType) -> str:
    if story.series is None or not story.places:
        return ""
    image = picture(figures.tip_path(story.series), "Path of the tip, measured and predicted")
    rows, t = figures.worst_stretch(story.series), story.series.t_seen
    part = "" if rows.stop - rows.start == len(t) else f", from {t[rows.start]:.0f} to {t[rows.stop - 1]:.0f} s, where "
    part += "the error before is largest (faint: the complete run, measured)" if part else ""
    return section("Path of the tip", image, f"Tip centroid in the base frame, mm{part}{_short(story)}.")


def _ladder(story: Story, figures: ModuleType) -> str:
    error = (story.diagnosis or {}).get("error") or {}
    if not ladder_steps(error):
        return ""
    unit, on = error.get("unit", PLACES), error.get("held_out_on")
    note = f"{escaped(error.get('kind', 'held-out rms'))}{escaped(f' on {on}' if on else '')}, {escaped(unit)}. "
    note += f"Floor: {escaped(error.get('floor_kind', 'origin not stated'))}. "
    known = [("Noise floor", error.get("noise_floor")), ("Model's own held-out error", error.get("model_floor"))]
    note += "".join(f"{name}: {mm(value)} {escaped(unit)} RMS. " for name, value in known if number(value) is not None)
    note += LADDER_NOTE if story.places else OUTPUT_NOTE
    return section(
        "What each effect removes", picture(figures.ladder_bars(error), "Error ladder down to the floor"), note
    )


def _ways(story: Story) -> str:
    rows = [(name, value) for name, value in (story.ways or {}).items() if value is not None]
    if not rows:
        return ""
    most = max(value for _, value in rows)
    body = "".join(
        f"<tr><td>{escaped(name)}</td><td>{mm(value)} {escaped(story.unit)}</td>"
        f'<td><meter min="0" max="{most:g}" value="{value:g}"></meter></td></tr>'
        for name, value in rows
    )
    note = f"RMS, on {escaped(story.ways_on)}. A residual is a function of the command; physics remembers."
    return section("Explained in other ways", f"<table><tbody>{body}</tbody></table>", note)


def _effects(story: Story) -> str:
    found = story.diagnosis or {}
    parts = []
    for title, rows in (("Faults of the measurement", found.get("faults")), ("Effects found", found.get("effects"))):
        if rows:
            judged = any((row.get("displacement_mm") or {}).get("held_out") is not None for row in rows)
            moves = f"moves {moved_by(story.unit)}, {escaped(story.unit)} RMS<br>fitted" + (
                " / held out" if judged else ""
            )
            values = "parameters, fitted ± 1σ<br>ratios have no unit"
            columns = ("effect", values, "probability<br>fitted", "share of the explained<br>error, fitted", moves)
            head = "".join(f"<th>{name}</th>" for name in columns)
            body = "".join(_effect_row(row, judged) for row in rows)
            parts.append(section(title, f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"))
    return "".join(parts)


def _effect_row(row: Mapping[str, Any], judged: bool) -> str:
    values = "".join(
        f"<div><code>{escaped(label)}</code> {escaped(parameter(value))}"
        + (' <span class="flag">at its bound</span>' if value.get("at_bound") else "")
        + "</div>"
        for label, value in (row.get("params") or {}).items()
    ) + "".join(f"<div><small>{escaped(line)}</small></div>" for line in [*again(row), *confirmed(row)])
    shift = row.get("displacement_mm") or {}
    return (
        f"<tr><td><b>{escaped(row.get('name', '?'))}</b><br><small>{escaped(row.get('family', '?'))} · stage "
        f"{escaped(row.get('stage', '?'))}</small></td><td>{values}</td>"
        f"<td>{percent(row.get('probability'))}</td><td>{percent(row.get('share'))}</td>"
        f"<td>{mm(shift.get('fitted'))}{' / ' + mm(shift.get('held_out')) if judged else ''}</td></tr>"
    )


def _where(story: Story, figures: ModuleType) -> str:
    if story.before is not None:
        old: Any = story.before.to_dict()["where"]
        new: Any = story.after.to_dict()["where"] if story.after else None
        kind = _short(story)
    else:
        maps = (story.diagnosis or {}).get("where") or {}
        old, new, kind = (
            maps.get("before"),
            maps.get("after"),
            f"; {((story.diagnosis or {}).get('error') or {}).get('kind')}",
        )
    if not old or not any(len(rows) > 1 for rows in old.values()):
        return ""
    colours = "wide bars before, narrow bars after" if new else "one bar a class"
    image = picture(figures.where_maps(old, new), "Error by condition, before and after")
    return section("Error by condition", image, f"RMS, {escaped(story.unit)}, on one scale; {colours}{escaped(kind)}.")


def _origin(story: Story) -> str:
    before, after = story.before, story.after
    documents = {
        "before": before and before.run | {"bundle": before.bundle} | before.made_from,
        "after": after and {"bundle": after.bundle} | after.made_from,
        "diagnosis": (story.diagnosis or {}).get("made_from"),
    }
    known = {name: value for name, value in documents.items() if value}
    text = json.dumps(known, indent=1, ensure_ascii=False, default=str, sort_keys=True)
    return f"<details><summary>What made this page</summary><pre>{escaped(text)}</pre></details>"
