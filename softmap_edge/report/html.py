"""Write one self-contained HTML page about a comparison, two comparisons or a diagnosis.

The text is in `templates/report.html`; this module supplies data, phrases and figures. Without
matplotlib the page has no figures and explains how to get them. Pinned by tests/report/.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from softmap_edge.comparison.comparison import Comparison
from softmap_edge.comparison.in_unit import comparison_in_unit, series_in_unit
from softmap_edge.comparison.series import Series
from softmap_edge.comparison.text import check_pair
from softmap_edge.diagnosis.document import VERDICTS, Diagnosis
from softmap_edge.diagnosis.family_text import (
    LEARNED,
    TITLE,
    family_line,
    findings_of,
    learned_line,
)
from softmap_edge.diagnosis.text import (
    again,
    alternative_name,
    confirmed,
    parameter,
    servo_row,
    untestable_rows,
)
from softmap_edge.errors import ReportError
from softmap_edge.files.atomic import Document, write_atomically
from softmap_edge.files.numbers import mm, number, tamed
from softmap_edge.report.errors_shown import cards, points_part
from softmap_edge.report.pages import Card, Picture, pictures_missing, render
from softmap_edge.report.story import Story
from softmap_edge.report.story_pictures import pictures
from softmap_edge.run.in_unit import in_unit, unit_of

# The tone of a verdict's badge: good, warn, bad or calm.
TONES = {
    "identified": "good",
    "ambiguous": "warn",
    "partly_explained": "warn",
    "nothing": "calm",
    "cannot_tell": "calm",
    "measurement_fault": "bad",
}
Rows = list[tuple[str, str]]


def write_html(
    path: str | Path,
    comparison: Comparison | Sequence[Comparison] | None = None,
    diagnosis: Diagnosis | Document | None = None,
    series: Series | None = None,
    floor: tuple[float, str] | None = None,
    ways: tuple[Mapping[str, float | None], str] | None = None,
) -> Path:
    """Write one self-contained HTML page.

    Args:
        path: the file to write
        comparison: one comparison, or two of the same run (before, after)
        diagnosis: a Diagnosis or its document softmap.diagnosis/2 (or /1)
        series: errors over time and over the body (`compare.series`), for the figures that need
            them
        ways: errors in mm RMS of models made in several ways, by name, and the run that they were
            measured on (`model adapt`)
        floor: the lowest error that a model can reach, mm, and its name, if known better than from
            the camera's noise

    Returns:
        The file.

    Raises:
        ReportError: there is nothing to show, or the comparisons are of different runs.
    """
    given = [comparison] if isinstance(comparison, Comparison) else list(comparison or [])
    if len(given) > 2:
        raise ReportError(
            f"{len(given)} comparisons given; a page shows one, or two of the same run (before, "
            "after)"
        )
    if not given and diagnosis is None:
        raise ReportError("nothing to show; give a comparison, a diagnosis or both")
    if len(given) == 2:
        check_pair(*given)
    if diagnosis is not None:
        given_document = diagnosis.to_dict() if isinstance(diagnosis, Diagnosis) else diagnosis
        diagnosis = Diagnosis.from_dict(given_document).to_dict()
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
    target = Path(path)
    write_atomically(target, render("report.html", _page(story)))
    return target


@dataclass(frozen=True)
class ShownParameter:
    """A parameter of an effect as the page shows it."""

    label: str
    value: str
    at_bound: bool


@dataclass(frozen=True)
class ShownEffect:
    """An effect as the page shows it: its size in the unit of the page, fitted and held out."""

    name: str
    family: str
    stage: str
    parameters: list[ShownParameter]
    lines: list[str]
    probability: float | None
    share: float | None
    fitted: float | None
    held_out: float | None


@dataclass(frozen=True)
class ShownFamily:
    """A family of effects as the page shows it."""

    line: str
    share: float | None
    law_share: float | None
    moved: float | None
    alternatives: list[str]


@dataclass(frozen=True)
class ReportPage:
    """The content of `templates/report.html`, from top to bottom.

    `install` is the command that installs missing packages for figures.
    """

    title: str
    badge: str
    tone: str
    heading: str
    about: str
    cards: list[Card]
    unit: str
    install: str | None
    families_title: str
    families: list[ShownFamily]
    learned_title: str
    learned: list[str]
    points_title: str
    points: list[str]
    first_pictures: list[Picture]
    ways: list[tuple[str, float]]
    ways_on: str
    faults: list[ShownEffect]
    found: list[ShownEffect]
    servos: Rows
    alternatives: Rows
    untestable: Rows
    steps: Rows
    remarks: list[str]
    unexplained: Rows
    last_pictures: list[Picture]
    origin: str


def _page(story: Story) -> ReportPage:
    document = story.diagnosis or {}
    verdict = str(story.diagnosis["verdict"]) if story.diagnosis else ""
    install = pictures_missing()
    first, last = ([], []) if install else pictures(story)
    title, points = points_part(story)
    return ReportPage(
        title=_title(story),
        badge=VERDICTS.get(verdict, verdict),
        tone=TONES.get(verdict, "calm"),
        heading=tamed(document.get("sentence") or "") or _sentence(story),
        about=" · ".join(_about(story)),
        cards=cards(story),
        unit=story.unit,
        install=install,
        families_title=TITLE,
        families=[_family(row, document) for row in document.get("families") or []],
        learned_title=LEARNED,
        learned=[learned_line(row) for row in document.get("learned_in") or []],
        points_title=title,
        points=points,
        first_pictures=first,
        ways=[(name, value) for name, value in (story.ways or {}).items() if value is not None],
        ways_on=story.ways_on,
        faults=[_effect(row) for row in document.get("faults") or []],
        found=[_effect(row) for row in document.get("effects") or []],
        servos=[
            (str(name), str(text)) for name, text in map(servo_row, document.get("servo") or [])
        ],
        alternatives=[
            (alternative_name(row), tamed(row.get("why", "")))
            for row in document.get("alternatives") or []
        ],
        untestable=[
            (name, f"{why} — {do}" if do else why) for name, why, do in untestable_rows(document)
        ],
        steps=[(str(row.get("block", "?")), _settles(row)) for row in document.get("next") or []],
        remarks=[tamed(row) for row in document.get("remarks") or []],
        unexplained=_unexplained(
            document.get("unexplained") or {}, unit_of(document.get("made_from") or {})
        ),
        last_pictures=last,
        origin=_origin(story),
    )


def _title(story: Story) -> str:
    robot = (story.before.bundle if story.before else {}).get("robot")
    return f"{'Diagnosis' if story.diagnosis else 'Comparison'}{f' of {robot}' if robot else ''}"


def _kind(story: Story) -> str:
    """Return whether the shown errors are held out, as text for a caption."""
    known = {
        "held out": "held out: this run was not fitted",
        "fitted": "fitted: this run took part",
    }
    if story.series is not None and story.series.kind in known:
        return known[story.series.kind]
    return "measured; whether this run took part in a fit is not recorded here"


def _about(story: Story) -> list[str]:
    if story.before is None:
        return []
    model = ", ".join(map(str, (story.after or story.before).bundle.get("effects") or [])) or "none"
    return [
        f"robot {story.before.bundle.get('robot', '?')}",
        f"run of {story.before.run.get('robot', '?')}, {story.before.frames} frames",
        f"effects in the model: {model}",
        _kind(story),
    ]


def _sentence(story: Story) -> str:
    if story.before is None:
        return VERDICTS.get(str((story.diagnosis or {}).get("verdict")), "")
    old = story.before.error["rms_mm"]
    kind = story.series.kind if story.series else ""
    data = {"held out": "a run that was not fitted", "fitted": "the run that was fitted"}.get(
        kind, "nothing is fitted"
    )
    if story.after is None:
        text = (
            f"The model is off by {mm(old)} {story.unit} RMS over {story.before.frames} frames "
            f"({data})"
        )
        floor, most = story.before.noise_floor_mm, "at most " * story.before.floor_is_bound
        return text + (
            f"; {story.noise} is {most}{mm(floor)} {story.unit}." if floor is not None else "."
        )
    new = story.after.error["rms_mm"]
    if new > old:
        return (
            f"The error rises from {mm(old)} to {mm(new)} {story.unit} RMS ({data}): the second "
            "model is worse."
        )
    return f"The error falls from {mm(old)} to {mm(new)} {story.unit} RMS ({data})."


def _family(row: Document, document: Document) -> ShownFamily:
    return ShownFamily(
        line=family_line(row, findings_of(document)),
        share=row.get("share"),
        law_share=row.get("law_share"),
        moved=row.get("moved_mm"),
        alternatives=[str(name) for name in row.get("alternatives") or []],
    )


def _effect(row: Document) -> ShownEffect:
    size = row.get("displacement_mm") or {}
    return ShownEffect(
        name=row.get("name", "?"),
        family=row.get("family", "?"),
        stage=row.get("stage", "?"),
        parameters=[
            ShownParameter(label, parameter(value), bool(value.get("at_bound")))
            for label, value in (row.get("params") or {}).items()
        ],
        lines=[*again(row), *confirmed(row)],
        probability=row.get("probability"),
        share=row.get("share"),
        fitted=size.get("fitted"),
        held_out=size.get("held_out"),
    )


def _settles(row: Mapping[str, object]) -> str:
    settles, apart = row.get("settles"), number(row.get("separation"))
    named = (
        ", ".join(map(str, settles)) if isinstance(settles, (list, tuple)) else str(settles or "")
    )
    time = "" if (minutes := number(row.get("minutes"))) is None else f"{minutes:g} min: "
    return f"{time}settles {named}" + (
        "" if apart is None else f"; expected separation {apart:.3g} (chi², simulated)"
    )


def _unexplained(left: Mapping[str, object], unit: str) -> Rows:
    if not left:
        return []
    by = left.get("predicted_by")
    named = (
        ", ".join(map(str, by))
        if isinstance(by, (list, tuple))
        else str(by or "nothing that was tried")
    )
    chi, share = number(left.get("chi2_per_n")), number(left.get("blocked_r2"))
    return [
        ("size", f"{mm(left.get('rms_mm'))} {unit} RMS beyond the noise, fitted"),
        (
            "against the noise",
            "–" if chi is None else f"chi² per number {chi:.3g} (1 is noise alone), fitted",
        ),
        ("predictable share", "–" if share is None else f"R² {share:.2g} on held-out blocks"),
        ("follows", named),
    ]


def _origin(story: Story) -> str:
    before, after = story.before, story.after
    documents = {
        "before": before and before.run | {"bundle": before.bundle} | before.made_from,
        "after": after and {"bundle": after.bundle} | after.made_from,
        "diagnosis": (story.diagnosis or {}).get("made_from"),
    }
    known = {name: value for name, value in documents.items() if value}
    return json.dumps(known, indent=1, ensure_ascii=False, default=str, sort_keys=True)
