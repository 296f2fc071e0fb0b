"""A packed file is stopped while it is unpacked: by its format, and by how far it grows."""

import gzip
import os
import tempfile
import time

import pytest
import zstandard
from bench_rows import NAMES, rows

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.readers import packed, text

MCAP = b"\x89MCAP0\r\n"
LINE = (",".join(NAMES) + "\n").encode()


def pack(path, data):
    packer = gzip.compress if path.suffix == ".gz" else zstandard.ZstdCompressor(level=3).compress
    path.write_bytes(packer(data))
    return path


def stopped(path):
    with pytest.raises(RunError) as found:
        guess_mapping([path])
    return str(found.value)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("zeros.csv.gz", bytes(2**24)),
        ("lines.csv.gz", LINE * (2**24 // len(LINE))),
        ("bag.mcap.zst", MCAP + bytes(2**24)),
        ("array.npy.gz", b"\x93NUMPY\x01\x00" + bytes(2**24)),
        ("spaces.tsv.zst", b" " * 2**24),
    ],
)
def test_a_file_that_grows_too_far_is_stopped_early(tmp_path, monkeypatch, name, data):
    monkeypatch.setattr(packed, "_UNSUSPECTED", 2**22)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    said = stopped(pack(tmp_path / name, data))
    assert not list(tmp_path.glob("softmap-*"))
    assert name in said and "more than 200 times its size" in said


@pytest.mark.parametrize("ending", ["gz", "zst"])
def test_a_text_log_is_unpacked_no_further_than_it_is_read(tmp_path, monkeypatch, ending):
    monkeypatch.setattr(text, "LIMIT", 2**21)
    dense = LINE + os.urandom(2**22).hex().encode()
    assert "holds more than 2097152 bytes when unpacked" in stopped(pack(tmp_path / f"log.csv.{ending}", dense))
    said = stopped(pack(tmp_path / f"bag.mcap.{ending}", MCAP + os.urandom(2**22)))
    assert "when unpacked" not in said  # other formats have limits of their own


def test_a_format_that_is_not_read_is_refused_after_the_first_piece(tmp_path, monkeypatch):
    asked = []
    pieces = packed._pieces
    monkeypatch.setattr(packed, "_pieces", lambda *given: (asked.append(1) or piece for piece in pieces(*given)))
    said = stopped(pack(tmp_path / "run.bag.gz", b"#ROSBAG V2.0\n" + os.urandom(2**23)))
    assert "ROS 1 bag" in said and "run.bag.gz" in said and len(asked) == 1


def test_an_ordinary_log_is_read_whatever_its_size(tmp_path, monkeypatch):
    monkeypatch.setattr(packed, "_UNSUSPECTED", 100)
    data = "\n".join([",".join(NAMES), *rows(4000)]) + "\n"
    for ending in ("gz", "zst"):
        assert "markers" in guess_mapping([pack(tmp_path / f"log.csv.{ending}", data.encode())]).text


def test_many_gigabytes_of_zeros_take_no_time(tmp_path):
    path = tmp_path / "bomb.csv.gz"
    with path.open("wb") as file, gzip.GzipFile(fileobj=file, mode="wb", compresslevel=1) as stream:
        for _ in range(320):
            stream.write(bytes(2**20))
    begin = time.monotonic()
    assert "times its size" in stopped(path) and time.monotonic() - begin < 8.0
