"""Diagnosis: what is hidden is named, silence and doubt are answers, documents survive a round
trip.

The arm of `arm.py` carries the statistics, the built-in finger what a run can do to a diagnosis;
hidden effects of other forms on the simulated finger are tested in other files.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from arm import NAMES, arm, protocol, record_run
from finger_runs import SOUND, finger_run, named

from softmap_edge import _core
from softmap_edge.comparison.comparison import compare
from softmap_edge.diagnosis import decision
from softmap_edge.diagnosis.diagnose import diagnose
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.diagnosis.refit import refit
from softmap_edge.diagnosis.text import diagnosis_text
from softmap_edge.errors import SoftmapError
from softmap_edge.model.bundle import builtin_model
from softmap_edge.run.run import Run

HIDDEN = {
    "offset": {"offset.shift[0]": 0.9, "offset.shift[1]": -0.9},
    "gain": {"gain.factor[0]": 1.1, "gain.factor[1]": 1.08},
    "latency": {"latency.delay": 0.2},
    "backlash": {"backlash.gap": 1.2},
    "creep": {"creep.strength": 0.2, "creep.tau": 15.0},
    "payload": {"payload.mass": 60.0},
    "mount": {"mount.shift_x": 1.2, "mount.turn_y": 1.15},
}


def diagnosed(hidden, model=None, **settings):
    return diagnose(model or arm(), record_run(hidden, **settings), effects=NAMES)


@pytest.mark.parametrize("name", HIDDEN)
def test_single_effect_is_named_and_the_error_falls(name):
    found = diagnosed(HIDDEN[name], seed=5)
    assert named(found) == {name}
    assert found.verdict == ("measurement_fault" if name == "mount" else found.verdict)
    assert found.verdict in ("identified", "ambiguous", "measurement_fault")
    entry = [*found.effects, *found.faults][0]
    for label, value in HIDDEN[name].items():
        fitted = entry.params[label]
        assert abs(fitted.value - value) < max(4 * fitted.sigma, 0.05 * abs(value))
    error = found.error
    assert error.after < 0.75 * error.before and error.after < 1.6 * error.floor


@pytest.mark.parametrize("seed", range(4))
def test_nothing_hidden_nothing_claimed(seed):
    found = diagnosed({}, seed=seed)
    assert found.verdict == "nothing" and not named(found)
    assert found.error.ladder == () and found.model.chain_names == ()


def test_pair_and_triple_are_found_completely():
    pair = HIDDEN["backlash"] | HIDDEN["creep"]
    found = diagnosed(pair, seed=7)
    assert named(found) == {"backlash", "creep"}
    assert found.effects[0].name == "backlash"  # the more important one first
    values = [found.error.before] + [step.value for step in found.error.ladder]
    assert all(after < before for before, after in zip(values, values[1:]))
    assert named(diagnosed(pair | HIDDEN["payload"], seed=7)) == {"backlash", "creep", "payload"}


def test_form_error_is_not_physics(monkeypatch):
    """A static error three times larger than what the model declares must not become an effect with
    a memory.
    """
    for seed in range(2):
        found = diagnosed({}, seed=seed, warp=0.3)
        assert not named(found) & {"latency", "backlash", "creep"}
    # For a model with zero model error, on a robot without imperfections, the same error is a
    # discovery.
    monkeypatch.setattr(decision, "ORDINARY", 0.0)
    assert any(diagnosed({}, arm(form=1e-3), seed=seed, warp=0.3).families for seed in range(2))


def test_static_grid_cannot_identify_memory():
    t = np.arange(0, 600, 0.1)
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-8, 8, size=(60, 2)), 100, axis=0)
    seen = np.arange(60) * 10.0 + 9.5  # long after each move
    found = diagnosed({}, t=t, u=u, moving=seen, noise=0.05)
    hidden = {h.name: h for h in found.not_testable}
    assert "latency" in hidden and "offset" not in hidden
    assert "triangle" in hidden["latency"].experiment
    assert any(block.settles == ("latency",) for block in found.next)
    moving = diagnosed({}, seed=1, noise=0.05)
    assert not moving.not_testable  # the standard protocol shows them all


def test_small_effects_are_below_the_floor():
    assert not named(diagnosed({"latency.delay": 0.01}, noise=0.3, seed=2))


def test_unknown_effect_is_flagged():
    """Without its true effect among the candidates the leftover is claimed, not hidden behind
    another name.
    """
    run = record_run({"creep.strength": 0.45, "creep.tau": 40.0}, seed=4)
    found = diagnose(arm(), run, effects=["gain", "payload", "mount"])
    assert found.verdict == "partly_explained" and not named(found)
    assert [(f.name, f.law) for f in found.families] == [("creep", "unknown")]
    assert "unknown law of the family creep" in found.sentence


def test_independent_run_decides():
    hidden = HIDDEN["backlash"]
    run, other = record_run(hidden, seed=8), record_run(hidden, seed=8, other=True)
    found = diagnose(arm(), run, other, effects=NAMES)
    assert named(found) == {"backlash"}
    assert found.error.held_out_on == "an independent run"
    assert found.error.after < 0.6 * found.error.before
    assert found.effects[0].displacement_mm.held_out > 0.3
    clean = record_run({}, seed=8, other=True)  # another kind of run on which the play is gone
    demoted = diagnose(arm(), run, clean, effects=NAMES)
    assert not named(demoted) and "backlash" in demoted.made_from["demoted"]
    assert "backlash" in demoted.sentence


def test_own_effects_are_kept_and_never_added_twice():
    own = arm().with_effects(("latency",), {"latency.delay": 0.2})
    found = diagnosed(HIDDEN["latency"] | HIDDEN["backlash"], own, seed=9)
    assert named(found) == {"backlash"}
    assert set(found.model.chain_names) == {"latency", "backlash"}
    assert "latency" not in found.made_from["candidates"]


def test_refit_moves_the_parameters_of_the_model():
    own = arm().with_effects(("latency",), {"latency.delay": 0.05})
    model, report = refit(own, record_run(HIDDEN["latency"], seed=1))
    assert model.chain_params[0] == pytest.approx(0.2, abs=0.01)
    assert report.after_held_out_rms_mm < 0.7 * report.before_rms_mm
    with pytest.raises(SoftmapError, match="no effects"):
        refit(arm(), record_run({}))


def test_same_input_same_document_and_round_trip():
    first, second = (diagnosed(HIDDEN["backlash"], seed=3) for _ in range(2))
    text = json.dumps(first.to_dict(), allow_nan=False)
    assert text == json.dumps(second.to_dict())
    back = Diagnosis.from_dict(json.loads(text))
    assert back.to_dict() == first.to_dict() and back.model is None
    assert str(back) == str(first)
    assert str(first) == diagnosis_text(first.to_dict())  # one text for every caller
    assert (
        "Verdict: identified" in str(first)
        and "backlash.gap" in str(first)
        and "floor" in str(first)
    )
    assert list(first.to_dict())[0] == "schema"
    assert back.params_of("backlash")["backlash.gap"] == pytest.approx(1.2, rel=0.05)


@pytest.mark.parametrize(
    ("broken", "match"),
    [
        ([], "not a diagnosis"),
        ({"schema": "softmap.diagnosis/9"}, "softmap.diagnosis/2"),
        ({"schema": "softmap.diagnosis/2", "verdict": 3}, "verdict"),
        ({"schema": "softmap.diagnosis/2", "verdict": "certain"}, "unknown verdict 'certain'"),
    ],
)
def test_broken_documents_are_refused(broken, match):
    with pytest.raises(SoftmapError, match=match):
        Diagnosis.from_dict(broken)


@pytest.mark.parametrize(
    ("spoil", "match"),
    [
        (lambda entry: entry.pop("name"), "has no 'name'"),
        (lambda entry: entry.update(params=7), "params"),
        (lambda entry: entry["params"]["backlash.gap"].update(value="wide"), "backlash.gap"),
        (lambda entry: entry["params"]["backlash.gap"].update(value=float("nan")), "backlash.gap"),
        (lambda entry: entry["params"]["backlash.gap"].update(value=10**400), "backlash.gap"),
        (lambda entry: entry["params"]["backlash.gap"].update(value=1e308), "within"),
        (lambda entry: entry["params"]["backlash.gap"].update(value=99), "allowed 0.04 to 32"),
        (
            lambda entry: entry["params"]["backlash.gap"].update(value=-2.0),
            "backlash.gap is -2 in the diagnosis",
        ),
        (lambda entry: entry["params"].clear(), "has no backlash.gap"),
    ],
)
def test_broken_effects_never_reach_a_model(spoil, match, tmp_path):
    document = json.loads(json.dumps(SOUND))
    Diagnosis.from_dict(document)
    spoil(document["effects"][0])
    (tmp_path / "d.json").write_text(json.dumps(document))
    with pytest.raises(SoftmapError, match=match):
        Diagnosis.load(tmp_path / "d.json").added(builtin_model(), ["backlash"])
    document["effects"].append(document["effects"][0])
    (tmp_path / "d.json").write_text(json.dumps(document))
    with pytest.raises(SoftmapError, match="damaged|twice"):
        Diagnosis.load(tmp_path / "d.json")
    (tmp_path / "d.json").write_text("{" + 5000 * "9")
    with pytest.raises(SoftmapError, match="not JSON"):
        Diagnosis.load(tmp_path / "d.json")


def test_wrong_use_is_an_error():
    with pytest.raises(SoftmapError, match="no effect 'nonsense'"):
        diagnose(arm(), record_run({}), effects=["nonsense"])
    with pytest.raises(SoftmapError, match="too few"):
        diagnose(arm(), record_run({}, frames=5), effects=NAMES)
    with pytest.raises(SoftmapError, match="does not name"):
        diagnosed({}).params_of("backlash")


def test_rod_frames_count_by_their_correlation():
    """On a rod the error of the form is large and slow: a small true effect is not claimed on
    it.
    """
    rod = arm(form=0.6, kind="rod")
    t, u = protocol()
    assert named(
        diagnosed(HIDDEN["backlash"] | {"backlash.gap": 2.5}, rod, t=t, u=u, frames=1000)
    ) == {"backlash"}
    assert not named(diagnosed({}, rod, t=t, u=u, frames=1000))


# --- what a run can do to a diagnosis, on the built-in finger ------------------------------------


LAWS = {
    "saturation": lambda u: np.clip(u, -8.0, 8.0),
    "dead_zone": lambda u: np.sign(u) * np.maximum(np.abs(u) - 1.0, 0.0),
    # 1.5 turns in the range
    "eccentric_pulley": lambda u: u + 0.8 * (np.sin(u / 2.5 + 0.3) - np.sin(0.3)),
}


@pytest.mark.long
@pytest.mark.parametrize("name", LAWS)
def test_what_no_effect_explains_is_no_effect(name):
    """A static law is named if the library has it; without it no replacement is identified."""
    run = finger_run(acting=LAWS[name])
    whole = diagnose(builtin_model(), run)
    assert whole.verdict == "identified" and named(whole) == {name}
    rest = [e["name"] for e in _core.effects() if e["name"] != name]
    found = diagnose(builtin_model(), run, effects=rest)
    assert found.verdict in ("ambiguous", "partly_explained")
    assert found.families[0].name == "static map" and found.families[0].law != "identified"
    assert all(e.probability < 0.5 for e in found.effects)
    values = [found.error.before] + [step.value for step in found.error.ladder]
    assert values[-1] == min(values)


def test_what_looks_alike_is_an_alternative_where_it_can_do_it():
    """Cables that stretch shorten all that is pulled: one factor below 1, and never one above
    it.
    """
    runs = [finger_run(acting=lambda u, f=f: u * f) for f in ([0.85, 0.85], [1.19, 0.81])]
    less, either = (diagnose(builtin_model(), run) for run in runs)
    assert named(less) == named(either) == {"gain"}
    assert [list(r.effects) for r in less.alternatives] == [
        ["tendon_stretch"]
    ] and less.verdict == "ambiguous"
    assert either.alternatives == () and either.verdict == "identified"


@pytest.mark.parametrize(
    ("acting", "case", "said"),
    [
        (lambda u: u[:, ::-1], 3, "channels 0 and 1 are exchanged"),
        (lambda u: u * [1.0, -1.0], 2, "channel 1 runs the wrong way"),
    ],
    ids=["swap", "sign"],
)
def test_wrong_wiring_is_named_before_any_physics(acting, case, said):
    """Swapped servos move the finger ten times as far off as the play behind them, and hide it
    not.
    """
    found = diagnose(builtin_model(), finger_run(acting=acting))
    assert found.verdict == "measurement_fault" and found.effects == ()
    assert found.faults[0].params["servo_swap.case"].value == case
    assert "measurement is at fault" in found.sentence and f"servo_swap: {said}" in found.sentence
    assert f"{case}: {said}" in str(found) and said in found.next[0].block
    behind = diagnose(
        builtin_model(), finger_run(["backlash"], {"backlash.gap": 1.0}, acting=acting)
    )
    assert [f.name for f in behind.faults] == ["servo_swap"] and [
        e.name for e in behind.effects
    ] == ["backlash"]
    assert behind.error.after < 0.1 * behind.error.ladder[0].value
    assert behind.effects[0].params["backlash.gap"].value == pytest.approx(1.0, abs=0.02)


def test_tiny_effect_is_no_larger_lie():
    found = diagnose(builtin_model(), finger_run(["offset"], {"offset.shift[0]": 0.1}))
    assert found.error.ladder == () or found.error.after < found.error.before


def test_large_error_is_not_nothing():
    run = finger_run()
    points = run.vertices.copy()
    points[50:60] += 30.0  # the camera lost the finger
    found = diagnose(builtin_model(), replace(run, vertices=points))
    assert found.verdict == "partly_explained" and not named(found)
    assert "the points jump by" in found.remarks[0] and found.error.before > 1.0


def test_finger_that_is_partly_seen():
    """Frames and parts that are never seen make no NaN, and no claim on what they would show."""
    model = builtin_model()
    run = finger_run(["backlash"], {"backlash.gap": 1.0})
    late, base = np.ones((2, *run.vertices.shape[:2]), bool)
    late[: run.frames // 2] = False
    base[:, model.rest[:, 2] > 8.0] = False
    found = diagnose(model, replace(run, visible=late))
    assert (
        named(found) == {"backlash"} and found.made_from["run"] == replace(run, visible=late).hash()
    )
    blind = diagnose(model, replace(run, visible=base))
    hidden = {row.name for row in blind.not_testable}
    physics = {e["name"] for e in _core.effects() if e["kind"] == "effect"}
    assert blind.verdict == "cannot_tell" and hidden >= physics & set(blind.made_from["candidates"])
    for document in (found, blind, compare(model, replace(run, visible=base))):
        assert str(document) and json.dumps(document.to_dict(), allow_nan=False)


def test_command_that_never_changes():
    model = builtin_model()
    t = np.arange(0.0, 60.0, 0.02)
    seen = np.arange(0.5, 59.0, 0.5)
    rest = np.broadcast_to(model.rest, (len(seen), *model.rest.shape))
    run = Run(t, np.tile([3.0, 2.0], (len(t), 1)), seen, vertices=rest, gravity=[0.0, 0.0, 1.0])
    points = model.predict(run) + 0.25 * np.random.default_rng(0).normal(size=rest.shape)
    assert diagnose(model, replace(run, vertices=points)).verdict == "cannot_tell"


def test_what_a_model_has_already_may_be_wrong_in_its_numbers():
    """An alternative that repairs a wrong number is not reported without the number."""
    run = finger_run(["backlash"], {"backlash.gap": 1.5})
    wrong, right = (
        builtin_model().with_effects(["backlash"], {"backlash.gap": gap}) for gap in (1.0, 1.5)
    )
    found = diagnose(wrong, run)
    assert found.verdict == "ambiguous" and list(found.alternatives[0].effects) == ["backlash"]
    assert (
        "`softmap model refit` alone takes" in found.sentence
        and "softmap model refit" in found.next[0].block
    )
    found = diagnose(right, run)
    assert found.verdict == "nothing" and "refit" not in found.sentence


def test_a_few_frames_identify_a_large_gain():
    run = finger_run(["gain"], {"gain.factor[0]": 1.15, "gain.factor[1]": 1.1})
    few = run.at(np.sort(np.random.default_rng(0).choice(run.frames, 12, replace=False)))
    found = diagnose(builtin_model(), few)
    assert [entry.name for entry in found.effects] == ["gain"]
    assert found.effects[0].params["gain.factor[0]"].value == pytest.approx(1.15, 0.03)


def test_a_name_with_two_alternatives_is_less_likely_than_not_and_not_identified():
    """On one slow sine a delay, a shifted clock and a lag look alike."""
    model, t = builtin_model(), np.arange(0, 180, 0.1)
    u = np.stack([8.0 * np.sin(2.0 * np.pi * t / 40.0), 0.0 * t], axis=1)
    rest = np.broadcast_to(model.rest, (len(t[5::6]), *model.rest.shape))
    run = Run(t, u, t[5::6], vertices=rest, gravity=np.array([0.0, 0.0, 1.0]), robot=model.robot)
    points = model.with_effects(["latency"], {"latency.delay": 0.4}).predict(run)
    run = replace(run, vertices=points + 0.25 * np.random.default_rng(0).normal(size=points.shape))
    found = diagnose(model, run)
    assert found.verdict == "ambiguous" and [entry.name for entry in found.effects] == ["latency"]
    assert sorted(a.effects for a in found.alternatives) == [("clock_shift",), ("lag",)]
    assert found.effects[0].probability < 0.5


def test_a_load_that_does_little_stays_an_alternative_in_one_orientation_with_its_size():
    """Forms of loads are off too far to rule one out by its fit; how much it does stands next to
    it.
    """
    run = finger_run(["gravity"], {"gravity.density": 0.5, "gravity.tilt_x": 40.0})
    upright = run.gravity[np.searchsorted(run.t, run.t_seen)][:, 2] > 0.99
    found = diagnose(builtin_model(), replace(run.at(upright), gravity=np.array([0.0, 0.0, 1.0])))
    assert found.verdict == "ambiguous" and [list(r.effects) for r in found.alternatives] == [
        ["payload"]
    ]
    assert re.search(r"fitted here it does \d+ % of it", found.alternatives[0].why)


def test_an_effect_that_was_not_asked_for_is_no_alternative():
    run = finger_run(["gain"], {"gain.factor[0]": 1.15, "gain.factor[1]": 1.1})
    assert diagnose(builtin_model(), run, effects=["gain", "backlash"]).alternatives == ()


def late(samples):
    """Effective commands that are so many samples of 20 ms late."""
    return lambda u: np.concatenate([np.tile(u[:1], (samples, 1)), u])[: len(u)]


def test_what_lies_beyond_a_bound_is_never_identified():
    """0.56 s of delay where the library allows 0.5: the number is at its bound, and this is
    reported.
    """
    found = diagnose(
        builtin_model(), finger_run(acting=late(28)), effects=["latency", "gain", "backlash"]
    )
    assert found.verdict != "identified"
    if found.effects:
        assert found.effects[0].params["latency.delay"].at_bound
        assert "latency.delay is at its bound of 0.5 s" in found.sentence
        # the true law is not in the library
        assert found.effects[0].probability <= 1 / (1 + decision.ODDS_DOUBT)


def test_what_lies_far_beyond_a_bound_is_an_unknown_law_of_its_family():
    """A second of delay, twice the library's limit, still counts as a robot that follows its
    commands.
    """
    found = diagnose(builtin_model(), finger_run(acting=late(50)))
    assert found.verdict == "partly_explained" and not found.faults
    assert (found.families[0].name, found.families[0].law) == ("delay", "unknown")


def test_extrapolation_is_reported():
    run = finger_run()
    assert "beyond the commands" not in diagnose(builtin_model(), run, effects=["gain"]).sentence
    assert (
        "beyond the commands"
        in diagnose(builtin_model(), replace(run, command=2 * run.command)).sentence
    )
