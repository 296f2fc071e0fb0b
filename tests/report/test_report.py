"""The reports: what the text says, what is refused, and that bad input breaks neither text nor
page.
"""

import copy
import re
from dataclasses import replace

import pytest
from leaning_triangle import triangle
from report_documents import DIAGNOSIS, compared, page

from softmap_edge.commands.understand import _nothing_left
from softmap_edge.comparison.comparison import compare
from softmap_edge.comparison.text import pair_text
from softmap_edge.diagnosis.findings import (
    Displacement,
    ErrorLadder,
    FamilyFinding,
    Finding,
    Rung,
    Unexplained,
    Untestable,
)
from softmap_edge.diagnosis.text import VERDICTS, diagnosis_text, parameter
from softmap_edge.diagnosis.wording import OwnMisfit, sentence_of, verdict_of
from softmap_edge.errors import ReportError
from softmap_edge.files.numbers import bar, fall, tamed
from softmap_edge.report.html import write_html

pair = pytest.fixture(scope="module")(compared)


def test_bars_are_proportional():
    assert len(bar(1.0, 1.0, 10)) == 10 and len(bar(0.5, 1.0, 10)) == 5
    assert bar(0.0, 1.0) == bar(float("nan"), 1.0) == bar(1.0, 0.0) == ""
    assert bar(1e-9, 1.0) == "▏"


def test_fall_is_counted_above_the_floor():
    assert fall(3.0, 1.0) == pytest.approx(2 / 3) and fall(3.0, 1.0, 1.0) == pytest.approx(1.0)
    assert fall(1.0, 2.0) == pytest.approx(-1.0) and fall(1.0, 0.5, 1.0) is None


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ({"value": 0.6213, "sigma": 0.013, "unit": "mm"}, "0.621 ± 0.013 mm"),
        ({"value": 59.96, "sigma": 4.2, "unit": "g"}, "60.0 ± 4.2 g"),
        ({"value": 1.0, "sigma": None, "unit": ""}, "1 (uncertainty not known)"),
        ({"value": 0.951, "sigma": 0.013, "unit": "1"}, "0.951 ± 0.013"),
        ({"value": 0.5, "sigma": 3e40, "unit": "mm"}, "0.5 ± 3e+40 mm"),
        ({"value": float("nan"), "sigma": 1.0}, "–"),
    ],
)
def test_parameters_have_as_many_digits_as_they_deserve(value, text):
    assert parameter(value) == text


def test_one_comparison_reads_well(pair):
    text = str(pair[3])
    assert "rms" in text and "3.46" in text and "noise floor" in text and "along the body" in text
    assert max(map(len, text.splitlines())) <= 100 and "█" in text


def test_a_pair_shows_the_fall_and_its_scale(pair):
    text = pair_text(pair[3], pair[4])
    assert "falls from 3.46 to 0.357 mm RMS; 92 % of the removable error is gone" in " ".join(
        text.split()
    )
    assert text.count("░") > 1 and text.count("▓") == 1  # once in the legend
    assert max(map(len, text.splitlines())) <= 100


def test_a_rise_is_called_a_rise(pair):
    text = pair_text(pair[4], pair[3])
    assert "ROSE from 0.357 to 3.46 mm" in text and text.count("▓") > 1


def test_a_run_at_its_floor_is_not_proposed_for_a_diagnosis(pair):
    """Nor one whose error above the floor is gone; a floor that is a bound excludes neither."""
    _, _, _, before, after = pair

    def off(old, new, kind="frames of one dwell"):
        one, two = (
            replace(
                comparison,
                error=comparison.error | {"rms_mm": rms},
                noise_floor_mm=0.2,
                made_from={"noise_floor": kind},
            )
            for comparison, rms in ((before, old), (after, new))
        )
        return _nothing_left(one, two)

    assert off(2.0, 1.0) is None and off(1.0, 1.0) is None
    assert "within 1.5 times the noise floor" in off(0.3, 0.3)
    assert off(3.0, 0.4).startswith("93 % of the removable error is gone")
    assert off(0.3, 0.3, "memory counts as noise: an upper bound") is None


def test_pairs_of_different_runs_are_refused(pair, tmp_path):
    other = compare(pair[1], triangle(noise=0.05, seed=5))
    with pytest.raises(ReportError, match="different runs"):
        pair_text(pair[3], other)
    with pytest.raises(ReportError, match="different runs"):
        write_html(tmp_path / "page.html", [pair[3], other])


def test_diagnosis_says_everything_it_knows():
    text = diagnosis_text(DIAGNOSIS)
    for part in (
        *(
            "partly explained",
            "backlash.gap",
            "0.621 ± 0.013 mm",
            "at its bound",
            "friction",
            "thermal_softening",
            "held-out rms",
        ),
        *(
            "a warm-up",
            "+ backlash",
            "floor: nothing hidden",
            "(held-out blocks)",
            "staircase",
            "2.5 min",
        ),
    ):
        assert part in text, part
    assert max(map(len, text.splitlines())) <= 100


def test_effects_that_cannot_be_tested_for_one_reason_share_a_line(tmp_path):
    """A robot without geometry lacks what a dozen effects need; it is one limit, not a dozen."""
    document = copy.deepcopy(DIAGNOSIS)
    names = ["twist", "kink", "contact", "routing"]
    reason = {"why": "a model with the geometry of the body is needed", "experiment": "build one"}
    document["not_testable"] += [{"name": name} | reason for name in names]
    text = " ".join(diagnosis_text(document).split())
    assert f"· 4 effects: {reason['why']}: {', '.join(names)}. To test it: build one." in text
    assert "· thermal_softening: no temperature" in text
    shown = page(write_html(tmp_path / "p.html", None, document))
    assert "<dt>4 effects</dt>" in shown and shown.count(reason["why"]) == 1


def test_the_sentence_names_few_effects_that_cannot_be_shown():
    hidden = [Untestable(f"law{k}", of_model=k < 3) for k in range(9)]
    text = sentence_of(
        "cannot_tell", [], [], [], [], Unexplained(), hidden, ErrorLadder(floor=0.1), []
    )
    assert text.endswith(
        "These data cannot show law3, law4, law5, law6, law7, law8 and 3 more effects."
    )


def test_what_is_not_known_is_not_printed():
    text = diagnosis_text(DIAGNOSIS | {"error": DIAGNOSIS["error"] | {"noise_floor": None}})
    assert "effect size 1.82 mm RMS (fitted) backlash" in " ".join(text.split()) and "–" not in text
    assert "noise floor" not in text and "own held-out error 0.190 mm" in text
    moved = copy.deepcopy(DIAGNOSIS)
    moved["effects"][0]["displacement_mm"]["held_out"] = 1.5
    moved["error"]["held_out_on"] = "an independent run"
    assert "1.82 mm RMS (fitted), 1.50 mm RMS (held out)" in " ".join(diagnosis_text(moved).split())
    assert "on an independent run" in diagnosis_text(moved)


def test_numbers_that_ran_away_stay_short(tmp_path):
    """An alternative with an astronomic held-out error must not fill the screen with its digits."""
    document = copy.deepcopy(DIAGNOSIS)
    document["alternatives"][0]["why"] = (
        f"explains 93 % of it, {4.2e299:+.1f} % in mm, {10**400} more"
    )
    document["sentence"] = f"The error falls from {3e200:.2f} to 0.93 mm."
    document["error"]["model"] = document["unexplained"]["rms_mm"] = 3.1e250
    document["effects"][0]["share"] = document["unexplained"]["blocked_r2"] = -1e200
    document["effects"][0]["params"]["backlash.gap"] |= {"value": 1e300, "sigma": 1e299}
    text = diagnosis_text(document)
    assert "93 % of it, +4.2e+299 % in mm, 1.0e+400 more" in " ".join(text.split())
    assert "falls from 3.0e+200 to 0.93 mm" in text
    write_html(tmp_path / "p.html", None, document)
    shown = page(tmp_path / "p.html").split("<details>")[0]
    for part in (text, re.sub(r'src="data:image/[^"]*"', "", shown)):
        assert not re.search(r"\d{8}", part)


@pytest.mark.parametrize(
    ("given", "kept"),
    [("2 of 12345.678 mm", None), ("1234567 %", "1.2e+06 %"), ("hash a12345678 stays", None)],
)
def test_ordinary_numbers_are_left_alone(given, kept):
    assert tamed(given) == (kept or given)


def test_a_diagnosis_of_nothing():
    empty = {
        "schema": "softmap.diagnosis/2",
        "verdict": "nothing",
        "sentence": "Nothing above the floor.",
    }
    assert "Nothing above the floor." in diagnosis_text(empty)


@pytest.mark.parametrize(
    "damage",
    [
        {"schema": "softmap.diagnosis/9"},
        {"verdict": None},
        {"effects": ["backlash"]},
        {"effects": [{"params": {"gap": 3}}]},
        {"error": [3]},
        {"error": {"ladder": [3]}},
        {"where": {"before": {"speed": [{"label": "x"}]}}},
        {"alternatives": {"a": 1}},
    ],
)
def test_damaged_diagnoses_are_refused(damage, tmp_path):
    with pytest.raises(ReportError, match="diagnosis"):
        diagnosis_text(DIAGNOSIS | damage)
    with pytest.raises(ReportError, match="diagnosis"):
        write_html(tmp_path / "p.html", None, DIAGNOSIS | damage)
    assert not (tmp_path / "p.html").exists()


@pytest.mark.parametrize("junk", ["x", float("nan"), []])
def test_odd_values_never_break_a_report(junk, tmp_path):
    """Every leaf of the document in turn becomes junk: a report or a ReportError, nothing else."""
    for where in leaves(DIAGNOSIS):
        document = copy.deepcopy(DIAGNOSIS)
        target = document
        for key in where[:-1]:
            target = target[key]
        target[where[-1]] = junk
        try:
            diagnosis_text(document)
        except ReportError:
            continue
        if where[0] == "error":
            write_html(tmp_path / "p.html", None, document)


def leaves(value, path=()):
    if isinstance(value, dict):
        return [leaf for key, inner in value.items() for leaf in leaves(inner, (*path, key))]
    if isinstance(value, list):
        return [leaf for key, inner in enumerate(value) for leaf in leaves(inner, (*path, key))]
    return [path]


ERROR = ErrorLadder(
    model=3.18, ladder=(Rung("backlash", 0.38),), held_out_on="blocks of the run that was fitted"
)
FAMILIES = {
    "none": (),
    "unknown": (FamilyFinding("memory", "memory", "unknown", (), 0.9, 1.2, 0.4, (), ("delay",)),),
    "open": (
        FamilyFinding(
            "static map", "static", "open", ("gain",), 0.9, 1.2, 0.9, ("u³ on all channels",)
        ),
    ),
}


@pytest.mark.parametrize("verdict", VERDICTS)
@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize("family", FAMILIES)
def test_every_error_in_a_sentence_says_rms_and_fitted_or_held_out(verdict, named, family):
    physics = [Finding("backlash", {})] if named else []
    left = Unexplained(rms_mm=0.4, chi2_per_n=1.9, blocked_r2=0.5, predicted_by="speed")
    reported = (
        sentence_of(verdict, physics, [], FAMILIES[family], [], left, [], ERROR, [])
        + f" {OwnMisfit(('gain',), 2.0, 1.0)}."
    )
    assert not re.findall(r"\d mm(?! RMS)", reported)
    errors = [part for part in re.split(r"[;:.] ", reported) if "mm RMS" in part]
    # of an effect, not an error
    sizes = [part for part in errors if "family memory" in part or "law open" in part]
    assert all("fitted" in part or "held" in part for part in errors if part not in sizes), reported


def test_a_sentence_names_what_was_found_in_words_of_both_levels():
    left = Unexplained(rms_mm=0.4, chi2_per_n=1.9, blocked_r2=0.5, predicted_by="speed")

    def reported(verdict, family, physics=(), hint=""):
        return sentence_of(verdict, physics, [], FAMILIES[family], [], left, [], ERROR, [], hint)

    assert reported("ambiguous", "open").startswith(
        "A static, non-linear map of the commands of 1.20 mm RMS, law open; candidates: gain, u³ "
        "on all channels"
    )
    unknown = reported("partly_explained", "unknown")
    assert (
        "unknown law of the family memory (or delay), 1.20 mm RMS" in unknown
        and "follow speed" in unknown
    )
    assert reported("partly_explained", "none").startswith(
        "Something unknown is missing; 0.40 mm RMS (fitted)"
    )
    assert "(nearest family: creep)" in reported("partly_explained", "none", hint="creep")
    both = reported("ambiguous", "open", [Finding("backlash", {})])
    assert both.startswith("The model lacks backlash; and a static, non-linear map of the commands")
    candidate = reported("ambiguous", "open", [Finding("gain", {})])
    assert "lacks" not in candidate  # a candidate of an open law is no missing effect


def test_every_error_of_a_report_says_rms_and_fitted_or_held_out():
    lines = diagnosis_text(DIAGNOSIS | {"sentence": ""}).splitlines()
    # others: parameters
    errors = [line for line in lines if "±" not in line and not line.startswith("  · Memory: ")]
    named = [line for line in errors if re.search(r"\d mm", line)]
    assert len(named) >= 3 and all("RMS" in line for line in named), named
    assert "probability 97 % (fitted)" in diagnosis_text(DIAGNOSIS)
    bare = DIAGNOSIS | {
        "effects": [entry | {"probability": None} for entry in DIAGNOSIS["effects"]]
    }
    assert "probability" not in diagnosis_text(bare)


def test_a_fault_that_does_most_comes_first_and_is_the_verdict():
    def entry(name, mm):
        return Finding(name, {}, displacement_mm=Displacement(mm))

    swap, hysteresis, mount = (
        entry("servo_swap", 13.0),
        entry("hysteresis", 2.0),
        entry("mount", 1.0),
    )
    sure, found = dict(doubtful=False, unknown=False), dict(detected=True, hidden=0, count=30)
    assert verdict_of([hysteresis], [swap], **sure, **found) == "measurement_fault"
    assert verdict_of([hysteresis], [mount], **sure, **found) == "identified"
    assert verdict_of([mount], [mount], doubtful=True, unknown=False, **found) == "ambiguous"
    assert verdict_of([], [mount], **sure, **found) == "measurement_fault"
    error = ErrorLadder(
        model=13.2, ladder=(Rung("servo_swap", 0.4),), held_out_on="blocks of this run"
    )
    left = Unexplained(0.1, 1.0, 0.0, None)
    reported = sentence_of("measurement_fault", [hysteresis], [swap], [], [], left, [], error, [])
    assert reported.startswith(
        "The measurement is at fault (servo_swap); and the model lacks hysteresis; the held-out "
        "error"
    )


def test_verdicts_follow_from_what_was_found():
    one, sure = (
        [Finding("gain", {}, displacement_mm=Displacement(1.0))],
        dict(doubtful=False, unknown=False),
    )
    assert verdict_of(one, [], **sure, detected=True, hidden=0, count=30) == "identified"
    assert (
        verdict_of(one, [], doubtful=True, unknown=False, detected=True, hidden=0, count=30)
        == "ambiguous"
    )
    assert (
        verdict_of(one, [], doubtful=True, unknown=True, detected=True, hidden=0, count=30)
        == "partly_explained"
    )
    assert (
        verdict_of([], [], doubtful=True, unknown=False, detected=True, hidden=0, count=30)
        == "ambiguous"
    )
    assert verdict_of([], [], **sure, detected=False, hidden=9, count=30) == "nothing"
    assert verdict_of([], [], **sure, detected=False, hidden=10, count=30) == "cannot_tell"
