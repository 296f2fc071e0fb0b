"""Words in columns of numbers: taken as missing, counted and named; a column of text stays a column
of text.
"""

import numpy as np
import pytest
from logs import ROOT, fault, imported, made_log

from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.logs.readers.words import is_word

CASE = ROOT / "tests" / "data" / "values" / "words.csv"


def with_words(cells):
    """A log in which cells {(row, column): word} hold words."""
    text, table = made_log()
    rows = [line.split(",") for line in text.splitlines()]
    for (row, column), word in cells.items():
        rows[row + 1][column] = word
    return "\n".join(map(",".join, rows)) + "\n", table


def test_the_case(tmp_path):
    found = guess_mapping([CASE])
    assert '["tip_x", "tip_y", "tip_z"]' in found.text
    for words in (
        ("tip_x '#N/A' in 5 of 40 rows", "tip_y '--' in 5 of 40 rows"),
        ("infinite", "tip_z 5"),
    ):
        assert any(all(word in line for word in words) for line in found.said)
    (tmp_path / "map.toml").write_text(found.text)
    done = import_logs([CASE], read_mapping(tmp_path / "map.toml"))
    assert done.run.frames == 35 and any(
        "5 of 40 rows show no marker" in note for note in done.notes
    )
    named = next(note for note in done.notes if "'#N/A'" in note)
    assert "first in line 2" in named


@pytest.mark.parametrize(
    "word",
    [
        "#N/A",
        "-",
        "--",
        "---",
        "lost",
        "LOST",
        "missing",
        "?",
        "*",
        "n.a.",
        "no data",
        "#DIV/0!",
        "#VALUE!",
        "1.#QNAN",
    ]
    + ["-1.#IND", "nan(0x8000)", "NaN(ind)", "out of view", "kein Wert", "—"],
)
def test_a_word_of_any_program_is_missing_and_named(tmp_path, word):
    text, table = with_words({(3, 4): word, (7, 4): word, (5, 2): word})
    done = imported(tmp_path, text)
    assert (~done.run.visible).sum(axis=0).tolist() == [2, 0] and len(done.run.t) == 19
    (named,) = [note for note in done.notes if "words in columns of numbers" in note]
    assert (
        f"y '{word}' in 2 of 20 rows (first in line 5)" in named
        and f"b '{word}' in 1 of 20 rows" in named
    )


@pytest.mark.parametrize("word", ["", "nan", "NaN", "NULL", "None", "NA", "n/a", "-nan"])
def test_words_that_say_missing_need_no_explanation(tmp_path, word):
    text, _ = with_words({(3, 4): word})
    done = imported(tmp_path, text)
    assert (~done.run.visible).sum() == 1 and not any("words" in note for note in done.notes)
    assert any("not seen in some frames" in note for note in done.notes)


@pytest.mark.parametrize("word", ["inf", "-inf", "Infinity", "1e999"])
def test_infinite_numbers_are_missing(tmp_path, word):
    text, _ = with_words({(3, 4): word})
    done = imported(tmp_path, text)
    assert (~done.run.visible).sum() == 1 and any(
        "infinite values" in note and "y 1" in note for note in done.notes
    )


@pytest.mark.parametrize("cell", ["12mm", "1.2.3", "0x1F", "3 4", "1/2", "2024-01-01"])
def test_a_damaged_number_stays_a_fault(tmp_path, cell):
    text, _ = with_words({(3, 4): cell})
    assert f"line 5, column y: '{cell}' is not a number" in fault(tmp_path, text)


def test_a_column_of_text_is_no_column_of_numbers(tmp_path):
    text, _ = with_words({(k, 4): "left" if k % 2 else "right" for k in range(20)})
    assert "column y: 'right' is not a number; this column holds text" in fault(tmp_path, text)
    text, _ = with_words({(3, 0): "late"})
    assert "line 5, column t: 'late' is not a number" in fault(tmp_path, text)


def test_labels_stay_labels(tmp_path):
    text, _ = made_log()
    lines = text.splitlines()
    label = ["part", *(["rest"] * 10), *(["move"] * 10)]
    (tmp_path / "log.csv").write_text(
        "\n".join(f"{line},{word}" for line, word in zip(lines, label)) + "\n"
    )
    assert 'block = "part"' in guess_mapping([tmp_path / "log.csv"]).text


def test_many_words_are_counted_in_one_line(tmp_path):
    cells = {(k, 4): chr(97 + k) * 30 for k in range(9)}
    done = imported(tmp_path, with_words(cells)[0])
    (named,) = [note for note in done.notes if "words in columns" in note]
    assert "and 3 more" in named and len(named) < 600


def test_what_is_a_word():
    assert all(map(is_word, ["lost", "#N/A", "#DIV/0!", "+inf", "nan7"]))
    assert not any(map(is_word, ["1", "1,5", "12 mm", "a1", "t0"]))
    assert np.isnan(float("nan"))
