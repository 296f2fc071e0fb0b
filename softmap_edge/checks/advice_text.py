"""Text for a terminal (100 columns): what a run can identify, and how visible effects are in it."""

from __future__ import annotations

from softmap_edge.checks.advice import Advice
from softmap_edge.files.atomic import Document
from softmap_edge.files.numbers import folded


def advice_lines(words: list[Advice]) -> list[str]:
    """Return text for a terminal: what can be identified, what cannot, and the minutes.

    Each item that cannot be identified is followed by its remedy.
    """
    lines = ["", "This run can identify"]
    lines += [line for word in words if word.tells for line in folded(f"+ {word.text}", 2, 2)] or [
        "  nothing yet"
    ]
    poor = [word for word in words if not word.tells]
    if not poor:
        return lines
    lines += ["", "This run cannot identify"]
    for word in poor:
        time = "" if word.minutes is None else f" ({word.minutes:g} min)"
        lines += [*folded(f"- {word.text}", 2, 2), *folded(f"> {word.remedy}{time}", 6, 2)]
    minutes = sum(word.minutes or 0.0 for word in poor)
    return [
        *lines,
        "",
        f"What is missing (the lines marked >) takes about {minutes:g} minutes of recording in "
        "all.",
    ]


def effect_lines(effects: list[Document]) -> list[str]:
    """Return the visibility of each effect (`diagnosis.showing`) as text for a terminal."""
    lines = [
        "",
        "Effects at typical strength: how far each would move the body, and how often that is the "
        "noise",
    ]
    wide = max((len(row["name"]) for row in effects), default=0)
    for row in effects:
        if row["shows"]:
            size = f"{row['moved_mm']:5.2f} mm {row['deviations']:7.0f} times"
            twins = f", but like {', '.join(row['alike'])}" if row["alike"] else ""
            lines.append(f"  + {row['name']:<{wide}}{size}   shows{twins}")
        else:
            lines += folded(f"- {row['name']:<{wide}}  does not show: {row['why']}", 2, 2)
        if not row["shows"] or row["alike"]:
            lines += folded(f"> {row['experiment']} ({row['minutes']:g} min)", 6, 2)
    return lines
