"""A line of units next to the names of a text log, and what the message names where a column is
missing.
"""

import pytest
from bench_rows import rows, write

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.table import open_log

NAMES = ["Timestamp", "servo_1_goal", "servo_2_goal", "tip_x", "tip_y", "tip_z"]
HEAD = ",".join(NAMES)
UNITS = {
    "a form of date, and a last name without a unit": f"{HEAD},Comment\nISO 8601,deg,deg,mm,mm,mm,",
    "a form of date": f"{HEAD}\nyyyy-mm-dd hh:mm:ss.fff,deg,deg,mm,mm,mm",
    "a zone": f"{HEAD}\nUTC,deg,deg,mm,mm,mm",
    "n.a.": f"{HEAD},Comment,Operator\nn.a.,deg,deg,mm,mm,mm,,",
    "no unit of time": f"{HEAD}\n,deg,deg,mm,mm,mm",
    "brackets around some": f"{HEAD}\n[since start],[deg],[deg],mm,mm,mm",
    "units that are not known": f"{HEAD}\ndate,counts,counts,px,px,px",
    "units that never repeat": f"{HEAD}\nUTC,deg,rad,mm,cm,m",
    "units, then types": (
        f"{HEAD}\nUTC,deg,deg,mm,mm,mm\nstring,float32,float32,float64,float64,float64"
    ),
    "units above the names": f"UTC,deg,deg,mm,mm,mm\n{HEAD}",
    "lines of a vendor above": (
        f"MoCapPro,v4\nCapture rate (Hz),50\n\n{HEAD},Comment\nISO 8601,deg,deg,mm,mm,mm,"
    ),
}
KNOWN = [kind for kind in UNITS if "not known" not in kind and "repeat" not in kind]


@pytest.mark.parametrize("kind", UNITS)
def test_a_line_of_units_is_not_taken_for_names(tmp_path, kind):
    path = write(tmp_path / "log.csv", UNITS[kind].split("\n"), rows())
    columns = open_log(path)
    assert columns.names[:6] == NAMES and columns.read([1]).numbers.shape == (40, 1)
    if kind in KNOWN:
        units = [columns.units.get(name) for name in NAMES[1:]]
        assert units == ["deg", "deg", "mm", "mm", "mm"]
    run = import_logs([path], parse_mapping(guess_mapping([path]).text, path)).run
    assert (run.channels, run.frames) == (2, 40)


@pytest.mark.parametrize("skipped", [0, 1, 2, 3])
def test_lines_may_be_skipped_above_a_line_of_units(tmp_path, skipped):
    path = write(tmp_path / "log.csv", UNITS["lines of a vendor above"].split("\n"), rows())
    mapping = f"""schema = "softmap.mapping/1"
command_unit = "deg"
[[log]]
skip_rows = {skipped}
time = {{ column = "Timestamp" }}
command = {{ columns = ["servo_1_goal", "servo_2_goal"], unit = "deg" }}"""
    assert import_logs([path], parse_mapping(mapping, path)).run.channels == 2


GROUPS = {
    "groups over their first column": (",,,tip,,\nTimestamp,u_1,u_2,X,Y,Z", "tip.X"),
    "a group in each cell": ("time,drive,drive,tip,tip,tip\nsec,u_1,u_2,X,Y,Z", "X"),
    "a title as wide as the names": ("Report,of,the,bench,number,3\nTimestamp,u_1,u_2,X,Y,Z", "X"),
    "names that look like units": ("t,u_1,u_2,tip_x,tip_y,tip_z", "tip_x"),
}


@pytest.mark.parametrize("kind", GROUPS)
def test_lines_of_other_kinds_above_the_names_stay_what_they_are(tmp_path, kind):
    head, fourth = GROUPS[kind]
    path = write(tmp_path / "log.csv", head.split("\n"), rows())
    assert open_log(path).names[3] == fourth


MISSING = """schema = "softmap.mapping/1"
[[log]]
time = { column = "clock" }
command = { columns = ["a0", "a1", "a2", "a3", "a4", "a5", "a6", "a7", "a8"] }"""


@pytest.mark.parametrize(
    ("above", "line"),
    [([], 1), (["bench 3", ""], 3), (["Rate,50", "Operator,Q", ""], 4), (["# 7", "# 8"], 3)],
)
def test_a_missing_column_names_the_line_of_the_names_and_the_ways_out(tmp_path, above, line):
    path = write(tmp_path / "log.csv", [*above, HEAD], rows())
    with pytest.raises(RunError) as fault:
        import_logs([path], parse_mapping(MISSING, path))
    text = str(fault.value)
    assert "no column clock, a0" in text and "a6 and 2 more" in text
    assert (
        f"line {line} was taken for the names" in text
        and "skip_rows" in text
        and "header = false" in text
    )


@pytest.mark.parametrize("count", [12, 60, 400])
def test_a_list_that_was_shortened_is_reported_so(tmp_path, count):
    names = [f"value_of_sensor_{k}" for k in range(count)]
    path = write(tmp_path / "log.csv", [",".join(names)], [",".join(["1.5"] * count)] * 5)
    with pytest.raises(RunError) as fault:
        import_logs([path], parse_mapping(MISSING, path))
    shown = str(fault.value).count("value_of_sensor_")
    assert f"… and {count - shown} more" in str(fault.value)
    with pytest.raises(RunError, match="line 1 was taken for the names"):
        guess_mapping([path])
