"""The errors of a report page before and after, each with its data and floor.

A page of a diagnosis has the held-out error of the diagnosis at its top; the error of all points,
which the pictures show, is another number and has a part of its own. Pinned by
tests/report/test_report_page.py.
"""

from __future__ import annotations

from dataclasses import dataclass

from softmap_edge.comparison.comparison import Comparison
from softmap_edge.diagnosis.text import STATIC_ADDED, ladder_steps
from softmap_edge.files.numbers import fall, mm, number, percent
from softmap_edge.report.pages import Card
from softmap_edge.report.story import Story


def cards(story: Story) -> list[Card]:
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
        name = "of the removable error gone" if shown.removable else "of the error gone"
        rows.append(Card(name, percent(shown.share), shown.data, "after"))
    most = "≤ " if shown.bound and shown.floor is not None else ""
    label = "floor, an upper bound" if most else "floor"
    return [*rows, Card(label, f"{most}{mm(shown.floor)} {unit}", shown.floor_kind, "floor")]


def _features(story: Story) -> str:
    """Return the quantity that a diagnosis measures."""
    return "middles of sections, or markers" if story.places else "outputs"


def points_part(story: Story) -> tuple[str, list[str]]:
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
