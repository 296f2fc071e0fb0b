"""Write docs/reference/effects.md and pictures by registry: `python docs/make_effects.py`.

A picture shows one recording without and with the effect. Effects on commands, at their start: the
commanded and the effective command over time, then what the effect adds, over the command. If one
channel moves the other, the plane of both channels is shown. Effects on the shape and on sensing,
at their typical strength: postures of the built-in finger, then what is added at its tip. Those
that change a number of the prior: on an elastic rod of the same length.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from softmap_edge import Run, _core, builtin_model
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.model.chain_labels import named
from softmap_edge.report.figures import AFTER, BEFORE, FAINT, STYLE

Floats = NDArray[np.float64]

PAGE = Path(__file__).parent / "reference" / "effects.md"
PICTURES = Path(__file__).parent / "pictures" / "effects"

HEAD = """# Effects

`docs/make_effects.py` writes this page from the registry; do not edit it. An effect is declared once, in a file of its
own under `rust/effects/`, and its name stands in the list of `rust/effects/mod.rs`. One file and one line add an
effect. A Python file works too, everywhere except in the control loop: [own_effect.md](../do/own_effect.md).

At its null values an effect is absent. A fit searches from *low* to *high* and begins at *start*. The scale is
logarithmic where *low* is positive.

| mark of a parameter | values |
|---|---|
| *per channel* | one for each command: `gain.factor[0]`, `gain.factor[1]` |
| *shared* | the same, but one number (`backlash.gap`) serves all channels until they are given or fitted separately |
| *shared by cables* | one for each of the two cables of a channel; see below |
| *per pair* | one for each ordered pair of channels, `coupling.factor[0,1]`: the channel that moves comes first |
| *integer* | tried at each integer of the range, not optimised |

Beyond four channels only neighbours form pairs. `dead_zone.slack[0+]` is for the cable that a positive command pulls,
`dead_zone.slack[0-]` for the other one; `dead_zone.slack[0]` sets both. The path from command to camera is `command →
transmission → material → shape → sensing`. A chain is always composed in this order. Each picture shows one recording
without the effect and with it.

Values in mm of command are for commands of ±16 mm. On a robot with another range they scale with the range. A fit goes
beyond the search range where the data require it. *At most 2 half ranges* is twice the largest command. *At most 1
length* is the weight at the tip that would move it sideways by the length of the body if the answer were linear.

Loads move a finger by its fields, which are taken at constant tension of its tendons. The tendons then answer by
falling slack or taut. This is a complementarity problem, solved at every frame (`rust/response/cables.rs`). The answer
to large loads, and to changes of the modulus, includes second derivatives (`rust/response/second_order.rs`). The table
gives the error against the simulator on the built-in finger, with and without these derivatives. *Of* is the
displacement by the load. All are RMS over the vertices and eleven commands.

@LOADS@

The fields of a polynomial rod answer loads by one nominal compliance. An elastic rod answers with its tendons. It also
has the fields of its modulus along the body, of a curvature at rest and of the sides of its tendons. Both are linear.
"""


LEANING = (float(np.sin(np.radians(35.0))), 0.0, float(np.cos(np.radians(35.0))))
LOADS = {  # what the page calls it: gravity in the base frame, grams at the tip
    "horizontal instead of hanging": ((1.0, 0.0, 0.0), 0.0),
    "25 g at the tip, hanging": ((0.0, 0.0, 1.0), 25.0),
    "25 g at the tip, leaning by 35°": (LEANING, 25.0),
    "60 g at the tip, leaning by 35°": (LEANING, 60.0),
    "60 g at the tip, horizontal": ((0.0, -1.0, 0.0), 60.0),
    "60 g at the tip, pointing upwards by 54°": ((0.5, -0.3, -0.8124), 60.0),
}
NEWTON_PER_GRAM = 9.80665e-3


def load_errors() -> dict[str, tuple[float, float, float]]:
    """Return for each load how far the model misses the simulator, mm RMS.

    Also how far without a second level, and how far the load moves the hanging finger.
    """
    model, simulator = builtin_model(), Simulator(Finger.builtin())
    u = np.vstack([np.zeros((1, 2)), np.random.default_rng(3).uniform(-14.0, 14.0, (10, 2))])
    t = np.arange(len(u), dtype=float)
    bare, found = simulator.path(u), {}
    for name, (direction, grams) in LOADS.items():
        gravity = np.array(direction) / np.linalg.norm(direction)
        truth = simulator.path(u, gravity=gravity, load=NEWTON_PER_GRAM * grams * gravity) - bare
        loaded = Run(t=t, command=u, t_seen=t, gravity=gravity, load=np.full(len(u), grams))
        misses = []
        for one in (model, model.with_structure(second=None)):
            moved = one.predict(loaded) - one.predict(Run(t=t, command=u, t_seen=t))
            misses.append(_rms(moved - truth))
        found[name] = (misses[0], misses[1], _rms(truth))
    return found


def _rms(moved: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=-1))))


def load_table(errors: dict[str, tuple[float, float, float]]) -> str:
    """Return the table of `load_errors`."""
    rows = [
        f"| {name} | {miss:.2f} mm | {linear:.2f} mm | {of:.1f} mm |"
        for name, (miss, linear, of) in errors.items()
    ]
    return "\n".join(["| load | error | linear | of |", "|---|---|---|---|", *rows])


# --- pictures -------------------------------------------------------------------------------------

# mm of both channels; a dwell is a knot twice. One channel at a time, growing, so that crosstalk
# and history show.
FIRST = [0, 5, -5, 11, 11, -11, 7, 7, 0, 0, 0, 0, 0, 0]
SECOND = [0, 0, 0, 0, 0, 0, 0, 0, 0, 9, 9, -9, 0, 0]
KNOTS = np.array([FIRST, SECOND], float).T
# Two cameras that look along −x and −y at a place 30 mm above the base, from 200 mm away.
CAMERAS = np.array(
    [
        [[0, 1, 0, 0], [0, 0, -1, 30], [-1, 0, 0, 200]],
        [[-1, 0, 0, 0], [0, 0, -1, 30], [0, -1, 0, 200]],
    ]
)
LASTS = {"delay": 7.0, "slow drift": 200.0}  # s, by family; others:
USUAL = 60.0
POSTURES = (0, 4, 13)  # knots seen from the side: at home, at 11 mm, home again


def pictured(effect: dict[str, Any]) -> bytes:
    """Draw an effect: what it does to the built-in finger during one recording (SVG)."""
    model = builtin_model()
    lasts = LASTS.get(effect["family"], USUAL)
    t = np.linspace(0.0, lasts, 561)
    moments = np.linspace(0.0, lasts, len(KNOTS))
    u = np.stack([np.interp(t, moments, column) for column in KNOTS.T], axis=1)
    warm = 22.0 + 9.0 * (1.0 - np.exp(-4.0 * t / lasts))
    run = Run(t=t, command=u, t_seen=t, temperature=warm, cameras=CAMERAS)
    chain = _core.Chain([effect["name"]], 2)
    commands = effect["role"] == "channel"
    far = np.where(chain.high > chain.null, chain.high, chain.low)
    params = chain.start if commands else 0.5 * (chain.null + far)
    with matplotlib.rc_context({**STYLE, "svg.hashsalt": effect["name"]}):
        figure = Figure(figsize=(8.0, 2.7), layout="constrained")
        if commands:
            _channel(figure, t, u, chain.rollout(params[None], u, t, temperature=warm)[0])
        else:
            sets = np.stack([chain.null, params])
            if effect["role"] == "prior":
                frames = _rod().predict(chain, sets, _core.Inputs(u, t, t))
            else:
                frames = model.predict_features((effect["name"],), sets, run)[
                    :, :, model.structure.positions
                ]
            _seen(figure, t, moments, frames[0], frames[1])
        units = dict(
            zip(
                [*chain.labels, *chain.group_labels],
                ["" if u == "1" else f" {u}" for u in chain.units] * 2,
            )
        )
        given = ", ".join(
            f"{n.split('.')[1]} {v:.3g}{units[n]}" for n, v in named(chain, params).items()
        )
        figure.suptitle(given, size=9.0, x=0.01, ha="left")
        target = io.BytesIO()
        figure.savefig(
            target, format="svg", facecolor="white", metadata={"Date": None, "Creator": None}
        )
        return target.getvalue()


def _rod() -> _core.Predictor:
    """Return an elastic rod of 105 mm with four push-pull tendons 6 mm off its axis."""
    quarter = np.pi / 2 * np.arange(4.0)
    numbers = [
        [1.0],
        quarter,
        [6.0] * 4,
        np.zeros(4),
        [30.0],
        [105.0],
        np.zeros(2),
        np.zeros(3),
        np.zeros(2),
    ]
    tendons = [0] * 4, [0, 1, 0, 1], [1.0, 1.0, -1.0, -1.0]
    rod = _core.ElasticRod(
        1, 2, *tendons, list(np.linspace(0.0, 1.0, 10)[1:]), np.concatenate(numbers)
    )
    return _core.Predictor(rod, {}, [True] * 9, np.array([0.0, 0.0, 1.0]))


def _channel(figure: Figure, t: Floats, u: Floats, acts: Floats) -> None:
    """Draw the commanded u and the effective command `acts` (T, 2) mm over t (T,) s.

    Also what the effect adds.
    """
    time, plane = figure.subplots(1, 2, width_ratios=[1.7, 1.0])
    for c, line in enumerate(("-", (0, (3, 2)))):
        time.plot(
            t, u[:, c], color=BEFORE, linewidth=1.0, linestyle=line, label=f"commanded, channel {c}"
        )
        time.plot(
            t,
            acts[:, c],
            color=AFTER,
            linewidth=1.4,
            linestyle=line,
            label=f"effective, channel {c}",
        )
    time.set(xlabel="time, s", ylabel="mm")
    time.legend(loc="lower left", ncols=2, frameon=False, fontsize=7.5)
    time.set_ylim(np.min([u, acts]) - 7.0, None)
    alone = t <= t[np.flatnonzero(u[:, 1])[0]]  # while channel 0 moves by itself
    crossed = abs(np.polyfit(u[alone, 0], acts[alone, 1], 1)[0]) > 0.02
    if crossed:
        plane.plot(u[:, 0], u[:, 1], color=BEFORE, linewidth=1.0)
        plane.plot(acts[:, 0], acts[:, 1], color=AFTER, linewidth=1.4)
        plane.set(xlabel="channel 0, mm", ylabel="channel 1, mm", aspect="equal")
    else:
        added = acts[:, 0] - u[:, 0]
        plane.plot(u[:, 0], added, color=AFTER, linewidth=1.2)
        plane.set_ylim(1.1 * min(added.min(), -0.02), 1.1 * max(added.max(), 0.02))
        plane.set(xlabel="commanded, channel 0, mm", ylabel="added, mm")
    for axes in (time, plane):
        axes.grid(color=FAINT, linewidth=0.8)


def _seen(figure: Figure, t: Floats, moments: Floats, before: Floats, after: Floats) -> None:
    """Draw section middles (T, S, 3) mm from the side at three moments.

    Also what is added at the tip over time.
    """
    side, time = figure.subplots(1, 2, width_ratios=[1.0, 1.7])
    for frames, colour in ((before, BEFORE), (after, AFTER)):
        for knot in POSTURES:
            body = frames[int(np.argmin(np.abs(t - moments[knot])))]
            side.plot(body[:, 0], body[:, 2], "o-", color=colour, linewidth=1.3, markersize=2.5)
    added = after[:, -1] - before[:, -1]
    for axis, line in enumerate(("-", (0, (4, 2)), (0, (1, 1.5)))):
        time.plot(t, added[:, axis], color=AFTER, linewidth=1.3, linestyle=line, label="xyz"[axis])
    time.set_ylim(1.1 * min(added.min(), -0.02), 1.1 * max(added.max(), 0.02))
    side.set(xlabel="x, mm", ylabel="z, mm", aspect="equal")
    time.set(xlabel="time, s", ylabel="added at the tip, mm")
    time.legend(ncols=3, frameon=False, fontsize=7.5)
    for axes in (side, time):
        axes.grid(color=FAINT, linewidth=0.8)


def page(loads: str) -> str:
    """Return the page as text; `loads` is the table of the errors under loads."""
    effects = _core.effects()
    rows = [
        f"| [{e['name']}](#{e['name']}) | {e['stage']} | {e['family']} | `{e['formula']}` |"
        for e in effects
    ]
    index = "\n".join(["| effect | stage | family | form |", "|---|---|---|---|", *rows])
    return "\n".join([HEAD.replace("@LOADS@", loads), index, "", *(_section(e) for e in effects)])


def _section(effect: dict[str, Any]) -> str:
    block, minutes = effect["experiment"]
    needs = ", ".join(effect["needs"]) or "nothing beyond commands"
    facts = f"{effect['role']} effect of the stage *{effect['stage']}*, family *{effect['family']}*"
    if effect["kind"] == "fault":
        facts += "; a fault of the measurement, not of the robot"
    parameters = [
        f"| `{effect['name']}.{p['name']}`{_each(p)} | {p['unit']} | {p['null']:g} | "
        f"{p['start']:g} | {p['low']:g} to {p['high']:g}{' (log)' if p['log'] else ''}{_reach(p)} "
        f"| {p['doc']} |"
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
            f"![Without and with {effect['name']}](../pictures/effects/{effect['name']}.svg)",
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


def _reach(parameter: dict[str, Any]) -> str:
    half, lengths = parameter["half_ranges"], parameter["lengths"]
    return (
        f", at most {half:g} half ranges"
        if half
        else f", at most {lengths:g} lengths"
        if lengths
        else ""
    )


def _each(parameter: dict[str, Any]) -> str:
    each = {
        "per_cable": " shared by cables",
        "shared": " shared",
        "per_channel": " per channel",
        "per_pair": " per pair",
    }
    # the first key that holds is the most exact
    words = [word for key, word in each.items() if parameter[key]][:1]
    return "".join(words + [" integer"] * parameter["integer"])


if __name__ == "__main__":
    PAGE.write_text(page(load_table(load_errors())), encoding="utf-8")
    PICTURES.mkdir(exist_ok=True)
    for declared in _core.effects():
        (PICTURES / f"{declared['name']}.svg").write_bytes(pictured(declared))
