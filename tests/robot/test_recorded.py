"""A recording with its observations is a run for every command; alone nothing was seen; damage
is a line.
"""

import json
import os
import shutil
from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import Run, builtin_model
from softmap_edge.cli import main
from softmap_edge.commands.robot import plain_map
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.errors import RecordingBroken, RecordingWarning, RunError
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.drive.observations import (
    LATELY,
    Keeper,
    keeping,
    read_kept,
    seen_file,
    with_crc,
)
from softmap_edge.robot.drive.recorded import open_run
from softmap_edge.robot.link.frames import Frame

MODEL = builtin_model()
CALIBRATED = replace(MODEL, calibration=plain_map(MODEL))


@pytest.fixture(scope="module")
def tracked(tmp_path_factory):
    """Give the recording of an O that an emulated finger drew which hides nothing."""
    file = tmp_path_factory.mktemp("tracked") / "o.mcap"
    options = ["--amplitude", "5", "--duration", "4", "--rate", "20", "--record", str(file)]
    assert main(["track", "O", "--sim", *options]) == 0
    return file


@pytest.fixture
def copied(tracked, tmp_path):
    """Give a copy of it, to be spoilt."""
    for file in (tracked, seen_file(tracked)):
        shutil.copy(file, tmp_path)
    return tmp_path / tracked.name


def test_a_model_in_ticks_gets_the_ticks_of_a_recording_and_not_mm(tracked):
    ticks = open_run(tracked, replace(MODEL, command_unit="ticks"))
    np.testing.assert_array_equal(ticks.ticks, read_recording(tracked).run().ticks)
    assert ticks.command is None and open_run(tracked, MODEL).command_unit == "mm"


def test_what_was_driven_and_seen_is_one_run_on_one_clock(tracked):
    run, reported = open_run(tracked, CALIBRATED), read_recording(tracked)
    driven = reported.run()
    np.testing.assert_array_equal(run.ticks, driven.ticks)
    np.testing.assert_array_equal(run.t, driven.t)
    assert run.robot == MODEL.robot and run.vertices.shape[1:] == MODEL.rest.shape
    assert (
        run.frames > 25.0 * (run.t[-1] - run.t[0])
        and run.t_seen[0] > 0
        and run.t_seen[-1] < run.t[-1]
    )
    tip = run.vertices[:, MODEL.tip_indices].mean(axis=1)
    acting = reported.calibration.commands(run.present_ticks)

    def off(late):
        at = np.stack([np.interp(run.t_seen - late, run.t, column) for column in acting.T], axis=1)
        return np.linalg.norm(tip - MODEL.tip(at), axis=1).mean()

    shifts = np.arange(-40, 41, 5) * 1e-3  # s
    best = shifts[np.argmin([off(shift) for shift in shifts])]
    assert abs(best) <= 0.01 and off(0.0) < 0.25 and np.ptp(tip, axis=0)[:2].min() > 5.0


def test_a_model_without_a_calibration_gets_mm(tracked):
    ticks, mm = open_run(tracked, CALIBRATED), open_run(tracked, MODEL)
    assert mm.ticks is None and mm.present_ticks is None and mm.command_unit == "mm"
    known = read_recording(tracked).calibration
    np.testing.assert_allclose(mm.command, known.commands(ticks.ticks))
    np.testing.assert_allclose(mm.present, known.commands(ticks.present_ticks))


@pytest.mark.long
def test_commands_take_it_as_any_run(tracked, tmp_path, capsys):
    file, out = str(tracked), str(tmp_path / "out")
    assert main(["compare", file, "--json"]) == 0
    # Servos are seen where they stand; the model is right but for the noise.
    assert json.loads(capsys.readouterr().out)["error"]["rms_mm"] < 0.35
    assert main(["diagnose", file, "--out", f"{out}.json"]) == 0
    assert "No effect exceeds the noise floor" in capsys.readouterr().out
    found = Diagnosis.load(f"{out}.json")
    assert not (found.effects or found.faults or found.families or found.alternatives)
    # Small circles of 4 s, hanging: a third of all effects would not show.
    assert found.verdict == "cannot_tell" and {"body_friction", "stiffness"} < {
        h.name for h in found.not_testable
    }
    for words in (
        ["show", file],
        ["check", file],
        ["check", file, "--bundle", out],
        ["model", "predict", file, "--out", f"{out}.p.npz"],
        ["next", f"{out}.json", "--run", file, "--out", f"{out}.csv"],
        ["servo", "replay", file, "--run", f"{out}.npz"],
    ):
        if "--bundle" in words:
            assert main(["model", "calibrate", file, "--out", out]) in (0, 1)
        assert main(words) == 0, words
    assert Run.load(f"{out}.npz").hash() == open_run(tracked).hash()
    assert main(["run", "align", file, "--bundle", out, "--out", f"{out}.a.npz"]) in (0, 1), (
        capsys.readouterr().err
    )
    upper = tmp_path / "O.MCAP"
    shutil.copy(tracked, upper)
    assert main(["model", "predict", str(upper), "--out", f"{out}.q.npz"]) == 0, (
        "by any letters, with nothing seen"
    )


@pytest.mark.parametrize("damage", ["cut", "zeros", "broken"])
def test_each_command_reports_a_recording_that_is_cut_or_damaged(copied, damage, capsys):
    data = copied.read_bytes()
    half = data.index(b'"overruns":', len(data) // 2)
    tail = {"cut": b"", "zeros": bytes(65536), "broken": b"?" + data[half + 1 :]}[damage]
    copied.write_bytes(data[:half] + tail)
    for word in ("compare", "check", "show", "predict", "diagnose"):
        assert main([word, str(copied)]) == 1, word
        said = capsys.readouterr()
        lines = [
            line
            for line in said.err.splitlines()
            if "o.mcap was cut short" in line or "o.mcap is damaged" in line
        ]
        assert len(lines) == 1 and "; it is read up to " in lines[0], said.err
        assert said.out, "what is sound is used"


def test_what_was_seen_that_was_cut_is_reported(copied, capsys):
    seen = seen_file(copied)
    data = seen.read_bytes()
    for cut in (data[: len(data) // 2], data[: len(data) // 2] + bytes(500)):
        seen.write_bytes(cut)
        assert main(["show", str(copied)]) == 1
        assert "o.seen was cut short: its last line is torn" in capsys.readouterr().err


def test_alone_nothing_was_seen(tracked, tmp_path, capsys):
    alone = tmp_path / "alone.mcap"
    shutil.copy(tracked, alone)
    assert open_run(alone).frames == 0
    assert main(["compare", str(alone)]) == 2
    assert "no seen frames" in capsys.readouterr().err
    (tmp_path / "alone.seen").write_text(seen_file(tracked).read_text().splitlines()[0] + "\n")
    with pytest.warns(RecordingWarning, match="no line that ends it"):
        run = open_run(alone)
    assert run.frames == 0 and run.robot == MODEL.robot, "cut before its first frame"


def test_another_robots_bundle_is_reported(copied, capsys):
    seen = seen_file(copied)
    first, *rest = seen.read_text().splitlines(True)
    seen.write_text("".join([changed(first, robot="another"), "\n", *rest]))
    assert main(["compare", str(copied)]) == 0
    assert "'another'" in capsys.readouterr().err


def changed(line, **what):
    """Return a line of a `.seen` file with other entries, its checksum right."""
    kept = {name: value for name, value in json.loads(line).items() if name != "crc"}
    return with_crc(json.dumps(kept | what)).rstrip("\n")


HEADS = [
    {"schema": "\x1b[2J\n"},
    {"late": "0.5"},
    {"late": True},
    {"late": float("nan")},
    {"late": 1e9},
    {"robot": 7},
    {"robot": "\x1b[31m"},
    {"robot": "x" * 1000},
    {"vertices": True},
    {"vertices": -1},
    {"vertices": "548"},
]
ROWS = [
    {"came": {"12": 1}},
    {"came": ["12"]},
    {"came": [[1, float("inf")]]},
    {"came": [["1", 2]]},
    {"taken": [[0, 1, 2]]},
    {"taken": [[0, 1, 2, "a"]]},
    {"taken": [[0, 1, 2, 7]]},
    {"taken": None},
    {"clock": [[1]]},
    {"clock": 3},
]


@pytest.mark.parametrize("head, row", [(one, {}) for one in HEADS] + [({}, one) for one in ROWS])
def test_what_is_damaged_is_reported_in_a_line(copied, head, row, capsys):
    seen = seen_file(copied)
    first, second, *rest = seen.read_text().splitlines()
    seen.write_text("\n".join([changed(first, **head), changed(second, **row), *rest]) + "\n")
    assert main(["compare", str(copied)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "o.seen: damaged, or no `.seen` file of a recording" in said
    assert said.strip().isprintable() and len(said) < 400


def test_a_line_that_never_ends_is_no_end(copied):
    seen = seen_file(copied)
    whole = seen.read_text().splitlines(True)
    seen.write_text("".join(whole[:5]) + "x" * (1 << 24) + "\n" + "".join(whole[5:]))
    with pytest.raises(RunError, match="a line of more than"):
        open_run(copied)


def test_what_is_no_file_is_not_waited_for(copied):
    seen_file(copied).unlink()
    os.mkfifo(seen_file(copied))
    with pytest.raises(RunError, match="o.seen: damaged, or no `.seen` file"):
        open_run(copied)
    seen_file(copied).unlink()
    seen_file(copied).mkdir()
    with pytest.raises(RunError, match="o.seen: damaged, or no `.seen` file"):
        open_run(copied)


def test_what_another_recording_saw_is_not_this_ones(copied):
    seen = seen_file(copied)
    first, *rest = seen.read_text().splitlines()
    moved = []
    for line in rest:
        one = json.loads(line)
        one["came"] = [[stamp, arrived + 1e4] for stamp, arrived in one["came"]]
        one["taken"] = [
            [look, stamp, arrived + 1e4, text] for look, stamp, arrived, text in one["taken"]
        ]
        moved.append(changed(line, came=one["came"], taken=one["taken"]))
    seen.write_text("\n".join([first, *moved]) + "\n")
    with pytest.raises(RunError, match=r"none of its \d+ frames was seen while o.mcap was driven"):
        open_run(copied)


def test_a_command_file_that_was_cut_is_recovered_and_not_opened(copied):
    seen = seen_file(copied)
    first, second, *rest = seen.read_text().splitlines()
    seen.write_text("\n".join([first, changed(second, clock=[[1.0, 0.0]]), *rest]) + "\n")
    with pytest.raises(RunError, match="softmap record COMMANDS --recover"):
        open_run(copied)


def test_a_recording_without_its_calibration_stays_in_ticks(copied, monkeypatch):
    reported = read_recording(copied)
    monkeypatch.setattr(
        "softmap_edge.robot.drive.recorded.read_recording",
        lambda file: replace(
            reported,
            setup={key: value for key, value in reported.setup.items() if key != "calibration"},
        ),
    )
    run = open_run(copied, MODEL)
    assert run.ticks is not None
    with pytest.raises(RunError, match="the run holds ticks"):
        run.commands()


def test_what_stands_there_is_not_lost(tmp_path, capsys):
    (tmp_path / "x.seen").write_text("mine")
    assert main(["track", "O", "--sim", "--record", str(tmp_path / "x.mcap")]) == 2
    assert (
        "x.seen exists, and would be taken for what it saw; give another name"
        in capsys.readouterr().err
    )
    with (
        pytest.raises(RunError, match="x.seen exists; give another name"),
        keeping(tmp_path / "x.mcap", list, MODEL),
    ):
        pass
    assert (tmp_path / "x.seen").read_text() == "mine"


def test_a_start_that_fails_leaves_nothing_to_be_taken_for_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(
        "softmap_edge.robot.control.controller.Controller._start",
        lambda self: (_ for _ in ()).throw(RunError("no start")),
    )
    for _ in range(2):
        assert main(["track", "O", "--sim", "--record", str(tmp_path / "x.mcap")]) == 2
        assert "no start" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_many_large_frames_that_were_there_already_are_all_kept(tmp_path):
    points = np.zeros((5000, 3))
    frames = [Frame(k / 30.0, 5.0 + k / 30.0, points) for k in range(LATELY)]
    with keeping(tmp_path / "x.mcap", lambda: frames, MODEL) as keeper:
        pass
    assert keeper.fault is None and len(read_kept(tmp_path / "x.seen").taken) == LATELY


def test_what_cannot_be_seen_any_more_is_a_fault_and_no_traceback(tmp_path, capfd):
    def gone():
        raise OSError("the camera is gone")

    said = "the camera is gone: .*x.seen; what was seen until then is kept"
    with (
        pytest.raises(RecordingBroken, match=said),
        keeping(tmp_path / "x.mcap", gone, MODEL) as keeper,
    ):
        pass
    assert (
        keeper.fault == "OSError: the camera is gone" and "Traceback" not in capfd.readouterr().err
    )
    keeper.add([], [], [])
    with pytest.raises(RunError, match="5 s late, 0 to 2 s is allowed"):
        Keeper(tmp_path / "y.seen", 5.0, MODEL)
    assert not (tmp_path / "y.seen").exists()
    with pytest.raises(RunError, match="nowhere"):
        Keeper(tmp_path / "nowhere" / "x.seen", 0.0, MODEL)


def test_every_command_says_what_was_lost_of_what_was_seen_and_its_run_keeps_that(copied, capsys):
    seen, out = seen_file(copied), str(copied.with_name("r.npz"))
    first, second, third, *rest = seen.read_bytes().splitlines(True)
    seen.write_bytes(b"".join([first, second, third.replace(b"[", b"[1", 1), *rest]))
    for words in (["compare"], ["show"], ["check"], ["replay"], ["run", "show"]):
        assert main([*words, str(copied), *(["--run", out] if words == ["replay"] else [])]) == 1, (
            words
        )
        assert "o.seen is damaged: 1 of" in capsys.readouterr().err, words
    assert main(["compare", out]) == 0  # by the map that was driven with
    capsys.readouterr()
    assert main(["check", out]) == 0
    assert "made of what could be read: " in " ".join(capsys.readouterr().out.split())
