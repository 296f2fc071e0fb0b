"""The virtual finger: how it differs from the model and by how much, what its run holds and what it
does not.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from logs import published

from benches import moe
from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.commands.experiment import _ahead
from softmap_edge.errors import SoftmapError
from softmap_edge.fem.bodies import Block, Tapered
from softmap_edge.fem.cut import Cut
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.files.npz import read_npz
from softmap_edge.robot.drive.command_file import read_commands, write_commands
from softmap_edge.robot.emulated.laws import OtherSpool, TipWeight, rotation
from softmap_edge.robot.emulated.published_map import PUBLISHED
from softmap_edge.run.protocol import Limits
from softmap_edge.run.run import Run
from softmap_edge.synthetic.finger import HiddenEffect, toured
from softmap_edge.synthetic.virtual_finger import (
    CAMERAS,
    LEAN,
    MEASURED,
    MODULUS,
    PHASE,
    virtual_finger,
)
from softmap_edge.synthetic.virtual_protocol import KINDS, virtual_protocol

FINGER = Finger.builtin().replace(core=2, layers=12)
LIMITS = Limits.of(np.array(FINGER.command_range))
FRAMES = 12


def thinned(protocol, frames=FRAMES):
    """Some of the frames of a protocol."""
    kept = np.linspace(0, protocol.frames - 1, frames).astype(int)
    return replace(protocol, t_seen=protocol.t_seen[kept], block=protocol.block[kept])


PATHS = thinned(virtual_protocol("paths", 0, LIMITS))


@pytest.fixture(scope="module")
def virtual():
    return virtual_finger(1, FINGER)


@pytest.fixture(scope="module")
def measured(virtual):
    return virtual.measure(PATHS)


def rms(difference):
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=-1))))


def test_the_truth_is_one_to_four_millimetres_from_the_nominal_model(virtual, measured):
    _, truth = measured
    nominal = toured(Simulator(FINGER), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), truth["command"])
    assert 1.0 < rms(truth["vertices"] - nominal) < 4.0
    np.testing.assert_allclose(truth["rest"], Simulator(FINGER).template.vertices)


def test_each_difference_acts_and_nothing_else_does(virtual, measured):
    """Without all of them only the elements are others: what is left is below the phase and the
    lean.
    """
    few = replace(PATHS, t_seen=PATHS.t_seen[[3, 6, 9]])
    shapes = virtual.shapes(few)
    without = {
        "phase": {"phase_deg": 0.0},
        "friction": {"friction": None},
        "lean": {"lean_deg": (0.0, 0.0)},
        "modulus": {"modulus": 1.0},
    }
    moved = {
        name: rms(shapes - replace(virtual, **change).shapes(few))
        for name, change in without.items()
    }
    assert (
        min(moved["phase"], moved["lean"]) > 0.5
        and moved["friction"] > 0.15
        and moved["modulus"] > 0.05
    ), moved
    plain = replace(
        virtual, **{key: value for change in without.values() for key, value in change.items()}
    )
    u = plain.truth.to_body(few)
    nominal = toured(Simulator(FINGER.replace(poisson=0.45)), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), u)
    left = rms(plain.shapes(few) - nominal)
    assert 0.02 < left < 0.3, left


def test_what_is_drawn_lies_at_the_stated_place(virtual):
    drawn = [virtual_finger(seed, FINGER) for seed in range(40)]
    modulus, phase = np.array([d.modulus for d in drawn]), np.array([d.phase_deg for d in drawn])
    lean, declared = (
        np.array([d.lean_deg for d in drawn]),
        np.array([d.declared_deg for d in drawn]),
    )
    assert MODULUS[0] <= modulus.min() < 0.9 and 1.1 < modulus.max() <= MODULUS[1]
    assert (
        (np.abs(phase) >= PHASE[0]).all()
        and (np.abs(phase) <= PHASE[1]).all()
        and phase.min() < 0 < phase.max()
    )
    assert 0.7 * LEAN < np.linalg.norm(lean, axis=1).max() <= LEAN
    off = np.linalg.norm(lean - declared, axis=1)
    assert (off > 0).all() and 0.7 * MEASURED < off.max() <= MEASURED
    assert virtual.body.finger.poisson == 0.45 and len({d.friction for d in drawn}) == 40


def test_friction_remembers_where_a_command_was_reached_from(virtual):
    protocol = virtual_protocol("grid", 3, LIMITS)
    effective, commanded = (
        virtual.truth.to_body(protocol),
        replace(virtual.truth, hidden=()).to_body(protocol),
    )
    held_back = commanded - effective
    assert 0.3 < np.abs(held_back).max() < 2.0 and held_back.min() < -0.3 < 0.3 < held_back.max()


def test_the_run_holds_what_hardware_gives_and_nothing_leaks(virtual, measured, tmp_path):
    run, truth = measured
    assert (
        run.command is None and run.vertices is None and run.markers is None and run.present is None
    )
    assert run.ticks.dtype == np.int64 and len(run.start) == run.frames + 1 == FRAMES + 1
    assert (
        float(run.sigma) == CAMERAS.sigma_mm
        and run.robot == FINGER.name
        and "simulated" in str(run.extra["made_by"])
    )
    assert set(run.extra) == {"made_by"}
    apart = np.degrees(np.arccos(np.clip(run.gravity[0] @ truth["gravity"][0], -1.0, 1.0)))
    assert 0.0 < apart <= MEASURED
    lean = np.degrees(np.arccos(truth["gravity"][0, 2]))
    assert lean == pytest.approx(np.linalg.norm(virtual.lean_deg))
    run.save(tmp_path / "run.npz")
    assert Run.load(tmp_path / "run.npz").hash() == run.hash()


def test_ticks_and_millimetres_go_round_within_half_a_tick(measured):
    run, truth = measured
    at = np.searchsorted(run.t, run.t_seen, side="right") - 1
    tick = np.abs(np.array(PUBLISHED.slope)).sum(axis=1)
    assert (np.abs(PUBLISHED.to_mm(run.ticks) - PATHS.command) <= 0.5 * tick).all()
    assert np.array_equal(PUBLISHED.to_ticks(PUBLISHED.to_mm(run.ticks)), run.ticks)
    # Between rows commands are straight lines, and frames lie between rows.
    step = np.abs(np.diff(PATHS.command, axis=0)).max()
    assert (
        np.abs(PUBLISHED.to_mm(run.ticks[at]) - truth["command"]).max() <= step + 0.5 * tick.max()
    )
    noise = run.present_ticks - run.ticks
    assert 0.8 < noise.std() < 1.3 and abs(noise.mean()) < 0.05
    # The published numbers, by hand: 100 ticks of the first servo from home.
    np.testing.assert_allclose(
        PUBLISHED.to_mm([1139.05, 1832.25]), [0.3106 - 1.363, -0.1511 + 0.758]
    )
    with pytest.raises(SoftmapError, match="7794 ticks from home; the servos take ±7000"):
        PUBLISHED.to_ticks([18.0, 18.0])


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(virtual, measured, tmp_path):
    few = thinned(PATHS, 2)
    one, again = virtual.measure(few), virtual_finger(1, FINGER).measure(few)
    other, noise = virtual_finger(2, FINGER).measure(few), virtual.measure(few, noise_seed=1)
    for name, run in (("one", one[0]), ("again", again[0])):
        run.save(tmp_path / name.join(["", ".npz"]))
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "again.npz").read_bytes()
    assert all(np.array_equal(one[1][name], again[1][name]) for name in one[1])
    assert other[0].hash() != one[0].hash() != noise[0].hash()
    assert np.array_equal(noise[1]["vertices"], one[1]["vertices"])
    assert rms(other[1]["vertices"] - one[1]["vertices"]) > 0.5


def test_clouds_lie_on_the_true_surface_within_their_noise(measured):
    """All but the outliers, which lie anywhere near; of a tilted surface only the noise across it
    shows.
    """
    run, truth = measured
    for k in range(run.frames):
        cloud = run.points[run.start[k] : run.start[k + 1]]
        assert 0.6 * CAMERAS.points < len(cloud) <= CAMERAS.points
        surface = _core.Surface(truth["vertices"][k], truth["triangles"].tolist())
        distance = np.sort(surface.nearest(cloud)[1])
        kept = distance[: int((1.0 - CAMERAS.outliers) * len(cloud))]
        assert np.sqrt(np.mean(kept**2)) == pytest.approx(CAMERAS.sigma_mm, rel=0.15)


def tetrahedra_volume(mesh):
    a, b, c, d = (mesh.nodes[mesh.cells[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)).sum() / 6.0


def surface_volume(mesh):
    """By the divergence theorem over the outer faces of bricks, each of two triangles."""
    faces = mesh.cells[
        :, [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    ]
    corners = mesh.nodes[faces.reshape(-1, 4)]
    triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    return np.einsum("ij,ij->", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])) / 6.0


@pytest.mark.parametrize(
    "solid",
    [
        FINGER.solid,
        Finger.builtin().solid,
        Block((16.0, 14.0, 60.0), (3, 2, 9)),
        Tapered(((0.0, 5.0), (80.0, 4.0)), 1, 1, 20),
    ],
)
def test_tetrahedra_fill_the_bricks_and_agree_on_their_faces(solid):
    """A face that two neighbours cut differently would leave nodes that only one of them has: a
    surface inside.
    """
    ends = [0.0, 40.0]
    bricks, cut = Cut(solid).bricks(ends), Cut(solid).cells(ends)
    assert cut.cells.shape == (6 * len(bricks.cells), 10)
    assert tetrahedra_volume(cut) == pytest.approx(surface_volume(bricks), rel=0.02)
    assert tetrahedra_volume(cut) == pytest.approx(surface_volume(solid.cells(ends)), rel=0.02)
    # A node in the middle of an inner face's diagonal belongs to both of its bricks: counted, none
    # is alone.
    corners, edges = len(bricks.nodes), set()
    for cell in np.asarray(cut.cells)[:, :4]:
        edges |= {tuple(sorted((int(cell[i]), int(cell[j])))) for i in range(4) for j in range(i)}
    faces = {
        tuple(sorted(int(n) for n in face))
        for cell in bricks.cells
        for face in cell[FACES_OF_A_BRICK]
    }
    sides = {tuple(sorted((int(c[i]), int(c[j])))) for c in bricks.cells for i, j in SIDES}
    assert len(cut.nodes) == corners + len(edges) and len(edges) == len(sides) + len(faces) + len(
        bricks.cells
    )


FACES_OF_A_BRICK = np.array(
    [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
)
SIDES = [
    (0, 1),
    (1, 2),
    (2, 3),
    (3, 0),
    (4, 5),
    (5, 6),
    (6, 7),
    (7, 4),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
]


def test_the_template_is_embedded_in_the_tetrahedra(virtual):
    """Weightless and untold the body is as it is described: each vertex where the model has it."""
    still = virtual.body.path(np.zeros((1, 2)), gravity=(0.0, 0.0, 0.0))[0]
    np.testing.assert_allclose(still, virtual.template.vertices, atol=1e-6)
    assert virtual.body.template.vertices.shape == Simulator(FINGER).template.vertices.shape


def test_hidden_effects_come_on_top(virtual):
    few = replace(PATHS, t_seen=PATHS.t_seen[[3]])
    gain, weight = HiddenEffect(OtherSpool((0.1, 0.1)), 0.0), HiddenEffect(TipWeight(10.0), 0.0)
    shapes = virtual.shapes(few)
    for secret in (gain, weight):
        assert rms(replace(virtual, hidden=(secret,)).shapes(few) - shapes) > 0.1
    both = replace(virtual, hidden=(weight, gain)).truth
    assert [secret.name for secret in both.hidden] == ["gain", "hysteresis", "gravity", "payload"]


def test_an_imported_mesh_is_turned_as_it_is():
    finger = moe.load(published("moe_finger"))
    made = virtual_finger(0, finger)
    assert made.body.finger.solid == finger.solid
    for tendon, turned in zip(finger.tendons, made.body.finger.tendons):
        np.testing.assert_allclose(
            turned.points, np.array(tendon.points) @ rotation((0, 0, made.phase_deg)).T
        )


@pytest.mark.parametrize("kind", KINDS)
def test_a_protocol_stays_within_the_limits_and_comes_back_from_its_file(kind, tmp_path):
    made = virtual_protocol(kind, 0, LIMITS)
    assert (made.command >= LIMITS.low - 1e-9).all() and (made.command <= LIMITS.high + 1e-9).all()
    step = np.abs(np.diff(made.command, axis=0)) / np.diff(made.t)[:, None]
    assert (step <= np.maximum(LIMITS.fast, 2 * LIMITS.slow) * 1.001).all() and (
        np.diff(made.t_seen) > 0
    ).all()
    write_commands(tmp_path / "f.csv", made, FINGER.name)
    again, robot = read_commands(tmp_path / "f.csv")
    assert robot == FINGER.name and again.frames == made.frames
    np.testing.assert_allclose(again.command, made.command, atol=1e-4)
    assert not np.array_equal(
        virtual_protocol(kind, 1, LIMITS).command[: len(made.t)], made.command
    )


def test_the_grid_is_complete_and_each_command_reached_from_a_neighbour():
    made = virtual_protocol("grid", 0, LIMITS)
    seen = np.stack([np.interp(made.t_seen, made.t, c) for c in made.command.T], axis=1)
    nodes = np.linspace(-12.0, 12.0, 7)
    wanted = np.array([(a, b) for a in nodes for b in nodes])
    near = np.abs(seen[:, None] - wanted[None]).max(axis=2)
    assert sorted(near.argmin(axis=1)) == list(range(49)) and near.min(axis=1).max() < 1e-9
    # Where the last straight move before each capture began.
    way, came = np.diff(made.command, axis=0), []
    for k in np.searchsorted(made.t, made.t_seen):
        last = np.flatnonzero(np.abs(way[:k]).max(axis=1) > 1e-9)[-1]
        same = np.abs(way[last::-1] - way[last]).max(axis=1) < 1e-9
        came.append(made.command[last - np.argmin(same) + 1] - made.command[k])
    np.testing.assert_allclose(np.abs(came).max(axis=1), 4.0)  # mm between nodes
    assert {tuple(np.round(c / 4.0).astype(int)) for c in came} == {
        (a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)
    } - {(0, 0)}
    held = np.stack([np.interp(made.t_seen - 0.5, made.t, c) for c in made.command.T], axis=1)
    np.testing.assert_allclose(held, seen)


def test_what_cannot_be_played_or_drawn_is_reported(tmp_path):
    with pytest.raises(SoftmapError, match="no protocol 'loops'"):
        virtual_protocol("loops", 0, LIMITS)
    with pytest.raises(SoftmapError, match="2401 commands for 4 channels"):
        virtual_protocol("grid", 0, Limits.even(4))
    single = FINGER.replace(pairs=((0, 2),), command_range=((-16.0, 16.0),))
    with pytest.raises(SoftmapError, match="1 commands in mm; the virtual finger has 2 servos"):
        virtual_finger(0, single)
    with pytest.raises(SoftmapError, match="no hidden law 'nonsense'"):
        virtual_finger(0, FINGER, ["nonsense"])


def test_the_commands_write_commands_a_run_and_its_truth_apart(tmp_path, capsys):
    (tmp_path / "finger.toml").write_text(FINGER.to_toml())
    out = {name: str(tmp_path / name) for name in ("grid.csv", "few.csv", "run.npz", "truth.npz")}
    assert main(["next", "--protocol", "grid", "--out", out["grid.csv"]]) == 0
    reported = capsys.readouterr().out
    assert (
        "49 frames" in reported
        and "--seed of `softmap record` draws the finger, not the commands: one for all its runs"
        in reported
    )
    made, robot = read_commands(out["grid.csv"])
    write_commands(out["few.csv"], thinned(made, 3), robot)
    argv = [
        "record",
        out["few.csv"],
        "--sim",
        "--virtual",
        "--finger",
        str(tmp_path / "finger.toml"),
        "--seed",
        "4",
    ]
    assert main([*argv, "--out", out["run.npz"], "--truth", out["truth.npz"], "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert reported["virtual"] and reported["simulated"] and reported["truth"] == out["truth.npz"]
    run, truth = Run.load(out["run.npz"]), read_npz(tmp_path / "truth.npz")
    assert _ahead(made, False) == "a recording of 1.8 minutes; solving its 49 frames one by one"
    assert main([*argv, "--out", str(tmp_path / "spoken.npz")]) == 0
    assert (
        "a recording of 1.8 minutes; solving its 3 frames one by one\n" in capsys.readouterr().err
    )
    assert _ahead(made, True).endswith(
        "finding how strong the hidden effects are, then solving its 49 frames one by one"
    )
    assert (
        truth["vertices"].shape == (3, len(truth["rest"]), 3)
        and run.frames == 3
        and run.command is None
    )
    assert (
        json.loads(str(truth["drawn"]))["seed"] == 4 and str(truth["schema"]) == "softmap.virtual/1"
    )
    for wrong, says in (
        ([*argv, "--out", out["run.npz"], "--truth", out["run.npz"]], "a run stands there"),
        (
            [
                "record",
                out["few.csv"],
                "--sim",
                "--out",
                str(tmp_path / "b.npz"),
                "--truth",
                out["truth.npz"],
            ],
            "--virtual",
        ),
        (["next", "--protocol", "grid", "--standard"], "two protocols"),
        (["next", "d.json", "--protocol", "grid"], "takes no diagnosis"),
    ):
        assert main(wrong) == 2
        assert says in capsys.readouterr().err
