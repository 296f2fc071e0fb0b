"""Effects on an elastic rod: its fields are those of its numbers, laws of its tendons are found and
fitted again.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from learned_tendon_arm import learned_from_rough, seen_exactly
from tendon_arm import arm, recorded

from softmap_edge import Diagnosis, _core, builtin_model, diagnose, learn_model, load_bundle, refit
from softmap_edge import save_bundle as save
from softmap_edge.cli import main
from softmap_edge.errors import SoftmapError
from softmap_edge.model.elastic_rod import ROUTING, ElasticRodArrays, RodLayout
from softmap_edge.model.model import Model
from softmap_edge.model.structure import Structure
from softmap_edge.rod.learn import learned_model
from softmap_edge.run.run import Run

run = pytest.fixture(scope="module")(seen_exactly)
learned = pytest.fixture(scope="module")(learned_from_rough)


@pytest.mark.parametrize("slack", [0.0, 0.4, 1.0])
def test_fields_of_a_changed_body_are_those_of_a_rod_with_other_numbers(slack):
    """As central differences of the rod itself: in stiffness, curvature at rest and the sides of
    its tendons.
    """
    robot = arm().with_slack(slack)
    places, lengths = robot.layout.places(), np.array([70.0, 50.0])
    fields = ElasticRodArrays(robot.layout, robot.start, 1.0).fields()
    u = np.random.default_rng(5).uniform(-6, 6, (20, 6))

    def changed(kind, by):
        numbers = robot.start.copy()
        numbers[places[kind]] += by
        return robot.layout.compiled(numbers).evaluate(u)

    s = (np.arange(12000) + 0.5) / 12000  # shares of the length; the first segment ends at 7/12
    total = np.zeros_like(changed("rest", 0.0))
    for k in range(7):
        hat = np.where(np.abs(6 * s - k) < 1, np.cos(0.5 * np.pi * (6 * s - k)) ** 2, 0.0)
        mean = np.array([hat[s < 7 / 12].mean(), hat[s > 7 / 12].mean()])
        by = 1e-5 * mean * robot.start[places["stiffness"]]
        got = fields[f"stiff_{k}"].evaluate(u)
        np.testing.assert_allclose(
            got, (changed("stiffness", by) - changed("stiffness", -by)) / 2e-5, atol=1e-4
        )
        total += got
    assert np.abs(total).max() > 1.0
    for axis in range(2):
        by = np.zeros((2, 2))
        by[:, axis] = 1e-5 * 2 * lengths / 120.0**2
        wanted = (changed("rest", by.ravel()) - changed("rest", -by.ravel())) / 2e-5
        np.testing.assert_allclose(fields[f"curve_{'xy'[axis]}"].evaluate(u), wanted, atol=1e-5)
    channel = np.array(robot.layout.channel)
    for command, name in enumerate(ROUTING):
        by = np.where(channel == command, np.radians(1e-3), 0.0)
        wanted = (changed("angle", by) - changed("angle", -by)) / 2e-3
        got = _core.ElasticField(robot.layout.compiled(robot.start), name, 1.0).evaluate(u)
        np.testing.assert_allclose(got, wanted, atol=1e-6)
        assert np.abs(got).max() > 0.05
    straight = robot.start.copy()
    straight[places["tilt"]] = straight[places["pretension"]] = 0.0
    moved = (
        ElasticRodArrays(robot.layout, straight, 1.0).fields()["curve_x"].evaluate(np.zeros((1, 6)))
    )
    np.testing.assert_allclose(moved[0, -3:], [1.0, 0.0, 0.0], atol=1e-9)
    one = _core.ElasticRod(
        1, 1, [0], [0], [1.0], [1.0], np.array([0, 0, 5, 0, 8, 50, *np.zeros(7)], float)
    )
    with pytest.raises(
        SoftmapError,
        match="routing_1 turns the tendons of a command that the rod has not: it has 1",
    ):
        _core.ElasticField(one, "routing_1", 1.0)
    with pytest.raises(SoftmapError, match="twist"):
        _core.ElasticField(robot.layout.compiled(robot.start), "twist", 1.0)


def test_tendons_that_run_at_other_places_are_found_on_a_rod():
    """Two pairs of cables, one of them turned by 8 degrees; a rod of more than three commands has
    no such fields.
    """
    numbers = [
        [0.0],
        0.5 * np.pi * np.arange(4),
        [6.0] * 4,
        [0.5] * 4,
        [30.0] * 2,
        [55.0] * 2,
        np.zeros(9),
    ]
    layout = RodLayout(2, 2, (1,) * 4, (0, 1, 0, 1), (1.0, 1.0, -1.0, -1.0), (0.5, 1.0, 1.5, 2.0))
    rod = ElasticRodArrays(layout, np.concatenate(numbers), 1.0)
    aside = rod.numbers.copy()
    aside[[1, 3]] += np.radians(8.0)
    model = Model(
        structure=Structure(
            prior=rod.compiled(),
            fields=dict(rod.fields()),
            rest=rod.compiled().evaluate(np.zeros((1, 2))).reshape(4, 3),
            triangles=np.zeros((0, 3), np.int32),
            tip_indices=np.array([3]),
            gravity_reference=np.array([0.0, 0.0, 1.0]),
            command_range=np.array([[-5.0, 5.0]] * 2),
            stiffness_known=False,
        ),
        kind="rod",
        form_error=np.full((4, 3), 0.05),
        vertex_error_mm=0.1,
        robot="two pairs",
        made_from={},
    )
    t = np.arange(0.0, 60.0, 0.2)
    u = 5.0 * np.stack([np.sin(0.4 * t), np.sin(0.7 * t)], axis=1)
    points = layout.compiled(aside).evaluate(u).reshape(len(t), 4, 3)
    seen = points + 0.1 * np.random.default_rng(2).normal(size=points.shape)
    run = Run(t=t, command=u, t_seen=t, markers=seen)
    found = diagnose(model, run, effects=["routing", "offset", "gain", "backlash"])
    assert [effect.name for effect in found.effects] == ["routing"], found.sentence
    phase = [found.effects[0].params[f"routing.phase[{c}]"].value for c in range(2)]
    assert phase == pytest.approx([8.0, 0.0], abs=0.8)  # linear in the angle
    assert found.error.after < 0.3 * found.error.before
    assert not set(ROUTING) & set(ElasticRodArrays(arm().layout, arm().start, 1.0).fields())


def test_a_gradient_of_stiffness_is_found_on_a_rod_that_was_taken_for_even():
    """Fields answer linearly: of 2.1 mm 0.66 are left, over half of that noise."""
    known = {
        'stiffness = "each"': "",
        'length = "each"': "",
        'angle = "each"': "",
        'radius = "shared"': "",
    }
    even = arm(
        **known
        | {
            "stiffness_mm2 = [8, 5]": "stiffness_mm2 = 7",
            "markers = [1, 1.5, 2]": "markers = [0.5, 1, 1.5, 2]",
        }
    )
    graded = replace(even, start=even.start.copy())
    graded.start[even.layout.places()["stiffness"]] = 7.0 * np.exp([-0.35, 0.35])
    seen = recorded(graded, seconds=60.0, rate=5.0, noise=0.2)
    found = diagnose(
        learn_model(seen, robot=even),
        seen,
        effects=["stiffness_gradient", "offset", "payload", "backlash"],
    )
    assert [effect.name for effect in found.effects] == ["stiffness_gradient"], found.sentence
    assert found.error.after < 0.4 * found.error.before


@pytest.fixture(scope="module")
def taken_for_rods():
    """A run of cables, seen within 0.3 mm, and the model of somebody who took them for rods that
    push.
    """
    worn = recorded(arm(), seconds=60.0, rate=5.0, noise=0.3)
    return worn, learn_model(worn, robot=arm().with_slack(1.0))


LAWS = ["gain", "backlash", "friction", "slack", "dead_zone", "payload", "mount"]


def test_cables_taken_for_rods_are_named_and_the_rod_is_fitted_again(
    taken_for_rods, tmp_path, capsys
):
    worn, model = taken_for_rods
    before = float(np.sqrt(np.mean(np.sum((model.predict(worn) - worn.markers) ** 2, axis=-1))))
    found = diagnose(model, worn, effects=LAWS)
    assert [effect.name for effect in found.effects] == [
        "slack"
    ] and found.verdict == "identified", found.sentence
    entry = found.effects[0]
    assert (
        entry.params["slack.ratio"].value < 0.02 and "slack.stiffness[0]" in entry.refitted.params
    )
    assert found.error.after < 0.1 * before
    numbers, truth = found.model.arrays.prior.shape.numbers, arm()
    for kind in ("angle", "radius", "stiffness", "length"):
        place = truth.layout.places()[kind]
        np.testing.assert_allclose(
            numbers[place], truth.start[place], rtol=0.05, atol=0.05, err_msg=kind
        )
    # The same through files: the rod's numbers, and what it errs by, come along.
    save(model, tmp_path / "rods")
    (tmp_path / "d.json").write_text(json.dumps(found.to_dict()))
    where = ["--bundle", str(tmp_path / "rods"), "--out", str(tmp_path / "cables")]
    assert main(["add", "slack", "--from", str(tmp_path / "d.json"), *where]) == 0
    capsys.readouterr()
    added = load_bundle(tmp_path / "cables")
    assert added.chain_names == ("slack",) and added.vertex_error_mm < 0.1 * model.vertex_error_mm
    np.testing.assert_allclose(added.predict(worn), found.model.predict(worn), atol=1e-9)
    np.testing.assert_allclose(added.form_error, found.model.form_error, rtol=1e-6)
    again, reported = refit(added, worn)
    assert reported.after_held_out_rms_mm < 1.1 * reported.before_rms_mm and again.chain_names == (
        "slack",
    )
    # Removed, also from a bundle and after a refit, the rod is what it was before, and says so.
    save(again, tmp_path / "again")
    assert (
        main(
            [
                "model",
                "remove",
                "slack",
                "--bundle",
                str(tmp_path / "again"),
                "--out",
                str(tmp_path / "less"),
            ]
        )
        == 0
    )
    assert "again those before the effect was added" in capsys.readouterr().out
    before, less = load_bundle(tmp_path / "rods"), load_bundle(tmp_path / "less")
    np.testing.assert_array_equal(
        less.arrays.prior.shape.numbers, before.arrays.prior.shape.numbers
    )
    np.testing.assert_array_equal(less.predict(worn), before.predict(worn))
    np.testing.assert_allclose(less.form_error, before.form_error)
    assert less.vertex_error_mm == pytest.approx(before.vertex_error_mm)
    old = replace(again, arrays=kept_with(again, None))
    save(old, tmp_path / "old")  # of before bundles kept them
    assert (
        main(
            [
                "model",
                "remove",
                "slack",
                "--bundle",
                str(tmp_path / "old"),
                "--out",
                str(tmp_path / "kept"),
            ]
        )
        == 0
    )
    assert "stay as they were fitted with the effect" in capsys.readouterr().out
    spoilt = replace(again.arrays.prior.before, numbers=np.zeros(3))
    with pytest.raises(SoftmapError, match="numbers of before"):
        replace(again, arrays=kept_with(again, spoilt)).with_effects((), {})
    assert np.abs(again.predict(worn) - added.predict(worn)).max() < 0.5


def kept_with(model, before):
    """The arrays of a rod, with other numbers of before an effect changed its law."""
    return replace(model.arrays, prior=replace(model.arrays.prior, before=before))


def test_rods_that_push_are_not_called_slack():
    pushed = recorded(arm().with_slack(1.0), seconds=60.0, rate=5.0, noise=0.3)
    found = diagnose(learn_model(pushed, robot=arm().with_slack(1.0)), pushed, effects=LAWS)
    assert found.verdict == "nothing" and not found.effects, found.sentence


def test_a_law_that_the_model_does_not_have_is_a_question_only_if_asked(
    run, learned, taken_for_rods
):
    cables = learned_model(run, learned)
    assert cables.missing_for("slack") == ["slack"] and taken_for_rods[1].missing_for("slack") == []
    assert builtin_model().missing_for("slack") == ["slack"]
    named = [item.name for item in diagnose(cables, run, effects=["slack", "lag"]).not_testable]
    assert "slack" in named
    with pytest.raises(SoftmapError, match="'slack' of the prior"):
        cables.with_effects(["slack"], {"slack.ratio": 0.5}).predict(run)


def test_changes_of_another_rod_are_refused(taken_for_rods):
    worn, model = taken_for_rods
    with pytest.raises(SoftmapError, match="stiffness"):
        model.changed({"slack.elbow": 1.0})
    with pytest.raises(SoftmapError):
        model.with_effects(["slack"], {"slack.ratio": 0.5, "slack.stiffness[0]": -1.0})
    found = diagnose(model, worn, effects=["slack"]).to_dict()
    assert "14 numbers of the model itself" in str(Diagnosis.from_dict(found))
    wrong = "not of this model"
    for error, match in (
        ([1.0], wrong),
        ([-1.0] * 9, wrong),
        (None, "error_mm is NoneType"),
        ("much", "error_mm is str"),
    ):
        found["effects"][0]["refitted"]["error_mm"] = error
        with pytest.raises(SoftmapError, match=match):
            Diagnosis.from_dict(found).added(model, ["slack"])
    found["effects"][0]["refitted"]["params"] = {"slack.radius": 3}
    with pytest.raises(SoftmapError, match="damaged diagnosis"):
        Diagnosis.from_dict(found)
    arrays = model.arrays.prior.to_npz()
    for damaged in (arrays["free"][:-1], arrays["free"] * 0 + 999, arrays["free"] + 0.5):
        with pytest.raises(SoftmapError, match="'free'"):
            ElasticRodArrays.from_npz({**arrays, "free": damaged})
