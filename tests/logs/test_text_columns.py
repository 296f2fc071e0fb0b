"""Columns of text that are flags are no blocks; all text columns left out are listed."""

import numpy as np
import pytest

from softmap_edge.logs.guess import guess_mapping

ROWS = 80
T = np.arange(ROWS) / 20
U = np.stack([8 * np.sin(0.9 * T), 6 * np.sin(1.3 * T + 0.4)], axis=1)
POINTS = np.stack([[U[:, 0] * k, U[:, 1] * k, 40.0 * k + 0 * T] for k in (1, 2)], axis=0).transpose(
    2, 0, 1
)
MARKERS = [f"m{k}_{axis}" for k in (1, 2) for axis in "xyz"]


def log(folder, names, columns, commands=None):
    commands = commands or [[f"{x:.4f}" for x in U[:, 0]], [f"{x:.4f}" for x in U[:, 1]]]
    head = ["t", *(f"u{k + 1}" for k in range(len(commands))), *MARKERS, *names]
    lines = [
        ",".join(
            [
                f"{T[k]:.3f}",
                *(command[k] for command in commands),
                *(f"{x:.4f}" for x in POINTS[k].ravel()),
                *(str(column[k]) for column in columns),
            ]
        )
        for k in range(ROWS)
    ]
    (folder / "log.csv").write_text("\n".join([",".join(head), *lines]) + "\n", "utf-8")
    return folder / "log.csv"


def words(one, other):
    return [other if k in (7, 8, 30) else one for k in range(ROWS)]


@pytest.mark.parametrize(
    ("name", "one", "other"),
    [
        ("m1_status", "OK", "MISSING"),
        ("valid_1", "True", "False"),
        ("camera", "tracked", "lost"),
        ("state", "seen", "not seen"),
        ("m1_visible", "full", "part"),  # by the name alone
        ("erkannt", "ja", "nein"),
        ("remark", "no", ""),
    ],
)
def test_words_of_flags_are_no_blocks(tmp_path, name, one, other):
    found = guess_mapping([log(tmp_path, [name, f"{name}_b"], [words(one, other)] * 2)])
    assert "\nblock =" not in found.text
    line = next(line for line in found.unknown if f"{name} (such as '{one}')" in line)
    assert f"{name}_b (such as '{one}')" in line and "left out" in line
    assert not any(line.startswith("blocks:") for line in found.assumed)


@pytest.mark.parametrize(
    ("name", "one", "other"),
    [
        ("pattern", "sweep", "hold"),
        ("pattern_label", "circle", "ok"),
        ("what", "rest", "push"),
        ("TrialNo", "1a", "2b"),
    ],
)
def test_words_of_a_protocol_stay_blocks(tmp_path, name, one, other):
    found = guess_mapping(
        [log(tmp_path, ["m1_status", name], [words("OK", "LOST"), words(one, other)])]
    )
    assert f'block = "{name}"' in found.text
    assert sum("m1_status (such as 'OK')" in line for line in found.unknown) == 1


def test_every_text_column_is_listed(tmp_path):
    names = [f"note{'abcdefghijklmnop'[k]}" for k in range(16)]
    found = guess_mapping([log(tmp_path, names, [words("ok", "bad")] * 16)])
    assert all(any(f"{name} (such as 'ok')" in line for line in found.unknown) for name in names)


@pytest.mark.parametrize(
    ("cell", "rows"), [("3_000", range(ROWS)), ("12q", range(0, ROWS, 2)), ("1'2x", range(60))]
)
def test_a_command_that_is_partly_text_is_listed_with_its_count(tmp_path, cell, rows):
    second = [cell if k in rows else f"{x:.4f}" for k, x in enumerate(U[:, 1])]
    first = [f"{x:.4f}" for x in U[:, 0]]
    found = guess_mapping([log(tmp_path, [], [], [first, second, first])])
    line = next(line for line in found.unknown if "'u2'" in line)
    assert "belongs to 'u1'" in line and f"such as '{cell}'" in line
    assert f"{len(rows)} of the first {ROWS} cells" in line and "left out" in line
    assert "\nblock =" not in found.text


def test_logs_of_numbers_get_no_such_line(tmp_path):
    found = guess_mapping([log(tmp_path, ["block"], [[k // 20 for k in range(ROWS)]])])
    assert 'block = "block"' in found.text
    assert not any("such as" in line for line in found.unknown)
