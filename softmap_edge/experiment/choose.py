"""Chooses the experiment that settles what a diagnosis left open: blocks are simulated before they are recorded.

A question is a pair of rivals, or an effect that the runs could not show. With A true and B believed, a block is worth

    separation = min over B's parameters of |C^(-1/2) (A - B)|² on old runs and block, less the same on the old runs,

over the over-dispersion of the diagnosis: the chi² that would be left (T-optimality; Atkinson & Fedorov 1975). A has
its fitted parameters, an effect that was not seen those of mid-range; C is the noise of the old runs and the model's
form error, which is one function of the command over old runs and block: what only a changed condition shows counts.
Of a pair the smaller of both directions holds. Effects that the library calls alike in one orientation (or under one
load) are told apart by blocks that change it and by no others: what differs elsewhere is the form of the library's
laws. Rivals are refitted in full, unseen effects against one linearised step. A block is worth, for each question that
it settles, its separation a minute over that of the best block for this question.
Limits: old runs are thinned to OLD frames, which makes separations smaller, not larger; several blocks are taken to
add nothing to each other. Pinned by tests/test_next_experiment.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.diagnose import Diagnosis, _problem
from softmap_edge.diagnosis.evidence import DETECTABLE, experiment
from softmap_edge.diagnosis.fit import Problem
from softmap_edge.diagnosis.noise import FLOOR, Noise
from softmap_edge.diagnosis.record import Record, record_of
from softmap_edge.diagnosis.search import VISIBLE_MM, Search
from softmap_edge.errors import SoftmapError
from softmap_edge.experiment.blocks import BLOCKS, Block, Setting, plan
from softmap_edge.protocol import Limits, Protocol
from softmap_edge.run import Run

if TYPE_CHECKING:
    from softmap_edge.model import Model

Floats = NDArray[np.float64]

SETTLED = DETECTABLE**2  # chi² from which a question counts as settled: five standard deviations
UNSEEN = 0.25  # worth of an effect that was not seen, over that of a pair of rivals
OLD = 300  # frames of the old runs that are simulated
BUDGET = 6.0  # minutes of a command file, unless asked otherwise
SCHEMA = "softmap.next/1"


@dataclass(frozen=True)
class Question:
    """What is open: two sets of effects that explain the runs alike, or with `hidden` an effect that they hide."""

    one: tuple[str, ...]
    other: tuple[str, ...]
    hidden: str | None = None

    @property
    def names(self) -> list[str]:
        """The effects that it is about."""
        if self.hidden is not None:
            return [self.hidden]
        return [e for e in self.one if e not in self.other] + [e for e in self.other if e not in self.one]


@dataclass(frozen=True, eq=False)
class Experiment:
    """A block to record: what it settles, its separation (chi² that the wrong answer would leave), and its commands.

    `separation` is that of the first question that it settles; None where nothing was simulated, as is `plan`.
    `answers` are (question, separation) of all that was asked.
    """

    block: str
    minutes: float
    settles: list[str]
    separation: float | None
    plan: Protocol | None = None
    answers: tuple[tuple[Question, float], ...] = ()
    alone: str = ""  # why its run is to be diagnosed without the earlier ones, if so

    def to_dict(self) -> dict[str, Any]:
        """Return an entry of `next`: `{block, minutes, settles, separation}`."""
        return {
            "block": self.block,
            "minutes": round(self.minutes, 2),
            "settles": self.settles,
            "separation": None if self.separation is None else float(f"{self.separation:.4g}"),
        }

    def settled(self) -> list[Question]:
        """Return the questions that it settles, rivals first."""
        found = [(q, s) for q, s in self.answers if s >= SETTLED]
        return [q for q, _ in sorted(found, key=lambda pair: (pair[0].hidden is not None, -pair[1]))]

    def __str__(self) -> str:
        apart = "not simulated" if self.separation is None else f"separation {float(f'{self.separation:.3g}'):g}"
        settles = ", ".join(self.settles) or "nothing"
        return f"{self.block} ({self.minutes:.1f} min): settles {settles}; {apart}{self.alone}"


def next_experiment(
    model: Model,
    diagnosis: Diagnosis,
    runs: Sequence[Run],
    limits: Limits | None = None,
    library: Any = None,
    progress: Callable[[float], None] | None = None,
) -> list[Experiment]:
    """Rank blocks of commands by how well a minute of each settles what a diagnosis left open.

    Args:
        model: the model that was diagnosed.
        diagnosis: what was found; its rivals and what was not testable are the questions.
        runs: the runs that it was made from; without any, each block is judged for itself, with mid-range parameters.
        limits: of the robot; three quarters of the model's range by default.
        library: where effects come from; the compiled core by default.
        progress: hears the share that is done.

    Returns:
        list: experiments, best first; last what no block settles, with what the library says of it. Empty where
        nothing is open.

    Raises:
        SoftmapError: the diagnosis is of another model or of other runs, or names effects that are not known.
    """
    if model.channels == 0:
        raise SoftmapError("the model takes no commands, so no block of commands can settle anything")
    limits = limits or Limits.of(model.command_range, model.command_unit)
    world = _World(model, diagnosis, list(runs), library)
    if not world.questions:
        return []
    found = []
    for i, block in enumerate(world.blocks(limits)):
        plan_ = plan([block], limits, world.setting)
        answers = world.answers(plan_, block.changes)
        found.append(_experiment(world, block, plan_, answers))
        if progress is not None:
            progress((i + 1) / len(BLOCKS))
    worth = _worth([e for e in found if e.settles], world.questions)
    good = sorted(worth, key=lambda e: -worth[e])
    settled = {q for e in good for q in e.settled()}
    return [*good, *_rest(world, [q for q in world.questions if q not in settled])]


def program(experiments: Sequence[Experiment], minutes: float = BUDGET) -> list[Experiment]:
    """Return which experiments to record together: the first, and while there is time what settles something more."""
    candidates = [e for e in experiments if e.plan is not None]
    still = list(dict.fromkeys(q for e in candidates for q in e.settled()))
    taken: list[Experiment] = []
    while candidates and still:
        worth = _worth(candidates, still)
        best = max(candidates, key=lambda e: worth[e])
        candidates.remove(best)
        if not taken or sum(e.minutes for e in [*taken, best]) <= minutes:
            taken.append(best)
            still = [q for q in still if q not in best.settled()]
            candidates = [e for e in candidates if any(q in still for q in e.settled())]
    return taken


def _worth(experiments: Sequence[Experiment], questions: Sequence[Question]) -> dict[Experiment, float]:
    """Return what each experiment is worth for some questions."""
    worth = dict.fromkeys(experiments, 0.0)
    for question in questions:
        rate = {e: dict(e.answers)[question] / max(e.minutes, 1e-9) for e in experiments if question in e.settled()}
        for e, speed in rate.items():
            worth[e] += (1.0 if question.hidden is None else UNSEEN) * speed / max(rate.values())
    return worth


def _experiment(world: _World, block: Block, made: Protocol, answers: list[tuple[Question, float]]) -> Experiment:
    bare = Experiment(block.name, made.minutes, [], None, made, tuple(answers))
    names = list(dict.fromkeys(name for q in bare.settled() for name in q.names))
    first = next((s for q, s in answers if q in bare.settled()[:1]), None)
    missing = [name for name in names if not world.declared(name)]
    fields = dict.fromkeys(field for name in missing for field in world.needs(name))
    alone = f"; for {', '.join(missing)} diagnose its run by itself, the earlier ones declare no {', '.join(fields)}"
    return replace(bare, settles=names, separation=first, alone=alone if missing else "")


def _rest(world: _World, questions: Sequence[Question]) -> list[Experiment]:
    """Return, for what no block settles, what the library says would show it."""
    rows: dict[str, Experiment] = {}
    for question in questions:
        for name in question.names:
            text, minutes = experiment(world.registry, name)
            row = rows.setdefault(text, Experiment(text, minutes, [], None))
            row.settles.extend([name] if name not in row.settles else [])
    return list(rows.values())


class _World:
    """What a diagnosis left open, and what each answer would look like in a block that is not recorded yet."""

    def __init__(self, model: Model, diagnosis: Diagnosis, runs: list[Run], library: Any) -> None:
        if library is None:
            from softmap_edge import _core as library
        self.model, self.runs, self.library = model, runs, library
        self.registry: dict[str, dict[str, Any]] = {e["name"]: e for e in library.effects()}
        _check(model, diagnosis, runs, self.registry)
        known = [e["name"] for e in [*diagnosis.effects, *diagnosis.faults]]
        self.found = tuple(name for name in self.registry if name in known)
        self.questions = _questions(diagnosis, self.found, tuple(model.chain_names))
        sets = {self.found, *(q.other for q in self.questions if q.hidden is None)}
        self.hidden = [q.hidden for q in self.questions if q.hidden is not None]
        self.setting = Setting.after(runs, model.gravity_reference)
        self.bare = _blank_record(model, self.setting, library)
        self.old = record_of(model, _thinned(runs), library) if runs else None
        self.names = [n for n in self.registry if any(n in s for s in sets) or n in self.hidden]
        self.params: dict[tuple[str, ...], dict[str, float]] = {}
        if runs:
            problem = _problem(record_of(model, runs, library), [n for n in self.names if self.declared(n)])
            search = Search(problem, [n for n in self.names if self.declared(n)])
            fits = {key: search.get(key) for key in sets}
            self.noise, self.dispersion = problem.noise, search.dispersion(fits[self.found])
            self.params |= {key: fit.params for key, fit in fits.items()}
        else:
            self.noise, self.dispersion = _declared_noise(model, diagnosis), 1.0
            told = {
                label: float(p["value"])
                for e in [*diagnosis.effects, *diagnosis.faults]
                for label, p in e["params"].items()
            }
            self.params |= {key: self._middle(key) | told for key in sets}

    def blocks(self, limits: Limits) -> list[Block]:
        """Return the blocks that the robot can do and that could matter."""
        needed = {field for name in self.names for field in self.registry[name].get("needs", [])}
        return [
            b
            for b in BLOCKS.values()
            if b.channels <= limits.channels and (b.changes != "temperature" or "temperature" in needed)
        ]

    def answers(self, made: Protocol, changes: str) -> list[tuple[Question, float]]:
        """Return the separation of each question in a block that `changes` a condition."""
        run = _blank(self.model, made, self.runs[0] if self.runs else None, self.setting)
        new = Record(self.model, run, self.library)
        parts = [] if self.old is None else [self.old]
        joint = record_of(self.model, [*_thinned(self.runs), run], self.library)
        problem = _problem(joint, [n for n in self.names if self._predicted(n, [*parts, new])], self.noise)
        alone = _Linear(
            self, _problem(new, [n for n in self.names if not new.missing(self.needs(n))], self.noise), [new]
        )
        both = _Linear(self, problem, [*parts, new])
        found = []
        for question in self.questions:
            if question.hidden is None:
                ways = ((question.one, question.other), (question.other, question.one))
                apart = 0.0
                if self._resolvable(question, changes):
                    apart = min(self._apart(problem, [*parts, new], a, b) for a, b in ways)
            elif self.declared(question.hidden):
                apart = both.left(question.hidden) - self._hidden_before(question.hidden)
                apart = apart if self._moved(question.hidden, new) >= VISIBLE_MM else 0.0
            elif new.missing(self.needs(question.hidden)):
                apart = 0.0
            else:  # the earlier runs will not tell: what the new one says by itself
                apart = alone.left(question.hidden)
                apart = apart if new.rms_mm(self._shift(question.hidden, new)) >= VISIBLE_MM else 0.0
            found.append((question, max(apart, 0.0) / self.dispersion))
        return found

    # --- rivals, refitted in full ---------------------------------------------------------------

    def _resolvable(self, question: Question, changes: str) -> bool:
        """Whether a block that `changes` a condition can tell a pair apart, by what the library says of its members."""
        mine = [e for e in question.one if e not in question.other]
        theirs = [e for e in question.other if e not in question.one]
        if len(mine) != 1 or len(theirs) != 1:
            return True
        by = self.registry[mine[0]]["alike"].get(theirs[0]) or self.registry[theirs[0]]["alike"].get(mine[0])
        return by is None or by == changes

    def _apart(self, problem: Problem, parts: list[Record], true: tuple[str, ...], tried: tuple[str, ...]) -> float:
        """Return by how much more `tried` is wrong with the block than without it, where `true` holds."""
        return self._left(problem, parts, true, tried) - self._before(true, tried)

    def _left(self, problem: Problem, parts: list[Record], true: tuple[str, ...], tried: tuple[str, ...]) -> float:
        """Return the chi² that `tried` leaves at best where `true` holds."""
        seen = np.isfinite(problem.record.seen)
        truth = np.concatenate([self.predicted(part, true, self.params[true]) for part in parts])
        problem.record.seen = np.where(seen, truth, np.nan)
        space = problem.space(tried)
        params = self.params[tried]
        values = np.array([_of(params, label, self._middle(tried)) for label in space.free_labels()])
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
    def _kept(self) -> dict[Any, float]:
        return {}

    @cached_property
    def _old_problem(self) -> Problem | None:
        if self.old is None:
            return None
        return _problem(self.old, [n for n in self.names if self.declared(n)], self.noise)

    @cached_property
    def _old_linear(self) -> _Linear | None:
        return None if self._old_problem is None or self.old is None else _Linear(self, self._old_problem, [self.old])

    def _hidden_before(self, name: str) -> float:
        if self._old_linear is None:
            return 0.0
        if name not in self._kept:
            self._kept[name] = self._old_linear.left(name)
        return self._kept[name]

    def _moved(self, name: str, new: Record) -> float:
        """Return how far an unseen effect moves the centreline over old runs and block, mm RMS."""
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

    def predicted(self, record: Record, effects: tuple[str, ...], params: Mapping[str, float]) -> Floats:
        """Return features (K, F) mm of a record with some effects on top of the model's own."""
        own = tuple(self.model.chain_names)
        layout = record.layout(own + tuple(e for e in effects if e not in own))
        rest = dict(zip(layout.labels, layout.null)) | dict(zip(record.layout(own).labels, map(float, record.own())))
        values = np.array([_of(params, label, rest) for label in layout.labels])
        return np.asarray(record.predict(layout.names, values[None])[0])

    def with_hidden(self, name: str) -> tuple[tuple[str, ...], dict[str, float]]:
        """Return what was found, with one effect more at mid-range."""
        return (*self.found, name), self._middle((name,)) | self.params[self.found]

    def _middle(self, effects: Sequence[str]) -> dict[str, float]:
        """Return parameters at mid-range: halfway from null to high, or the start where the scale is logarithmic."""
        layout = self.bare.layout(tuple(effects))
        middle = np.where(layout.log, layout.start, 0.5 * (layout.null + layout.high))
        return dict(zip(layout.labels, map(float, middle)))

    def needs(self, name: str) -> list[str]:
        return list(self.registry[name].get("needs", []))

    def _predicted(self, name: str, parts: Sequence[Record]) -> bool:
        return not any(part.missing(self.needs(name)) for part in parts)

    def declared(self, name: str) -> bool:
        """Whether the old runs declare what an effect needs."""
        return self.old is None or not self.old.missing(self.needs(name))


class _Linear:
    """What an unseen effect leaves beside what was found, whose parameters take one linearised step."""

    def __init__(self, world: _World, problem: Problem, parts: list[Record]) -> None:
        self.world, self.problem, self.parts = world, problem, parts

    @cached_property
    def _base(self) -> list[Floats]:
        world = self.world
        return [world.predicted(part, world.found, world.params[world.found]) for part in self.parts]

    @cached_property
    def _jacobian(self) -> Floats:
        """Slopes (P, n) of the white residual over what was found."""
        problem, world = self.problem, self.world
        if not world.found:
            return np.zeros((0, 1))
        space = problem.space(world.found)
        kept, problem.record.seen = problem.record.seen, np.concatenate(self._base)
        rest = world._middle(world.found)
        x = space.scaled(np.array([_of(world.params[world.found], label, rest) for label in space.free_labels()]))
        modes = problem.at(space, x[None])[1][0]
        slopes = problem.slopes(space, x, modes)
        problem.record.seen = kept
        return problem.white(slopes)

    def left(self, name: str) -> float:
        """Return the chi² that is left of an effect at mid-range."""
        shift = np.concatenate([self.world._shift(name, part) for part in self.parts])
        shift = np.where(np.isfinite(self.problem.record.seen), shift, np.nan)
        white = self.problem.white(self.problem.whitener.modes(shift) * self.problem.gain)
        if not len(self._jacobian):
            return float(white @ white)
        pull = self._jacobian @ white
        return float(
            white @ white - pull @ np.linalg.solve(self._jacobian @ self._jacobian.T + np.eye(len(pull)), pull)
        )


# --- what is asked ------------------------------------------------------------------------------


def _questions(diagnosis: Diagnosis, found: tuple[str, ...], own: tuple[str, ...]) -> list[Question]:
    asked = []
    for rival in diagnosis.rivals:
        effects = tuple(str(e) for e in rival.get("effects") or ())
        if set(effects) != set(found) and not set(effects) & set(own):  # a refit of the model's own needs no experiment
            asked.append(Question(found, effects))
    asked += [Question(found, found, row["name"]) for row in diagnosis.not_testable if row["name"] not in found]
    return list(dict.fromkeys(asked))


def _check(model: Model, diagnosis: Diagnosis, runs: Sequence[Run], registry: Mapping[str, Any]) -> None:
    made = diagnosis.made_from
    own = made.get("own_effects")
    if isinstance(own, list) and own != list(model.chain_names):
        raise SoftmapError(
            f"the diagnosis is of a model with {', '.join(map(str, own)) or 'no effects'}, this one has "
            f"{', '.join(model.chain_names) or 'none'}; give the bundle that was diagnosed"
        )
    told = made.get("run")
    hashes = [run.hash() for run in runs]
    if runs and told is not None and sorted(hashes) != sorted(told if isinstance(told, list) else [told]):
        raise SoftmapError(
            f"the diagnosis was made from other runs than the {len(runs)} given; give those, or diagnose these again"
        )
    named = [e["name"] for e in [*diagnosis.effects, *diagnosis.faults]]
    named += [str(e) for rival in diagnosis.rivals for e in rival.get("effects") or ()]
    named += [str(row.get("name")) for row in diagnosis.not_testable]
    unknown = [name for name in named if name not in registry]
    if unknown:
        raise SoftmapError(f"the diagnosis names '{unknown[0]}', which this library lacks; diagnose again")


def _declared_noise(model: Model, diagnosis: Diagnosis) -> Noise:
    """Return the noise that a diagnosis states, the same for each coordinate, where its runs are not given."""
    stated = diagnosis.error.get("noise_floor")
    mm = float(stated) if isinstance(stated, (int, float)) and 0 < stated < 1e3 else 0.3
    return Noise(np.eye(3 * len(model.positions)) * max(mm / np.sqrt(3.0), FLOOR) ** 2, "stated", 1.0)


def _thinned(runs: Sequence[Run]) -> list[Run]:
    total = max(1, sum(run.frames for run in runs))
    share = min(1.0, OLD / total)
    return [
        run.at(np.unique(np.linspace(0, run.frames - 1, max(2, int(share * run.frames))).astype(int))) for run in runs
    ]


def _blank(model: Model, made: Protocol, like: Run | None, setting: Setting) -> Run:
    """Return a protocol as a run in which nothing is seen yet, in the way in which `like` was seen."""
    warm = made.temperature
    if warm is None and like is not None and like.temperature is not None:
        warm = np.full(made.t.size, setting.temperature)
    seen: dict[str, Any] = {"vertices": np.repeat(model.rest[None], made.frames, axis=0)}
    if model.markers or (like is not None and like.markers is not None):
        rest = model.rest if like is None or like.marker_rest is None else like.marker_rest
        seen = {"markers": np.repeat(rest[None], made.frames, axis=0), "marker_rest": rest}
    return Run(
        t=made.t, command=made.command, t_seen=made.t_seen, gravity=made.gravity, load=made.load,
        temperature=warm, block=made.block, robot=model.robot, command_unit=model.command_unit, **seen,
    )  # fmt: skip


def _blank_record(model: Model, setting: Setting, library: Any) -> Record:
    """Return a record of two frames at home, that knows the parameters of any chain."""
    limits = Limits.of(model.command_range, model.command_unit)
    made = plan([BLOCKS["home revisits"]], limits, setting)
    blank = _blank(model, made, None, setting)
    return Record(model, blank.at([0, 1]), library)


def _of(params: Mapping[str, float], label: str, rest: Mapping[str, float]) -> float:
    """Return a parameter by label; what belongs to one run only is taken from the first."""
    bare = label.split("@")[0]
    return params.get(label, params.get(bare, rest.get(label, rest.get(bare, 0.0))))
