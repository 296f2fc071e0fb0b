"""An archive that claims more numbers than a run may hold is refused before it is unpacked."""

import io
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest

from softmap_edge.errors import RunError
from softmap_edge.run.run import Run

MOST = 200_000  # numbers of a run, in place of the real limit
UNPACKED = 40 * MOST  # bytes of zeros; they deflate to a thousandth


def head(shape, kind, version=1):
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (117 - len(text)) + b"\n"
    size = struct.pack("<H" if version == 1 else "<I", len(text))
    return b"\x93NUMPY" + bytes((version, 0)) + size + text


def zeros(count=UNPACKED):
    return bytes(count)


ARRAYS = {
    "places that are there": [head((UNPACKED // 24, 1, 3), "<f8") + zeros()],
    "one byte each": [head((UNPACKED,), "|i1") + zeros()],
    "a few very long texts": [head((4,), f"<U{UNPACKED // 16}") + zeros()],
    "places of no bytes": [head((MOST + 1,), "<U0")],
    "a shape that does not fit": [head((10**9, 10**9), "<f8") + zeros()],
    "many arrays, each small enough": [head((MOST // 2,), "<f8", 2) + zeros(4 * MOST)] * 3,
    "no header at all": [zeros()],
    "a header without end": [b"\x93NUMPY\2\0" + struct.pack("<I", 2**31) + b" " * UNPACKED],
}


def archive(path, arrays):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name in ("t", "t_seen"):
            buffer = io.BytesIO()
            np.save(buffer, np.arange(9.0))
            file.writestr(f"{name}.npy", buffer.getvalue())
        for k, content in enumerate(arrays):
            file.writestr(f"field{k}.npy", content)
    return path


@pytest.fixture(autouse=True)
def low_limit(monkeypatch):
    monkeypatch.setattr("softmap_edge.run.run.MAX_NUMBERS", MOST)


@pytest.mark.parametrize("case", ARRAYS)
def test_too_many_numbers_are_refused_before_they_are_unpacked(case, tmp_path):
    path = archive(tmp_path / "run.npz", ARRAYS[case])
    tracemalloc.start()
    try:
        with pytest.raises(RunError, match=r"numbers, at most 2e\+05 are read; cut it into"):
            Run.load(path)
        assert tracemalloc.get_traced_memory()[1] < UNPACKED // 8
    finally:
        tracemalloc.stop()


def test_a_run_of_just_as_many_numbers_is_read(tmp_path):
    rows = MOST // 8
    t = np.arange(float(rows))
    Run(t=t, command=np.zeros((rows, 3)), t_seen=t[:9]).save(tmp_path / "run.npz")
    assert len(Run.load(tmp_path / "run.npz").t) == rows
