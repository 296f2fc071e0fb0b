"""The blocks of docs/do/own_program.md, in order, on the emulated robot that it names; and what
opening one refuses.
"""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from emulated_robot import emulated

from softmap_edge import SoftmapError, builtin_model, open_robot, save_bundle
from softmap_edge.cli import main
from softmap_edge.robot.control.recording import read_recording
from softmap_edge.robot.link.points import PointReceiver

PAGE = (Path(__file__).parents[2] / "docs/do/own_program.md").read_text(encoding="utf-8")


@pytest.mark.long
def test_the_programs_of_the_page_run_one_after_another(tmp_path, monkeypatch, capsys):
    (command,) = re.findall(r"```text\n(.*?)\n```", PAGE, re.S)
    hides, stream = command.split()[3:5], command.split()[9:]
    assert command.split()[:9] == [
        "softmap",
        "servo",
        "emulate",
        *hides,
        "--rig",
        "rig.toml",
        "--calibrated",
        "finger",
    ]
    assert stream == ["--stream", "udp://127.0.0.1:9870"]
    programs = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    assert len(programs) == 4
    monkeypatch.chdir(tmp_path)
    with PointReceiver("127.0.0.1", 0) as any_port:
        port = str(any_port.port)
    names, sent = {}, []
    with emulated(tmp_path, *hides, "--stream", f"udp://127.0.0.1:{port}") as (_, reported, _):
        Path(reported["bundle"]).rename("finger")
        for program in programs:
            exec(compile(program.replace("9870", port), "docs/do/own_program.md", "exec"), names)
            sent.append((names["t"], names["done"]))
    _, second, *_ = capsys.readouterr().out.splitlines()
    t, done = sent[0]
    np.testing.assert_allclose(done, [4.0 * np.sin(2.0 * t), -1.0], atol=0.5)
    assert second.startswith("engaged [")
    assert read_recording("drive.mcap").replay() == []
    assert main(["compare", "seen.mcap", "--bundle", "finger", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["error"]["rms_mm"] > 0.5, "it hides something"
    assert main(["diagnose", "seen.mcap", "--bundle", "finger", "--out", "lacks.json"]) == 0
    assert "The model lacks" in capsys.readouterr().out
    assert [effect["name"] for effect in json.loads(Path("lacks.json").read_text())["effects"]] == [
        "backlash"
    ]
    assert names["found"].distance.max() < 0.01
    at = names["robot"].calibration.commands(names["robot"].position)
    assert np.abs(at).max() < 0.3, "slack at the end"


def test_a_robot_that_cannot_be_opened_says_what_to_do(tmp_path):
    save_bundle(builtin_model(), tmp_path / "bare")
    with pytest.raises(SoftmapError, match="calibrat"):
        open_robot(tmp_path / "rig.toml", tmp_path / "bare")
    with pytest.raises(SoftmapError, match="nowhere"):
        open_robot(tmp_path / "rig.toml", tmp_path / "nowhere")
    with emulated(tmp_path) as (_, reported, _):
        with pytest.raises(SoftmapError, match=r"none\.toml"):
            open_robot(tmp_path / "none.toml", reported["bundle"])
        with (
            open_robot(reported["rig"], reported["bundle"]) as robot,
            pytest.raises(SoftmapError, match=r"shape \(3,\)"),
        ):
            robot.engage([1.0, 2.0, 3.0])
