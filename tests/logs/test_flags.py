"""Labels of what was seen (`tracked`, `valid`, `likelihood`) are no places, commands or blocks."""

import numpy as np
import pytest

from softmap_edge.logs.flags import flags_of
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

ROWS = 120
T = np.arange(ROWS) / 20
U = np.stack([8 * np.sin(0.9 * T), 6 * np.sin(1.3 * T + 0.4)], axis=1)
REST = np.array([[0.0, 0.0, 40.0], [0.0, 0.0, 80.0], [0.0, 0.0, 120.0]])
POINTS = REST + np.stack(
    [U[:, :1] * [1, 2, 4], U[:, 1:] * [1, 2, 4], 0 * U[:, :1] * [1, 2, 4]], axis=2
)
SEEN = np.random.default_rng(4).random((ROWS, 3)) > 0.2
GRADE = np.random.default_rng(5).random((ROWS, 3))


def archive(folder, **more):
    np.savez(folder / "log.npz", t=T, u=U, markers=POINTS, **more)
    return folder / "log.npz"


def table(folder, names, columns):
    head = ["t", "u1", "u2", *(f"m{k}_{axis}" for k in (1, 2, 3) for axis in "xyz"), *names]
    numbers = np.column_stack([T, U, POINTS.reshape(ROWS, -1)])
    lines = [
        ",".join([*(f"{x:.4f}" for x in row), *(str(column[k]) for column in columns)])
        for k, row in enumerate(numbers)
    ]
    (folder / "log.csv").write_text("\n".join([",".join(head), *lines]) + "\n", "utf-8")
    return folder / "log.csv"


def run_of(path, found):
    return import_logs([path], parse_mapping(found.text, path)).run


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("tracked", SEEN.astype(np.uint8)),
        ("valid", SEEN),
        ("visible", SEEN.astype(float)),
        ("marker_confidence", GRADE),
        ("likelihood", GRADE.astype(np.float32)),
        ("track_status", 1 + SEEN + 2 * (GRADE > 0.5)),
        ("markers_mask", np.repeat(SEEN[:, :, None], 3, axis=2)),
        ("points_seen_by_camera", SEEN),
        ("tip", SEEN),
        ("command_goal", SEEN),
        ("position", np.ones((ROWS, 3), bool)),
    ],
)
def test_flags_of_a_container_are_no_places_and_no_drives(tmp_path, name, values):
    path = archive(tmp_path, **{name: values})
    found = guess_mapping([path])
    line = next(one for one in found.unknown if "labels of what was seen" in one)
    assert f"{name}[0]" in line and "left out" in line
    assert f'"{name}[' not in found.text
    run = run_of(path, found)
    assert run.markers.shape == (ROWS, 3, 3) and run.channels == 2


@pytest.mark.parametrize("name", ["valid", "m_likelihood", "quality"])
def test_flags_of_a_table_follow_the_same_rule(tmp_path, name):
    columns = list(np.where(SEEN, 1, 0).T)
    names = [f"{name}_{k}" for k in (1, 2, 3)]
    found = guess_mapping([table(tmp_path, names, columns)])
    assert any(f"{name}_1" in one and "labels of what was seen" in one for one in found.unknown)
    path = archive(tmp_path, **{name: SEEN.astype(float)})
    assert any("labels of what was seen" in one for one in guess_mapping([path]).unknown)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("tracked", 0.001 * POINTS[:, 0]),  # places in m
        ("visible_point", POINTS[:, 1]),
        ("mask_marker", 5 + POINTS[:, 2]),
    ],
)
def test_places_with_such_names_stay_places(tmp_path, name, values):
    found = guess_mapping([archive(tmp_path, **{name: values})])
    assert not any("labels of what was seen" in one for one in found.unknown)
    np.savez(tmp_path / "own.npz", t=T, u=U, **{name: POINTS[:, 1]})
    assert f'"{name}[0]", "{name}[1]", "{name}[2]"' in guess_mapping([tmp_path / "own.npz"]).text


def test_valves_that_are_numbers_stay_commands(tmp_path):
    np.savez(tmp_path / "log.npz", t=T, command=(U > 0).astype(float), markers=POINTS)
    found = guess_mapping([tmp_path / "log.npz"])
    assert 'command = { columns = ["command[0]", "command[1]"]' in found.text


def test_all_columns_of_a_group_decide_together():
    numbers = np.column_stack([SEEN[:, 0], POINTS[:, 0, 0], SEEN[:, 1], SEEN[:, 2]])
    names = ["valid_x", "valid_y", "m1_ok", "m2_ok"]
    assert flags_of(names, numbers, set()) == ["m1_ok", "m2_ok"]
    assert flags_of(["a", "b", "c", "d"], numbers, {"c"}) == ["c"]
    assert flags_of(["masking_1", "groundtruth", "unevaluated", "book"], numbers, set()) == []
