"""Paired replay: a reference run of the same commands takes the model error away; others are
refused.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from arm import NAMES, arm, record_run
from finger_runs import finger_run

from softmap_edge import builtin_model, diagnose, next_experiment
from softmap_edge.cli import main
from softmap_edge.diagnosis.findings import Alternative
from softmap_edge.diagnosis.record import Record
from softmap_edge.diagnosis.records import Records
from softmap_edge.errors import SoftmapError
from softmap_edge.robot.emulated.laws import LAWS, TipWeight
from softmap_edge.run.protocol import standard_protocol
from softmap_edge.synthetic.finger import HiddenEffect, Truth

MODEL = builtin_model()
WANTED = [
    "offset",
    "gain",
    "latency",
    "backlash",
    "hysteresis",
    "creep",
    "gravity",
    "payload",
    "mount",
]
PAYLOAD = {"payload.mass": 60.0}


def names(found):
    return [e.name for e in [*found.faults, *found.effects]]


@pytest.mark.long
def test_what_acts_in_both_runs_cancels_out_and_the_payload_of_one_is_named_alone():
    """A second finger with hysteresis of its own law, with and without a weight at its tip."""
    whole = standard_protocol(2)
    shown = replace(whole, t_seen=whole.t_seen[::2], block=whole.block[::2])
    memory = LAWS["hysteresis"].draw(np.random.default_rng(3), 2)
    bare, heavy = (
        Truth(4, (HiddenEffect(memory, 0.0),)),
        Truth(4, (HiddenEffect(memory, 0.0), HiddenEffect(TipWeight(14.0), 0.0))),
    )
    reference, run = bare.measure(shown), heavy.measure(shown, seed=1)
    alone, paired = (
        diagnose(MODEL, run, effects=WANTED),
        diagnose(MODEL, run, effects=WANTED, reference=reference),
    )
    assert set(names(alone)) == {"hysteresis", "payload"}
    assert names(paired) == ["payload"] and paired.verdict == "identified"
    assert "relative to the reference run" in paired.sentence and "cancels out" in paired.sentence
    assert (
        paired.made_from["reference"]["run"] == reference.hash()
        and paired.made_from["run"] == run.hash()
    )
    assert alone.made_from["reference"] is None
    assert paired.effects[0].params["payload.mass"].value == pytest.approx(14.0, rel=0.15)
    error = paired.error
    assert error.before < 0.7 * alone.error.before and error.after < 0.4 * error.before


def test_a_static_error_of_the_model_goes_away_with_the_reference():
    """Six times the declared model-form error hides a weight; paired replay removes that error."""
    alike = dict(warp=0.6, noise=0.05, seed=4)
    reference, run = record_run({}, **alike), record_run(PAYLOAD, **alike)
    assert reference.hash() != run.hash()
    again = replace_noise(record_run({}, **alike), 9)
    paired = diagnose(arm(), run, effects=NAMES, reference=reference)
    assert names(paired) == ["payload"] and paired.verdict == "identified"
    value = paired.effects[0].params["payload.mass"]
    assert abs(value.value - 60.0) < 3 * value.sigma + 0.5
    alone = diagnose(arm(), run, effects=NAMES)
    assert names(alone) != ["payload"]
    assert diagnose(arm(), again, effects=NAMES, reference=reference).verdict == "nothing"


def replace_noise(run, seed):
    return replace(
        run, markers=run.markers + 0.05 * np.random.default_rng(seed).normal(size=run.markers.shape)
    )


def test_the_noise_is_that_of_a_difference():
    run, clean = finger_run(), finger_run(noise=0.0)
    other = clean.vertices + 0.25 * np.random.default_rng(7).normal(size=run.vertices.shape)
    reference = replace(run, vertices=other)
    alone, paired = (
        diagnose(MODEL, run, effects=["offset", "payload"], reference=r) for r in (None, reference)
    )
    assert paired.error.noise_floor == pytest.approx(np.sqrt(2) * alone.error.noise_floor, rel=0.1)
    assert paired.verdict == "nothing"


def test_a_late_start_is_found_and_frames_need_not_meet():
    run = finger_run(["payload"], {"payload.mass": 15.0})
    free = finger_run()
    later = replace(free, t=free.t + 321.4, t_seen=free.t_seen + 321.4)
    record = Record(MODEL, run, later)
    assert record.replay.shift_s == pytest.approx(321.4, abs=0.02) and record.replay.share < 0.01
    straight = Record(MODEL, run, free)
    assert straight.replay.shift_s == 0.0 and straight.replay.differ == 0.0
    np.testing.assert_allclose(record.seen, straight.seen, atol=0.05)
    # The reference was seen at other times, and not to the end.
    half = replace(free.at(np.arange(free.frames) < 0.8 * free.frames), block=None)
    early = Record(MODEL, run, half)
    assert 0.7 * run.frames < len(early) <= 0.8 * run.frames + 1 and np.isfinite(early.seen).all()
    assert early.recorded_runs == (run,)
    both = Records(MODEL, [run, run], free)
    assert len(both) == 2 * run.frames and both.replay.frames == run.frames


def test_hidden_points_of_either_run_are_no_numbers():
    run, free = finger_run(), finger_run()
    hidden = np.ones(run.vertices.shape[:2], bool)
    hidden[10, MODEL.rest[:, 2] > 60.0] = False
    seen = Record(MODEL, run, replace(free, visible=hidden)).seen
    assert (
        np.isfinite(seen[11]).all()
        and not np.isfinite(seen[10]).all()
        and np.isfinite(seen[10]).any()
    )


def test_what_is_no_replay_is_refused_with_numbers():
    run = finger_run()
    with pytest.raises(
        SoftmapError, match=r"channel 0 differs by .* mm RMS, .* % of its range, allowed are 1 %"
    ):
        diagnose(MODEL, run, reference=replace(run, command=run.command[:, ::-1]))
    with pytest.raises(SoftmapError, match="does not play the commands"):
        diagnose(MODEL, run, reference=replace(run, command=1.2 * run.command))
    with pytest.raises(SoftmapError, match=r"seen at \d+ of the \d+ frames"):
        diagnose(MODEL, run, reference=run.at([3]))
    few = run.at(np.arange(run.frames) < 30)
    with pytest.raises(SoftmapError, match=r"seen at 30 of the \d+ frames"):
        diagnose(MODEL, run, reference=few)
    rest = MODEL.rest[::40]
    markers = replace(run, vertices=None, markers=run.vertices[:, ::40], marker_rest=rest)
    with pytest.raises(SoftmapError, match="seen in the same way"):
        diagnose(MODEL, run, reference=markers)
    with pytest.raises(SoftmapError, match="markers in place"):
        diagnose(MODEL, markers, reference=replace(markers, marker_rest=rest + 2.0))


def test_validation_is_relative_to_a_reference_of_its_own_commands():
    """A static error of 0.6 mm buries the weight in the raw run of other commands too; relative, it
    goes away.
    """
    alike = dict(warp=0.6, noise=0.05)
    reference, run = record_run({}, seed=4, **alike), record_run(PAYLOAD, seed=4, **alike)
    free, loaded = (record_run(hidden, seed=4, other=True, **alike) for hidden in ({}, PAYLOAD))
    loaded = replace_noise(loaded, 9)
    found = diagnose(arm(), run, loaded, effects=NAMES, reference=[reference, free])
    error = found.error
    assert (
        names(found) == ["payload"]
        and error.held_out_on == "an independent run, relative to the reference"
    )
    assert error.before > 1.0 and error.after < 0.15  # 0.05 a coordinate
    raw = diagnose(arm(), run, loaded, effects=NAMES).error
    assert raw.after > 0.3
    with pytest.raises(
        SoftmapError, match=r"the held-out run needs .* channel . differs by .*--held-out out"
    ):
        diagnose(arm(), run, loaded, effects=NAMES, reference=reference)
    with pytest.raises(SoftmapError, match="none of the 2 reference runs stands for this run"):
        diagnose(arm(), run, effects=NAMES, reference=[free, free])


def test_what_was_found_relative_to_a_reference_is_not_expected_of_it_again():
    alike = dict(warp=0.3, noise=0.05, seed=4)
    reference, run = record_run({}, **alike), record_run(PAYLOAD, **alike)
    heavy = arm().with_effects(("payload",), PAYLOAD)
    again = diagnose(heavy, run, effects=NAMES, reference=reference)
    assert again.verdict == "nothing" and again.made_from["reference"]["absent"] == ("payload",)
    assert "the model's own payload is taken as absent there" in again.sentence
    # In both runs it is expected of both.
    both = diagnose(
        heavy, replace_noise(record_run(PAYLOAD, **alike), 9), effects=NAMES, reference=run
    )
    assert both.verdict == "nothing" and both.made_from["reference"]["absent"] == ()


@pytest.mark.long
def test_the_next_experiment_is_chosen_for_a_difference():
    run, free = finger_run(["payload"], {"payload.mass": 9.0}), finger_run()
    found = diagnose(MODEL, run, effects=["payload", "gravity", "offset"], reference=free)
    assert any("next block twice" in remark for remark in found.remarks)
    open_one = (Alternative(("gravity",), "for the test"),)
    found = replace(found, alternatives=open_one, not_testable=())
    paired = next_experiment(MODEL, found, [run], references=[free])[0]
    assert paired.block == "another orientation" and set(paired.settles) == {"payload", "gravity"}
    reported = found.made_from
    raw = next_experiment(MODEL, replace(found, made_from=reported | {"reference": None}), [run])[0]
    # The noise of a difference is twice that of a run, the model-form error a fifth: it is another
    # number.
    assert abs(paired.separation / raw.separation - 1.0) > 0.05
    with pytest.raises(
        SoftmapError, match="relative to a reference run; give that run too, with --reference"
    ):
        next_experiment(MODEL, found, [run])
    with pytest.raises(
        SoftmapError, match=r"relative to 1 other reference run\(s\) than the 1 given"
    ):
        next_experiment(MODEL, found, [run], references=[run])
    with pytest.raises(SoftmapError, match="not relative to a reference run"):
        next_experiment(
            MODEL,
            replace(found, made_from=reported | {"reference": None}),
            [run],
            references=[free],
        )


def test_the_command_takes_a_reference(tmp_path, capsys):
    finger_run(["payload"], {"payload.mass": 15.0}).save(tmp_path / "b.npz")
    finger_run().save(tmp_path / "a.npz")
    argv = [
        "diagnose",
        str(tmp_path / "b.npz"),
        "--reference",
        str(tmp_path / "a.npz"),
        "--effects",
        "payload,offset",
    ]
    assert main([*argv, "--out", str(tmp_path / "d.json")]) == 0
    assert "relative to the reference run" in " ".join(capsys.readouterr().out.split())
    document = json.loads((tmp_path / "d.json").read_text())
    assert (
        document["effects"][0]["name"] == "payload"
        and document["made_from"]["reference"]["share"] == 0.0
    )
    assert main([*argv[:3], str(tmp_path / "none.npz")]) == 2
    capsys.readouterr()
    # An added effect names its reference, and the next experiment is recorded twice.
    assert (
        main(
            ["add", "payload", "--from", str(tmp_path / "d.json"), "--out", str(tmp_path / "with")]
        )
        == 0
    )
    assert "relative to a reference run" in capsys.readouterr().out
    document["not_testable"] = [{"name": "hysteresis", "why": "for the test", "experiment": ""}]
    (tmp_path / "d.json").write_text(json.dumps(document))
    argv = [
        "next",
        str(tmp_path / "d.json"),
        "--run",
        str(tmp_path / "b.npz"),
        "--reference",
        str(tmp_path / "a.npz"),
    ]
    assert main(argv) == 0
    reported = capsys.readouterr().out
    assert "play it twice" in reported and "--reference NEW_REFERENCE" in reported
    assert main([*argv, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["times"] == 2
    assert main(argv[:4]) == 2 and "give that run too, with --reference" in capsys.readouterr().err
