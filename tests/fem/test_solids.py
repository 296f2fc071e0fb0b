"""A finger of any shape: blocks, regions, helices, tensions and imported meshes; bad ones get
one clear line.
"""

import meshio
import numpy as np
import pytest
from small_solids import BLOCK, SIZE, mesh_finger, sag, tetrahedra

from softmap_edge import Run, _core, builtin_model, load_bundle
from softmap_edge.errors import FingerError, RunError, SoftmapError
from softmap_edge.fem.bodies import Block, Meshed
from softmap_edge.fem.build import build_model
from softmap_edge.fem.finger import Finger, Region, Tendon
from softmap_edge.fem.mesh_file import read_mesh
from softmap_edge.fem.simulator import Simulator, Sweep
from softmap_edge.model.bundle import save_bundle
from softmap_edge.sweep.summary import read_summary

TENDONS = """
[cable]
stiffness_n_mm = 20.0
guide_ring_mm = 1.5
anchor_disc_mm = 2.0
[[tendon]]
points_mm = [[4.0, 0.0, 0.0], [3.0, 0.0, 55.0]]
[[tendon]]
angle_deg = 180.0
route_mm = [[0.0, 4.0], [55.0, 3.0]]
"""


def bar(tail=""):
    return Finger.from_toml(BLOCK + tail)


def test_a_block_sags_alike_as_bricks_and_as_a_mesh_in_any_unit_and_frame(tmp_path):
    bricks = sag(bar().replace(solid=Block(SIZE, (6, 6, 24))))
    assert bricks > 0.5
    nodes, cells = tetrahedra((3, 3, 10))
    same = [mesh_finger(tmp_path / "bar.vtk", nodes, cells)]
    turned = nodes[:, [1, 2, 0]] + [3.0, 5.0, 7.0]  # the file's y is up, its z is x
    frame = 'unit = "m"\naxes = ["z", "x", "y"]\norigin_mm = [3.0, 5.0, 7.0]\n'
    (tmp_path / "m").mkdir()
    same.append(
        mesh_finger(tmp_path / "m/bar.msh", 1e-3 * turned, cells, tail=frame, file_format="gmsh22")
    )
    sags = [sag(finger) for finger in same]
    assert sags[0] == pytest.approx(sags[1], rel=1e-9)
    # 6 × 6 × 24 bricks against quadratic tetrahedra of 6 mm, a little stiff at this Poisson's
    # ratio, and of 3 mm.
    refined = sag(same[0].other_mesh())
    assert sags[0] == pytest.approx(bricks, rel=0.05) and refined == pytest.approx(
        bricks, rel=0.015
    )
    assert sag(same[0].replace(refine=0, young_mpa=0.6)) == pytest.approx(sags[0] / 2, rel=0.05)


def test_a_block_without_tendons_is_a_model_without_commands(tmp_path):
    model = load_bundle(save_bundle(build_model(bar()), tmp_path / "bar"))
    assert model.channels == 0 and model.structure.cables is None
    rest = model.prior.evaluate(np.zeros((1, 0))).reshape(-1, 3)
    assert (rest - model.rest)[model.tip_indices, 0].mean() > 0.5
    assert model.rest[model.tip_indices, 2].min() > SIZE[2] - 1e-6
    assert "gravity_x" in model.fields and 0 < model.vertex_error_mm < 1.0


def test_a_stiffer_half_bends_the_finger_away_and_a_stiffer_root_holds_it():
    plain = bar(TENDONS + "[[command]]\ntendons = [0]\nrange_mm = [0.0, 8.0]\n").replace(
        gravity=(0.0, 0.0, 1.0)
    )
    assert Finger.from_toml(plain.to_toml()) == plain
    sided = plain.replace(regions=(Region(0.6, side_deg=90.0),))
    assert Finger.from_toml(sided.to_toml()) == sided

    def tip(finger):
        simulator = Simulator(finger)
        rest = simulator.template.vertices
        return (simulator.path([[6.0]])[0] - rest)[rest[:, 2] > SIZE[2] - 1e-6].mean(axis=0)

    assert abs(tip(plain)[1]) < 0.05 and tip(sided)[1] < -1.0  # the softer side shortens more
    sag_ratio = sag(bar().replace(regions=(Region(0.6, z=(0.0, 30.0)),))) / sag(bar())
    # the half next to the clamp is 15/16 of a slender bar's sag: 0.53
    assert 0.45 < sag_ratio < 0.65


def test_a_helix_twists_its_finger():
    builtin = Finger.builtin().replace(core=2, layers=16)
    route = ((0.0, 8.0), (95.0, 6.0))

    def twist(turn):
        tendon = Tendon(0.0, route, turn_deg=turn)
        finger = builtin.replace(tendons=(tendon,), pairs=((0,),), command_range=((0.0, 10.0),))
        assert Finger.from_toml(finger.to_toml()) == finger
        simulator = Simulator(finger)
        rest = simulator.template.vertices
        moved = simulator.path([[6.0]])[0] - rest
        ring = np.abs(rest[:, 2] - rest[np.argmin(np.abs(rest[:, 2] - 60)), 2]) < 1e-6
        at, by = rest[ring, :2], (moved - moved[ring].mean(axis=0))[ring, :2]
        return float(
            np.mean(at[:, 0] * by[:, 1] - at[:, 1] * by[:, 0]) / np.mean((at**2).sum(axis=1))
        )

    assert abs(twist(0.0)) < 1e-3
    assert twist(120.0) == pytest.approx(-twist(-120.0), abs=1e-3) and abs(twist(120.0)) > 0.01


def test_a_finger_pulled_by_tension_carries_newtons_everywhere(tmp_path):
    tail = "[[command]]\ntendons = [0, 1]\nrange_n = [-3.0, 3.0]\n"
    finger = bar(TENDONS + tail).replace(gravity=(0.0, 0.0, 1.0))
    assert finger.command_unit == "N" and Finger.from_toml(finger.to_toml()) == finger
    simulator = Simulator(finger)
    sweep = simulator.sweep([[-3.0, -1.0, 0.0, 2.0]])
    np.testing.assert_allclose(sweep.tension, [[0, 3], [0, 1], [0, 0], [2, 0]], atol=1e-12)
    sweep.save(tmp_path / "sweep.npz")
    assert Sweep.load(tmp_path / "sweep.npz").finger.command_unit == "N"
    assert read_summary(tmp_path / "sweep.npz")["command_unit"] == "N"
    # The shortening that gives 2 N gives the same shape.
    by_length = bar(TENDONS + tail.replace("range_n", "range_mm")).replace(gravity=(0.0, 0.0, 1.0))
    other = Simulator(by_length)
    low, high = 0.0, 3.0
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if other.sweep([[middle]]).tension[0, 0] < 2.0 else (low, middle)
    np.testing.assert_allclose(other.path([[low]])[0], sweep.vertices[3], atol=1e-3)
    model = load_bundle(save_bundle(build_model(finger, 9), tmp_path / "pulled"))
    assert model.command_unit == "N" and model.structure.cables is None
    t = np.arange(3.0)
    pulled = Run(
        t=t,
        t_seen=t,
        command=np.full((3, 1), 2.0),
        command_unit="N",
        gravity=np.array([0.0, 0.0, 1.0]),
    )
    # A cubic through nine commands against the solved shape.
    assert np.abs(model.predict(pulled)[0] - sweep.vertices[3]).max() < 0.2
    with pytest.raises(RunError, match="takes N; a length is not a tension"):
        model.predict(Run(t=t, t_seen=t, command=np.full((3, 1), 2.0)))
    with pytest.raises(RunError, match="takes mm"):
        builtin_model().predict(Run(t=t, t_seen=t, command=np.zeros((3, 2)), command_unit="N"))


REFUSED = [
    ("[[command]]\ntendons = [0]\nrange_n = [-1.0, 5.0]\n", "cannot push"),
    (
        "[[command]]\ntendons = [0]\nrange_n = [0.0, 5.0]\n[[command]]\ntendons = [1]\nrange_mm = "
        "[0.0, 5.0]\n",
        "mixed",
    ),
    ("[[command]]\ntendons = [0]\nrange_n = [0.0, 5.0]\nrange_mm = [0.0, 5.0]\n", "in mm or in N"),
    ("[[region]]\nyoung_mpa = 0.5\n", "at least one of"),
    ("[[region]]\nyoung_mpa = 0.5\nz_mm = [30.0, 20.0]\n", "z_mm"),
    ("[[region]]\nyoung_mpa = 0.5\nheight_mm = 3.0\n", "height_mm"),
    ('[[tendon]]\npoints_file = "cable.json"\n', "mesh"),
    ("[[tendon]]\npoints_mm = [[0.0, 0.0, 0.0]]\n", "points"),
    ("[[tendon]]\npoints_mm = [[0.0, 0.0, 9.0], [0.0, 0.0, 3.0]]\n", "ascend"),
    ('[mesh]\nfile = "a.vtk"\n', "block and mesh"),
]


@pytest.mark.parametrize(("tail", "named"), REFUSED)
def test_a_bad_table_is_named_in_one_line(tail, named):
    with pytest.raises(FingerError) as caught:
        bar(TENDONS + tail)
    assert named in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (dict(gravity=(0.0, 0.0, 9.81)), "not in m/s2"),
        (dict(density_kg_m3=1.07), "g/cm3"),
        (dict(regions=(Region(0.4, z=(4000.0, 6000.0)),)), "holds nothing"),
    ],
)
def test_another_unit_is_not_taken_for_a_strange_finger(change, says):
    with pytest.raises(FingerError, match=says):
        Simulator(bar(TENDONS).replace(**change))


def test_a_tendon_outside_a_block_is_refused():
    with pytest.raises(FingerError, match="outside the solid"):
        Simulator(bar(TENDONS.replace("[4.0, 0.0, 0.0]", "[7.5, 0.0, 0.0]")))


def _alone(mesh):
    mesh.points = np.vstack([mesh.points, [[1.0, 1.0, 1.0]]])


def _twice(mesh):
    shift, block = len(mesh.points), mesh.cells[0]
    block.data = np.vstack([block.data, block.data + shift])
    mesh.points = np.vstack([mesh.points, mesh.points + [40.0, 0.0, 0.0]])


def _doubled(mesh):
    block = mesh.cells[0]
    block.data = np.vstack([block.data, block.data[:2]])


def _torn(mesh):
    """Each cell with nodes of its own: they touch, and nothing joins them."""
    block = mesh.cells[0]
    mesh.points = mesh.points[block.data].reshape(-1, 3)
    block.data = np.arange(block.data.size).reshape(-1, 4)


def _surface(mesh):
    mesh.cells = [meshio.CellBlock("triangle", mesh.cells[0].data[:, :3])]


def _flat(mesh):
    mesh.cells[0].data[5, 0] = mesh.cells[0].data[5, 1]


def _mirrored(mesh):
    mesh.points[:, 0] *= -1.0


def _metres(mesh):
    mesh.points = mesh.points * 1e-3


def _hanging(mesh):
    mesh.points = mesh.points + [0.0, 0.0, 5.0]


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (_alone, "belong to no tetrahedron"),
        (_twice, "2 separate bodies"),
        (_doubled, "there twice"),
        (_torn, "merge coincident nodes"),
        (_surface, "mesh the volume"),
        (_flat, "1 flat"),
        (_mirrored, "inside out"),
        (_metres, "unit"),
        (_hanging, "held"),
    ],
)
def test_a_bad_mesh_gets_one_clear_line(spoil, says, tmp_path):
    nodes, cells = tetrahedra()
    assert Simulator(mesh_finger(tmp_path / "good.vtk", nodes, cells))
    with pytest.raises(FingerError) as caught:
        Simulator(mesh_finger(tmp_path / "bad.vtk", nodes, cells, spoil))
    assert says in str(caught.value) and "\n" not in str(caught.value)


def test_a_mesh_that_is_none_is_refused(tmp_path):
    nodes, cells = tetrahedra()
    finger = mesh_finger(tmp_path / "bar.vtk", nodes, cells)
    for name, content in (
        ("bar.vtk", b"nonsense"),
        ("bar.vtk", b""),
        ("bar.msh", b"$MeshFormat\n4.1 0 8\n"),
        ("x.stl", b"s"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FingerError, match=name):
            Simulator(finger.replace(solid=Meshed(str(tmp_path / name))))
    with pytest.raises(FingerError, match="absent.vtk"):
        Simulator(finger.replace(file=str(tmp_path / "absent.vtk")))
    for axes in (("x", "y", "-z"), ("x", "x", "z"), ("x", "y"), ("x", "y", "up")):
        with pytest.raises(FingerError, match="right-handed"):
            finger.replace(axes=axes)


@pytest.mark.long
def test_damaged_meshes_and_guides_give_errors_never_a_crash(tmp_path):
    nodes, cells = tetrahedra((1, 1, 3))
    guides = tmp_path / "cable.json"
    finger = mesh_finger(tmp_path / "bar.vtk", nodes, cells)
    mesh_finger(tmp_path / "bar.msh", nodes, cells, file_format="gmsh22")
    rng, refused = np.random.default_rng(8), 0
    for name in ("bar.vtk", "bar.msh"):
        whole = (tmp_path / name).read_bytes()
        for k in range(150):
            mutant = bytearray(whole[: len(whole) if k % 3 else rng.integers(1, len(whole))])
            for place in rng.integers(0, len(mutant), rng.integers(1, 9)):
                mutant[place] = rng.integers(32, 127) if k % 2 else rng.integers(0, 256)
            (tmp_path / name).write_bytes(bytes(mutant))
            try:
                mesh = read_mesh(tmp_path / name)
                read = mesh.points, mesh.cells
                finger.solid.cells([]) if name == "bar.vtk" else _core.Mesh.tetrahedra(*read, 0)
            except SoftmapError as error:
                refused += 1
                assert "\n" not in str(error) and len(str(error)) < 600
    assert refused > 150
    for text in (
        "[]",
        "[[1, 2]]",
        "[[1, 2, 3]]",
        "{",
        '[["a", 2, 3], [1, 2, 3]]',
        "[" * 100_000,
        "[[1e999, 0, 0], [1, 2, 3]]",
    ):
        guides.write_text(text)
        with pytest.raises(FingerError):
            toml = (
                tmp_path / "finger.toml"
            ).read_text() + '[[tendon]]\npoints_file = "cable.json"\n'
            Finger.from_toml(toml + TENDONS[: TENDONS.index("[[tendon]]")], tmp_path)


def test_the_progress_of_a_build_rises_evenly_over_all_its_parts():
    """Not from 0 to 1 for each part, nor in a jump: a bar of it goes right."""
    heard = []
    build_model(bar(), progress=lambda what, share: heard.append((what, share)))
    shares = [share for _, share in heard]
    assert shares == sorted(shares) and shares[-1] == pytest.approx(1.0)
    assert len({what for what, _ in heard}) == 4
    assert all(later - before < 0.3 for before, later in zip(shares, shares[1:]))
