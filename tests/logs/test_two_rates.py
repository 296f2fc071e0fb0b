"""A rate in the head of a file that contradicts its time column is reported; no time is invented."""

import re
import struct

import numpy as np
import pytest
from bench_rows import NAMES, rows, write
from recordings import places, write_c3d, write_motive, write_trc

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping


def read(path):
    return import_logs([path], parse_mapping(guess_mapping([path]).text, path))


def rates(done):
    return [doubt for doubt in done.doubts if "the head states" in doubt and " Hz" in doubt]


def trc(folder, rate):
    path = write_trc(folder / "log.trc", *places())
    path.write_text(path.read_text().replace("100.00\t100.00", f"{rate}\t100.00"))
    return path


def motive(folder, rate, key="Capture Frame Rate"):
    t, points = places()
    path = write_motive(folder / "log.csv", t, 1e-3 * points)
    head = f"{key},{rate}" if key.startswith("Capture") else f"{key},{rate},Capture Frame Rate,50"
    path.write_text(path.read_text().replace("Capture Frame Rate,100.000000", head))
    return path


def qualisys(folder, rate):
    t, points = places()
    labels = ["a", "b", "c"]
    head = [f"NO_OF_FRAMES\t{len(t)}", f"FREQUENCY\t{rate}", "MARKER_NAMES\t" + "\t".join(labels)]
    head += ["Frame\tTime\t" + "\t".join(f"{one} {x}" for one in labels for x in "XYZ")]
    lines = [
        "\t".join([str(k + 1), f"{t[k]:.5f}", *(f"{x:.3f}" for x in points[k].ravel())])
        for k in range(len(t))
    ]
    return write(folder / "log.tsv", head, lines)


def plain(folder, rate):
    lines = rows(60, time=lambda k: f"{0.01 * k:.2f}")
    return write(folder / "log.csv", f"# Sample rate: {rate} Hz", ",".join(NAMES), lines)


def long(folder, rate):
    lines = [
        f"{0.01 * k:.2f},m{m},{np.sin(k / 9):.3f},{m + np.cos(k / 7):.3f},{40 * m + 20}.5,{k % 9}"
        for k in range(60)
        for m in range(3)
    ]
    head = "t,marker,x,y,z,cmd_1"
    return write(folder / "log.csv", f"# Sample rate: {rate} Hz", head, lines)


MAKERS = [trc, motive, lambda f, r: motive(f, r, "Export Frame Rate"), qualisys, plain, long]


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize(("rate", "apart"), [(120, "-17 %"), (50, "+100 %")])
def test_the_time_column_is_followed_and_the_difference_is_reported(tmp_path, make, rate, apart):
    done = read(make(tmp_path, rate))
    said = rates(done)
    assert len(said) == 1 and f"{rate} Hz" in said[0] and apart in said[0]
    assert "the time is followed" in said[0] and f"rate_hz = {rate}" in said[0]
    assert np.diff(done.run.t_seen) == pytest.approx(0.01)


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("rate", [100, 100.5])
def test_equal_rates_are_no_doubt(tmp_path, make, rate):
    assert not rates(read(make(tmp_path, rate)))


def test_rounded_stamps_and_gaps_are_no_other_rate(tmp_path):
    t, points = places(rate=240.0)
    kept = np.r_[0:20, 30:60]
    path = write_trc(tmp_path / "log.trc", t[kept], points[kept])
    found = re.sub(r"(?m)^(\d+\t\d\.\d{3})\d+\t", r"\1\t", path.read_text())  # in ms
    path.write_text(found)
    assert not rates(read(path))


@pytest.mark.parametrize("rate", [120.0, 50.0, 200.0])
def test_a_c3d_file_with_two_rates_is_refused(tmp_path, rate):
    pytest.importorskip("c3d")
    path = write_c3d(tmp_path / "log.c3d", *places())
    assert any("frames at 100 Hz" in note for note in read(path).notes)
    data = bytearray(path.read_bytes())
    assert struct.unpack_from("<f", data, 20)[0] == pytest.approx(100.0)
    struct.pack_into("<f", data, 20, rate)
    path.write_bytes(data)
    with pytest.raises(RunError, match=rf"header states {rate:g} frames .* POINT:RATE 100"):
        read(path)
