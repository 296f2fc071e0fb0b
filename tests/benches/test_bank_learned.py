"""The slice *learned*: recordings of one robot whose law was always present, in the frame of a
motion capture.
"""

from dataclasses import replace

import numpy as np
import pytest

from benches.bank.case import seen
from benches.bank.judge_learned import judge_learned, together
from benches.bank.laws_shop import SheathFriction
from benches.bank.learned import Capture, balls, circles, learned_case, reference, uncubed_mm
from benches.bank.make import made
from softmap_edge.model.learned_in import Alternative, LearnedIn


def test_a_capture_moves_and_turns_the_frame_and_nothing_else():
    points = np.random.default_rng(0).normal(size=(4, 5, 3)) * 30.0
    law = Capture.draw(np.random.default_rng(1), 2)
    out = law.seen(points, np.arange(4.0))
    apart = [np.linalg.norm(p[:, :, None] - p[:, None], axis=3) for p in (points, out)]
    assert np.allclose(*apart) and np.abs(out - points).max() > 5.0
    up = law.seen(np.array([[[0.0, 0.0, 100.0], [0.0, 0.0, 0.0]]]), np.zeros(1))[0]
    assert np.degrees(np.arccos((up[0] - up[1])[2] / 100.0)) < 8.0  # z is still about the axis


def test_two_reference_runs_differ_in_size_and_speed_and_validation_is_another_kind():
    one, two = reference(0, 1.0, 1.0, 90.0), reference(1, 0.5, 2.0, 60.0)
    fast = [
        np.abs(np.diff(p.command, axis=0)).max() / 0.02 / np.abs(p.command).max()
        for p in (one, two)
    ]
    assert np.abs(two.command).max() < 0.65 * np.abs(one.command).max() and fast[
        1
    ] != pytest.approx(fast[0], rel=0.2)
    assert np.abs(circles(0, 40.0).command).max() <= 11.0 and len(balls()[0]) == 5
    for protocol in (one, two):
        assert (
            np.abs(protocol.command[0]).max() < 1e-9
            and 5.0 < protocol.frames / protocol.t[-1] < 8.0
        )


@pytest.mark.long
def test_the_law_was_there_in_every_recording_and_a_case_is_pure():
    mine, runs = learned_case("development", "two", "single", 0)
    again, same = learned_case("development", "two", "single", 0)
    assert mine.to_dict() == again.to_dict() and all(
        runs[name].hash() == same[name].hash() for name in runs
    )
    assert list(runs) == ["taught", "taught_2", "first", "judge"] and mine.hidden == ("backlash",)
    for run in runs.values():
        assert (
            run.markers.shape[1] == 5 and run.marker_rest is None and np.ptp(run.temperature) == 0.0
        )
    protocol = circles(0, 40.0)
    plain = seen(mine.body, mine.small, protocol, True, every=4, room=mine.room)
    moved = np.linalg.norm(runs["judge"].markers[::4] - plain, axis=2)
    assert np.sqrt(np.mean(moved**2)) > 1.0 and 0.3 < uncubed_mm(mine, 0) < 3.0
    with pytest.raises(KeyError, match="no kind 'trap'"):
        learned_case("development", "one", "trap", 0)


@pytest.mark.long
def test_a_learned_robot_is_scored_from_its_own_recordings(tmp_path):
    case = made(("development", "learned", "one", "null", 1), tmp_path)
    row = judge_learned(case)
    assert (
        row["hidden"] == []
        and row["verdicts"] == ["nothing", "cannot_tell"]
        and row["false_identified"] is False
    )
    assert 0.0 < row["error_mm"]["noise"] < row["error_mm"]["learned"] < 5.0 and row["chain"] == []


@pytest.mark.long
@pytest.mark.parametrize("number", [12, 15, 19])
def test_what_a_map_cannot_follow_is_no_new_static_effect(tmp_path, number):
    """The cables of these fingers fall slack: a polynomial is off by 1.3 to 1.6 mm, on every run as
    much.
    """
    row = judge_learned(made(("development", "learned", "one", "null", number), tmp_path))
    assert (
        row["background_mm"] > 1.2
        and row["named"] == []
        and row["verdict"] in ("nothing", "cannot_tell")
    )


def test_a_law_that_learning_left_open_is_not_identified():
    document = {"effects": [], "alternatives": [], "families": [], "verdict": "cannot_tell"}
    other = Alternative("hysteresis", "memory", 1.0)
    known = LearnedIn("backlash", "memory", "identified", 3.0, 1.0, (), (other,))
    unknown = LearnedIn("", "rate", "unknown", 3.0, 1.0)
    sure, unsure = (
        together([one, unknown], document) for one in (known, replace(known, law="open"))
    )
    assert (
        sure["verdict"] == "identified"
        and sure["alternatives"] == []
        and sure["effects"][0]["probability"] == 1.0
    )
    assert unsure["verdict"] == "ambiguous" and unsure["effects"][0]["probability"] == 0.5
    assert [one["effects"] for one in unsure["alternatives"]] == [["hysteresis"]]
    assert together([unknown], document) == document


def test_a_cable_in_its_sheath_never_moves_on_while_its_servo_turns_back():
    d = np.concatenate([np.linspace(0.0, 10.0, 500), np.linspace(10.0, 4.0, 300)])[:, None] * [
        1.0,
        0.5,
    ]
    out = SheathFriction((0.3, 0.1), 2.0).pull(None, d)
    assert np.diff(out[500:], axis=0).max() <= 1e-3 and np.abs(out - d).max() > 1.0
