"""Runs that are joined although they follow one another in time, or hold the same data, are
reported.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import Run, join_runs
from softmap_edge.cli import main
from softmap_edge.run.cut import cut
from softmap_edge.run.join_doubts import join_doubts


def run_of(first, count, seed=0, points=3, rate=50, **change):
    """Rows `first` to `first + count` of one long experiment, as an importer of each part would
    give them.
    """
    t = np.arange(first, first + count) / rate
    noise = np.random.default_rng(seed).normal(0, 0.1, (10_000, points, 3))[first : first + count]
    u = np.stack([8 * np.sin(t), 5 * np.cos(0.7 * t)], axis=1)
    seen = noise + np.stack([u[:, :1], u[:, 1:], 50 + 0 * u[:, :1]], axis=2)
    return Run(t=t, t_seen=t, command=u, markers=seen, **change)


@pytest.mark.parametrize(
    ("begin", "gap", "words"),
    [
        (500, 10.0, "import their logs together"),
        (501, 10.0, "import their logs together"),
        (600, 10.0, "--gap 2.02 keeps the true pause"),
        (2000, 10.0, "--gap 30.02 keeps the true pause"),
        (4999, 5.0, "--gap 90 keeps the true pause"),
    ],
)
def test_runs_that_follow_one_another_in_time_are_reported(begin, gap, words):
    found = join_doubts([run_of(0, 500), run_of(begin, 300)], gap)
    assert len(found) == 1 and "runs 1 and 2 follow one another" in found[0] and words in found[0]


def test_other_orders_and_recordings_are_not_reported():
    one, later = run_of(0, 500), run_of(600, 300)
    assert join_doubts([later, one], 10.0) == []  # time goes back
    assert join_doubts([one, run_of(0, 500, seed=1)], 10.0) == []  # each begins at 0
    assert join_doubts([one, later], 2.02) == []  # the pause is kept
    # another day
    assert (
        join_doubts([one, replace(later, t=later.t + 1e5, t_seen=later.t_seen + 1e5)], 10.0) == []
    )
    assert join_doubts([cut(one, 0, 3), cut(one, 5, 9)], 10.0) == []  # pieces keep their clock


@pytest.mark.parametrize("points", [1, 3, 12])
@pytest.mark.parametrize("begin", [450, 250, 0])
def test_frames_in_both_runs_are_named(points, begin):
    one, other = run_of(0, 500, points=points), run_of(begin, 500, points=points)
    found = join_doubts([one, other], 10.0)
    assert len(found) == 1
    assert (
        f"{500 - begin} frames have equal values in runs 1 and 2 ({begin / 50:g} to 9.98 s of run 1"
        in found[0]
    )


def test_frames_that_a_third_run_repeats_are_found_whatever_its_clock():
    one, two = run_of(0, 300), run_of(0, 300, seed=1)
    moved = run_of(200, 300)
    third = Run(
        t=moved.t + 1e6, t_seen=moved.t_seen + 1e6, command=moved.command, markers=moved.markers
    )
    found = [line for line in join_doubts([one, two, third], 10.0) if "equal values" in line]
    assert len(found) == 1 and "100 frames have equal values in runs 1 and 3" in found[0]


def test_rows_of_encoders_in_both_runs_are_named():
    def rows(first):
        t = np.arange(first, first + 200) / 50
        ticks = np.stack([1000 * np.sin(t), 800 * np.cos(1.3 * t)], axis=1)
        return Run(
            t=t,
            t_seen=t[:0],
            ticks=np.rint(ticks),
            present_ticks=np.rint(ticks - 3 * np.cos(9 * t)[:, None]),
        )

    found = join_doubts([rows(0), rows(150)], 10.0)
    assert len(found) == 1 and "50 rows have equal values in runs 1 and 2" in found[0]


def test_repeats_that_are_no_copies_are_not_named():
    one, other = run_of(0, 400), run_of(0, 400, seed=5)
    still = np.array(one.markers)
    still[:] = still[0] + [[0, 0, 0], [0, 0, 9], [0, 0, 18]]
    rest = Run(t=one.t, t_seen=one.t_seen, command=one.command, markers=still)
    assert join_doubts([rest, rest], 10.0) == []  # a simulation at rest
    assert join_doubts([one, other], 10.0) == []  # one protocol, another noise
    bare = Run(t=one.t, t_seen=one.t[:0], command=one.command)
    assert join_runs([bare, replace(bare, command=2 * bare.command)]).channels == 2
    assert join_doubts([bare, bare], 10.0) == []  # the same commands may be sent twice
    coarse = [
        Run.of_outputs(
            np.rint(3 * np.sin(k + run.t))[:, None],
            "N",
            ["force"],
            t=run.t,
            t_seen=run.t,
            command=run.command,
        )
        for k, run in enumerate((one, other))
    ]
    assert join_doubts(coarse, 10.0) == []


def test_the_command_prints_them(tmp_path, capsys):
    run_of(0, 500).save(tmp_path / "a.npz")
    run_of(450, 500).save(tmp_path / "b.npz")
    run_of(960, 40).save(tmp_path / "c.npz")
    names = [str(tmp_path / f"{name}.npz") for name in "abc"]
    assert main(["run", "join", *names, "--out", str(tmp_path / "j.npz")]) == 0
    text = capsys.readouterr().out
    assert text.count("look at   ") == 2 and "50 frames have equal values in runs 1 and 2" in text
    assert main(["run", "join", *names, "--out", str(tmp_path / "j.npz"), "--force", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["doubts"]) == 2
