"""Effects: every one of the registry against its law written in plain NumPy (laws.py), and what all
must keep.
"""

import importlib.util
import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from bodies import (
    CAMERAS,
    COEFFICIENTS,
    HOME,
    OBSTACLE,
    finger_body,
    protocol,
    record,
    rod_body,
    turning,
    warming,
)
from laws import BY_ROLE, EFFECTS, ORACLES, named, random_params, slot, values

from softmap_edge import _core
from softmap_edge.errors import SoftmapError

RUN_FIELDS = {"cameras", "gravity", "load", "temperature", "present", "current"}


@pytest.fixture(scope="module")
def bodies():
    """A body for each role: a finger, and an elastic rod where an effect changes a number of the
    prior.
    """
    return dict.fromkeys(BY_ROLE, finger_body()) | {"prior": rod_body()}


@pytest.fixture(scope="module")
def body(bodies):
    return bodies["channel"]


def test_every_effect_has_an_oracle():
    assert set(ORACLES) == set(EFFECTS)


@pytest.mark.parametrize("name", EFFECTS)
def test_it_is_documented(name):
    effect = EFFECTS[name]
    for key in ("family", "stage", "role", "formula", "doc", "signature", "reference", "kind"):
        assert effect[key].strip(), key
    assert set(effect["needs"]) <= RUN_FIELDS
    assert effect["parameters"]
    for p in effect["parameters"]:
        assert p["doc"].strip() and p["unit"].strip() and p["low"] <= p["start"] <= p["high"]
        assert p["log"] == (p["low"] > 0 and not p["integer"])
        assert not p["integer"] or all(
            p[key] == int(p[key]) for key in ("null", "start", "low", "high")
        )
    page = (Path(__file__).parents[2] / "docs/reference/effects.md").read_text(encoding="utf-8")
    assert f"## {name}\n" in page and effect["signature"] in page


def the_page():
    """The script that makes the page, and the table of loads that stands in it, solved again by
    `make prove`.
    """
    path = Path(__file__).parents[2] / "docs" / "make_effects.py"
    spec = importlib.util.spec_from_file_location("make_effects", path)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    text = script.PAGE.read_text(encoding="utf-8")
    loads = re.search(r"^\| load \|.*?\n\n", text, re.MULTILINE | re.DOTALL)[0].strip()
    return script, loads


def test_the_page_is_up_to_date():
    script, loads = the_page()
    assert script.page(loads) == script.PAGE.read_text(encoding="utf-8"), (
        "run `python docs/make_effects.py`"
    )
    assert {path.stem for path in script.PICTURES.glob("*.svg")} == set(EFFECTS)
    for name in ("coupling", "friction", "scale"):
        assert script.pictured(EFFECTS[name]).startswith(b"<?xml")


@pytest.mark.prove
def test_errors_of_loads_are_as_the_page_says():
    script, loads = the_page()
    errors = script.load_errors()
    stated = re.findall(
        r"^\| (.+?) \| ([\d.]+) mm \| ([\d.]+) mm \| ([\d.]+) mm \|$", loads, re.MULTILINE
    )
    assert [name for name, *_ in stated] == list(errors)
    for name, *sizes in stated:
        assert tuple(map(float, sizes)) == pytest.approx(errors[name], rel=0.03, abs=0.006), name


@pytest.mark.parametrize("channels", [0, 1, 2, 6])
@pytest.mark.parametrize("name", EFFECTS)
def test_null_is_the_identity(name, channels, bodies):
    chain = _core.Chain([name], channels)
    t, u = record(channels)
    out = chain.rollout(chain.null[None], u, t, temperature=warming(t))[0]
    np.testing.assert_allclose(out, u, rtol=0, atol=1e-12)
    held = np.full((7, channels), 9.0)
    assert not chain.coefficients(chain.null[None], turning(7), u=held).any()
    if channels == 2:
        body = bodies[EFFECTS[name]["role"]]
        seen = np.linspace(t[0], t[-1], 40)
        none = _core.Chain([], 2)
        plain = body.predict(none, none.null[None], _core.Inputs(u, t, seen))
        np.testing.assert_allclose(
            body.predict(chain, chain.null[None], _core.Inputs(u, t, seen, cameras=CAMERAS)),
            plain,
            rtol=0,
            atol=1e-12,
        )


# What an effect does not act on, by its own words: one channel has no neighbour.
WITHOUT = {("coupling", 1)}


@pytest.mark.parametrize("channels", [1, 2, 3, 6])
@pytest.mark.parametrize("name", BY_ROLE["channel"])
def test_channel_effects_agree_with_the_oracle(name, channels):
    chain = _core.Chain([name], channels)
    t, u = record(channels, seed=channels)
    sets = np.stack(
        [
            values(chain, "middle"),
            values(chain, "start"),
            *(random_params(chain, s) for s in range(4)),
        ]
    )
    sets = sets if chain.labels else sets[:1]
    out = chain.rollout(sets, u, t, temperature=warming(t))
    for params, got in zip(sets, out):
        wanted = ORACLES[name](named(name, params, channels), u, t)
        # round-off of 900 recursions on 10 mm
        np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-9)
    does = np.abs(out - u).max() > 0.1
    assert does != ((name, channels) in WITHOUT), "the oracle would agree with doing nothing"


@pytest.mark.parametrize("name", BY_ROLE["shape"])
def test_shape_effects_agree_with_the_oracle(name):
    chain = _core.Chain([name], 2)
    gravity, u = turning(25), np.random.default_rng(9).uniform(-12.0, 12.0, (25, 2))
    u[0] = 0.0
    for params in (values(chain, "middle"), *(random_params(chain, s) for s in range(4))):
        got = chain.coefficients(params[None], gravity, u=u)[0]
        np.testing.assert_allclose(
            got, ORACLES[name](named(name, params, 2), gravity, u), rtol=0, atol=1e-12
        )
        assert np.abs(got).max() > 1e-3
        used = {name for name, column in zip(COEFFICIENTS, got.T) if column.any()}
        used = {"tendon_compliance" if name.startswith("compliance_") else name for name in used}
        assert used - set(OBSTACLE) <= set(chain.fields)


@pytest.mark.parametrize("name", BY_ROLE["sensing"])
def test_sensing_effects_agree_with_the_oracle(name):
    positions = np.arange(9) % 3 == 0
    t, u = record(2)
    chain, none = _core.Chain([name], 2), _core.Chain([], 2)
    gravity, load = turning(len(t)), np.linspace(0.0, 5.0, len(t))
    body = finger_body(positions)

    def see(moments):
        return body.predict(none, none.null[None], _core.Inputs(u, t, moments, gravity, load))[0]

    sets = [
        values(chain, "middle"),
        1e-7 * values(chain, "middle"),
        random_params(chain, 3),
        random_params(chain, 4),
    ]
    batch = body.predict(
        chain, np.stack(sets), _core.Inputs(u, t, t[::9], gravity, load, cameras=CAMERAS)
    )
    for params, got in zip(sets, batch):
        wanted = ORACLES[name](named(name, params, 2), see, positions, t[::9])
        np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-11)
    assert np.abs(batch[0] - see(t[::9])).max() > 0.5


@pytest.mark.parametrize("name", BY_ROLE["prior"])
def test_prior_effects_agree_with_the_oracle(name):
    chain, rod = _core.Chain([name], 2), rod_body()
    t, u = record(2)
    sets = np.stack(
        [values(chain, "middle"), chain.low, *(random_params(chain, s) for s in range(3))]
    )
    batch = rod.predict(chain, sets, _core.Inputs(u, t, t[::9]))
    for params, got in zip(sets, batch):
        wanted = ORACLES[name](named(name, params, 2), u[::9])
        np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-5)  # the oracle's sum along the arc
    assert (
        np.abs(batch[0] - rod.predict(chain, chain.null[None], _core.Inputs(u, t, t[::9]))[0]).max()
        > 0.5
    )


@pytest.mark.parametrize("name", BY_ROLE["prior"])
def test_a_body_without_the_number_refuses_it(name, body):
    chain, (t, u) = _core.Chain([name], 2), record(2)
    with pytest.raises(SoftmapError, match=f"'{chain.numbers[0]}'.*has none to change"):
        body.predict(chain, values(chain, "middle")[None], _core.Inputs(u, t, t[::9]))


@pytest.mark.parametrize("name", EFFECTS)
def test_it_moves_the_sections_by_half_a_millimetre(name, bodies):
    """At typical strength or at its start, whichever moves more: the size in a diagnosis."""
    body, chain = bodies[EFFECTS[name]["role"]], _core.Chain([name], 2)
    t, u = protocol()
    sets = np.stack([chain.null, values(chain, "middle"), values(chain, "start")])
    frames = body.predict(
        chain,
        sets,
        _core.Inputs(u, t, t[::5], turning(len(t)), temperature=warming(t), cameras=CAMERAS),
    )
    moved = np.sqrt(((frames[1:] - frames[0]) ** 2).sum(axis=-1).mean(axis=(1, 2))).max()
    assert moved >= 0.5, f"{moved:.2f} mm RMS"


@pytest.mark.parametrize("name", BY_ROLE["channel"])
def test_it_stays_bounded_and_finite(name):
    chain = _core.Chain([name], 2)
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.choice([0.0, 1e-6, 0.01, 100.0], 600))
    u = rng.uniform(-20.0, 20.0, (600, 2))
    sets = np.stack([chain.low, chain.high, *(random_params(chain, s) for s in range(10))])
    out = chain.rollout(sets, u, t, temperature=warming(t))
    # The strongest: gain 1.6, creep and Mullins 1.5 on 20 mm; offset adds 4 mm, hysteresis at most
    # 0.7 · 6.25 mm.
    most = 20.0 + 30.0 * 2.0 if name == "zero_drift" else 32.0  # half an hour at 2 mm/min
    assert np.isfinite(out).all() and np.abs(out).max() <= most + 1e-9


@pytest.mark.parametrize("name", [*BY_ROLE["channel"], "all"])
def test_step_is_rollout_and_peek_leaves_no_trace(name):
    chain = _core.Chain(BY_ROLE["channel"] if name == "all" else [name], 2)
    params = values(chain, "middle")
    t, u = record(2, samples=200)
    warm = warming(t)
    whole = chain.rollout(params[None], u, t, temperature=warm)[0]
    state = chain.init(params, u[0])
    dt = np.diff(t, prepend=t[0])
    for k in range(len(t)):
        before = state.copy()
        peeked = chain.peek(params, state, u[k], dt[k], t[k], temperature=warm[k])
        chain.peek(params, state, -u[k] + 3.0, dt[k], t[k], temperature=warm[k] + 5.0)
        np.testing.assert_array_equal(state, before)
        acting, state = chain.step(params, state, u[k], dt[k], t[k], temperature=warm[k])
        np.testing.assert_array_equal(peeked, acting)
        np.testing.assert_array_equal(acting, whole[k])
        assert state is not before and np.isfinite(state).all()


@pytest.mark.parametrize("name", [*BY_ROLE["channel"], "all"])
def test_splitting_changes_nothing_and_a_new_state_forgets(name):
    chain = _core.Chain(BY_ROLE["channel"] if name == "all" else [name], 2)
    sets = np.stack([values(chain, "middle"), random_params(chain, 1), chain.null])
    t, u = record(2, samples=300)
    warm = warming(t)
    whole, end = chain.advance(sets, u, t, temperature=warm)
    first, state = chain.advance(sets, u[:117], t[:117], temperature=warm[:117])
    second, split_end = chain.advance(sets, u[117:], t[117:], temperature=warm[117:], state=state)
    np.testing.assert_array_equal(np.concatenate([first, second], axis=1), whole)
    np.testing.assert_array_equal(split_end, end)
    np.testing.assert_array_equal(
        chain.rollout(sets, u, t, temperature=warm), whole
    )  # reset: nothing lingers in the chain


# which never rests
@pytest.mark.parametrize("name", [name for name in BY_ROLE["channel"] if name != "zero_drift"])
def test_memory_starts_in_equilibrium(name):
    chain = _core.Chain([name], 2)
    held = np.tile([[4.0, -7.0]], (400, 1))
    out = chain.rollout(values(chain, "middle")[None], held, np.linspace(0.0, 300.0, 400))[0]
    np.testing.assert_allclose(out, np.tile(out[:1], (400, 1)), rtol=0, atol=1e-12)


def test_absurd_numbers_never_become_nan():
    """Parameters far out of their bounds, commands of other units, clocks that stand still or
    leap.
    """
    rng = np.random.default_rng(8)
    t = np.cumsum(rng.choice([0.0, 1e-9, 0.1, 1e7], 200))
    u = rng.choice([0.0, 1e-300, -1e12, 1e12, 3.0], (200, 2))
    for name in BY_ROLE["channel"]:
        chain = _core.Chain([name], 2)
        for factor in (-1e6, -1.0, 1e-12, 1e3):
            try:
                out = chain.rollout((factor * chain.high)[None], u, t, temperature=warming(t))
            except SoftmapError as refused:
                assert name in str(refused) and len(str(refused)) > 30
            else:
                assert np.isfinite(out).all(), (name, factor)


def test_a_parameter_per_pair_stays_few():
    assert _core.Chain(["coupling"], 2).labels == ["coupling.factor[0,1]", "coupling.factor[1,0]"]
    assert len(_core.Chain(["coupling"], 4).labels) == 12
    assert [len(_core.Chain(["coupling"], c).labels) for c in (0, 1, 5, 9, 256)] == [
        0,
        0,
        8,
        16,
        510,
    ]
    assert _core.Chain(["coupling"], 6).labels[:3] == [
        f"coupling.factor[{pair}]" for pair in ("0,1", "1,0", "1,2")
    ]


def test_a_whole_number_has_as_many_values_as_there_are_cases():
    highs = {c: _core.Chain(["servo_swap"], c).high[0] for c in (0, 1, 2, 3, 9, 256)}
    assert highs == {0: 1, 1: 1, 2: 3, 3: 6, 9: 45, 256: 511}


def test_a_clock_that_is_late_is_no_latency_for_loads(body):
    """Commands alone: the same. Gravity that turns: a latency of the drive does not turn it
    later.
    """
    t, u = record(2)
    still = np.tile(HOME, (len(t), 1))
    late = _core.Chain(["clock_shift"], 2), np.array([[0.2]])
    delay = _core.Chain(["latency"], 2), np.array([[0.2]])
    seen = t[60::9]
    for gravity, same in ((still, True), (turning(len(t)), False)):
        frames = [
            body.predict(*chain, _core.Inputs(u, t, seen, gravity))[0] for chain in (late, delay)
        ]
        assert (np.abs(frames[0] - frames[1]).max() < 1e-9) == same


def best(law, truth, *grids):
    """The least RMS misfit of `strength · law(*shape)` to truth (T,), over grids of the shape's
    numbers.
    """
    found = np.inf
    for shape in product(*grids):
        form = law(*shape)
        rest = truth - form * (form @ truth) / (form @ form)
        found = min(found, float(np.sqrt(np.mean(rest**2))))
    return found / np.sqrt(np.mean(truth**2))


def test_two_terms_of_creep_stand_for_three_and_one_does_not():
    t, u = (column[::6] for column in protocol())
    u = u[:, :1]
    chain = _core.Chain(["creep"], 1)

    def slow(tau, spread):
        return (chain.rollout([[1.0, tau, spread]], u, t)[0] - u)[:, 0]

    for weights, taus in (
        ((1, 1, 1), (1, 10, 100)),
        ((4, 2, 1), (1, 8, 60)),
        ((1, 2, 4), (1, 8, 60)),
    ):
        truth = sum(w * slow(tau, 1.0) for w, tau in zip(weights, taus))
        one, two = (
            best(slow, truth, np.geomspace(1, 100, 25), spread)
            for spread in ([1.0], np.geomspace(1, 10, 12))
        )
        assert two < 0.09 and one > 0.1, (weights, one, two)


def test_the_shape_of_hysteresis_follows_other_laws():
    """Thresholds of other densities than the library's; growing, falling and minor loops."""
    turns = [0, 4, -4, 10, -10, 12, 6, 9, 3, 0]
    u = np.interp(np.arange(0.0, 9.0, 0.01), np.arange(10.0), turns)[:, None]
    t = np.arange(len(u), dtype=float)
    chain = _core.Chain(["hysteresis"], 1)

    def held(reach, shape):
        return (u - chain.rollout([[1.0, reach, shape]], u, t)[0])[:, 0]

    def stop(r):
        return u[:, 0] - slot(u[:, 0], r)

    densities = {
        "exponential": sum(np.exp(-r / 2) * stop(r) for r in np.linspace(0.1, 12, 40)),
        "1/r": sum(stop(r) for r in np.geomspace(0.05, 12, 40)),
    }
    for name, truth in densities.items():
        reaches = np.geomspace(1.0, 10.0, 16)
        even, free = (
            best(held, truth, reaches, shapes) for shapes in ([1.0], np.geomspace(0.4, 4.0, 12))
        )
        assert free < 0.09 and free < 0.75 * even, (name, even, free)
