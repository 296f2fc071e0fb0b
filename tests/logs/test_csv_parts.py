"""Files with the same columns, one after another in time, are parts of one log; others are not."""

import datetime
import gzip
from pathlib import Path

import numpy as np
import pytest
from bench_rows import NAMES, STEP, rows, values, write

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.readers.text import TextColumns

SPANS = [(0, 20), (20, 12), (32, 8)]  # first row and number of rows of each part


def iso(k):
    return f"2031-05-07T10:15:{STEP * k:09.6f}Z"


def date_and_day(k):
    """The time 1.05 s before midnight of row 0: the parts lie on two days."""
    left = 1.05 - STEP * k
    if left > 1e-9:
        return f"2031-05-07,23:59:{60 - left:06.3f}"
    return f"2031-05-08,00:00:{-left + 0:06.3f}"


def sec_and_nanosec(k):
    full, rest = divmod(round(STEP * k * 1e9) + 500_000_000, 10**9)
    return f"{1700000000 + full},{rest}"


FORMS = {
    "numbered": (["part_1.csv", "part_2.csv", "part_3.csv"], "time", None, ","),
    "in letters": (["run-a.csv", "run-b.csv", "run-c.csv"], "time", None, ","),
    "no common name": (["z.txt", "morning.csv", "afternoon.dat"], "time", None, ","),
    "with brackets": (["log[1].csv", "log[2].csv", "log[3].csv"], "time", iso, ","),
    "a date and a time of day": (["b2.csv", "b10.csv", "b9.csv"], "date,clock", date_and_day, ","),
    "seconds and nanoseconds": (
        ["s_0.csv", "s_1.csv", "s_2.csv"],
        "stamp.sec,stamp.nanosec",
        sec_and_nanosec,
        ",",
    ),
    "tabs": (["t0.tsv", "t1.tsv", "t2.tsv"], "time", None, "\t"),
}


def parts(folder, form, spans=SPANS):
    names, clock, time, cut = FORMS[form]
    head = cut.join([clock, *NAMES[1:]])
    return [
        write(folder / name, head, rows(count, cut, time=time, first=first))
        for name, (first, count) in zip(names, spans)
    ]


DAY = 86400
MAP = """schema = "softmap.mapping/1"
[[log]]
file = "part_*.csv"
time = { column = "time"%s }
command = { columns = ["cmd_1", "cmd_2"] }
markers = { columns = [["tip_x", "tip_y", "tip_z"]], unit = "mm" }
"""


def clocked(folder, text, names=("part_1.csv", "part_2.csv", "part_3.csv"), spans=SPANS):
    """Parts of a log whose time is written by `text`, from the number of the row."""
    head = ",".join(["time", "cmd_1", "cmd_2", "tip_x", "tip_y", "tip_z"])
    return [
        write(folder / name, head, rows(count, time=text, first=first))
        for name, (first, count) in zip(names, spans)
    ]


def of_day(seconds):
    seconds = round(seconds % DAY, 6)
    return f"{int(seconds // 3600):02d}:{int(seconds % 3600 // 60):02d}:{seconds % 60:06.3f}"


@pytest.mark.parametrize("midnight", [10, 20, 25, 32, 36])
def test_times_of_day_pass_midnight_within_and_between_parts(tmp_path, midnight):
    paths = clocked(tmp_path, lambda k: of_day(DAY + STEP * (k - midnight)))
    found = imported(paths[::-1], MAP % "")
    assert np.diff(found.run.t) == pytest.approx(STEP) and len(found.run.t) == 40
    assert found.run.t[0] == pytest.approx(DAY - STEP * midnight)
    assert any("midnight" in note for note in found.notes) and not found.doubts
    proposed = guess_mapping(paths)
    assert not any("missing" in said for said in proposed.said)


def test_minutes_and_seconds_pass_the_full_hour_between_parts(tmp_path):
    def text(k):
        seconds = (3600 + STEP * (k - 20)) % 3600
        return f"{int(seconds // 60):02d}:{seconds % 60:06.3f}"

    found = imported(clocked(tmp_path, text), MAP % "")
    assert np.diff(found.run.t) == pytest.approx(STEP)
    assert any("full hour" in note for note in found.notes)


@pytest.mark.parametrize(
    ("turn", "unit", "start"), [(DAY, "s", DAY - 1.3), (2**32 / 1e6, "us", 2**32 / 1e6 - 1.3)]
)
def test_numbers_that_roll_over_are_mended_across_parts(tmp_path, turn, unit, start):
    scale = {"s": 1, "us": 1e6}[unit]
    paths = clocked(tmp_path, lambda k: f"{(start + STEP * k) % turn * scale:.6f}")
    found = imported(paths, MAP % f', unit = "{unit}", jumps = "mend"')
    assert np.diff(found.run.t) == pytest.approx(STEP) and len(found.run.t) == 40
    assert any("rolls over 1 times" in note for note in found.notes)
    # between part 1 and 2
    plain = clocked(tmp_path, lambda k: f"{(start + STEP * (k + 6)) % turn * scale:.6f}")
    doubted = imported(plain, MAP % f', unit = "{unit}"')
    assert any('time.jumps = "mend"' in doubt for doubt in doubted.doubts)


@pytest.mark.parametrize(
    ("order", "first", "days"),
    [
        ("mdy", (5, 12), (0, 1)),
        ("mdy", (4, 30), (0, 1)),
        ("dmy", (12, 5), (0, 1)),
        ("dmy", (30, 4), (0, 1)),
    ],
)
def test_all_parts_decide_the_order_of_day_and_month(tmp_path, order, first, days):
    day, month = first if order == "dmy" else first[::-1]
    start = datetime.datetime(2031, month, day, 23, 59, 59)

    def text(k):
        now = start + datetime.timedelta(seconds=STEP * k)
        date = (now.day, now.month) if order == "dmy" else (now.month, now.day)
        return f"{date[0]}/{date[1]}/{now.year} {now:%H:%M:%S.%f}"

    found = imported(clocked(tmp_path, text, spans=[(0, 20), (20, 10), (30, 10)]), MAP % "")
    assert np.diff(found.run.t) == pytest.approx(STEP, abs=1e-6)
    assert found.run.t[0] == pytest.approx(start.replace(tzinfo=datetime.UTC).timestamp(), abs=1e-6)


def test_parts_whose_dates_decide_nothing_are_asked_about(tmp_path):
    dates = ["3/4/2031", "4/3/2031"]
    paths = clocked(
        tmp_path, lambda k: f"{dates[k >= 20]} {of_day(STEP * k)}", spans=[(0, 20), (20, 20)]
    )
    with pytest.raises(RunError, match='set time.date_order = "dmy" or "mdy"'):
        imported(paths, MAP % "")
    spans = [
        np.ptp(imported(paths, MAP % f', date_order = "{order}"').run.t) for order in ("dmy", "mdy")
    ]
    assert spans == pytest.approx([29 * DAY + STEP * 39] * 2, abs=3 * DAY)


def test_parts_with_dates_of_no_common_order_are_refused(tmp_path):
    dates = ["13/4/2031", "4/14/2031"]
    paths = clocked(
        tmp_path, lambda k: f"{dates[k >= 20]} {of_day(STEP * k)}", spans=[(0, 20), (20, 20)]
    )
    with pytest.raises(RunError, match="neither all day/month/year nor all month/day/year"):
        imported(paths, MAP % "")


def imported(paths, text):
    return import_logs(paths, parse_mapping(text, Path("map.toml")))


def complete(run):
    assert run.t - run.t[0] == pytest.approx(STEP * np.arange(40), abs=1e-6)
    assert run.command == pytest.approx(np.array([values(k)[:2] for k in range(40)]), abs=6e-4)


@pytest.mark.parametrize("form", FORMS)
def test_the_proposal_for_parts_is_one_log_in_the_order_of_time(tmp_path, form):
    files = parts(tmp_path, form)
    for paths in (files, files[::-1]):
        found = guess_mapping(paths)
        assert any("they are parts of one log" in line for line in found.assumed)
        assert found.text.count("[[log]]") == 1
        done = imported(paths, found.text)
        complete(done.run)
        assert not any("cannot be imported" in line for line in found.said)
        named = ", ".join(path.name for path in files)
        assert any(
            f"3 parts read one after another: {named}; the longest pause between two is 0.05 s"
            in note
            for note in done.notes
        )
        assert len(done.run.extra["made_from"]) == 3


@pytest.mark.parametrize(
    ("form", "logs"), [("numbered", 2), ("in letters", 2), ("no common name", 4)]
)
def test_the_parts_and_another_log_have_logs_of_their_own(tmp_path, form, logs):
    files = parts(tmp_path, form)
    camera = write(tmp_path / "nx.csv", "time,load", [f"{STEP * k:.3f},{k % 7}" for k in range(40)])
    found = guess_mapping([*files, camera])
    assert found.text.count("[[log]]") == logs
    done = imported([*files, camera], found.text)
    complete(done.run)
    assert done.run.load == pytest.approx(np.arange(40) % 7)


@pytest.mark.parametrize("pattern", ['file = "part_*.csv"', 'file = "*"', ""])
def test_a_mapping_takes_parts_by_a_pattern_or_none(tmp_path, pattern):
    text = (
        f'schema = "softmap.mapping/1"\n[[log]]\n{pattern}\ntime = {{ column = "time" }}\n'
        'command = { columns = ["cmd_1", "cmd_2"] }'
    )
    complete(imported(parts(tmp_path, "numbered"), text).run)


@pytest.mark.parametrize("form", ["date,clock", "stamp.sec,stamp.nanosec"])
def test_the_order_is_by_all_columns_of_the_clock(tmp_path, form):
    time = date_and_day if form == "date,clock" else sec_and_nanosec
    head = ",".join([form, *NAMES[1:]])
    # within one day, and within one second, the first column does not order the parts
    later = write(tmp_path / "a.csv", head, rows(3, time=time, first=5))
    earlier = write(tmp_path / "b.csv", head, rows(5, time=time))
    columns = ", ".join(f'"{name}"' for name in form.split(","))
    text = (
        f'schema = "softmap.mapping/1"\n[[log]]\ntime = {{ columns = [{columns}] }}\n'
        'command = { columns = ["cmd_1", "cmd_2"] }'
    )
    done = imported([later, earlier], text)
    assert np.diff(done.run.t) == pytest.approx(STEP, abs=1e-6)
    assert any(
        "b.csv, a.csv; the longest pause between two is 0.05 s" in note for note in done.notes
    )


def test_each_part_is_read_once(tmp_path, monkeypatch):
    paths = parts(tmp_path, "numbered")
    read, count = TextColumns.read, []
    monkeypatch.setattr(
        TextColumns, "read", lambda *args: count.append(args[0].path.name) or read(*args)
    )
    text = 'schema = "softmap.mapping/1"\n[[log]]\ntime = { column = "time" }\ncommand = { columns = ["cmd_1"] }'
    assert len(imported(paths, text).run.t) == 40
    assert sorted(count) == ["part_1.csv", "part_2.csv", "part_3.csv"]


def test_packed_parts_and_arrays_are_parts_as_well(tmp_path):
    for path in parts(tmp_path, "numbered"):
        (tmp_path / f"{path.name}.gz").write_bytes(gzip.compress(path.read_bytes()))
    packed = sorted(tmp_path.glob("*.gz"))
    found = guess_mapping(packed)
    assert 'file = "part_*.csv.gz"' in found.text
    complete(imported(packed, found.text).run)
    for k, (first, count) in enumerate(SPANS):
        table = np.array([values(row) for row in range(first, first + count)])
        t = STEP * np.arange(first, first + count)
        np.savez(tmp_path / f"p{k}.npz", t=t, cmd=table[:, :2], markers=table[:, None, 2:])
    arrays = sorted(tmp_path.glob("p?.npz"))
    found = guess_mapping(arrays)
    assert 'file = "p*.npz"' in found.text
    complete(imported(arrays, found.text).run)


@pytest.mark.parametrize(
    "form", ["numbered", "in letters", "a date and a time of day", "seconds and nanoseconds"]
)
@pytest.mark.parametrize("second", [(0, 25), (15, 20)])
def test_logs_that_overlap_are_no_parts_and_the_way_out_is_to_join_runs(tmp_path, form, second):
    paths = parts(tmp_path, form, [(0, 20), second])
    found = guess_mapping(paths)
    assert any("overlap in time" in line and "`softmap run join`" in line for line in found.said)
    line = next(line for line in found.text.split("\n") if line.startswith("time = "))
    text = f'schema = "softmap.mapping/1"\n[[log]]\n{line}\ncommand = {{ columns = ["cmd_1", "cmd_2"] }}'
    with pytest.raises(
        RunError,
        match="overlap in time .* s and begins at .* import each by itself.*softmap run join",
    ):
        imported(paths, text)
    assert len(imported(paths[:1], text).run.t) == 20


def test_files_without_a_column_are_named_and_are_no_parts(tmp_path):
    one = parts(tmp_path, "numbered")[0]
    other = write(tmp_path / "camera.csv", "time,m_x,m_y,m_z", "9,1,2,3", "10,1,2,4", "11,1,2,5")
    text = (
        'schema = "softmap.mapping/1"\n[[log]]\n'
        'time = { column = "time" }\ncommand = { columns = ["cmd_1", "cmd_2"] }'
    )
    with pytest.raises(
        RunError, match="camera.csv has no column cmd_1.*give exactly one, or change `file`"
    ):
        imported([one, other], text)
    found = guess_mapping([one, other])
    assert not any("parts of one log" in line for line in found.assumed)


def test_logs_of_other_things_with_the_same_names_stay_apart(tmp_path):
    goals = write(tmp_path / "goals.csv", [f"{STEP * k:.2f},{k % 9},{k % 7}" for k in range(40)])
    seen = write(tmp_path / "seen.csv", [f"{STEP * k:.2f},{k % 5},{k % 3}" for k in range(40)])
    text = (
        'schema = "softmap.mapping/1"\n[[log]]\n'
        "header = false\ntime = { column = 0 }\ncommand = { columns = [1, 2] }"
    )
    with pytest.raises(RunError, match="overlap in time"):
        imported([goals, seen], text)


def test_only_time_puts_parts_in_order(tmp_path):
    text = 'schema = "softmap.mapping/1"\n[[log]]\ntime = "none"\ncommand = { columns = ["cmd_1", "cmd_2"] }'
    with pytest.raises(RunError, match="3 of the given files fit"):
        imported(parts(tmp_path, "numbered"), text)
