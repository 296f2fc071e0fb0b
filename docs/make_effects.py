"""Write docs/effects.md, the page of every effect, from registry and simulator: `python docs/make_effects.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from softmap_edge import Run, _core, builtin_model
from softmap_edge.solid.finger import Finger
from softmap_edge.solid.simulator import Simulator

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

@LOADS@

A rod has no tendons in its model: its fields answer loads alone, by one nominal compliance.
"""


LEANING = (float(np.sin(np.radians(35.0))), 0.0, float(np.cos(np.radians(35.0))))
LOADS = {  # what the page calls it: gravity in the base frame, grams at the tip
    "horizontal instead of hanging": ((1.0, 0.0, 0.0), 0.0),
    "25 g at the tip, hanging": ((0.0, 0.0, 1.0), 25.0),
    "25 g at the tip, leaning by 35°": (LEANING, 25.0),
    "60 g at the tip, leaning by 35°": (LEANING, 60.0),
}
NEWTON_PER_GRAM = 9.80665e-3


def load_errors() -> dict[str, tuple[float, float]]:
    """Return for each load how far its fields miss the simulator, and how far it moves the hanging finger: mm RMS."""
    model, simulator = builtin_model(), Simulator(Finger.builtin())
    u = np.vstack([np.zeros((1, 2)), np.random.default_rng(3).uniform(-14.0, 14.0, (10, 2))])
    t = np.arange(len(u), dtype=float)
    bare, unloaded = simulator.path(u), model.predict(Run(t=t, command=u, t_seen=t))
    found = {}
    for name, (gravity, grams) in LOADS.items():
        force = NEWTON_PER_GRAM * grams * np.array(gravity)
        truth = simulator.path(u, gravity=gravity, load=force) - bare
        loaded = Run(t=t, command=u, t_seen=t, gravity=np.array(gravity), load=np.full(len(u), grams))
        moved = model.predict(loaded) - unloaded
        miss, size = (float(np.sqrt(np.mean(np.sum(d**2, axis=-1)))) for d in (moved - truth, truth))
        found[name] = (miss, size)
    return found


def load_table(errors: dict[str, tuple[float, float]]) -> str:
    """Return the table of `load_errors`."""
    rows = [f"| {name} | {miss:.2f} mm | {size:.1f} mm |" for name, (miss, size) in errors.items()]
    return "\n".join(["| load | error | of |", "|---|---|---|", *rows])


def page(loads: str) -> str:
    """Return the whole page as text; `loads` is the table of what loads miss."""
    effects = _core.effects()
    rows = [f"| [{e['name']}](#{e['name']}) | {e['stage']} | {e['family']} | `{e['formula']}` |" for e in effects]
    index = "\n".join(["| effect | stage | family | form |", "|---|---|---|---|", *rows])
    return "\n".join([HEAD.replace("@LOADS@", loads), index, "", *(_section(e) for e in effects)])


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
    PAGE.write_text(page(load_table(load_errors())), encoding="utf-8")
