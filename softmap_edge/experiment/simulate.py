"""The open questions of a diagnosis, and the predicted outcome of each answer.

Outcomes are predicted for a block of commands that is not recorded yet.

`Outcomes` holds the questions, the fitted parameters of each answer, the noise and the old runs;
`answers` simulates a block and returns the error of the wrong answer (`choose.py` has the formula).
Predictions are those of the diagnosis itself: records, noise and model-form error, whitened
features, bounded fits. Pinned by tests/experiment/test_next_experiment.py.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.clean import clean_run
from softmap_edge.diagnosis.decision import VISIBLE_MM
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.diagnosis.findings import Alternative
from softmap_edge.diagnosis.fit import Problem
from softmap_edge.diagnosis.fits import Fits
from softmap_edge.diagnosis.prepare import problem_of
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.records import record_of
from softmap_edge.diagnosis.separate import families_of
from softmap_edge.errors import SoftmapError
from softmap_edge.experiment.blocks import BLOCKS, Block, Setting, plan
from softmap_edge.files.atomic import Document
from softmap_edge.model.effect_info import Registry, registry
from softmap_edge.noise.noise_model import FLOOR, Noise
from softmap_edge.run.protocol import Limits, Protocol
from softmap_edge.run.run import Run

if TYPE_CHECKING:
    from softmap_edge.model.model import Model

Floats = NDArray[np.float64]

OLD = 300  # simulated frames of the old runs


@dataclass(frozen=True)
class OpenQuestion:
    """An open question: two sets of effects that explain the runs equally well.

    With `hidden`, it is an effect that the runs cannot show.
    """

    one: tuple[str, ...]
    other: tuple[str, ...]
    hidden: str | None = None
    # families of the two sets, if they differ
    families: tuple[str, str] | None = field(default=None, compare=False)

    @property
    def names(self) -> list[str]:
        """The effects of the question."""
        if self.hidden is not None:
            return [self.hidden]
        return [e for e in self.one if e not in self.other] + [
            e for e in self.other if e not in self.one
        ]


class Outcomes:
    """The open questions, and each answer's prediction for a block not recorded yet."""

    def __init__(
        self, model: Model, diagnosis: Diagnosis, runs: list[Run], references: Sequence[Run] = ()
    ) -> None:
        self.model, self.registry = model, registry()
        _check(model, diagnosis, runs, self.registry, references)
        self.paired = diagnosis.made_from.get("reference") is not None
        self.runs = runs = [clean_run(model, run).run for run in runs]
        self.references = [clean_run(model, run).run for run in references]
        known = [e.name for e in (*diagnosis.effects, *diagnosis.faults)]
        self.found = tuple(name for name in self.registry if name in known)
        asked = _questions(diagnosis, self.found, tuple(model.chain_names))
        self.beyond = [
            q for q in asked if q.hidden is None and any(model.missing_for(n) for n in q.other)
        ]
        # effects without a field in the model are not simulated
        self.questions = [q for q in asked if q not in self.beyond]
        sets = list(
            dict.fromkeys([self.found, *(q.other for q in self.questions if q.hidden is None)])
        )
        self.hidden = [q.hidden for q in self.questions if q.hidden is not None]
        self.setting = Setting.after(runs, model.gravity_reference)
        self.bare = _blank_record(model, self.setting)
        self.old = record_of(model, _thinned(runs), self.references or None) if runs else None
        named = [n for n in self.registry if any(n in s for s in sets) or n in self.hidden]
        self.names = [n for n in named if not model.missing_for(n)]
        self.params: dict[tuple[str, ...], dict[str, float]] = {}
        if runs:
            combined = record_of(model, runs, self.references or None)
            problem = problem_of(combined, [n for n in self.names if self.declared(n)])
            fitted = Fits(problem, [n for n in self.names if self.declared(n)])
            fits = {key: fitted.get(key) for key in sets}
            self.noise, self.dispersion = problem.noise, fitted.dispersion(fits[self.found])
            self.params |= {key: fit.params for key, fit in fits.items()}
        else:
            self.noise, self.dispersion = _declared_noise(model, diagnosis), 1.0
            found_params: dict[str, float] = {}
            for name in self.found:
                found_params |= diagnosis.params_of(name)
            self.params |= {key: self._middle(key) | found_params for key in sets}

    def blocks(self, limits: Limits) -> list[Block]:
        """Return the blocks that the robot can play and that could resolve a question."""
        needed = {field for name in self.names for field in self.registry[name].needs}
        return [
            b
            for b in BLOCKS.values()
            if b.channels <= limits.channels
            and (b.changes != "temperature" or "temperature" in needed)
        ]

    def answers(self, made: Protocol, changes: str) -> list[tuple[OpenQuestion, float]]:
        """Return the separation of each question in a block that `changes` a condition."""
        run = _blank(self.model, made, self.runs[0] if self.runs else None, self.setting)
        own = [run] if self.paired else []  # the block is also played in the state of the reference
        new = Record(self.model, run, own or None)
        parts = [] if self.old is None else [self.old]
        joint = record_of(self.model, [*_thinned(self.runs), run], [*self.references, *own] or None)
        problem = problem_of(
            joint, [n for n in self.names if self._predicted(n, [*parts, new])], self.noise
        )
        alone = _Linear(
            self,
            problem_of(new, [n for n in self.names if not new.missing(self.needs(n))], self.noise),
            [new],
        )
        both = _Linear(self, problem, [*parts, new])
        found = []
        for question in self.questions:
            if question.hidden is None:
                ways = ((question.one, question.other), (question.other, question.one))
                apart = 0.0
                if self._resolvable(question, changes):
                    apart = min(self._apart(problem, [*parts, new], a, b) for a, b in ways)
            elif question.hidden not in self.names or not self._shows(question.hidden, changes):
                apart = 0.0
            elif self.declared(question.hidden):
                apart = both.left(question.hidden) - self._hidden_before(question.hidden)
                apart = apart if self._moved(question.hidden, new) >= VISIBLE_MM else 0.0
            elif new.missing(self.needs(question.hidden)):
                apart = 0.0
            else:  # the earlier runs do not show it: use the new one alone
                apart = alone.left(question.hidden)
                apart = (
                    apart if new.rms_mm(self._shift(question.hidden, new)) >= VISIBLE_MM else 0.0
                )
            found.append((question, max(apart, 0.0) / self.dispersion))
        return found

    # --- alternatives, refitted in full -----------------------------------------------------------

    def _resolvable(self, question: OpenQuestion, changes: str) -> bool:
        """Whether a block that `changes` a condition can separate a pair, by the library."""
        mine = [e for e in question.one if e not in question.other]
        theirs = [e for e in question.other if e not in question.one]
        if len(mine) != 1 or len(theirs) != 1:
            return True
        by = self.registry[mine[0]].alike.get(theirs[0]) or self.registry[theirs[0]].alike.get(
            mine[0]
        )
        return by is None or by == changes

    def _shows(self, name: str, changes: str) -> bool:
        """Whether a block that `changes` a condition can show an effect.

        The effect may need another orientation.
        """
        by = set(self.registry[name].alike.values())
        return by != {"orientation"} or changes == "orientation"

    def _apart(
        self, problem: Problem, parts: list[Record], true: tuple[str, ...], tried: tuple[str, ...]
    ) -> float:
        """Return the increase of the chi² of `tried` by the block, if `true` holds."""
        return self._left(problem, parts, true, tried) - self._before(true, tried)

    def _left(
        self, problem: Problem, parts: list[Record], true: tuple[str, ...], tried: tuple[str, ...]
    ) -> float:
        """Return the least chi² of `tried`, if `true` holds."""
        seen = np.isfinite(problem.record.seen)
        truth = np.concatenate([self.predicted(part, true, self.params[true]) for part in parts])
        problem.record.seen = np.where(seen, truth, np.nan)
        space = problem.space(tried)
        params = self.params[tried]
        values = np.array([_of(params, label, self._middle(tried)) for label in space.free_labels])
        return float(problem.fit(tried, [space.scaled(values)]).chi2)

    def _before(self, true: tuple[str, ...], tried: tuple[str, ...]) -> float:
        """Return the same on the old runs alone."""
        if self._old_problem is None or self.old is None:
            return 0.0
        key = (true, tried)
        if key not in self._kept:
            self._kept[key] = self._left(self._old_problem, [self.old], true, tried)
        return self._kept[key]

    @cached_property
    def _kept(self) -> dict[Hashable, float]:
        return {}

    @cached_property
    def _old_problem(self) -> Problem | None:
        if self.old is None:
            return None
        return problem_of(self.old, [n for n in self.names if self.declared(n)], self.noise)

    @cached_property
    def _old_linear(self) -> _Linear | None:
        return (
            None
            if self._old_problem is None or self.old is None
            else _Linear(self, self._old_problem, [self.old])
        )

    def _hidden_before(self, name: str) -> float:
        if self._old_linear is None:
            return 0.0
        if name not in self._kept:
            self._kept[name] = self._old_linear.left(name)
        return self._kept[name]

    def _moved(self, name: str, new: Record) -> float:
        """Return the effect size of an unseen effect over old runs and block, mm RMS."""
        squares = len(new) * new.rms_mm(self._shift(name, new)) ** 2
        frames = sum(run.frames for run in self.runs)
        if self.old is not None:
            key = ("moved", name)
            if key not in self._kept:
                self._kept[key] = self.old.rms_mm(self._shift(name, self.old))
            squares += frames * self._kept[key] ** 2
        return float(np.sqrt(squares / (len(new) + frames)))

    def _shift(self, name: str, record: Record) -> Floats:
        effects, params = self.with_hidden(name)
        there = self.predicted(record, effects, params)
        return there - self.predicted(record, self.found, self.params[self.found])

    # --- what is predicted ----------------------------------------------------------------------

    def predicted(
        self, record: Record, effects: tuple[str, ...], params: Mapping[str, float]
    ) -> Floats:
        """Return features (K, F) mm of a record with some effects on top of the model's own."""
        own = tuple(self.model.chain_names)
        layout = record.layout(own + tuple(e for e in effects if e not in own))
        rest = dict(zip(layout.labels, layout.null)) | record.own_values()
        values = np.array([_of(params, label, rest) for label in layout.labels])
        return np.asarray(record.predict(layout.names, values[None])[0])

    def with_hidden(self, name: str) -> tuple[tuple[str, ...], dict[str, float]]:
        """Return the effects found, with one more effect at typical strength."""
        return (*self.found, name), self._middle((name,)) | self.params[self.found]

    def _middle(self, effects: Sequence[str]) -> dict[str, float]:
        """Return parameters of typical strength: halfway from null to high, or the start.

        The start is for parameters on a log scale.
        """
        layout = self.bare.layout(tuple(effects))
        return dict(zip(layout.labels, map(float, layout.middle)))

    def needs(self, name: str) -> list[str]:
        return list(self.registry[name].needs)

    def _predicted(self, name: str, parts: Sequence[Record]) -> bool:
        return not any(part.missing(self.needs(name)) for part in parts)

    def declared(self, name: str) -> bool:
        """Whether the old runs declare what an effect needs."""
        return self.old is None or not self.old.missing(self.needs(name))


class _Linear:
    """The signature of an unseen effect, after one linearised step of the parameters found."""

    def __init__(self, world: Outcomes, problem: Problem, parts: list[Record]) -> None:
        self.world, self.problem, self.parts = world, problem, parts

    @cached_property
    def _base(self) -> list[Floats]:
        world = self.world
        return [
            world.predicted(part, world.found, world.params[world.found]) for part in self.parts
        ]

    @cached_property
    def _jacobian(self) -> Floats:
        """Slopes (P, n) of the white residual over the parameters found."""
        problem, world = self.problem, self.world
        if not world.found:
            return np.zeros((0, 1))
        space = problem.space(world.found)
        kept, problem.record.seen = problem.record.seen, np.concatenate(self._base)
        rest = world._middle(world.found)
        x = space.scaled(
            np.array([_of(world.params[world.found], label, rest) for label in space.free_labels])
        )
        modes = problem.at(space, x[None])[0]
        slopes = problem.slopes(space, x, modes)
        problem.record.seen = kept
        return problem.white(slopes)

    def left(self, name: str) -> float:
        """Return the remaining chi² of an effect at typical strength."""
        shift = np.concatenate([self.world._shift(name, part) for part in self.parts])
        shift = np.where(np.isfinite(self.problem.record.seen), shift, np.nan)
        white = self.problem.white(self.problem.whitener.modes(shift) * self.problem.gain)
        if not len(self._jacobian):
            return float(white @ white)
        pull = self._jacobian @ white
        return float(
            white @ white
            - pull @ np.linalg.solve(self._jacobian @ self._jacobian.T + np.eye(len(pull)), pull)
        )


# --- what is asked ------------------------------------------------------------------------------


def _questions(
    diagnosis: Diagnosis, found: tuple[str, ...], own: tuple[str, ...]
) -> list[OpenQuestion]:
    asked = []
    for alternative in diagnosis.alternatives:
        effects = alternative.effects
        # a refit of the model's own effects needs no experiment
        if set(effects) != set(found) and not set(effects) & set(own):
            asked.append(OpenQuestion(found, effects, families=_between(diagnosis, alternative)))
    recordable = [row.name for row in diagnosis.not_testable if not row.of_model]
    asked += [OpenQuestion(found, found, name) for name in recordable if name not in found]
    return list(dict.fromkeys(asked))


def _between(diagnosis: Diagnosis, alternative: Alternative) -> tuple[str, str] | None:
    """Return the two families of an alternative; None within one family."""
    own = next((one.name for one in diagnosis.families if alternative.member in one.effects), "")
    new = [name for name in alternative.effects if name not in {e.name for e in diagnosis.effects}]
    other = alternative.family or next(iter(families_of(new)), "")
    return (own, other) if own and other and own != other else None


def _check(
    model: Model,
    diagnosis: Diagnosis,
    runs: Sequence[Run],
    known: Registry,
    references: Sequence[Run],
) -> None:
    made = diagnosis.made_from
    own = made.get("own_effects")
    if isinstance(own, list) and own != list(model.chain_names):
        raise SoftmapError(
            f"the diagnosis is of a model with {', '.join(map(str, own)) or 'no effects'}, this "
            f"one has {', '.join(model.chain_names) or 'none'}; give the bundle that was diagnosed"
        )
    recorded = made.get("run")
    hashes = [run.hash() for run in runs]
    if (
        runs
        and recorded is not None
        and sorted(hashes) != sorted(recorded if isinstance(recorded, list) else [recorded])
    ):
        raise SoftmapError(
            f"the diagnosis was made from other runs than the {len(runs)} given; give those, or "
            "diagnose these again"
        )
    _check_references(made.get("reference"), bool(runs), [run.hash() for run in references])
    named = [e.name for e in (*diagnosis.effects, *diagnosis.faults)]
    named += [e for alternative in diagnosis.alternatives for e in alternative.effects]
    named += [row.name for row in diagnosis.not_testable]
    unknown = [name for name in named if name not in known]
    if unknown:
        raise SoftmapError(
            f"the diagnosis names '{unknown[0]}', which this library lacks; diagnose again"
        )


def _check_references(recorded: object, runs: bool, given: list[str]) -> None:
    """Reject references other than those of a diagnosis.

    References of its held-out run are accepted.
    """
    if recorded is None and given:
        raise SoftmapError(
            "the diagnosis is not relative to a reference run; leave --reference out"
        )
    hashes = recorded.get("run") if isinstance(recorded, Mapping) else None
    needed = hashes if isinstance(hashes, list) else [hashes]
    if recorded is None or not (runs or given):
        return
    if not given:
        raise SoftmapError(
            "the diagnosis is relative to a reference run; give that run too, with --reference"
        )
    if not {str(h) for h in needed} <= set(given):
        raise SoftmapError(
            f"the diagnosis is relative to {len(needed)} other reference run(s) than the "
            f"{len(given)} given; give those"
        )


def _declared_noise(model: Model, diagnosis: Diagnosis) -> Noise:
    """Return the noise of a diagnosis without runs, equal for each coordinate."""
    stated = diagnosis.error.noise_floor
    mm = stated if stated is not None and 0 < stated < 1e3 else 0.3
    return Noise(
        np.eye(3 * len(model.structure.positions)) * max(mm / np.sqrt(3.0), FLOOR) ** 2,
        "stated",
        1.0,
    )


def _thinned(runs: Sequence[Run]) -> list[Run]:
    total = max(1, sum(run.frames for run in runs))
    share = min(1.0, OLD / total)
    return [
        run.at(
            np.unique(np.linspace(0, run.frames - 1, max(2, int(share * run.frames))).astype(int))
        )
        for run in runs
    ]


def _blank(model: Model, made: Protocol, like: Run | None, setting: Setting) -> Run:
    """Return a protocol as a run without measurements, observed in the way of `like`."""
    warm = made.temperature
    if warm is None and like is not None and like.temperature is not None:
        warm = np.full(made.t.size, setting.temperature)
    seen: Document = {"vertices": np.repeat(model.rest[None], made.frames, axis=0)}
    if model.markers or (like is not None and like.markers is not None):
        rest = model.rest if like is None or like.marker_rest is None else like.marker_rest
        seen = {"markers": np.repeat(rest[None], made.frames, axis=0), "marker_rest": rest}
    return Run(
        t=made.t,
        command=made.command,
        t_seen=made.t_seen,
        gravity=made.gravity,
        load=made.load,
        temperature=warm,
        block=made.block,
        robot=model.robot,
        command_unit=model.command_unit,
        **seen,
    )


def _blank_record(model: Model, setting: Setting) -> Record:
    """Return a record of two frames at home, with the parameters of any chain."""
    limits = Limits.of(model.command_range, model.command_unit)
    made = plan([BLOCKS["home revisits"]], limits, setting)
    blank = _blank(model, made, None, setting)
    return Record(model, blank.at([0, 1]))


def _of(params: Mapping[str, float], label: str, rest: Mapping[str, float]) -> float:
    """Return a parameter by label; a parameter per run is taken from the first run."""
    bare = label.split("@")[0]
    return params.get(label, params.get(bare, rest.get(label, rest.get(bare, 0.0))))
