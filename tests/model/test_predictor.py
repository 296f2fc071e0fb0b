"""Chain, table and predictor: composition, interpolation, batches, and errors of wrong use."""

from functools import partial

import numpy as np
import pytest
from bodies import (
    CAMERAS,
    FIELD_VALUES,
    HOME,
    TENSION_VALUES,
    finger,
    finger_body,
    lost,
    record,
    rod_body,
    stopped,
    tabulated,
    turning,
    warming,
)
from laws import BY_ROLE, EFFECTS, ORACLES, REMEMBERED, named, values

from softmap_edge import _core
from softmap_edge.errors import CoreError


@pytest.fixture(scope="module")
def body():
    return finger_body()


def test_all_together_agree_with_the_oracles_in_stage_order(body):
    # a finger has no such numbers
    every = [name for name in EFFECTS if name not in BY_ROLE["prior"]]
    chain = _core.Chain(list(reversed(every)), 2)
    assert chain.names == every
    t, u = record(2)
    gravity, load = turning(len(t)), np.linspace(0.0, 5.0, len(t))
    seen = np.linspace(t[0], t[-1], 61) + 0.004
    for params in (values(chain, "middle"), values(chain, "start")):
        got = body.predict(
            chain, params[None], _core.Inputs(u, t, seen, gravity, load, warming(t), CAMERAS)
        )[0]
        own, at = {}, 0
        for name in chain.names:
            width = len(_core.Chain([name], 2).labels)
            own[name] = named(name, params[at : at + width], 2)
            at += width
        x = u
        for name in BY_ROLE["channel"]:
            x = ORACLES[name](own[name], x, t)

        def see(moments, x=x, own=own):
            def seen_of(rows):
                return np.stack([np.interp(moments, t, column) for column in rows.T], axis=1)

            seen_gravity, acting = seen_of(gravity), seen_of(x)
            kept = {
                name: [seen_of(remembers(own[name], x))] for name, remembers in REMEMBERED.items()
            }
            shapes = BY_ROLE["shape"]
            coefficients = sum(
                ORACLES[name](own[name], seen_gravity, acting, *kept.get(name, []))
                for name in shapes
            )
            coefficients[:, :3] += seen_gravity - HOME
            coefficients[:, 3:6] += 9.80665e-3 * np.interp(moments, t, load)[:, None] * seen_gravity
            frames = tabulated(finger).evaluate(acting)
            for name, values_of in FIELD_VALUES.items():
                f = _core.FIELDS.index(name)
                frames = frames + coefficients[:, f : f + 1] * tabulated(values_of).evaluate(acting)
            for change, values_of in zip(
                lost(coefficients[0, len(_core.FIELDS)], acting).T, TENSION_VALUES
            ):
                frames = frames + change[:, None] * tabulated(values_of).evaluate(acting)
            frames = frames + stopped(coefficients[0, -8:], frames, acting)
            return frames.reshape(-1, 9, 3)

        for name in BY_ROLE["sensing"]:
            see = partial(ORACLES[name], own[name], see, np.ones(9, bool))
        np.testing.assert_allclose(got, see(seen), rtol=0, atol=1e-8)


def test_a_changed_number_makes_another_prior_loads_and_slopes_included():
    """Alone and in batches that share shapes, as against a rod that was made with the number."""
    (t, u), seen = record(2, samples=200), np.linspace(1.0, 6.0, 40)
    world = turning(len(t)), np.linspace(0.0, 5.0, len(t))
    effects = ["slack", "gain", "payload", "mount"]
    chain, rest = _core.Chain(effects, 2), _core.Chain(effects[1:], 2)
    assert (
        chain.names == ["gain", "slack", "payload", "mount"]
        and chain.numbers == ["slack"]
        and rest.numbers == []
    )
    base = values(chain, "middle")
    sets = np.tile(base, (6, 1))
    sets[:, chain.labels.index("slack.ratio")] = [0.0, 0.25, 0.25, 1.0, 0.0, 0.25]
    sets[2:4, chain.labels.index("mount.turn_x")] += 1.0
    got = rod_body().predict(chain, sets, _core.Inputs(u, t, seen, *world))
    at = chain.labels.index("slack.ratio")
    without, step = np.delete(np.arange(len(base)), at), np.array([0.3, 0.3])
    for params, frames in zip(sets, got):
        made = rod_body(params[at])
        wanted = made.predict(rest, params[None, without], _core.Inputs(u, t, seen, *world))[0]
        np.testing.assert_allclose(frames, wanted, rtol=0, atol=1e-9)
        slopes = rod_body().slopes(chain, params[None], _core.Inputs(u, t, seen, *world), step)
        wanted = made.slopes(rest, params[None, without], _core.Inputs(u, t, seen, *world), step)
        np.testing.assert_allclose(slopes, wanted, rtol=0, atol=1e-9)
    # multiplied, not set: half of a half
    halved = np.where(np.arange(len(base)) == at, 0.5, sets[1])
    np.testing.assert_allclose(
        rod_body(0.5).predict(chain, halved[None], _core.Inputs(u, t, seen, *world))[0],
        got[1],
        atol=1e-9,
    )
    assert np.abs(got[0] - got[1]).max() > 0.5 and np.abs(got[1] - got[3]).max() > 0.5


def test_labels_units_and_scales():
    chain = _core.Chain(["backlash", "gain"], 2)
    assert chain.labels == [
        "gain.factor[0]",
        "gain.factor[1]",
        "backlash.gap[0]",
        "backlash.gap[1]",
    ]
    assert chain.group_labels == [
        "gain.factor[0]",
        "gain.factor[1]",
        "backlash.gap",
        "backlash.gap",
    ]
    assert chain.units == ["1", "1", "mm", "mm"]
    assert list(chain.null) == [1.0, 1.0, 0.0, 0.0] and list(chain.log) == [True] * 4


def test_a_batch_equals_its_members_whatever_they_share(body):
    chain = _core.Chain(["backlash", "payload", "mount"], 2)
    t, u = record(2, samples=200)
    sets = np.tile(values(chain, "start"), (12, 1))
    count = len(chain.labels)
    sets[1 : 1 + count] += 0.1 * np.eye(count)
    sets[1 + count, 0] = 1.0
    batch = body.predict(chain, sets, _core.Inputs(u, t, t[::3], turning(200)))
    for params, frames in zip(sets, batch):
        np.testing.assert_array_equal(
            body.predict(chain, params[None], _core.Inputs(u, t, t[::3], turning(200)))[0], frames
        )


# loads that recur this often in a set have a body of their own, or not
@pytest.mark.parametrize("frames", [20, 40])
def test_a_batch_equals_its_members_where_loads_recur(body, frames):
    chain = _core.Chain(["backlash", "payload", "stiff_section", "mount"], 2)
    t, u = record(2, samples=frames)
    leaning = np.tile([0.5, -0.3, 0.81], (frames, 1))
    sets = np.tile(values(chain, "start"), (12, 1))
    sets[1:9] += 0.1 * np.eye(sets.shape[1])[:8]
    batch = body.predict(chain, sets, _core.Inputs(u, t, t, leaning))
    for params, one in zip(sets, batch):
        np.testing.assert_array_equal(
            body.predict(chain, params[None], _core.Inputs(u, t, t, leaning))[0], one
        )
    # Loads that never recur are answered in full: the same within round-off and the 1e-9 g by which
    # they differ.
    shaken = leaning + 1e-9 * np.random.default_rng(0).normal(size=leaning.shape)
    np.testing.assert_allclose(
        body.predict(chain, sets, _core.Inputs(u, t, t, shaken)), batch, rtol=0, atol=1e-6
    )


def test_linear_forms_come_at_once_as_they_are_formed_of_frames_and_nothing_senses_them(body):
    chain = _core.Chain(["backlash", "payload", "stiff_section"], 2)
    t, u = record(2, samples=80)
    weights = np.random.default_rng(0).normal(size=(3 * 9, 6))
    sets = np.stack([values(chain, "start"), values(chain, "middle")])
    for gravity in (turning(80), np.tile([0.5, -0.3, 0.81], (80, 1))):
        frames = body.predict(chain, sets, _core.Inputs(u, t, t, gravity)).reshape(2, 80, -1)
        forms = (
            body.through(weights)
            .predict(chain, sets, _core.Inputs(u, t, t, gravity))
            .reshape(2, 80, -1)
        )
        np.testing.assert_allclose(forms, frames @ weights, rtol=0, atol=1e-9)
    senses = _core.Chain(["mount"], 2)
    with pytest.raises(CoreError, match="changes what is seen"):
        body.through(weights).predict(senses, values(senses, "start")[None], _core.Inputs(u, t, t))
    with pytest.raises(CoreError, match="multiple of 3"):
        body.through(weights[:, :5])
    rod = rod_body()
    assert (
        rod.through(
            np.ones(
                (
                    3
                    * rod.predict(
                        _core.Chain([], 2), np.zeros((1, 0)), _core.Inputs(u, t, t)
                    ).shape[2],
                    3,
                )
            )
        )
        is None
    )


def test_the_table_meets_its_nodes_and_its_slopes():
    table = tabulated(finger)
    axis = np.linspace(-20.0, 20.0, 21)
    nodes = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=2).reshape(-1, 2)
    np.testing.assert_allclose(table.evaluate(nodes), finger(nodes), rtol=0, atol=1e-7)
    rng = np.random.default_rng(2)
    u = rng.uniform(-25.0, 25.0, (50, 2))  # outside too
    slopes = table.jacobian(u)
    for c in range(2):
        step = 1e-5 * np.eye(2)[c]
        difference = (table.evaluate(u + step) - table.evaluate(u - step)) / 2e-5
        np.testing.assert_allclose(slopes[:, :, c], difference, rtol=0, atol=1e-5)
    between = rng.uniform(2.0, 18.0, (200, 2))
    # Cubic interpolation of a bend of 10 degrees a cell: h³ f''' / 40 ≈ 0.06 mm at worst.
    assert np.abs(table.evaluate(between) - finger(between)).max() < 0.06


def test_a_projected_table_sees_through_the_map():
    rng = np.random.default_rng(0)
    table, weights, offset = tabulated(finger), rng.normal(size=(27, 6)), rng.normal(size=6)
    u = rng.uniform(-22.0, 22.0, (30, 2))
    seen = table.project(weights, offset)
    assert (seen.channels, seen.size) == (2, 6)
    np.testing.assert_allclose(
        seen.evaluate(u), table.evaluate(u) @ weights + offset, rtol=0, atol=1e-9
    )
    copy = _core.Table(seen.axes, seen.coefficients, seen.mean, seen.modes)
    np.testing.assert_array_equal(copy.evaluate(u), seen.evaluate(u))


def test_a_robot_without_commands_has_one_shape():
    table = _core.Table([], [[2.0]], [1.0, 0.0, 5.0], [[3.0, 0.0, 0.0]])
    np.testing.assert_array_equal(
        table.evaluate(np.zeros((4, 0))), np.tile([7.0, 0.0, 5.0], (4, 1))
    )
    chain = _core.Chain(["mount"], 0)
    body = _core.Predictor(table, {}, np.ones(1, bool), HOME)
    params = chain.null + np.array([0, 0, 90.0, 0, 0, 1.0])
    seen = body.predict(
        chain, params[None], _core.Inputs(np.zeros((0, 0)), np.zeros(0), np.arange(3.0))
    )
    np.testing.assert_allclose(seen, np.tile([0.0, 7.0, 6.0], (1, 3, 1, 1)), rtol=0, atol=1e-12)


def wrong_calls():
    chain, none = _core.Chain(["lag", "payload"], 2), _core.Chain([], 2)
    t, u = np.linspace(0, 1, 5), np.zeros((5, 2))
    bad = u.copy()
    bad[3, 1] = np.nan
    p, late = chain.null[None], _core.Chain(["latency"], 2)
    table = tabulated(finger)
    body = _core.Predictor(table, {}, np.ones(9, bool), HOME)
    still = chain.init(chain.null, u[0])
    later = chain.step(chain.null, still, u[0], 0.0, 9.0)[1][None]
    axis = np.arange(3.0)
    return {
        "an unknown effect": (lambda: _core.Chain(["gian"], 2), "backlash"),
        "too many channels": (lambda: _core.Chain(["lag"], 10**12), "256"),
        "an effect twice": (lambda: _core.Chain(["lag", "lag"], 2), "twice"),
        "nan in u": (lambda: chain.rollout(p, bad, t), "u holds NaN"),
        "nan in params": (lambda: chain.rollout(p * np.nan, u, t), "params holds NaN"),
        "wrong params": (lambda: chain.rollout(p[:, :1], u, t), "P = 3"),
        "flat params": (lambda: chain.rollout(p[0], u, t), "params"),
        "wrong channels": (lambda: chain.rollout(p, u[:, :1], t), "C = 2"),
        "short t": (lambda: chain.rollout(p, u, t[:3]), "T = 3"),
        "text for u": (lambda: chain.rollout(p, "abc", t), "u must be"),
        "falling t": (lambda: chain.rollout(p, u, t[::-1]), "backwards"),
        "wrong gravity": (lambda: chain.rollout(p, u, t, gravity=np.zeros((5, 2))), "gravity"),
        "wrong state": (lambda: chain.rollout(p, u, t, state=np.zeros((1, 3))), "state"),
        "a state from later": (lambda: chain.rollout(p, u, t, state=later), "backwards"),
        "negative dt": (lambda: chain.step(chain.null, still, u[0], -1.0, 0.0), "dt"),
        "a delay beyond the ring": (lambda: late.rollout([[3.0]], u, t), "latency.delay"),
        "a field that is missing": (
            lambda: body.predict(chain, [[0.1, 5.0]], _core.Inputs(u, t, t)),
            "tip_force",
        ),
        "another robot's chain": (
            lambda: body.predict(
                _core.Chain([], 3), none.null[None], _core.Inputs(np.zeros((5, 3)), t, t)
            ),
            "channels",
        ),
        "an unknown field": (
            lambda: _core.Predictor(table, {"wind": table}, np.ones(9, bool), HOME),
            "gravity_x",
        ),
        "wrong positions": (lambda: _core.Predictor(table, {}, np.ones(8, bool), HOME), "27"),
        "a falling axis": (lambda: _core.Table([-axis], np.zeros((3, 1)), [0.0], [[1.0]]), "rise"),
        "missing nodes": (
            lambda: _core.Table([axis], np.zeros((2, 1)), [0.0], [[1.0]]),
            "3 grid nodes",
        ),
        "nan in a table": (
            lambda: _core.Table([axis], np.full((3, 1), np.nan), [0.0], [[1.0]]),
            "NaN",
        ),
        "a projection of another size": (
            lambda: table.project(np.zeros((5, 2)), np.zeros(2)),
            "M = 27",
        ),
    }


@pytest.mark.parametrize("case", wrong_calls())
def test_wrong_use_is_reported_in_one_line(case):
    call, clue = wrong_calls()[case]
    with pytest.raises(_core.CoreError) as error:
        call()
    message = str(error.value)
    assert clue in message and "\n" not in message and len(message) > 20
