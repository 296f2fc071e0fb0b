"""A run for a fit: measured features, commands, declared conditions, predictions.

It predicts for any chain of effects.

Several runs have the same interface (`records.py`), so the rest of a diagnosis need not distinguish
them. Units: mm, s, g. Pinned by tests/diagnosis/test_fit.py.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from copy import copy
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.alignment.base_motion import FRAME, BaseMotion, base_of, bounded
from softmap_edge.diagnosis.paired import Replay, pair
from softmap_edge.diagnosis.spools import RADIUS, Spool, spool_of, with_radius
from softmap_edge.errors import SoftmapError
from softmap_edge.model.chain_labels import differing
from softmap_edge.model.effect_info import effects_that
from softmap_edge.model.parameter_layout import Layout, layout_of, ranges_of
from softmap_edge.model.servo_calibration import converted
from softmap_edge.model.views import laid
from softmap_edge.run.conditions import Conditions, conditions
from softmap_edge.run.plane import unmeasured_parameters
from softmap_edge.run.run import as_runs

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
Forms = Callable[[Sequence[str], Floats], Floats]

CHUNK = 12_000_000  # values of one batched prediction: 100 MB
SLOPE = 0.02  # of the command range, on both sides, for slopes
# clouds of a round finger do not show it: rotated tendons look the same
ROLLS = ("mount.turn_z",)
ENDS = 0.05  # of a run: events nearer to its ends have data on one side only


class Record:
    """One run: measured features (K, F) mm, their commands, and predictions.

    It predicts for any chain of effects.
    """

    seen: Floats  # (K, F) mm
    form_error: Floats  # (V, 3) mm
    _leaning: Floats  # (K, d)
    roll_seen: bool  # whether frames show the rotation of the body about its own axis
    # remarks on the runs, without a full stop, for any verdict
    doubts: tuple[str, ...] = ()
    remapped: bool = False  # whether a learned static map is solved again with every law
    # (K, F) mm, the removed residual; `model` is without it
    static: Floats | None = None

    def __init__(
        self, model: Model, run: Run, reference: Run | Sequence[Run] | None = None
    ) -> None:
        """Bind a model to a run.

        A `reference` has the same commands; several may be given. The model error on it is
        subtracted from the measurement.
        """
        adapted = model.residual is not None
        self.model = model.with_residual(None) if adapted else model
        self.recorded_runs: tuple[Run, ...] = (run,)
        self.replay: Replay | None = None
        self.bases: tuple[BaseMotion | None, ...] = (
            base_of(model, converted(model, run), reference),
        )
        self._bind(run)
        if reference is not None:
            several = as_runs(reference)
            self.replay, missed, form = pair(self, [Record(model, one) for one in several])
            met = np.isfinite(missed).any(axis=1)
            if not met.all():
                self._bind(self.run.at(met))
            self.seen, self.form_error = self.seen - missed[met], form
            # the reference shows the model error of a lean
            self._leaning = np.ones((self.frames, 1))
        elif adapted:
            self.static = (model.features(self.run) - self.model.features(self.run)).reshape(
                self.seen.shape
            )

    def _bind(self, run: Run) -> None:
        """Select the frames of a run with visible points; the others carry no information."""
        self._forget()
        self.__dict__.pop("_within", None)
        model, run = self.model, converted(self.model, run)
        seen = np.asarray(model.seen_features(run), float)
        some = np.isfinite(seen).any(axis=(1, 2))
        if len(some) and not some.any():
            raise SoftmapError(
                f"none of the {len(some)} frames shows enough of '{model.robot}': a section "
                "counts where six of its points are seen, a marker where it is seen; look at "
                "`visible`"
            )
        if not some.all():
            run, seen = run.at(some), seen[some]
        self._layouts: dict[tuple[tuple[str, ...], int, frozenset[str]], Layout] = {}
        self.run = run
        self.frames, self.features = seen.shape[0], seen.shape[1] * 3
        self.seen = seen.reshape(self.frames, self.features)
        self.t_seen: Floats = np.asarray(run.t_seen, float)
        self.u: Floats = np.asarray(model.commands(run), float)
        t = np.asarray(run.t, float)
        columns = [np.interp(self.t_seen, t, c) for c in self.u.T]
        self.command: Floats = np.stack(columns, axis=1) if columns else np.zeros((self.frames, 0))
        mapping = model.run_feature_map(run)
        self.positions: NDArray[np.bool_] = np.asarray(mapping.positions, bool)
        self.section: NDArray[np.int64] = np.asarray(mapping.section)
        self.form_error = np.asarray(model.run_form_error(run), float)
        self._leaning = np.asarray(model.run_leaning(run), float)
        self.block: NDArray[np.generic] | None = run.block
        self.roll_seen = not laid(run)
        self.across = unmeasured_parameters(run)  # for a run with markers in a plane

    @property
    def parts(self) -> Sequence[Record]:
        """The record of each run."""
        return [self]

    @property
    def begins(self) -> NDArray[np.intp]:
        """Number of the first frame of each run."""
        return np.zeros(min(1, self.frames), np.intp)

    def _forget(self) -> None:
        """Clear results cached for other frames."""
        for name in ("state", "leaning", "frame_mm", "_inputs"):
            self.__dict__.pop(name, None)

    def spread_rows(self, most: int) -> NDArray[np.intp]:
        """Return the numbers of about `most` frames, evenly spread.

        They include the first and the last frame of a run.
        """
        return np.unique(
            np.linspace(0, self.frames - 1, min(self.frames, max(2, most))).astype(np.intp)
        )

    def some(self, rows: NDArray[np.intp]) -> Record:
        """Return the record with some of its frames, `rows` increasing, including the first.

        Time counts from the first.

        Declarations and parameters are kept.
        """
        few = copy(self)
        few.__dict__["_within"] = self._within
        few._forget()
        few.run, few.frames = self.run.at(rows), len(rows)
        few.seen, few.t_seen, few.command = self.seen[rows], self.t_seen[rows], self.command[rows]
        few._leaning = self._leaning[rows]
        few.block = None if self.block is None else np.asarray(self.block)[rows]
        few.static = None if self.static is None else self.static[rows]
        return few

    # --- what the run declares ------------------------------------------------------------------

    @cached_property
    def state(self) -> Conditions:
        """The motion of the commands at each frame."""
        return conditions(self.run, self.u)

    @cached_property
    def spread(self) -> Floats:
        """Range (C,) of the commands."""
        return np.ptp(self.u, axis=0) if len(self.u) else np.zeros(self.u.shape[1])

    @cached_property
    def leaning(self) -> Floats:
        """Factors of the model error by orientation, (K, 4), row length 1 on average."""
        return self._leaning / max(
            float(np.sqrt(np.mean(np.sum(self._leaning**2, axis=1)))), 1e-300
        )

    @property
    def load(self) -> Floats | None:
        """The declared loads (n,) g."""
        return None if self.run.load is None else np.atleast_1d(np.asarray(self.run.load, float))

    def missing(self, required: Sequence[str]) -> list[str]:
        """Return the fields that an effect needs and the run does not declare."""
        return [name for name in required if getattr(self.run, name) is None]

    # --- predictions ----------------------------------------------------------------------------

    @property
    def untold(self) -> tuple[str, ...]:
        """Parameters that are not fitted: not observable, or known."""
        rolls = () if self.roll_seen else ROLLS
        return (*rolls, *self.across, *(() if self.spool is None else (RADIUS,)))

    @cached_property
    def spool(self) -> Spool | None:
        """The radius of the spools, if it is known."""
        return spool_of(self.model, self.recorded_runs)

    def layout(self, names: Sequence[str], split: Collection[str] = ()) -> Layout:
        """Return the parameters of a chain of `names`; those in `split` have one per channel.

        So do the model's own effects with different values per channel.
        """
        return self._layout(names, 1, split)

    def _layout(self, names: Sequence[str], runs: int, split: Collection[str]) -> Layout:
        """Return a chain's parameters, cached; PER_RUN effects have one set for each run."""
        apart = self._differing.union(split).intersection(names)
        key = (tuple(names), runs, apart)
        if key not in self._layouts:
            chain = _core.Chain(list(names), self.model.channels)
            ranges = ranges_of(self.model, chain)
            made = layout_of(
                names, chain, self.model.changes(names), ranges, runs, self._within, apart
            )
            made = bounded(made, self.bases)
            self._layouts[key] = made if self.spool is None else with_radius(made, self.spool)
        return self._layouts[key]

    @cached_property
    def _differing(self) -> frozenset[str]:
        """The model's own effects with different values per channel."""
        return differing(self.model.chain, np.asarray(self.model.chain_params))

    def full(self, names: Sequence[str], params: Floats) -> Floats:
        """Expand parameter sets of the layout of `names` to (B, N); full sets pass unchanged."""
        return self.layout(names).full(params)

    @cached_property
    def _within(self) -> tuple[float, float]:
        """Return times since the first command with enough of the run on both sides, s."""
        begin, end = (
            (float(self.t_seen[i] - self.run.t[0]) for i in (0, -1)) if self.frames else (0.0, 0.0)
        )
        return begin + ENDS * (end - begin), end - ENDS * (end - begin)

    def _models(
        self, names: Sequence[str], params: Floats
    ) -> list[tuple[Model, NDArray[np.intp], Floats]]:
        """Yield the models for sets (B, P), each with its rows and their chain parameters."""
        changes = self.model.changes(names)
        if not changes:
            return [(self.model, np.arange(len(params)), np.ascontiguousarray(params))]
        count = params.shape[1] - len(changes)
        found = []
        sets, which = np.unique(params[:, count:], axis=0, return_inverse=True)
        for i, values in enumerate(sets):
            moved = {c.label: float(v) for c, v in zip(changes, values) if v != c.null}
            rows = np.flatnonzero(which.ravel() == i)
            model = self.model.changed(moved) if moved else self.model
            found.append((model, rows, np.ascontiguousarray(params[rows, :count])))
        return found

    def own(self) -> Floats:
        """Return the parameters (L,) of the model's own effects in their layout."""
        layout = self.layout(self.model.chain_names)
        return layout.values(self.model.params, layout.null)

    def own_values(self) -> dict[str, float]:
        """Return these parameters by label."""
        return dict(zip(self.layout(self.model.chain_names).labels, map(float, self.own())))

    @cached_property
    def _inputs(self) -> _core.Inputs:
        """The run in the format of the compiled core."""
        return self.model.inputs(self.run)

    def predict(self, names: Sequence[str], params: Floats) -> Floats:
        """Return predicted features (B, K, F) mm for sets of the layout of `names`.

        The parameter sets are (B, L), or full (B, N).
        """
        params = self.full(names, params)
        chunk = max(1, CHUNK // max(1, self.frames * self.features))
        out = np.empty((len(params), self.frames, self.features))
        for model, rows, sets in self._models(names, params):
            for i in range(0, len(rows), chunk):
                part = model.predict_features(
                    tuple(names), sets[i : i + chunk], self.run, self._inputs
                )
                out[rows[i : i + chunk]] = np.reshape(part, (len(part), self.frames, self.features))
        return out

    def forms(self, weights: Floats) -> Forms:
        """Return a function that predicts linear forms (B, K, M) of the features.

        It has the arguments of `predict`; `weights` are (F, M).

        Tables give the forms directly, at a fraction of the cost. Sensing effects move points, and
        have no forms.
        """
        forms = self.model.through(weights, self.run)
        senses = effects_that("sensing")

        def predict(names: Sequence[str], params: Floats) -> Floats:
            if forms is None or self.model.changes(names) or not senses.isdisjoint(names):
                return np.asarray(self.predict(names, params) @ weights)
            sets, chunk = (
                np.ascontiguousarray(self.full(names, params)),
                max(1, CHUNK // max(1, self.frames * weights.shape[1])),
            )
            parts = [
                self.model.predict_forms(forms, names, sets[i : i + chunk], self._inputs)
                for i in range(0, len(sets), chunk)
            ]
            return (parts[0] if len(parts) == 1 else np.concatenate(parts))[..., : weights.shape[1]]

        return predict

    # --- measures -------------------------------------------------------------------------------

    def rms_mm(self, difference: Floats, frames: NDArray[np.generic] | None = None) -> float:
        """Return the RMS distance in mm over the places of feature differences (K, F)."""
        squares = self.squares(difference)
        return float(np.sqrt(np.nanmean(squares if frames is None else squares[frames])))

    def squares(self, difference: Floats) -> Floats:
        """Return squared distances (K, places) mm² of features (K, F); NaN where unseen."""
        places = difference.reshape(len(difference), -1, 3)[:, self.positions]
        return np.asarray(np.sum(places**2, axis=2))

    @property
    def error_is_noise(self) -> bool:
        """Whether model error counts as noise: that of a rod is not smooth in the commands."""
        return bool(self.model.kind == "rod")

    @property
    def form_mm(self) -> float:
        """Return the model's own held-out error in mm RMS over the places."""
        return float(np.sqrt(np.mean(np.sum(self.form_error[self.positions] ** 2, axis=1))))

    @cached_property
    def frame_mm(self) -> float:
        """RMS error (mm) of points from the alignment uncertainty (`frame_sigma`)."""
        sigma = self.run.frame_sigma
        if sigma is None:
            return 0.0
        own = tuple(self.model.chain_names)
        names = own if "mount" in own else (*own, "mount")
        layout = self.layout(names)
        at = layout.values(self.own_values(), layout.null)
        labels = np.array(layout.labels)
        moved = [
            at + each * (labels == label) for label, each in zip(FRAME, np.asarray(sigma, float))
        ]
        seen = self.predict(names, np.stack([at, *moved]))
        return float(np.sqrt(sum(self.rms_mm(one - seen[0]) ** 2 for one in seen[1:])))

    def __len__(self) -> int:
        return int(self.frames)
