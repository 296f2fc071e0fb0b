"""`check`, `compare` and `diagnose` state one noise of the points: the same digits, from the same
repeats.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from recorded_arms import arc

from softmap_edge import Run, builtin_model, learn_model, save_bundle
from softmap_edge.cli import main
from softmap_edge.files.numbers import mm
from softmap_edge.noise.floor import noise_of_points


def held(seed=0, noise=0.2, unit="mm", encoders=0.0, dwell=30):
    """An arm that rests at five places and home, seen 10 times a second; encoders flicker by
    `encoders`.
    """
    rng = np.random.default_rng(seed)
    places = np.array([[0, 0], [6, 2], [0, 0], [-5, 4], [3, -6], [0, 0], [6, 2], [-5, 4]], float)
    goal = np.repeat(np.tile(places, (3, 1)) * (1.0 + 0.1 * seed), dwell, axis=0)
    t = np.arange(len(goal)) * 0.1
    seen = arc(goal) + rng.normal(0, noise, (len(t), 3, 3))
    present = goal + encoders * rng.integers(-1, 2, goal.shape) if encoders else None
    return Run(
        t=t, command=goal, present=present, command_unit=unit, t_seen=t, markers=seen, robot="arm"
    )


def moving(seed=0, seconds=40.0):
    """Nothing is seen twice."""
    t = np.arange(0.0, seconds, 0.1)
    goal = np.stack([7 * np.sin(0.7 * t), 6 * np.sin(1.13 * t + seed)], axis=1)
    return Run(
        t=t,
        command=goal,
        t_seen=t,
        markers=arc(goal) + np.random.default_rng(seed).normal(0, 0.2, (len(t), 3, 3)),
        robot="arm",
    )


RUNS = {
    "plain": held(1),
    "noisy": held(2, noise=0.6),
    "degrees": held(3, unit="deg"),
    "encoders": held(4, encoders=0.02),
    "hidden": replace(held(5), visible=np.random.default_rng(0).random((720, 3)) > 0.2),
    "moving": moving(1),
    "short": moving(1, 3.0),
}


def stated(capsys, *argv):
    assert main([*map(str, argv)]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("name", RUNS)
def test_three_commands_state_the_noise_of_a_run_alike(name, tmp_path, capsys):
    run = RUNS[name]
    run.save(tmp_path / "run.npz")
    teacher = (
        moving() if name in ("moving", "short") else replace(held(0), command_unit=run.command_unit)
    )
    save_bundle(learn_model(teacher, static=True, input="goal"), tmp_path / "b")
    compared = json.loads(
        stated(capsys, "compare", tmp_path / "run.npz", "--bundle", tmp_path / "b", "--json")
    )
    argv = ["diagnose", tmp_path / "run.npz", "--bundle", tmp_path / "b", "--effects", "offset"]
    diagnosed = json.loads(stated(capsys, *argv, "--json"))
    checked = json.loads(stated(capsys, "check", tmp_path / "run.npz", "--json"))
    reported = [word for word in checked["can_tell"] if word["about"] == "noise"]
    number = noise_of_points(run)
    (of_diagnosis,) = diagnosed["made_from"]["noise_of_points_mm"]
    if number is None:
        assert name == "short" and not reported and of_diagnosis is None
        assert "no replicates" in compared["made_from"]["noise_floor"]
        assert any("too few repeated poses" in remark for remark in diagnosed["remarks"])
        return
    assert compared["noise_floor_mm"] == of_diagnosis == number.mm
    assert f"the noise is {number.mm:.2g} mm" in reported[0]["text"]
    assert not any("too few repeated poses" in remark for remark in diagnosed["remarks"])
    text = " ".join(stated(capsys, *argv).split())
    assert re.search(
        rf"noise of a point, as `softmap check` and `softmap compare` report it: {mm(number.mm)} mm RMS",
        text,
    )


def test_each_of_several_runs_has_its_own(tmp_path, capsys):
    for k, name in enumerate(("plain", "noisy")):
        RUNS[name].save(tmp_path / f"{k}.npz")
    save_bundle(learn_model(held(0), static=True), tmp_path / "b")
    argv = [
        "diagnose",
        tmp_path / "0.npz",
        tmp_path / "1.npz",
        "--bundle",
        tmp_path / "b",
        "--effects",
        "offset",
        "--json",
    ]
    found = json.loads(stated(capsys, *argv))["made_from"]["noise_of_points_mm"]
    assert found == [noise_of_points(RUNS[name]).mm for name in ("plain", "noisy")]


def test_a_simulated_finger_states_one_number_too(tmp_path, capsys):
    """Vertices: the noise of section middles is smaller, and is another line of the report."""
    model, rng = builtin_model(), np.random.default_rng(0)
    goal = np.repeat(np.array([[0, 0], [8, 0], [0, 0], [0, 8], [-8, 0], [0, 0]], float), 20, axis=0)
    t = np.arange(len(goal)) * 0.2
    blank = Run(t=t, command=goal, t_seen=t, robot=model.robot)
    points = model.predict(blank)
    run = replace(blank, vertices=points + rng.normal(0, 0.3, points.shape))
    run.save(tmp_path / "run.npz")
    compared = json.loads(stated(capsys, "compare", tmp_path / "run.npz", "--json"))
    diagnosed = json.loads(
        stated(capsys, "diagnose", tmp_path / "run.npz", "--effects", "offset", "--json")
    )
    assert diagnosed["made_from"]["noise_of_points_mm"] == [compared["noise_floor_mm"]]
    assert diagnosed["error"]["noise_floor"] < compared["noise_floor_mm"]
