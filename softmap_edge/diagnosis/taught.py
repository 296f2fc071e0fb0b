"""Training runs of a model: what the model already contains, and what such a run can show.

A learned model was fitted to its runs. Its static map contains the static effects present then, so
these runs show no static effect. `softmap learn` also adds the memory that it finds to the chain
(`Model.learned_in`). With --static it leaves all memory to the diagnosis. That memory has distorted
the static map. So each law is fitted with the map solved again (`Record.remapped`,
`families.State`). Pinned by tests/diagnosis/test_taught.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from softmap_edge import _core
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.diagnosis.families import families
from softmap_edge.diagnosis.findings import FamilyFinding, Finding, NextBlock, Untestable
from softmap_edge.diagnosis.record import Record
from softmap_edge.run.conditions import orientations

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.run.run import Run

WHY = (
    "the model was learned from this run, so its static map contains what was static in the robot "
    "then"
)
LATER = "the same moves after the change, in a run that takes no part in learning", 4.0
BENT = "the static map was learned while the memory acted, so it is fitted again here"
AGAIN = (
    "`softmap learn` without --static: the memory has bent the static map, so the numbers found "
    "here are biased"
)


@dataclass(frozen=True)
class TaughtRuns:
    """The training runs of the model among `count` runs, and how it was learned.

    Runs are numbered from 1; it also holds whether --static was used, and the map.

    A polynomial is a `free` map that follows any static effect. The rod of a `robot.toml` follows
    few of them. So static effects show even in its training runs.
    """

    runs: tuple[int, ...] = ()
    count: int = 1
    free: bool = False
    static: bool = False
    learned_in: tuple[str, ...] = ()

    @classmethod
    def by(cls, model: Model, runs: Sequence[Run]) -> TaughtRuns:
        """Find the training runs of a model; none if it was not learned from runs."""
        made_from = model.made_from
        if not made_from.get("runs"):
            return cls(count=len(runs))
        numbers = tuple(i for i, run in enumerate(runs, 1) if model.taught_by(run))
        names = tuple(one.name for one in model.learned_in if one.name)
        free = isinstance(model.prior, _core.Rod)
        return cls(numbers, len(runs), free, bool(made_from.get("static")), names)

    @property
    def all(self) -> bool:
        """Whether every run is a training run."""
        return len(self.runs) == self.count

    @property
    def remaps(self) -> bool:
        """Whether the static map is solved again with each law, at least initially.

        It is, if memory has distorted it.

        Without --static, `learn` solved it together with the memory that it found.
        """
        return self.free and self.static

    def __str__(self) -> str:
        """Report the training runs, the learned effects, and what these runs can show."""
        if self.static:
            memory = "memory can, because the model was learned with --static"
        elif self.learned_in:
            memory = f"memory was learned as well: {', '.join(self.learned_in)} (in its chain)"
        else:
            memory = "memory was tested as well, and none was added to its chain"
        if self.count == 1:
            who = "this run"
        elif self.all:
            who = "these runs"
        else:
            who = f"run {', '.join(map(str, self.runs))}"
        held = "its static map holds what was static then, so no static effect can show"
        if not self.free:
            held = (
                "static effects can show only as far as the rod of its robot.toml does not follow "
                "them"
            )
        elif not self.all:
            held = "only the other runs can show a static effect"
        return f"{who} taught the model: {held}; {memory}"

    def hidden(self, record: Record, candidates: Sequence[str]) -> list[Untestable]:
        """Return the candidates hidden by the static map, or by solving it again."""
        if not record.remapped and not (self.free and self.all):
            return []
        loaded = record.load is not None and float(np.ptp(record.load)) > 0
        varied = loaded or orientations(record.state.gravity) > 1
        static = {
            n
            for f in families()
            if f.kind == "static" and not (f.name == "load" and varied)
            for n in f.members
        }
        found = (WHY, *LATER) if self.all else (BENT, AGAIN, 0.0)
        return [Untestable(name, *found) for name in candidates if name in static]

    def next(self, found: Sequence[Finding]) -> list[NextBlock]:
        """Return how to fit memory found with the static map solved again."""
        return (
            [NextBlock(AGAIN, 0.0, tuple(one.name for one in found))]
            if self.static and found
            else []
        )


def with_unknown(model: Model, found: Diagnosis, teacher: TaughtRuns) -> Diagnosis:
    """Add to a diagnosis without names the memory without a law that `learn` detected, if any.

    The error of a learned model is part of its noise. Such a memory is part of this error. In
    training runs, a family found with a fixed map does not count: `learn` solved the map again with
    each family.
    """
    unknown = next((one for one in model.learned_in if not one.name), None)
    silent = found.verdict in ("nothing", "cannot_tell")
    lawless = found.verdict == "partly_explained" and not found.effects and not found.faults
    if unknown is None or not (silent or (lawless and teacher.all)):
        return found
    kinds, before, after = {f.name: f.kind for f in families()}, unknown.before_mm, unknown.after_mm
    moved = float(np.sqrt(max(0.0, before**2 - after**2)))
    others = tuple(dict.fromkeys(one.family for one in unknown.alternatives))
    family = FamilyFinding(
        unknown.family,
        kinds.get(unknown.family, "memory"),
        "unknown",
        (),
        (moved / before) ** 2,
        moved,
        alternatives=others,
    )
    sentence = (
        f"An unknown law of the family {unknown.family}, {moved:.2f} mm RMS, was detected while "
        "the model was learned; the model does not contain "
        f"it.{' ' + found.sentence if silent else ''}"
    )
    return replace(found, verdict="partly_explained", families=(family,), sentence=sentence)
