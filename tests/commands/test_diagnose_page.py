"""docs/do/diagnose.md as written: each Python block and `softmap` line is run, on files like those
a reader brings.

The reader's files: a finger.toml (the built-in finger, coarser and moving less, so that its sweep
takes seconds), the log of a second finger on another mesh with hidden backlash, as CSV with a
mapping, and a run of another kind.
"""

from pathlib import Path

import numpy as np
import pytest
from page import blocks, lines

from softmap_edge import Run, _core, import_logs, load_bundle, read_mapping
from softmap_edge.cli import main
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.robot.emulated.laws import LAWS
from softmap_edge.run.protocol import Protocol, other_protocol, standard_protocol

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/do/diagnose.md").read_text(encoding="utf-8")
BLOCKS = blocks(PAGE)
REACH, NOISE = 8.0, 0.1  # mm: largest command of the log; σ of each marker coordinate


COMMANDS = [words for language, text in BLOCKS if language != "python" for words in lines(text)]
PYTHON = [text for language, text in BLOCKS if language == "python"]

MAPPING = """schema = "softmap.mapping/1"
robot = "moe-finger"
[[log]]
time = {{ column = "t" }}
command = {{ columns = ["u0", "u1"], unit = "mm" }}
markers = {{ columns = [{columns}], unit = "mm" }}
[seen]
rate_hz = 2.5
[constant]
gravity = [0.0, 0.0, 1.0]
sigma_mm = {noise}
marker_rest_mm = {rest}
"""


class SecondFinger:
    """Another mesh of the reader's finger, softer silicone and play in its tendons, seen by 20
    markers.
    """

    def __init__(self, finger):
        first = Simulator(finger)
        other = Simulator(
            finger.replace(layers=finger.solid.layers + 3, young_mpa=0.95 * finger.young_mpa),
            template=first.template,
        )
        rest = np.asarray(first.template.vertices)
        rings = [
            np.flatnonzero(np.abs(rest[:, 2] - z) < 1e-6) for z in np.unique(rest[:, 2].round(6))
        ]
        rings = [ring for ring in rings if len(ring) >= 4][2::2]
        chosen = np.concatenate([ring[:: len(ring) // 4][:4] for ring in rings])
        axes = [np.linspace(-10, 10, 11)] * 2
        points = np.asarray(other.sweep(axes).vertices)[:, chosen].reshape(121, -1)
        self.rest = rest[chosen]
        self.table = _core.Table(
            axes, points - points.mean(0), points.mean(0), np.eye(points.shape[1])
        )
        self.play = LAWS["backlash"].draw(np.random.default_rng(1), 2)

    def log(self, protocol: Protocol, seed):
        """Return t, commands and markers at 10 Hz, hanging."""
        turned = int(np.argmax(np.any(protocol.gravity != protocol.gravity[0], axis=1)))
        rows = slice(0, turned, 5)
        t, u = protocol.t[:turned], protocol.command[:turned]
        seen = self.table.evaluate(np.ascontiguousarray(self.play.command(t, u)[rows]))
        seen = seen + NOISE * np.random.default_rng(seed).normal(size=seen.shape)
        return t[rows], u[rows], seen.reshape(len(seen), -1, 3)


def write_log(path, t, u, markers):
    names = ["t", "u0", "u1"] + [f"{axis}{k}" for k in range(markers.shape[1]) for axis in "xyz"]
    table = np.column_stack([t, u, markers.reshape(len(t), -1)])
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.5f")


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    """A folder with what a reader brings, and what the commands of the page left in it."""
    folder = tmp_path_factory.mktemp("reader")
    text = (ROOT / "softmap_edge/data/finger.toml").read_text(encoding="utf-8")
    for old, new in (
        ("core = 3", "core = 2"),
        ("layers = 42", "layers = 12"),
        ("-16.0, 16.0", "-10.0, 10.0"),
    ):
        assert old in text
        text = text.replace(old, new)
    (folder / "finger.toml").write_text(text, encoding="utf-8")
    finger = SecondFinger(Finger.load(folder / "finger.toml"))
    columns = ", ".join(f'["x{k}", "y{k}", "z{k}"]' for k in range(len(finger.rest)))
    mapping = MAPPING.format(columns=columns, noise=NOISE, rest=finger.rest.round(6).tolist())
    (folder / "map.toml").write_text(mapping, encoding="utf-8")
    write_log(folder / "LOG.csv", *finger.log(standard_protocol(2, reach=REACH), 1))
    write_log(folder / "other.csv", *finger.log(other_protocol(2, reach=REACH), 2))
    import_logs([folder / "other.csv"], read_mapping(folder / "map.toml")).run.save(
        folder / "other_run.npz"
    )
    t, u, markers = finger.log(standard_protocol(2, reach=REACH), 3)
    # a tracked body for every other ring
    bodies = markers.reshape(len(t), -1, 4, 3).mean(2)[:, [0, 2, 4]]
    reference = Run(
        t=t,
        command=u,
        t_seen=t,
        markers=bodies,
        gravity=np.array([0.0, 0.0, 1.0]),
        robot="moe-finger",
    )
    reference.save(folder / "reference.npz")
    return folder


@pytest.fixture(scope="module")
def done(reader):
    """Run every command of the page's blocks in their order; give (words, exit code) and the
    folder.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(reader)
        return reader, [(words, main(words[1:])) for words in COMMANDS if words[0] == "softmap"]


def test_the_blocks_are_what_this_test_knows_how_to_run():
    assert {language for language, _ in BLOCKS} <= {"", "python"}
    assert {words[0] for words in COMMANDS} == {"softmap"} and PYTHON


def test_every_command_works_and_the_error_falls(done):
    folder, results = done
    assert len(results) >= 7
    assert [words for words, code in results if code != 0] == []
    changed = load_bundle(folder / "finger2")
    # what its finger has, and no more
    assert {"backlash"} <= set(changed.chain_names) <= {"backlash", "stiffness"}
    assert load_bundle(folder / "finger").chain_names == ()
    assert (folder / "d.html").read_text(encoding="utf-8").startswith("<!doctype html")
    assert load_bundle(folder / "robot").kind == "rod"


def test_the_python_blocks_work(done, monkeypatch, capsys):
    folder, _ = done
    monkeypatch.chdir(folder)
    for text in PYTHON:
        exec(compile(text, "docs/do/diagnose.md", "exec"), {})
    said = capsys.readouterr().out
    assert "noise floor" in said and "Verdict:" in said
    assert "backlash" in load_bundle(folder / "finger2").chain_names
