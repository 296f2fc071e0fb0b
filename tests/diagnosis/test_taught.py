"""A run that taught the model is recognised: the report says what was learned in, and what can
still be found.

The robot is that of tests/rod/test_learned_memory.py, simulated apart from the effect library.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from learned_ticks import arm
from logs import published
from recorded_arms import arc, recorded, wander

from softmap_edge import Run, diagnose, learn_model, load_bundle, save_bundle
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.diagnosis.family_text import LEARNED
from softmap_edge.diagnosis.taught import TaughtRuns, with_unknown
from softmap_edge.errors import ReportError
from softmap_edge.report.html import write_html
from softmap_edge.rod.learn import learn, learned_model
from softmap_edge.run.cut import cut
from softmap_edge.run.join import join_runs

GAP = 1.4


@pytest.fixture(scope="module")
def always():
    """A robot that had play in both servos from the beginning."""
    return recorded((GAP, GAP), seconds=60.0)


@pytest.fixture(scope="module")
def model(always):
    return learned_model(always, learn(always))


@pytest.fixture(scope="module")
def static(always):
    return learned_model(always, learn(always, static=True))


@pytest.fixture(scope="module")
def same(model, always):
    return diagnose(model, always)


@pytest.fixture(scope="module")
def bent(static, always):
    return diagnose(static, always)


def test_play_that_was_learned_in_is_in_the_report_and_nothing_is_left(same):
    (one,) = same.learned_in
    assert one.name == "backlash" and one.params[0].value == pytest.approx(GAP, rel=0.05)
    assert same.effects == same.faults == same.families == ()
    text = " ".join(str(same).split())
    assert (
        "Learned with the model" in text and "· backlash, gap 1.40 mm (memory, identified)" in text
    )
    assert "this run taught the model" in text and "no static effect can show" in text
    assert "memory was learned as well: backlash" in text


def test_static_effects_cannot_be_found_in_a_run_that_taught_the_model(same, model):
    held = {one.name: one.why for one in same.not_testable if "learned from this run" in one.why}
    assert {"gain", "offset", "payload", "mount"} <= set(held) and not {
        "backlash",
        "latency",
        "creep",
    } & set(held)
    other = diagnose(
        model, recorded((GAP, GAP), seconds=60.0, seed=2, drive=lambda t: wander(t + 77))
    )
    assert other.learned_in == same.learned_in
    assert not any("taught" in said for said in other.remarks)
    assert not any("learned from this run" in one.why for one in other.not_testable)


def test_learned_statically_the_play_is_named_first_by_the_diagnosis(bent):
    (found,), (family,) = bent.effects, bent.families
    assert found.name == "backlash" and (family.name, family.law) == ("memory", "identified")
    assert bent.verdict == "identified" and bent.learned_in == ()
    assert bent.error.after < 0.4 * bent.error.before
    assert any(
        "memory can, because the model was learned with --static" in said for said in bent.remarks
    )
    assert "without --static" in bent.next[0].block and bent.next[0].settles == ("backlash",)


def test_without_solving_the_map_again_another_effect_is_named_next_to_it(
    static, always, bent, monkeypatch
):
    """The play has bent the static map: with the map as it is, play alone does not explain what the
    family can.
    """
    monkeypatch.setattr("softmap_edge.diagnosis.families.MAPPED", ())
    found = diagnose(static, always)
    assert [one.name for one in found.effects] != ["backlash"] == [one.name for one in bent.effects]


def test_another_run_of_that_robot_is_named_as_well(static, bent):
    other = diagnose(
        static, recorded((GAP, GAP), seconds=60.0, seed=2, drive=lambda t: wander(t + 77))
    )
    assert [one.name for one in other.effects] == ["backlash"] == [one.name for one in bent.effects]
    assert not any("taught the model" in said for said in other.remarks)
    assert "gain" in {
        one.name for one in other.not_testable if "learned while the memory acted" in one.why
    }


def test_a_static_change_is_still_found_with_a_model_learned_statically():
    """Without memory, solving the map again finds nothing, and the search goes on with the map as
    it is.
    """
    before, after = recorded(seconds=60.0), recorded(seconds=60.0, seed=4)
    model = learned_model(before, learn(before, static=True))
    weaker = replace(after, command=after.command / 0.8)  # each command does 80 % of what it did
    found = diagnose(model, weaker)
    assert [one.name for one in found.effects] == ["gain"]


def test_of_several_runs_those_that_taught_the_model_are_named(model, always):
    other = recorded((GAP, GAP), seconds=60.0, seed=2, drive=lambda t: wander(t + 77))
    found = diagnose(model, [other, always])
    assert any(
        said.startswith("run 2 taught the model: only the other runs") for said in found.remarks
    )
    assert not any("taught the model" in one.why for one in found.not_testable)


def test_the_document_keeps_what_was_learned_in_and_an_earlier_one_reads_without(same):
    document = json.loads(json.dumps(same.to_dict()))
    assert document["learned_in"][0]["name"] == "backlash"
    assert Diagnosis.from_dict(document).learned_in == same.learned_in
    assert str(Diagnosis.from_dict(document)) == str(same)
    without = {key: value for key, value in document.items() if key != "learned_in"}
    assert Diagnosis.from_dict(without).learned_in == () and "Learned with the model" not in str(
        Diagnosis.from_dict(without)
    )
    document["learned_in"][0]["law"] = "certain"
    with pytest.raises(ReportError, match="law"):
        Diagnosis.from_dict(document)


def test_the_page_shows_it_with_what_a_file_says_escaped(same, tmp_path):
    evil = replace(same, learned_in=(replace(same.learned_in[0], name="<script>"),))
    page = write_html(tmp_path / "p.html", diagnosis=evil).read_text()
    assert LEARNED in page and "&lt;script&gt;" in page and "<script>" not in page
    assert (
        LEARNED
        not in write_html(tmp_path / "p.html", diagnosis=replace(same, learned_in=())).read_text()
    )


def test_a_described_rod_shows_static_effects_in_the_run_that_taught_it():
    """The rod of a robot.toml has few numbers, so it does not follow every static effect."""
    teacher = TaughtRuns(runs=(1,), free=False)
    assert not teacher.remaps and "only as far as the rod of its robot.toml" in str(teacher)
    assert TaughtRuns(runs=(1,), free=True, static=True).remaps
    # it was solved with the memory that was found
    assert not TaughtRuns(runs=(1,), free=True).remaps


@pytest.mark.parametrize("name", ["vio000", "vio090", "arts_30lb_05hz_1in"])
def test_a_machine_whose_memory_was_learned_gets_no_other_name_and_no_fault(name):
    run = Run.load(published("memory") / f"{name}_fit.npz")
    found = diagnose(learned_model(run, learn(run)), run)
    assert found.verdict != "measurement_fault" and found.effects == found.faults == ()
    assert found.unexplained.rms_mm <= found.error.model
    free = diagnose(learned_model(run, learn(run, static=True)), run)
    assert free.verdict != "measurement_fault" and free.unexplained.rms_mm <= free.error.model


def tugged(u, t, share=0.02):
    """Commands (T, C) mm that a drag pulls back by the square of their speed: a law that is in no
    library.
    """
    v = np.gradient(u, t, axis=0)
    return u - share * v * np.abs(v)


def test_a_memory_without_a_law_is_kept_with_the_model_and_reported_if_a_run_shows_nothing(
    tmp_path,
):
    t = np.arange(0.0, 90.0, 0.02)
    markers = arc(tugged(wander(t), t))[::3]
    markers = markers + np.random.default_rng(0).normal(0, 0.1, markers.shape)
    run = Run(t=t, command=wander(t), t_seen=t[::3], markers=markers)
    save_bundle(learned_model(run, learn(run)), tmp_path / "dragged")
    model = load_bundle(tmp_path / "dragged")
    (one,) = model.learned_in
    assert (one.name, one.law, model.chain_names) == (
        "",
        "unknown",
        (),
    ) and one.after_mm < 0.9 * one.before_mm
    assert f"unknown law of {one.family}" in str(one) and "not in the model" in str(one)
    silent = Diagnosis("nothing", "Nothing is missing.")
    found = with_unknown(model, silent, TaughtRuns())
    (family,) = found.families
    assert (found.verdict, family.name, family.law) == ("partly_explained", one.family, "unknown")
    assert found.sentence.startswith(f"An unknown law of the family {one.family}")
    assert found.sentence.endswith("Nothing is missing.")
    assert family.moved_mm**2 == pytest.approx(one.before_mm**2 - one.after_mm**2)
    named, other = Diagnosis("identified"), Diagnosis("partly_explained", "A delay.")
    assert with_unknown(model, named, TaughtRuns()) is named
    assert with_unknown(model, other, TaughtRuns()) is other  # another run may show another one
    # the runs that taught the model cannot
    again = with_unknown(model, other, TaughtRuns(runs=(1,)))
    assert again.families == found.families and "A delay." not in again.sentence
    kept = json.loads(json.dumps(one.to_dict()))
    document = {
        "schema": "softmap.diagnosis/2",
        "verdict": "nothing",
        "sentence": "",
        "learned_in": [kept],
    }
    page = write_html(tmp_path / "p.html", diagnosis=document).read_text()
    assert f"unknown law of {one.family}, not in the model" in page


def test_a_robot_without_such_a_memory_gets_no_such_record():
    model = learned_model(runs := recorded(), learn(runs))
    found = diagnose(model, recorded(seed=5, seconds=60.0, drive=lambda t: wander(t + 400.0)))
    assert model.learned_in == () and found.verdict in ("nothing", "cannot_tell")


def test_a_piece_of_the_recording_that_taught_the_model_is_recognised(tmp_path):
    run = arm(seconds=60.0)
    early, late = cut(run, end=40.0), cut(run, start=40.0)
    save_bundle(learn_model(early, static=True), tmp_path / "b")
    model = load_bundle(tmp_path / "b")
    assert (
        model.taught_by(early)
        and model.taught_by(run)
        and model.taught_by(cut(run, start=30.0, end=50.0))
    )
    assert model.taught_by(join_runs([late, early])) and not model.taught_by(late)
    assert not model.taught_by(arm(seconds=60.0, seed=8))
    assert learn_model(join_runs([early, late]), static=True).taught_by(run)
