"""An option that a command would ignore is refused, with the way to use it."""

import re

import pytest

from softmap_edge.cli import main
from softmap_edge.commands import COMMANDS

JOG = ["servo", "move", "--rig", "rig.toml", "--servo", "1", "--by", "40", "--hold"]
KEYS = ["servo", "move", "--rig", "rig.toml"]
BARE = ["servo", "emulate", "--servos", "2"]
KEY = ["servo", "heartbeat", "--new-key", "stop.key"]
DRIVEN = ["--rig", "rig.toml", "--seed", "3"]

IDLE = [
    ([*JOG, "--seconds", "2"], "--seconds: a jog ends where it is; give U1,U2"),
    ([*JOG, "--bundle", "finger"], "--bundle: a jog of a rig uses no model"),
    ([*KEYS, "--effects", "own.py"], "--effects: a jog of a rig uses no model"),
    ([*KEYS, "--hold"], "--hold: a jog by keys is driven by held keys"),
    (["servo", "move", "--sim", "--hold"], "--hold: a jog by keys is driven by held keys"),
    ([*BARE, "--strength", "2"], "--strength: it needs a finger; leave --servos out"),
    ([*BARE, "--effects", "own.py"], "--effects: it needs a finger; leave --servos out"),
    (["servo", "emulate", "--strength", "2"], "--strength: nothing is hidden; give --hide"),
    ([*KEY, "--key", "other.key"], "--key: --new-key only makes a key"),
    ([*KEY, "--every", "0.1"], "--every: --new-key only makes a key"),
    (["servo", "heartbeat", "host:5006", *KEY[2:]], "HOST:PORT: --new-key only makes a key"),
    (["track", "S", *DRIVEN], "--seed: only an emulated finger uses it"),
    (["teleop", "--page", "none", "--seconds", "1", *DRIVEN], "--seed: only an emulated finger"),
    (["record", "c.csv", "--out", "r.npz", *DRIVEN], "--seed: only a simulated or emulated finger"),
]


@pytest.mark.parametrize("argv, line", IDLE, ids=lambda value: " ".join(value)[:60])
def test_an_option_that_would_do_nothing_is_refused(argv, line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(argv) == 2
    out, err = capsys.readouterr()
    assert not out and line in err and err.count("\n") == 1, err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "example", [one for command in COMMANDS for one in command.examples if "--rig rig.toml" in one]
)
def test_an_example_with_a_rig_lacks_nothing_but_its_files(example, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(example.split()) != 0
    said = " ".join(capsys.readouterr())
    assert re.search(r"rig\.toml|next\.csv: no such file|no serial port", said), said
