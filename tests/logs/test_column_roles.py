"""Columns of a log that a mapping uses twice, and scales that are no scales."""

import pytest
from bench_rows import NAMES, rows, write

from softmap_edge.errors import RunError
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

MAP = """schema = "softmap.mapping/1"
[[log]]
time = { column = "time" }
command = { columns = ["cmd_1", "cmd_2"] }
markers = { columns = [["tip_x", "tip_y", "tip_z"]] }
"""


def doubts(folder, text):
    log = write(folder / "log.csv", [",".join(NAMES)], rows())
    found = import_logs([log], parse_mapping(text, folder / "map.toml")).doubts
    return [doubt for doubt in found if " roles: " in doubt]


@pytest.mark.parametrize(
    ("old", "new", "name", "roles"),
    [
        ('["cmd_1", "cmd_2"]', '["cmd_1", "tip_x"]', "tip_x", "command 2, marker 1 x"),
        ('["cmd_1", "cmd_2"]', '["cmd_1", 3]', "tip_x", "command 2, marker 1 x"),
        ('["cmd_1", "cmd_2"]', '["time", "cmd_2"]', "time", "time, command 1"),
        ('["cmd_1", "cmd_2"]', '["cmd_2", "cmd_1", "cmd_2"]', "cmd_2", "command 1, command 3"),
        ('"tip_y", "tip_z"', '"tip_y", "tip_y"', "tip_y", "marker 1 y, marker 1 z"),
        (
            "markers =",
            'present = { columns = ["cmd_1", "cmd_2"] }\nmarkers =',
            "cmd_1",
            "command 1",
        ),
        (
            "markers =",
            'temperature = { columns = ["cmd_1"] }\nmarkers =',
            "cmd_1",
            "command 1, temperature",
        ),
    ],
)
def test_a_column_in_two_roles_is_a_doubt(tmp_path, old, new, name, roles):
    assert old in MAP
    first = doubts(tmp_path, MAP.replace(old, new))[0]
    assert f"column '{name}' has 2 roles: {roles}" in first


def test_each_column_in_one_role_is_none(tmp_path):
    assert doubts(tmp_path, MAP) == []


@pytest.mark.parametrize("scale", ["0", "-0.0", "[1.0, 0.0]", "nan", "inf", "[1.0, nan]"])
@pytest.mark.parametrize("key", ["command", "markers"])
def test_a_scale_of_0_or_none_is_refused(key, scale):
    scale = scale.replace("]", ", 1.0]") if key == "markers" else scale
    with pytest.raises(RunError, match="scale"):
        parse_mapping(MAP.replace(f"{key} = {{", f"{key} = {{ scale = {scale},"), "map.toml")
