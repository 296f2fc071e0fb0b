"""CSV logs as they really are: delimiters, decimals, headers or none, empty and cut rows, doubled
times, many rows.
"""

import numpy as np
import pytest
from logs import ONE_LOG, fault, imported, made_log

from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.logs.table import open_log


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_delimiters_and_line_ends_are_found(tmp_path, delimiter, newline):
    text, table = made_log(delimiter=delimiter)
    (tmp_path / "log.csv").write_bytes(b"\xef\xbb\xbf" + text.replace("\n", newline).encode())
    (tmp_path / "map.toml").write_text(ONE_LOG)
    run = import_logs([tmp_path / "log.csv"], read_mapping(tmp_path / "map.toml")).run
    assert np.array_equal(run.command, table[:, 1:3])


def test_decimal_commas_and_columns_by_number(tmp_path):
    text, table = made_log(delimiter=";")
    mapping = ONE_LOG.replace("[[log]]", '[[log]]\ndecimal = ","\ndelimiter = ";"')
    assert np.array_equal(
        imported(tmp_path, text.replace(".", ","), mapping).run.command, table[:, 1:3]
    )
    numbered = (
        ONE_LOG.replace("[[log]]", "[[log]]\nheader = false")
        .replace('"t"', "0")
        .replace('["a", "b"]', "[1, 2]")
    )
    numbered = numbered.replace('[["x", "y", "z"], ["p", "q", "r"]]', "[3, 4, 5, 6, 7, 8]")
    bare = text.replace(";", ",").split("\n", 1)[1]
    assert np.array_equal(imported(tmp_path, bare, numbered).run.command, table[:, 1:3])


# --- faults --------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.replace("t,a,b", "t,a,c"), ["log.csv: no column b", "there are t, a, c"]),
        (lambda s: s.split("\n", 1)[1], ["has no header line", "header = false"]),
        (lambda s: s[:-30], ["line 21 has", "expected 9", "skip_last_rows"]),
        (lambda s: s.split("\n")[0], ["holds no rows"]),
        (lambda s: "", ["holds no lines"]),
        (lambda s: s.replace("\n0.1,", "\noops,", 1), ["line 3, column t: 'oops' is not a number"]),
        (lambda s: s.replace("\n0.1,", "\n0_1,", 1), ["line 3, column t: '0_1' is not a number"]),
        (lambda s: s.replace("\n0.1,", "\n,", 1), ["line 3: the time is empty"]),
        (lambda s: s.replace("\n0.5,", "\n0.1,", 1), ["time goes backwards at row 5"]),
        (lambda s: s.replace("\n0.5,", "\n0.4,", 1), ["time stands still at row 5"]),
        (lambda s: s.replace("0.", "\0"), ["zero bytes"]),
        (lambda s: b"PK\3\4\0\xff\xfe", ["is a damaged archive", "copy it again"]),
    ],
)
def test_faults_of_a_log(tmp_path, change, words):
    text, _ = made_log()
    message = fault(tmp_path, change(text))
    for word in words:
        assert word in message


def test_a_row_written_twice_is_one_row(tmp_path):
    text, table = made_log()
    lines = text.splitlines()
    done = imported(tmp_path, "\n".join([*lines[:6], lines[5], lines[5], *lines[6:]]))
    assert np.array_equal(done.run.command, table[:, 1:3]) and any(
        "2 rows that repeat" in note for note in done.notes
    )


def test_times_of_a_coarse_clock_can_be_spread(tmp_path):
    """Four rows a stamp, as a logger writes that empties its buffer."""
    text, table = made_log(rows=40)
    lines = text.splitlines()
    stamped = [
        lines[0],
        *(f"{0.4 * (k // 4):.1f},{line.split(',', 1)[1]}" for k, line in enumerate(lines[1:])),
    ]
    assert (
        '"spread"' in (message := fault(tmp_path, "\n".join(stamped))) and '"drop"' not in message
    )
    spread = ONE_LOG.replace('column = "t"', 'column = "t", repeated = "spread"')
    done = imported(tmp_path, "\n".join(stamped), spread)
    run = done.run
    assert any("30 of 40 rows share a time" in doubt for doubt in done.doubts)
    assert run.t == pytest.approx(table[:, 0]) and np.array_equal(run.command, table[:, 1:3])


def test_repeated_times_can_be_dropped(tmp_path):
    text, table = made_log()
    doubled = text.replace("\n0.5,", "\n0.4,", 1)
    run = imported(
        tmp_path, doubled, ONE_LOG.replace('column = "t"', 'column = "t", repeated = "drop"')
    ).run
    assert len(run.t) == 19 and np.array_equal(run.command[5], table[6, 1:3])


def test_rows_can_be_skipped_at_both_ends(tmp_path):
    text, table = made_log()
    mapping = ONE_LOG.replace("[[log]]", "[[log]]\nskip_rows = 2\nskip_last_rows = 1")
    run = imported(tmp_path, "recorded on a bench\n# units: s mm m\n" + text + "0.7,1", mapping).run
    assert np.array_equal(run.command, table[:, 1:3])


def test_the_wrong_delimiter_is_recognised(tmp_path):
    text, _ = made_log(delimiter=";")
    message = fault(tmp_path, text, ONE_LOG.replace("[[log]]", '[[log]]\ndelimiter = ","'))
    assert "cut by ';'" in message
    message = fault(
        tmp_path, text.replace(".", ","), ONE_LOG.replace("[[log]]", '[[log]]\ndecimal = "."')
    )
    assert 'decimal = ","' in message


def test_decimal_commas_are_found(tmp_path):
    for mark in (";", "\t"):
        text, table = made_log(delimiter=mark)
        done = imported(tmp_path, text.replace(".", ","))
        assert np.array_equal(done.run.command, table[:, 1:3]) and any(
            "decimal commas" in note for note in done.notes
        )


@pytest.mark.parametrize("cut", [";", "\t", " ", "|"])
def test_decimal_commas_are_no_delimiter_where_a_header_is_missing(tmp_path, cut):
    """Nine numbers have nine commas and eight semicolons."""
    rows = [[0.1 * k, 0.5 * k, -2.5, 7.25 * k, 1e-3 * k] for k in range(12)]
    text = "".join(cut.join(f"{x:.4f}".replace(".", ",") for x in row) + "\n" for row in rows)
    path = tmp_path / "log.csv"
    path.write_text(text)
    found = open_log(path)
    assert found.names == list("01234")
    np.testing.assert_allclose(found.read([0, 1, 2, 3, 4]).numbers, np.round(rows, 4))


def test_columns_between_spaces(tmp_path):
    """As numpy writes them: padded, the header a comment."""
    text, table = made_log(delimiter="   ")
    head, body = text.split("\n", 1)
    for above in (head, f"# {head}", f"# a bench\n#  {head}"):
        assert np.array_equal(imported(tmp_path, f"{above}\n{body}").run.command, table[:, 1:3])


def test_comments_above_the_header_and_units_below_it(tmp_path):
    text, table = made_log()
    lines = text.splitlines()
    done = imported(
        tmp_path,
        "\n".join(["# a bench", "", "% of ours", lines[0], "s,mm,mm" + ",m" * 6, *lines[1:]]),
    )
    assert np.array_equal(done.run.command, table[:, 1:3]) and any(
        "units" in note for note in done.notes
    )


def test_a_comma_at_the_end_of_each_row(tmp_path):
    text, table = made_log()
    lines = text.splitlines()
    run = imported(tmp_path, "\n".join([lines[0], *(line + "," for line in lines[1:])])).run
    assert np.array_equal(run.command, table[:, 1:3])


def test_blank_and_empty_rows_are_left_out(tmp_path):
    text, table = made_log()
    lines = text.splitlines()
    lines[4:4] = ["", "   "]
    lines[9:9] = ["," * 8]
    done = imported(tmp_path, "\n".join(lines) + "\n\n")
    assert np.array_equal(done.run.t, table[:, 0])
    assert any("2 blank lines" in n for n in done.notes) and any(
        "1 empty rows" in n for n in done.notes
    )
    broken = [*lines[:-1], "oops," + lines[-1].split(",", 1)[1]]
    # lines are the file's own
    assert "line 24, column t: 'oops'" in fault(tmp_path, "\n".join(broken))


def test_missing_rows_are_counted(tmp_path):
    text, _ = made_log(rows=60)
    lines = text.splitlines()
    done = imported(tmp_path, "\n".join(lines[:20] + lines[25:40] + lines[41:]))
    assert any(
        "6 rows are missing in 2 gaps" in n and "0.6 s after line 20" in n for n in done.notes
    )
    assert not any("missing" in note for note in imported(tmp_path, text).notes)


def test_cells_without_a_value(tmp_path):
    """Two rates in one file: rows without command are no command rows, an encoder between its
    values is on the line.
    """
    text, table = made_log(rows=41)
    lines = [line.split(",") for line in text.splitlines()]
    for k, row in enumerate(lines[1:]):
        row[1] = row[1] if k % 2 == 0 else ""
        row[2] = row[2] if k % 4 == 0 else ""
        row[3:] = row[3:] if k % 5 == 0 else [""] * 6
    mapping = ONE_LOG.replace('["a", "b"] }', '["a"] }\npresent = { columns = ["b"] }')
    done = imported(tmp_path, "\n".join(map(",".join, lines)), mapping)
    assert np.array_equal(done.run.t, table[::2, 0]) and np.array_equal(
        done.run.command[:, 0], table[::2, 1]
    )
    assert done.run.present[::2, 0] == pytest.approx(table[::4, 2])
    assert done.run.present[1, 0] == pytest.approx(table[[0, 4], 2].mean())
    assert np.array_equal(done.run.t_seen, table[::5, 0]) and done.run.visible is None
    assert any("20 of 41 rows have no command" in n for n in done.notes) and any(
        "show no marker" in n for n in done.notes
    )
    for row in lines[1:]:
        row[2] = ""
    assert "present: its column 1 holds no value" in fault(
        tmp_path, "\n".join(map(",".join, lines)), mapping
    )


def test_two_columns_of_one_name_are_not_guessed(tmp_path):
    text, table = made_log()
    mapping = ONE_LOG.replace('"b"', '"a"')
    assert "columns 1 and 2 are all called 'a'" in fault(
        tmp_path, text.replace("t,a,b", "t,a,a", 1), mapping
    )
    numbered = ONE_LOG.replace('["a", "b"]', "[1, 2]")
    assert np.array_equal(
        imported(tmp_path, text.replace("t,a,b", "t,a,a", 1), numbered).run.command, table[:, 1:3]
    )


@pytest.mark.long
def test_many_rows_take_little_memory(tmp_path):
    """100 000 rows of 17 columns in a process of its own; `python -m benches.import_rows` does a
    million.
    """
    from benches.import_rows import measure, write_log

    write_log(tmp_path, 100_000)
    _, seconds, megabytes, rows = measure(tmp_path)
    assert rows == 100_000 and seconds < 10.0  # of work
    # of the process, 35 MB of them the interpreter and numpy; the log is 16 MB
    assert megabytes < 150.0
