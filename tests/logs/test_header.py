"""Where the table of a text log begins: lines above the names, units, groups, rows without names,
ragged ends.
"""

import time

import numpy as np
import pytest
from bench_rows import NAMES, STEP, rows, values, write

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.table import open_log

HEAD = ",".join(NAMES)
TABBED = [name + ", mm" for name in NAMES]
ABOVE = {
    "nothing": ([HEAD], {}),
    "a logger's remarks": (
        [
            "my logger started on:,2031-5-7_101500",
            "ctrl:,{'n': 2, 'u0': [1000., 1000.], 'sep': ';'}",
            HEAD,
        ],
        {},
    ),
    "a table of settings": (["name,value", "mass,3", "length,90", "", HEAD], {}),
    "a title as wide as the names": (["Report,of,the,bench,number,3", HEAD], {}),
    "settings of one width with names": (["0.02,3,5,1,2,2", "5,7,8,8,1,2", HEAD], {}),
    "units that are known": ([HEAD, "s,mm,mm,mm,mm,mm"], {}),
    "units that are not": ([HEAD, "s,N/mm,N/mm,pix,pix,pix"], {}),
    "types": ([HEAD, "double,double,double,double,double,double"], {}),
    "a spreadsheet": (
        ["sep=;", "Versuch 3; Datum 07.05.2031", ";;;;;", ";".join(NAMES)],
        {"cut": ";", "point": ","},
    ),
    "tabs and commas in names": (["\t".join(TABBED)], {"cut": "\t"}),
    "tabs and decimal commas": (["Messung\t7", "\t".join(NAMES)], {"cut": "\t", "point": ","}),
    "a comment": (["# bench 3", "# " + HEAD], {}),
    "a comment and units": (["# " + HEAD, "s,mm,mm,mm,mm,mm"], {}),
    "the echo of a topic": (["%" + HEAD], {}),
    "blank lines": (["", "bench", "", HEAD, ""], {}),
}


@pytest.mark.parametrize("kind", ABOVE)
def test_the_names_are_the_last_text_above_the_rows(tmp_path, kind):
    head, form = ABOVE[kind]
    path = write(tmp_path / "log.csv", head, rows(**form))
    columns = open_log(path)
    assert columns.names == (TABBED if kind == "tabs and commas in names" else NAMES)
    numbers = columns.read(list(range(6))).numbers
    assert numbers[:, 1:] == pytest.approx(np.array([values(k) for k in range(40)]), abs=6e-4)
    run = import_logs([path], parse_mapping(guess_mapping([path]).text, path)).run
    assert (run.channels, run.frames) == (2, 40) and run.t == pytest.approx(STEP * np.arange(40))


def test_lines_that_are_passed_over_are_counted(tmp_path):
    path = write(tmp_path / "log.csv", ABOVE["a logger's remarks"][0], rows())
    assert "lines above the table were skipped: 2" in open_log(path).notes
    assert open_log(write(path, HEAD, rows())).notes == ()


@pytest.mark.parametrize(
    ("head", "tail"),
    [
        (HEAD, lambda k: ",,"),
        (HEAD + ",,", lambda k: ",,"),
        (HEAD, lambda k: "," * (k % 3)),
        (HEAD + ",Comment", lambda k: ""),
        (HEAD + ",Comment", lambda k: ",started" if k == 4 else ""),
        (HEAD + ",a,b", lambda k: "" if k % 4 else ",7,8"),
    ],
)
def test_ragged_ends(tmp_path, head, tail):
    path = write(tmp_path / "log.csv", "run log of bench 3", "bench,limbs", "0.02,3,", head)
    with path.open("a") as file:
        file.writelines(line + tail(k) + "\n" for k, line in enumerate(rows(60)))
    numbers = open_log(path).read(list(range(6))).numbers
    assert numbers.shape == (60, 6) and np.isfinite(numbers).all()
    run = import_logs([path], parse_mapping(guess_mapping([path]).text, path)).run
    assert (run.channels, run.frames) == (2, 60)


def test_one_row_that_is_cut_is_not_filled_up(tmp_path):
    lines = rows(60)
    for cut, line in ((30, 32), (59, 61)):
        path = write(tmp_path / "log.csv", HEAD, [*lines[:cut], lines[cut][:-8], *lines[cut + 1 :]])
        with pytest.raises(
            RunError, match=f"line {line} has 5 cells, expected 6; the file may be cut short"
        ):
            open_log(path).read(list(range(6)))
    path = write(tmp_path / "log.csv", HEAD, [*lines[:30], lines[30] + ",7", *lines[31:]])
    with pytest.raises(
        RunError, match="line 32 has 7 cells, expected 6; cells of the line are not named"
    ):
        open_log(path).read(list(range(6)))


def test_names_over_several_columns_stand_in_front(tmp_path):
    for above, below in (
        (",drive,,tip,,", "time,cmd_1,cmd_2,x,y,z"),
        (",drive,drive,tip,tip,tip", "time,cmd_1,cmd_2,x,y,z"),
        ("log,drive,drive,tip,tip,tip", "time,cmd_1,cmd_1,x,y,z"),
    ):
        names = open_log(write(tmp_path / "log.csv", above, below, rows())).names
        assert names[3:] == ["tip.x", "tip.y", "tip.z"] and names[1] == "drive.cmd_1"
    title = open_log(write(tmp_path / "log.csv", "bench 3", "time,a,a,x,y,z", rows()))
    assert title.names == ["time", "a", "a", "x", "y", "z"]


# --- rows without names --------------------------------------------------------------------
def test_a_row_is_never_taken_for_names(tmp_path):
    """The case: a word in each row made the first row look like names."""
    lines = [
        f"1900000000,{50_000_000 * k},world," + ",".join(rows(1, first=k)[0].split(",")[3:])
        for k in range(18)
    ]
    path = write(tmp_path / "log.csv", [line + ",0.0,0.0,0.0,1.0" for line in lines])
    columns = open_log(path)
    assert columns.names == list("0123456789") and len(columns.read([3]).numbers) == 18
    mapping = 'schema = "softmap.mapping/1"\n[[log]]\ntime = { rate_hz = 20 }\nmarkers = { columns = ["x", "y", "z"] }'
    with pytest.raises(
        RunError, match=r"line 1 looks like a row.*9 of 10 cells are numbers.*header = false"
    ):
        import_logs([path], parse_mapping(mapping, path))
    found = guess_mapping([path])
    assert "header = false" in found.text and "[3, 4, 5]" in found.text
    run = import_logs([path], parse_mapping(found.text, path)).run
    assert run.frames == 18 and run.t == pytest.approx(STEP * np.arange(18))


@pytest.mark.parametrize(
    ("first", "names"),
    [
        (["time,1,2,3,4,5"], ["time", "1", "2", "3", "4", "5"]),  # numbers of channels as names
        (["0,1,2,3,4,5"], list("012345")),  # as pandas writes them
        ([], list("012345")),
        (["bench 3", "made by hand"], list("012345")),
    ],
)
def test_rows_below_names_that_are_numbers_or_none(tmp_path, first, names):
    columns = open_log(write(tmp_path / "log.csv", first, rows()))
    assert columns.names == names and columns.read([0]).numbers[0, 0] == 0.0
    assert len(columns.read([1]).numbers) == 40


def test_where_no_line_fits_the_rows_the_message_says_where_they_begin(tmp_path):
    indexed = [f"{k}," + line for k, line in enumerate(rows())]  # a name is missing, as R writes it
    path = write(tmp_path / "log.csv", "bench", HEAD, indexed)
    with pytest.raises(RunError) as fault:
        guess_mapping([path])
    assert "differ in width (1, 6, 7)" in str(
        fault.value
    ) and "begin in line 3: set skip_rows = 2" in str(fault.value)
    mapping = (
        'schema = "softmap.mapping/1"\n[[log]]\nskip_rows = 2\nheader = false\ntime = { column = '
        "1 }\n"
        "markers = { columns = [4, 5, 6] }"
    )
    # the remedy leads out
    assert import_logs([path], parse_mapping(mapping, path)).run.frames == 40


# --- limits --------------------------------------------------------------------------------
def test_the_search_ends_early_however_long_the_file(tmp_path):
    path = write(tmp_path / "log.csv", "bench", HEAD, rows(100_000))
    began = time.process_time()
    assert open_log(path).names == NAMES
    assert time.process_time() - began < 1.5  # 0.2 s; all 100 000 lines take 5 s


@pytest.mark.parametrize(
    "line",
    ["a," * 40_000, "1," * 40_000, "1:" * 40_000, "1 " * 40_000, "'" * 90_000, '"1,' * 9_000],
)
def test_odd_heads_take_no_time(tmp_path, line):
    path = write(tmp_path / "log.csv", *[line] * 20)
    began = time.process_time()
    try:
        open_log(path)
    except RunError as fault:
        assert "\n" not in str(fault) and len(str(fault)) < 800
    assert time.process_time() - began < 10


REMARKS = {
    "comments": ["# remark"] * 1100,
    "percent marks": ["% remark", "%"] * 700,
    "blank lines": [""] * 1500,
    "a title and comments": ["bench 3", *["# remark", ""] * 600],
}


@pytest.mark.parametrize("kind", REMARKS)
def test_remarks_do_not_count_among_the_lines_searched(tmp_path, kind):
    path = write(tmp_path / "log.csv", REMARKS[kind], HEAD, rows())
    assert open_log(path).names == NAMES and len(open_log(path).read([0]).numbers) == 40


@pytest.mark.parametrize("remark", ["# " + "a" * 98, "%" + "b" * 400, " " * 200])
def test_more_remarks_than_are_searched_name_the_way_out(tmp_path, remark):
    path = write(tmp_path / "log.csv", [remark] * 12_000, HEAD, rows())
    with pytest.raises(RunError, match="12000 lines above line 12001 .* skip_rows = 11999 "):
        open_log(path)
    mapping = (
        'schema = "softmap.mapping/1"\n[[log]]\nskip_rows = 11999\ntime = { column = "time" }\n'
        'markers = { columns = ["tip_x", "tip_y", "tip_z"] }'
    )
    assert import_logs([path], parse_mapping(mapping, path)).run.frames == 40


@pytest.mark.parametrize("line", ["," * 1_000_000, "1.5;" * 60_000, "1\t" * 50_001, "1 " * 50_001])
def test_too_many_columns_are_an_error_before_the_work(tmp_path, line):
    path = write(tmp_path / "log.csv", "bench", *[line] * 30)
    began = time.process_time()
    with pytest.raises(RunError, match=r"line 2 has \d+ columns, at most 50000 are read"):
        guess_mapping([path])
    assert time.process_time() - began < 3


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("quote", ["", '"'])
@pytest.mark.parametrize("every", [3, 50, 90])
def test_a_head_that_is_repeated_hides_no_column_from_a_proposal(delimiter, quote, every, tmp_path):
    head = delimiter.join(
        f"{quote}{name}{quote}" for name in ("time_s", "cmd_0", "cmd_1", "x", "y", "z")
    )
    lines = [head]
    for k in range(200):
        if k and k % every == 0:
            lines.append(head)
        numbers = [
            k / 20,
            5 * np.sin(k / 9),
            4 * np.cos(k / 7),
            np.sin(k / 9) * 9,
            k % 3,
            90 + k / 50,
        ]
        lines.append(delimiter.join(f"{x:.4f}" for x in numbers))
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    found = guess_mapping([tmp_path / "log.csv"])
    assert 'command = { columns = ["cmd_0", "cmd_1"]' in found.text
    assert any("lines that repeat the head" in line for line in found.said)
