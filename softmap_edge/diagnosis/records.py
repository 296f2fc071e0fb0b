"""Several runs of one robot as one record: frames in sequence, with shared parameters.

Memory starts in equilibrium in each run, and session parameters have a value for each run
(`model/parameter_layout.py`). Units: mm, s, g. Limit: the runs must be measured in the same way (vertices, or the
same number of markers). Pinned by tests/diagnosis/test_several_runs.py.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from copy import copy
from dataclasses import fields, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.diagnosis.record import Forms, Record
from softmap_edge.errors import SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.model.parameter_layout import Layout
from softmap_edge.run.conditions import Conditions
from softmap_edge.run.run import as_runs

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]

APART = 60.0  # s between the runs: longer than any fold gap


class Records(Record):
    """Several runs of one robot, one after the other."""

    def __init__(
        self, model: Model, runs: Sequence[Run], reference: Run | Sequence[Run] | None = None
    ) -> None:
        """Bind a model to runs, each with the commands of a `reference` if there is any.

        Raises:
            SoftmapError: the runs are not measured in the same way.
        """
        self._layouts = {}
        parts = [Record(model, run, reference) for run in runs]
        kinds = [(part.features, len(part.positions)) for part in parts]
        if len(set(kinds)) > 1:
            raise SoftmapError(
                f"the runs show {', '.join(str(n) for _, n in kinds)} features a frame; runs that "
                "are diagnosed together must be seen in the same way, so diagnose them apart"
            )
        self.model = model
        replays = [p.replay for p in parts if p.replay is not None]
        self.replay = max(replays, key=lambda r: r.share, default=None)
        met = list(dict.fromkeys(str(r.run) for r in replays))
        if self.replay is not None and len(met) > 1:
            self.replay = replace(self.replay, run=met)
        self.recorded_runs = tuple(runs)
        self.bases = tuple(part.bases[0] for part in parts)
        self._join(parts)

    def _join(self, parts: list[Record]) -> None:
        """Concatenate the frames of runs."""
        self._parts = parts
        self.frames, self.features = sum(part.frames for part in parts), parts[0].features
        self.seen = np.concatenate([part.seen for part in parts])
        self.command = np.concatenate([part.command for part in parts])
        self.positions, self.section = parts[0].positions, parts[0].section
        self.roll_seen = all(part.roll_seen for part in parts)
        self.across = tuple(dict.fromkeys(name for part in parts for name in part.across))
        if parts[0].static is not None:
            self.static = np.concatenate([part.static for part in parts])
        weight = [part.frames / max(1, self.frames) for part in parts]
        self.form_error = np.sqrt(sum(w * part.form_error**2 for w, part in zip(weight, parts)))
        self._leaning = np.concatenate([part._leaning for part in parts])
        self.ends = np.cumsum([part.frames for part in parts])
        begins, end = [], 0.0
        for part in parts:
            first = float(part.t_seen[0]) if part.frames else 0.0
            begins.append(part.t_seen - first + end)
            end = (float(begins[-1][-1]) if part.frames else end) + APART
        self.t_seen = np.concatenate(begins)
        labels = [part.block for part in parts]
        self.block = (
            None
            if any(b is None for b in labels)
            else np.concatenate([np.asarray(b) for b in labels])
        )

    @property
    def parts(self) -> Sequence[Record]:
        """The record of each run."""
        return self._parts

    @property
    def begins(self) -> NDArray[np.intp]:
        """Number of the first frame of each run."""
        return np.unique(
            np.array(
                [e - part.frames for e, part in zip(self.ends, self.parts) if part.frames], np.intp
            )
        )

    def spread_rows(self, most: int) -> NDArray[np.intp]:
        """Return the numbers of about `most` frames, a share from each run."""
        begins = self.ends - [part.frames for part in self.parts]
        shares = [-(-most * part.frames // max(1, self.frames)) for part in self.parts]
        each = zip(begins, self.parts, shares)
        return np.concatenate([begin + part.spread_rows(share) for begin, part, share in each])

    def some(self, rows: NDArray[np.intp]) -> Record:
        """Return the record with some frames, `rows` increasing, the first of each run included."""
        few = copy(self)
        few.__dict__["_within"] = self._within
        few._forget()
        own = np.split(rows, np.searchsorted(rows, self.ends[:-1]))
        begins = self.ends - [part.frames for part in self.parts]
        few._join([part.some(mine - begin) for part, mine, begin in zip(self.parts, own, begins)])
        few.seen = self.seen[rows]
        return few

    @cached_property
    def state(self) -> Conditions:
        """The motion of the commands at each frame; a dwell belongs to one run."""
        states = [part.state for part in self.parts]
        columns: Document = {}
        for f in fields(Conditions):
            rows = [getattr(state, f.name) for state in states]
            columns[f.name] = None if any(row is None for row in rows) else np.concatenate(rows)
        for i, (end, part) in enumerate(zip(self.ends, self.parts)):
            visit = columns["visit"][end - part.frames : end]
            visit[visit >= 0] += i * (1 << 40)
        return Conditions(**columns | {"time": self.t_seen - self.t_seen[:1]})

    @cached_property
    def spread(self) -> Floats:
        """Range (C,) of the commands of all runs."""
        return np.asarray(np.ptp(np.concatenate([part.u for part in self.parts]), axis=0))

    @property
    def load(self) -> Floats | None:
        """Loads (n,) g, 0 in runs that declare none; None if no run does."""
        rows = [part.load for part in self.parts]
        return (
            None
            if all(r is None for r in rows)
            else np.concatenate([np.zeros(1) if r is None else r for r in rows])
        )

    @cached_property
    def frame_mm(self) -> float:
        """RMS error of the points from the alignment uncertainties, mm."""
        squares = [part.frames * part.frame_mm**2 for part in self.parts]
        return float(np.sqrt(sum(squares) / max(1, self.frames)))

    def missing(self, required: Sequence[str]) -> list[str]:
        """Return the fields that an effect needs and some run does not declare."""
        return [name for name in required if any(part.missing([name]) for part in self.parts)]

    def layout(self, names: Sequence[str], split: Collection[str] = ()) -> Layout:
        """Return the parameters of a chain.

        Session parameters have a value for each run.
        """
        return self._layout(names, len(self.parts), split)

    @cached_property
    def _within(self) -> tuple[float, float]:
        """Return times since the first command with enough of every run on both sides, s."""
        begins, ends = zip(*(part._within for part in self.parts))
        return max(begins), min(ends)

    def _each(self, names: Sequence[str], params: Floats) -> list[tuple[Record, Floats]]:
        full = self.full(names, params)
        return [
            (part, full[..., column])
            for part, column in zip(self.parts, self.layout(names).columns)
        ]

    def predict(self, names: Sequence[str], params: Floats) -> Floats:
        """Return predicted features (B, ΣK, F) mm for sets of the layout of `names`.

        The sets are (B, L), or full (B, N).
        """
        return np.concatenate(
            [part.predict(names, own) for part, own in self._each(names, params)], axis=1
        )

    def forms(self, weights: Floats) -> Forms:
        """Return a function that predicts linear forms (B, ΣK, M) of the features.

        It has the arguments of `predict`; `weights` are (F, M).
        """
        each = [part.forms(weights) for part in self.parts]

        def predict(names: Sequence[str], params: Floats) -> Floats:
            own = [sets for _, sets in self._each(names, params)]
            return np.concatenate([forms(names, sets) for forms, sets in zip(each, own)], axis=1)

        return predict


def record_of(
    model: Model, run: Run | Sequence[Run], reference: Run | Sequence[Run] | None = None
) -> Record:
    """Return the record of one or several runs, relative to a `reference` if given.

    Raises:
        SoftmapError: no run, runs not measured in the same way, a reference of other commands.
    """
    runs = as_runs(run)
    if not runs:
        raise SoftmapError("no run is given; a diagnosis needs at least one")
    if len(runs) == 1:
        return Record(model, runs[0], reference)
    return Records(model, runs, reference)
