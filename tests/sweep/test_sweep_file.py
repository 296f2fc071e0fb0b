"""An imported sweep is checked field by field: an error is one line that says what is wrong and
what to do.
"""

import numpy as np
import pytest
from robots import arc, rings

from softmap_edge.cli import main
from softmap_edge.errors import SweepError
from softmap_edge.sweep.sweep_file import ShapeSweep, grid_axes, is_shape_sweep

PLACE, OFFSET = rings(6, 8)
GRID = np.stack(
    [g.ravel() for g in np.meshgrid(np.linspace(-10, 10, 5), np.linspace(-8, 8, 5), indexing="ij")],
    axis=1,
)
SHAPES = arc(GRID, PLACE, OFFSET)
SOUND = {"command": GRID, "vertices": SHAPES, "triangles": np.array([[0, 1, 8]]), "robot": "arc"}
LOADED = {
    "load": np.ones(2),
    "loaded_command": GRID[:2],
    "loaded_vertices": SHAPES[:2],
    "mass": 40.0,
}
DOWN = np.array([0.0, 0.0, 1.0])


def load(tmp_path, **fields):
    content = {name: value for name, value in (SOUND | fields).items() if value is not None}
    np.savez(tmp_path / "sweep.npz", **content)
    return ShapeSweep.load_file(tmp_path / "sweep.npz")


def without(array, at):
    spoilt = np.array(array, float)
    spoilt[at] = np.nan
    return spoilt


WRONG = [
    ({"command": None}, "`command` is missing"),
    ({"vertices": None}, "`vertices` is missing"),
    ({"command": GRID[:, 0]}, r"shape \(S, 1\)"),
    ({"command": GRID[:7]}, "its axis S should be 7 as in `command`"),
    ({"vertices": SHAPES[..., :2]}, "x, y, z"),
    ({"command": GRID.astype(str)}, "expected real numbers"),
    ({"command": without(GRID, (3, 1))}, r"not finite, the first at \[3, 1\]; leave out"),
    ({"vertices": without(SHAPES, (0, 0, 0))}, "commands that failed"),
    ({"command": np.zeros((25, 0))}, "C = 0"),
    ({"command": GRID[:1], "vertices": SHAPES[:1]}, "1 command;"),
    (
        {"command": np.tile(GRID[:1], (25, 1)), "vertices": np.tile(SHAPES[:1], (25, 1, 1))},
        "one command only",
    ),
    ({"command": GRID * [1, 0]}, "channel 1 takes 1 value"),
    ({"command": np.sign(GRID) + 0.5 * (GRID == 0)}, "same command, but their shapes"),
    ({"command": np.stack([GRID[:, 0] + 0.1 * GRID[:, 1]] * 2, axis=1)}, "always move together"),
    ({"command": GRID[:4], "vertices": SHAPES[:4]}, "channel 0 takes 1 value"),
    ({"command": np.diag([1.0, 2, 3, 4, 5]), "vertices": SHAPES[:5]}, "channel 0 takes 2 values"),
    ({"vertices": np.tile(SHAPES[:1], (25, 1, 1))}, "the same for every command"),
    ({"vertices": SHAPES / 1000}, "looks like metres; multiply by 1000"),
    ({"vertices": SHAPES * 1000}, "at most 10000 is plausible"),
    ({"command": GRID / 1000}, "look like metres: multiply"),
    ({"command": GRID / 10}, "look like radians: give command_unit"),
    ({"command": GRID * 1000}, "name the unit in `command_unit`"),
    ({"triangles": np.array([[0, 1, 48]])}, "expected 0 to 47"),
    ({"triangles": np.zeros((4, 2), int)}, r"expected whole numbers \(F, 3\)"),
    ({"gravity": np.array([0.0, 0.0, 9.81])}, "length 9.81, expected a unit vector"),
    ({"gravity": np.array([0.0, 0.0, 1e200])}, "length 1e\\+200, expected a unit vector"),
    ({"gravity": np.zeros(2)}, "axis 3 should be 3"),
    ({"robot": ""}, "one printable text"),
    ({"schema": "softmap.shapes/7"}, "expected softmap.shapes/1"),
    ({"load": np.ones(2)}, "`load` without `loaded_command`"),
    (LOADED, "pulls along `gravity`, which is missing"),
    (LOADED | {"gravity": DOWN, "load": np.array([1.0, -1.0])}, "more than 0"),
    (LOADED | {"gravity": DOWN, "loaded_command": GRID[:2] + 40.0}, "row 0 lies outside"),
    (LOADED | {"gravity": DOWN, "mass": 0.0}, "`mass` holds 0 to 0 g"),
    (LOADED | {"gravity": DOWN, "loaded_vertices": SHAPES[:2, :5]}, "its axis N should be 48"),
]


@pytest.mark.parametrize(("fields", "says"), WRONG, ids=[says[:30] for _, says in WRONG])
def test_each_mistake_is_reported_in_one_line(fields, says, tmp_path):
    with pytest.raises(SweepError, match=says) as fault:
        load(tmp_path, **fields)
    assert str(fault.value).startswith("sweep.npz: ") and "\n" not in str(fault.value)


def test_the_command_says_so_too(tmp_path, capsys):
    np.savez(tmp_path / "bad.npz", **SOUND | {"vertices": SHAPES / 1000})
    assert main(["build", str(tmp_path / "bad.npz"), "--out", str(tmp_path / "b")]) == 2
    assert "looks like metres" in capsys.readouterr().err and not (tmp_path / "b").exists()
    assert (
        main(["check", str(tmp_path / "bad.npz")]) == 1
        and "looks like metres" in capsys.readouterr().err
    )
    np.savez(tmp_path / "frame.npz", **SOUND | {"vertices": SHAPES * [1, 1, -1] + [0, 0, 100.0]})
    assert main(["build", str(tmp_path / "frame.npz"), "--out", str(tmp_path / "b")]) == 2
    assert "belongs at the clamped end" in capsys.readouterr().err


def test_units_that_are_named_are_believed(tmp_path):
    assert load(tmp_path, command=GRID / 10, command_unit="rad").command_unit == "rad"
    assert load(tmp_path, command=GRID / 10, command_unit="mm").command_unit == "mm"
    assert load(tmp_path, **LOADED, gravity=DOWN).mass == 40.0


def test_grids_are_found_in_any_order_on_uneven_axes_and_with_round_off(tmp_path):
    rng = np.random.default_rng(0)
    axes = [
        np.array([-9.0, -2.0, 0.5, 8.0]),
        np.array([-1.0, 0.0, 0.3, 7.0, 9.0]),
        np.array([0.0, 1.0, 5.0]),
    ]
    u = np.stack([g.ravel() for g in np.meshgrid(*axes, indexing="ij")], axis=1)
    shuffled = u[rng.permutation(60)].astype(np.float32) + 1e-7 * rng.normal(size=(60, 3))
    for found, axis in zip(grid_axes(shuffled), axes):
        np.testing.assert_allclose(found, axis, atol=1e-6)
    for other in (
        u[:-1],
        np.vstack([u[:-1], [[3.0, 3.0, 3.0]]]),
        u + rng.normal(size=u.shape),
        np.hstack([u, u[:, :1]]),
    ):
        assert grid_axes(other) is None
    order = rng.permutation(25)
    sweep = load(tmp_path, command=GRID[order], vertices=SHAPES[order])
    np.testing.assert_allclose(sweep.command, GRID)
    np.testing.assert_allclose(sweep.vertices, SHAPES)


def test_repeated_commands_are_averaged_and_unknown_fields_are_named(tmp_path):
    noise = 0.01 * np.random.default_rng(0).normal(size=SHAPES[:3].shape)
    twice = {
        "command": np.vstack([GRID, GRID[:3]]),
        "vertices": np.concatenate([SHAPES, SHAPES[:3] + noise]),
    }
    sweep = load(tmp_path, **twice, stress=np.zeros(4))
    assert len(sweep.command) == 25 and sweep.axes is not None
    np.testing.assert_allclose(sweep.vertices[:3], SHAPES[:3] + noise / 2)
    assert (
        "3 rows repeat a command" in sweep.notes[1] and "stress is not known here" in sweep.notes[0]
    )


def test_a_run_is_no_sweep(tmp_path):
    np.savez(
        tmp_path / "run.npz",
        t=np.arange(3.0),
        command=np.zeros((3, 1)),
        vertices=np.zeros((3, 2, 3)),
    )
    np.savez(tmp_path / "sweep.npz", command=np.zeros((3, 1)), vertices=np.zeros((3, 2, 3)))
    (tmp_path / "none.npz").write_bytes(b"PK")
    assert not is_shape_sweep(tmp_path / "run.npz") and is_shape_sweep(tmp_path / "sweep.npz")
    assert not is_shape_sweep(tmp_path / "none.npz") and not is_shape_sweep(tmp_path / "absent.npz")
