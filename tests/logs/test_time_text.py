"""Time as people write it: ISO 8601, local dates, times of day; what decides the order of day and
month.
"""

import datetime

import numpy as np
import pytest
from bench_rows import NAMES, STEP, rows, write

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.readers.clock_cells import packed_of
from softmap_edge.logs.time_text import TimeTextError, form_of, time_text_of

START = datetime.datetime(2031, 5, 7, 10, 15, 0, tzinfo=datetime.UTC)
SECONDS = START.timestamp()


def stamp(form, start=START, digits=3):
    """A function of the row that writes its time; `{f}` is the fraction of a second."""

    def written(k):
        at = start + datetime.timedelta(seconds=STEP * k)
        return at.strftime(form).replace("{f}", f"{at.microsecond / 1e6:.{digits}f}"[2:])

    return written


def seconds_of(cells, order=None):
    clock = time_text_of(cells, order)
    return clock.settle(clock.parse(cells))[0]


@pytest.mark.parametrize(
    "cell",
    [
        "2031-05-07T10:15:00Z",
        "2031-05-07T10:15:00.000000Z",
        "2031-05-07 10:15:00",
        "2031-05-07 10:15:00,000",
        "2031-05-07T12:15:00+02:00",
        "2031-05-07T12:15:00.000 +0200",
        "2031-05-07 05:15:00-05",
        "2031-05-07 10:15:00 UTC",
        "2031/05/07 10:15:00",
        "2031-5-7_10:15:00",
        "20310507T101500Z",
        "20310507 10:15:00.0",
        "07.05.2031 10:15:00",
        "07.05.2031 10:15:00,000",
        "7.5.31 10:15",
        "07-May-2031 10:15:00",
        "7 May 2031 10:15:00",
        "May 7, 2031 10:15:00 AM",
        "Wed, 07 May 2031 10:15:00 GMT",
        "Wed May  7 10:15:00 2031",
        "Wed May  7 10:15:00.000 UTC 2031",
        "Mi. 7. Mai 2031 10:15:00",
        "Mittwoch, 7. Mai 2031, 10:15:00 Uhr",
        "May 7th, 2031 10:15:00",
        "2031-May-07 10:15:00",
        "2031:05:07 10:15:00",
        "10:15:00 07.05.2031",
        "10:15:00.0 2031-05-07",
        "10:15:00 7 May 2031",
    ],
)
def test_a_date_is_seconds_since_1970(cell):
    assert seconds_of([cell])[0] == SECONDS


@pytest.mark.parametrize(
    ("cell", "seconds"),
    [
        ("10:15:00", 36900.0),
        ("10:15:00.25", 36900.25),
        ("10:15:00,25", 36900.25),
        ("10:15:00:250", 36900.25),
        ("10:15", 36900.0),
        ("15:00.25", 900.25),
        ("12:15:00 AM", 900.0),
        ("12:15:00 pm", 44100.0),
    ],
)
def test_a_time_of_day_is_seconds_since_midnight(cell, seconds):
    assert seconds_of([cell])[0] == seconds


@pytest.mark.parametrize(
    "cell",
    [
        "",
        "7",
        "1.5",
        "-1e-5",
        "1-2",
        "a:b",
        "1:2:3",
        "10:15:00:12",
        "1.2.3.4",
        "127.0.0.1",
        "v1.2.3",
        "x-1/2",
        "::",
        "2031",
    ],
)
def test_what_is_no_time(cell):
    assert form_of(cell) is None


def test_a_value_above_twelve_decides_the_order_of_day_and_month():
    assert seconds_of(["05/07/2031 10:15:00", "05/13/2031 10:15:00"])[0] == SECONDS
    assert seconds_of(["07/05/2031 10:15:00", "13/05/2031 10:15:00"])[0] == SECONDS


def test_the_sequence_decides_the_order_of_day_and_month():
    around = ["{}/{}/2031 23:59:59", "{}/{}/2031 00:00:01"]
    us = [around[0].format(5, 7), around[1].format(5, 8)]
    there = [around[0].format(7, 5), around[1].format(8, 5)]
    for cells in (us, there):
        assert np.diff(seconds_of(cells)) == pytest.approx([2.0])


def test_one_date_needs_no_order_and_leaps_ask_for_one():
    clock = time_text_of(["05/07/2031 10:15:00", "05/07/2031 10:15:01"])
    seconds, note = clock.settle(clock.parse(["05/07/2031 10:15:00", "05/07/2031 10:15:01"]))
    assert np.diff(seconds) == pytest.approx([1.0]) and "date_order" in note
    unclear = ["01/02/2031 10:00:00", "02/03/2031 10:00:00", "03/04/2031 10:00:00"]
    with pytest.raises(TimeTextError, match="day/month/year or month/day/year"):
        seconds_of(unclear)
    assert np.diff(seconds_of(unclear, "dmy"))[0] == 29 * 86400
    assert np.diff(seconds_of(unclear, "mdy"))[0] == 32 * 86400


def test_a_time_of_day_counts_on_over_midnight():
    assert seconds_of(["23:59:59.5", "", "00:00:00.5"])[[0, 2]] == pytest.approx([86399.5, 86400.5])
    assert np.isnan(seconds_of(["23:59:59.5", "", "00:00:00.5"])[1])
    assert np.diff(seconds_of(["59:59.9", "00:00.1"])) == pytest.approx([0.2])


# --- in a log ------------------------------------------------------------------------------
MIDNIGHT = datetime.datetime(2031, 5, 7, 23, 59, 59, tzinfo=datetime.UTC)
FORMS = {
    "iso": (stamp("%Y-%m-%dT%H:%M:%S.{f}Z", digits=6), {}),
    "german": (stamp("%d.%m.%Y %H:%M:%S,{f}"), {"cut": ";", "point": ","}),
    "offset": (stamp("%Y-%m-%d %H:%M:%S.{f}+02:00"), {}),
    "american": (stamp("%m/%d/%Y %I:%M:%S.{f} %p", MIDNIGHT), {}),
    "british": (stamp("%d/%m/%Y %H:%M:%S.{f}", MIDNIGHT), {"cut": "\t"}),
    "matlab": (stamp("%d-%b-%Y %H:%M:%S.{f}"), {}),
    "of day": (stamp("%H:%M:%S.{f}", MIDNIGHT), {}),
    "quoted": (stamp('"%Y-%m-%d %H:%M:%S,{f}"'), {}),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_log_with_dates(tmp_path, form):
    time, style = FORMS[form]
    path = write(
        tmp_path / "log.csv",
        style.get("cut", ",").join(["Zeitpunkt", *NAMES[1:]]),
        rows(time=time, **style),
    )
    found = guess_mapping([path])
    assert not any("no column holds time" in line for line in [*found.assumed, *found.unknown])
    run = import_logs([path], parse_mapping(found.text, path)).run
    assert run.t == pytest.approx(STEP * np.arange(40), abs=1e-5) and run.channels == 2
    mapping = (
        'schema = "softmap.mapping/1"\n[[log]]\n'
        'time = { column = "Zeitpunkt" }\ncommand = { columns = ["cmd_1"] }'
    )
    by_hand = import_logs([path], parse_mapping(mapping, path)).run
    assert np.diff(by_hand.t) == pytest.approx(STEP, abs=1e-5)


def test_a_date_and_a_time_of_day_in_two_columns(tmp_path):
    for cut in (",", " "):
        form = stamp(f"%d.%m.%Y{cut}%H:%M:%S.{{f}}", MIDNIGHT)
        path = write(
            tmp_path / "log.csv",
            cut.join(["Datum", "Uhrzeit", *NAMES[1:]]),
            rows(cut=cut, time=form),
        )
        found = guess_mapping([path])
        assert 'columns = ["Datum", "Uhrzeit"]' in found.text
        run = import_logs([path], parse_mapping(found.text, path)).run
        assert run.t == pytest.approx(STEP * np.arange(40), abs=1e-5)


@pytest.mark.parametrize("cut", [5, 20, 35])
def test_a_date_and_a_time_of_day_in_two_parts_of_a_log(tmp_path, cut):
    form = stamp("%d.%m.%Y,%H:%M:%S.{f}", MIDNIGHT)
    head = ",".join(["Datum", "Uhrzeit", *NAMES[1:]])
    paths = [
        write(tmp_path / "a.csv", head, rows(cut, time=form)),
        write(tmp_path / "b.csv", head, rows(40 - cut, time=form, first=cut)),
    ]
    log = 'time = { columns = ["Datum", "Uhrzeit"] }\ncommand = { columns = ["cmd_1"] }\n'
    mapping = 'schema = "softmap.mapping/1"\n' + "".join(
        f'[[log]]\nfile = "{path.name}"\n{log}' for path in paths
    )
    run = import_logs(paths, parse_mapping(mapping, paths[0])).run
    assert np.diff(run.t) == pytest.approx(STEP, abs=1e-5) and len(run.t) == 40


def test_a_cell_that_is_no_time_is_named_with_its_line(tmp_path):
    lines = rows(time=FORMS["iso"][0])
    lines[20] = "soon" + lines[20][lines[20].index(",") :]
    path = write(tmp_path / "log.csv", ",".join(NAMES), lines)
    mapping = 'schema = "softmap.mapping/1"\n[[log]]\ntime = { column = "time" }\ncommand = { columns = ["cmd_1"] }'
    with pytest.raises(RunError, match=r"line 22, column time: 'soon' is not a date"):
        import_logs([path], parse_mapping(mapping, path))
    with pytest.raises(RunError, match=r"time holds dates or times; leave unit"):
        path = write(tmp_path / "log.csv", ",".join(NAMES), rows(time=FORMS["iso"][0]))
        import_logs(
            [path], parse_mapping(mapping.replace('"time" }', '"time", unit = "ms" }'), path)
        )


def test_dates_that_can_be_read_in_two_ways_are_asked_about(tmp_path):
    dates = [f"0{k + 1}/0{k + 2}/2031 10:00:00" for k in range(8)]
    path = write(tmp_path / "log.csv", ",".join(NAMES), rows(8, time=lambda k: dates[k]))
    mapping = 'schema = "softmap.mapping/1"\n[[log]]\ntime = { column = "time" }\ncommand = { columns = ["cmd_1"] }'
    with pytest.raises(RunError, match=r'set time.date_order = "dmy" or "mdy"'):
        import_logs([path], parse_mapping(mapping, path))
    run = import_logs(
        [path], parse_mapping(mapping.replace('"time" }', '"time", date_order = "dmy" }'), path)
    ).run
    assert len(run.t) == 8  # the remedy leads out


@pytest.mark.parametrize(
    ("cell", "month"),
    [("5. März 2024", 3), ("5. Maerz 2024", 3), ("5 Mrz 2024", 3), ("5. Okt. 2024", 10)]
    + [("5. Dezember 2024", 12), ("Dezember 5, 2024", 12), ("5-Mai-24", 5), ("5. Jänner 2024", 1)],
)
def test_months_have_german_names_too(cell, month):
    known = datetime.datetime(2024, month, 5, tzinfo=datetime.UTC).timestamp()
    assert seconds_of([cell])[0] == known


@pytest.mark.parametrize("cell", ["Mar 2024", "run 5 Mar", "5 Marker 2024", "a 5 foo 20"])
def test_words_that_are_no_date(cell):
    assert form_of(cell) is None


def imported(folder, names, time, count=200):
    (folder / "log.csv").unlink(missing_ok=True)
    path = write(folder / "log.csv", ",".join(names), rows(count, time=time))
    return import_logs([path], parse_mapping(guess_mapping([path]).text, path))


LATE = START.replace(hour=11, minute=59, second=57)
DIGITS = [
    ("%y%m%d%H%M%S.{f}", 2, "yymmdd"),
    ("%y%m%d%H%M%S.{f}", 3, "yymmdd"),
    ("%Y%m%d%H%M%S.{f}", 2, "yymmdd"),
    ("%Y%m%d%H%M%S{f}", 3, "yymmdd"),
    ("%H%M%S.{f}", 3, "HHMMSS"),
]


@pytest.mark.parametrize(("form", "digits", "said"), DIGITS)
def test_digits_without_separators_are_a_date(tmp_path, form, digits, said):
    done = imported(tmp_path, NAMES, stamp(form, LATE, digits))
    assert done.run.t - done.run.t[0] == pytest.approx(STEP * np.arange(200), abs=1e-5)
    assert any(said in note for note in done.notes)


def test_counts_of_twelve_digits_are_no_date():
    for first, step in ((240305125950, 50_000), (1709643590, 1), (125950, 1), (240305125999, 7)):
        assert packed_of([str(first + step * k) for k in range(200)]) is None


@pytest.mark.parametrize("form", ["%H:%M:%S.", "%d.%m.%Y %H:%M:%S.", "%y%m%d%H%M%S.", "%M:%S."])
@pytest.mark.parametrize("unit", [1000, 1])
def test_fractions_without_leading_zeros(tmp_path, form, unit):
    def written(k):
        at = LATE + datetime.timedelta(seconds=STEP * k)
        return at.strftime(form) + str(at.microsecond // unit)

    done = imported(tmp_path, NAMES, written)
    assert len(done.run.t) == 200
    assert done.run.t - done.run.t[0] == pytest.approx(STEP * np.arange(200), abs=1e-5)
    assert any("lack their leading zeros" in note for note in done.notes)


@pytest.mark.parametrize("form", ["%H:%M:%S.%f", "%Y-%m-%d %H:%M:%S.%f", "%M:%S.%f"])
def test_fractions_without_last_zeros_stay_decimal(tmp_path, form):
    def written(k):
        at = LATE + datetime.timedelta(seconds=STEP * k)
        return at.strftime(form)[:-3].rstrip("0") + ("0" if k % 20 == 0 else "")

    done = imported(tmp_path, NAMES, written)
    assert done.run.t - done.run.t[0] == pytest.approx(STEP * np.arange(200), abs=1e-5)
    assert not any("leading zeros" in note for note in done.notes)
