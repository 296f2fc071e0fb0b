"""Units that a log states: inches and feet, and units that are not known."""

import numpy as np
import pytest

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.unit_words import unit_in_name, unknown_unit

T = np.arange(120) / 20
U = np.stack([8 + 7 * np.sin(0.7 * T), 8 + 7 * np.sin(1.1 * T + 1)], axis=1)
S = np.array([0.5, 1.0])[None, :]
POINTS = np.stack(
    [3 * S**2 * (U[:, :1] - 8), 3 * S**2 * (U[:, 1:] - 8), 100 * S + 0 * U[:, :1]], axis=2
)  # mm


def written(path, marker="marker_{}_{}_mm", command="command_{}_mm", size=1.0, pull=1.0, row=None):
    head = ["time_s", *(command.format(k) for k in range(2))]
    head += [marker.format(m, axis) for m in range(2) for axis in "xyz"]
    numbers = np.column_stack([T, U / pull, POINTS.reshape(len(T), -1) / size])
    lines = [",".join(f"{x:.5f}" for x in one) for one in numbers]
    path.write_text("\n".join([",".join(head), *([row] if row else []), *lines]) + "\n", "utf-8")
    return path


def doubts_or_fault(log, text):
    """Return the doubts of an import, or the text of its error."""
    try:
        return import_logs([log], parse_mapping(text, log)).doubts
    except RunError as fault:
        return [str(fault)]


@pytest.mark.parametrize(
    ("form", "mm", "row"),
    [
        ("marker_{}_{}_in", 25.4, None),
        ("marker_{}_{} [inch]", 25.4, None),
        ("marker_{}_{} (Inches)", 25.4, None),
        ("marker_{}_{} [ft]", 304.8, None),
        ("marker_{}_{}_feet", 304.8, None),
        ("marker_{}_{}", 25.4, "s,mm,mm" + ",in" * 6),
        ("marker_{}_{}", 304.8, "[s],[mm],[mm]" + ",[foot]" * 6),
        ("marker_{}_{}", 10.0, "s,mm,mm" + ",centimeters" * 6),
    ],
)
def test_lengths_that_are_stated_are_read(tmp_path, form, mm, row):
    log = written(tmp_path / "log.csv", form, size=mm, row=row)
    found = guess_mapping([log])
    assert not any("unit of the markers" in line for line in found.unknown)
    text = "".join(line + "\n" for line in found.text.split("\n") if "origin_mm" not in line)
    run = import_logs([log], parse_mapping(text, log)).run
    assert np.allclose(run.markers, POINTS, atol=0.01)
    wrong = 'unit = "mm", columns = [\n'
    stated = found.text.replace('unit = "file", columns = [\n', wrong)
    for unit in ("in", "ft"):
        stated = stated.replace(f'unit = "{unit}", columns = [\n', wrong)
    doubts = doubts_or_fault(log, stated)
    assert any("the file states" in doubt for doubt in doubts)
    assert not any("looks like m:" in doubt for doubt in doubts)


@pytest.mark.parametrize(("form", "mm"), [("command_{}_in", 25.4), ("cmd_{} [ft]", 304.8)])
def test_commands_in_inches_and_feet(tmp_path, form, mm):
    log = written(tmp_path / "log.csv", command=form, pull=mm)
    run = import_logs([log], parse_mapping(guess_mapping([log]).text, log)).run
    assert run.command_unit == "mm" and np.allclose(run.command, U, atol=0.01)


@pytest.mark.parametrize(
    ("form", "unit", "row"),
    [
        ("cmd_{}_pct", "pct", None),
        ("cmd_{} [%]", "%", None),
        ("cmd_{}_0.1mm", "0.1mm", None),
        ("cmd_{} [0.1 mm]", "0.1 mm", None),
        ("cmd_{}_steps", "steps", None),
        ("cmd_{} (N)", "N", None),
        ("cmd_{}", "%", "s,%,%" + ",mm" * 6),
    ],
)
def test_a_unit_of_commands_that_is_not_known_is_quoted_and_kept(tmp_path, form, unit, row):
    log = written(tmp_path / "log.csv", command=form, pull=0.2, row=row)
    found = guess_mapping([log])
    assert any(f"the log states '{unit}', which is not a unit" in line for line in found.unknown)
    assert import_logs([log], parse_mapping(found.text, log)).run.command_unit == unit


@pytest.mark.parametrize("form", ["marker_{}_{} [yd]", "marker_{}_{}_thou", "marker_{}_{} [0.1mm]"])
def test_a_unit_of_places_that_is_not_known_is_quoted(tmp_path, form):
    found = guess_mapping([written(tmp_path / "log.csv", form)])
    assert any("unit of the markers: the log states" in line for line in found.unknown)


@pytest.mark.parametrize("name", ["temperature_F", "temp_f", "tempF", "temp [F]", "temp_degF"])
def test_a_temperature_in_fahrenheit_is_asked_about(tmp_path, name):
    log = written(tmp_path / "log.csv")
    head, *rows = log.read_text().splitlines()
    rows = [f"{row},{72 + 0.1 * k:.1f}" for k, row in enumerate(rows)]
    log.write_text("\n".join([f"{head},{name}", *rows]) + "\n")
    found = guess_mapping([log])
    assert sum("the unit of the temperature: the log states" in line for line in found.unknown) == 1
    doubts = import_logs([log], parse_mapping(found.text, log)).doubts
    assert any("the file states" in doubt and "scale" in doubt for doubt in doubts)


def test_names_without_a_unit_state_none():
    for name in ("temp_finger", "TEMP", "tempC", "temp_c", "force_f", "cmd_f", "attemptF1"):
        assert unknown_unit(name, None, {"degc", "c"}) is None
    for name in ("motor_in", "u1 (left)", "cmd[3]", "servo_a", "cmd_1_goal", "q (x)", "u (mm)"):
        assert unknown_unit(name, None, {"mm"}) is None
    assert unit_in_name("motor_in", {"in"}) is None


@pytest.mark.parametrize(
    ("command", "marker", "line"),
    [
        ("cmd", "marker_{}_{}_mm", "UNKNOWN  the unit of the commands: mm is only likely"),
        ("cmd (mm)", "{1}", "their name states mm"),
        ("cmd [px]", "marker_{}_{}_mm", '"px"'),
        ("motor", "{1} (mm)", "the unit of the commands: mm is only likely"),
    ],
)
def test_columns_of_one_name_state_only_what_stands_in_their_name(tmp_path, command, marker, line):
    """Two columns of one name are distinguished by their numbers, which are not units."""
    found = guess_mapping([written(tmp_path / "log.csv", marker, command)])
    assert line in found.text
    assert '"column' not in found.text and "'column" not in found.text
