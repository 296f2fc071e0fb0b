"""Digits in groups of three are read where a cell is clear; an error about a comma never leads back
to itself.
"""

import re

import numpy as np
import pytest
from bench_rows import NAMES, values

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.readers.thousands import grouping_of, plain
from softmap_edge.logs.readers.typed_rows import open_typed

MAP = """schema = "softmap.mapping/1"
[[log]]
time = { column = "time" }
command = { columns = ["%s", "%s"] }
markers = { unit = "um", columns = [["%s", "%s", "%s"]] }
"""


def written(x, group, point, digits=1):
    """A number with groups of three digits."""
    text = f"{x:,.{digits}f}"
    return text.replace(",", "\0").replace(".", point).replace("\0", group)


def log(folder, group, point, mark, quote=""):
    """A log whose markers are in um, in groups of three digits."""
    lines = [mark.join(NAMES)]
    for k in range(60):
        cells = [f"{0.05 * k:.3f}".replace(".", point)]
        cells += [written(x, group, point, 3) for x in values(k)[:2]]
        cells += [written(1000 * x, group, point) for x in values(k)[2:]]
        lines.append(mark.join(f"{quote}{cell}{quote}" for cell in cells))
    (folder / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / "log.csv"


@pytest.mark.parametrize(
    ("group", "point", "mark", "quote"),
    [
        (",", ".", ",", '"'),
        (",", ".", ";", ""),
        (",", ".", "\t", ""),
        (".", ",", ";", ""),
        (".", ",", ",", '"'),
        ("'", ".", ",", ""),
        ("\u2019", ".", ";", ""),
        ("\u00a0", ",", ";", ""),
        (" ", ",", ";", ""),
    ],
)
def test_groups_of_digits_are_read(tmp_path, group, point, mark, quote):
    path = log(tmp_path, group, point, mark, quote)
    run = import_logs([path], parse_mapping(MAP % tuple(NAMES[1:]), path)).run
    assert run.markers[:, 0] == pytest.approx(
        np.array([values(k)[2:] for k in range(60)]), abs=1e-4
    )
    assert run.command == pytest.approx(np.array([values(k)[:2] for k in range(60)]), abs=1e-3)
    found = guess_mapping([path])
    assert "markers = " in found.text and any("groups of three" in said for said in found.said)


def test_whole_numbers_follow_the_clear_cells_of_their_log(tmp_path):
    lines = ["time;cmd_1;cmd_2;tip_x;tip_y;tip_z"]
    lines += [
        f"{0.05 * k:.2f};{0.1 * k:.1f};{0.2 * k:.1f};12,3{k:02d};-1,500.{k};90,{k:03d}"
        for k in range(60)
    ]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    mapping = MAP % ("cmd_1", "cmd_2", "tip_x", "tip_y", "tip_z")
    run = import_logs([tmp_path / "log.csv"], parse_mapping(mapping, tmp_path)).run
    assert run.markers[7, 0] == pytest.approx([12.307, -1.5007, 90.007])


def test_decimal_commas_stay_decimal_commas(tmp_path):
    lines = ["time;cmd_1;cmd_2;tip_x;tip_y;tip_z"]
    lines += [f"{k},050;{k},100;0,200;25,{k:03d};1,500;90,{k:03d}" for k in range(60)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    mapping = (MAP % ("cmd_1", "cmd_2", "tip_x", "tip_y", "tip_z")).replace('"um"', '"mm"')
    run = import_logs([tmp_path / "log.csv"], parse_mapping(mapping, tmp_path)).run
    assert run.markers[7, 0] == pytest.approx([25.007, 1.5, 90.007])


@pytest.mark.parametrize("cell", ["25,03", "0,039", "12,34.5", "1,23,456.0", "25,039,1"])
@pytest.mark.parametrize("decimal", ["", 'decimal = "."\n', 'decimal = ","\n'])
def test_the_remedy_of_an_error_leads_to_no_circle(tmp_path, cell, decimal):
    lines = ["time;cmd_1;cmd_2;tip_x;tip_y;tip_z"]
    lines += [f"{0.05 * k};{0.1 * k};0.2;{cell if k == 40 else 25.5};1.5;90.0" for k in range(60)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    mapping = (MAP % ("cmd_1", "cmd_2", "tip_x", "tip_y", "tip_z")).replace(
        "[[log]]\n", f"[[log]]\n{decimal}"
    )
    try:
        import_logs([tmp_path / "log.csv"], parse_mapping(mapping, tmp_path))
    except RunError as fault:
        assert "line 42" in str(fault)
        again = 'set decimal = ","' in str(fault)
        assert not (again and "," in decimal)
        if again:
            other = mapping.replace(decimal, "").replace("[[log]]\n", '[[log]]\ndecimal = ","\n')
            import_logs([tmp_path / "log.csv"], parse_mapping(other, tmp_path))
        else:
            assert "groups of digits" in str(fault)


def whole_numbers(folder, mark, clock, point=""):
    """A log of whole numbers in groups of three digits; its time is in ms, or in s with a decimal
    mark.
    """
    lines = ["time;cmd_1;cmd_2;tip_x;tip_y;tip_z"]
    for k in range(60):
        time = f"{50 * k}" if clock == "ms" else f"{0.05 * k:.3f}".replace(".", point)
        cells = [
            time,
            f"{k % 9}",
            f"{k % 7}",
            *(f"{x:,}".replace(",", mark) for x in (900 + 8 * k, 300 + k, 2000 - k)),
        ]
        lines.append(";".join(cells))
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    mapping = MAP % ("cmd_1", "cmd_2", "tip_x", "tip_y", "tip_z")
    return folder / "log.csv", mapping.replace('"time" }', f'"time", unit = "{clock}" }}')


@pytest.mark.parametrize(("mark", "point"), [(".", ","), (",", "."), ("'", "."), ("\u202f", ",")])
def test_whole_numbers_follow_the_decimal_mark_of_their_log(tmp_path, mark, point):
    path, mapping = whole_numbers(tmp_path, mark, "s", point)
    found = import_logs([path], parse_mapping(mapping, path))
    assert found.run.markers[:, 0, 0] == pytest.approx([0.9 + 0.008 * k for k in range(60)])
    assert any("groups of three" in note for note in found.notes)


@pytest.mark.parametrize("mark", [".", ","])
def test_whole_numbers_without_any_decimal_mark_are_asked_about(tmp_path, mark):
    path, mapping = whole_numbers(tmp_path, mark, "ms")
    with pytest.raises(RunError, match="'1.004' may be 1.004 or 1004") as fault:
        import_logs([path], parse_mapping(mapping, path))
    read = {}
    for key, value in re.findall(r'(decimal = "[.,]")[^"]* to read ([\d.]+)', str(fault.value)):
        stated = mapping.replace("[[log]]\n", f"[[log]]\n{key}\n")
        read[float(value)] = (
            1000 * import_logs([path], parse_mapping(stated, path)).run.markers[13, 0, 0]
        )
    assert len(read) == 2 and list(read) == pytest.approx(list(read.values()))


@pytest.mark.parametrize(("mark", "point"), [(".", ","), (",", ".")])
def test_a_group_far_below_is_refused_by_its_line(tmp_path, mark, point):
    lines = ["time;cmd_1;cmd_2;tip_x;tip_y;tip_z"]
    for k in range(400):
        x = f"1{mark}200" if k == 350 else f"{300 + k / 8:.3f}".replace(".", point)
        lines.append(f"{0.05 * k:.2f};0.1;0.2;".replace(".", point) + f"{x};15;90")
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    mapping = MAP % ("cmd_1", "cmd_2", "tip_x", "tip_y", "tip_z")
    with pytest.raises(RunError, match="line 352") as fault:
        import_logs([tmp_path / "log.csv"], parse_mapping(mapping, tmp_path))
    key = re.search(r'decimal = "[.,]"', str(fault.value))[0]
    stated = mapping.replace("[[log]]\n", f"[[log]]\n{key}\n")
    run = import_logs([tmp_path / "log.csv"], parse_mapping(stated, tmp_path)).run
    assert run.markers[350, 0, 0] == pytest.approx(1.2)


def test_a_stated_mark_that_the_log_contradicts_is_doubted(tmp_path):
    path, mapping = whole_numbers(tmp_path, ",", "s", ".")
    stated = mapping.replace("[[log]]\n", '[[log]]\ndecimal = ","\n')
    found = import_logs([path], parse_mapping(stated, path))
    assert any("leave decimal out to read 2000" in doubt for doubt in found.doubts)
    assert not any(
        "decimal" in doubt for doubt in import_logs([path], parse_mapping(mapping, path)).doubts
    )


def test_three_decimals_stay_decimals(tmp_path):
    lines = ["time;cmd_1;cmd_2;tip_x;tip_y;tip_z"]
    lines += [
        f"{50 * k};{k % 9};{k % 7};{20 + k / 64:.3f};{12 + k / 8:.3f};{90 + k:.3f}"
        for k in range(60)
    ]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    mapping = MAP % ("cmd_1", "cmd_2", "tip_x", "tip_y", "tip_z")
    mapping = mapping.replace('"time" }', '"time", unit = "ms" }').replace('"um"', '"mm"')
    run = import_logs([tmp_path / "log.csv"], parse_mapping(mapping, tmp_path)).run
    assert run.markers[8, 0] == pytest.approx([20.125, 13.0, 98.0])


@pytest.mark.parametrize("cell", ["1,234.5", "1.234,5", "1'234"])
def test_groups_in_rows_of_types_are_refused_by_their_line(tmp_path, cell):
    rows = [f'frame,{k},{0.01 * k},0,1,0.1,0.2,"{cell if k == 3 else 0.3}",1,tip' for k in range(6)]
    (tmp_path / "log.csv").write_text("\n".join(["info,framecount,6", *rows]) + "\n")
    with pytest.raises(RunError, match=f"line 5: '{cell}' is not a number"):
        open_typed(tmp_path / "log.csv")


def test_the_rules():
    clear = {
        "25,039.0": ",",
        "-1,234,567": ",",
        "25.039,0": ".",
        "1'234": "'",
        "1\u00a0234,5": "'",
        "1,234.5e3": ",",
    }
    assert {cell: grouping_of(cell) for cell in clear} == clear
    for cell in (
        "25,039",
        "25.039",
        "0,039.0",
        "1.234.567",
        "25,03.1",
        "12345,678.0",
        "m1,234.5",
        "",
        "1.5",
        "abc",
    ):
        assert grouping_of(cell) is None, cell
    assert (
        plain("25,039", ",") == "25039"
        and plain("25,039", None) is None
        and plain("-25.039,5", None) == "-25039.5"
    )
