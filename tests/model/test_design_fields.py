"""Changes of a design: the built-in model against the changed finger, solved; and bundles without
such fields.
"""

from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import _core
from softmap_edge.diagnosis.diagnose import diagnose
from softmap_edge.errors import FingerError, SoftmapError
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.files.npz import Stored
from softmap_edge.model.bundle import builtin_model, load_bundle, save_bundle
from softmap_edge.model.model import Model
from softmap_edge.model.shapes import BundleArrays, FieldArrays, Grid, ModeArrays, PriorArrays
from softmap_edge.run.run import Run

COMMANDS = np.vstack([np.zeros((1, 2)), np.random.default_rng(3).uniform(-14.0, 14.0, (5, 2))])
MIDDLES = np.linspace(0.0, 1.0, 7)


@pytest.fixture(scope="module")
def bare():
    return Simulator(Finger.builtin()).path(COMMANDS)


def section(amount, low, high):
    """The change of design of a section whose stretches hold it completely or not at all."""
    return {f"stiff_{k}": amount for k, m in enumerate(MIDDLES) if low < m < high}


# parameters; the change of design that they stand for (or mm/N of the cables); allowed share of
# error
CASES = {
    "stiffness_gradient": (
        {"stiffness_gradient.gradient": -0.6},
        {f"stiff_{k}": -0.6 * (m - 0.5) for k, m in enumerate(MIDDLES)},
        0.06,
    ),
    "stiff_section": (
        {
            "stiff_section.amount": 0.4,
            "stiff_section.centre": 0.5,
            "stiff_section.width": 2 / 3 - 1e-9,
        },
        section(0.4, 0.3, 0.7) | {"stiff_1": 0.2, "stiff_5": 0.2},
        0.22,  # of 0.46 mm: the logarithm is not small
    ),
    "one_sided_stiffness": (
        {"one_sided_stiffness.x": 0.25, "one_sided_stiffness.y": -0.15},
        {"stiff_x": 0.25, "stiff_y": -0.15},
        0.08,
    ),
    "twist": ({"twist.angle": 6.0}, {"twist": 6.0}, 0.08),
    "pre_curve": (
        {"pre_curve.x": 3.0, "pre_curve.y": -1.5},
        {"curve_x": 3.0, "curve_y": -1.5},
        0.06,
    ),
    "routing": (
        {"routing.phase[0]": 5.0, "routing.phase[1]": -3.0},
        {"routing_0": 5.0, "routing_1": -3.0},
        0.1,
    ),
    "tendon_stretch": ({"tendon_stretch.compliance": 0.05}, 0.05, 0.06),
}


def moved(model: Model, name: str, params: dict[str, float]):
    """What the effect does to the model's vertices, and those of the model without it."""
    t = np.arange(float(len(COMMANDS)))
    run = Run(t=t, command=COMMANDS, t_seen=t)
    return model.with_effects([name], params).predict(run) - model.predict(run)


QUICK = ("one_sided_stiffness", "twist", "pre_curve", "tendon_stretch")
EACH = [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in CASES]


@pytest.mark.parametrize("name", EACH)
def test_the_built_in_model_answers_a_change_of_design_as_the_simulator_does(name, bare):
    params, change, allowed = CASES[name]
    finger = Finger.builtin()
    if isinstance(change, float):
        softer = 1.0 / (1.0 / finger.cable_stiffness_n_mm + change)
        truth = Simulator(finger.replace(cable_stiffness_n_mm=softer)).path(COMMANDS) - bare
    else:
        truth = Simulator(finger, change=change).path(COMMANDS) - bare
    said = moved(builtin_model(), name, params)
    miss, size = (np.sqrt(np.mean(np.sum(d**2, axis=-1))) for d in (said - truth, truth))
    assert size > 0.2, f"{size:.3f} mm: nothing to answer"
    assert miss < allowed * size, f"{miss:.3f} of {size:.3f} mm"


def in_single_precision(prior):
    """A table as it was kept before there were steps."""
    single, shape = (lambda stored: Stored(np.float32(stored.values))), prior.shape
    over = Grid(tuple(np.float32(axis) for axis in shape.over.axes))
    modes, coefficients = single(shape.modes), single(shape.coefficients)
    return PriorArrays(ModeArrays(over, shape.mean, modes, coefficients), single(prior.pull))


@pytest.fixture(scope="module")
def old(tmp_path_factory):
    """The built-in bundle as it was before there were fields of a design."""
    model = builtin_model()
    design = set(_core.FIELDS) - set(_core.LOADS)
    fields = model.arrays.fields.to_npz()
    kept = FieldArrays.from_npz({
        key: value
        for key, value in fields.items()
        if not any(key.removesuffix("_step").endswith(f"_{name}") for name in design)
    })  # fmt: skip
    prior = in_single_precision(model.arrays.prior)
    model = replace(
        model.with_structure(
            fields={name: field for name, field in model.fields.items() if name not in design}
        ),
        arrays=BundleArrays(prior, kept),
        safety=None,
    )
    folder = save_bundle(model, tmp_path_factory.mktemp("bundles") / "old")
    assert '"schema": 1,' in (folder / "manifest.json").read_text()
    return load_bundle(folder)


def test_a_bundle_without_these_fields_is_read_and_answers_loads_as_before(old):
    t = np.arange(float(len(COMMANDS)))
    run = Run(
        t=t,
        command=COMMANDS,
        t_seen=t,
        gravity=np.array([0.6, 0.0, 0.8]),
        load=np.full(len(t), 20.0),
    )
    np.testing.assert_allclose(old.predict(run), builtin_model().predict(run), atol=1e-4)  # float32
    assert old.missing_for("payload") == [] and old.missing_for("tendon_stretch") == []
    assert old.missing_for("twist") == ["twist"] and builtin_model().missing_for("twist") == []
    with pytest.raises(SoftmapError, match="field twist, which this model does not have"):
        moved(old, "twist", {"twist.angle": 3.0})


def test_an_effect_without_its_field_is_reported_untestable(old):
    t = np.arange(0.0, 40.0, 0.2)
    command = 8.0 * np.stack([np.sin(0.4 * t), np.sin(0.7 * t)], axis=1)
    points = old.predict(Run(t=t, command=command, t_seen=t))
    seen = points + np.random.default_rng(0).normal(scale=0.1, size=points.shape)
    run = Run(t=t, command=command, t_seen=t, vertices=seen)
    found = diagnose(old, run, effects=["gain", "twist"])
    reported = {row["name"]: row["why"] for row in found.to_dict()["not_testable"]}
    assert reported["twist"] == "a model with the geometry of the body is needed"


def test_a_change_that_no_finger_has_is_refused():
    finger = Finger.builtin().replace(core=1, layers=6)
    for change in ({"wind": 1.0}, {"routing_2": 1.0}, {"twist": float("nan")}, {"gravity_x": 1.0}):
        with pytest.raises(FingerError, match=f"change {next(iter(change))}"):
            Simulator(finger, change=change)


def stretched(command, **compliance):
    """What compliances, by label, do to the vertices of the built-in model at one command."""
    t = np.arange(2.0)
    run, model = Run(t=t, command=np.tile(command, (2, 1)), t_seen=t), builtin_model()
    given = {f"tendon_stretch.compliance{label}": value for label, value in compliance.items()}
    return (model.with_effects(["tendon_stretch"], given).predict(run) - model.predict(run))[0]


@pytest.mark.parametrize(("side", "other", "sign"), [("+", "-", 1.0), ("-", "+", -1.0)])
@pytest.mark.parametrize("channel", [0, 1])
def test_each_cable_has_its_own_compliance(channel, side, other, sign):
    """A cable that is pulled moves the body as if all were so soft, its antagonist, which hangs,
    hardly at all.
    """
    for amount in (6.0, 8.0, 11.0):
        command = sign * amount * np.eye(2)[channel]
        every = stretched(command, **{"": 0.04})
        pulled, slack = (stretched(command, **{f"[{channel}{k}]": 0.04}) for k in (side, other))
        size = np.sqrt(np.mean(every**2))
        assert size > 0.1 and np.sqrt(np.mean((pulled - every) ** 2)) < 0.2 * size
        assert np.sqrt(np.mean(slack**2)) < 0.2 * size
