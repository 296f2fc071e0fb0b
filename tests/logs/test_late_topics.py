"""Logs that begin late, stop early or pause while others go on: the import reports it."""

import numpy as np
import pytest

from softmap_edge.logs.coverage import pauses
from softmap_edge.logs.importer import import_logs, read_mapping

T = 0.05 * np.arange(200)
MAP = """schema = "softmap.mapping/1"
[[log]]
file = "goals.csv"
time = { column = "t" }
command = { columns = ["u"] }
[[log]]
file = "seen.csv"
time = { column = "t" }
markers = { columns = [["x", "y", "z"]] }
[[log]]
file = "drive.csv"
time = { column = "t" }
present = { columns = ["p"] }
"""


def table(path, names, rows):
    lines = [",".join(f"{x:.6f}" for x in row) for row in rows]
    path.write_text("\n".join([names, *lines]) + "\n")
    return path


def imported(folder, seen=T, drive=T, goals=T, zero=0.0):
    u = 8 * np.sin(goals)
    files = [table(folder / "goals.csv", "t,u", np.c_[goals + zero, u])]
    p = np.c_[20 + 3 * np.sin(seen), 5 * np.cos(0.7 * seen), 100 - seen]
    files.append(table(folder / "seen.csv", "t,x,y,z", np.c_[seen + zero, p]))
    read = drive + 0.003
    files.append(table(folder / "drive.csv", "t,p", np.c_[read + zero, 7.9 * np.sin(read)]))
    (folder / "map.toml").write_text(MAP)
    return import_logs(files, read_mapping(folder / "map.toml"))


@pytest.mark.parametrize("zero", [0.0, 1.7e9])
@pytest.mark.parametrize(
    ("drive", "how", "rows"),
    [
        (T[:100], "stops early", 100),
        (T[60:], "begins late", 61),
        (np.r_[T[:80], T[140:]], "pauses", 60),
    ],
)
def test_readings_that_are_made_up_are_counted(tmp_path, drive, how, rows, zero):
    done = imported(tmp_path, drive=drive, zero=zero)
    said = next(doubt for doubt in done.doubts if doubt.startswith(f"present: {how}"))
    assert abs(int(said.split(" of 200 rows")[0].split()[-1]) - rows) <= 1


@pytest.mark.parametrize(
    "drive", [T, T[::7], T[2:-2], np.sort(np.random.default_rng(0).uniform(0, 10, 200))]
)
def test_readings_at_any_rate_raise_no_doubt(tmp_path, drive):
    done = imported(tmp_path, drive=drive)
    assert not any(doubt.startswith("present: ") for doubt in done.doubts), done.doubts


@pytest.mark.parametrize(
    ("seen", "said"), [(T[:90], "from 4.45 to 9.95 s"), (T[90:], "from 0 to 4.5 s"), (T, None)]
)
def test_commands_that_nothing_sees_are_listed(tmp_path, seen, said):
    notes = [note for note in imported(tmp_path, seen).notes if "without frames" in note]
    assert (said in notes[0]) if said else not notes


@pytest.mark.parametrize("zero", [0.0, 1.7e9, -5.0])
def test_frames_after_the_last_command_are_left_out_on_every_clock(tmp_path, zero):
    done = imported(tmp_path, goals=T[:190], zero=zero)
    assert done.run.frames == 190
    assert any("10 of 200 frames lie outside" in note for note in done.notes)


def test_pauses_of_irregular_and_short_series():
    assert pauses(np.array([0.0, 1.0]), -50.0, 90.0) == []
    assert pauses(np.arange(10.0), 0.0, 30.0) == [(9.0, 30.0)]
    assert pauses(np.r_[np.arange(10.0), np.arange(40.0, 50.0)], 0.0, 49.0) == [(9.0, 40.0)]
    assert pauses(np.array([0.0, 1, 9, 10, 20, 21, 22]), 0.0, 22.0) == []
