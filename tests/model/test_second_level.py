"""Large loads and softer sections: the built-in model against the finger solved with them, what
bends, old bundles.
"""

from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import _core
from softmap_edge.errors import BundleError, SoftmapError
from softmap_edge.fem.build import build_model
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.files.npz import read_npz
from softmap_edge.model.bundle import builtin_model, load_bundle, save_bundle
from softmap_edge.model.shapes import FieldArrays
from softmap_edge.run.run import Run

NEWTON = 9.80665e-3  # a gram
COMMANDS = np.vstack([np.zeros((1, 2)), np.random.default_rng(3).uniform(-14.0, 14.0, (4, 2))])
UP = np.array([0.5, -0.3, -0.81])
LEANING = np.array([np.sin(np.radians(35.0)), 0.0, np.cos(np.radians(35.0))])
# gravity, grams, allowed share of error, what is missed without a second level at least
CASES = {
    "25 g leaning": (LEANING, 25.0, 0.05, 0.08),
    "60 g leaning": (LEANING, 60.0, 0.08, 0.16),
    "60 g horizontal": (np.array([0.0, -1.0, 0.0]), 60.0, 0.08, 0.10),
    "60 g upwards": (UP / np.linalg.norm(UP), 60.0, 0.08, 0.20),
}
LOADS = [
    name if name == "60 g leaning" else pytest.param(name, marks=pytest.mark.long) for name in CASES
]


@pytest.fixture(scope="module")
def simulator():
    return Simulator(Finger.builtin())


@pytest.fixture(scope="module")
def bare(simulator):
    return simulator.path(COMMANDS)


def rms(moved):
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=-1))))


def moved(model, gravity, grams):
    """What a declared gravity and load do to the vertices of a model."""
    t = np.arange(float(len(COMMANDS)))
    bare = Run(t=t, command=COMMANDS, t_seen=t)
    loaded = replace(bare, gravity=gravity, load=np.full(len(t), float(grams)))
    return model.predict(loaded) - model.predict(bare)


@pytest.mark.parametrize("name", LOADS)
def test_a_large_load_moves_the_finger_as_the_simulator_says(name, simulator, bare):
    gravity, grams, allowed, linear = CASES[name]
    truth = simulator.path(COMMANDS, gravity=gravity, load=NEWTON * grams * gravity) - bare
    model = builtin_model()
    first, second = (
        rms(moved(m, gravity, grams) - truth) for m in (model.with_structure(second=None), model)
    )
    assert second < allowed * rms(truth), f"{second:.2f} of {rms(truth):.2f} mm"
    assert first > linear * rms(truth), f"{first:.2f} of {rms(truth):.2f} mm: nothing to improve"


@pytest.mark.long
def test_a_lean_alone_is_answered_between_the_commands_of_the_sweep(simulator):
    """Where tendons fall slack between two of them: tensions interpolated across that kink are up
    to 2 N off, and the lean then 0.21 mm RMS.
    """
    commands = np.random.default_rng(0).uniform(-14.0, 14.0, (10, 2))
    t = np.arange(float(len(commands)))
    plain = Run(t=t, command=commands, t_seen=t)
    model = builtin_model()
    reported = model.predict(replace(plain, gravity=LEANING)) - model.predict(plain)
    truth = simulator.path(commands, gravity=LEANING) - simulator.path(commands)
    assert rms(reported - truth) < 0.05 and rms(truth) > 1.0, (
        f"{rms(reported - truth):.3f} of {rms(truth):.2f} mm"
    )


# gravity, grams, effect, amount, where; allowed share of error, what is missed where the modulus is
# answered linearly
SECTIONS = {
    "half as stiff, leaning": (LEANING, 0.0, "stiff_section", -0.7, 0.2, 0.09, 0.25),
    "twice as stiff, leaning": (LEANING, 0.0, "stiff_section", 0.7, 0.2, 0.07, 0.20),
    "half as stiff, horizontal": (
        np.array([0.0, -1.0, 0.0]),
        0.0,
        "stiff_section",
        -0.7,
        0.4,
        0.15,
        0.5,
    ),
    "half as stiff, leaning with 20 g": (LEANING, 20.0, "stiff_section", -0.7, 0.4, 0.18, 0.6),
    "a kink, leaning": (LEANING, 0.0, "kink", -0.7, 0.2, 0.10, 0.25),
}


EACH = [
    name if name == "half as stiff, leaning" else pytest.param(name, marks=pytest.mark.long)
    for name in SECTIONS
]


@pytest.mark.parametrize("name", EACH)
def test_a_softer_or_stiffer_section_moves_the_finger_as_the_simulator_says(name, simulator):
    gravity, grams, effect, amount, centre, allowed, linear = SECTIONS[name]
    if effect == "kink":  # gives way at once, and as much at all commands but for 1e-5 of it
        params = {"kink.softening": -amount, "kink.centre": centre, "kink.bend": 1e-4}
    else:
        params = {
            "stiff_section.amount": amount,
            "stiff_section.centre": centre,
            "stiff_section.width": 0.25,
        }
    chain = _core.Chain([effect], 2)
    values = np.array([[params[label] for label in chain.labels]])
    u = COMMANDS[1:]
    at = chain.coefficients(values, gravity=np.tile(gravity, (4, 1)), load=np.zeros(4), u=u)[0]
    change = {name: float(c) for name, c in zip(_core.FIELDS, at[0]) if c}
    under = {"gravity": gravity, "load": NEWTON * grams * gravity}
    truth = Simulator(simulator.finger, change=change).path(u, **under) - simulator.path(u, **under)
    many = np.tile(u, (40, 1))  # under loads that recur a body of its own is made
    off = []
    for frames in (u, many):
        t = np.arange(float(len(frames)))
        run = Run(t=t, command=frames, t_seen=t, gravity=gravity, load=np.full(len(t), grams))
        for model in (builtin_model(), builtin_model().with_structure(second=without_moduli())):
            said = model.with_effects([effect], params).predict(run) - model.predict(run)
            off.append(rms(said[:4] - truth) / rms(truth))
    assert max(off[0], off[2]) < allowed, f"{off} of {rms(truth):.2f} mm"
    assert min(off[1], off[3]) > linear, f"{off} of {rms(truth):.2f} mm: nothing to improve"


def with_fields(model, fields):
    """The model with other arrays of fields to save."""
    return replace(model, arrays=replace(model.arrays, fields=fields))


def without_moduli():
    """The second level of the built-in bundle as it was before it knew the modulus."""
    fields = builtin_model().arrays.fields
    return replace(fields, second=replace(fields.second, moduli=None)).second_order()


def test_without_a_change_of_the_modulus_the_answer_is_that_without_its_pairs():
    model = builtin_model()
    for count in (5, 200):
        t = np.arange(float(count))
        run = Run(
            t=t,
            command=np.resize(COMMANDS, (count, 2)),
            t_seen=t,
            gravity=LEANING,
            load=np.full(count, 30.0),
        )
        old = model.with_structure(second=without_moduli())
        for names, params in (([], {}), (["twist"], {"twist.angle": 4.0})):
            both = [m.with_effects(names, params).predict(run) for m in (model, old)]
            np.testing.assert_allclose(*both, atol=1e-9)


def test_a_small_load_is_answered_by_its_fields_and_none_not_at_all():
    """The correction of the second level falls with the square of the load."""
    model = builtin_model()
    linear = model.with_structure(second=None)
    hanging = np.array([0.0, 0.0, 1.0])
    added = [rms(moved(model, hanging, g) - moved(linear, hanging, g)) for g in (0.0, 0.5, 1.0)]
    assert added[0] == 0.0 and 3.6 < added[2] / added[1] < 4.0


@pytest.fixture(scope="module")
def coarse():
    return Finger.builtin().replace(core=1, layers=10)


def test_bends_are_the_differences_of_fields(coarse):
    """Of the same finger driven by tension, at the equilibrium of a command, one load or other
    cause up and down.
    """
    simulator, command = Simulator(coarse), np.array([[6.0, -4.0]])
    bend = simulator.bends(command)
    by_tension = coarse.replace(
        command_unit="N", pairs=tuple((i,) for i in range(4)), command_range=((0.0, 10.0),) * 4
    )
    twin = Simulator(by_tension)
    tension = np.maximum(
        simulator.solid.path(command, np.array([[0.0, 0.0, 1.0]]), (0.0, 0.0, 0.0))[1], 0.0
    )
    names = [*_core.LOADS, *_core.MODULI, *(f"tension_{t}" for t in range(4))]
    columns = [*range(15), *(len(_core.FIELDS) + t for t in range(4))]
    row = {pair: p for p, pair in enumerate(zip(*np.triu_indices(19)))}
    taut = int(np.argmax(tension))
    for l, by in ((0, 0.02), (5, 0.02), (8, 0.05), (13, 0.05), (15 + taut, 0.02)):
        sides = []
        for sign in (1.0, -1.0):
            step = np.zeros(19)
            step[l] = sign * by
            made = (
                Simulator(by_tension, change=dict(zip(_core.MODULI, step[6:15])))
                if 6 <= l < 15
                else twin
            )
            under = {"gravity": [0.0, 0.0, 1.0] + step[:3], "load": step[3:6]}
            found = made.fields(tension + step[15:], **under, design=True)
            sides.append(
                (np.stack([found.fields[n][0] for n in names]), found.stretch[0][:, columns].T)
            )
        for both, got in zip(zip(*sides), (bend.fields[0], bend.stretch[0])):
            wanted = (both[0] - both[1]) / (2 * by)
            mine = np.stack([got[row[min(k, l), max(k, l)]] for k in range(19)])
            # The third derivative over a step of 0.02, and round-off of equilibria that are settled
            # to 2e-4 mm.
            assert np.abs(mine - wanted).max() < 0.01 * np.abs(wanted).max()


@pytest.mark.long
def test_a_finger_driven_by_tension_or_without_tendons_has_one_too(coarse):
    pulled = coarse.replace(
        command_unit="N", command_range=((0.0, 4.0), (0.0, 4.0)), pairs=((0,), (1,))
    )
    pulled = pulled.replace(tendons=pulled.tendons[:2])
    free = coarse.replace(tendons=(), pairs=(), command_range=())
    for finger in (pulled.replace(core=2), free.replace(core=2)):
        model, simulator = build_model(finger, steps=5), Simulator(finger)
        command = np.zeros((2, model.channels))
        t = np.arange(2.0)
        bare = Run(t=t, command=command, command_unit=model.command_unit, t_seen=t)
        # Without tendons that hold, 20 g along the axis and gravity aside bend it together.
        loaded = replace(bare, gravity=LEANING, load=np.full(2, 20.0))
        truth = simulator.path(
            command, gravity=LEANING, load=NEWTON * 20.0 * LEANING
        ) - simulator.path(command)
        first, second = (
            rms(m.predict(loaded) - m.predict(bare) - truth)
            for m in (model.with_structure(second=None), model)
        )
        assert second < 0.5 * first, f"{second:.2f} against {first:.2f} of {rms(truth):.2f} mm"


def test_a_bundle_without_a_second_level_is_read_and_a_spoiled_one_refused(tmp_path):
    model = builtin_model()
    fields = model.arrays.fields
    folder = save_bundle(with_fields(model, replace(fields, second=None)), tmp_path / "old")
    assert not any(name.startswith("second_") for name in read_npz(folder / "fields.npz"))
    old = load_bundle(folder)
    assert old.structure.second is None
    linear = moved(model.with_structure(second=None), LEANING, 60.0)
    np.testing.assert_array_equal(moved(old, LEANING, 60.0), linear)
    kept = replace(fields, second=replace(fields.second, moduli=None))
    old = load_bundle(save_bundle(with_fields(model, kept), tmp_path / "loads alone"))
    np.testing.assert_array_equal(moved(old, LEANING, 60.0), moved(model, LEANING, 60.0))
    of_moduli = ("second_moduli_weights", "second_moduli_stretch", "second_moduli_growth")
    for name in ("second_growth", "second_modes", "second_axis1", "second_stretch", *of_moduli):
        stored = fields.to_npz()
        short = FieldArrays.from_npz({**stored, name: stored[name][:-1]})
        folder = save_bundle(with_fields(model, short), tmp_path / name)
        with pytest.raises(BundleError):
            load_bundle(folder)
    with pytest.raises(SoftmapError, match="numbers a node"):
        _core.Second([np.array([0.0, 1.0])], np.zeros((2, 5)), 1, np.ones((1, 3)))
