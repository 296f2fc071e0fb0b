"""The format of a log is found by its bytes; one that is not read is named with the way out."""

import io
import re
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from containers import arrays, messages, write_dataset, write_db3, write_mat73
from recordings import places, write_c3d, write_mcap, write_motive, write_trc

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.readers.kinds import _FOREIGN, kind_of


def archive(names):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as made:
        for name in names:
            made.writestr(name, "x")
    return stream.getvalue()


def tar():
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as made:
        made.addfile(tarfile.TarInfo("log.csv"))
    return stream.getvalue()


def ros1_mcap():
    return (Path(__file__).parents[1] / "data/containers/ros1.mcap").read_bytes()


NOT_READ = {
    "run.bag": (
        b"#ROSBAG V2.0\n" + bytes(100),
        "a ROS 1 bag: convert it with `rosbags-convert --src run.bag --dst FOLDER`",
    ),
    "log.csv": (b"#ROSBAG V2.0\n" + bytes(100), "a ROS 1 bag"),
    "run.mcap": (ros1_mcap(), "an MCAP file of ROS 1 messages: convert the bag"),
    "log.xlsx": (
        archive(["[Content_Types].xml", "xl/workbook.xml"]),
        "a spreadsheet (.xlsx): save the sheet as CSV",
    ),
    "log.CSV": (archive(["[Content_Types].xml", "xl/workbook.xml"]), "a spreadsheet (.xlsx)"),
    "log.ods": (
        archive(["mimetype", "content.xml"]),
        "an OpenDocument file (.ods): save the sheet as CSV",
    ),
    "log.xls": (
        b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(500),
        "an old spreadsheet or document (.xls): save the sheet as CSV",
    ),
    "logs.zip": (archive(["a.csv", "b.csv"]), "a zip archive: unpack it"),
    "logs.tar": (tar(), "a tar archive: unpack it"),
    "log.csv.xz": (b"\xfd7zXZ\0" + bytes(50), "`xz -dk log.csv.xz`"),
    "log.csv.bz2": (b"BZh9" + bytes(50), "`bzip2 -dk log.csv.bz2`"),
    "log.tdms": (b"TDSm\x0e" + bytes(100), "a LabVIEW TDMS file"),
    "flight.ulg": (b"ULog\x01\x12\x35\x01" + bytes(100), "`ulog2csv flight.ulg`"),
    "log.feather": (b"ARROW1\0\0" + bytes(100), "write it as Parquet"),
    "take.bvh": (b"HIERARCHY\nROOT hips\n", "a BVH motion file: export the positions"),
    "film.mp4": (b"\0\0\0\x20ftypisom" + bytes(100), "a picture or video, no log"),
    "log.txt": (b"# Created by Octave 8.4\n# name: x\n", "`save -v7 FILE.mat`"),
    "data.pkl": (b"\x80\x04\x95" + bytes(100), "a Python pickle, which could run code"),
}


@pytest.mark.parametrize("name", NOT_READ)
def test_a_format_that_is_not_read_is_named_with_the_way_out(tmp_path, name):
    data, words = NOT_READ[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(RunError) as fault:
        guess_mapping([tmp_path / name])
    message = str(fault.value)
    assert words in message and "is not text" not in message and "\n" not in message
    assert "{" not in message


def test_every_format_of_the_list_is_named_by_its_bytes(tmp_path):
    for k, (magic, _) in enumerate(_FOREIGN):
        (tmp_path / f"log{k}.csv").write_bytes(magic + bytes(600))
        with pytest.raises(RunError, match=f"log{k}.csv: is "):
            kind_of(tmp_path / f"log{k}.csv")


@pytest.mark.parametrize("word", ["PAR1", "LOGGED", "RRF2", "BZh9", "ARROW1", "FEA1", "TDSm"])
def test_a_column_that_is_called_as_a_format_begins_is_a_column(tmp_path, word):
    (tmp_path / "log.csv").write_text(f"{word},t\n1,2\n3,4\n")
    assert kind_of(tmp_path / "log.csv") == "csv"


def test_an_archive_of_very_many_entries_is_refused_before_it_is_listed(tmp_path):
    (tmp_path / "log.npz").write_bytes(archive([f"{k}.npy" for k in range(25_000)]))
    with pytest.raises(RunError, match="table of contents has .* at most 1048576 are read"):
        kind_of(tmp_path / "log.npz")


def text(path):
    path.write_text("t,u\n0,1\n1,2\n")
    return path


def npz(path):
    np.savez(path, **arrays())
    return path


READ = {
    "csv": text,
    "npz": lambda path: npz(path.with_suffix(".npz")),
    "hdf5": lambda path: write_mat73(path, arrays()),
    "db3": lambda path: write_db3(path, messages(4)),
    "mcap": lambda path: write_mcap(path, messages(4)),
    "motive": lambda path: write_motive(path, *places(4)),
    "trc": lambda path: write_trc(path, *places(4)),
}


@pytest.mark.parametrize("kind", READ)
def test_a_name_does_not_change_what_a_file_is(tmp_path, kind):
    data = READ[kind](tmp_path / "made").read_bytes()
    for name in ("log.csv", "log", "log.txt", "log.dat", "log.db3", "log.zip"):
        (tmp_path / name).write_bytes(data)
        assert kind_of(tmp_path / name) == kind


def test_where_bytes_say_nothing_the_name_decides(tmp_path):
    assert kind_of(write_c3d(tmp_path / "take.c3d", *places(20))) == "c3d"
    (tmp_path / "old.mat").write_bytes(bytes(20))
    assert kind_of(tmp_path / "old.mat") == "mat"
    (tmp_path / "empty").write_bytes(b"")
    assert kind_of(tmp_path / "empty") == "csv"


def test_what_is_no_file_is_not_waited_for(tmp_path):
    import os

    os.mkfifo(tmp_path / "pipe")
    for path, words in (
        (tmp_path / "pipe", "no file"),
        (tmp_path / "absent", "cannot be read"),
        (tmp_path, "a folder"),
    ):
        with pytest.raises(RunError, match=words):
            kind_of(path)


# --- what is not installed -----------------------------------------------------------------
@pytest.mark.parametrize(
    ("package", "made", "words"),
    [
        (
            "scipy",
            lambda f: (scipy.io.savemat(f / "a.mat", arrays()), f / "a.mat")[1],
            "MATLAB files need scipy",
        ),
        ("h5py", lambda f: write_mat73(f / "a.mat", arrays()), "HDF5 files need h5py"),
        ("pyarrow", lambda f: write_dataset(f / "set"), "Parquet needs pyarrow"),
    ],
)
def test_a_parser_that_is_not_installed_is_named_with_its_extra(
    tmp_path, monkeypatch, package, made, words
):
    path = made(tmp_path)
    (tmp_path / "without").mkdir()
    (tmp_path / f"without/{package}.py").write_text("raise ImportError")
    monkeypatch.setattr(sys, "path", [str(tmp_path / "without"), *sys.path])
    for name in [name for name in sys.modules if name.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(RunError, match=rf"{words}; run pip install 'softmap-edge\[logs\]'"):
        guess_mapping([path])


def test_zstd_that_is_not_installed_is_named_with_its_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "zstandard", None)
    (tmp_path / "run.mcap.zstd").write_bytes(b"\x28\xb5\x2f\xfd" + bytes(20))
    with pytest.raises(
        RunError,
        match=r"need zstandard; run pip install 'softmap-edge\[logs\]', or zstd -d run.mcap.zstd",
    ):
        guess_mapping([tmp_path / "run.mcap.zstd"])


def test_the_extra_has_all_that_its_errors_name():
    text = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    extras = tomllib.loads(text)["project"]["optional-dependencies"]
    assert {re.split("[>=]", one)[0] for one in extras["logs"]} == {
        "c3d",
        "h5py",
        "mcap",
        "pyarrow",
        "scipy",
        "zstandard",
    }
    assert extras["capture"] == ["softmap-edge[logs]"]
