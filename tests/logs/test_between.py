"""A head that a logger writes again, and remarks between the rows, are left out with a note."""

import pytest
from bench_rows import NAMES, rows

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

HEAD = ",".join(NAMES)
ROWS = rows(90)


def read(folder, *lines, end="\n"):
    flat = [line for entry in lines for line in (entry if isinstance(entry, list) else [entry])]
    (folder / "log.csv").write_bytes((end.join(flat) + end).encode())
    found = guess_mapping([folder / "log.csv"])
    return import_logs([folder / "log.csv"], parse_mapping(found.text, folder))


UNITS = ",".join("s" if name == "time" else "mm" for name in NAMES)
QUOTED = ",".join(f'"{name}"' for name in NAMES)
AGAIN = {
    "once": ([HEAD], [HEAD], 1),
    "with units": ([HEAD, UNITS], [HEAD, UNITS], 2),
    "a comment": (["# " + HEAD], ["# " + HEAD], 1),
    "quoted": ([QUOTED], [QUOTED], 1),
    "quoted only once": ([QUOTED], [HEAD], 1),
    "with blanks": ([HEAD], [HEAD.replace(",", ", ")], 1),
    "a title above": (["Logger v2 started", HEAD], ["Logger v2 started", HEAD], 2),
}


@pytest.mark.parametrize("kind", AGAIN)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_head_that_is_written_again_is_left_out(tmp_path, kind, end):
    head, again, count = AGAIN[kind]
    done = read(tmp_path, head, ROWS[:40], again, ROWS[40:], end=end)
    first = len(head) + 41
    assert len(done.run.t) == 90
    assert any(
        f"repeat the head of the table were left out: {count} (line {first}" in note
        for note in done.notes
    )
    assert not any("blank" in note for note in done.notes)


def test_many_heads_are_counted(tmp_path):
    done = read(tmp_path, *[[HEAD, *ROWS[k : k + 10]] for k in range(0, 90, 10)])
    assert len(done.run.t) == 90 and any(
        "left out: 8 (line 12, 23, 34 and 5 more)" in note for note in done.notes
    )


def test_rows_keep_their_numbers(tmp_path):
    """An error after a repeated head names the line of the file."""
    bad = ",".join([*ROWS[60].split(",")[:-1], "12mm"])
    (tmp_path / "log.csv").write_text("\n".join([HEAD, *ROWS]))
    mapping = parse_mapping(guess_mapping([tmp_path / "log.csv"]).text, tmp_path)
    (tmp_path / "log.csv").write_text(
        "\n".join([HEAD, *ROWS[:40], HEAD, *ROWS[40:60], bad, *ROWS[61:]])
    )
    with pytest.raises(RunError, match="line 63, column tip_z: '12mm' is not a number"):
        import_logs([tmp_path / "log.csv"], mapping)


def test_names_in_another_order_are_an_error(tmp_path):
    other = ",".join([NAMES[0], NAMES[2], NAMES[1], *NAMES[3:]])
    with pytest.raises(
        RunError, match="line 42 names the columns again, in another order; cut the log there"
    ):
        read(tmp_path, HEAD, ROWS[:40], other, ROWS[40:])


@pytest.mark.parametrize(
    "remark", ["# marker 3 glued again", "% pause, 5 min", "#", "#event,start"]
)
def test_remarks_between_rows_are_left_out(tmp_path, remark):
    done = read(tmp_path, HEAD, ROWS[:40], remark, ROWS[40:])
    assert len(done.run.t) == 90 and any(
        "remarks between the rows were left out: 1 (line 42)" in n for n in done.notes
    )


def test_other_text_between_rows_stays_an_error(tmp_path):
    with pytest.raises(RunError, match="line 42 has 1 cells"):
        read(tmp_path, HEAD, ROWS[:40], "restarted", ROWS[40:])


def test_labels_that_begin_with_a_mark_are_rows(tmp_path):
    names = ",".join(["block", *NAMES])
    done = read(tmp_path, names, [f"#{k // 30},{line}" for k, line in enumerate(ROWS)])
    assert len(done.run.t) == 90 and not any("remarks" in note for note in done.notes)


# --- a head that differs ---------------------------------------------------------------------
SAME = {
    "a byte order mark": "\ufeff" + HEAD,
    "upper case": HEAD.upper(),
    "blanks": HEAD.replace(",", " , "),
    "a byte order mark, quoted": "\ufeff" + QUOTED.title(),
}
OTHER = {
    "a new last column": (HEAD + ",volts", lambda row: row + ",1.5", "with volts"),
    "a new first column": ("pc," + HEAD, lambda row: "7," + row, "with pc"),
    "a renamed column": (HEAD.replace("tip_z", "top_z"), str, "with top_z and without tip_z"),
    "a column less": (
        HEAD.rsplit(",", 1)[0],
        lambda row: row.rsplit(",", 1)[0],
        "without tip_z",
    ),
}


METRES = ",".join("s" if name == "time" else "m" for name in NAMES)
UNIT_ROWS = {
    "other units": ([HEAD, UNITS], [HEAD, METRES]),
    "units only in the second log": ([HEAD], [HEAD, UNITS]),
    "units in brackets": ([HEAD], [HEAD, METRES.replace("m", "[m]").replace("s", "[s]")]),
    "some cells are empty": ([HEAD, UNITS], [HEAD, METRES.replace("s,", ",", 1)]),
    "no names above": ([HEAD, UNITS], [METRES]),
}


@pytest.mark.parametrize("kind", UNIT_ROWS)
@pytest.mark.parametrize("cut", [25, 70])
def test_units_of_a_second_log_are_an_error_with_the_line(tmp_path, kind, cut):
    head, second = UNIT_ROWS[kind]
    line = len(head) + cut + len(second)
    with pytest.raises(RunError, match=f"line {line} gives units below rows.*cut the log there"):
        read(tmp_path, head, ROWS[:cut], second, ROWS[cut:])


@pytest.mark.parametrize("kind", SAME)
@pytest.mark.parametrize("cut", [25, 70])
def test_the_same_head_in_other_letters_is_left_out(tmp_path, kind, cut):
    done = read(tmp_path, HEAD, ROWS[:cut], SAME[kind], ROWS[cut:])
    assert len(done.run.t) == 90
    assert any(f"left out: 1 (line {cut + 2})" in note for note in done.notes)


@pytest.mark.parametrize("kind", OTHER)
@pytest.mark.parametrize("cut", [25, 70])
def test_another_head_is_an_error_with_the_line(tmp_path, kind, cut):
    head, change, words = OTHER[kind]
    said = f"line {cut + 2} names the columns again, {words}.*; cut the log there"
    with pytest.raises(RunError, match=said):
        read(tmp_path, HEAD, ROWS[:cut], head, list(map(change, ROWS[cut:])))


@pytest.mark.parametrize("cut", [25, 70])
def test_other_names_below_rows_are_an_error(tmp_path, cut):
    said = f"line {cut + 2} .*cut the log there|begins in line {cut + 2}; cut the log there"
    with pytest.raises(RunError, match=said):
        read(tmp_path, HEAD, ROWS[:cut], "a,b,c,d,e,f", ROWS[cut:])


@pytest.mark.parametrize("cut", [25, 70])
def test_rows_above_the_only_head_are_not_dropped(tmp_path, cut):
    with pytest.raises(RunError, match=f"line {cut + 1}.*cut the log there"):
        read(tmp_path, ROWS[:cut], HEAD, ROWS[cut:])
