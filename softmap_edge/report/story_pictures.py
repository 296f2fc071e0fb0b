"""The pictures of a report page, each with its caption.

They need matplotlib. Pinned by tests/report/.
"""

from __future__ import annotations

from types import ModuleType

from softmap_edge.diagnosis.text import LADDER_NOTE, OUTPUT_NOTE, ladder_steps
from softmap_edge.files.atomic import Document
from softmap_edge.files.numbers import mm, number
from softmap_edge.report.pages import Picture
from softmap_edge.report.story import Story
from softmap_edge.run.in_unit import PLACES


def pictures(story: Story) -> tuple[list[Picture], list[Picture]]:
    """Return the figures above and below the tables."""
    from softmap_edge.report import figures
    from softmap_edge.report.loop_figure import loop_picture

    loops = (
        None
        if story.series is None
        else loop_picture(story.series, story.unit, story.diagnosis, story.short)
    )
    first = (loops, _sheet(story), _where(story, figures), _ladder(story, figures))
    last = (_time(story, figures), _body(story, figures), _tip(story, figures))
    return [one for one in first if one is not None], [one for one in last if one is not None]


def _time(story: Story, figures: ModuleType) -> Picture | None:
    if story.series is None or story.series.timeless:
        return None
    return Picture(
        "Error over time",
        figures.over_time(story.series, story.unit),
        "RMS error of each frame over time, before and after",
        f"RMS over the {story.things} of a frame, {story.unit}{story.short}.",
    )


def _sheet(story: Story) -> Picture | None:
    if story.series is None or not story.places:
        return None
    from softmap_edge.report.sheet import sheet

    commands = " and every frame at its command" if story.series.command.shape[1] else ""
    return Picture(
        "Where the error is",
        sheet(story.series),
        "Error of poses and commands",
        f"Measured poses{commands}, coloured by their error on one scale{story.short}.",
    )


def _body(story: Story, figures: ModuleType) -> Picture | None:
    if story.series is None or not story.places:
        return None
    markers = story.series.triangles is None
    drawn = (
        "markers at their mean places, axes of different scale"
        if markers
        else "shape at rest, base left"
    )
    return Picture(
        "Error on the body",
        figures.body(story.series),
        "RMS error of each point, drawn on the body",
        f"RMS over all frames of each point, mm, one colour scale, {drawn}{story.short}.",
    )


def _tip(story: Story, figures: ModuleType) -> Picture | None:
    if story.series is None or not story.places:
        return None
    rows, t = figures.worst_stretch(story.series), story.series.t_seen
    part = (
        ""
        if rows.stop - rows.start == len(t)
        else f", from {t[rows.start]:.0f} to {t[rows.stop - 1]:.0f} s, where "
    )
    part += "the error before is largest (faint: the complete run, measured)" if part else ""
    return Picture(
        "Path of the tip",
        figures.tip_path(story.series),
        "Path of the tip, measured and predicted",
        f"Tip centroid in the base frame, mm{part}{story.short}.",
    )


def _ladder(story: Story, figures: ModuleType) -> Picture | None:
    error = (story.diagnosis or {}).get("error") or {}
    if not ladder_steps(error):
        return None
    unit, on = error.get("unit", PLACES), error.get("held_out_on")
    note = f"{error.get('kind', 'held-out rms')}{f' on {on}' if on else ''}, {unit}. "
    note += f"Floor: {error.get('floor_kind', 'origin not stated')}. "
    note += _other_floor(error, unit)
    note += LADDER_NOTE if story.places else OUTPUT_NOTE
    drawn = figures.ladder_bars(error)
    return Picture("What each effect removes", drawn, "Error ladder down to the floor", note)


def _other_floor(error: Document, unit: str) -> str:
    """Return the estimate that is not the floor of the ladder, and why it is not."""
    floor, noise, form = (number(error.get(key)) for key in ("floor", "noise_floor", "model_floor"))
    if floor is None:
        return ""
    if form is not None and form != floor:
        return f"The model's own held-out error is another limit: {mm(form)} {unit} RMS. "
    if noise is not None and noise != floor:
        return (
            f"The noise estimate of {mm(noise)} {unit} RMS is not a floor, because too few poses "
            "repeat. "
        )
    return ""


def _where(story: Story, figures: ModuleType) -> Picture | None:
    if story.before is not None:
        old = story.before.to_dict()["where"]
        new = story.after.to_dict()["where"] if story.after else None
        kind = story.short
    else:
        document = story.diagnosis or {}
        maps = document.get("where") or {}
        old, new = maps.get("before"), maps.get("after")
        kind = f"; {(document.get('error') or {}).get('kind')}"
    if not old or not any(len(rows) > 1 for rows in old.values()):
        return None
    colours = "wide bars before, narrow bars after" if new else "one bar a class"
    return Picture(
        "Error by condition",
        figures.where_maps(old, new),
        "Error by condition, before and after",
        f"RMS, {story.unit}, on one scale; {colours}{kind}.",
    )
