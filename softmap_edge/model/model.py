"""The model: the map from commands to shapes, and the only interface of its users.

    command ─chain of effects─> u_eff ─prior f(u_eff) + Σ cₖ·Sₖ(u_eff)─sensing effects─> points

The prior is a table, a scattered family (from a sweep) or a rod (fitted to a run), with the same
interface. Comparison, diagnosis and control use nothing else. Effect parameters are stored in
`chain_params`, in the order of `chain.labels`. By label (`chain_labels`), one number applies to all
channels while their numbers are equal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Unpack

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.geometry.sections import FeatureMap
from softmap_edge.model import views
from softmap_edge.model.chain_labels import named, readings, spread, valued
from softmap_edge.model.predictors import Shape, all_points, tip
from softmap_edge.model.servo_calibration import Calibration, converted
from softmap_edge.model.shapes import BundleArrays, ModeArrays, NetworkArrays, NumbersBefore
from softmap_edge.model.structure import Structure, StructureFields
from softmap_edge.run.fields import unmasked
from softmap_edge.run.output import Output
from softmap_edge.run.plane import flat

if TYPE_CHECKING:
    from softmap_edge.model.coverage import Coverage
    from softmap_edge.model.elastic_rod import Change, ElasticRodArrays
    from softmap_edge.model.learned_in import LearnedIn
    from softmap_edge.model.safety import Safety
    from softmap_edge.run.run import Run

Floats = NDArray[np.float64]
# of the length: motion of the tip under 1 N across, where stiffness is unknown
TIP_PER_NEWTON = 0.1
NOMINAL = "nominal: 1 N across the tip moves it by a tenth of the length; no load is known in grams"
KEPT_VIEWS = 4  # views stored: number of different runs in one diagnosis


@dataclass(frozen=True, eq=False)
class Model:
    """A structure and the effects added to it.

    `form_error` (V, 3) mm is the measured held-out error of each feature. `made_from` is the
    model's provenance (versions, seeds, hashes). `arrays` are the contents of `prior.npz`,
    `fields.npz` and `residual.npz`, from which the structure was compiled. The residual was learned
    with these effects and is removed when they change. `handles` (H,) are the vertices matched to
    the cloud in the published registration, ascending; None for all.
    """

    kind: str
    structure: Structure
    form_error: Floats
    vertex_error_mm: float
    robot: str = "finger"
    command_unit: str = "mm"
    input: str = "present"
    chain_names: tuple[str, ...] = ()
    chain_params: Floats = field(default_factory=lambda: np.zeros(0))
    made_from: Document = field(default_factory=dict)
    error_per_g_mm: float = 0.0  # model error per g away from the reference gravity
    arrays: BundleArrays | None = field(default=None, repr=False)
    calibration: Calibration | None = None  # of the servos: converts a run's ticks to commands
    handles: NDArray[np.int64] | None = None
    output: Output | None = None  # meaning of the markers, for a model of forces, angles, levels
    safety: Safety | None = None  # limits of the finger; None in bundles of earlier versions
    _views: dict[tuple[bytes, bool], views.View] = field(
        default_factory=dict, init=False, repr=False
    )

    # --- its structure ---------------------------------------------------------------------------

    @property
    def prior(self) -> Shape:
        """The prior without residual: effective commands (n, C) to flattened points (n, 3N) mm."""
        return self.structure.prior

    @property
    def fields(self) -> Mapping[str, Shape]:
        """Displacements per 1 g or per 1 N, by name."""
        return self.structure.fields

    @property
    def residual(self) -> Shape | None:
        """The correction learned on top of the prior with these effects (`model adapt`)."""
        return self.structure.residual

    @property
    def rest(self) -> Floats:
        """The template's vertices, or the markers at rest, (N, 3) mm."""
        return self.structure.rest

    @property
    def triangles(self) -> NDArray[np.int32]:
        """Triangles (F, 3) of the template; (0, 3) for markers."""
        return self.structure.triangles

    @property
    def tip_indices(self) -> NDArray[np.int64]:
        """The points whose mean is the tip."""
        return self.structure.tip_indices

    @property
    def gravity_reference(self) -> Floats:
        """Gravity (3,) included in the prior, in g, base frame."""
        return self.structure.gravity_reference

    @property
    def command_range(self) -> Floats:
        """Lowest and highest command (C, 2) for which the prior was made, in `command_unit`."""
        return self.structure.command_range

    @property
    def channels(self) -> int:
        """Number of commands C."""
        return self.structure.channels

    @property
    def markers(self) -> bool:
        """Whether the points are markers rather than vertices of a template."""
        return self.structure.markers

    @property
    def sections(self) -> NDArray[np.int64]:
        """Section (N,) of each point: slices along the body, or the marker's own number."""
        return self.structure.sections

    @property
    def weight_per_length(self) -> float:
        """The tip weight (g) that would move the tip sideways by the body length (`Structure`)."""
        return self.structure.weight_per_length

    def with_structure(self, **changes: Unpack[StructureFields]) -> Model:
        """Return the model with fields of its structure replaced."""
        return replace(self, structure=replace(self.structure, **changes))

    @cached_property
    def chain(self) -> _core.Chain:
        """The compiled chain of this model's effects."""
        return _core.Chain(list(self.chain_names), self.channels)

    @cached_property
    def learned_in(self) -> tuple[LearnedIn, ...]:
        """The effects that the robot had while the model was learned (`softmap learn`).

        A simulator has none.
        """
        from softmap_edge.model.learned_in import read_learned_in

        return read_learned_in(self.made_from.get("learned_in"))

    def taught_by(self, run: Run) -> bool:
        """Return whether the model was learned from this run, or from a part of its recording."""
        from softmap_edge.run.pieces import spans

        known = [
            (str(one), float(start), float(end))
            for one, start, end in self.made_from.get("pieces", [])
        ]
        parts = spans(run)
        return run.hash() in self.made_from.get("runs", []) or any(
            one == part.origin and max(start, first) < min(end, last)
            for one, start, end in known
            for part, first, last in parts
        )

    @property
    def coverage(self) -> Coverage | None:
        """The commands that a learned model was trained on; None if they were not stored."""
        return None if self.arrays is None else self.arrays.prior.coverage

    @property
    def params(self) -> dict[str, float]:
        """The parameters of the effects, by label (`backlash.gap`, `gain.factor[0]`)."""
        return named(self.chain, self.chain_params)

    @cached_property
    def tip_shape(self) -> Shape:
        """The tip (3,) mm for an effective command, unloaded, in the model's orientation.

        It is the mean of the `tip_indices` (`predictors.tip`).
        """
        return tip(
            self.structure, self.chain, self.chain_params, self.gravity_reference, 0.0, float("nan")
        )

    def tip(self, acting: Floats) -> Floats:
        """Return the tip (n, 3) mm in the base frame for effective commands `acting` (n, C) mm.

        Sensing effects are not applied. The tip is NaN where a command is masked or NaN.
        """
        return np.asarray(self.tip_shape.evaluate(unmasked(acting)))

    def tip_jacobian(self, acting: Floats) -> Floats:
        """Return the slopes (n, 3, C) of the tip, mm per mm, at commands `acting` (n, C) mm."""
        return np.asarray(self.tip_shape.jacobian(unmasked(acting)))

    def missing_for(self, name: str) -> list[str]:
        """Return what the effect `name` needs and this model lacks.

        These are names of fields, `tendon_compliance`, `contact`, or a number of the prior.
        """
        there = set(self.fields) | (
            {"tendon_compliance"} if self.structure.cables is not None else set()
        )
        there |= set() if self.structure.contact is None else {"contact"}
        there |= set(self.prior.numbers)
        chain = _core.Chain([name], self.channels)
        return [required for required in (*chain.fields, *chain.numbers) if required not in there]

    def with_effects(self, names: Sequence[str], params: Floats | Mapping[str, float]) -> Model:
        """Return a model whose chain is exactly `names` with `params` in chain order or by label.

        A shared parameter may be given once (`backlash.gap`) or per channel (`backlash.gap[1]`). In
        chain order, either all of them are given once or all are given per channel.

        By label, `params` may also hold changes of the prior's numbers (`changes`). Without an
        effect that changes its law, the prior returns to its numbers from before such an effect was
        added.
        """
        chain = _core.Chain(list(names), self.channels)
        if isinstance(params, Mapping):
            known = {change.label for change in self.changes(names)}
            moved = {label: value for label, value in params.items() if label in known}
            if moved:
                return self.changed(moved).with_effects(
                    names, {k: v for k, v in params.items() if k not in known}
                )
            allowed = {
                name for pair in zip(chain.labels, chain.group_labels) for name in readings(*pair)
            }
            unknown = [label for label in params if label not in allowed]
            if unknown:
                there = ", ".join(dict.fromkeys(chain.group_labels))
                raise SoftmapError(f"no parameter '{unknown[0]}' in the chain; there are {there}")
            params = valued(chain, params, chain.null)
        params = spread(chain, unmasked(params))
        if params.shape != (len(chain.labels),):
            groups = list(dict.fromkeys(chain.group_labels))
            raise SoftmapError(
                f"{len(groups)} parameters expected ({', '.join(groups)}), got {params.shape}"
            )
        if not np.isfinite(params).all():
            wrong = next(
                label for label, value in named(chain, params).items() if not np.isfinite(value)
            )
            raise SoftmapError(f"{wrong} is not a finite number; give one")
        if (params < 0)[chain.log].any():
            i = int(np.argmax(chain.log & (params < 0)))
            wrong = next(
                label
                for label in (chain.group_labels[i], chain.labels[i])
                if label in named(chain, params)
            )
            raise SoftmapError(f"{wrong} is {params[i]:g} {chain.units[i]}, allowed is 0 or more")
        model = self if chain.numbers else self._before_laws()
        return replace(model.with_residual(None), chain_names=tuple(names), chain_params=params)

    def bare(self) -> Model:
        """Return the model without its effects and its residual: the prior alone."""
        return self.with_effects([], {})

    def with_residual(self, arrays: ModeArrays | NetworkArrays | None) -> Model:
        """Return the model with the residual of `arrays` in place of its own, or with none.

        Raises:
            SoftmapError: its commands or points differ.
        """
        kept = None if self.arrays is None else replace(self.arrays, residual=arrays)
        if arrays is None:
            made = {name: details for name, details in self.made_from.items() if name != "residual"}
            return replace(self.with_structure(residual=None), arrays=kept, made_from=made)
        residual = arrays.compiled()
        _core.Sum(self.prior, residual)  # raises unless they agree
        return replace(self.with_structure(residual=residual), arrays=kept)

    def changes(self, names: Sequence[str]) -> list[Change]:
        """Return the changes of the prior's numbers that are fitted along with the effects `names`.

        Their labels are those of the effects. The numbers of a rod were fitted under its law, so an
        effect that changes this law makes them free again.
        """
        laws = [name for name in names if _core.Chain([name], self.channels).numbers]
        if not laws or self._elastic is None:
            return []
        return [replace(c, label=f"{laws[0]}.{c.label}") for c in self._elastic.changeable()]

    def changed(self, values: Mapping[str, float]) -> Model:
        """Return the model with the prior's numbers changed, by the labels of `changes`."""
        if self._elastic is None:
            raise SoftmapError(f"the model of '{self.robot}' has no rod whose numbers could change")
        rod = self._elastic.changed(
            {label.split(".", 1)[1]: value for label, value in values.items()}
        )
        before = self._before or NumbersBefore(self._elastic.numbers, self.form_error)
        return self._with_rod(rod, before)

    @property
    def has_earlier_numbers(self) -> bool:
        """Whether an effect changed the prior's numbers and the earlier ones are stored."""
        return self._before is not None

    @property
    def _before(self) -> NumbersBefore | None:
        before = None if self.arrays is None else self.arrays.prior.before
        return before if isinstance(before, NumbersBefore) else None

    def _before_laws(self) -> Model:
        """Return the model with its rod's numbers and error from before any change."""
        before = self._before
        if before is None or self._elastic is None:
            return self
        error = before.form_error
        if error.shape != self.form_error.shape or np.any(error < 0):
            raise SoftmapError(
                f"elastic rod: an error {error.shape} of before, now {self.form_error.shape}; "
                "learn again"
            )
        model = self._with_rod(self._elastic.with_numbers(before.numbers), None)
        overall = float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
        return replace(model, form_error=error, vertex_error_mm=overall)

    def _with_rod(self, rod: ElasticRodArrays, before: NumbersBefore | None) -> Model:
        assert self.arrays is not None  # the rod's source
        prior = replace(self.arrays.prior, shape=rod, before=before)
        return replace(
            self.with_structure(prior=rod.compiled(), fields=dict(rod.fields())),
            arrays=replace(self.arrays, prior=prior),
        )

    @cached_property
    def _elastic(self) -> ElasticRodArrays | None:
        """The elastic rod of the prior, if some of its numbers were fitted to a run."""
        from softmap_edge.model.elastic_rod import ElasticRodArrays

        rod = None if self.arrays is None else self.arrays.prior.shape
        return rod if isinstance(rod, ElasticRodArrays) and rod.free else None

    # --- from runs ------------------------------------------------------------------------------

    def commands(self, run: Run) -> Floats:
        """Return the run's commands (T, C) for this model: present positions if it has any."""
        u = (run := converted(self, run)).commands("goal" if self.input == "goal" else None)
        from softmap_edge.model.training_range import check_commands

        check_commands(self, run, u)
        return np.ascontiguousarray(u, float)

    def predict(self, run: Run) -> Floats:
        """Return the points (K, N, 3) mm at seen times, or the markers if the run has any."""
        vertices = self.points.predict(self.chain, self.chain_params[None], self.inputs(run))[0]
        carry = self.view(run).carry
        return flat(
            vertices if carry is None else np.asarray(np.einsum("mn,knc->kmc", carry, vertices)),
            run,
        )

    def features(self, run: Run) -> Floats:
        """Return the predicted features (K, V, 3) mm at the run's seen times."""
        return np.asarray(self.predict_features(self.chain_names, self.chain_params[None], run)[0])

    def inputs(self, run: Run) -> _core.Inputs:
        """Return a run as input of the core, for repeated predictions of an unchanged run."""
        gravity = self.gravity_reference if run.gravity is None else run.gravity
        return _core.Inputs(
            self.commands(run),
            np.asarray(run.t, float),
            np.asarray(run.t_seen, float),
            gravity=np.broadcast_to(gravity, (len(run.t), 3)),
            load=run.load,
            temperature=run.temperature,
            cameras=run.cameras,
        )

    def predict_features(
        self, names: Sequence[str], params: Floats, run: Run, inputs: _core.Inputs | None = None
    ) -> Floats:
        """Return features (B, K, V, 3) mm for B parameter sets (B, P) of a chain of `names`.

        The core computes them in one batch. For repeated calls, here and below, the result of
        `inputs` may be passed in.
        """
        chain = (
            self.chain
            if tuple(names) == self.chain_names
            else _core.Chain(list(names), self.channels)
        )
        return flat(
            self.view(run).predictor.predict(chain, params, inputs or self.inputs(run)), run
        )

    def through(self, weights: Floats, run: Run) -> _core.Predictor | None:
        """Return the predictor of linear forms of the features, `weights` (3V, M).

        None if shapes are not tables. Outputs come in threes, padded with zero forms. Sensing
        effects cannot be used with it.
        """
        filled = np.zeros((len(weights), -(-weights.shape[1] // 3) * 3))
        each = flat(weights.T.reshape(weights.shape[1], -1, 3), run)
        filled[:, : weights.shape[1]] = each.reshape(weights.shape[1], -1).T
        return self.view(run).predictor.through(filled)

    def predict_forms(
        self, forms: _core.Predictor, names: Sequence[str], params: Floats, inputs: _core.Inputs
    ) -> Floats:
        """Return forms (B, K, M) of a predictor from `through`, for B sets (B, P) of a chain."""
        found = forms.predict(_core.Chain(list(names), self.channels), params, inputs)
        return found.reshape(*found.shape[:2], -1)

    def acting(
        self, names: Sequence[str], params: Floats, run: Run, inputs: _core.Inputs | None = None
    ) -> Floats:
        """Return the effective commands (B, K, C) of a chain of `names` at the seen times.

        `params` holds B parameter sets (B, P).
        """
        chain = _core.Chain(list(names), self.channels)
        return self.view(run).predictor.acting(chain, params, inputs or self.inputs(run))

    def effective_commands(self, run: Run) -> Floats:
        """Return the effective commands (K, C) at the seen times, after the model's own effects."""
        if self.chain_names:
            return np.ascontiguousarray(
                self.acting(self.chain_names, self.chain_params[None], run)[0]
            )
        # without a predictor, which would make a table of a network's features
        u = self.commands(run)
        rows = [np.interp(run.t_seen, run.t, channel) for channel in u.T]
        return np.ascontiguousarray(np.reshape(rows, (self.channels, run.frames)).T)

    def slopes(
        self,
        names: Sequence[str],
        params: Floats,
        step: Floats,
        run: Run,
        inputs: _core.Inputs | None = None,
    ) -> Floats:
        """Return the slopes (C, K, V, 3) of the features over effective commands, for one set (P,).

        They are central differences over `step` (C,).
        """
        chain, predictor = _core.Chain(list(names), self.channels), self.view(run).predictor
        return predictor.slopes(
            chain, params[None], inputs or self.inputs(run), np.asarray(step, float)
        )

    def features_at(self, effective: Floats, run: Run) -> Floats:
        """Return the prior's features (K, V, 3) mm at effective commands (K, C) of a run."""
        chain, predictor = _core.Chain([], self.channels), self.view(run).predictor
        return np.asarray(
            predictor.predict(chain, np.zeros((1, 0)), self._inputs_at(effective, run))[0]
        )

    def slopes_at(self, effective: Floats, step: Floats, run: Run) -> Floats:
        """Return the slopes (C, K, V, 3) of the prior at effective commands (K, C).

        They are central differences over `step` (C,).
        """
        chain, predictor = _core.Chain([], self.channels), self.view(run).predictor
        return predictor.slopes(
            chain, np.zeros((1, 0)), self._inputs_at(effective, run), np.asarray(step, float)
        )

    def _inputs_at(self, effective: Floats, run: Run) -> _core.Inputs:
        """Return input of the core with one effective command per seen frame."""
        seen = np.ascontiguousarray(run.t_seen, float)
        at = np.clip(
            np.searchsorted(np.asarray(run.t, float), seen, side="right") - 1, 0, len(run.t) - 1
        )
        gravity = np.broadcast_to(
            self.gravity_reference if run.gravity is None else run.gravity, (len(run.t), 3)
        )
        load = None if run.load is None else np.broadcast_to(run.load, (len(run.t),))[at]
        warm = (
            None if run.temperature is None else np.broadcast_to(run.temperature, (len(run.t),))[at]
        )
        given = (np.ascontiguousarray(a, float) for a in (effective, seen, seen, gravity[at]))
        u, t, t_seen, g = given
        return _core.Inputs(
            u, t, t_seen, gravity=g, load=load, temperature=warm, cameras=run.cameras
        )

    def seen_features(self, run: Run) -> Floats:
        """Return the measured features (K, V, 3) mm; NaN where too few points were seen."""
        return views.seen_features(self, run)

    def seen_points(self, run: Run) -> Floats:
        """Return the run's points (K, N, 3) mm after checking that they belong to this robot."""
        return views.seen_points(self, run)

    def points_in_mm(self, run: Run) -> Floats:
        """Return the run's points after checking that their size fits the robot.

        A wrong unit would otherwise be explained by an effect.
        """
        return views.points_in_mm(self, run)

    def run_feature_map(self, run: Run) -> FeatureMap:
        """Return the map from a run's points to features (V): body sections, or the markers."""
        return self.view(run).mapping

    def run_form_error(self, run: Run) -> Floats:
        """Return the held-out model error (V, 3) mm of the run's features in its orientations."""
        return views.form_error(self, run)

    def run_leaning(self, run: Run) -> Floats:
        """Return (K, 4) for each seen frame: 1, and the relative error for a lean along x, y, z.

        The latter are relative to the error in the reference orientation.
        """
        return views.leaning(self, run)

    def view(self, run: Run) -> views.View:
        """Return this model's view of the run's points, cached for repeated predictions."""
        key = views.key_of(self, run)
        if key not in self._views:
            if len(self._views) >= KEPT_VIEWS:
                self._views.clear()
            self._views[key] = views.view_of(self, run)
        return self._views[key]

    @cached_property
    def points(self) -> _core.Predictor:
        """The predictor of all points."""
        return all_points(self.structure)
