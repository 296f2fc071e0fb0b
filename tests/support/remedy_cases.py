"""Messages that name a command, each with what provokes it and what has to work once the command
has run.

A case is a row of `CASES`; add one for each message whose remedy runs without hardware. `make`
writes the files into an empty folder, `fails` is what brings the message, `names` is the command in
it, `remedy` are commands that carry it out (placeholders filled in), and `works` must then end with
0 without the message. `tests/commands/test_remedies.py` runs them.
"""

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from learned_ticks import CASE, arm
from tick_runs import HOME, record, scattered

from softmap_edge import Run, builtin_model, learn_model, save_bundle
from softmap_edge.cli import main
from softmap_edge.run.cut import cut
from softmap_edge.synthetic.depth_camera import FULL


@dataclass(frozen=True)
class Remedy:
    """A message and the way out that it names.

    Attributes:
        name: of the case.
        make: writes what is needed into the current folder.
        fails: arguments of the command that brings the message.
        names: the command as the message has it, such as "softmap learn".
        remedy: arguments of each command that follows the advice.
        works: arguments of the command that works afterwards.
        code: exit code of `fails`; 0 where the message is a remark.
    """

    name: str
    make: Callable[[], object]
    fails: Sequence[str]
    names: str
    remedy: Sequence[Sequence[str]]
    works: Sequence[str]
    code: int = 2


def _lengths(**more: object) -> Run:
    """An arm in mm of tendon with three markers."""
    run = arm(**more)
    return replace(run, ticks=None, command=(run.ticks - 2048) / 100.0, robot="arm")


def _finger(
    size: float = 8.0, shift: Sequence[float] = (0.0, 0.0, 0.0), effects: Sequence[str] = ()
) -> Run:
    """The built-in finger, which visits home and four corners, seen by a camera that stands `shift`
    mm away.
    """
    model, rng = builtin_model(), np.random.default_rng(0)
    places = size * np.array(
        [[0, 0], [1, 0], [0, 0], [0, 1], [-1, 0], [0, 0], [0, -1], [0, 0]], float
    )
    goal = np.repeat(np.tile(places, (2, 1)), 10, axis=0)
    t = np.arange(len(goal)) * 0.5
    blank = Run(t=t, command=goal, t_seen=t, robot=model.robot)
    points = model.with_effects(effects, {}).predict(blank) + rng.normal(
        0, 0.2, (len(t), len(model.rest), 3)
    )
    return replace(blank, vertices=points + np.asarray(shift, float))


def write_clouds() -> None:
    model, rng = builtin_model(), np.random.default_rng(0)
    goal = np.array([[0, 0], [6, 0], [0, 6], [-6, 3], [4, -5], [0, 0]], float)
    t = np.arange(len(goal)) * 2.0
    blank = Run(t=t, command=goal, t_seen=t, robot=model.robot)
    seen = [FULL.look(shape, model.triangles, rng) for shape in model.predict(blank)]
    start = np.r_[0, np.cumsum([len(cloud) for cloud in seen])]
    replace(blank, points=np.concatenate(seen), start=start).save("clouds.npz")


def _learned(*names: str) -> None:
    """A run of an arm and its model, with effects."""
    run = _lengths()
    run.save("run.npz")
    save_bundle(learn_model(run, static=True).with_effects(names, {}), "bundle")


def _with_offset() -> None:
    """A finger that pulls 2 mm farther than commanded, and a bundle that knows an offset
    already.
    """
    run = _finger()
    replace(run, command=run.command - [2.0, 0.0]).save("run.npz")
    save_bundle(builtin_model(), "plain")


def _ticks_of_a_finger(effects: Sequence[str] = ()) -> None:
    record(scattered(1), 1).save("ticks.npz")
    save_bundle(builtin_model().with_effects(effects, {}), "finger")


def _two_units() -> None:
    arm().save("ticks.npz")
    save_bundle(learn_model(_lengths(), static=True), "mm")


def _log() -> None:
    Path("log.csv").write_text(CASE.read_text())


def _no_diagnosis() -> None:
    _with_offset()
    Path("d.json").write_text(json.dumps({"schema": "softmap.comparison/1"}))


def _no_bundle() -> None:
    _lengths().save("run.npz")
    Path("empty").mkdir()


def _doubtful() -> None:
    """A recording with a wrong digit at a place that its checksum does not show."""
    assert main(["track", "O", "--sim", "--duration", "3", "--record", "s.mcap"]) == 0
    data = bytearray(Path("s.mcap").read_bytes())
    places = [one.end() - 1 for one in re.finditer(rb'"position":\[\d{4}', data)]
    data[places[len(places) // 2]] ^= 1
    Path("s.mcap").write_bytes(data)


def _two_logs(overlap: float) -> None:
    """Two logs of one robot, the second begins `overlap` s before the first ends; their runs share
    frames.
    """
    whole = arm()
    rows = np.hstack([whole.t[:, None], whole.ticks, whole.markers.reshape(whole.frames, -1)])
    names = ",".join(
        ["t", "cmd_1", "cmd_2", *(f"m{k}_{axis}" for k in (1, 2, 3) for axis in "xyz")]
    )
    half = len(rows) // 2
    for name, part in (("part_1", rows[:half]), ("part_2", rows[half - round(overlap / 0.05) :])):
        Path(f"{name}.csv").write_text(
            "\n".join([names, *(",".join(f"{x:.5f}" for x in row) for row in part)]) + "\n"
        )
        assert main(["import", f"{name}.csv", "--guess", "--out", f"{name}.toml"]) == 0
        assert main(["import", f"{name}.csv", "--map", f"{name}.toml", "--out", f"{name}.npz"]) in (
            0,
            1,
        )
    text = Path("part_1.toml").read_text()
    Path("both.toml").write_text(text.replace("[[log]]", '[[log]]\nfile = "part_*.csv"'))


def _shared() -> None:
    """Two runs of one recording that share a second."""
    whole = arm()
    for name, part in (("a", cut(whole, end=31.0)), ("b", cut(whole, start=30.0))):
        replace(part, extra={}).save(f"{name}.npz")


HOMES = [str(ticks) for ticks in HOME]
CALIBRATED = [
    "model",
    "calibrate",
    "ticks.npz",
    "--bundle",
    "finger",
    "--home",
    *HOMES,
    "--out",
    "calibrated",
]
CASES = [
    Remedy(
        "ticks without a model",
        lambda: arm().save("ticks.npz"),
        ["compare", "ticks.npz"],
        "softmap learn RUN --out DIR",
        [["learn", "ticks.npz", "--static", "--out", "b"]],
        ["compare", "ticks.npz", "--bundle", "b"],
    ),
    Remedy(
        "ticks and a model in mm",
        _ticks_of_a_finger,
        ["compare", "ticks.npz", "--bundle", "finger"],
        "softmap model calibrate RUN --bundle DIR --out DIR2",
        [CALIBRATED],
        ["compare", "ticks.npz", "--bundle", "calibrated"],
    ),
    Remedy(
        "check of a run in ticks",
        lambda: arm().save("ticks.npz"),
        ["check", "ticks.npz"],
        "softmap learn",
        [["learn", "ticks.npz", "--static", "--out", "b"]],
        ["compare", "ticks.npz", "--bundle", "b"],
        code=0,
    ),
    Remedy(
        "commands in ticks and a model in mm",
        lambda: (_two_units(), arm(held=True).save("held.npz")),
        ["compare", "held.npz", "--bundle", "mm"],
        "softmap learn",
        [["learn", "held.npz", "--static", "--out", "b"]],
        ["compare", "held.npz", "--bundle", "b"],
    ),
    Remedy(
        "a log in place of a run",
        _log,
        ["compare", "log.csv"],
        "softmap import",
        [
            ["import", "log.csv", "--guess", "--out", "m.toml"],
            ["import", "log.csv", "--map", "m.toml", "--out", "r.npz"],
            ["learn", "r.npz", "--static", "--out", "b"],
        ],
        ["compare", "r.npz", "--bundle", "b"],
    ),
    Remedy(
        "clouds",
        write_clouds,
        ["compare", "clouds.npz"],
        "softmap run register",
        [["run", "register", "clouds.npz", "--out", "registered.npz"]],
        ["compare", "registered.npz"],
    ),
    Remedy(
        "a camera's frame",
        lambda: _finger(shift=(40.0, 300.0, 700.0)).save("camera.npz"),
        ["compare", "camera.npz"],
        "softmap run align",
        [["run", "align", "camera.npz", "--out", "aligned.npz"]],
        ["compare", "aligned.npz"],
        code=0,
    ),
    Remedy(
        "check of a camera's frame",
        lambda: _finger(shift=(40.0, 300.0, 700.0)).save("camera.npz"),
        ["check", "camera.npz"],
        "softmap run align",
        [["run", "align", "camera.npz", "--out", "aligned.npz"]],
        ["check", "aligned.npz"],
        code=0,
    ),
    Remedy(
        "a frame that was never found",
        lambda: (_finger(shift=(9.0, 0.0, 0.0)).save("a.npz"), _finger().save("b.npz")),
        ["run", "align", "a.npz", "--like", "b.npz", "--out", "c.npz"],
        "softmap run align",
        [["run", "align", "b.npz", "--out", "aligned.npz"]],
        ["run", "align", "a.npz", "--like", "aligned.npz", "--out", "c.npz"],
    ),
    Remedy(
        "calibrate with effects",
        lambda: _ticks_of_a_finger(["gain"]),
        CALIBRATED,
        "softmap model remove",
        [["model", "remove", "gain", "--bundle", "finger", "--out", "finger", "--force"]],
        CALIBRATED,
    ),
    Remedy(
        "no diagnosis",
        _no_diagnosis,
        ["add", "--from", "d.json", "--bundle", "plain", "--out", "b"],
        "softmap diagnose",
        [["diagnose", "run.npz", "--bundle", "plain", "--effects", "offset", "--out", "d.json"]],
        ["add", "--from", "d.json", "--bundle", "plain", "--out", "b"],
    ),
    Remedy(
        "an effect that is there",
        lambda: (_with_offset(), _diagnosed()),
        ["add", "offset", "--from", "d.json", "--bundle", "known", "--out", "b"],
        "softmap model refit",
        [["model", "refit", "run.npz", "--bundle", "known", "--out", "refitted"]],
        ["compare", "run.npz", "--bundle", "refitted"],
    ),
    Remedy(
        "no effect is named",
        _learned,
        ["model", "remove", " , ", "--bundle", "bundle", "--out", "b"],
        "softmap model effects",
        [["model", "effects"]],
        ["compare", "run.npz", "--bundle", "bundle"],
    ),
    Remedy(
        "a file of commands that is none",
        lambda: Path("c.csv").write_text("a,b\n1,2\n"),
        ["record", "c.csv", "--sim", "--out", "r.npz"],
        "softmap next --out",
        [["next", "--protocol", "validation", "--minutes", "1", "--out", "n.csv"]],
        ["record", "n.csv", "--sim", "--out", "r.npz"],
    ),
    Remedy(
        "a folder that is no bundle",
        _no_bundle,
        ["compare", "run.npz", "--bundle", "empty"],
        "softmap learn",
        [["learn", "run.npz", "--static", "--out", "b"]],
        ["compare", "run.npz", "--bundle", "b"],
    ),
    Remedy(
        "a recording with a wrong checksum",
        _doubtful,
        ["compare", "s.mcap"],
        "softmap servo replay s.mcap --run RUN.npz",
        [["servo", "replay", "s.mcap", "--run", "r.npz"]],
        ["compare", "r.npz"],
    ),
    Remedy(
        "a file that no loop recorded",
        lambda: Path("x.mcap").write_bytes(b""),
        ["servo", "replay", "none.mcap"],
        "softmap track --record FILE.mcap",
        [["track", "O", "--sim", "--duration", "3", "--record", "s.mcap"]],
        ["servo", "replay", "s.mcap"],
    ),
    Remedy(
        "logs that overlap",
        lambda: _two_logs(1.0),
        ["import", "part_1.csv", "part_2.csv", "--map", "both.toml", "--out", "r.npz"],
        "softmap run join",
        [["run", "join", "part_1.npz", "part_2.npz", "--out", "both.npz"]],
        ["run", "show", "both.npz"],
    ),
    Remedy(
        "frames in both runs",
        _shared,
        ["run", "join", "a.npz", "b.npz", "--out", "twice.npz"],
        "softmap run cut",
        [["run", "cut", "b.npz", "--from", "31.01", "--out", "rest.npz"]],
        ["run", "join", "a.npz", "rest.npz", "--out", "both.npz"],
        code=0,
    ),
    Remedy(
        "a new effect without a name",
        lambda: None,
        ["model", "effects", "new"],
        "softmap model effects new wobble",
        [["model", "effects", "new", "wobble"]],
        ["model", "effects", "wobble", "--effects", "wobble.py"],
    ),
]


def _diagnosed() -> None:
    """A diagnosis that names the offset, and a bundle that has it."""
    from softmap_edge import diagnose

    run = Run.load("run.npz")
    found = diagnose(builtin_model(), run, effects=["offset"])
    Path("d.json").write_text(json.dumps(found.to_dict()))
    save_bundle(builtin_model().with_effects(["offset"], {}), "known")
