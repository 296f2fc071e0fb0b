"""Write docs/effects.md, the page of every effect, from the registry: `python docs/make_effects.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from softmap_edge import _core

PAGE = Path(__file__).with_name("effects.md")

HEAD = """# Effects

Made from the registry by `docs/make_effects.py`; do not edit. An effect is declared once, in a file of its own under
`rust/effects/`, and its name stands in the list of `rust/effects/mod.rs`: one file and one line add one.

At its null values an effect is absent. A fit searches from *low* to *high* (on a logarithmic scale where *low* is
positive) and begins at *start*. A parameter marked *per channel* has one value for each command: `gain.factor[0]`,
`gain.factor[1]`. The path from command to camera is `command → transmission → material → shape → sensing`; a chain is
always composed in this order.

Loads move a finger by its fields, which are linear and taken at constant tension of its tendons; the tendons then
answer by falling slack or taut, a complementarity problem solved at every frame (`rust/cables.rs`). On the built-in
finger this misses the simulator by (RMS over vertices and eleven commands, of what the load moves them by):

| load | error | of |
|---|---|---|
| horizontal instead of hanging | 0.12 mm | 2.5 mm |
| 25 g at the tip, hanging | 0.08 mm | 0.8 mm |
| 25 g at the tip, leaning by 35° | 0.27 mm | 3.1 mm |
| 60 g at the tip, leaning by 35° | 0.96 mm | 5 mm |

A rod has no tendons in its model: its fields answer loads alone, by one nominal compliance.
"""


def page() -> str:
    """Return the whole page as text."""
    effects = _core.effects()
    rows = [f"| [{e['name']}](#{e['name']}) | {e['stage']} | {e['family']} | `{e['formula']}` |" for e in effects]
    index = "\n".join(["| effect | stage | family | form |", "|---|---|---|---|", *rows])
    return "\n".join([HEAD, index, "", *(_section(e) for e in effects)])


def _section(effect: dict[str, Any]) -> str:
    block, minutes = effect["experiment"]
    needs = ", ".join(effect["needs"]) or "nothing beyond commands"
    facts = f"{effect['role']} effect of the stage *{effect['stage']}*, family *{effect['family']}*"
    if effect["kind"] == "fault":
        facts += "; a fault of the measurement, not of the robot"
    parameters = [
        f"| `{effect['name']}.{p['name']}`{' per channel' if p['per_channel'] else ''} | {p['unit']} | {p['null']:g} "
        f"| {p['start']:g} | {p['low']:g} to {p['high']:g}{' (log)' if p['log'] else ''} | {p['doc']} |"
        for p in effect["parameters"]
    ]
    return "\n".join(
        [
            f"## {effect['name']}",
            "",
            f"`{effect['formula']}`",
            "",
            effect["doc"],
            "",
            f"- **While it is missing:** {effect['signature']}",
            f"- **To show it:** {block} ({minutes:g} min).",
            f"- **Kind:** {facts}.",
            f"- **Needs in a run:** {needs}.",
            f"- **Reference:** {effect['reference']}",
            "",
            "| parameter | unit | null | start | search | meaning |",
            "|---|---|---|---|---|---|",
            *parameters,
            "",
        ]
    )


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
