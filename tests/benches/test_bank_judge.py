"""Scores by family: first family, claims on nulls, false identifications, a known law together with
an unknown one.
"""

import json
import subprocess
import sys

import pytest

from benches.bank import left_out
from benches.bank.answers import answer_for, fits_family, matches
from benches.bank.judge import table
from benches.bank.judge_family import by_family, names_alike
from benches.bank.judge_learned import together
from benches.bank.work import decided
from softmap_edge.diagnosis import decision
from softmap_edge.model.learned_in import LearnedIn

ALIKE = {
    name: {name}
    for name in (
        "backlash",
        "friction",
        "gain",
        "eccentric_pulley",
        "latency",
        "creep",
        "dead_zone",
    )
}
ALIKE["gain"].add("tendon_stretch")


def truth(*hidden, background=0.2):
    answers = [answer_for(name, name != "smooth_map").to_dict() for name in hidden]
    for name, answer in zip(hidden, answers):
        if name == "smooth_map":
            answer |= {"families": ["static map"], "verdicts": ["partly_explained", "ambiguous"]}
    verdicts = answers[0]["verdicts"] if len(answers) == 1 else ["ambiguous", "partly_explained"]
    return {
        "hidden": list(hidden), "answers": answers, "also": [], "background_mm": background,
        "verdicts": verdicts if hidden else ["nothing", "cannot_tell"],
    }  # fmt: skip


def said(*effects, verdict="identified", families=None, faults=(), p=0.9):
    entries = [{"name": name, "probability": p} for name in effects]
    document = {
        "verdict": verdict,
        "effects": entries,
        "faults": [{"name": n, "probability": p} for n in faults],
    }
    return (
        document if families is None else document | {"families": [{"name": f} for f in families]}
    )


def reported(hidden, document):
    about = truth(*hidden)
    return by_family(document, about, names_alike(ALIKE, about))


def test_the_first_family_has_to_be_that_of_the_law():
    assert reported(["backlash"], said("backlash", families=["memory", "time"]))["family_right"]
    assert not reported(["backlash"], said("backlash", families=["time", "memory"]))["family_right"]
    assert (
        reported(["backlash"], said("backlash"))["family_right"] is False
    )  # none are reported today
    assert reported([], said(verdict="nothing", families=[]))["family_right"] is None
    pair = ["backlash", "gain"]
    assert reported(pair, said(*pair, families=["static_map", "memory"]))["family_right"]
    assert not reported(pair, said(*pair, families=["memory", "memory"]))["family_right"]
    assert fits_family("Static_Map", {"families": ["static map"]})


def test_a_claim_on_nothing_is_a_name_or_an_open_map_above_the_background():
    assert (
        not reported([], said(verdict="nothing"))["claimed"]
        and reported([], said("gain"))["claimed"]
    )
    assert not reported([], said("gain", verdict="ambiguous", p=0.3))["claimed"]  # a candidate
    assert reported([], said(verdict="measurement_fault", faults=["mount"]))["claimed"]
    open_map = said(verdict="ambiguous", families=["static map"])
    assert reported([], open_map)["claimed"]
    for size, claimed in ((0.1, False), (0.3, True)):
        document = open_map | {"families": [{"name": "static map", "moved_mm": size}]}
        assert reported([], document)["claimed"] is claimed
    assert not reported([], said(verdict="nothing", families=["memory"]))["claimed"]


def test_an_identified_map_is_false_and_an_open_one_is_right():
    pulley = reported(["smooth_map"], said("eccentric_pulley"))
    assert pulley["false_identified"] and not pulley["answered"]
    left = reported(
        ["smooth_map"],
        said("eccentric_pulley", verdict="ambiguous", families=["static map"], p=0.4),
    )
    assert not left["false_identified"] and left["answered"] and left["family_right"]
    assert not reported(["gain"], said("tendon_stretch"))["false_identified"]  # declared alike
    assert reported(["backlash"], said("backlash", "gain"))["false_identified"]
    assert not reported(["smooth_map"], said(verdict="nothing"))["answered"]


def test_a_known_law_next_to_an_unknown_one_is_named_and_the_rest_left_open():
    both = ["backlash", "smooth_map"]
    assert reported(both, said("backlash", verdict="partly_explained"))["beside"]
    assert (
        not reported(both, said("backlash"))["beside"]
        and not reported(both, said("gain", verdict="ambiguous"))["beside"]
    )
    assert not reported(both, said("backlash", "gain", verdict="partly_explained"))["beside"]
    candidate = said("backlash", "gain", verdict="partly_explained")
    candidate["effects"][1]["probability"] = 0.3
    assert reported(both, candidate)["beside"]
    assert reported(["backlash"], said("backlash"))["beside"] is None


def test_names_may_be_patterns():
    assert matches("guide_friction", ("friction", "*_friction")) and not matches(
        "backlash", ("friction", "*_friction")
    )
    about = truth("body_friction")
    assert names_alike(ALIKE, about)["body_friction"] >= {"friction"}
    assert names_alike(ALIKE, truth("smooth_map"))["smooth_map"] == {"unknown smooth_map"}


def test_what_the_model_learned_counts_before_what_is_diagnosed():
    backlash = LearnedIn("backlash", "memory", "identified", 2.0, 1.0)
    latency = LearnedIn("latency", "delay", "identified", 2.0, 1.0)
    document = together([backlash], said(verdict="nothing") | {"alternatives": []})
    assert [e["name"] for e in document["effects"]] == ["backlash"] and document[
        "verdict"
    ] == "identified"
    assert document["families"] == [{"name": "memory"}]
    document = together([], said("creep", families=["creep"]) | {"alternatives": []})
    assert document["verdict"] == "identified" and [f["name"] for f in document["families"]] == [
        "creep"
    ]
    document = together([latency], said("creep", verdict="ambiguous") | {"alternatives": []})
    assert document["verdict"] == "ambiguous"


def test_the_table_counts_what_is_scored():
    base = {
        "first": True,
        "exact": True,
        "inside": True,
        "flagged": False,
        "in_library": True,
        "claims": [],
        "fall": 0.9,
        "seen": "vertices",
        "equivalent": True,
        "seconds": 1.0,
        "truth_seconds": 2.0,
        "beside": None,
        "identified": True,
        "claimed": True,
        "answered": True,
        "not_testable": [],
        "named": ["gain"],
    }
    rows = [
        base | {"kind": "single", "scored": True, "family_right": True, "false_identified": False},
        base | {"kind": "single", "scored": False, "family_right": False, "false_identified": True},
        base
        | {
            "kind": "null",
            "scored": True,
            "family_right": None,
            "false_identified": True,
            "claimed": True,
        },
    ]
    found = {m["measure"]: (m["value"], m["n"]) for m in table(rows)}
    assert found["single, twice its background: right name first"] == (1.0, 1)
    assert found["single, twice its background: right family"] == (1.0, 1)
    assert found["'identified' that is false"] == (pytest.approx(2 / 3), 3)
    assert found["nothing hidden, a name or an open map claimed"] == (1.0, 1)


# --- leave one bank out -------------------------------------------------------------------------


def scored(part, right, claims=(), number=0):
    slice_, level = part.split("/")
    return {
        "slice": slice_,
        "level": level,
        "kind": "single",
        "case": f"{part}-{number}",
        "scored": True,
        "beside": None,
        "first": right,
        "false_identified": False,
        "claims": list(claims),
    }


def bank(rights, claims=()):
    return [
        scored(part, right, claims, i)
        for part, many in rights.items()
        for i, right in enumerate(many)
    ]


def test_a_slice_chooses_nothing_for_itself():
    """The other constants are far better on one slice and a little worse on the others: they are
    not used there.
    """
    shipped = bank({"A/real": [0, 0, 0, 0], "shop/floor": [1, 1, 1, 0], "odd/real": [1, 1, 1, 0]})
    other = bank({"A/real": [1, 1, 1, 1], "shop/floor": [1, 1, 0, 0], "odd/real": [1, 1, 0, 0]})
    sets = {"shipped": left_out.parts_of(shipped), "LEFT=0.3": left_out.parts_of(other)}
    assert left_out.chosen(sets, "A/real") == "shipped"
    assert left_out.chosen(sets, "shop/floor") == left_out.chosen(sets, "odd/real") == "LEFT=0.3"
    table = left_out.text({"shipped": shipped, "LEFT=0.3": other}).splitlines()
    assert table[0].startswith("answers that are right, 12 cases") and "0 (0 to 49), 4" in table[5]


def test_odds_are_fitted_to_the_claims_of_the_other_slices():
    def claims(doubts, right, count):
        p = 1.0 / (1.0 + decision.ODDS_BASE + decision.ODDS_DOUBT * doubts)
        return [{"probability": p, "itself": i < right, "true": i < right} for i in range(count)]

    many = claims(0, 99, 100) + claims(1, 50, 100)  # a doubt is worth odds of 1 in truth
    assert left_out.fitted_odds(many) == (0.01, 1.0)
    assert left_out.calibration_error(many) > 3 * left_out.calibration_error(
        left_out.with_odds(many, 0.01, 1.0)
    )
    assert 0.0 < left_out.by_chance(many) < left_out.calibration_error(many)
    rows = bank({"A/real": [1], "shop/floor": [1]}, many)
    assert "0.01, 1" in left_out.text({"shipped": rows})


def test_other_constants_are_set_before_the_diagnosis_reads_them():
    script = (
        "from benches.bank.work import decided; decided('VISIBLE_MM=0.5,FORM=0.1')\nfrom "
        "softmap_edge.diagnosis import decision, diagnose; print(diagnose.VISIBLE_MM, "
        "decision.FORM)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["0.5", "0.1"]
    for wrong in ("FROM=0.1", "np=3", "FORM=x"):
        with pytest.raises(ValueError, match="give NAME=VALUE"):
            decided(wrong)


@pytest.mark.long
def test_the_command_scores_with_other_constants_and_leaves_banks_out(tmp_path):
    command = [
        sys.executable,
        "-m",
        "benches.bank",
        "--parts",
        "learned/one",
        "--kinds",
        "null",
        "--share",
        "0.02",
    ]

    def run(*more):
        return subprocess.run(
            [*command, *map(str, more)], capture_output=True, text=True, check=True
        ).stdout

    run("--out", tmp_path / "a", "--jobs", 1)
    run("--out", tmp_path / "b", "--jobs", 1, "--cases", tmp_path / "a/cases", "--set", "FORM=0.1")
    (row,) = (json.loads(path.read_text()) for path in (tmp_path / "b").glob("*.json"))
    assert row["code"].endswith(" FORM=0.1") and "failed" not in row
    table = run("--out", tmp_path / "a", "--left-out", tmp_path / "b")
    empty = subprocess.run(
        [*command, "--out", tmp_path / "a", "--left-out", tmp_path], capture_output=True, text=True
    )
    assert empty.returncode == 2 and "no rows of development seeds" in empty.stderr.splitlines()[-1]
    assert "1 cases" in table and "FORM=0.1" in table and "best on the other slices" in table
