"""A recording with what was seen beside it is a run; alone it is one of which nothing was seen; damage is told."""

import json
from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import builtin_model
from softmap_edge.cli import main
from softmap_edge.commands.robot import plain_map
from softmap_edge.errors import RunError
from softmap_edge.experiment.kept import keeping, seen_file
from softmap_edge.experiment.recorded import open_recording
from softmap_edge.servo.recording import read_recording

MODEL = builtin_model()
CALIBRATED = replace(MODEL, calibration=plain_map(MODEL))


@pytest.fixture(scope="module")
def tracked(tmp_path_factory):
    """Give the recording of an O that an emulated finger drew which hides nothing."""
    file = tmp_path_factory.mktemp("tracked") / "o.mcap"
    options = ["--amplitude", "5", "--duration", "4", "--rate", "20", "--record", str(file)]
    assert main(["track", "O", "--sim", *options]) == 0
    return file


def test_what_was_driven_and_seen_is_one_run(tracked):
    run, told = open_recording(tracked, CALIBRATED), read_recording(tracked)
    driven = told.run()
    np.testing.assert_array_equal(run.ticks, driven.ticks)
    np.testing.assert_array_equal(run.t, driven.t)
    assert run.robot == MODEL.robot and run.vertices.shape[1:] == MODEL.rest.shape
    assert run.frames > 25.0 * (run.t[-1] - run.t[0]) and run.t_seen[0] > 0 and run.t_seen[-1] < run.t[-1]
    # What was seen is what the encoders say, on one clock.
    tip = run.vertices[:, MODEL.tip_indices].mean(axis=1)
    acting = told.calibration.commands(run.present_ticks)
    at = np.stack([np.interp(run.t_seen, run.t, column) for column in acting.T], axis=1)
    assert np.linalg.norm(tip - MODEL.tip(at), axis=1).mean() < 0.3 and np.ptp(tip, axis=0)[:2].min() > 5.0


def test_a_model_without_a_calibration_gets_mm(tracked):
    ticks, mm = open_recording(tracked, CALIBRATED), open_recording(tracked, MODEL)
    assert mm.ticks is None and mm.present_ticks is None and mm.command_unit == "mm"
    known = read_recording(tracked).calibration
    np.testing.assert_allclose(mm.command, known.commands(ticks.ticks))
    np.testing.assert_allclose(mm.present, known.commands(ticks.present_ticks))


def test_every_verb_takes_it(tracked, tmp_path, capsys):
    assert main(["compare", str(tracked), "--json"]) == 0
    # Servos are seen where they stand; the model is right but for the noise.
    assert json.loads(capsys.readouterr().out)["error"]["rms_mm"] < 0.35
    assert main(["diagnose", str(tracked)]) == 0
    assert "Verdict: nothing above the floor" in capsys.readouterr().out
    for verb in (["show"], ["check"]):
        assert main([*verb, str(tracked)]) == 0
    assert "frames of vertices" in capsys.readouterr().out


def test_alone_nothing_was_seen(tracked, tmp_path, capsys):
    alone = tmp_path / "alone.mcap"
    alone.write_bytes(tracked.read_bytes())
    assert open_recording(alone).frames == 0
    assert main(["compare", str(alone)]) == 2
    assert "no seen frames" in capsys.readouterr().err


def test_another_robots_bundle_is_told(tracked, tmp_path, capsys):
    other = tmp_path / "other.mcap"
    other.write_bytes(tracked.read_bytes())
    text = seen_file(tracked).read_text().replace(MODEL.robot, "another")
    seen_file(other).write_text(text)
    assert open_recording(other).robot == "another"
    seen_file(other).write_text("no json\n")
    with pytest.raises(RunError, match="other.seen: damaged, or not what is kept beside a recording"):
        open_recording(other)


def test_what_stands_there_is_not_lost(tracked, tmp_path, capsys):
    (tmp_path / "x.seen").write_text("mine")
    assert main(["track", "O", "--sim", "--record", str(tmp_path / "x.mcap")]) == 2
    assert "x.seen exists, where what is seen goes; give another name" in capsys.readouterr().err
    assert (tmp_path / "x.seen").read_text() == "mine"
    with pytest.raises(FileExistsError), keeping(tmp_path / "x.mcap", list, MODEL):
        pass
