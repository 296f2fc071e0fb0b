"""A `file` of a mapping that fits none of the given files is an error."""

import pytest
from bench_rows import NAMES, rows, write

from softmap_edge.errors import RunError
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

LOG = """[[log]]
file = "FILE"
time = { column = "time" }
command = { columns = ["cmd_1", "cmd_2"] }
markers = { columns = [["tip_x", "tip_y", "tip_z"]] }
"""


def imported(folder, patterns, given):
    for k, name in enumerate(given):
        write(folder / name, [",".join(NAMES)], rows(first=40 * k))
    text = 'schema = "softmap.mapping/1"\n' + "".join(LOG.replace("FILE", p) for p in patterns)
    return import_logs([folder / name for name in given], parse_mapping(text, folder / "map.toml"))


@pytest.mark.parametrize(
    ("patterns", "given", "missing"),
    [
        (["other.csv"], ["log.csv"], "other.csv"),
        (["run_*.csv"], ["log.csv"], r"run_\*.csv"),
        (["log.txt"], ["log.csv"], "log.txt"),
        (["a.csv", "b.csv"], ["a.csv"], "b.csv"),
        (["a.csv", "b*", "c*"], ["a.csv", "b.csv"], r"c\*"),
    ],
)
def test_a_pattern_without_a_file_is_named_with_the_files(tmp_path, patterns, given, missing):
    with pytest.raises(RunError, match=f"log '{missing}': no given file fits") as fault:
        imported(tmp_path, patterns, given)
    assert f"(given: {', '.join(given)})" in str(fault.value)


@pytest.mark.parametrize(
    ("patterns", "given"),
    [(["log.csv"], ["log.csv"]), (["l*"], ["log.csv"]), (["a.csv", "b*"], ["a.csv", "b.csv"])],
)
def test_patterns_that_fit_are_read(tmp_path, patterns, given):
    assert imported(tmp_path, patterns, given).run.frames == 40 * len(given)
