"""Numbers that a sensor writes when it fails never become a temperature or a load of the run."""

import numpy as np
import pytest
from bench_rows import NAMES, rows, write

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

COUNT = 60
TIMES = np.arange(COUNT)


def log(folder, name, cells):
    lines = [f"{line},{cell}" for line, cell in zip(rows(COUNT), cells)]
    return write(folder / "log.csv", ",".join([*NAMES, name]), lines)


def spoiled(usual, error, at):
    return [error if k in at else f"{usual[k]:.4f}" for k in range(COUNT)]


def read(path, old="", new=""):
    text = guess_mapping([path]).text
    assert old in text
    return import_logs([path], parse_mapping(text.replace(old, new, 1), path))


WARMING = 22.0 + 0.02 * TIMES
NOISY = 100.0 + np.random.default_rng(0).normal(0.0, 1.0, COUNT)
DIGITAL = 0.0625 * np.round((22.0 + 0.01 * TIMES) / 0.0625)  # held for several rows


@pytest.mark.parametrize(
    ("name", "usual", "error", "at"),
    [
        ("temperature_c", WARMING, "-127", {9, 30, 31}),
        ("temperature_c", WARMING, "-127.00", {20}),
        ("temp", DIGITAL, "85.0", {0, 1, 2}),  # after power-up
        ("temp", 20.0 + TIMES, "-127.0", {30}),  # within a wide range
        ("temperature_c", WARMING, "-273.15", {59}),
        ("temperature_c", WARMING, "-999", {10, 40}),
        ("temperature_c", WARMING, "9999", {10, 40}),
        ("temperature_c", DIGITAL, "65535", {10, 11, 12}),
        ("temp", WARMING, "0", {12, 13, 40}),  # no known number: far, and between others
        ("temp [K]", WARMING + 273.15, "146.15", {5, 6}),
        ("load_g", NOISY, "8388607", {7, 8, 30}),  # full scale of 24 bits
        ("load_g", NOISY, "0", {7, 8, 30}),
        ("load_g", NOISY, "-32768", {20}),
    ],
)
def test_an_error_of_a_sensor_is_missing_and_counted(tmp_path, name, usual, error, at):
    path = log(tmp_path, name, spoiled(usual, error, at))
    done = read(path)
    kind = "load" if "load" in name else "temperature"
    expected = usual - 273.15 if "K" in name else usual
    kept = np.array([k for k in range(COUNT) if k not in at])
    between = np.interp(TIMES, kept, expected[kept])
    assert getattr(done.run, kind) == pytest.approx(between, abs=1e-3)
    said = [doubt for doubt in done.doubts if doubt.startswith(f"{kind}: exactly")]
    assert len(said) == 1 and f"in {len(at)} of {COUNT} rows" in said[0]
    assert f'{kind}.not_seen = "keep"' in said[0]


@pytest.mark.parametrize(
    ("name", "cells"),
    [
        ("temperature_c", [f"{x:.3f}" for x in WARMING]),
        ("temperature_c", ["85.0"] * COUNT),  # a hot chamber
        ("temperature_c", [f"{20 + 1.2 * k:.2f}" for k in range(COUNT)]),  # passes 85 nearly
        ("temperature_c", ["85.0" if k == 30 else f"{80 + k / 6:.1f}" for k in range(COUNT)]),
        ("temperature_c", ["20.0"] * 30 + [f"{60 + 0.01 * k:.2f}" for k in range(30)]),  # chamber
        (
            "temperature_c",  # three sessions, in steps of half a degree
            ["60.0" if 20 <= k < 40 else f"{20 + 0.5 * (k % 4):.1f}" for k in range(COUNT)],
        ),
        ("load_g", ["0"] * 20 + ["50"] * 20 + ["0"] * 20),  # typed
        ("load_g", ["0"] * 10 + ["20"] * 10 + ["50"] * 10 + ["999"] * 10 + ["0"] * 20),
        ("load_g", [f"{x:.2f}" for x in np.where(TIMES < 30, 0.0, NOISY)]),  # put on once
    ],
)
def test_what_a_sensor_measured_is_kept(tmp_path, name, cells):
    done = read(log(tmp_path, name, cells))
    values = done.run.load if "load" in name else done.run.temperature
    assert values == pytest.approx(np.array(cells, float))
    assert not any("error of the sensor" in doubt for doubt in done.doubts)


@pytest.mark.parametrize(
    ("name", "cells"),
    [
        ("temperature_c", ["25.0"] * 40 + ["85.0"] * 20),  # a second session in a chamber
        ("temp", ["25.0"] * 20 + ["85.0"] * 20 + ["25.0"] * 20),
        ("temp", ["85"] * 30 + [f"{25 + 0.0625 * (k % 3):.4f}" for k in range(30)]),
        ("temp [K]", ["298.15"] * 30 + ["358.15"] * 30),
        ("temp", [("25.0", "85.0")[k > 30] if k % 2 else "" for k in range(COUNT)]),  # every 2nd
    ],
)
def test_a_hot_session_is_kept_and_reported(tmp_path, name, cells):
    path = log(tmp_path, name, cells)
    done = read(path)
    kelvin = 273.15 if "K" in name else 0.0
    assert done.run.temperature.max() == pytest.approx(85.0)
    asked = [doubt for doubt in done.doubts if "a hot session, or a sensor that failed" in doubt]
    assert len(asked) == 1 and f"exactly {85 + kelvin:g} in" in asked[0]
    column = f'columns = ["{name}"]'
    missing = read(path, column, f"{column}, not_seen = [{85 + kelvin:g}]")
    assert missing.run.temperature.max() < 26.0
    kept = read(path, column, f'{column}, not_seen = "keep"')
    assert kept.run.temperature.max() == pytest.approx(85.0) and not kept.doubts


def test_many_short_errors_are_no_session(tmp_path):
    cells = ["85.0" if k // 3 % 2 else f"{22 + 0.02 * k:.2f}" for k in range(COUNT)]
    assert read(log(tmp_path, "temp", cells)).run.temperature.max() < 24.0


def test_declared_numbers_are_missing_and_others_are_kept_if_asked(tmp_path):
    cells = spoiled(WARMING, "21.5", {10, 20})
    path = log(tmp_path, "temperature_c", cells)
    assert read(path).run.temperature[10] == 21.5
    column = 'columns = ["temperature_c"]'
    done = read(path, column, f"{column}, not_seen = [21.5]")
    assert done.run.temperature[10] == pytest.approx(22.2)
    assert any("21.5 in 2 of 60 rows" in note for note in done.notes)
    path = log(tmp_path, "temperature_c", spoiled(WARMING, "85", {10, 20}))
    assert read(path, column, f'{column}, not_seen = "keep"').run.temperature[10] == 85.0


@pytest.mark.parametrize("error", ["-127", "-273.15", "-127.00"])
def test_a_sensor_that_never_answered_is_left_out(tmp_path, error):
    path = log(tmp_path, "temperature_c", [error] * COUNT)
    guess = guess_mapping([path])
    assert any("as a sensor writes when it fails" in line for line in guess.unknown)
    assert read(path).run.temperature is None
    with pytest.raises(RunError, match="temperature_c is .* in all 60 rows"):
        read(path, "markers =", 'temperature = { columns = ["temperature_c"] }\nmarkers =')
