"""Lines below a table are found and counted; a file that ends within its last cell is a *look at*
line.
"""

import pytest
from bench_rows import NAMES, rows

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

HEAD = ",".join(NAMES)


def log(folder, text):
    (folder / "log.csv").write_bytes(text.encode())
    return folder / "log.csv"


def read(found, path):
    return import_logs([path], parse_mapping(found.text, path))


# --- lines below the table --------------------------------------------------------------------
BELOW = {
    "two lines": ["End of data", "Total rows,60"],
    "a mean": ["Mean" + ",0.0" * (len(NAMES) - 1)],
    "statistics": [f"{word}" + ",1.5" * (len(NAMES) - 1) for word in ("Min", "Max", "Std")],
    "a blank line between": ["", "Log closed", "reason: user"],
    "a line of one word": ["EOF"],
    "cells of keys": ["Operator,Smith", "Firmware,2.1.7", "Rows,60"],
}


@pytest.mark.parametrize("kind", BELOW)
@pytest.mark.parametrize("end", ["\n", "", "\r\n\r\n"])
def test_lines_below_the_table_are_left_out_by_the_proposal(tmp_path, kind, end):
    path = log(tmp_path, "\n".join([HEAD, *rows(60), *BELOW[kind]]) + end)
    found = guess_mapping([path])
    count = sum(1 for line in BELOW[kind] if line)
    assert f"skip_last_rows = {count} " in found.text
    done = read(found, path)
    assert len(done.run.t) == 60 and not any("cut" in doubt for doubt in done.doubts)


@pytest.mark.parametrize("kind", BELOW)
def test_the_error_gives_the_number(tmp_path, kind):
    path = log(tmp_path, "\n".join([HEAD, *rows(60)]) + "\n")
    mapping = guess_mapping([path]).text
    path = log(tmp_path, "\n".join([HEAD, *rows(60), *BELOW[kind]]) + "\n")
    count = sum(1 for line in BELOW[kind] if line)
    if kind in ("a mean", "statistics"):  # their labels say what they are
        done = import_logs([path], parse_mapping(mapping, path))
        assert len(done.run.t) == 60 and f"were left out: {count} (line 62" in done.notes[0]
        return
    with pytest.raises(RunError, match=f"set skip_last_rows = {count}"):
        import_logs([path], parse_mapping(mapping, path))


@pytest.mark.parametrize("tail", [[], ["# closed"], ["", ""]])
def test_a_table_that_ends_with_its_rows_loses_none(tmp_path, tail):
    path = log(tmp_path, "\n".join([HEAD, *rows(60), *tail]) + "\n")
    found = guess_mapping([path])
    assert "skip_last_rows" not in found.text and len(read(found, path).run.t) == 60


def test_words_of_a_tracker_in_the_last_rows_are_rows(tmp_path):
    lines = rows(60)
    lines[-3:] = [",".join([*line.split(",")[:-3], "lost", "lost", "lost"]) for line in lines[-3:]]
    path = log(tmp_path, "\n".join([HEAD, *lines]) + "\n")
    found = guess_mapping([path])
    assert "skip_last_rows" not in found.text and len(read(found, path).run.t) == 60


def test_a_long_file_is_looked_at_from_its_end(tmp_path):
    path = log(tmp_path, "\n".join([HEAD, *rows(4000), "End of data", "Total rows,4000"]) + "\n")
    assert path.stat().st_size > 2**17
    found = guess_mapping([path])
    assert "skip_last_rows = 2 " in found.text and len(read(found, path).run.t) == 4000


def test_a_last_row_that_was_cut_is_left_out_by_the_proposal(tmp_path):
    lines = rows(60)
    path = log(tmp_path, "\n".join([HEAD, *lines[:-1], lines[-1][: len(lines[-1]) // 2]]))
    found = guess_mapping([path])
    assert "skip_last_rows = 1 " in found.text and len(read(found, path).run.t) == 59


# --- a file that ends within its last cell ------------------------------------------------------
def cut_doubts(folder, text):
    path = log(folder, text)
    found = guess_mapping([path])
    return [doubt for doubt in read(found, path).doubts if "may be cut" in doubt]


TEXT = "\n".join([HEAD, *rows(60)])


@pytest.mark.parametrize("cut", [1, 2, 3, 4])
def test_a_last_number_with_fewer_digits_is_a_look_at(tmp_path, cut):
    doubts = cut_doubts(tmp_path, TEXT[:-cut])
    assert len(doubts) == 1 and "line 61" in doubts[0] and "skip_last_rows = 1" in doubts[0]
    # a program that ends its lines was not cut within one
    assert not cut_doubts(tmp_path, TEXT[:-cut] + "\n")


@pytest.mark.parametrize("form", ["{:.5e}", "{:08.3f}"])
def test_any_form_of_numbers_shows_it(tmp_path, form):
    lines = [
        ",".join([*line.split(",")[:-1], form.format(float(line.split(",")[-1]))])
        for line in rows(60)
    ]
    assert cut_doubts(tmp_path, "\n".join([HEAD, *lines])[:-1]) and not cut_doubts(
        tmp_path, "\n".join([HEAD, *lines])
    )


def test_a_last_label_that_begins_another_is_a_look_at(tmp_path):
    lines = [f"{line},{'calibration' if k < 30 else 'circle'}" for k, line in enumerate(rows(60))]
    text = "\n".join([HEAD + ",phase", *lines])
    assert cut_doubts(tmp_path, text[:-2]) and not cut_doubts(tmp_path, text)


def test_decimal_commas_and_wide_text(tmp_path):
    text = "\n".join([HEAD.replace(",", ";"), *rows(60, cut=";", point=",")])
    assert cut_doubts(tmp_path, text[:-1]) and not cut_doubts(tmp_path, text)
    for end, cut in (("", True), ("\n", False)):
        (tmp_path / "wide.csv").write_bytes((TEXT[:-1] + end).encode("utf-16"))
        found = guess_mapping([tmp_path / "wide.csv"])
        assert any("may be cut" in said for said in found.said) == cut


def test_a_program_without_a_last_line_end_is_no_doubt(tmp_path):
    assert not cut_doubts(tmp_path, TEXT)
    free = [
        ",".join([*line.split(",")[:-1], repr(float(line.split(",")[-1]) / 3)]) for line in rows(60)
    ]
    free[-1] = ",".join([*free[-1].split(",")[:-1], "98.5"])  # as many digits as each number needs
    assert not cut_doubts(tmp_path, "\n".join([HEAD, *free]))
    assert not cut_doubts(tmp_path, "\n".join([HEAD, *rows(12)])[:-1])  # too few rows show a form


def test_a_row_that_is_left_out_is_no_doubt(tmp_path):
    path = log(tmp_path, TEXT[:-1])
    text = guess_mapping([path]).text.replace("[[log]]", "[[log]]\nskip_last_rows = 1")
    done = import_logs([path], parse_mapping(text, path))
    assert len(done.run.t) == 59 and not any("cut" in doubt for doubt in done.doubts)
