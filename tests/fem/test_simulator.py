"""A user describes a finger, simulates it, saves the sweep, and gets a message on a bad
description.
"""

import json

import numpy as np
import pytest

from softmap_edge import _core
from softmap_edge.errors import FingerError, NoEquilibriumError, SimulationError, SoftmapError
from softmap_edge.fem.finger import Finger, Tendon
from softmap_edge.fem.simulator import Simulator, Sweep
from softmap_edge.files.npz import read_npz


@pytest.fixture(scope="module")
def coarse():
    """The built-in finger on a mesh that solves in milliseconds."""
    return Finger.builtin().replace(core=2, layers=16)


@pytest.fixture(scope="module")
def simulator(coarse):
    return Simulator(coarse)


def test_builtin_finger_has_the_stated_template():
    simulator = Simulator(Finger.builtin())
    template = simulator.template
    assert template.vertices.shape == (548, 3)
    assert template.triangles.dtype == np.int32
    corners = template.vertices[template.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    volume_cm3 = np.einsum("ij,ij->", corners[:, 0], normals) / 3e3
    z, r = np.array(Finger.builtin().solid.profile).T
    cones = np.pi / 3 * np.diff(z) * (r[1:] ** 2 + r[1:] * r[:-1] + r[:-1] ** 2)
    # layers cut the profile's corners
    assert volume_cm3 == pytest.approx(cones.sum() / 1e3, rel=5e-3)
    np.testing.assert_allclose(normals.sum(axis=0), 0, atol=1e-9)


def test_positive_command_bends_towards_its_first_tendon(simulator):
    tip = simulator.template.vertices[:, 2] > 110
    x_pulled, y_pulled, x_paid = simulator.path([[8.0, 0.0], [0.0, 8.0], [-8.0, 0.0]])[:, tip].mean(
        axis=1
    )
    assert x_pulled[0] > 15 and abs(x_pulled[1]) < 1e-4
    assert y_pulled[1] > 15 and abs(y_pulled[0]) < 1e-4
    np.testing.assert_allclose(x_paid, x_pulled * [-1, 1, 1], atol=1e-4)


def test_sweep_is_in_c_order_reports_progress_and_survives_its_file(simulator, tmp_path):
    shares = []
    axes = [np.array([-4.0, 0.0, 4.0]), np.array([-2.0, 3.0])]
    sweep = simulator.sweep(axes, progress=shares.append)
    np.testing.assert_array_equal(sweep.command[:3], [[-4, -2], [-4, 3], [0, -2]])
    np.testing.assert_allclose(sweep.vertices, simulator.path(sweep.command), atol=1e-4)
    assert sweep.tension.shape == (6, 4)
    assert sweep.tension.min() == 0 and sweep.tension[:, 0].argmax() in (4, 5)
    assert shares[-1] == 1.0 and shares == sorted(shares)
    sweep.save(tmp_path / "sweep.npz")
    back = Sweep.load(tmp_path / "sweep.npz")
    for name in ("command", "vertices", "tension"):
        np.testing.assert_array_equal(getattr(back, name), getattr(sweep, name))
    np.testing.assert_array_equal(back.axes[1], axes[1])
    np.testing.assert_array_equal(back.triangles, simulator.template.triangles)
    assert (
        back.finger == simulator.finger
        and back.gravity.tolist() == [0, 0, 1]
        and not back.tip_force.any()
    )
    # The content of the file makes the same shapes again: nothing else has to be known.
    again = Simulator(back.finger).sweep(back.axes, gravity=back.gravity, load=back.tip_force)
    np.testing.assert_array_equal(again.vertices, back.vertices)
    stored = read_npz(tmp_path / "sweep.npz")
    assert (
        json.loads(str(stored["units"]))["vertices"] == "mm"
        and json.loads(str(stored["effects"])) == []
    )


def test_same_input_gives_the_same_bytes(simulator):
    commands = np.random.default_rng(3).uniform(-6, 6, (70, 2))  # more than one chunk
    assert simulator.path(commands).tobytes() == simulator.path(commands).tobytes()


def test_gravity_and_load_move_the_finger_as_their_fields_say(simulator):
    command = [[5.0, -3.0]]
    compliance = simulator.fields(command)
    fields, stretch = compliance.fields, compliance.stretch
    loads = [f"{kind}_{axis}" for kind in ("gravity", "tip_force") for axis in "xyz"]
    assert list(fields) == [*loads, *(f"tension_{t}" for t in range(4))]
    first = len(_core.FIELDS)
    assert stretch.shape == (1, 4, first + 4)
    # Pulling a tendon shortens its path; what one does to another's path the other does to the
    # one's.
    assert (np.diagonal(stretch[0, :, first:]) < 0).all()
    assert np.allclose(stretch[0, :, first:], stretch[0, :, first:].T, rtol=1e-6, atol=1e-9)
    # Declared gravity and load, answered by the fields and the tendons without solving again.
    flat = [np.array([-10.0, 10.0])] * 2

    def table(numbers):
        return _core.Table(
            flat, np.tile(numbers.ravel(), (4, 1)), np.zeros(numbers.size), np.eye(numbers.size)
        )

    vertices, pull = simulator.solid.path(
        np.array(command), np.array([[0.0, 0.0, 1.0]]), (0.0, 0.0, 0.0)
    )
    tensions = [table(fields[f"tension_{t}"]) for t in range(4)]
    cables = _core.Cables(
        np.full(4, simulator.finger.cable_stiffness_n_mm), table(pull), table(stretch), tensions
    )
    for heavy, load in (
        ([0.05, 0.0, 1.0], 0.0),
        ([0.0, 0.0, 1.0], 10.0),
        ([0.4, -0.3, 0.87], 20.0),
    ):
        seen = (
            simulator.path(command, gravity=heavy, load=9.80665e-3 * load * np.array(heavy))[0]
            - vertices[0]
        )

        def said(cables, heavy=heavy, load=load, seen=seen):
            body = {name: table(fields[name]) for name in loads}
            predictor = _core.Predictor(
                table(vertices), body, np.ones(len(seen), bool), [0.0, 0.0, 1.0], cables
            )
            record = np.array(command * 2), np.array([0.0, 1.0]), np.array([0.5])
            chain = _core.Chain([], 2)
            world = {"gravity": np.array([heavy] * 2), "load": np.full(2, load)}
            return (
                predictor.predict(chain, np.zeros((1, 0)), _core.Inputs(*record, **world))[0, 0]
                - vertices[0]
            )

        # Linear to a few per cent; if the tensions stayed as they are, the body would move about
        # twice as far.
        assert np.linalg.norm(seen - said(cables)) < 0.08 * np.linalg.norm(seen)
        assert np.linalg.norm(seen - said(None)) > 0.3 * np.linalg.norm(seen) > 0.1


def test_gravity_may_change_along_a_path(simulator):
    gravity = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 0.8]])
    both = simulator.path(np.zeros((2, 2)), gravity=gravity)
    np.testing.assert_allclose(
        both[1], simulator.path(np.zeros((1, 2)), gravity=gravity[1])[0], atol=1e-4
    )
    assert np.abs(both[1] - both[0]).max() > 0.2
    np.testing.assert_allclose(both[0], simulator.rest(), atol=1e-4)


def test_another_mesh_reports_the_same_material_points():
    finger = Finger.builtin().replace(layers=30)
    own = Simulator(finger)
    other = Simulator(finger.other_mesh(), template=own.template)
    command = [[8.0, 0.0]]
    one, two = own.path(command)[0], other.path(command)[0]
    assert one.shape == two.shape
    difference = np.linalg.norm(one - two, axis=1)
    moved = np.linalg.norm(one - own.template.vertices, axis=1)
    # Meshes differ by their discretisation error; points taken for their neighbours would be off by
    # a cell (3 mm).
    assert difference.mean() < 0.05 * moved.mean() and difference.max() < 2.0


def test_finger_survives_its_file(tmp_path):
    builtin = Finger.builtin()
    finger = builtin.replace(
        name='a "quoted" näme', tendons=builtin.tendons[:3], pairs=((0, 2), (1,))
    )
    (tmp_path / "finger.toml").write_text(finger.to_toml(), encoding="utf-8")
    assert Finger.load(tmp_path / "finger.toml") == finger
    assert Finger.from_toml(Finger.builtin().to_toml()) == Finger.builtin()


def test_three_single_tendons_make_three_commands():
    builtin = Finger.builtin().replace(core=1, layers=10)
    tendons = tuple(Tendon(angle, builtin.tendons[0].route) for angle in (0.0, 120.0, 240.0))
    finger = builtin.replace(
        tendons=tendons, pairs=((0,), (1,), (2,)), command_range=((-2.0, 10.0),) * 3
    )
    sweep = Simulator(finger).sweep([[0.0, 3.0]] * 3)
    assert sweep.vertices.shape[0] == 8 and sweep.tension.shape == (8, 3)
    tip = sweep.vertices[:, -1]
    assert tip[4, 0] > 1 and tip[2, 1] > 1 and tip[1, 1] < -1


BAD = [
    (dict(young_mpa=-1.0), "young_mpa"),
    (dict(young_mpa=float("nan")), "young_mpa"),
    (dict(poisson=0.5), "poisson"),
    (dict(poisson="soft"), "poisson"),
    (dict(core=0), "core"),
    (dict(layers=2.5), "layers"),
    (dict(gravity=(0.0, 0.0, float("inf"))), "gravity_g"),
    (dict(profile=((0.0, 10.0), (0.0, 9.0))), "profile_mm"),
    (dict(profile=((0.0, 10.0), (110.0, 9.0))), "outside the solid"),
    (dict(tendons=(Tendon(0.0, ((0.0, 15.5), (95.0, 5.0))),)), "outside the solid"),
    (dict(tendons=(Tendon(0.0, ((0.0, 12.0), (130.0, 5.0))),)), "inside the solid"),
    (dict(pairs=((0, 2), (1, 2))), "tendons"),
    (dict(pairs=((0, 7), (1, 3))), "tendons"),
    (dict(command_range=((16.0, -16.0), (-16.0, 16.0))), "range_mm"),
    (dict(command_range=((-16.0, 16.0),)), "command_range"),
    (
        dict(handles=0),
        "template.handles: 0; allowed are whole numbers 1 to 50000; without [template] all",
    ),
    (dict(handles=0.5), "template.handles: 0.5"),
    (dict(handles="many"), "template.handles: 'many'"),
    (dict(handles=True), "template.handles: True"),
    (dict(colour="red"), "colour"),
    (dict(name=""), "name"),
]


@pytest.mark.parametrize(("changes", "named"), BAD)
def test_a_bad_field_is_named_in_one_line(changes, named):
    with pytest.raises(FingerError) as caught:
        Finger.builtin().replace(**changes)
    assert named in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("[mesh]", "[meshes]", "meshes"),
        ("core = 3", "", "'core' is missing"),
        ("core = 3", "core = 3\ncores = 4", "cores"),
        ("young_mpa = ", "young_mpa = !", "TOML"),
        ('name = "moe-finger"', "name = 3", "name"),
        ("gravity_g = [0.0, 0.0, 1.0]", "gravity_g = 1.0", "gravity_g"),
        ("[mounting]", "[template]\n[mounting]", "'handles' is missing"),
        ("[mounting]", "[template]\nhandles = nan\n[mounting]", "template.handles: nan"),
        ("[mounting]", "[template]\nhandles = 9\nstart = 3\n[mounting]", "unknown key 'start'"),
        ("[mounting]", "[[template]]\nhandles = 9\n[mounting]", "expected a table [template]"),
        ("[0.0, 16.2]", "16.2", "profile_mm"),
        ("[0.0, 16.2]", '[0.0, "wide"]', "profile_mm"),
    ],
)
def test_a_bad_file_is_refused_with_its_name(tmp_path, old, new, named):
    text = Finger.builtin().to_toml()
    assert old in text
    path = tmp_path / "finger.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(FingerError) as caught:
        Finger.load(path)
    assert named in str(caught.value) and "finger.toml" in str(caught.value)


def test_missing_and_binary_finger_files_are_refused(tmp_path):
    (tmp_path / "binary.toml").write_bytes(bytes(range(128, 256)))
    for name in ("absent.toml", "binary.toml"):
        with pytest.raises(FingerError, match=name):
            Finger.load(tmp_path / name)


def test_mutated_finger_files_give_errors_never_a_crash(tmp_path):
    rng = np.random.default_rng(11)
    text = Finger.builtin().to_toml().encode()
    refused = 0
    for _ in range(500):
        mutant = bytearray(text)
        for place in rng.integers(0, len(mutant), rng.integers(1, 6)):
            mutant[place] = rng.integers(0, 256)
        path = tmp_path / "mutant.toml"
        path.write_bytes(bytes(mutant[: rng.integers(len(mutant) // 2, len(mutant) + 1)]))
        try:
            Finger.load(path)
        except SoftmapError:
            refused += 1
    assert refused > 300


def test_bad_requests_are_refused(simulator):
    for request in (
        lambda: simulator.path([[1.0]]),
        lambda: simulator.path([[1.0, float("nan")]]),
        lambda: simulator.path([["a", "b"]]),
        lambda: simulator.path([[1.0, 0.0]], gravity=np.zeros((2, 3))),
        lambda: simulator.path([[1.0, 0.0]], load=(0.0, 1.0)),
        lambda: simulator.sweep([[0.0, 1.0]]),
        lambda: simulator.sweep([[1.0, 0.0], [0.0, 1.0]]),
        lambda: simulator.sweep([[], [0.0, 1.0]]),
    ):
        with pytest.raises(SimulationError):
            request()


def test_an_impossible_load_says_where_and_what_to_try(simulator):
    with pytest.raises(NoEquilibriumError, match=r"tip load .* out of balance .* try"):
        simulator.path([[0.0, 0.0]], load=(0.0, 0.0, -1e6))


def test_a_template_of_another_finger_is_refused(coarse):
    wide = Simulator(coarse.replace(profile=((0.0, 30.0), (116.75, 20.0)))).template
    with pytest.raises(FingerError, match="outside the solid"):
        Simulator(coarse, template=wide)


def test_damaged_sweeps_are_refused(simulator, tmp_path):
    path = tmp_path / "sweep.npz"
    simulator.sweep([[0.0, 1.0], [0.0]]).save(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(5)
    refused = 0
    for _ in range(200):
        mutant = bytearray(whole[: rng.integers(1, len(whole) + 1)])
        mutant[rng.integers(0, len(mutant))] ^= 255
        path.write_bytes(bytes(mutant))
        try:
            Sweep.load(path)
        except SimulationError:
            refused += 1
    assert refused > 150
    with pytest.raises(SimulationError, match="absent"):
        Sweep.load(tmp_path / "absent.npz")


@pytest.mark.prove
def test_full_sweep_has_no_failed_command():
    axis = np.linspace(-16, 16, 41)
    sweep = Simulator(Finger.builtin()).sweep([axis, axis])
    assert np.isfinite(sweep.vertices).all() and len(sweep.command) == 1681
    turned = sweep.vertices.reshape(41, 41, 548, 3)[::-1, ::-1]
    tips = sweep.vertices.reshape(41, 41, 548, 3)[:, :, -28:].mean(axis=2)
    np.testing.assert_allclose(turned[:, :, -28:].mean(axis=2), tips * [-1, -1, 1], atol=1e-3)
