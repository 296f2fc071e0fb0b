"""A run without commands is reported at import and by `softmap check`; guess knows usual names of
other languages.
"""

from pathlib import Path

import numpy as np
import pytest

from softmap_edge import Run
from softmap_edge.checks.summary import summary
from softmap_edge.cli import main
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

T = np.arange(120) / 20
MARKERS = {
    "markers": 'markers = { columns = [["x", "y", "z"]] }',
    "markers in a plane": 'markers = { columns = [["x", "z"]] }',
    "an output": 'output = { columns = ["x"], unit = "N" }',
}


def log(folder, names=("x", "y", "z"), drive=()):
    lines = [",".join(["t", *drive, *names])]
    for t in T:
        places = [10 * np.sin(t), 3 * np.cos(t), 90 - np.sin(t) ** 2]
        lines.append(
            ",".join(
                f"{x:.3f}" for x in (t, *(30 * np.sin(t + k) for k in range(len(drive))), *places)
            )
        )
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return folder / "log.csv"


@pytest.mark.parametrize("kind", MARKERS)
def test_an_import_without_commands_is_reported(tmp_path, capsys, kind):
    text = f'schema = "softmap.mapping/1"\n[[log]]\ntime = {{ column = "t" }}\n{MARKERS[kind]}\n'
    done = import_logs([log(tmp_path)], parse_mapping(text, Path("map.toml")))
    assert done.run.channels == 0
    assert (
        sum(
            "without commands" in doubt and "`command` or `ticks`" in doubt for doubt in done.doubts
        )
        == 1
    )
    done.run.save(tmp_path / "run.npz")
    main(["check", str(tmp_path / "run.npz")])
    assert "look at   0 channels: a run without commands" in capsys.readouterr().out


@pytest.mark.parametrize("key", ["command", "ticks"])
def test_a_run_with_commands_is_not_reported(key):
    unit = {} if key == "ticks" else {"command_unit": "deg"}
    run = Run(t=T, t_seen=T[:0], **{key: np.rint(100 * np.sin(T))[:, None]}, **unit)
    assert not any("without commands" in text for text in summary(run).warnings)


NAMES = {
    "angles in German": (["Winkel 1", "Winkel 2"], 2),
    "angles as one word": (["Motorwinkel_links", "Motorwinkel_rechts"], 2),
    "goals in German": (["Sollwert_1 [deg]", "Sollwert_2 [deg]"], 2),
    "goals and readings": (["Soll 1", "Soll 2", "Ist 1", "Ist 2"], 2),
    "goals in French": (["consigne_1", "consigne_2"], 2),
    "commands in French": (["commande1", "commande2", "commande3"], 3),
    "angles in English": (["angle_a", "angle_b"], 2),
    "a set value": (["Vorgabe Seil 1", "Vorgabe Seil 2"], 2),
}


@pytest.mark.parametrize("kind", NAMES)
def test_commands_are_recognised_by_names_of_other_languages(tmp_path, kind):
    drive, channels = NAMES[kind]
    path = log(tmp_path, ("tip_x", "tip_y", "tip_z"), drive)
    found = guess_mapping([path])
    done = import_logs([path], parse_mapping(found.text, Path("map.toml")))
    assert done.run.channels == channels and (done.run.present is not None) == (
        kind == "goals and readings"
    )
    line = next(line for line in found.text.split("\n") if line.startswith("command = "))
    assert all(f'"{name}"' in line for name in drive[:channels])


@pytest.mark.parametrize("name", ["Kraft", "Insolation", "Distanz", "Liste", "Feuchte"])
def test_other_words_are_no_commands(tmp_path, name):
    found = guess_mapping([log(tmp_path, ("tip_x", "tip_y", "tip_z"), [f"{name}_1", f"{name}_2"])])
    assert "command = " not in found.text and any(
        "what was commanded" in line for line in found.unknown
    )
    assert any("without commands" in line for line in found.said)


@pytest.mark.parametrize("kind", MARKERS)
def test_check_proposes_no_model_without_commands(tmp_path, capsys, kind):
    text = f'schema = "softmap.mapping/1"\n[[log]]\ntime = {{ column = "t" }}\n{MARKERS[kind]}\n'
    run = import_logs([log(tmp_path)], parse_mapping(text, Path("map.toml"))).run
    run.save(tmp_path / "run.npz")
    assert main(["check", str(tmp_path / "run.npz")]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("next: softmap show ")
    assert main([*last.removeprefix("next: softmap ").split()]) == 0


def test_check_proposes_to_learn_from_commands_and_markers(tmp_path, capsys):
    markers = np.stack([np.sin(T), np.cos(T), 90 + 0 * T], axis=1)[:, None]
    Run(t=T, t_seen=T, command=np.sin(T)[:, None], markers=markers).save(tmp_path / "run.npz")
    main(["check", str(tmp_path / "run.npz")])
    assert capsys.readouterr().out.splitlines()[-1].startswith("next: softmap learn ")
