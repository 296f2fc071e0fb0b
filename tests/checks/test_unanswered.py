"""Runs whose commands and motion contradict each other are not sound; others are."""

import numpy as np
import pytest
from lost_markers import BUT_ALSO, GOOD, SINES, STAIRS, K, T, body

from softmap_edge.checks.unanswered import unanswered
from softmap_edge.cli import main
from softmap_edge.run.run import Run


def run(points, u, **more):
    return Run(t=T, command=u, t_seen=T, markers=points, **more)


NEVER = {
    "zero": (body(SINES), 0 * SINES),
    "three": (body(SINES, noise=0), 0 * SINES + 3.0),
    "on stairs": (body(STAIRS), 0 * SINES - 1.5),
    "one marker, one command": (body(SINES, count=1, noise=0.5), 0 * SINES[:, :1]),
}
STILL = {
    "noise": (body(0 * SINES), SINES),
    "no noise": (body(0 * SINES, noise=0), SINES),
    "much noise": (body(0 * SINES, noise=2.0), STAIRS),
    "whole millimetres": (body(0 * SINES, noise=0.6, digits=0), SINES),
    "one marker": (body(0 * SINES, count=1), SINES),
}


@pytest.mark.parametrize("name", [*NEVER, *STILL])
def test_such_a_run_is_not_sound(name, tmp_path, capsys):
    points, u = (NEVER | STILL)[name]
    text = unanswered(run(points, u))
    assert (
        "the commands never change, but the points move"
        if name in NEVER
        else "the points do not move"
    ) in text
    run(points, u).save(tmp_path / "run.npz")
    assert main(["check", str(tmp_path / "run.npz")]) == 1
    out, err = capsys.readouterr()
    assert out.startswith("not sound") and text[:30] in err and "+ " not in out


@pytest.mark.parametrize(
    "name", [name for name in [*GOOD, *BUT_ALSO] if name not in ("no commands", "it never moves")]
)
def test_runs_that_answer_are_sound(name):
    points, u = (GOOD | BUT_ALSO)[name]
    if u is not None:
        assert unanswered(run(points, u)) is None


def test_little_motion_and_other_causes():
    for size in (0.3, 0.05):  # as large as the noise, and far below it
        assert unanswered(run(body(size * SINES / 8, noise=0.05), SINES)) is None
    assert unanswered(run(body(0 * SINES), 0 * SINES)) is None
    assert unanswered(run(body(SINES), 0 * SINES, load=20 + 10 * np.sin(T))) is None
    assert unanswered(run(body(SINES), np.zeros((K, 0)))) is None
    plane = body(SINES)
    plane[..., 1] = 0.0
    assert unanswered(run(plane, SINES)) is None
