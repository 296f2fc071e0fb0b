"""A table below thousands of lines of settings or messages is found; rows of numbers above it are
refused; a log without a table is named, with the key that states where it begins.
"""

import pytest
from bench_rows import NAMES, rows, write

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

HEAD = ",".join(NAMES)
PREAMBLES = {
    "messages": lambda k: f"session remark number {k} of the logger",
    "settings": lambda k: f"param_{k}: {k * 0.5}",
    "settings in cells": lambda k: f"param_{k},{k * 0.5}",
    "settings with several numbers": lambda k: f"gain {k} {k} {k} {k}",
    "messages with commas": lambda k: f"warning, motor {k} is hot, see page {k}, and stop",
    "long messages": lambda k: f"{k} " + "x" * 1000,
    "comments and settings": lambda k: f"# {k}" if k % 2 else f"p{k} = {k}",
}


@pytest.mark.parametrize("count", [60, 1500])
@pytest.mark.parametrize("make", list(PREAMBLES))
def test_a_table_far_below_is_found(tmp_path, make, count):
    preamble = [PREAMBLES[make](k) for k in range(1100)]
    path = write(tmp_path / "log.csv", preamble, HEAD, rows(count))
    text = guess_mapping([path]).text
    done = import_logs([path], parse_mapping(text, path))
    assert len(done.run.t) == count and done.run.command.shape[1] == 2
    lines = sum(not line.startswith("#") for line in preamble)
    assert any(f"lines above the table were skipped: {lines}" in note for note in done.notes)


def test_units_and_other_delimiters_far_below(tmp_path):
    preamble = [PREAMBLES["settings in cells"](k) for k in range(2500)]
    units = "\t".join(["s", "mm", "mm", "mm", "mm", "mm"])
    path = write(tmp_path / "log.tsv", preamble, HEAD.replace(",", "\t"), units, rows(200, "\t"))
    run = import_logs([path], parse_mapping(guess_mapping([path]).text, path)).run
    assert len(run.t) == 200


def test_a_fault_far_below_has_its_own_line(tmp_path):
    body = rows(300)
    body[100] = body[100].replace(",", ",12mm,", 1).rsplit(",", 1)[0]
    preamble = [PREAMBLES["messages"](k) for k in range(1500)]
    path = write(tmp_path / "log.csv", preamble, HEAD, body)
    with pytest.raises(RunError, match="line 1602"):
        import_logs([path], parse_mapping(MAP, path))


MAP = """schema = "softmap.mapping/1"
[[log]]
time = { column = "time" }
command = { columns = ["cmd_1", "cmd_2"] }
markers = { columns = [["tip_x", "tip_y", "tip_z"]] }
"""


@pytest.mark.parametrize("width", [3, 5, 12])
def test_rows_of_numbers_above_are_refused(tmp_path, width):
    other = [",".join(f"{k * 0.1:.1f}" for _ in range(width)) for k in range(1500)]
    path = write(tmp_path / "log.csv", other, HEAD, rows(3000))
    with pytest.raises(RunError, match="cut the log there|cells, expected"):
        import_logs([path], parse_mapping(MAP, path))


def test_a_log_without_a_table_is_named(tmp_path):
    path = write(tmp_path / "log.csv", [PREAMBLES["messages"](k) for k in range(5000)])
    with pytest.raises(RunError, match="hold no table, .* set skip_rows"):
        guess_mapping([path])


@pytest.mark.parametrize("footer", [2, 400])
def test_lines_below_a_long_table_do_not_move_it(tmp_path, footer):
    """Skipped lines at the end are settings or another table: the mapping leaves them out."""
    below = [f"{k},{k}.5,1" for k in range(footer)]
    path = write(tmp_path / "log.csv", HEAD, rows(2000), below)
    text = MAP.replace("[[log]]", f"[[log]]\nskip_last_rows = {footer}")
    assert len(import_logs([path], parse_mapping(text, path)).run.t) == 2000
