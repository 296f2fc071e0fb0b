"""Rows that hold the mean, the spread or the sum of a table are not rows of the run."""

import numpy as np
import pytest
from bench_rows import NAMES, rows, write

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

COUNT = 43
ROWS = rows(COUNT)
TABLE = np.array([[float(cell) for cell in line.split(",")] for line in ROWS])
STATISTICS = {
    "Mean": TABLE.mean(axis=0),
    "Average": TABLE.mean(axis=0),
    "SD": TABLE.std(axis=0, ddof=1),
    "Std Dev": TABLE.std(axis=0),
    "Min": TABLE.min(axis=0),
    "Maximum": TABLE.max(axis=0),
    "Total": TABLE.sum(axis=0),
    "Mittelwert": TABLE.mean(axis=0),
}


def cells(name):
    return [f"{number:.3f}" for number in STATISTICS[name]]


def labelled(name):
    """A row whose label stands in the column of the time."""
    return ",".join([name, *cells(name)[1:]])


def bare(name, time=True):
    return ",".join([cells(name)[0] if time else "", *cells(name)[1:]])


def by_hand(path):
    """The mapping of the table without a summary, which has no `skip_last_rows`."""
    return guess_mapping([write(path.with_name("plain.csv"), ",".join(NAMES), ROWS)]).text


def assert_plain(done):
    expected = np.delete(TABLE, 0, axis=1)
    assert done.run.t == pytest.approx(TABLE[:, 0])
    assert done.run.command == pytest.approx(expected[:, :2])
    assert done.run.frames == COUNT


@pytest.mark.parametrize(
    ("above", "below"),
    [
        ([], ["Mean"]),
        ([], ["Mean", "SD", "Min", "Maximum"]),
        (["Average"], []),
        (["Mittelwert", "Std Dev"], []),
        (["Min", "Maximum"], ["Total"]),
    ],
)
@pytest.mark.parametrize("text", [labelled, lambda name: f'"{labelled(name)}"'.replace(",", '","')])
def test_a_row_with_a_label_is_set_aside(tmp_path, above, below, text):
    lines = [*map(text, above), *ROWS, *map(text, below)]
    path = write(tmp_path / "log.csv", ",".join(NAMES), lines)
    done = import_logs([path], parse_mapping(by_hand(path), path))
    assert_plain(done)
    count = len(above) + len(below)
    assert any(
        f"label of a summary, such as Mean, were left out: {count} (" in n for n in done.notes
    )
    guess = guess_mapping([path])
    assert_plain(import_logs([path], parse_mapping(guess.text, path)))
    assert "skip_last_rows" in guess.text or any("label of a summary" in n for n in guess.said)


@pytest.mark.parametrize(
    ("above", "below"),
    [
        ([], [bare("Mean")]),
        ([], [bare("Mean", time=False)]),
        ([bare("Average", time=False)], []),
        ([], [bare("Mean"), bare("SD"), bare("Min"), bare("Maximum"), bare("Total")]),
        ([bare("Std Dev"), bare("Mean")], []),
    ],
)
def test_a_row_without_a_label_that_equals_the_mean_is_set_aside(tmp_path, above, below):
    path = write(tmp_path / "log.csv", ",".join(NAMES), [*above, *ROWS, *below])
    guess = guess_mapping([path])
    assert "jumps" not in guess.text
    done = import_logs([path], parse_mapping(guess.text, path))
    assert_plain(done)
    count = len(above) + len(below)
    assert any(f"{count} of {COUNT + count} rows hold the mean" in note for note in done.notes)


@pytest.mark.parametrize("part", ["25%", "50 %", "97.5%"])
@pytest.mark.parametrize("index", [False, True])
def test_a_description_by_pandas_is_set_aside(tmp_path, part, index):
    labels = ["Mean", "SD", "Min", part, "75%", "Maximum"]
    below = [",".join([label, *cells("Mean")[0 if index else 1 :]]) for label in labels]
    lines = [f"{k},{row}" if index else row for k, row in enumerate(ROWS)]
    head = ",".join(["", *NAMES] if index else NAMES)
    path = write(tmp_path / "log.csv", head, [*lines, *below])
    assert_plain(import_logs([path], parse_mapping(guess_mapping([path]).text, path)))


@pytest.mark.parametrize("lines", [["25%"], ["50%", "75%"], ["25%", "Mean"]])
def test_a_percentage_without_a_label_above_it_is_no_summary(tmp_path, lines):
    below = [",".join([label, *cells("Mean")[1:]]) for label in lines]
    path = write(tmp_path / "log.csv", ",".join(NAMES), [*ROWS, *below, *rows(9, first=COUNT)])
    with pytest.raises(RunError, match="'(25|50)%' is not a number"):
        import_logs([path], parse_mapping(by_hand(path), path))


def test_a_label_in_a_column_of_remarks_is_no_block(tmp_path):
    lines = [*(f"{line}," for line in ROWS), f"{bare('Mean')},Average"]
    path = write(tmp_path / "log.csv", ",".join([*NAMES, "note"]), lines)
    guess = guess_mapping([path])
    assert 'block = "' not in guess.text
    assert_plain(import_logs([path], parse_mapping(guess.text, path)))


def home(k):
    """A row in which all columns but the time have the values of their mean."""
    return f"{2.1 + 0.05 * k:.3f}," + ",".join(f"{number:.3f}" for number in STATISTICS["Mean"][1:])


@pytest.mark.parametrize(
    ("names", "lines"),
    [
        (NAMES, [*ROWS, home(1)]),  # a robot that comes to rest in its mean
        (NAMES, [f"{0.05 * k:.2f},{k},{k},{2 * k},{k},90" for k in range(40)]),  # one ramp
        (NAMES, [*ROWS[:20], *(f"{k},5.0,4.0,14.0,3.6,90.0" for k in range(2, 20))]),  # held
        (
            [*NAMES, "phase"],
            [f"{line},{'min' if k < 40 else 'max'}" for k, line in enumerate(ROWS)],
        ),
        (
            [*NAMES, "phase"],
            [f"{line},{'run' if k < 42 else 'Total'}" for k, line in enumerate(ROWS)],
        ),
        (NAMES[1:], [line.partition(",")[2] for line in [*ROWS[:41], ROWS[0]]]),  # no time
    ],
)
def test_rows_of_the_robot_are_kept(tmp_path, names, lines):
    path = write(tmp_path / "log.csv", ",".join(names), lines)
    text = guess_mapping([path]).text
    done = import_logs([path], parse_mapping(text, path))
    assert len(done.run.t) == len(lines)
    assert not any("summar" in note for note in done.notes)
