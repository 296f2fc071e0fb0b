"""Numbers with a unit behind them are one clear error of a proposal; labels are not."""

import pytest
from bench_rows import NAMES, rows

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.readers.unit_cells import unit_behind

HEAD = ",".join(NAMES)


@pytest.mark.parametrize("behind", [" mm", "mm", "mm ", " cm", " m", "\u00b5m", " in"])
def test_a_unit_in_the_cells_is_an_error_with_the_remedy(tmp_path, behind):
    lines = [
        ",".join([*line.split(",")[:3], *(cell + behind for cell in line.split(",")[3:])])
        for line in rows(60)
    ]
    (tmp_path / "log.csv").write_text("\n".join([HEAD, *lines]) + "\n", encoding="utf-8")
    with pytest.raises(RunError) as found:
        guess_mapping([tmp_path / "log.csv"])
    said = str(found.value)
    assert (
        NAMES[3] in said
        and f"remove '{behind.strip()}'" in said
        and "give the unit in the mapping" in said
    )


@pytest.mark.parametrize("behind", [" deg", "\u00b0", "V", " ms"])
def test_one_column_is_enough(tmp_path, behind):
    lines = [
        ",".join([line.split(",")[0], line.split(",")[1] + behind, *line.split(",")[2:]])
        for line in rows(60)
    ]
    (tmp_path / "log.csv").write_text("\n".join([HEAD, *lines]) + "\n", encoding="utf-8")
    with pytest.raises(RunError, match=NAMES[1]):
        guess_mapping([tmp_path / "log.csv"])


def test_a_unit_in_one_cell_does_not_drop_the_column(tmp_path):
    lines = rows(60)
    for cell in ("12mm", "0.5 deg", "3\u00b0"):
        lines[30] = ",".join([*lines[30].split(",")[:-1], cell])
        (tmp_path / "log.csv").write_text("\n".join([HEAD, *lines]) + "\n", encoding="utf-8")
        with pytest.raises(
            RunError, match=f"{NAMES[-1]} hold numbers with a unit, such as '{cell}'"
        ):
            guess_mapping([tmp_path / "log.csv"])


def test_labels_are_read(tmp_path):
    for label in ("{}mm", "{}a", "step{}", "{}mm"):
        lines = [f"{line},{label.format(5 * (k // 20))}" for k, line in enumerate(rows(60))]
        (tmp_path / "log.csv").write_text("\n".join([HEAD + ",trial", *lines]) + "\n")
        assert 'block = "trial"' in guess_mapping([tmp_path / "log.csv"]).text


def test_the_rule():
    assert (
        unit_behind([f"{k}.5 mm" for k in range(20)]) == "mm"
        and unit_behind(["1,5e-3 m", "2,5e-3 m", "", "3 m"]) == "m"
    )
    assert (
        unit_behind(["5mm"] * 30 + ["10mm"] * 30) is None
        and unit_behind([f"a{k}" for k in range(20)]) is None
    )
    assert (
        unit_behind([f"{k}{'ab'[k % 2]}" for k in range(20)]) is None
        and unit_behind(["1 mm"]) is None
    )
