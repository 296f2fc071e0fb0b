"""docs/learn/tdcr.md as written: its commands run, its numbers come out, and the tendons of a real
robot are cables.

Without the logs everything here is skipped and says so; `make data` brings them.
"""

import importlib.util
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from logs import published
from page import ROOT, reader, run_commands

from benches import tdcr
from softmap_edge import Robot, learn_model, load_bundle

pytestmark = pytest.mark.long

PAGE = (ROOT / "docs/learn/tdcr.md").read_text(encoding="utf-8")
ROBOT = ROOT / "examples/tdcr_robot.toml"


@pytest.fixture(scope="module")
def logs():
    folder = published("tdcr")
    return folder, *tdcr.read(folder)


@pytest.fixture(scope="module")
def rods(logs):
    return {row["model"]: (row, learned, model) for row, learned, model in tdcr.rods(*logs[1:])}


@pytest.fixture(scope="module")
def page(logs, tmp_path_factory):
    """Run the commands of the page in their order and return the folder."""
    there = reader(tmp_path_factory.mktemp("tdcr"), logs[0])
    run_commands(PAGE, there)
    return there


def test_cables_predict_moves_that_they_were_not_fitted_to(rods):
    row, learned, model = rods["elastic rod, cables"]
    assert row["unseen_mm"] <= 7.4 and row["cv_mm"] < 6.2 and row["seconds"] < 30.0
    assert len(learned.numbers) == 17 and learned.made_from["blocks"] == 10
    assert model.chain_names == ()  # half a second a pose does not identify delay and lag
    assert not any(number.note for number in learned.numbers) and learned.notes == ()


def test_two_sided_tendons_do_not(rods):
    row, learned, _ = rods["elastic rod, two-sided"]
    assert row["unseen_mm"] == pytest.approx(12.3, abs=0.3) and row["cv_mm"] > 15.0
    assert any("stiffness" in note for note in learned.notes)


def test_asked_what_they_are_the_tendons_say_cables(rods):
    assert rods["… with a fitted ratio"][1].rod.numbers[0] < 0.05
    plain, tight = (rods[name][0] for name in ("elastic rod, cables", "… with a pretension"))
    assert tight["cv_mm"] < plain["cv_mm"] and tight["unseen_mm"] > plain["unseen_mm"]


def test_sides_found_from_the_log_are_as_good_as_measured_ones(logs):
    robot = replace(Robot.load(ROBOT), angles_known=False)
    assert tdcr.error(learn_model(logs[1], robot=robot), logs[2]) <= 7.4


@pytest.mark.prove
def test_a_turned_sign_ruins_everything(logs, rods):
    """The page says so; it is also the proof that the fit cannot please itself."""
    train = logs[1]
    command = np.array(train.command)
    command[:, 4] *= -1.0
    wrong = learn_model(replace(train, command=command), robot=Robot.load(ROBOT))
    assert wrong.vertex_error_mm > 2 * rods["elastic rod, cables"][0]["cv_mm"]


def shown(name):
    """Return the numbers of one row of the page's table; None for a dash."""
    found = re.search(rf"^\| \**{re.escape(name)}\** \|(.*)\|$", PAGE, re.MULTILINE)
    assert found, f"no row '{name}'"
    cells = [cell.strip(" *") for cell in found[1].split("|")]
    return [None if cell == "–" else float(cell) for cell in cells]


def test_the_numbers_of_the_page_come_from_the_logs(logs, rods):
    """All but gradient boosting and the Gaussian process, which take minutes: `python -m
    benches.tdcr` prints those.
    """
    assert shown("published simulator") == [None, None, None, tdcr.SIMULATOR_MM]
    for name, (row, _, _) in rods.items():
        wanted = [row["numbers"], *(row[key] for key in ("train_mm", "cv_mm", "unseen_mm"))]
        # The last digit shown; where a number is not identified, the descent ends a little off on
        # another machine.
        assert shown(name) == pytest.approx(wanted, abs=0.3 if "two-sided" in name else 0.1), name
    taut, slack = tdcr.slack_share(rods["elastic rod, cables"][2], logs[1])
    assert (
        f"{100 * taut:.0f} % of the\ntendons" in PAGE
        or f"{100 * taut:.0f} % of the tendons" in PAGE
    )
    assert slack < taut


def test_peers_are_measured_on_the_same_frames(logs, monkeypatch):
    quick = {
        name: make
        for name, make in tdcr.PEERS.items()
        if name in ("ridge, linear", "ridge, quadratic")
    }
    monkeypatch.setattr(tdcr, "PEERS", quick)
    for row in tdcr.peers(*logs[1:]):
        assert shown(row["model"]) == [
            None,
            *(pytest.approx(row[f"{k}_mm"], abs=0.06) for k in ("train", "cv", "unseen")),
        ]


def document(page, name):
    """Return a diagnosis of the page, and the unseen error before and after it."""
    found = json.loads((page / name).read_text(encoding="utf-8"))
    return found, found["error"]["model"], found["error"]["ladder"][-1]["value"]


def test_the_example_with_rods_is_the_other_one_with_another_law():
    rods, cables = (
        Robot.load(ROOT / f"examples/{name}.toml") for name in ("tdcr_rods", "tdcr_robot")
    )
    np.testing.assert_array_equal(rods.start, cables.with_slack(1.0).start)
    assert rods.layout == cables.layout and rods.modes == cables.modes and rods.angles_known


def test_from_two_sided_tendons_the_first_answer_is_slack(page, logs):
    found, before, after = document(page, "rods.json")
    assert found["verdict"] == "identified" and [effect["name"] for effect in found["effects"]] == [
        "slack"
    ]
    assert found["alternatives"] == [] and found["error"]["held_out_on"] == "an independent run"
    effect = found["effects"][0]
    assert effect["probability"] is None  # calibrated on bodies that were simulated
    assert (
        effect["params"]["slack.ratio"]["value"] < 0.02 and len(effect["refitted"]["params"]) == 17
    )
    assert before > 12.0 and after <= 7.0 and f"{before:.1f} → {after:.1f} mm" in PAGE
    rods, added = (load_bundle(page / name) for name in ("rods.bundle", "slack.bundle"))
    assert added.chain_names == ("slack",) and added.vertex_error_mm < 0.4 * rods.vertex_error_mm
    assert tdcr.error(added, logs[2]) == pytest.approx(after, abs=1e-6)


def test_the_second_is_a_memory_whose_members_are_not_distinguished(page, logs):
    """An offset is dropped: the error on the unseen run did not fall."""
    found, before, after = document(page, "tdcr.json")
    rivals = {name for rival in found["alternatives"] for name in rival["effects"]}
    named = {effect["name"] for effect in found["effects"]}
    assert found["verdict"] == "partly_explained" and found["made_from"]["demoted"] == ["offset"]
    assert named == {"friction"} and rivals == {"latency"}
    assert {one["family"] for one in found["alternatives"]} >= {"body", "creep"}
    assert "friction is not confirmed on the withheld blocks" in found["sentence"]
    assert (
        after <= 6.1
        and f"{found['unexplained']['rms_mm']:.1f} mm of error remain" in PAGE
        and f"{before:.1f} → {after:.1f} mm" in PAGE
    )
    after = load_bundle(page / "memory.bundle")
    assert after.kind == "rod" and after.channels == 9 and after.made_from["robot"] == "ftdcr-v4"
    assert tdcr.error(after, logs[2]) <= 6.3


@pytest.mark.prove
def test_the_pictures_of_the_page_are_made_by_their_script(logs, tmp_path, capsys):
    path = ROOT / "docs/figures_tdcr.py"
    spec = importlib.util.spec_from_file_location("figures_tdcr", path)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert script.main(["--out", str(tmp_path / "pictures")]) == 0
    made = {path.name: path.read_bytes() for path in (tmp_path / "pictures").iterdir()}
    assert made.keys() == {path.name for path in (ROOT / "docs").glob("tdcr_*")}
    assert all(b"<svg" in content[:1000] and name in PAGE for name, content in made.items())
    assert "unseen moves" in capsys.readouterr().out
