"""Choose the experiment that resolves the open questions of a diagnosis.

Blocks are simulated before they are recorded.

A question is a pair of alternatives, or an effect that the runs could not show. If A is true and B
is assumed, the separation of a block is

    separation = min over B's parameters of |C^(-1/2) (A - B)|² on old runs and block, minus the
    same on the old runs,

divided by the over-dispersion of the diagnosis. It is the expected chi² difference (T-optimality;
Atkinson & Fedorov 1975). A has its fitted parameters; an unseen effect has those of typical
strength. C is the noise of the old runs plus the model-form error. That error is one function of
the command over old runs and block, so only a changed condition adds evidence. The smaller value of
the two directions of a pair counts. Effects that the library declares alike in one orientation (or
under one load) are separated only by blocks that change it: other differences are the form of the
library's laws. Alternatives are refitted in full, unseen effects against one linearised step. The
value of a block for a question that it resolves is its separation per minute, relative to the best
block. Questions between two families of effects rank first: a law is asked for only once its family
is known. Limits: old runs are thinned (`simulate.OLD` frames), which makes separations smaller, not
larger; blocks are assumed not to add to each other. Pinned by
tests/experiment/test_next_experiment.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.diagnosis.evidence import DETECTABLE
from softmap_edge.diagnosis.separate import separating
from softmap_edge.errors import SoftmapError
from softmap_edge.experiment.blocks import Block, plan
from softmap_edge.experiment.simulate import OpenQuestion, Outcomes
from softmap_edge.files.atomic import Document
from softmap_edge.run.protocol import Limits, Protocol
from softmap_edge.run.run import Run

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

SETTLED = DETECTABLE**2  # chi² from which a question is resolved: five standard deviations
UNSEEN = 0.25  # weight of an unseen effect, relative to a pair of alternatives
BUDGET = 6.0  # default length of a command file, minutes
SCHEMA = "softmap.next/1"


@dataclass(frozen=True, eq=False)
class Experiment:
    """A block to record: what it resolves, its separation, and its commands.

    The separation is the expected chi² difference between the hypotheses.

    `separation` is that of the first question that it resolves. It and `plan` are None if nothing
    was simulated. `answers` are (question, separation) of all questions.
    """

    block: str
    minutes: float
    settles: list[str]
    separation: float | None
    plan: Protocol | None = None
    answers: tuple[tuple[OpenQuestion, float], ...] = ()
    alone: str = ""  # why its run must be diagnosed without the earlier ones, if so

    def to_dict(self) -> Document:
        """Return an entry of `next`: `{block, minutes, settles, separation}`."""
        return {
            "block": self.block,
            "minutes": round(self.minutes, 2),
            "settles": self.settles,
            "separation": None if self.separation is None else float(f"{self.separation:.4g}"),
        }

    def settled(self) -> list[OpenQuestion]:
        """Return the questions that it resolves, alternatives first."""
        found = [(q, s) for q, s in self.answers if s >= SETTLED]
        return [
            q for q, _ in sorted(found, key=lambda pair: (pair[0].hidden is not None, -pair[1]))
        ]

    def __str__(self) -> str:
        apart = (
            "no block that was simulated settles it for sure" if self.answers else "not simulated"
        )
        apart = (
            apart
            if self.separation is None
            else f"separation {float(f'{self.separation:.3g}'):g} (chi²)"
        )
        settles = ", ".join(self.settles) or "nothing"
        return f"{self.block} ({self.minutes:.1f} min): settles {settles}; {apart}{self.alone}"


def next_experiment(
    model: Model,
    diagnosis: Diagnosis,
    runs: Sequence[Run],
    limits: Limits | None = None,
    progress: Callable[[float], None] | None = None,
    references: Sequence[Run] = (),
) -> list[Experiment]:
    """Rank blocks of commands by how well a minute of each resolves the open questions.

    Args:
        model: the model that was diagnosed.
        diagnosis: its alternatives and untestable effects are the questions.
        runs: the diagnosed runs; without any, each block is rated alone, with parameters of typical
            strength.
        limits: limits of the robot; three quarters of the model's range by default.
        progress: called with the completed share.
        references: the reference runs of the diagnosis, if any; then a block counts as played in
            both states.

    Returns:
        list: experiments, best first: by separation of families, then by all questions. Questions
        that no block resolves come last, with the advice of the library. Empty if nothing is open.

    Raises:
        SoftmapError: the diagnosis is of another model or other runs, or names unknown effects.
    """
    if model.channels == 0:
        raise SoftmapError(
            "the model takes no commands, so no block of commands can settle anything"
        )
    limits = limits or Limits.of(model.command_range, model.command_unit)
    world = Outcomes(model, diagnosis, list(runs), references)
    found = []
    blocks = world.blocks(limits) if world.questions else []
    for i, block in enumerate(blocks):
        plan_ = plan([block], limits, world.setting)
        answers = world.answers(plan_, block.changes)
        found.append(_experiment(world, block, plan_, answers))
        if progress is not None:
            progress((i + 1) / len(blocks))
    worth = _worth([e for e in found if e.settles], world.questions)
    between = _worth(list(worth), _between_families(world.questions))
    good = sorted(worth, key=lambda e: (-between[e], -worth[e]))
    settled = {q for e in good for q in e.settled()}
    return [
        *good,
        *_rest(world, [q for q in (*world.questions, *world.beyond) if q not in settled]),
    ]


def program(experiments: Sequence[Experiment], minutes: float = BUDGET) -> list[Experiment]:
    """Return which experiments to record together.

    These are the first, then, while time remains, those that resolve further questions.
    """
    candidates = [e for e in experiments if e.plan is not None]
    still = list(dict.fromkeys(q for e in candidates for q in e.settled()))
    taken: list[Experiment] = []
    while candidates and still:
        between, worth = _worth(candidates, _between_families(still)), _worth(candidates, still)
        best = max(candidates, key=lambda e: (between[e], worth[e]))
        candidates.remove(best)
        if not taken or sum(e.minutes for e in [*taken, best]) <= minutes:
            taken.append(best)
            still = [q for q in still if q not in best.settled()]
            candidates = [e for e in candidates if any(q in still for q in e.settled())]
    return taken


def _between_families(questions: Sequence[OpenQuestion]) -> list[OpenQuestion]:
    """Return the questions between two families of effects; they precede those between laws."""
    return [question for question in questions if question.families is not None]


def _worth(
    experiments: Sequence[Experiment], questions: Sequence[OpenQuestion]
) -> dict[Experiment, float]:
    """Return the value of each experiment for some questions."""
    worth = dict.fromkeys(experiments, 0.0)
    for question in questions:
        rate = {
            e: dict(e.answers)[question] / max(e.minutes, 1e-9)
            for e in experiments
            if question in e.settled()
        }
        for e, speed in rate.items():
            worth[e] += (1.0 if question.hidden is None else UNSEEN) * speed / max(rate.values())
    return worth


def _experiment(
    world: Outcomes, block: Block, made: Protocol, answers: list[tuple[OpenQuestion, float]]
) -> Experiment:
    bare = Experiment(block.name, made.minutes, [], None, made, tuple(answers))
    names = list(dict.fromkeys(name for q in bare.settled() for name in q.names))
    first = next((s for q, s in answers if q in bare.settled()[:1]), None)
    missing = [name for name in names if not world.declared(name)]
    fields = dict.fromkeys(field for name in missing for field in world.needs(name))
    alone = (
        f"; for {', '.join(missing)} diagnose its run by itself, the earlier ones declare no "
        f"{', '.join(fields)}"
    )
    return replace(bare, settles=names, separation=first, alone=alone if missing else "")


def _rest(world: Outcomes, questions: Sequence[OpenQuestion]) -> list[Experiment]:
    """Return the advice of the library for questions that no block resolves."""
    rows: dict[str, Experiment] = {}
    tried = set(world.questions)
    for question in sorted(questions, key=lambda q: q.families is None):
        apart = None if question.families is None else separating(*question.families)
        for name in question.names:
            text, minutes = apart or world.registry[name].experiment
            answers = ((question, 0.0),) if question in tried else ()
            row = rows.setdefault(text, Experiment(text, minutes, [], None, answers=answers))
            row.settles.extend([name] if name not in row.settles else [])
    return list(rows.values())
