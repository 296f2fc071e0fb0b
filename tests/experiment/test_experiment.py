"""Blocks of commands within a robot's limits, one condition at a time; command files written, read
and played.
"""

import json

import numpy as np
import pytest

from softmap_edge.cli import main
from softmap_edge.errors import RunError, SoftmapError
from softmap_edge.experiment.blocks import BLOCKS, Setting, chosen, plan
from softmap_edge.robot.drive.command_file import read_commands, write_commands
from softmap_edge.run.protocol import HANGING, Limits, standard_protocol
from softmap_edge.run.run import Run

LIMITS = {
    "two pairs": Limits.even(2),
    "one tendon": Limits.of(np.array([[0.0, 8.0]]), "N"),
    "nine, slow": Limits.of(np.tile([-5.0, 5.0], (9, 1)), "mm", fastest=6.0),
    "uneven": Limits.of(np.array([[-16.0, 16.0], [0.0, 3.0], [2.0, 5.0]])),
}


@pytest.mark.parametrize("limits", LIMITS.values(), ids=LIMITS)
@pytest.mark.parametrize("block", BLOCKS.values(), ids=BLOCKS)
def test_a_block_stays_within_the_limits_and_changes_one_condition(block, limits):
    if block.channels > limits.channels:
        with pytest.raises(SoftmapError, match="moves 2 channels together, the robot has 1"):
            plan([block], limits)
        return
    made = plan([block], limits)
    assert (made.command >= limits.low - 1e-9).all() and (made.command <= limits.high + 1e-9).all()
    step = np.abs(np.diff(made.command, axis=0)) / np.diff(made.t)[:, None]
    assert (
        step <= np.maximum(limits.fast, 2 * limits.slow) * 1.001 + 1e-9
    ).all() or block.name == "circle"
    assert np.ptp(made.command[:, 0]) > 0.3 * (limits.high - limits.low)[0]
    for end in (made.command[0], made.command[-1]):
        np.testing.assert_allclose(end, limits.home, atol=1e-9)
    assert made.frames >= 12 and (np.diff(made.t_seen) > 0).all()
    changed = {
        "orientation": np.ptp(made.gravity, axis=0).max() > 0.1,
        "load": made.load is not None,
        "temperature": made.temperature is not None,
    }
    assert [name for name, yes in changed.items() if yes] == [block.changes] * (
        block.changes != "nothing"
    )
    assert bool(made.notes) == (block.changes != "nothing")  # somebody has to do it


def test_a_change_is_seen_before_and_after_it():
    """Without the same moves in the usual condition a block would change the day together with the
    condition.
    """
    for name in ("another orientation", "a known 10 g"):
        made = BLOCKS[name].plan(LIMITS["two pairs"])
        changed = made.gravity[:, 0] > 0 if made.load is None else made.load > 0
        at = np.interp(made.t_seen, made.t, changed) > 0.5
        assert 20 <= at.sum() <= made.frames - 20
        u = np.abs([np.interp(made.t_seen, made.t, c) for c in made.command.T])
        assert u[:, at].max() == pytest.approx(u[:, ~at].max(), rel=0.1)


def test_blocks_in_a_row_put_back_what_they_change():
    made = plan(
        chosen(["a warm-up", "another orientation", "a known 10 g", "circle"]), LIMITS["two pairs"]
    )
    leaning, loaded = made.gravity[:, 0] != 0, made.load > 0
    assert leaning.any() and loaded.any() and not (leaning & loaded).any()
    # what is warm stays warm: it is last
    assert made.temperature[leaning | loaded].max() == made.temperature.min()
    assert [text.split()[0] for _, text in made.notes] == ["turn", "turn", "hang", "take", "warm"]
    at_home = np.array([made.command[np.searchsorted(made.t, time)] for time, _ in made.notes])
    np.testing.assert_allclose(at_home, 0.0, atol=1e-9)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_another_orientation_is_one_that_was_not_seen(gravity):
    seen = [gravity]
    for _ in range(3):
        leaning = Setting(gravity, seen=tuple(seen)).leaning()
        assert np.linalg.norm(leaning) == pytest.approx(1.0)
        assert max(np.dot(leaning, s) for s in seen) < np.cos(np.radians(20.0))
        seen.append(leaning)


def test_the_reverse_distinguishes_orientation_from_time():
    once, back = standard_protocol(2), standard_protocol(2, back=True)
    assert back.minutes == pytest.approx(6.0, abs=0.6) and once.minutes == pytest.approx(
        4.0, abs=0.1
    )

    def with_time(made):
        return abs(
            np.corrcoef(made.t_seen, np.interp(made.t_seen, made.t, made.gravity[:, 0]))[0, 1]
        )

    assert with_time(back) < 0.3 < 0.8 < with_time(once)
    both = {sign for label in ("staircase[0]", "staircase[1]") for sign in _signs(back, label)}
    assert both == {-1.0, 1.0}
    assert np.array_equal(once.command, back.command[: len(once.command)])


def _signs(made, label):
    u = np.stack([np.interp(made.t_seen[made.block == label], made.t, c) for c in made.command.T])
    upright = np.interp(made.t_seen[made.block == label], made.t, made.gravity[:, 0]) == 0
    return set(np.sign(np.round(u[:, upright], 6)).ravel()) - {0.0}


@pytest.mark.parametrize("channels", range(1, 10))
def test_the_standard_protocol_fits_any_robot(channels):
    limits = Limits.of(np.tile([[0.0, 4.0]], (channels, 1)), "N", fastest=3.0)
    made = standard_protocol(limits=limits, back=True)
    assert made.unit == "N" and made.command.shape[1] == channels
    assert made.command.min() >= 0.0 and made.command.max() == pytest.approx(3.0)
    assert np.abs(np.diff(made.command, axis=0)).max() <= 3.0 / 50 * 1.01
    assert {label.split("[")[0] for label in made.block} >= {
        "home",
        "triangle",
        "staircase",
        "fast",
        "small loop",
    }


def test_limits_that_leave_no_room_are_named():
    for bad in (np.zeros((0, 2)), np.array([[3.0, 3.0]]), np.array([[0.0, np.nan]])):
        with pytest.raises(SoftmapError, match="no room to move"):
            Limits.of(bad)
    with pytest.raises(SoftmapError, match="fastest speed of 0 mm/s"):
        Limits.of(np.array([[-1.0, 1.0]]), fastest=0.0)
    with pytest.raises(SoftmapError, match="no block 'wave'; there are home revisits"):
        chosen(["wave"])
    with pytest.raises(SoftmapError, match="no block is asked for"):
        plan([], LIMITS["two pairs"])
    with pytest.raises(SoftmapError, match="more than 120 minutes"):
        plan([BLOCKS["a warm-up"]] * 13, LIMITS["two pairs"])


# --- the command file ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("commands") / "c.csv"
    made = plan(chosen(["another orientation", "a known 10 g"]), LIMITS["two pairs"])
    write_commands(path, made, "moe-finger")
    return path, made


def test_a_command_file_holds_the_complete_plan(written):
    path, made = written
    again, robot = read_commands(path)
    assert robot == "moe-finger" and again.unit == "mm"
    np.testing.assert_allclose(again.t, made.t, atol=1e-4)
    np.testing.assert_allclose(again.command, made.command, atol=1e-4)
    np.testing.assert_allclose(again.gravity, made.gravity, atol=1e-6)
    np.testing.assert_array_equal(again.load, made.load)
    np.testing.assert_array_equal(again.block, made.block)
    assert np.abs(again.t_seen - made.t_seen).max() <= 0.02 + 1e-4 and again.temperature is None
    assert [text for _, text in again.notes] == [text for _, text in made.notes]


SPOILT = {
    "another kind of file": (
        lambda text: "t,u0\n0,1\n",
        "no command file, the first line is 't,u0'",
    ),
    "a newer one": (
        lambda text: text.replace("commands 1;", "commands 2;"),
        "version 2, version 1 is read",
    ),
    "a column less": (lambda text: text.replace(",look", "", 1), "columns t,u0,u1"),
    "a word": (
        lambda text: text.replace("\n0.0200,0.0000", "\n0.0200,zero"),
        "row 2: u0 is 'zero'",
    ),
    "not a number": (
        lambda text: text.replace("\n0.0200,0.0000", "\n0.0200,nan"),
        "row 2: u0 is 'nan'",
    ),
    "time that stands": (
        lambda text: text.replace("\n0.0200", "\n0.0000"),
        "row 2: time 0 s after 0 s",
    ),
    "weightless": (lambda text: text.replace("1.0000000", "0.0000000", 1), "row 1: gravity of 0 g"),
    "a cell more": (
        lambda text: text.replace("\n0.0400", "\n0.0400,1"),
        "row 3 has 12 cells, the header 11",
    ),
    "one row": (lambda text: "\n".join(text.split("\n")[:3]), "1 rows of commands; 2 to"),
    "looks twice": (lambda text: text.replace(",,1,", ",,2,", 1), "look is 0 or 1, got 2"),
    "warm at times": (
        lambda text: text.replace(",0,,", ",0,20,", 1),
        "temperature_c is given in some rows only",
    ),
}


@pytest.mark.parametrize(("spoil", "reported"), SPOILT.values(), ids=SPOILT)
def test_a_bad_command_file_is_named_in_one_line(spoil, reported, written, tmp_path, capsys):
    text = written[0].read_text()
    assert spoil(text) != text
    (tmp_path / "bad.csv").write_text(spoil(text))
    with pytest.raises(RunError) as fault:
        read_commands(tmp_path / "bad.csv")
    assert reported in str(fault.value) and "\n" not in str(fault.value)
    assert (
        main(["record", str(tmp_path / "bad.csv"), "--sim", "--out", str(tmp_path / "r.npz")]) == 2
    )
    assert reported in capsys.readouterr().err and not (tmp_path / "r.npz").exists()


# --- record -------------------------------------------------------------------------------------


def test_a_plan_is_played_on_the_simulated_finger(tmp_path, capsys):
    """The load that a block hangs is there: it moves the tip as the same weight, hidden, does."""
    made = plan(chosen(["a known 10 g"]), Limits.even(2, 3.0))
    made = _cut(made)
    write_commands(tmp_path / "c.csv", made, "moe-finger")
    argv = [
        "record",
        str(tmp_path / "c.csv"),
        "--sim",
        "--json",
        "--out",
        str(tmp_path / "run.npz"),
    ]
    assert main(argv) == 0
    reported = json.loads(capsys.readouterr().out)
    run = Run.load(tmp_path / "run.npz")
    assert (
        reported["schema"] == "softmap.record/1"
        and reported["hash"] == run.hash()
        and reported["frames"] == run.frames
    )
    assert run.load.max() == 10.0 and set(run.block) == set(made.block)
    np.testing.assert_allclose(run.command, made.command, atol=1e-4)
    sag = run.vertices[-1] - run.vertices[0]
    assert 0.05 < np.abs(sag.mean(axis=0)).max() < 5.0
    assert main(argv) == 2 and "a run stands there" in capsys.readouterr().err
    (tmp_path / "run.npz").unlink()
    assert main(argv) == 0 and json.loads(capsys.readouterr().out)["hash"] == run.hash()
    (tmp_path / "run.npz").unlink()
    assert (
        main([*argv, "--noise-seed", "1"]) == 0
        and json.loads(capsys.readouterr().out)["hash"] != run.hash()
    )


def _cut(made):
    """The first and the last frame, at home and at home under load: two equilibria instead of
    sixty.
    """
    from dataclasses import replace

    leaning = replace(made, gravity=np.tile([0.6, 0.0, 0.8], (made.t.size, 1)))
    loaded = np.flatnonzero(made.block == "loaded home")[-1]
    return replace(leaning, t_seen=made.t_seen[[0, loaded]], block=made.block[[0, loaded]])


def test_what_cannot_be_recorded_is_reported(written, tmp_path, capsys):
    path, out = str(written[0]), str(tmp_path / "r.npz")
    assert main(["record", path, "--out", out]) == 2
    assert "give --sim" in capsys.readouterr().err
    assert main(["record", path, "--sim", "--out", out, "--hide", "wobble"]) == 2
    # before anything is solved
    assert capsys.readouterr().err.startswith("softmap record: no hidden law 'wobble'")
    assert main(["record", path, "--sim", "--out", out, "--hide", "servo_swap,creep", "gust"]) == 2
    assert "no hidden law 'gust'" in capsys.readouterr().err
    write_commands(tmp_path / "other.csv", plan([BLOCKS["circle"]], Limits.even(3)), "moe-finger")
    assert main(["record", str(tmp_path / "other.csv"), "--sim", "--out", out]) == 2
    assert (
        "3 commands in mm for 'moe-finger', 'moe-finger' takes 2 in mm" in capsys.readouterr().err
    )
    for text in ("[]", "{", '{"hidden": [{"name": "lag"}], "seed": true}'):
        (tmp_path / "demo.json").write_text(text)
        assert (
            main(
                ["record", path, "--sim", "--out", out, "--truth-from", str(tmp_path / "demo.json")]
            )
            == 2
        )
        reported = capsys.readouterr().err
        assert reported.count("\n") == 1 and "demo.json" in reported
    assert HANGING == (0.0, 0.0, 1.0) and not (tmp_path / "r.npz").exists()
