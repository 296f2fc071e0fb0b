"""HDF5 and netCDF files whose attributes scale numbers, mark missing ones and give units."""

import h5py
import numpy as np
import pytest

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.readers.matlab_file import open_hdf5

T = np.arange(160) / 20
U = np.stack([8 + 7 * np.sin(0.7 * T), 8 + 7 * np.sin(1.1 * T + 1)], axis=1)
S = np.array([0.5, 1.0])[None, :]
POINTS = np.stack(
    [3 * S**2 * (U[:, :1] - 8), 3 * S**2 * (U[:, 1:] - 8), 100 * S + 0 * U[:, :1]], axis=2
)  # mm


def written(path, arrays):
    """Write arrays, each a pair of numbers and attributes."""
    with h5py.File(path, "w") as file:
        for name, (numbers, attributes) in arrays.items():
            entry = file.create_dataset(name, data=numbers)
            for key, value in attributes.items():
                entry.attrs[key] = value
    return path


def log(**attributes):
    """Return the arrays of a log, with more attributes of the markers."""
    return {"time": (T, {}), "command": (U, {}), "markers": (POINTS, attributes)}


def imported(path):
    text = guess_mapping([path]).text
    text = "".join(line + "\n" for line in text.split("\n") if "origin_mm" not in line)
    return import_logs([path], parse_mapping(text, path))


@pytest.mark.parametrize(
    ("kind", "scale", "offset", "fill"),
    [
        (np.int16, 0.01, 0.0, -32768),
        (np.int32, 1e-4, 40.0, -(2**31)),
        (np.uint16, np.float32(0.5**7), np.array([-100.0]), 65535),
    ],
)
def test_packed_numbers_are_unpacked_and_fills_are_missing(tmp_path, kind, scale, offset, fill):
    packed = np.rint((POINTS - offset) / scale).astype(kind)
    packed[30:40, 1] = fill
    what = {"scale_factor": scale, "add_offset": offset, "_FillValue": kind(fill), "units": "mm"}
    done = imported(written(tmp_path / "log.h5", log() | {"markers": (packed, what)}))
    seen = done.run.visible
    assert not seen[30:40, 1].any() and seen.sum() == seen.size - 10
    assert np.allclose(done.run.markers[seen], POINTS[seen], atol=0.01)
    assert any("markers: read as" in note for note in done.notes)


@pytest.mark.parametrize(
    ("units", "mm", "stored"),
    [("cm", 10.0, "c"), ("meters", 1000.0, "m"), (np.bytes_(b"[inch]"), 25.4, "i")],
)
def test_units_of_places_are_read(tmp_path, units, mm, stored):
    path = tmp_path / f"{stored}.h5"
    arrays = log() | {"markers": (POINTS / mm, {"units": units})}
    assert np.allclose(imported(written(path, arrays)).run.markers, POINTS, atol=1e-6)


@pytest.mark.parametrize(
    ("units", "second"), [("milliseconds", 1e3), ("us", 1e6), ("seconds since 2031-05-01", 1.0)]
)
def test_units_of_time_are_read(tmp_path, units, second):
    path = written(tmp_path / "log.h5", log() | {"time": (T * second, {"units": units})})
    assert np.ptp(imported(path).run.t) == pytest.approx(np.ptp(T))


@pytest.mark.parametrize(("units", "unit"), [("degrees", "deg"), ("rad", "rad"), ("[mm]", "mm")])
def test_units_of_commands_are_read(tmp_path, units, unit):
    path = written(tmp_path / "log.h5", log() | {"command": (U, {"units": units})})
    assert imported(path).run.command_unit == unit


@pytest.mark.parametrize("units", ["furlong", "s" * 20_000, 5.0, np.ones(3), h5py.Empty("f8")])
def test_units_that_are_not_known_are_named(tmp_path, units):
    path = written(tmp_path / "log.h5", log(units=units))
    notes = open_hdf5(path).notes
    assert len(notes) == 1 and notes[0].startswith("markers: its") and len(notes[0]) < 120


@pytest.mark.parametrize("value", ["0.1", np.ones(2), np.ones(5000), np.nan, 0.0, 1j])
def test_an_array_with_a_malformed_scale_is_left_out(tmp_path, value):
    path = written(tmp_path / "log.h5", log(scale_factor=value))
    columns = open_hdf5(path)
    assert not any(name.startswith("markers") for name in columns.names)
    assert any("its attribute scale_factor is not one plain number" in n for n in columns.notes)


@pytest.mark.parametrize("value", ["none", np.ones(5000), np.zeros(0)])
@pytest.mark.parametrize("key", ["_FillValue", "missing_value"])
def test_a_malformed_fill_is_named(tmp_path, key, value):
    notes = open_hdf5(written(tmp_path / "log.h5", log(**{key: value}))).notes
    assert notes == (f"markers: its attribute {key} is not a plain number and is not used",)


def test_a_fill_of_another_width_is_found(tmp_path):
    numbers = POINTS.astype(np.float32)
    numbers[5] = 1e20
    path = written(tmp_path / "log.h5", log() | {"markers": (numbers, {"missing_value": 1e20})})
    columns = open_hdf5(path)
    missing = np.isnan(columns.columns[columns.names.index("markers[0].x")])
    assert np.flatnonzero(missing).tolist() == [5]


def test_without_the_array_nothing_is_left(tmp_path):
    path = written(tmp_path / "log.h5", {"t": (T, {"add_offset": "later"})})
    with pytest.raises(RunError, match="attribute add_offset is not one plain number"):
        open_hdf5(path)
