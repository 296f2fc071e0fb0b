"""Runs of no points, no frames or no commands to speak of are refused or read without a warning."""

import warnings

import numpy as np
import pytest

from softmap_edge.checks.summary import summary
from softmap_edge.cli import main
from softmap_edge.errors import RunError
from softmap_edge.files.npz import write_npz
from softmap_edge.run.run import Run

T = np.arange(200) / 20
U = np.stack([1 + np.sin(T), 1 - np.cos(T)], axis=1)
BODY = np.stack([U[:, :1] * [5, 9], U[:, 1:] * [5, 9], 50 + 0 * U[:, :1] + [0, 50]], axis=2)

EMPTY = {
    "no markers": {"t_seen": T, "markers": np.zeros((200, 0, 3))},
    "no vertices": {"t_seen": T, "vertices": np.zeros((200, 0, 3))},
    "no frames of markers": {"t_seen": T[:0], "markers": np.zeros((0, 4, 3))},
    "no frames of vertices": {"t_seen": T[:0], "vertices": np.zeros((0, 0, 3))},
    "no points in any cloud": {"t_seen": T[:2], "points": np.zeros((0, 3)), "start": np.zeros(3)},
}
TINY = {
    "denormal": 1e-310 * U,
    "squares are no numbers": 1e-170 * U,
    "about a level": 3.0 + 1e-13 * U,
    "one channel": U * [1, 1e-310],
}


@pytest.mark.parametrize("command", ["check", "learn", "compare"])
@pytest.mark.parametrize("case", EMPTY)
def test_empty_arrays_are_one_error(command, case, tmp_path, capsys):
    path = tmp_path / "run.npz"
    write_npz(path, {"t": T, "command": U} | EMPTY[case])
    out = ["--out", str(tmp_path / "out")] if command == "learn" else []
    assert main([command, str(path), *out]) != 0
    printed = "".join(capsys.readouterr())
    name = [*EMPTY[case]][1]
    assert f"{name}: shape" in printed and "is empty" in printed and len(printed.splitlines()) == 1


def test_a_run_made_in_python_needs_a_point():
    with pytest.raises(RunError, match=r"markers: shape \(200, 0, 3\) holds no point"):
        Run(t=T, command=U, **EMPTY["no markers"])


@pytest.mark.parametrize("case", TINY)
def test_commands_that_hardly_change_are_constant(case, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = Run(t=T, command=TINY[case], present=TINY[case], t_seen=T, markers=BODY)
        moving = np.ptp(run.command, axis=0) > 0
        assert moving.tolist() == [case == "one channel", False]
        assert (np.ptp(run.present, axis=0) > 0).tolist() == moving.tolist()
        assert np.abs(run.command - TINY[case]).max() < 1e-9
        summary(run)
    run.save(tmp_path / "run.npz")
    assert Run.load(tmp_path / "run.npz").hash() == run.hash()


@pytest.mark.parametrize("case", TINY)
def test_commands_that_hardly_change_are_checked(case, tmp_path, capsys):
    path = tmp_path / "run.npz"
    write_npz(path, {"t": T, "command": TINY[case], "t_seen": T, "markers": BODY})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        main(["check", str(path)])
    printed = "".join(capsys.readouterr())
    assert ("the commands never change" in printed) == (case != "one channel")


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_commands_that_change_stay_as_they_are(size):
    run = Run(t=T, command=size * U, command_unit="unit", t_seen=T, markers=BODY)
    assert np.array_equal(run.command, size * U)
