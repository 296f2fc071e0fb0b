"""Make a model from a finger: sweep, fields, compression to modes, and a measured model-form error.

The model-form error is measured, not assumed. Commands off the grid are solved on another mesh,
with the modulus 10 % up and 10 % down, and compared with the table, per feature and over the
vertices. For an imported mesh, the other mesh is the refined one with eight times the cells. It is
solved at a few commands only, from the equilibria of the first, and the squares of both differences
are added.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.errors import FingerError, SoftmapError
from softmap_edge.fem.bodies import Meshed
from softmap_edge.fem.doubts import doubts, lost_in_tendons
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Bend, Compliance, Simulator, Sweep, tensor_grid
from softmap_edge.files.npz import Stored
from softmap_edge.geometry.sections import SECTIONS, sections_of, tip_of
from softmap_edge.model.model import Model
from softmap_edge.model.safety import derived
from softmap_edge.model.shapes import (
    BundleArrays,
    FieldArrays,
    Grid,
    ModeArrays,
    PairArrays,
    PriorArrays,
    SecondArrays,
    pairs_of,
)
from softmap_edge.model.structure import Structure
from softmap_edge.run.run import Run
from softmap_edge.version import __version__

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]

MODES = 16  # 12 modes represent the shapes of a finger to 0.016 mm
FIELD_MODES = 40
FIELD_PART = 3e-3  # of a field's size: stored precision
PULL_STEP = 1e-3  # N
FIELD_STEPS = 11  # nodes per channel for smooth fields,
COARSE_FIELD_STEPS = 7  # and for three channels, or for a slow imported mesh
# the same for second derivatives, a tenth to a third of the load fields:
SECOND_STEPS, COARSE_SECOND_STEPS = 7, 5
SECOND_MODES, SECOND_PART = 8, 0.1  # fewer modes; stored precision as a part of their size
FORM_COMMANDS = 24
MESHED_COMMANDS = 8
REFINED_COMMANDS = 3  # factorising the refined mesh takes seconds, not milliseconds
USUAL_STEPS = {1: 41, 2: 41, 3: 13}  # commands per channel of a sweep: 1681 for two, 2197 for three
EVEN_STEPS = 21  # steps of a sweep from which the spacing is uniform
GRADED = 1.7  # power of the spacing of fewer steps, denser about home
FORM_SEED = 20
# where the parts of a build end, as shares: of all work for the sweep, then of the rest; measured
# with the built-in finger
PARTS = {"sweep": 0.2, "fields": 0.1, "second order": 0.4}
# gravity across the reference, g, a lean of 35 degrees: measures the error under other gravity
SIDEWAYS = 0.7


def build_model(
    finger: Finger, steps: int | None = None, progress: Progress | None = None, modes: int = MODES
) -> Model:
    """Simulate `finger` over its command range and return its table model.

    `steps` commands per channel (odd, at least 5; usually 41, or 13 of three channels) over its
    command range. `progress` is called with (what, share of all work). Raises NoEquilibriumError
    if there is no equilibrium, SoftmapError for a bad argument.
    """
    report: Progress = progress or (lambda what, share: None)
    simulator = simulator_of(finger)
    grid_axes(finger, steps)
    handles_of(finger, simulator.template.vertices)
    # needed for the model-form error: reject a bad mesh before the sweep
    Simulator(finger.other_mesh())
    sweep = simulator.sweep(
        grid_axes(finger, steps), progress=part(report, "sweep", 0.0, PARTS["sweep"])
    )
    return from_sweep(finger, simulator, sweep, part_of_all(report), modes)


def part(report: Progress, what: str, begin: float, end: float) -> Callable[[float], None]:
    """Return the progress of a part of the work, which takes it from `begin` to `end`."""
    return lambda share: report(what, begin + (end - begin) * share)


def part_of_all(report: Progress) -> Progress:
    """Return the progress of what follows the sweep, as a share of all work."""
    return lambda what, share: report(what, PARTS["sweep"] + (1.0 - PARTS["sweep"]) * share)


def simulator_of(finger: Finger) -> Simulator:
    """Return the simulator of a finger, with vertices all along the body if possible.

    For a coarse mesh file, the vertices of the refined mesh are used.

    Raises:
        FingerError: the finger cannot be built.
    """
    simulator, solid = Simulator(finger), finger.solid
    while (
        isinstance(solid, Meshed)
        and len(np.unique(sections_of(simulator.template.vertices))) < SECTIONS
    ):
        try:
            solid = solid.other_mesh()
            simulator = Simulator(finger, template=Simulator(finger.replace(solid=solid)).template)
        except FingerError:  # it cannot be refined; the caller that needs the vertices reports it
            break
    return simulator


def grid_axes(finger: Finger, steps: int | None = None) -> list[Floats]:
    """Return the axis (n,) of each command in a sweep of `finger`, in its command unit.

    Raises SoftmapError for more than three commands.
    """
    if len(finger.pairs) > max(USUAL_STEPS):
        raise SoftmapError(
            f"{finger.name} has {len(finger.pairs)} commands, a sweep is a grid over at most "
            f"{max(USUAL_STEPS)}; pair its tendons, or simulate scattered commands with "
            "Simulator.path"
        )
    count = steps or USUAL_STEPS.get(len(finger.pairs), 1)
    return [_axis(low, high, count, count < EVEN_STEPS) for low, high in finger.command_range]


def _axis(low: float, high: float, count: int, graded: bool) -> Floats:
    """Return `count` nodes from `low` to `high`.

    Graded nodes are denser about home, where tendons become slack.
    """
    even, far = np.linspace(low, high, count), max(-low, high)
    return (
        np.asarray(np.sign(even) * far * np.abs(even / far) ** GRADED)
        if graded and low < 0.0
        else even
    )


def from_sweep(
    finger: Finger, simulator: Simulator, sweep: Sweep, report: Progress, modes: int = MODES
) -> Model:
    """Compress a sweep of `finger` to a table model; add its fields and its model-form error.

    `report` is called with (what, share of this work).
    """
    rest, triangles = simulator.template.vertices, simulator.template.triangles
    notes = [*doubts(finger), *filter(None, [lost_in_tendons(finger, sweep.command, sweep.pull)])]
    table = compressed(sweep.axes, sweep.vertices.reshape(len(sweep.command), -1), modes)
    prior = PriorArrays(table, pull=Stored.in_steps(sweep.pull, PULL_STEP, np.int16))
    tensions = prior.tensions()
    many = len(sweep.axes) > 2 or isinstance(finger.solid, Meshed)
    steps = COARSE_FIELD_STEPS if many else FIELD_STEPS
    field_axes = [_axis(axis[0], axis[-1], steps, len(axis) < EVEN_STEPS) for axis in sweep.axes]
    ends = [PARTS[name] for name in ("fields", "second order")]
    report("fields", 0.0)
    grid = tensor_grid(field_axes)
    # A commanded tension in N does not change under a load.
    stiffness = finger.cable_stiffness_n_mm if finger.command_unit == "mm" else 0.0
    pull = np.zeros((len(grid), 0)) if tensions is None else tensions.evaluate(grid)
    fields = field_arrays(
        simulator.fields(grid, progress=part(report, "fields", 0.0, ends[0]), design=True),
        field_axes,
        pull,
        stiffness,
    )
    if finger.tendons and stiffness:
        fields = replace(fields, stiffness=np.full(len(finger.tendons), stiffness))
    seconds = COARSE_SECOND_STEPS if many else SECOND_STEPS
    second_axes = [_axis(axis[0], axis[-1], seconds, len(axis) < EVEN_STEPS) for axis in sweep.axes]
    assert fields.modes is not None
    second = second_arrays(
        simulator.bends(tensor_grid(second_axes), part(report, "second order", *ends)),
        second_axes,
        bool(stiffness),
        fields.modes.values,
    )
    fields = replace(fields, second=second)
    model = Model(
        structure=Structure(
            prior=table.compiled(),
            fields=fields.compiled(),
            cables=fields.cables(tensions),
            second=fields.second_order(),
            rest=np.asarray(np.float32(rest), float),
            triangles=np.asarray(triangles, np.int32),
            tip_indices=tip_of(sweep.vertices),
            gravity_reference=np.asarray(finger.gravity, float),
            command_range=np.array([[axis[0], axis[-1]] for axis in sweep.axes], float).reshape(
                -1, 2
            ),
        ),
        kind="table",
        form_error=np.zeros((3 * SECTIONS, 3)),
        vertex_error_mm=0.0,
        robot=finger.name,
        command_unit=finger.command_unit,
        handles=handles_of(finger, rest),
        made_from={
            "softmap-edge": __version__,
            "finger": finger.name,
            "steps": len(sweep.axes[0]) if sweep.axes else 1,
            "modes": modes,
            **({"notes": notes} if notes else {}),
        },
        arrays=BundleArrays(prior, fields),
    )
    error, vertex_error, grown = form_error(
        model, finger, simulator, part(report, "model-form error", ends[1], 1.0)
    )
    report("model-form error", 1.0)
    limits = derived(model, finger.young_mpa)
    return replace(
        model, form_error=error, vertex_error_mm=vertex_error, error_per_g_mm=grown, safety=limits
    )


def handles_of(finger: Finger, rest: Floats) -> NDArray[np.int64] | None:
    """Return the ascending indices of the handles among vertices `rest` (N, 3) mm, None for all.

    The first is the farthest from the base, each next one the farthest from all previous ones.
    Raises FingerError if there are fewer vertices.
    """
    if finger.handles is None:
        return None
    if finger.handles > len(rest):
        raise FingerError(
            f"template.handles: {finger.handles}, the template has {len(rest)} vertices; give 1 "
            f"to {len(rest)}, or leave [template] out for all"
        )
    # in the precision of a bundle
    places = np.asarray(np.float32(rest), float)
    chosen: list[int] = []
    nearest = np.sum(places**2, axis=1)
    for _ in range(finger.handles):
        chosen.append(int(np.argmax(nearest)))
        distance = np.sum((places - places[chosen[-1]]) ** 2, axis=1)
        nearest = distance if len(chosen) == 1 else np.minimum(nearest, distance)
        nearest[chosen] = -1.0
    return np.sort(np.array(chosen, np.int64))


def compressed(axes: Sequence[Floats], values: Floats, modes: int) -> ModeArrays:
    """Return the table of values (S, M) over the grid of `axes`, with some modes.

    Values are quantised to 1/32767 of the largest: 0.001 mm RMS of a finger's sweep.
    """
    mean = values.mean(axis=0)
    centred = values - mean
    basis = Stored.in_steps(leading(centred, modes), np.zeros((1, 1)), np.int16)
    weights = Stored.in_steps(centred @ np.linalg.pinv(basis.values), 0.0, np.int16)
    return ModeArrays(Grid(tuple(axes)), mean.astype(np.float32), basis, weights)


def form_error(
    model: Model, finger: Finger, simulator: Simulator, progress: Callable[[float], None]
) -> tuple[Floats, float, float]:
    """Measure the model error at held-out commands.

    Return RMS (V, 3) mm of the features, RMS mm of the vertices, and the growth of the latter per g
    of difference to the reference gravity.

    The truth has another mesh and a modulus 10 % lower and higher, with the same template points.
    The modulus matters under the weight of a leaning body, and hardly under tendons of given
    shortening. `progress` is called with the completed share.
    """
    rng = np.random.default_rng(FORM_SEED)
    low, high = model.command_range.T
    meshed = isinstance(finger.solid, Meshed)
    count = 1
    if model.channels:
        count = MESHED_COMMANDS if meshed else FORM_COMMANDS
    commands = rng.uniform(low * 0.85, high * 0.85, (count, model.channels))
    if finger.command_unit == "N":  # no tendon is pulled below zero: stay inside the range
        commands = low + (high - low) * rng.uniform(0.075, 0.925, commands.shape)
    predicted = model.prior.evaluate(commands).reshape(count, -1, 3)
    leaning = _leaning(model.gravity_reference)
    t = np.arange(count, dtype=float)
    leaned = model.predict(
        Run(t=t, command=commands, command_unit=model.command_unit, gravity=leaning, t_seen=t)
    )
    truth = finger if meshed else finger.other_mesh()
    squares, vertex_squares, leaning_squares = [], [], []
    named: Progress = lambda what, share: progress(share)  # noqa: E731
    paths = (part(named, "", k / 4.0, (k + 1) / 4.0) for k in range(4))
    for factor in (0.9, 1.1):
        other = Simulator(
            truth.replace(young_mpa=finger.young_mpa * factor), template=simulator.template
        )
        error = other.path(commands, progress=next(paths)) - predicted
        squares.append(model.structure.feature_map(error) ** 2)
        vertex_squares.append((error**2).sum(axis=2))
        leaned_points = other.path(commands, gravity=leaning, progress=next(paths))
        leaning_squares.append(((leaned_points - leaned) ** 2).sum(axis=2))
    features, upright = np.mean(np.concatenate(squares), axis=0), float(np.mean(vertex_squares))
    aslant = float(np.mean(leaning_squares))
    grown = float(
        np.sqrt(max(aslant - upright, 0.0)) / np.linalg.norm(leaning - model.gravity_reference)
    )
    if meshed:
        error = refined(finger, simulator, commands[:REFINED_COMMANDS])
        features += np.mean(model.structure.feature_map(error) ** 2, axis=0)
        upright += float(np.mean((error**2).sum(axis=2)))
    return np.sqrt(features), float(np.sqrt(upright)), grown


def refined(finger: Finger, simulator: Simulator, commands: Floats) -> Floats:
    """Return the change (K, N, 3) mm on a mesh of eight times the cells.

    The commands are (K, C).
    """
    finer = Simulator(finger.other_mesh(), template=simulator.template)
    return finer.path_from(simulator, commands) - simulator.path(commands)


def _leaning(gravity: Floats) -> Floats:
    """Return the unit gravity (3,) of the finger with SIDEWAYS across `gravity` (3,) g.

    This is the gravity of the turned finger.
    """
    across = np.eye(3)[int(np.argmin(np.abs(gravity)))]
    across = across - (across @ gravity) * gravity / max(gravity @ gravity, 1e-9)
    leaning = gravity + SIDEWAYS * across / np.linalg.norm(across)
    return np.asarray(leaning / np.linalg.norm(leaning))


def field_arrays(
    compliance: Compliance, axes: list[Floats], pull: Floats, stiffness: float
) -> FieldArrays:
    """Compress all fields to shared modes, on the grid of `axes`.

    At constant tension, a change of design moves the body several times as far as after the tendons
    respond. So modes and steps are chosen by the motion after the response. `pull` (S, T) N at the
    grid, `stiffness` N/mm (0: tensions are given and do not respond).
    """
    names = sorted(compliance.fields)
    flat = {name: compliance.fields[name].reshape(len(compliance.stretch), -1) for name in names}
    size = _sizes(compliance, flat, pull, stiffness)
    basis = leading(np.concatenate([flat[name] / size[name] for name in names]), FIELD_MODES)
    modes = Stored.in_steps(basis, np.zeros((len(basis), 1)), np.int8)
    back = np.linalg.pinv(modes.values)
    coefficients = {}
    for name in names:
        step = FIELD_PART * size[name] * float(np.sqrt(basis.shape[1]))
        coefficients[name] = Stored.in_steps(flat[name] @ back, step, np.int16)
    stretch, loads, count = compliance.stretch, len(_core.LOADS), len(_core.FIELDS)
    both = np.concatenate([stretch[..., :loads], stretch[..., count:]], axis=2).reshape(
        len(stretch), -1
    )
    return FieldArrays(
        Grid(tuple(axes)),
        modes,
        coefficients,
        stretch=Stored.in_steps(both, np.zeros((1, both.shape[1])), np.int16),
        stretch_of={
            name: Stored.in_steps(stretch[..., f], 0.0, np.int16)
            for f, name in enumerate(_core.FIELDS)
            if f >= loads and name in flat and stretch.shape[1]
        },
    )


def second_arrays(bend: Bend, axes: list[Floats], answers: bool, modes: Floats) -> SecondArrays:
    """Compress the second derivatives by loads and moduli, on the grid of `axes`.

    They use a few modes, combined from the `modes` (m, 3N) of the fields. Tensions are included
    only if `answers`.
    """
    loads, moduli, causes = len(_core.LOADS), len(_core.MODULI), bend.growth.shape[1]
    first, other = np.triu_indices(causes)
    # Pairs are weighted by amounts of gravity, force, moduli and tensions that bend the body
    # equally.
    kind = np.repeat([0, 1, 2, 3], [3, loads - 3, moduli, causes - loads - moduli])
    size = np.sqrt(np.mean(bend.fields**2, axis=(0, 2, 3)))
    alike = [
        np.sqrt(np.mean(size[(kind[first] == k) & (kind[other] == k)] ** 2))
        for k in sorted(set(kind))
    ]
    usual = 1.0 / np.sqrt(np.maximum(alike, 1e-9))
    amount = usual[kind[first]] * usual[kind[other]]
    parts = pairs_of(loads, moduli, causes - loads - moduli if answers else 0)
    row = {pair: p for p, pair in enumerate(zip(first.tolist(), other.tolist()))}
    kept = [np.array([row[min(pair), max(pair)] for pair in pairs]) for pairs, _ in parts]
    fields = bend.fields.reshape(len(bend.fields), len(first), -1) @ np.linalg.pinv(modes)
    every = np.concatenate(kept)
    basis = leading(
        (fields * amount[:, None])[:, every].reshape(-1, fields.shape[2]), SECOND_MODES
    ).astype(np.float32)
    found = []
    for (_, own), pairs in zip(parts, kept):
        amounts = amount[pairs, None]
        weights = fields[:, pairs] @ basis.T.astype(np.float64)
        stretch = bend.stretch[:, pairs] if answers else np.zeros((len(fields), len(pairs), 0))
        bent, longer = (
            Stored.in_steps(values, SECOND_PART * _rms(values * amounts) / amounts[None], np.int16)
            for values in (weights, stretch)
        )
        growth = Stored.in_steps(bend.growth[:, own], 1e-3, np.int16)
        found.append(PairArrays(bent, longer, growth))
    return SecondArrays(Grid(tuple(axes)), basis, *found)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _sizes(
    compliance: Compliance, flat: dict[str, Floats], pull: Floats, stiffness: float
) -> dict[str, float]:
    """Return the motion of the body by each field, mm RMS per coordinate.

    It is the motion after the taut tendons respond. For a tension it is 0.4 of the motion by 1 N.
    """
    count = len(_core.FIELDS)
    size = {}
    for name, values in flat.items():
        free = float(np.sqrt(np.mean(values**2))) + 1e-12
        size[name] = 0.4 * free if name.startswith("tension_") else free
        if name not in _core.FIELDS or not stiffness:
            continue
        left = values.copy()
        for s, stretch in enumerate(compliance.stretch):
            taut = np.flatnonzero(pull[s] > 0.0)
            if not len(taut):
                continue
            matrix = np.eye(len(taut)) / stiffness - stretch[np.ix_(taut, count + taut)]
            answer = np.linalg.solve(matrix, stretch[taut, _core.FIELDS.index(name)])
            left[s] += answer @ np.array([flat[f"tension_{t}"][s] for t in taut]).reshape(
                len(taut), -1
            )
        size[name] = max(float(np.sqrt(np.mean(left**2))), 0.1 * free)
    return size


def leading(values: Floats, modes: int) -> Floats:
    """Return the `modes` leading right singular vectors (m, M) of values (S, M)."""
    if len(values) < values.shape[1]:
        _, vectors = np.linalg.eigh(values @ values.T)
        return np.ascontiguousarray(np.linalg.qr(values.T @ vectors[:, ::-1][:, :modes])[0].T)
    _, directions = np.linalg.eigh(values.T @ values)
    return np.ascontiguousarray(directions[:, ::-1][:, :modes].T)
