"""Numbers with a Unicode minus, hexadecimal integers, exponents of Fortran, and a unit in one cell."""

import numpy as np
import pytest
from bench_rows import NAMES, rows, values, write

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.readers.spellings import with_exponents, with_minus
from softmap_edge.logs.table import open_log

HEAD = ",".join(NAMES)
KNOWN = np.array([values(k) for k in range(60)])


@pytest.mark.parametrize("sign", ["\u2212", "\uff0d", "\u2013"])
@pytest.mark.parametrize("form", [{}, {"cut": ";", "point": ","}, {"cut": "\t"}])
def test_another_minus_is_a_minus(tmp_path, sign, form):
    lines = [line.replace("-", sign) for line in rows(60, **form)]
    path = write(tmp_path / "log.csv", form.get("cut", ",").join(NAMES), lines)
    done = import_logs([path], parse_mapping(guess_mapping([path]).text, path))
    assert (done.run.channels, done.run.frames) == (2, 60)
    assert open_log(path).read([1, 2]).numbers == pytest.approx(KNOWN[:, :2], abs=6e-4)


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("1,\u22123.5", "1,-3.5"),
        ("1e\u221205", "1e-05"),
        ('"\u22120,5"', '"-0,5"'),
        ("3\u20135,a\u2212b", "3\u20135,a\u2212b"),
    ],
)
def test_only_signs_are_changed(text, plain):
    assert with_minus(text) == plain


def ticks(k, column):
    return 2048 + round(100 * values(k)[column])


@pytest.mark.parametrize("form", ["0x{:x}", "0x{:04X}", "0X{:03X}"])
@pytest.mark.parametrize("names", ["ticks_0,ticks_1", "cmd_1,cmd_2"])
def test_hexadecimal_columns_are_read(tmp_path, form, names):
    lines = []
    for k, line in enumerate(rows(60)):
        cells = line.split(",")
        lines.append(",".join([cells[0], *(form.format(ticks(k, j)) for j in (0, 1)), *cells[3:]]))
    path = write(tmp_path / "log.csv", f"time,{names},tip_x,tip_y,tip_z", lines)
    found = guess_mapping([path])
    assert all(name in found.text for name in names.split(","))  # a command, or left out by name
    assert any("hexadecimal numbers are read in " in note for note in found.said)
    known = [[ticks(k, j) for j in (0, 1)] for k in range(60)]
    assert np.array_equal(open_log(path).read([1, 2]).numbers, known)
    assert np.array_equal(open_log(path).read([2, 1]).numbers, np.fliplr(known))


@pytest.mark.parametrize("quote", ["", '"'])
@pytest.mark.parametrize("row", [5, 40, 300])
def test_a_column_in_two_bases_is_an_error_with_the_remedy(tmp_path, row, quote):
    lines = [f"{line},{k}" for k, line in enumerate(rows(400))]
    lines[row] = f"{lines[row].rsplit(',', 1)[0]},{quote}0x1F{quote}"
    path = write(tmp_path / "log.csv", HEAD + ",volts", lines)
    with pytest.raises(RunError, match=f"line {row + 2}, column volts: '0x1F'.*in one base"):
        open_log(path).read([6])
    lines = [f"{line},0x{k:x}" for k, line in enumerate(rows(400))]
    lines[row] = f"{lines[row].rsplit(',', 1)[0]},{quote}31{quote}"
    path = write(tmp_path / "log.csv", HEAD + ",volts", lines)
    with pytest.raises(RunError, match="line .*in one base|'31' stands in a column of"):
        open_log(path).read([6])


@pytest.mark.parametrize("cell", ["5mm", "5.25 deg", "3\u00b0", "7,5 mA"])
def test_a_unit_in_a_cell_has_a_remedy(tmp_path, cell):
    lines = rows(400, cut=";")
    lines[300] = lines[300].rsplit(";", 1)[0] + ";" + cell
    path = write(tmp_path / "log.csv", HEAD.replace(",", ";"), lines)
    with pytest.raises(RunError, match="is not a number; remove '.*' from the cell, and give the"):
        open_log(path).read([5])


def double(number):
    return f"{number:.6E}".replace("E", "D")


def as_printed(number):
    """As Fortran prints a number: three digits of an exponent leave no room for its letter."""
    return f"{1e-120 * number:.6E}".replace("E-1", "-1") if 0 < number < 1e-3 else double(number)


@pytest.mark.parametrize("written", [double, lambda x: double(x).lower(), as_printed])
@pytest.mark.parametrize("cut", [",", "\t", "  ", ";"])
def test_exponents_of_fortran_are_numbers(tmp_path, written, cut):
    lines = [cut.join(written(float(cell)) for cell in line.split(",")) for line in rows(60)]
    path = write(tmp_path / "log.csv", cut.join(NAMES), lines)
    done = import_logs([path], parse_mapping(guess_mapping([path]).text, path))
    assert (done.run.channels, done.run.frames) == (2, 60)
    assert open_log(path).read([1, 2, 5]).numbers == pytest.approx(KNOWN[:, [0, 1, 4]], abs=6e-4)


@pytest.mark.parametrize("cut", [";", "\t", " "])
@pytest.mark.parametrize("letter", ["D", "d", "Q"])
def test_exponents_of_fortran_after_decimal_commas(tmp_path, cut, letter):
    lines = [
        cut.join(double(float(cell)).replace(".", ",").replace("D", letter) for cell in cells)
        for cells in (line.split(",") for line in rows(60))
    ]
    path = write(tmp_path / "log.csv", cut.join(NAMES), lines)
    done = import_logs([path], parse_mapping(guess_mapping([path]).text, path))
    assert (done.run.channels, done.run.frames) == (2, 60)
    assert open_log(path).read([1, 2, 5]).numbers == pytest.approx(KNOWN[:, [0, 1, 4]], abs=6e-4)


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("1.0D+02,2.5d3", "1.0e+02,2.5e3"),
        ("-.5Q-1 1d-3", "-.5e-1 1e-3"),
        ("1.25-100;0.5+101", "1.25e-100;0.5e+101"),
        ("3D2,12d,1.5d,3.5-2,07.05-2031,v1.0D+02,1.0D+02x", None),
    ],
)
def test_only_exponents_are_changed(text, plain):
    assert with_exponents(text) == (plain or text)


def test_a_range_of_numbers_stays_an_error(tmp_path):
    lines = rows(40)
    lines[7] = lines[7].replace(lines[7].split(",")[3], "3.5-12")
    mapping = guess_mapping([write(tmp_path / "whole.csv", HEAD, rows(40))]).text
    path = write(tmp_path / "log.csv", HEAD, lines)
    with pytest.raises(RunError, match="line 9, column tip_x: '3.5-12' is not a number"):
        import_logs([path], parse_mapping(mapping, path))
