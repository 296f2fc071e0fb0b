"""A run is cut and joined: nothing is lost, nothing is moved, and what does not fit is refused with
both values.
"""

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sound_run import sound

from softmap_edge import Run, builtin_model, join_runs
from softmap_edge.cli import main
from softmap_edge.errors import RunError
from softmap_edge.run.contents import contents, lines
from softmap_edge.run.cut import cut
from softmap_edge.run.pieces import pieces


def recording(seed=0, **change):
    """Two clocks, labels, an orientation for each row, hidden points, an unknown field of rows and
    one of frames.
    """
    rng = np.random.default_rng(seed)
    t, t_seen = np.arange(400) * 0.05, 0.013 + np.arange(150) * 0.13
    gravity = np.tile([0.0, 0.0, 1.0], (400, 1))
    values = dict(
        t=t,
        command=np.stack([8.0 * np.sin(t), 5.0 * np.cos(0.7 * t)], axis=1),
        gravity=gravity,
        temperature=np.full(400, 22.0),
        t_seen=t_seen,
        markers=rng.normal(0, 1, (150, 3, 3))
        + [[[0, 0, 30]], [[0, 0, 60]], [[0, 0, 90]]][seed % 3],
        visible=rng.random((150, 3)) > 0.1,
        block=np.repeat(["slow", "fast", "slow"], 50),
        robot="arm",
        extra={
            "volts": rng.normal(12, 1, 400),
            "light": rng.normal(5, 1, (150, 2)),
            "made_from": np.array("log"),
            "base_markers": rng.normal(0, 1, (150, 4, 3)),
        },
    )
    return Run(**(values | change))


def outputs():
    t = np.arange(200) * 0.1
    return Run.of_outputs(
        np.stack([np.sin(t), np.cos(t)], axis=1),
        "N",
        ("pull", "push"),
        t_seen=t,
        t=t,
        command=np.sin(t)[:, None],
    )


def clouds(seed=0):
    t = np.arange(60) * 0.5
    counts = np.random.default_rng(seed).integers(0, 9, 60)
    points = np.random.default_rng(seed).normal(0, 30, (int(counts.sum()), 3))
    ticks = np.stack([np.arange(60), 9 * np.arange(60) % 40], axis=1)
    return Run(t=t, ticks=ticks, t_seen=t, points=points, start=np.r_[0, np.cumsum(counts)])


def same(one, other, *, without=()):
    a, b = one.arrays(), other.arrays()
    drop = {"piece_origin", "piece_row", "piece_frame", "piece_shift_s", *without}
    assert set(a) - drop == set(b) - drop
    for name in set(a) - drop:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


@pytest.mark.parametrize(
    "run", [recording(), outputs(), clouds(), sound(), recording(block=None)], ids=range(5)
)
@pytest.mark.parametrize("seed", range(4))
def test_the_pieces_of_a_run_are_the_run(run, seed):
    """Cut anywhere, also at a row or a frame, and joined in order: the same arrays to the last
    bit.
    """
    rng = np.random.default_rng(seed)
    # of each piece but the first
    first = np.sort(rng.choice(np.arange(1, run.frames), 4, replace=False))
    share = np.r_[rng.uniform(0.0, 1.0, 2), 1.0, 1.0]  # between two frames, or at one
    at = run.t_seen[first - 1] + np.maximum(share, 1e-3) * (
        run.t_seen[first] - run.t_seen[first - 1]
    )
    at[2:] = run.t_seen[first[2:]]
    edges = [None, *at.tolist(), None]
    parts = [cut(run, a, b) for a, b in zip(edges, edges[1:])]
    whole = join_runs(parts)
    same(whole, run)
    assert [piece.origin for piece in pieces(whole)] == [run.hash()]
    same(join_runs([join_runs(parts[:2]), *parts[2:]]), run)


def test_a_piece_keeps_times_labels_and_the_hash_of_its_recording():
    run = recording()
    part = run.cut(5.0, 9.0)
    inside = (run.t_seen >= 5.0) & (run.t_seen < 9.0)
    np.testing.assert_array_equal(part.t_seen, run.t_seen[inside])
    np.testing.assert_array_equal(part.block, run.block[inside])
    np.testing.assert_array_equal(part.extra["light"], run.extra["light"][inside])
    assert part.extra["volts"].shape == part.t.shape and part.extra["base_markers"].shape == (
        part.frames,
        4,
        3,
    )
    again = part.cut(6.0, 7.0)
    assert {piece.origin for piece in (*pieces(part), *pieces(again))} == {run.hash()}
    for t in part.t_seen:
        np.testing.assert_allclose(part.command_at(t), run.command_at(t), atol=1e-12)


def test_a_block_is_its_frames_wherever_they_lie():
    run = recording()
    fast, slow = run.cut(block="fast"), run.cut(block="slow")
    np.testing.assert_array_equal(fast.t_seen, run.t_seen[50:100])
    np.testing.assert_array_equal(slow.t_seen, np.r_[run.t_seen[:50], run.t_seen[100:]])
    # the gap between them is a border
    assert slow.block.tolist() == ["1:slow"] * 50 + ["2:slow"] * 50
    numbered = sound()
    assert numbered.cut(block=1).block.tolist() == [1] * 4


def test_the_memory_before_a_piece_is_kept_with_its_commands():
    """Creep is not the same without what came before; with the lead it is."""
    model = builtin_model().with_effects(["creep"], {"creep.strength": 0.5, "creep.tau": 4.0})
    t = np.arange(300) * 0.1
    run = Run(t=t, command=np.stack([np.where(t < 12, 12.0, 3.0), 0 * t], axis=1), t_seen=t[5::10])
    whole = model.predict(run)[run.t_seen >= 15.0]
    lost, kept = (model.predict(run.cut(15.0, lead_s=lead)) for lead in (0.0, 100.0))
    np.testing.assert_allclose(kept, whole, atol=1e-9)
    assert np.abs(lost - whole).max() > 0.5


def test_runs_of_two_days_are_joined_with_a_gap_and_a_border():
    one, two = recording(0), recording(1, block=None, robot=None)
    whole = join_runs([one, two], gap_s=20.0)
    assert whole.frames == 300 and len(whole.t) == 800
    assert whole.t_seen[150] - two.t_seen[0] == pytest.approx(whole.t[400] - two.t[0])
    assert whole.t[400] - max(one.t[-1], one.t_seen[-1]) == pytest.approx(20.0)
    assert list(dict.fromkeys(whole.block.tolist())) == ["1:slow", "1:fast", "2"]
    assert [piece.origin for piece in pieces(whole)] == [one.hash(), two.hash()]
    for k, run in enumerate((one, two)):
        again = whole.cut(block="2") if k else whole.cut(None, whole.t[400])
        np.testing.assert_array_equal(again.markers, run.markers)
        assert {piece.origin for piece in pieces(again)} == {run.hash()}


@pytest.mark.parametrize(
    "change",
    [
        dict(gravity=np.where(np.arange(400)[:, None] < 200, [0.0, 0.0, 1.0], [0.0, 1.0, 0.0])),
        dict(temperature=np.where(np.arange(400) < 200, 20.0, 31.0)),
        dict(t_seen=np.r_[np.arange(75) * 0.13, 12.0 + np.arange(75) * 0.1]),
    ],
    ids=["turned", "warmed", "gap"],
)
def test_a_turn_a_change_of_temperature_and_a_gap_are_borders(change):
    plain = join_runs([recording(0, block=None), recording(1, block=None)])
    assert set(plain.block.tolist()) == {"1", "2"}
    found = join_runs([recording(0, block=None, **change), recording(1, block=None)])
    assert list(dict.fromkeys(found.block.tolist())) == ["1", "1/2", "2"]
    border = int(np.flatnonzero(found.block == "1/2")[0])
    assert border in (75, 77)  # the first frame after 10 s


def test_clouds_and_outputs_of_another_scale_are_joined():
    both = join_runs([clouds(0), clouds(1)])
    assert both.frames == 120 and both.start[-1] == len(both.points)
    one, two = outputs(), outputs()
    two = Run.of_outputs(
        3.0 * two.outputs, "N", ("pull", "push"), t_seen=two.t_seen, t=two.t, command=two.command
    )
    whole = join_runs([one, two])
    assert one.output.mm_per_unit != two.output.mm_per_unit
    np.testing.assert_allclose(whole.outputs, np.concatenate([one.outputs, two.outputs]), atol=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(robot="finger"), ["finger", "arm", "robot"]),
        (dict(command=np.zeros((400, 3))), ["3 command channels", "first run 2"]),
        (dict(command_unit="deg"), ["deg as the unit", "first run mm"]),
        (dict(command=None, ticks=np.zeros((400, 2), int)), ["ticks", "kind of its commands"]),
        (
            dict(markers=np.random.default_rng(0).normal(0, 9, (150, 4, 3)), visible=None),
            ["4 points", "first run 3"],
        ),
        (dict(markers=None, visible=None), ["nothing", "markers", "what was seen"]),
        (
            dict(temperature=None),
            ["temperature: run 1 holds it, run 2 does not", "--drop temperature"],
        ),
        (
            dict(current=np.ones((400, 2))),
            ["current: run 2 holds it, run 1 does not", "--drop current"],
        ),
        (dict(gravity=None), ["gravity", "--drop gravity"]),
        (dict(timeless=True), ["rows without time"]),
        (dict(extra={"volts": np.zeros(7)}), ["--drop"]),
    ],
)
def test_what_does_not_fit_is_refused_with_both_values(change, words):
    with pytest.raises(RunError) as fault:
        join_runs([recording(0), recording(1, **change)])
    assert all(word in str(fault.value) for word in words), fault.value


def test_what_is_left_out_is_asked_for():
    one, two = recording(0), recording(1, temperature=None)
    assert join_runs([one, two], drop=["temperature"]).temperature is None
    for wrong in (["t"], ["markers"], ["command"]):
        with pytest.raises(RunError, match="cannot be left out"):
            join_runs([one, two], drop=wrong)


def test_the_same_frames_are_not_joined_twice():
    run = recording()
    for parts in (
        [run, run],
        [run.cut(0, 5), run.cut(4, 9)],
        [run.cut(0, 5), run.cut(9, 12), run.cut(3, 4)],
        [run, run.cut(3, 5)],
    ):
        with pytest.raises(RunError, match="both hold .* of recording"):
            join_runs(parts)


def test_nonsense_is_one_line():
    run = recording()
    for wrong, words in (
        (lambda: run.cut(9.0, 5.0), "ends before it begins"),
        (lambda: run.cut(500.0), "the run ends at 19.95 s, before --from 500"),
        (lambda: run.cut(block="fist"), "did you mean 'fast'"),
        (lambda: run.cut(1.0, block="fast"), "not both"),
        (lambda: run.cut(1.0, lead_s=-1.0), "lead_s: -1"),
        (lambda: run.cut(float("nan")), "ends before it begins"),
        (lambda: recording(block=None).cut(block="fast"), "has no blocks"),
        (lambda: join_runs([run]), "1 run to join"),
        (lambda: join_runs([run, recording(1)], gap_s=float("nan")), "gap_s"),
    ):
        with pytest.raises(RunError, match=words):
            wrong()


@pytest.mark.parametrize(
    "change",
    [
        dict(piece_row=np.array([9999])),
        dict(piece_row=np.array([3])),
        dict(piece_origin=np.array(["x" * 64])),
        dict(piece_origin=np.array([5])),
        dict(piece_shift_s=np.array([np.nan])),
        dict(piece_frame=np.array([0, 1])),
        dict(piece_row=None),
    ],
)
def test_a_damaged_origin_is_refused(change, tmp_path, capsys):
    part = recording().cut(2.0, 6.0)
    extra = {name: value for name, value in (part.extra | change).items() if value is not None}
    replace(part, extra=extra).save(tmp_path / "bad.npz")
    assert main(["run", "show", str(tmp_path / "bad.npz")]) == 2
    assert "do not fit the rows and frames" in capsys.readouterr().err


def test_the_commands_cut_join_and_show(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = recording()
    run.save("run.npz")
    assert (
        main(
            [
                "run",
                "cut",
                "run.npz",
                "--from",
                "0",
                "--to",
                "8",
                "--from",
                "8",
                "--to",
                "99",
                "--out",
                "p.npz",
            ]
        )
        == 0
    )
    out = capsys.readouterr().out
    assert "p_1.npz: 0.013 to 7.943 s" in out and "--lead" in out
    assert main(["run", "join", "p_1.npz", "p_2.npz", "--out", "whole.npz", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "softmap.join/1" and document["frames"] == 150
    same(Run.load("whole.npz"), run)
    assert main(["run", "show", "whole.npz"]) == 0
    shown = capsys.readouterr().out
    for words in (
        "2 channels in mm",
        "3 markers",
        "slow: 100 frames",
        f"recording {run.hash()[:12]}: 400 rows",
        "22 °C",
    ):
        assert words in shown
    assert main(["run", "show", "run.npz", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["origin"][0]["recording"] == run.hash()
    assert main(["run", "cut", "run.npz", "--block", "fast", "--out", "whole.npz"]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["run", "cut", "run.npz", "--block", "fast", "--out", "whole.npz", "--force"]) == 0
    assert Run.load("whole.npz").frames == 50


@pytest.mark.parametrize(
    "argv",
    [
        ["run"],
        ["run", "cut", "run.npz", "--out", "a.npz"],
        ["run", "cut", "run.npz", "--from", "1", "--from", "2", "--to", "3", "--out", "a.npz"],
        ["run", "cut", "run.npz", "--from", "x", "--out", "a.npz"],
        ["run", "cut", "run.npz", "--block", "fast", "--to", "3", "--out", "a.npz"],
        ["run", "cut", "run.npz", "--from", "1", "--out", "a.csv"],
        ["run", "join", "run.npz", "--out", "a.npz"],
        ["run", "join", "run.npz", "run.npz", "--out", "a.npz"],
        ["run", "show", "nowhere.npz"],
    ],
)
def test_wrong_use_writes_nothing(argv, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    recording().save("run.npz")
    assert main(argv) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["run.npz"]


def test_the_commands_of_the_page_run_and_print_what_it_shows(tmp_path, monkeypatch, capsys):
    """docs/do/runs.md, with two recordings of 50 s."""
    page = (Path(__file__).parents[2] / "docs/do/runs.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for day in (1, 2):
        t = np.arange(2500 + 500 * (day == 1)) * 0.02
        seen = t[::5]
        rest = np.random.default_rng(day).normal(0, 1, (len(seen), 3, 3)) + [
            [0, 0, 30],
            [0, 0, 60],
            [0, 0, 90],
        ]
        command = np.stack([8.0 * np.sin(t), 5.0 * np.cos(0.7 * t)], axis=1)
        block = np.where(seen < 30.0, "slow", "fast")
        Run(t=t, command=command, t_seen=seen, markers=rest, block=block, robot="arm").save(
            f"day{day}.npz"
        )
    commands, shown = re.findall(r"```(?:text)?\n(.*?)```", page, re.DOTALL)[:2]
    for line in commands.strip().splitlines():
        capsys.readouterr()
        assert main(shlex.split(line)[1:]) == 0, line
    printed = re.sub(r"[0-9a-f]{12,}", "HASH", capsys.readouterr().out).splitlines()
    assert printed[:-2] == re.sub(r"[0-9a-f]{12,}", "HASH", shown).splitlines()
    assert printed[-2].startswith("hash ") and printed[-1] == "next: softmap check both.npz"
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(code, {})
    assert Run.load("both.npz").frames == 800


@pytest.mark.parametrize("start", [25.0, 200.0, 9e5])
def test_a_cut_beyond_the_end_names_the_end(start):
    with pytest.raises(RunError, match=rf"the run ends at 19.95 s, before --from {start:g}"):
        cut(recording(), start)
    with pytest.raises(RunError, match="ends before it begins"):
        cut(recording(), start, 20.0)


@pytest.mark.parametrize("rows", [40, 200, 4500])
def test_a_run_without_time_is_listed_by_rows(rows):
    t = np.arange(rows) * 0.05
    block = np.repeat([0, 1], rows // 2)
    run = Run(
        t=t,
        t_seen=t,
        command=np.sin(t)[:, None],
        timeless=True,
        block=block,
        markers=np.cumsum(np.ones((rows, 2, 3)), axis=0) + [[[0, 0, 0], [0, 0, 9]]],
    )
    text = "\n".join(lines(contents(run)))
    assert (
        f"1: {rows // 2} frames from row {rows // 2} to {rows - 1}" in text
        and f"row 0 to {rows - 1}" in text
    )
    assert not re.search(r"\d s\b", text)
