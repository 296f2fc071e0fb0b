"""Messages that name a command, each with what provokes it and what has to work once the command has run.

A case is a row of `CASES`; add one for each message whose remedy runs without hardware. `make` writes the files into an
empty folder, `fails` is what brings the message, `names` is the command in it, `remedy` are commands that carry it
out (placeholders filled in), and `works` must then end with 0 without the message. `tests/test_remedies.py` runs them.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from test_learn_ticks import CASE, arm
from tick_runs import HOME, record, scattered

from softmap_edge import Run, builtin_model, learn_model, save_bundle
from softmap_edge.truth_clouds import FULL


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


def _finger(size: float = 8.0, shift: Sequence[float] = (0.0, 0.0, 0.0), effects: Sequence[str] = ()) -> Run:
    """The built-in finger, which visits home and four corners, seen by a camera that stands `shift` mm away."""
    model, rng = builtin_model(), np.random.default_rng(0)
    places = size * np.array([[0, 0], [1, 0], [0, 0], [0, 1], [-1, 0], [0, 0], [0, -1], [0, 0]], float)
    goal = np.repeat(np.tile(places, (2, 1)), 10, axis=0)
    t = np.arange(len(goal)) * 0.5
    blank = Run(t=t, command=goal, t_seen=t, robot=model.robot)
    points = model.with_effects(effects, {}).predict(blank) + rng.normal(0, 0.2, (len(t), len(model.rest), 3))
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
    """A finger that pulls 2 mm farther than commanded, and a bundle that knows an offset already."""
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


HOMES = [str(ticks) for ticks in HOME]
CALIBRATED = ["calibrate", "ticks.npz", "--bundle", "finger", "--home", *HOMES, "--out", "calibrated"]
CASES = [
    Remedy(
        "ticks without a model", lambda: arm().save("ticks.npz"), ["compare", "ticks.npz"],
        "softmap learn RUN --out DIR",
        [["learn", "ticks.npz", "--static", "--out", "b"]], ["compare", "ticks.npz", "--bundle", "b"],
    ),
    Remedy(
        "ticks and a model in mm", _ticks_of_a_finger, ["compare", "ticks.npz", "--bundle", "finger"],
        "softmap calibrate RUN --bundle DIR --out DIR2", [CALIBRATED],
        ["compare", "ticks.npz", "--bundle", "calibrated"],
    ),
    Remedy(
        "check of a run in ticks", lambda: arm().save("ticks.npz"), ["check", "ticks.npz"], "softmap learn",
        [["learn", "ticks.npz", "--static", "--out", "b"]], ["compare", "ticks.npz", "--bundle", "b"], code=0,
    ),
    Remedy(
        "commands in ticks and a model in mm", lambda: (_two_units(), arm(held=True).save("held.npz")),
        ["compare", "held.npz", "--bundle", "mm"], "softmap learn",
        [["learn", "held.npz", "--static", "--out", "b"]], ["compare", "held.npz", "--bundle", "b"],
    ),
    Remedy(
        "a log in place of a run", _log, ["compare", "log.csv"], "softmap import",
        [
            ["import", "log.csv", "--guess", "--out", "m.toml"],
            ["import", "log.csv", "--map", "m.toml", "--out", "r.npz"],
            ["learn", "r.npz", "--static", "--out", "b"],
        ],
        ["compare", "r.npz", "--bundle", "b"],
    ),
    Remedy(
        "clouds", write_clouds, ["compare", "clouds.npz"], "softmap register",
        [["register", "clouds.npz", "--out", "registered.npz"]], ["compare", "registered.npz"],
    ),
    Remedy(
        "a camera's frame", lambda: _finger(shift=(40.0, 300.0, 700.0)).save("camera.npz"), ["compare", "camera.npz"],
        "softmap align", [["align", "camera.npz", "--out", "aligned.npz"]], ["compare", "aligned.npz"], code=0,
    ),
    Remedy(
        "check of a camera's frame", lambda: _finger(shift=(40.0, 300.0, 700.0)).save("camera.npz"),
        ["check", "camera.npz"], "softmap align", [["align", "camera.npz", "--out", "aligned.npz"]],
        ["check", "aligned.npz"], code=0,
    ),
    Remedy(
        "a frame that was never found", lambda: (_finger(shift=(9.0, 0.0, 0.0)).save("a.npz"), _finger().save("b.npz")),
        ["align", "a.npz", "--like", "b.npz", "--out", "c.npz"], "softmap align",
        [["align", "b.npz", "--out", "aligned.npz"]], ["align", "a.npz", "--like", "aligned.npz", "--out", "c.npz"],
    ),
    Remedy(
        "calibrate with effects", lambda: _ticks_of_a_finger(["gain"]), CALIBRATED, "softmap remove",
        [["remove", "gain", "--bundle", "finger", "--out", "finger", "--force"]], CALIBRATED,
    ),
    Remedy(
        "no diagnosis", _no_diagnosis, ["add", "--from", "d.json", "--bundle", "plain", "--out", "b"],
        "softmap diagnose",
        [["diagnose", "run.npz", "--bundle", "plain", "--effects", "offset", "--out", "d.json"]],
        ["add", "--from", "d.json", "--bundle", "plain", "--out", "b"],
    ),
    Remedy(
        "an effect that is there", lambda: (_with_offset(), _diagnosed()),
        ["add", "offset", "--from", "d.json", "--bundle", "known", "--out", "b"], "softmap refit",
        [["refit", "run.npz", "--bundle", "known", "--out", "refitted"]],
        ["compare", "run.npz", "--bundle", "refitted"],
    ),
    Remedy(
        "no effect is named", _learned, ["remove", " , ", "--bundle", "bundle", "--out", "b"], "softmap effects",
        [["effects"]], ["compare", "run.npz", "--bundle", "bundle"],
    ),
    Remedy(
        "a file of commands that is none", lambda: Path("c.csv").write_text("a,b\n1,2\n"),
        ["record", "c.csv", "--sim", "--out", "r.npz"], "softmap next --out",
        [["next", "--protocol", "validation", "--minutes", "1", "--out", "n.csv"]],
        ["record", "n.csv", "--sim", "--out", "r.npz"],
    ),
    Remedy(
        "a new effect without a name", lambda: None, ["effects", "new"], "softmap effects new wobble",
        [["effects", "new", "wobble"]], ["effects", "wobble", "--effects", "wobble.py"],
    ),
]  # fmt: skip


def _diagnosed() -> None:
    """A diagnosis that names the offset, and a bundle that has it."""
    from softmap_edge import diagnose

    run = Run.load("run.npz")
    found = diagnose(builtin_model(), run, effects=["offset"])
    Path("d.json").write_text(json.dumps(found.to_dict()))
    save_bundle(builtin_model().with_effects(["offset"], {}), "known")
