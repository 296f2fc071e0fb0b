"""Logs in Windows-1252 are read and reported; other bytes are refused with their line and place in
the file.
"""

import numpy as np
import pytest

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.table import open_log

ROWS = "".join(f"{k / 20},{np.sin(k / 9):.3f},{k % 7}\n" for k in range(50))
HEADS = {
    "degrees": ("t,Soll 1 [°],note\n", 1, "Soll 1 [°]"),
    "umlauts": ("Gerät,Prüfstand\nt,Führungsgröße_1,note\n", 1, "Führungsgröße_1"),
    "a quote of Windows": ("# operator\n# it’s ours\nt,cmd_1,note\n", 2, "cmd_1"),
    "french": ("essai n° 4\n\nt,consigne_é,note\n", 1, "consigne_é"),
}


@pytest.mark.parametrize("kind", HEADS)
def test_a_log_in_windows_1252_is_read_and_reported(tmp_path, kind):
    head, line, name = HEADS[kind]
    path = tmp_path / "log.csv"
    path.write_bytes((head + ROWS).encode("cp1252"))
    columns = open_log(path)
    assert columns.names[1] == name
    assert f"line {line} is not UTF-8; the file was read as Windows-1252 (latin-1)" in columns.notes
    found = guess_mapping([path])
    assert len(import_logs([path], parse_mapping(found.text, path)).run.t) == 50
    path.write_bytes((head + ROWS).encode("utf-8-sig"))
    assert open_log(path).names[1] == name and not any(
        "1252" in note for note in open_log(path).notes
    )


def test_a_byte_far_down_is_read_as_well(tmp_path):
    path = tmp_path / "log.csv"
    row = b"1.5,2.5,abcdefghijklmnopqrstuvwxyz\n"
    path.write_bytes(b"t,cmd_1,note\n" + row * 200_000 + "2,3,heiß\n".encode("cp1252"))
    assert any("line 200002 is not UTF-8" in note for note in open_log(path).notes)
    assert open_log(path).read([1]).numbers.shape == (200_001, 1)


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (b"t,u\n1,2\n2,\x81\x8d\n", 3),
        (b"t,u\n1,2\n" + bytes(range(128, 256)) * 20, 3),
        (b"t,u\n\xff\x01\x02,3\n", 2),
        ("время,команда\n1,2\n".encode("koi8-r"), 1),
    ],
)
def test_other_bytes_are_refused_with_their_line_and_place(tmp_path, data, line):
    (tmp_path / "log.csv").write_bytes(data)
    with pytest.raises(
        RunError, match=rf"line {line} \(byte \d+ of the file\) is not text in UTF-8.*iconv"
    ):
        open_log(tmp_path / "log.csv")
