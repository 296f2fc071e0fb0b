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
    STATIC_ADDED,
    again,
    alternative_name,
    confirmed,
    ladder_steps,
    parameter,
    servo_row,
    untestable_rows,
)
from softmap_edge.errors import ReportError
from softmap_edge.files.atomic import Document, write_atomically
from softmap_edge.files.numbers import fall, mm, number, percent, tamed
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
    title, points = _points(story)
    return ReportPage(
        title=_title(story),
        badge=VERDICTS.get(verdict, verdict),
        tone=TONES.get(verdict, "calm"),
        heading=tamed(document.get("sentence") or "") or _sentence(story),
        about=" · ".join(_about(story)),
        cards=_cards(story),
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


def _cards(story: Story) -> list[Card]:
    """Return the numbers at the top: one error before and after, and the floor of both.

    They are those of the sentence above them: of a diagnosis its held-out error, else that of the
    comparison.
    """
    found = _diagnosed(story)
    if found is not None:
        return _pair_cards(found, story.unit)
    if story.before is None:
        return []
    shown = _compared(story, story.before)
    rows = _pair_cards(shown, story.unit)
    if shown.after is None:
        tip = story.before.error["tip_rms_mm"]
        most = f"{mm(story.before.error['p95_mm'])} {story.unit}"
        if story.places:
            rows.insert(
                1, Card("error of the tip", f"{mm(tip)} mm", f"RMS, {shown.data}", "before")
            )
        rows.insert(
            1 + story.places, Card(f"95 % of {story.things} within", most, shown.data, "before")
        )
    return rows


@dataclass(frozen=True)
class ShownErrors:
    """One error before and after, with its floor.

    Attributes:
        before, after: RMS in the unit of the page; `after` is None if there is one model
        floor: the same, None if unknown
        floor_kind: the origin of the floor
        bound: whether the floor is an upper bound, which an error may undercut
        removable: whether the share of the removable error is counted above the floor
        data: the data of both errors, in words
        what: the measured quantity, with its data, in words
        held: "held-out " if both errors are held out
    """

    before: float | None
    after: float | None
    floor: float | None
    floor_kind: str
    bound: bool
    removable: bool
    data: str
    what: str
    held: str = ""

    @property
    def share(self) -> float | None:
        """The share of the removable error that is gone; None without a fall to count."""
        before, after = number(self.before), number(self.after)
        if before is None or after is None:
            return None
        return fall(before, after, self.floor if self.removable else None)


def _diagnosed(story: Story) -> ShownErrors | None:
    """Return the held-out error of a diagnosis before and after its effects; None without one."""
    error = (story.diagnosis or {}).get("error") or {}
    before = number(error.get("model"))
    if before is None:
        return None
    steps = [
        value
        for name, value in ladder_steps(error)
        if name.startswith("+") and name != STATIC_ADDED
    ]
    on = str(error.get("held_out_on") or error.get("kind") or "held out")
    return ShownErrors(
        before=before,
        after=steps[-1] if steps else None,
        floor=number(error.get("floor")),
        floor_kind=str(error.get("floor_kind") or "origin not stated"),
        bound=False,
        removable=number(error.get("floor")) is not None,
        data=on,
        what=f"{_features(story)}; {on}",
        held="held-out ",
    )


def _compared(story: Story, before: Comparison) -> ShownErrors:
    """Return the error of all points of the compared run, by one model or two."""
    kind = story.series.kind if story.series else ""
    data = {"held out": "a run not fitted", "fitted": "the run fitted"}.get(kind, "this run")
    new = story.after.error["rms_mm"] if story.after else None
    floor, origin = story.floor or (before.noise_floor_mm, f"noise, RMS; {before.floor_kind}")
    above = floor is not None and (bool(story.floor) or (new is not None and new > floor))
    return ShownErrors(
        before=before.error["rms_mm"],
        after=new,
        floor=floor,
        floor_kind=origin,
        bound=not story.floor and before.floor_is_bound,
        removable=above,
        data=data,
        what=f"all {story.things}, {data}",
    )


def _pair_cards(shown: ShownErrors, unit: str) -> list[Card]:
    """Return the cards of one error before and after, and its floor."""
    name = f"{shown.held}error" + ("" if shown.after is None else " before")
    rows = [Card(name, f"{mm(shown.before)} {unit}", f"RMS, {shown.what}", "before")]
    if number(shown.after) is not None and number(shown.before) is not None:
        note = f"RMS, {shown.what}"
        rows.append(Card(f"{shown.held}error after", f"{mm(shown.after)} {unit}", note, "after"))
        raw = percent(fall(float(shown.before or 0.0), float(shown.after or 0.0)))
        rows.append(
            Card(
                "of the removable error gone",
                percent(shown.share),
                f"{raw} of the raw error; {shown.data}",
                "after",
            )
        )
    most = "≤ " if shown.bound and shown.floor is not None else ""
    label = "floor, an upper bound" if most else "floor"
    return [*rows, Card(label, f"{most}{mm(shown.floor)} {unit}", shown.floor_kind, "floor")]


def _features(story: Story) -> str:
    """Return the quantity that a diagnosis measures."""
    return "middles of sections, or markers" if story.places else "outputs"


def _points(story: Story) -> tuple[str, list[str]]:
    """Return the title and sentences of the part that shows all points next to a diagnosis.

    Its errors differ from those of the diagnosis, so the sentences state both differences.
    """
    if story.before is None or _diagnosed(story) is None:
        return "", []
    shown = _compared(story, story.before)
    kind = story.series.kind if story.series else ""
    title = {
        "held out": f"Validation: all {story.things} of a run that was not fitted",
        "fitted": f"The fitted run: all {story.things}",
    }.get(kind, f"The compared run: all {story.things}")
    old, new, unit = mm(shown.before), mm(shown.after), story.unit
    text = [
        f"Error {old} {unit} RMS."
        if shown.after is None
        else f"Error before {old} {unit} RMS, after {new} {unit} RMS"
        + (
            f"; {percent(shown.share)} of the removable error is gone (floor {mm(shown.floor)} "
            f"{unit}: {shown.floor_kind})."
            if story.floor
            else "."
        )
    ]
    if not story.floor and shown.floor is not None:
        one, most = ("point" if story.places else "output"), "at most " * shown.bound
        text.append(
            f"The noise of one {one} is {most}{mm(shown.floor)} {unit} RMS "
            f"({story.before.floor_kind})."
        )
    on = str(((story.diagnosis or {}).get("error") or {}).get("held_out_on") or "held-out blocks")
    same = kind == "held out" and on.startswith("an independent run")
    text.append(
        f"The pictures below show these {story.things}. The numbers at the top are of "
        f"{'the same run' if same else on}."
    )
    if story.places and story.series is not None and story.series.triangles is not None:
        text.append(
            "They are measured at the middles of the body's sections, which have less noise than "
            "single points."
        )
    return title, text


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
