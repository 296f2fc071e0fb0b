"""Damaged runs, bundles, fingers and documents give an error of ours: never a crash, a hang or
another exception.

Each format is one line of FORMATS; `damage.py` says how files are spoiled and used. Logs:
test_mutated_logs.py.
"""

import contextlib
import io
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from damage import (
    Format,
    assert_10000,
    assert_some,
    run_all,
    spoil_bundle,
    spoil_many,
    spoil_npz_file,
    spoil_text_file,
)


# --- sound samples -------------------------------------------------------------------------
def run_sample(folder):
    from softmap_edge.run.run import Run

    t = np.arange(12) * 0.5
    Run(
        t=t,
        command=np.column_stack([t, -t]),
        gravity=np.array([0.0, 0, 1]),
        temperature=np.full(12, 20.0),
        frame=np.eye(3, 4),
        frame_sigma=np.ones(6),
        cameras=np.eye(3, 4)[None],
        t_seen=t[::2],
        markers=np.arange(72.0).reshape(6, 4, 3),
        visible=np.ones((6, 4), bool),
        sigma=np.array(0.1),
        block=np.array(list("aabbcc")),
        robot="sample",
        extra={"wind": np.arange(3)},
    ).save(folder / "run.npz")
    return folder / "run.npz"


def clouds_sample(folder):
    from softmap_edge.run.run import Run

    start = np.array([0, 4, 4, 9])
    clouds = Run(
        t=[0.0, 3.0],
        ticks=[[1], [2]],
        t_seen=[0.0, 1, 2],
        points=np.arange(27.0).reshape(9, 3),
        start=start,
    )
    clouds.save(folder / "run.npz")
    return folder / "run.npz"


def finger_sample(folder):
    from softmap_edge.fem import finger

    text = finger._template().replace("#   [template]\n#   handles", "[template]\nhandles")
    (folder / "finger.toml").write_text(text, encoding="utf-8")
    return folder / "finger.toml"


def mesh_sample(name, **how):
    """A bar of tetrahedra as a text file of one of the formats that meshio reads for us."""

    def sample(folder):
        import meshio
        from small_solids import tetrahedra

        nodes, cells = tetrahedra((1, 1, 2))
        with contextlib.redirect_stderr(io.StringIO()):  # it warns that text is slow
            meshio.write(folder / name, meshio.Mesh(nodes, [("tetra", cells)]), binary=False, **how)
        return folder / name

    return sample


def guides_sample(folder):
    (folder / "cable.json").write_text(json.dumps([[4.0, 0.5 * k, 5.0 * k] for k in range(12)]))
    return folder / "cable.json"


def robot_sample(folder):
    shutil.copy(Path(__file__).parents[2] / "examples/tdcr_robot.toml", folder / "robot.toml")
    return folder / "robot.toml"


def rig_sample(folder):
    from softmap_edge.robot.servo.emergency import Beats, Emergency, Line
    from softmap_edge.robot.servo.rig import Rig, RigServo
    from softmap_edge.robot.servo.rig_ceiling import Ceiling

    servos = (
        RigServo(1, "XL330-M288", 2000, 200.0, -900, 900),
        RigServo(2, "XM430-W350", 2100, slew=1000.0),
    )
    stops = Emergency(Line("/dev/gpiochip0", 17), Beats(5006, "/stop.key"))
    ceiling = Ceiling((("slew", 3000.0), ("hold", 1.0), ("jump", (100.0, 2000.0))))
    Rig("/dev/ttyUSB0", 1_000_000, servos, ceiling=ceiling, emergency=stops).write(
        folder / "rig.toml"
    )
    return folder / "rig.toml"


def diagnosis_sample(folder):
    from finger_runs import SOUND

    (folder / "d.json").write_text(json.dumps(SOUND, indent=1), encoding="utf-8")
    return folder / "d.json"


def commands_sample(folder):
    from softmap_edge.experiment.blocks import BLOCKS
    from softmap_edge.robot.drive.command_file import write_commands
    from softmap_edge.run.protocol import Limits

    made = BLOCKS["a known 10 g"].plan(Limits.even(2))
    write_commands(folder / "c.csv", made, "sample")
    lines = (folder / "c.csv").read_text().split("\n")
    # damage meets the head as often as the rows
    (folder / "c.csv").write_text("\n".join(lines[:30]) + "\n")
    return folder / "c.csv"


def sweep_sample(folder):
    from softmap_edge.fem.finger import Finger
    from softmap_edge.fem.simulator import Simulator

    Simulator(Finger.builtin().replace(core=1, layers=4)).sweep([[0.0, 1.0], [0.0]]).save(
        folder / "sweep.npz"
    )
    return folder / "sweep.npz"


def shapes_sample(folder):
    from robots import arc, rings

    place, offset = rings(4, 7)
    u = np.stack(
        [g.ravel() for g in np.meshgrid([-4.0, -1.0, 4.0], [-3.0, 0.0, 3.0], indexing="ij")], axis=1
    )
    known = {"load": np.array([5.0]), "loaded_command": u[:1], "mass": np.array(30.0)}
    np.savez(
        folder / "sweep.npz",
        command=u,
        vertices=arc(u, place, offset),
        triangles=np.array([[0, 1, 7], [1, 8, 7]]),
        robot="arc",
        command_unit="mm",
        gravity=np.array([0.0, 0.0, 1.0]),
        base=np.zeros(3),
        loaded_vertices=arc(u[:1] + 1.0, place, offset),
        **known,
    )
    return folder / "sweep.npz"


def scattered_bundle_sample(folder):
    from robots import arc, rings

    from softmap_edge.model.bundle import save_bundle
    from softmap_edge.sweep.build import model_from_file

    u = np.random.default_rng(0).uniform(-5, 5, (25, 2))
    np.savez(folder / "sweep.npz", command=u, vertices=arc(u, *rings(4, 7)))
    return save_bundle(model_from_file(folder / "sweep.npz"), folder / "bundle")


def bundle_sample(folder):
    from softmap_edge.model.bundle import builtin_model, save_bundle

    return save_bundle(builtin_model(), folder / "bundle")


def residual_sample(folder):
    from softmap_edge.files.npz import Stored
    from softmap_edge.model.bundle import builtin_model, save_bundle
    from softmap_edge.model.shapes import ModeArrays, Nodes

    model, rng = builtin_model(), np.random.default_rng(0)
    over = Nodes(rng.uniform(-9, 9, (6, 2)), np.array([9.0, 9.0]), 3)
    coefficients = Stored(0.1 * rng.normal(size=(9, 2)))
    mean, modes = rng.normal(size=model.prior.size), rng.normal(size=(2, model.prior.size))
    residual = ModeArrays(over, mean, Stored(modes), coefficients)
    return save_bundle(model.with_residual(residual), folder / "bundle")


def own_effect_sample(folder):
    """A bundle with a user's effect, whose code counts how often it was run."""
    import builtins

    from softmap_edge.model.bundle import builtin_model, save_bundle
    from softmap_edge.model.user_effect import load_effect, template

    builtins.runs = 0
    (folder / "mine.py").write_text(f"import builtins\nbuiltins.runs += 1\n{template('mine')}")
    load_effect(folder / "mine.py")
    (folder / "mine.py").unlink()
    return save_bundle(
        builtin_model().with_effects(["mine"], {"mine.share": 0.2}), folder / "bundle"
    )


def elastic_sample(folder):
    from softmap_edge.model.bundle import save_bundle
    from softmap_edge.rod.learn import learn_model
    from softmap_edge.rod.robot import Robot
    from softmap_edge.run.run import Run

    robot = Robot.load(robot_sample(folder)).with_slack(1.0)
    (folder / "robot.toml").unlink()
    t = np.arange(0.0, 40.0, 0.5)
    command = 4.0 * np.sin((0.3 + 0.1 * np.arange(9)) * t[:, None])
    markers = robot.layout.compiled(robot.start).evaluate(command).reshape(-1, 1, 3)
    model = learn_model(Run(t=t, command=command, t_seen=t, markers=markers), robot=robot)
    changed = {change.label: change.null + 0.01 for change in model.changes(["slack"])[:2]}
    return save_bundle(
        model.with_effects(["slack"], {"slack.ratio": 0.5} | changed), folder / "bundle"
    )


# --- use: load, and what everybody does next -----------------------------------------------
def use_run(path):
    from softmap_edge.checks.summary import summary
    from softmap_edge.checks.summary_text import sentences
    from softmap_edge.run.run import Run

    run = Run.load(path)
    json.dumps(summary(run).to_dict())
    sentences(summary(run))
    run.at(np.arange(run.frames) % 2 == 0)
    run.save(path.with_name("again.npz"))
    assert Run.load(path.with_name("again.npz")).hash() == run.hash()


def use_finger(path):
    from softmap_edge.fem.finger import Finger
    from softmap_edge.fem.simulator import Simulator

    finger = Finger.load(path)
    Simulator(finger)
    assert Finger.from_toml(finger.to_toml()) == finger


def use_mesh(path):
    from softmap_edge.fem.bodies import Meshed

    assert len(Meshed(str(path)).cells([]).nodes) > 10


def use_guides(path):
    from softmap_edge.fem.mesh_file import read_guides
    from softmap_edge.fem.tendons import Tendon

    assert np.isfinite(Tendon(points=read_guides(path)).ends()).all()


def use_robot(path):
    from softmap_edge.rod.robot import Robot

    robot = Robot.load(path)
    robot.layout.compiled(robot.coordinates().numbers(np.zeros(len(robot.coordinates().labels))))


def use_rig(path):
    from dataclasses import replace

    from rigs import calibration

    from softmap_edge.model.bundle import builtin_model
    from softmap_edge.robot.servo.limits import effective_limits
    from softmap_edge.robot.servo.rig import read_rig

    rig = read_rig(path)
    rig.write(path.with_name("again.toml"))
    assert read_rig(path.with_name("again.toml")) == rig
    str(effective_limits(rig, replace(builtin_model(), calibration=calibration())))
    effective_limits(rig, replace(builtin_model(), calibration=calibration())).table()


def use_diagnosis(path):
    from softmap_edge.diagnosis.document import Diagnosis
    from softmap_edge.model.bundle import builtin_model

    found = Diagnosis.load(path)
    str(found)
    for entry in found.effects:
        builtin_model().with_effects([entry.name], found.params_of(entry.name))


def use_commands(path):
    from softmap_edge.robot.drive.command_file import read_commands, steps, write_commands

    made, robot = read_commands(path)
    steps(made.notes)
    write_commands(path.with_name("again.csv"), made, robot)


def use_sweep(path):
    from softmap_edge.fem.simulator import Sweep

    sweep = Sweep.load(path)
    sweep.save(path.with_name("again.npz"))
    np.testing.assert_array_equal(Sweep.load(path.with_name("again.npz")).vertices, sweep.vertices)


def use_shapes(path):
    from softmap_edge.sweep.build import model_from_file
    from softmap_edge.sweep.summary import read_summary

    read_summary(path)
    model_from_file(path).prior.evaluate(np.zeros((2, 2)))


def use_bundle(path):
    from softmap_edge.model.bundle import load_bundle
    from softmap_edge.run.run import Run

    model = load_bundle(path)
    model.prior.evaluate(np.zeros((2, model.channels)))
    run = Run(
        t=[0.0, 1.0],
        command=np.ones((2, model.channels)),
        t_seen=[0.5],
        gravity=[1.0, 0, 0],
        load=5.0,
    )
    model.predict(run)
    model.features(run)
    if model.has_earlier_numbers:
        model.with_effects((), {}).predict(run)


def use_own_effect(path):
    import builtins

    from softmap_edge.commands.runs import _bundle, _bundle_lines

    _bundle_lines({"path": str(path), **_bundle(path, asking=False)})
    use_bundle(path)
    assert builtins.runs == 1  # what came in a bundle never was


FORMATS = [
    Format("run", run_sample, spoil_npz_file, use_run),
    Format("run of clouds", clouds_sample, spoil_npz_file, use_run),
    Format("finger", finger_sample, spoil_text_file, use_finger),
    Format("VTK mesh", mesh_sample("bar.vtk", file_format="vtk42"), spoil_text_file, use_mesh),
    Format("Gmsh mesh", mesh_sample("bar.msh", file_format="gmsh22"), spoil_text_file, use_mesh),
    Format("guides", guides_sample, spoil_text_file, use_guides),
    Format("robot", robot_sample, spoil_text_file, use_robot),
    Format("rig", rig_sample, spoil_text_file, use_rig),
    Format("sweep", sweep_sample, spoil_npz_file, use_sweep),
    Format("diagnosis", diagnosis_sample, spoil_text_file, use_diagnosis),
    Format("commands", commands_sample, spoil_text_file, use_commands),
    Format("sweep made elsewhere", shapes_sample, spoil_npz_file, use_shapes),
    Format("scattered bundle", scattered_bundle_sample, spoil_bundle, use_bundle),
    Format("bundle with a residual", residual_sample, spoil_bundle, use_bundle),
    Format("bundle", bundle_sample, spoil_bundle, use_bundle),
    Format("elastic bundle", elastic_sample, spoil_bundle, use_bundle),
    Format("bundle with a user's effect", own_effect_sample, spoil_bundle, use_own_effect),
]


def _die_at_7(path):
    if path.name == "spoilt" and (path.parent.parent / "seed").read_text() == "7":
        os.abort()


# Not a format: what the test of this file's own report uses.
DYING = Format("dying", lambda folder: folder, lambda _, folder, __: folder / "spoilt", _die_at_7)


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_damaged_files(form, tmp_path):
    assert_some(__file__, form, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_500_damaged_files(form, tmp_path):
    assert_some(__file__, form, tmp_path, 500)


@pytest.mark.prove
@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_10000_damaged_files(form, tmp_path):
    assert_10000(__file__, form, tmp_path)


def test_a_child_that_dies_names_its_seed(tmp_path):
    """Without this a crash of the core would leave no way to see it again."""
    with pytest.raises(AssertionError, match="dying, seed 7: exit -6"):
        spoil_many(__file__, DYING, 0, 10, tmp_path)


if __name__ == "__main__":
    run_all([*FORMATS, DYING])
