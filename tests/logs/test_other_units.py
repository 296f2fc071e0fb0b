"""A mapping whose unit contradicts that of the log is doubted, and followed."""

import numpy as np
import pytest

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

T = np.arange(80) / 20
U = np.stack([8 + 7 * np.sin(0.7 * T), 8 + 7 * np.sin(1.1 * T + 1)], axis=1)
POINT = np.stack([3 * U[:, 0] - 24, 3 * U[:, 1] - 24, 100 + 0 * T], axis=1)


def log(folder, names, row=None, file="log.csv"):
    """A log of the columns t, u0, u1, x, y, z, extra under other names, with a line of units."""
    numbers = np.column_stack([T, U, POINT, U[:, 0]])
    lines = [",".join(names), *([row] if row else [])]
    lines += [",".join(f"{x:.5f}" for x in one) for one in numbers]
    (folder / file).write_text("\n".join(lines) + "\n", "utf-8")
    return folder / file


def doubts(path, command, unit="mm", command_unit="mm", more="", time='"s"', markers="mm"):
    names = command if isinstance(command, list) else [f"{command}".format(k) for k in (0, 1)]
    listed = ", ".join(f'"{name}"' for name in names)
    text = f"""schema = "softmap.mapping/1"
command_unit = "{command_unit}"
[[log]]
time = {{ column = 0, unit = {time} }}
command = {{ columns = [{listed}], unit = "{unit}"{more} }}
markers = {{ columns = [[3, 4, 5]], unit = "{markers}" }}
"""
    return import_logs([path], parse_mapping(text, path))


NAMES = ["t", "u0", "u1", "x", "y", "z", "extra"]


def named(command):
    return ["t", command.format(0), command.format(1), *NAMES[3:]]


@pytest.mark.parametrize(
    ("form", "unit", "command_unit", "stated"),
    [
        ("cmd_{} [mm]", "deg", "deg", "mm"),
        ("cmd_{} (rad)", "mm", "mm", "rad"),
        ("cmd_{} (rad)", "deg", "deg", "rad"),
        ("tendon_{}_cm", "mm", "mm", "cm"),
        ("servo_{}_deg", "rad", "rad", "deg"),
        ("cmd_{} [°]", "mm", "mm", "deg"),
        ("cmd_{} [%]", "mm", "mm", "%"),
        ("cmd_{}_pwm", "mm", "mm", None),
        ("cmd_{} [deg/s]", "deg", "deg", "deg/s"),
        ("cmd_{} [mm]", "bar", "bar", "mm"),
        ("cmd_{} (kPa)", "bar", "bar", "kPa"),
        ("cmd_{}_inches", "cm", "mm", "in"),
        ("cmd_{} [mm/deg]", "mm", "mm", "mm/deg"),
        ("cmd_{} (N m)", "mm", "mm", "N m"),
    ],
)
def test_a_unit_in_the_name_of_a_command_is_held_against_the_mapping(
    tmp_path, form, unit, command_unit, stated
):
    done = doubts(log(tmp_path, named(form)), form, unit, command_unit)
    found = [one for one in done.doubts if "the file states" in one]
    assert len(found) == (stated is not None)
    for line in found:
        assert f"the file states {stated}, the mapping {unit} and is followed; " in line
        assert line.startswith(f"command: {form.format(0)} and 1 more: ")
        assert "set unit" in line or "`scale`" in line


@pytest.mark.parametrize(
    ("row", "unit", "command_unit", "stated"),
    [
        ("s,deg,deg,mm,mm,mm,-", "mm", "mm", "deg"),
        ("[s],[mm],[mm],[mm],[mm],[mm],[]", "rad", "rad", "mm"),
        ("s,%,%,mm,mm,mm,K", "mm", "mm", "%"),
        ("(s),(ticks),(ticks),(mm),(mm),(mm),(K)", "mm", "mm", "ticks"),
    ],
)
def test_a_line_of_units_is_held_against_the_mapping(tmp_path, row, unit, command_unit, stated):
    done = doubts(log(tmp_path, NAMES, row), ["u0", "u1"], unit, command_unit)
    assert any(f"the file states {stated}, the mapping {unit}" in one for one in done.doubts)


@pytest.mark.parametrize(
    ("form", "unit", "command_unit", "more"),
    [
        ("cmd_{} [mm]", "mm", "mm", ""),
        ("cmd_{} [Millimeters]", "mm", "mm", ""),
        ("cmd_{} (degrees)", "deg", "deg", ""),
        ("cmd_{} [pct]", "%", "%", ""),
        ("cmd_{} [kPa]", "kpa", "kpa", ""),
        ("cmd_{} [N m]", "N·m", "N·m", ""),
        ("cmd_{} [deg]", "mm", "mm", ", scale = 0.2"),  # converted on purpose
        ("cmd_{} [raw]", "mm", "mm", ""),
        ("cmd_{} (left)", "mm", "mm", ""),
        ("m{}otor_in", "mm", "mm", ""),  # an input
        ("servo_{}_a", "deg", "deg", ""),
        ("servo_{}_c", "mm", "mm", ""),
    ],
)
def test_a_unit_that_agrees_or_is_none_is_not_doubted(tmp_path, form, unit, command_unit, more):
    done = doubts(log(tmp_path, named(form)), form, unit, command_unit, more)
    assert not any("the file states" in one for one in done.doubts)


@pytest.mark.parametrize(
    ("name", "unit", "key"),
    [
        ("motor (A)", "mA", "current"),
        ("temp [K]", "degC", "temperature"),
        ("load_kg", "g", "load"),
        ("enc [deg]", "ticks", "present_ticks"),
    ],
)
def test_other_columns_of_the_drive_are_compared_too(tmp_path, name, unit, key):
    path = log(tmp_path, [*NAMES[:6], name])
    columns = f'["{name}", "{name}"]' if key in ("present_ticks", "current") else f'["{name}"]'
    text = f"""schema = "softmap.mapping/1"
[[log]]
time = {{ column = "t" }}
command = {{ columns = ["u0", "u1"] }}
{key} = {{ columns = {columns}, unit = "{unit}" }}
markers = {{ columns = [["x", "y", "z"]] }}
"""
    done = import_logs([path], parse_mapping(text, path))
    assert any(f"{key}: {name}" in d and f"the mapping {unit}" in d for d in done.doubts)


@pytest.mark.parametrize("places", [["x_mm", "y_mm", "z_mm"], ["x [mm]", "y [mm]", "z [mm]"]])
def test_places_are_compared_column_by_column(tmp_path, places):
    names = [*NAMES[:3], *places, "extra"]
    done = doubts(log(tmp_path, names), ["u0", "u1"], markers="um")
    assert any("the file states mm, the mapping um" in one for one in done.doubts)
    mixed = [*NAMES[:3], "x_mm", "y_mm", "z_cm", "extra"]
    done = doubts(log(tmp_path, mixed), ["u0", "u1"])
    assert any("z_cm: the file states cm, the mapping mm" in one for one in done.doubts)


@pytest.mark.parametrize(
    ("name", "unit", "stated"),
    [
        ("Time (s)", "ms", "s"),
        ("t_ms", "s", "ms"),
        ("timestamp [us]", "ms", "us"),
        ("t", "s", None),
    ],
)
def test_a_unit_of_time_is_compared_too(tmp_path, name, unit, stated):
    done = doubts(log(tmp_path, [name, *NAMES[1:]]), ["u0", "u1"], time=f'"{unit}"')
    found = [one for one in done.doubts if "the file states" in one]
    assert len(found) == (stated is not None)
    assert stated is None or f"the file states {stated}" in found[0] and "set time.unit" in found[0]


@pytest.mark.parametrize("name", ["force [mN]", "force_kg", "angle (deg)"])
def test_outputs_are_compared_too(tmp_path, name):
    path = log(tmp_path, [*NAMES[:6], name])
    text = f"""schema = "softmap.mapping/1"
[[log]]
time = {{ column = "t" }}
command = {{ columns = ["u0", "u1"] }}
output = {{ columns = ["{name}"], unit = "N" }}
"""
    done = import_logs([path], parse_mapping(text, path))
    assert any(f"output: {name}: the file states" in one for one in done.doubts)


@pytest.mark.parametrize("form", ["cmd_{} [mm]", "cmd_{} (deg)", "cmd_{}_rad", "cmd_{} [%]", "u{}"])
def test_a_proposal_never_contradicts_its_log(tmp_path, form):
    found = guess_mapping([log(tmp_path, named(form))])
    assert not any("the file states" in line for line in found.said)


@pytest.mark.parametrize(
    ("row", "factors"),
    [
        ("s,mm,mm,cm,cm,cm,mm,mm,mm", (10, 1)),
        ("[s],[mm],[mm],[mm],[mm],[mm],[m],[m],[m]", (1, 1000)),
        ("(s),(mm),(mm),(in),(in),(in),(um),(um),(um)", (25.4, 0.001)),
        ("s,mm,mm,cm,cm,cm,,,", (10, 10)),
    ],
)
def test_each_marker_has_the_unit_of_its_own_columns(tmp_path, row, factors):
    points = np.concatenate([POINT / factors[0], POINT / 2 / factors[1]], axis=1)
    columns = np.column_stack([T, U, points])
    names = [*NAMES[:3], *(f"{m}_{a}" for m in ("mid", "tip") for a in "xyz")]
    lines = [",".join(names), row, *(",".join(f"{x:.9f}" for x in one) for one in columns)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    text = """schema = "softmap.mapping/1"
[[log]]
time = { column = 0 }
command = { columns = ["u0", "u1"] }
markers = { columns = [[3, 4, 5], [6, 7, 8]] }
"""
    done = import_logs([tmp_path / "log.csv"], parse_mapping(text, "m.toml"))
    assert np.allclose(done.run.markers[:, 0], POINT, atol=1e-3)
    assert np.allclose(done.run.markers[:, 1], POINT / 2, atol=1e-3)
    assert not any("the file states" in one for one in done.doubts)


@pytest.mark.parametrize(
    "row", ["s,mm,mm,mm,cm,m", "s,mm,mm,mm,mm,cm", "[s],[mm],[mm],[cm],[mm],[mm]"]
)
def test_a_marker_whose_columns_state_several_units_is_doubted(tmp_path, row):
    done = doubts(log(tmp_path, NAMES, row + ",-"), ["u0", "u1"], markers="file")
    assert any(one.startswith("markers: ") and "the file states" in one for one in done.doubts)


@pytest.mark.parametrize("names", [["x_cm", "y_cm", "z_cm"], ["x [m]", "y [m]", "z [m]"]])
def test_a_name_is_held_against_a_mapping_without_a_unit(tmp_path, names):
    done = doubts(log(tmp_path, [*NAMES[:3], *names, "extra"]), ["u0", "u1"], markers="file")
    assert any("the file states" in one and "the mapping mm" in one for one in done.doubts)


# --- places in several units ---------------------------------------------------------------
def mixed(folder, units, form="m{}_{} [{}]"):
    """A log of one marker for each unit, in that unit."""
    factor = {"mm": 1.0, "m": 1000.0, "cm": 10.0, "in": 25.4}
    head = ["t", "u1", "u2"]
    head += [form.format(k + 1, axis, unit) for k, unit in enumerate(units) for axis in "xyz"]
    places = [(POINT + [0, 0, 30 * k]) / factor[unit] for k, unit in enumerate(units)]
    numbers = np.column_stack([T, U, *places])
    lines = [",".join(head), *(",".join(f"{x:.6f}" for x in row) for row in numbers)]
    (folder / "mixed.csv").write_text("\n".join(lines) + "\n", "utf-8")
    return folder / "mixed.csv"


@pytest.mark.parametrize("units", [["mm", "mm", "m"], ["m", "mm"], ["cm", "mm", "in"]])
@pytest.mark.parametrize("form", ["m{}_{} [{}]", "m{}_{}_{}"])
def test_places_in_several_units_are_converted_by_the_proposal(tmp_path, units, form):
    path = mixed(tmp_path, units, form)
    found = guess_mapping([path])
    assert "scale = [" in found.text
    assert any("as the log states" in line for line in found.assumed)
    done = import_logs([path], parse_mapping(found.text, path))
    assert not any("unit" in doubt for doubt in done.doubts)
    gaps = np.linalg.norm(np.diff(done.run.markers, axis=1), axis=2)
    assert gaps == pytest.approx(30.0, abs=0.1)


@pytest.mark.parametrize("unit", ["mm", "m", "cm"])
def test_the_doubt_on_several_units_leads_out(tmp_path, unit):
    path = mixed(tmp_path, ["mm", "m"])
    text = """schema = "softmap.mapping/1"
[[log]]
time = {{ column = 0, unit = "s" }}
command = {{ columns = [1, 2], unit = "mm" }}
markers = {{ {}, columns = [[3, 4, 5], [6, 7, 8]] }}
"""
    try:
        said = list(
            import_logs([path], parse_mapping(text.format(f'unit = "{unit}"'), path)).doubts
        )
    except RunError as fault:
        said = [str(fault)]
    advice = 'unit = "mm" and scale = [1, 1, 1, 1000, 1000, 1000]'
    assert sum(f"set {advice}" in line for line in said) >= 1
    done = import_logs([path], parse_mapping(text.format(advice.replace(" and", ",")), path))
    assert not done.doubts
    assert np.linalg.norm(np.diff(done.run.markers, axis=1), axis=2) == pytest.approx(30, abs=0.1)


def test_places_in_one_unit_get_no_scale(tmp_path):
    assert "scale = [" not in guess_mapping([mixed(tmp_path, ["mm", "mm"])]).text
