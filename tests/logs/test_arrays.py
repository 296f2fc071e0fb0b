"""Logs as named arrays: NumPy, MATLAB v4 to v7.3, HDF5 and Parquet; what holds no plain numbers is
named, never run.
"""

import io
import json
import pickle
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from containers import ARRAYS, JOINTS, arrays, write_dataset, write_mat73

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.readers.arrays import columns_of_arrays
from softmap_edge.logs.readers.npz_log import seconds_of
from softmap_edge.logs.table import open_log

DATA = Path(__file__).parents[1] / "data/containers"


def imported(paths, mapping=ARRAYS):
    return import_logs(paths, parse_mapping(mapping, Path("map.toml")))


def refused(path, mapping=ARRAYS):
    with pytest.raises(RunError) as fault:
        imported([path], mapping)
    assert "\n" not in str(fault.value) and len(str(fault.value)) < 1000
    return str(fault.value)


def turned(values):
    return {name: value.T for name, value in values.items()}


def npz(path, values):
    np.savez_compressed(path, **values)
    return path


def mat(path, values):
    scipy.io.savemat(path, values, do_compression=True)
    return path


def nested(values):
    return {"log": {"t": values["t"], "signal": {"u": values["u"], "tip": values["tip"]}}}


def hdf5(path, values, group=""):
    with h5py.File(path, "w") as file:
        for name, value in values.items():
            file.create_dataset(f"{group}{name}", data=value, compression="gzip", fletcher32=True)
    return path


def parquet(path, values):
    columns = {"t": pa.array(values["t"])}
    columns |= {
        name: pa.array(values[name].tolist(), pa.list_(pa.float64())) for name in ("u", "tip")
    }
    pq.write_table(pa.table(columns), path, row_group_size=30)
    return path


MADE = {
    "npz": lambda f: npz(f / "a.npz", arrays()),
    "npz of other types": lambda f: npz(
        f / "a.npz", {k: v.astype("<f4") for k, v in arrays().items()}
    ),
    "npz turned": lambda f: npz(f / "a.npz", turned(arrays())),
    "npz without its name": lambda f: npz(f / "a.npz", arrays()).rename(f / "log.dat"),
    "mat": lambda f: mat(f / "a.mat", arrays()),
    "mat turned": lambda f: mat(f / "a.mat", turned(arrays())),
    "mat v4": lambda f: (scipy.io.savemat(f / "a.mat", arrays(), format="4"), f / "a.mat")[1],
    "mat v7.3": lambda f: write_mat73(f / "a.mat", arrays()),
    "mat v7.3 turned": lambda f: write_mat73(f / "a.mat", turned(arrays())),
    "hdf5": lambda f: hdf5(f / "a.h5", arrays()),
    "parquet": lambda f: parquet(f / "a.parquet", arrays()),
}


@pytest.mark.parametrize("made", MADE)
def test_every_format_gives_the_same_run_and_its_proposal_imports(tmp_path, made):
    path = MADE[made](tmp_path)
    run, known = imported([path]).run, arrays()
    near = 1e-5 if "types" in made else 1e-12
    assert run.t == pytest.approx(known["t"], abs=near) and run.command == pytest.approx(
        known["u"], abs=near
    )
    assert run.markers[:, 0] == pytest.approx(known["tip"], abs=10 * near)
    found = guess_mapping([path])
    again = imported([path], found.text).run
    assert again.command == pytest.approx(known["u"], abs=near) and again.markers.shape == (
        80,
        1,
        3,
    )


@pytest.mark.parametrize("name", ["log.npz", "run.mat"])
def test_the_cases(name):
    found = guess_mapping([DATA / name])
    run = imported([DATA / name], found.text).run
    assert run.command.shape == (80, 2) and run.markers.shape == (80, 1, 3)
    assert list(run.markers[0, 0]) == [10, 2, 90]


@pytest.mark.parametrize(
    ("made", "prefix"),
    [
        (lambda f: mat(f / "a.mat", nested(arrays())), "log.signal."),
        (lambda f: write_mat73(f / "a.mat", {f"log.{k}": v for k, v in arrays().items()}), "log."),
        (lambda f: hdf5(f / "a.h5", arrays(), "run/7/"), "run.7."),
    ],
)
def test_structs_and_groups_give_paths(tmp_path, made, prefix):
    mapping = ARRAYS.replace('"u[', f'"{prefix}u[').replace('"tip[', f'"{prefix}tip[')
    time = prefix.replace("signal.", "")
    run = imported([made(tmp_path)], mapping.replace('"t"', f'"{time}t"')).run
    assert run.command == pytest.approx(arrays()["u"]) and run.t == pytest.approx(arrays()["t"])
    found = guess_mapping([made(tmp_path)])
    again = imported([made(tmp_path)], found.text).run
    assert again.command == pytest.approx(arrays()["u"]) and again.markers.shape == (80, 1, 3)


def test_points_of_three_dimensions_have_axes():
    points = np.arange(5 * 2 * 3.0).reshape(5, 2, 3)
    for array in (
        points,
        np.moveaxis(points, 0, 2),
        np.moveaxis(points, 2, 1),
        np.moveaxis(points, 0, 1),
    ):
        held = columns_of_arrays(Path("a"), {"t": np.arange(5.0), "m": array})
        values = dict(zip(held.names, held.columns))
        assert list(values["m[1].y"]) == list(points[:, 1, 1]), array.shape
    held = columns_of_arrays(Path("a"), {"t": np.arange(5.0), "T": np.zeros((5, 4, 4))})
    assert "T[3,3]" in held.names and len(held.names) == 17


def test_signals_of_other_lengths_are_logs_of_their_own(tmp_path):
    """Commands at 20 Hz, a camera at 10: two [[log]] of one file; one [[log]] of both is
    refused.
    """
    values = arrays()
    values |= {"t_cam": values["t"][::2], "tip": values["tip"][::2]}
    path = npz(tmp_path / "a.npz", values)
    assert "tip[0] has 40 rows and t has 80 rows: give each length a [[log]] of its own" in refused(
        path
    )
    found = guess_mapping([path])
    assert found.text.count("[[log]]") == 2
    run = imported([path], found.text).run
    assert (
        run.command.shape == (80, 2)
        and run.markers.shape == (40, 1, 3)
        and run.t_seen == pytest.approx(values["t_cam"])
    )


class Canary:
    def __reduce__(self):
        return (open, ("canary", "w"))


def test_objects_are_left_out_and_never_unpickled(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    canary = tmp_path / "canary"
    odd = np.array([Canary(), None], dtype=object)
    path = npz(tmp_path / "a.npz", arrays() | {"who": odd, "fs": np.array(20.0)})
    canary.unlink(missing_ok=True)
    done = imported([path])
    assert any(
        "left out: who (Python objects, which are never read), fs (one number, 20)" in n
        for n in done.notes
    )
    assert "holds no columns of numbers: who (Python objects" in refused(
        npz(tmp_path / "b.npz", {"who": odd})
    )
    np.save(tmp_path / "c.npy", odd)
    assert "Python objects" in refused(tmp_path / "c.npy")
    (tmp_path / "d.pkl").write_bytes(pickle.dumps(Canary()))
    assert "is a Python pickle, which could run code and is never read" in refused(
        tmp_path / "d.pkl"
    )
    assert not canary.exists()


def test_fields_texts_and_dates_of_numpy(tmp_path):
    table = np.zeros(30, [("when", "M8[ms]"), ("u", "<f4", 2), ("name", "U5")])
    table["when"] = np.datetime64("2026-11-27T12:00:00.000") + 50 * np.arange(30).astype("m8[ms]")
    table["u"] = np.arange(60).reshape(30, 2)
    table["name"] = np.where(np.arange(30) < 15, "one", "two")
    np.save(tmp_path / "a.npy", table)
    held = open_log(tmp_path / "a.npy")
    assert held.names == ["data.when", "data.u[0]", "data.u[1]", "data.name"]
    assert held.columns[0][1] - held.columns[0][0] == pytest.approx(0.05, abs=1e-6)
    assert list(held.read([0], 3).labels[[0, 29]]) == ["one", "two"]
    assert np.isnan(seconds_of(np.array(["NaT"], "M8[us]"))).all()


def test_a_run_is_not_a_log(tmp_path):
    run = imported([npz(tmp_path / "a.npz", arrays())]).run
    run.save(tmp_path / "run.npz")
    assert "is a run already; `softmap check run.npz`" in refused(tmp_path / "run.npz")


# --- damage and bombs ----------------------------------------------------------------------
def claimed(shape, dtype="<f8"):
    """The header of an array of a shape, without its numbers."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": dtype, "fortran_order": False, "shape": shape}
    )
    return stream.getvalue()


def zipped(path, entries, kind=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", kind) as archive:
        for name, data in entries:
            archive.writestr(name, data)
    return path


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ([("t.npy", claimed((2**40,)))], "needs 8796093022208 bytes"),
        ([("t.npy", claimed((2**62, 2**62)))], "needs"),
        ([("t.npy", claimed((-3,)))], "shape (-3,)"),
        ([("t.npy", claimed((0,) * 3))], "t (empty)"),
        ([("t.npy", claimed((4,)) + bytes(64))], "is longer than its shape"),
        ([("t.npy", bytes(2**20))] * 600, "600 arrays"),
        ([("t.npy", b"no array")], "is a damaged NumPy file"),
        (
            [("t.npy", claimed((2,)) + bytes(16)), ("t.npy", claimed((2,)) + bytes(16))],
            "two arrays are called 't'",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_archives_made_to_harm(tmp_path, entries, words):
    assert words in refused(zipped(tmp_path / "a.npz", entries))


def test_a_flipped_bit_in_an_archive_is_found_by_its_checksum(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, **arrays())
    data = bytearray(path.read_bytes())
    for at in (300, 1500, 3000):
        path.write_bytes(data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :])
        assert "is a damaged NumPy file" in refused(path)


def test_a_matlab_file_that_unpacks_without_end_is_stopped(tmp_path):
    """200 MB of zeros in 200 kB are refused before they are unpacked; a compressed bomb of structs
    by the limit.
    """
    path = mat(tmp_path / "a.mat", {"x": np.zeros((2**25 + 1, 1), np.int8)})
    assert path.stat().st_size < 10**6 and "holds more than 33554432 numbers" in refused(path)
    path = mat(
        tmp_path / "b.mat",
        {"s": {"x": np.zeros((2**27, 1), np.int8), "y": np.zeros((2**27, 1), np.int8)}},
    )
    assert "holds more than 33554432 numbers" in refused(path) or "needs more than" in refused(path)


def test_what_matlab_keeps_besides_numbers_is_named(tmp_path):
    cells = np.empty(2, object)
    cells[:] = [np.zeros(3), "text"]
    words = np.empty(80, object)
    words[:] = ["one"] * 40 + ["two"] * 40
    path = mat(
        tmp_path / "a.mat",
        arrays() | {"c": cells, "z": np.array([1j, 2]), "title": "run 7", "part": words},
    )
    done = imported([path], ARRAYS + 'block = "part"\n')
    assert any(
        "left out: c (cells), z (complex numbers), title (text)" in note for note in done.notes
    )
    assert list(np.unique(done.run.block)) == ["one", "two"]


def deep(depth):
    value = np.arange(5.0)
    for _ in range(depth):
        value = {"s": value}
    return value


def test_structs_within_structs_end(tmp_path):
    assert "structs within more than 8 structs" in refused(mat(tmp_path / "a.mat", {"s": deep(20)}))
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["a"] = np.arange(5.0)
        group = file.create_group("g")
        group["again"] = group  # a hard link to itself
    assert "structs within more than 8 structs" in refused(tmp_path / "b.h5")


def test_hdf5_follows_nothing_out_of_the_file(tmp_path):
    secret = tmp_path / "secret"
    secret.write_bytes(np.arange(80.0).tobytes())
    hdf5(tmp_path / "other.h5", arrays())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["n"] = np.arange(80.0)
        file["link"] = h5py.ExternalLink("other.h5", "/t")
        file["soft"] = h5py.SoftLink("/n")
        file.create_dataset("outside", (80,), "<f8", external=[(str(secret), 0, 640)])
        layout = h5py.VirtualLayout((80,), "<f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "t", (80,))
        file.create_virtual_dataset("virtual", layout)
    held = open_log(tmp_path / "a.h5")
    assert held.names == ["n"]
    remarks = "; ".join(held.notes)
    assert (
        "link (a link)" in remarks
        and "outside (kept in another file)" in remarks
        and "virtual (kept in" in remarks
    )


def test_hdf5_of_a_size_that_it_only_promises(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x", (2**40,), "<f8", chunks=(2**20,))
    assert "holds more than 33554432 numbers" in refused(tmp_path / "a.h5")


def test_damage_in_hdf5_and_matlab_is_one_error(tmp_path):
    for path in (
        hdf5(tmp_path / "a.h5", arrays()),
        mat(tmp_path / "a.mat", arrays()),
        parquet(tmp_path / "a.pq", arrays()),
    ):
        data = bytearray(path.read_bytes())
        path.write_bytes(data[: len(data) // 2])
        assert "is a damaged" in refused(path)


# --- Parquet -------------------------------------------------------------------------------
LEROBOT = """schema = "softmap.mapping/1"
command_unit = "deg"
[[log]]
episode = 1
time = { column = "timestamp" }
command = { columns = ["action[shoulder_pan.pos]", "action[gripper.pos]"], unit = "deg" }
present = { columns = ["observation.state[shoulder_pan.pos]", "observation.state[gripper.pos]"], unit = "deg" }
"""


@pytest.mark.parametrize("what", ["", "data/chunk-000/file-000.parquet"])
def test_an_episode_of_a_dataset(tmp_path, what):
    write_dataset(tmp_path / "set")
    done = imported([tmp_path / "set" / what], LEROBOT)
    t = np.arange(40) / 30
    assert done.run.t == pytest.approx(t, abs=1e-6)
    assert done.run.command[:, 0] == pytest.approx(50 * np.sin(t + 1) + 1, abs=1e-4)
    assert any("episode 1" in note for note in done.notes)
    assert any("observation.images.front (in files of video)" in note for note in done.notes)
    message = refused(tmp_path / "set" / what, LEROBOT.replace("episode = 1\n", ""))
    assert "several episodes" in message and "episode = 0" in message
    message = refused(tmp_path / "set" / what, LEROBOT.replace("= 1\n", "= 7\n", 1))
    assert "no episode 7; there are 0 to 2" in message


def test_the_proposal_for_a_dataset(tmp_path):
    found = guess_mapping([write_dataset(tmp_path / "set")])
    assert "degrees or LeRobot's values from -100 to 100" in found.text
    assert (
        "episode = 0" in found.text
        and '"action[shoulder_pan.pos]", "action[gripper.pos]"' in found.text
    )
    run = imported([tmp_path / "set"], found.text).run
    assert run.command.shape == (40, 2) and run.present.shape == (40, 2)


def test_a_dataset_of_several_files(tmp_path):
    folder = write_dataset(tmp_path / "set")
    other = write_dataset(tmp_path / "other", episodes=5)
    table = pq.read_table(other / "data/chunk-000/file-000.parquet")
    table = table.filter(pa.compute.greater(table["episode_index"], 2))
    pq.write_table(table, folder / "data/chunk-000/file-001.parquet")
    done = imported([folder], LEROBOT.replace("episode = 1", "episode = 4"))
    assert done.run.command[0, 0] == pytest.approx(50 * np.sin(4) + 1, abs=1e-4)
    assert list(done.run.extra["made_from"])[0].startswith("file-001.parquet")
    assert "many episodes in 2 files" in refused(folder, LEROBOT.replace("episode = 1\n", ""))
    assert "no file of set holds episode 9" in refused(
        folder, LEROBOT.replace("episode = 1", "episode = 9")
    )


def test_a_dataset_of_one_file_an_episode(tmp_path):
    """LeRobot before v3."""
    folder = write_dataset(tmp_path / "set")
    complete = pq.read_table(folder / "data/chunk-000/file-000.parquet")
    (folder / "data/chunk-000/file-000.parquet").unlink()
    for k in range(3):
        one = complete.filter(pa.compute.equal(complete["episode_index"], k))
        pq.write_table(one, folder / f"data/chunk-000/episode_{k:06d}.parquet")
    done = imported([folder], LEROBOT)
    assert done.run.command[0, 0] == pytest.approx(50 * np.sin(1) + 1, abs=1e-4)
    assert list(done.run.extra["made_from"])[0].startswith("episode_000001.parquet")
    assert imported(
        [folder / "data/chunk-000/episode_000001.parquet"], LEROBOT.replace("episode = 1\n", "")
    ).run
    assert "episode = 0" in guess_mapping([folder]).text


def test_the_calibration_of_an_arm_is_explained(tmp_path):
    motor = {"id": 1, "drive_mode": 0, "homing_offset": -47, "range_min": 738, "range_max": 3358}
    (tmp_path / "arm.json").write_text(
        json.dumps({"shoulder_pan": motor, "gripper": motor | {"id": 6, "drive_mode": 1}})
    )
    message = refused(tmp_path / "arm.json")
    assert (
        "is the calibration of a LeRobot arm, no log: shoulder_pan (id 1, 738 to 3358), gripper "
        "(id 6" in message
    )
    assert "scale = 13.1, offset = 2048" in message and "softmap model calibrate" in message
    assert [13.1 * x + 2048 for x in (-100, 100)] == pytest.approx([738, 3358])
    for odd in (
        "[]",
        '{"a": {"homing_offset": 1}}',
        '{"a": {"id": "x", "homing_offset": 1, "range_min": [], "range_max": 0}}',
    ):
        (tmp_path / "odd.json").write_text(odd)
        refused(tmp_path / "odd.json")


@pytest.mark.parametrize(
    "names", [JOINTS, {"motors": JOINTS}, None, ["one"], [1, 2], {"a": [], "b": []}]
)
def test_names_of_elements_as_datasets_give_them(tmp_path, names):
    write_dataset(tmp_path / "set")
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    info["features"]["action"]["names"] = names
    (tmp_path / "set/meta/info.json").write_text(json.dumps(info))
    held = open_log(
        tmp_path / "set/data/chunk-000/file-000.parquet", parse_mapping(LEROBOT, Path("m")).logs[0]
    )
    known = names in (JOINTS, {"motors": JOINTS})
    assert ("action[gripper.pos]" if known else "action[1]") in held.names


def test_an_info_that_is_damaged_is_one_error(tmp_path):
    write_dataset(tmp_path / "set")
    for text in ("{", "[]", '{"features": 3}', "[" * 10_000):
        (tmp_path / "set/meta/info.json").write_text(text)
        assert "info.json" in refused(tmp_path / "set", LEROBOT)


def test_types_of_parquet(tmp_path):
    rows = 20
    when = pa.array(1_700_000_000_000 + 50 * np.arange(rows), pa.timestamp("ms"))
    columns = {
        "when": when,
        "u": pa.array([None if k == 3 else k for k in range(rows)], pa.int32()),
        "on": pa.array([k % 2 == 0 for k in range(rows)]),
        "part": pa.array(["a", "b"] * (rows // 2)).dictionary_encode(),
        "ragged": pa.array([[1.0] * (1 + k % 3) for k in range(rows)]),
        "picture": pa.array([{"bytes": b"x", "path": "p"}] * rows),
        "raw": pa.array([b"x"] * rows),
    }
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    held = open_log(tmp_path / "a.parquet")
    assert held.names == ["when", "u", "on", "part"]
    assert held.columns[0][1] == pytest.approx(1_700_000_000.05) and np.isnan(held.columns[1][3])
    remarks = "; ".join(held.notes)
    assert all(
        word in remarks
        for word in ("ragged (lists of different lengths)", "picture (struct", "raw (binary")
    )


def test_a_flipped_bit_in_a_page_with_a_checksum_is_found(tmp_path):
    path = tmp_path / "a.parquet"
    pq.write_table(
        pa.table({"t": np.arange(5000.0)}),
        path,
        write_page_checksum=True,
        compression="none",
        use_dictionary=False,
    )
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    assert "is a damaged Parquet file" in refused(path)


def test_a_parquet_file_of_more_numbers_than_are_read(tmp_path):
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"t": np.zeros(2**25 + 2, np.int8)}), path)
    assert path.stat().st_size < 10**6 and "holds more than 33554432 numbers" in refused(path)


def test_signalling_nans_are_missing_values_without_a_warning(tmp_path):
    """Damaged bytes may hold them; any sum or product with one is a floating-point exception, here
    an error.
    """
    values = arrays()
    values["tip"] = np.array(values["tip"], float)
    values["t"] = np.array(values["t"], float)
    values["t"].view(np.uint64)[7] = 0x7FF0_0000_0000_0001
    values["tip"].view(np.uint64)[5] = 0x7FF0_0000_0000_0001
    assert "the time is empty or not a number" in refused(npz(tmp_path / "a.npz", values))
