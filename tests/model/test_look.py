"""The commands that look at a model: predict runs all of it, effects lists the registry."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.files.npz import read_npz
from softmap_edge.model.bundle import builtin_model, save_bundle
from softmap_edge.run.run import Run


def test_predict_takes_one_command_through_the_effects_of_the_bundle(tmp_path, capsys):
    model = builtin_model()
    shifted = model.with_effects(
        ["offset", "mount"], {"offset.shift[0]": 2.0, "mount.shift_x": 1.5}
    )
    bundle = save_bundle(shifted, tmp_path / "bundle")
    assert (
        main(
            [
                "model",
                "predict",
                "6,-3",
                "--bundle",
                str(bundle),
                "--out",
                str(tmp_path / "p.npz"),
                "--json",
            ]
        )
        == 0
    )
    expected = model.prior.evaluate(np.array([[8.0, -3.0]])).reshape(1, -1, 3) + [1.5, 0.0, 0.0]
    np.testing.assert_allclose(read_npz(tmp_path / "p.npz")["points"], expected, atol=1e-9)
    tip = json.loads(capsys.readouterr().out)["tip_mm"]
    np.testing.assert_allclose(tip, expected[:, model.tip_indices].mean(axis=1), atol=1e-4)


@pytest.mark.parametrize("text", ["6", "6,-3,1", "6,nan", "six,seven"])
def test_what_is_no_command_is_refused_in_one_line(text, capsys):
    assert main(["model", "predict", text]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_commands_beyond_the_range_of_the_model_are_reported(capsys):
    assert main(["model", "predict", "16.5,-16"]) == 0
    assert capsys.readouterr().err == ""  # within a twentieth of the range
    assert main(["model", "predict", "45,0", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["frames"] == 1
    assert err.count("\n") == 1 and "channel 0" in err and "-16 to 16" in err


def test_a_reader_that_stops_early_is_no_error():
    program = (
        "import sys; from softmap_edge.cli import main; sys.exit(main(['model', 'effects', "
        "'--json']))"
    )
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-c", program], stdout=writing, stderr=subprocess.PIPE, check=False
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, b"")


def test_effects_lists_the_registry_and_shows_one_in_full(capsys):
    assert main(["model", "effects", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["effects"] == json.loads(json.dumps(_core.effects()))
    assert main(["model", "effects", "creep"]) == 0
    shown = capsys.readouterr().out
    for parameter in ("strength", "tau"):
        assert parameter in shown
    assert main(["model", "effects", "nosuch"]) == 2


def test_an_effect_that_is_not_there_is_reported_with_the_nearest(capsys):
    for name, hint in (
        ("backlsh", "; did you mean 'backlash'?"),
        ("mine.py,gain", "an --effects of its own"),
        ("zzz", "'zzz'; there are"),
    ):
        assert main(["model", "effects", name]) == 2
        assert hint in capsys.readouterr().err


def test_no_line_about_an_effect_is_wider_than_a_terminal(capsys):
    assert main(["model", "effects"]) == 0
    for effect in _core.effects():
        assert main(["model", "effects", effect["name"]]) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 100
    assert " ".join(_core.effects()[0]["signature"].split()[:3]) in out


def test_command_may_begin_with_a_minus(capsys):
    assert main(["model", "predict", "-8,3", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["tip_mm"][0][0] < 0


def test_a_run_is_not_replaced_by_what_is_no_run(tmp_path, capsys):
    run = standing(tmp_path / "run.npz")
    for verb in (["model", "predict", "8,3"], ["sweep"]):
        assert main([*verb, "--out", str(run)]) == 2
        assert "a run stands there" in capsys.readouterr().err
    assert Run.load(run).frames == 3
    assert main(["model", "predict", "8,3", "--out", str(tmp_path / "p.npz")]) == 0
    assert main(["model", "predict", "8,3", "--out", str(tmp_path / "p.npz")]) == 0


def standing(path):
    t = np.arange(3.0)
    markers = 50.0 * np.random.default_rng(0).normal(size=(3, 4, 3))
    Run(t=t, command=np.zeros((3, 2)), t_seen=t, markers=markers).save(path)
    return path


@pytest.mark.parametrize(
    ("verb", "option", "path", "what"),
    [
        (["model", "predict", "8,3"], "--out", "p.txt", "saved as .npz"),
        (["model", "sweep"], "--out", "s.txt", "saved as .npz"),
        (["model", "sweep"], "--out", "none/s.npz", "make it first"),
        (["compare", "run.npz"], "--html", "none/r.html", "make it first"),
        (["compare", "run.npz"], "--html", "run.npz", "saved as .html"),
        (["diagnose", "run.npz"], "--out", "run.npz", "saved as .json"),
        (["diagnose", "run.npz"], "--html", "folder", "a folder"),
        (["diagnose", "run.npz"], "--out", "none/d.json", "make it first"),
        (["build"], "--out", "folder", "not a bundle"),
        (["demo"], "--out", "folder/of", "a part of this path is a file"),
        (["learn", "run.npz"], "--out", "folder", "not a bundle"),
        (["model", "refit", "run.npz", "--bundle", "b"], "--out", "folder", "not a bundle"),
    ],
)
def test_where_nothing_can_be_written_is_reported_before_the_work(
    verb, option, path, what, tmp_path, capsys
):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "of").write_text("someone")
    assert main([*verb, option, str(tmp_path / path)]) == 2
    error = capsys.readouterr().err
    assert what in error and error.count("\n") == 1
