"""Combine recordings into a training set on top of a model, called a lesson.

It holds the prediction of the model and the measurement for each frame.

Clouds are transformed to their base frame if it is clearly displaced
(`alignment/base_in_clouds.py`), and the template is registered to them, run by run. Units: mm.
Pinned by tests/training/test_evaluate.py and tests/adaptation/test_residual_network.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.adaptation.residual import APART, strangers
from softmap_edge.alignment.base_in_clouds import base_stood_off, in_base
from softmap_edge.alignment.clouds import clouds_of
from softmap_edge.alignment.register import register
from softmap_edge.calibration.matching import weighted
from softmap_edge.model.model import Model
from softmap_edge.run.folds import Folds, run_folds
from softmap_edge.run.run import Run
from softmap_training import choices
from softmap_training.errors import TrainingError

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
LEAST_FRAMES = 12
ROWS = ("commands", "points", "vertices", "weight", "times")  # of a lesson, one row per frame


@dataclass(frozen=True, eq=False)
class Lesson:
    """Training data of K frames on top of `base`, a model without its residual.

    `commands` (K, C) are effective commands, `points` (K, N, 3) mm the predictions. `clouds` (m, 3)
    mm were measured, empty if vertices were recorded. `vertices` (K, N, 3) mm are recorded or
    registered to clouds, with `weight` (K, N) in 1/mm², 0 if hidden. `times` (K,) s are of all
    runs, whose hashes are `runs`; `remarks` are to be reported.
    """

    base: Model
    commands: Floats
    points: Floats
    clouds: list[Floats]
    vertices: Floats
    weight: Floats
    times: Floats
    runs: list[str]
    remarks: list[str]

    @classmethod
    def of(cls, model: Model, runs: Run | Sequence[Run]) -> Lesson:
        """Return the lesson of recordings with clouds or vertices.

        Args:
            model: the model with its effects; an earlier residual is removed.
            runs: one or several runs, with commands, or with ticks if the model is calibrated.

        Raises:
            TrainingError: fewer than LEAST_FRAMES frames, or runs without a surface.
            RunError: a run of another robot or unit.
        """
        base, every = model.with_residual(None), [runs] if isinstance(runs, Run) else list(runs)
        frames = sum(run.frames for run in every)
        if frames < LEAST_FRAMES:
            raise TrainingError(
                f"{frames} frames, at least {LEAST_FRAMES} are needed to learn a residual; record "
                "more"
            )
        each = [_of_run(base, run) for run in every]
        begins = np.cumsum([0.0, *(float(np.ptp(one.times)) + APART for one in each[:-1])])
        times = [one.times - one.times[0] + begin for one, begin in zip(each, begins)]
        rows = {name: np.concatenate([getattr(one, name) for one in each]) for name in ROWS}
        missed = [
            (one.commands, (one.vertices - one.points).reshape(len(one), -1), one.weight > 0)
            for one in each
        ]
        return cls(
            base,
            **rows | {"times": np.concatenate(times)},
            clouds=[cloud for one in each for cloud in one.clouds],
            runs=[run.hash() for run in every],
            remarks=[remark for one in each for remark in one.remarks] + strangers(missed),
        )

    def __len__(self) -> int:
        return len(self.commands)

    @property
    def of_clouds(self) -> bool:
        """Whether every frame shows a cloud."""
        return all(map(len, self.clouds))

    @property
    def blocks(self) -> list[Indices]:
        """Blocks of frames that are drawn, or held out, together."""
        return [test for _, test in run_folds(self.times)]

    @property
    def parts(self) -> Folds:
        """Training and held-out frames, for `choices.HELD_OUT` interleaved sets of blocks."""
        folds, found = run_folds(self.times), []
        for number in range(min(choices.HELD_OUT, len(folds))):
            train, some = np.arange(len(self)), folds[number :: choices.HELD_OUT]
            for kept, _ in some:
                train = np.intersect1d(train, kept)
            found.append((train, np.concatenate([test for _, test in some])))
        return found

    def at(self, rows: Indices) -> Lesson:
        """Return the lesson of some frames."""
        return replace(
            self, clouds=[self.clouds[k] for k in rows], **{n: getattr(self, n)[rows] for n in ROWS}
        )

    def share(self, share: float, seed: int) -> Indices:
        """Return the frames of a share of the blocks, ascending.

        For one seed, larger shares contain the smaller ones.
        """
        blocks = self.blocks
        order = np.random.default_rng(seed).permutation(len(blocks))
        return np.sort(
            np.concatenate([blocks[k] for k in order[: max(1, round(share * len(order)))]])
        )


def _of_run(base: Model, run: Run) -> Lesson:
    """Return the training data of one run."""
    if not run.frames or run.markers is not None or (run.points is None and run.vertices is None):
        shown = (
            "markers, which do not show the surface"
            if run.markers is not None
            else "no clouds and no vertices"
        )
        raise TrainingError(
            f"a run of {run.frames} frames shows {shown}; a residual network is learned from these"
        )
    there, stood = in_base(run, base)
    points = np.asarray(base.predict(there))
    if there.points is None:
        clouds = [np.zeros((0, 3))] * there.frames
        seen, weight = weighted(base, there)
        vertices = np.where(weight[..., None] > 0, seen, points)
    else:
        clouds, found = clouds_of(there), register(base, there)
        vertices, weight = found.vertices, weighted(base, found.run(there))[1]
    remarks = [] if stood is None else [base_stood_off(stood.pose)]
    return Lesson(
        base,
        base.effective_commands(there),
        points,
        clouds,
        vertices,
        weight,
        there.t_seen,
        [run.hash()],
        remarks,
    )
