"""Laws whose parameters change within a run: with temperature, time, speed or bend.

    p(t) ≈ p + θ c(t)  for each fitted parameter p of a law
    c: a condition with mean 0 and variance 1

The slopes of the prediction over the parameters, times the condition, are columns at level 1. A law
is constant unless these columns explain a good part of the loss that it explains. A changing law
may be another law of its family, or act on another effect. In both cases an unknown error remains.
To first order in θ. Pinned by tests/diagnosis/test_changing.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis import decision as rule
from softmap_edge.diagnosis.decision import difference, seen_to_fall
from softmap_edge.diagnosis.families import WARMED, declared, families, seen_commands
from softmap_edge.diagnosis.outcome import Outcome
from softmap_edge.diagnosis.representatives import State, best_ridge

Floats = NDArray[np.float64]

FAMILY_OF = {"temperature": "temperature", "time": "time", "speed": "rate", "bend": "softening"}


@dataclass(frozen=True)
class Change:
    """A law whose parameters change with a condition.

    Holds its effects, the condition, and the change's share of its loss.

    `share` is how far the change lowers the held-out loss, relative to what the law explains.
    """

    effects: tuple[str, ...]
    condition: str
    share: float

    def __str__(self) -> str:
        named = " and ".join(self.effects)
        return (
            f"the numbers of {named} change with the {self.condition}; this change explains "
            f"{100.0 * self.share:.0f} % of what {named} explains"
        )

    @property
    def experiment(self) -> tuple[str, float]:
        """The experiment that shows this change, and the minutes, as for the condition's family."""
        return next(f.experiment for f in families() if f.name == FAMILY_OF[self.condition])


def changing(outcome: Outcome) -> list[Change]:
    """Return the laws of a search with changing parameters, and the condition of each.

    The condition that explains most is returned.
    """
    state, found = outcome.state, []
    if outcome.loss.sum() <= rule.ABOVE_NOISE * outcome.body.problem.numbers:
        return []
    conditions = conditions_of(state)
    for step in outcome.steps:
        law = step.answer.law
        if (
            not step.answer.identified
            or law is None
            or not set(law.effects) <= set(state.fit.effects)
        ):
            continue
        explained = float(step.answer.before.sum()) - step.answer.left
        shares = {
            name: _fall(state, law.effects, c) / max(explained, 1e-300)
            for name, c in conditions.items()
        }
        most = max(shares, key=lambda name: shares[name], default="")
        if most and shares[most] >= rule.LEFT:
            found.append(Change(law.effects, most, shares[most]))
    return found


def conditions_of(state: State) -> dict[str, Floats]:
    """Return the conditions over the frames (K,) of a record, with mean 0 and variance 1."""
    body, rows = state.body, []
    warm = [declared(part.run.temperature, len(part.run.t)) for part in body.parts]
    known = all(row is not None and np.ptp(row) >= WARMED for row in warm)
    for part, commands, temperature in zip(body.parts, state.commands, warm):
        t, seen = np.asarray(part.run.t, float), np.asarray(part.t_seen, float)
        rate = np.gradient(commands, t, axis=0) if len(t) > 1 else np.zeros_like(commands)
        # no channels: a body under its weight alone
        speed = np.abs(rate / body.half).max(axis=1, initial=0.0)
        bend = np.abs((seen_commands(part, commands) - body.middle) / body.half).max(
            axis=1, initial=0.0
        )
        row = {"time": seen, "speed": np.interp(seen, t, speed), "bend": bend}
        if known and temperature is not None:
            row["temperature"] = np.interp(seen, t, temperature)
        rows.append(row)
    found = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    moving = found["speed"] > 0.0
    found["speed"] = (
        np.log1p(found["speed"] / np.median(found["speed"][moving]))
        if np.any(moving)
        else found["speed"]
    )
    return {
        name: (c - c.mean()) / c.std()
        for name, c in found.items()
        if c.std() > 1e-9 * max(1.0, np.abs(c).max())
    }


def _fall(state: State, effects: tuple[str, ...], condition: Floats) -> float:
    """Return the fall of the held-out loss if parameters change with a condition.

    The condition is (K,).
    """
    body, fit = state.body, state.fit
    own = np.flatnonzero(fit.space.of(effects))
    level = body.level()
    names, ridges = state.blocks(level)
    each = np.ascontiguousarray(np.tile(condition, (len(own), 1)))
    level.add("changing", np.ascontiguousarray(-fit.slopes[own]), np.arange(len(own)), each)
    level.close(np.ascontiguousarray(body.modes(state.residual)))
    before = np.asarray(level.losses(names, ridges))
    fall = difference(before, best_ridge(level, names, ridges, "changing")[0])
    return fall.fall if seen_to_fall(fall) and fall.fall >= rule.FALL * float(before.sum()) else 0.0
