"""docs/do/commission.md: from servos as delivered to a tracked circle, each command as its reader
types it.
"""

import json
from pathlib import Path

import pytest
from page import blocks, lines

from softmap_edge.cli import main
from softmap_edge.commands.robot import plain_map
from softmap_edge.model.bundle import builtin_model, save_bundle
from softmap_edge.robot.emulated.finger import emulated_robot
from softmap_edge.robot.servo.rig import read_rig

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/do/commission.md").read_text(encoding="utf-8")
STEPS = [
    "scan",
    "setup",
    "setup",
    "read",
    "home",
    "calibrate",
    "pull",
    "limits",
    "doctor",
    "move",
    "move",
    "track",
]


def test_from_the_box_to_ready(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    model = builtin_model()
    save_bundle(model, tmp_path / "model")
    done, said = [], {}
    with emulated_robot(model, plain_map(model), ready=False) as (bus, _, _, _):
        for language, text in blocks(PAGE):
            if language == "text":
                continue
            if language == "toml":
                rig = Path("rig.toml")
                head, *rest = rig.read_text(encoding="utf-8").split("\n[[servo]]", 1)
                rig.write_text("\n[[servo]]".join([f"{head}{text}", *rest]), encoding="utf-8")
                continue
            for words in lines(text):
                words = [{"PORT": bus.path, "BUNDLE": "model"}.get(word, word) for word in words]
                assert words[0] == "softmap"
                name = words[2] if words[1] == "servo" else words[1]
                code = main(words[1:])
                reported = capsys.readouterr()
                # What this computer lacks (a camera's packages, real-time rights) is no matter of
                # the rig.
                assert code == 0 or name == "doctor", f"{name}: {reported.err}"
                done.append(name)
                said[name] = reported.out
        horns = bus.state()[1]
    assert done == STEPS
    assert not any(on for _, on, _, _ in horns), "torque is off"
    rig = read_rig("rig.toml")
    assert all(servo.home is not None and servo.current_mA for servo in rig.servos)
    assert set(rig.made) >= {"homed", "pulled"} and rig.ceiling.get("high") == 800.0
    assert "800" in said["limits"] and "nothing is driven" not in said["limits"]
    well = {
        line.removeprefix("ok").split(":")[0].strip()
        for line in said["doctor"].splitlines()
        if line[:2] == "ok"
    }
    assert {
        "bundle",
        "calibration",
        "safety.toml",
        "rig",
        "servo 1",
        "servo 2",
        "limits",
    } <= well, said["doctor"]
    assert {"home of servo 1", "home of servo 2"} <= well and "ceiling" not in said["doctor"]
    assert Path("o.svg").read_text(encoding="utf-8").startswith("<")
    done = json.loads(Path("finger/calibration.json").read_text(encoding="utf-8"))
    assert done["A"][0][0] == pytest.approx(1 / 280.0, rel=0.01)


def test_the_guards_page_leads_here():
    assert "(../do/commission.md)" in (ROOT / "docs/reference/safety.md").read_text(
        encoding="utf-8"
    )
