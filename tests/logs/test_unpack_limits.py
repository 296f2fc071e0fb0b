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
from softmap_edge.logs.readers import lines, packed

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
    monkeypatch.setattr(lines, "LIMIT", 2**21)
    dense = LINE + os.urandom(2**22).hex().encode()
    assert "holds more than 2097152 bytes when unpacked" in stopped(
        pack(tmp_path / f"log.csv.{ending}", dense)
    )
    said = stopped(pack(tmp_path / f"bag.mcap.{ending}", MCAP + os.urandom(2**22)))
    assert "when unpacked" not in said  # other formats have limits of their own


def test_a_format_that_is_not_read_is_refused_after_the_first_piece(tmp_path, monkeypatch):
    asked = []
    pieces = packed._pieces
    monkeypatch.setattr(
        packed, "_pieces", lambda *given: (asked.append(1) or piece for piece in pieces(*given))
    )
    said = stopped(pack(tmp_path / "run.bag.gz", b"#ROSBAG V2.0\n" + os.urandom(2**23)))
    assert "ROS 1 bag" in said and "run.bag.gz" in said and len(asked) == 1


def test_an_ordinary_log_is_read_whatever_its_size(tmp_path, monkeypatch):
    monkeypatch.setattr(packed, "_UNSUSPECTED", 100)
    data = "\n".join([",".join(NAMES), *rows(4000)]) + "\n"
    for ending in ("gz", "zst"):
        assert (
            "markers" in guess_mapping([pack(tmp_path / f"log.csv.{ending}", data.encode())]).text
        )


def test_many_gigabytes_of_zeros_take_no_time(tmp_path):
    path = tmp_path / "bomb.csv.gz"
    with path.open("wb") as file, gzip.GzipFile(fileobj=file, mode="wb", compresslevel=1) as stream:
        for _ in range(320):
            stream.write(bytes(2**20))
    begin = time.monotonic()
    assert "times its size" in stopped(path) and time.monotonic() - begin < 8.0


TEXT = "\n".join([",".join(NAMES), *rows(60)]).encode() + b"\n"
SKIPPED = b"\x53\x2a\x4d\x18" + (5).to_bytes(4, "little") + b"hello"


def frame(data, **ways):
    return zstandard.ZstdCompressor(write_checksum=True, **ways).compress(data)


@pytest.mark.parametrize(
    "content",
    [
        frame(TEXT[:700]) + frame(TEXT[700:]),
        frame(TEXT[:90]) + frame(TEXT[90:91]) + frame(TEXT[91:], write_content_size=False),
        frame(TEXT[:700]) + SKIPPED + frame(TEXT[700:]),
        SKIPPED + frame(TEXT),
        SKIPPED + SKIPPED + frame(TEXT[:5]) + frame(TEXT[5:]) + SKIPPED,
    ],
)
def test_all_frames_of_zstd_are_read(tmp_path, content):
    (tmp_path / "log.csv.zst").write_bytes(content)
    assert packed.unpack(tmp_path / "log.csv.zst").file.read_bytes() == TEXT
    assert "tip_x" in guess_mapping([tmp_path / "log.csv.zst"]).text


def sized(content, change):
    """A frame that states another size of its content; the test data have one of two bytes."""
    assert content[4] >> 5 == 0b011
    size = int.from_bytes(content[5:7], "little") + change
    return content[:5] + size.to_bytes(2, "little") + content[7:]


@pytest.mark.parametrize(
    "content",
    [
        frame(TEXT) + b"garbage",
        frame(TEXT) + b"\0" * 20,
        frame(TEXT) + frame(TEXT)[:9],
        frame(TEXT)[:-1],
        sized(frame(TEXT), 1),
        sized(frame(TEXT), -1),
        frame(TEXT)[:-1] + bytes([frame(TEXT)[-1] ^ 1]),
        frame(TEXT) + SKIPPED[:9],
    ],
)
def test_a_tail_or_a_size_that_does_not_fit_is_reported(tmp_path, content):
    (tmp_path / "log.csv.zst").write_bytes(content)
    assert "is a damaged packed file" in stopped(tmp_path / "log.csv.zst")


@pytest.mark.parametrize("content", [b"", b"1,2\n"])
def test_frames_without_end_are_stopped(tmp_path, content):
    began = time.monotonic()
    (tmp_path / "log.csv.zst").write_bytes(frame(LINE) + frame(content) * 200_000)
    assert "more than 10000 frames" in stopped(tmp_path / "log.csv.zst")
    assert time.monotonic() - began < 30  # 65 s and more without the limit
