"""Long tables, with a row for each marker of each frame: recognised by their values, turned to one
row a frame, and the same again by the keys of the mapping. Tables that only look so stay.
"""

import numpy as np
import pytest

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping

FRAMES, MARKERS, STEP = 40, 3, 0.02
T = np.arange(FRAMES) * STEP
U = np.stack([5 * np.sin(6 * T), 4 * np.cos(5 * T) - 4], axis=1)
HEIGHT = 30.0 * np.arange(1, MARKERS + 1)
PLACES = np.round(
    np.stack(
        [
            np.outer(U[:, 0], HEIGHT**2 / 1000),
            np.outer(U[:, 1], HEIGHT**2 / 1000),
            np.tile(HEIGHT, (FRAMES, 1)) - np.outer((U**2).sum(axis=1), HEIGHT) / 1000,
        ],
        axis=2,
    ),
    3,
)
BY_FRAME = [(k, m) for k in range(FRAMES) for m in range(MARKERS)]
BY_MARKER = [(k, m) for m in range(MARKERS) for k in range(FRAMES)]


def xyz(k, m, cut=","):
    return cut.join(f"{x:.3f}" for x in PLACES[k, m])


def pulled(k):
    return f"{U[k, 0]:.4f},{U[k, 1]:.4f}"


def written(folder, head, rows):
    path = folder / "log.csv"
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    return path


def imported(path, text):
    return import_logs([path], parse_mapping(text, path))


MAKES = {
    "a name, and commands repeated": (
        "t,marker,x,y,z,u1,u2",
        [f"{T[k]:.3f},m{m},{xyz(k, m)},{pulled(k)}" for k, m in BY_FRAME],
    ),
    "one marker after another, numbered": (
        "frame,time,id,X,Y,Z,cmd_1,cmd_2",
        [f"{k},{T[k]:.3f},{m + 7},{xyz(k, m)},{pulled(k)}" for k, m in BY_MARKER],
    ),
    "a body and its marker": (
        "t;body;point;px;py;pz;u1;u2",
        [
            f"{T[k]:.3f};{'AAB'[m]};{(1, 2, 1)[m]};{xyz(k, m, ';')};{pulled(k).replace(',', ';')}"
            for k, m in BY_FRAME
        ],
    ),
    "dates, and commands in rows of their own": (
        "stamp,name,x,y,z,u1,u2",
        [
            line
            for k in range(FRAMES)
            for line in (
                f"2031-05-07T10:15:{T[k]:06.3f}Z,,,,,{pulled(k)}",
                *(f"2031-05-07T10:15:{T[k]:06.3f}Z,m{m},{xyz(k, m)},," for m in range(MARKERS)),
            )
        ],
    ),
    "numbers, and commands in rows of their own": (
        "t,id,x,y,z,u1,u2",
        [
            line
            for k in range(FRAMES)
            for line in (
                *(f"{T[k]:.3f},{m + 1},{xyz(k, m)},," for m in range(MARKERS)),
                f"{T[k]:.3f},,,,,{pulled(k)}",
            )
        ],
    ),
    "numbers that all markers share": (
        "frame,t,marker,u1,u2,x,y,z,rate",
        [f"{k},{T[k]:.3f},m{m},{pulled(k)},{xyz(k, m)},50" for k, m in BY_FRAME],
    ),
    "one value a row": (
        "time,variable,value",
        [
            f"{T[k]:.3f},{name},{value:.4f}"
            for k in range(FRAMES)
            for name, value in [
                *((f"u{c + 1}", U[k, c]) for c in range(2)),
                *((f"m{m}_{a}", PLACES[k, m, "xyz".index(a)]) for m in range(3) for a in "xyz"),
            ]
        ],
    ),
    "seconds and nanoseconds": (
        "sec,nanosec,object,x,y,z,u1,u2",
        [
            f"{17 + int(T[k] + 0.5)},{round((T[k] + 0.5) % 1 * 1e9)},{'pqr'[m]},{xyz(k, m)},"
            f"{pulled(k)}"
            for k, m in BY_FRAME
        ],
    ),
}


@pytest.mark.parametrize("make", list(MAKES))
def test_a_long_table_becomes_one_row_a_frame(tmp_path, make):
    path = written(tmp_path, *MAKES[make])
    found = guess_mapping([path])
    assert "pivot = { frame = " in found.text
    assert any("a long table" in line for line in found.assumed)
    done = imported(path, found.text)
    assert done.run.markers.shape == (FRAMES, MARKERS, 3) and done.run.visible is None
    assert np.ptp(done.run.markers - PLACES, axis=(0, 1)) == pytest.approx([0, 0, 0], abs=1e-6)
    assert done.run.command == pytest.approx(U, abs=1e-4)
    assert np.diff(done.run.t) == pytest.approx(STEP, abs=1e-6)
    assert sum(f"became {FRAMES} frames" in note for note in done.notes) == 1


@pytest.mark.parametrize(
    "names", [["01", "1", "2"], ["1", "1.0", "1.00"], ["7", "07", "m7"], ["+1", "1", "-1"]]
)
def test_names_that_are_equal_numbers_are_different_markers(tmp_path, names):
    rows = [f"{T[k]:.3f},{names[m]},{xyz(k, m)},{pulled(k)}" for k, m in BY_FRAME]
    path = written(tmp_path, "t,marker,x,y,z,u1,u2", rows)
    run = imported(path, guess_mapping([path]).text).run
    assert (run.frames, run.markers.shape[1]) == (FRAMES, MARKERS)


def test_a_coordinate_that_all_markers_share_belongs_to_each(tmp_path):
    """In a plane y is 0 in all rows."""
    rows = [
        f"{T[k]:.3f},m{m},{PLACES[k, m, 0]},0,{PLACES[k, m, 2]},{U[k, 0]:.4f}" for k, m in BY_FRAME
    ]
    path = written(tmp_path, "t,marker,x,y,z,u1", rows)
    run = imported(path, guess_mapping([path]).text).run
    assert run.markers.shape == (FRAMES, MARKERS, 3) and not np.ptp(run.markers[..., 1])


def test_a_missing_row_is_a_marker_that_was_not_seen(tmp_path):
    head, rows = MAKES["a name, and commands repeated"]
    gone = {(4, 1), (9, 0), (9, 1), (30, 2)}
    path = written(tmp_path, head, [row for row, one in zip(rows, BY_FRAME) if one not in gone])
    done = imported(path, guess_mapping([path]).text)
    assert {(int(k), int(m)) for k, m in np.argwhere(~done.run.visible)} == gone
    assert any("4 rows are missing and count as not seen" in note for note in done.notes)


@pytest.mark.parametrize("where", ["next to it", "at the end"])
@pytest.mark.parametrize("make", [make for make in MAKES if "own" not in make])
def test_two_rows_of_one_marker_and_time_are_refused(tmp_path, make, where):
    head, rows = MAKES[make]
    more = [*rows, rows[4]] if where == "at the end" else [*rows[:5], rows[4], *rows[5:]]
    path = written(tmp_path, head, more)
    with pytest.raises(RunError, match=r"lines 6 and \d+ both hold marker .* 1 of \d+ rows"):
        guess_mapping([path])


def test_a_row_without_time_is_refused_with_its_line(tmp_path):
    head, rows = MAKES["a name, and commands repeated"]
    path = written(tmp_path, head, [*rows[:7], rows[7].replace(f"{T[2]:.3f}", "", 1), *rows[8:]])
    with pytest.raises(RunError, match="line 9: 't' is empty or no number in 1 rows"):
        guess_mapping([path])


def test_a_hundred_markers(tmp_path):
    rows = [
        f"{T[k]:.3f},{m},{PLACES[k, 2, 0] + m % 10:.3f},{PLACES[k, 2, 1]:.3f},{m // 10}"
        for k in range(FRAMES)
        for m in range(100)
    ]
    path = written(tmp_path, "t,marker_id,x,y,z", rows)
    assert imported(path, guess_mapping([path]).text).run.markers.shape == (FRAMES, 100, 3)


def test_a_clock_that_is_set_back_does_not_mix_its_frames(tmp_path):
    """Times come twice, so only consecutive rows are a frame; the clock is asked about as ever."""
    rows = [f"{T[k % 20]:.3f},m{m},{xyz(k, m)},{pulled(k)}" for k, m in BY_FRAME]
    path = written(tmp_path, "t,marker,x,y,z,u1,u2", rows)
    found = guess_mapping([path])
    assert "pivot = { frame = " in found.text
    with pytest.raises(RunError, match="clock was set back") as fault:
        imported(path, found.text)
    assert "pivot" not in str(fault.value)
    done = imported(path, found.text.replace('unit = "s"', 'unit = "s", jumps = "mend"'))
    assert done.run.markers.shape == (FRAMES, MARKERS, 3)


def test_markers_with_times_of_their_own_are_seen_one_at_a_time(tmp_path):
    rows = [f"{T[k] + 0.005 * m:.3f},{m},{xyz(k, m)},{pulled(k)}" for k, m in BY_FRAME]
    path = written(tmp_path, "t,id,x,y,z,u1,u2", rows)
    found = guess_mapping([path])
    assert any("a time of its own" in line for line in found.assumed)
    run = imported(path, found.text).run
    assert run.markers.shape == (FRAMES * MARKERS, MARKERS, 3)
    assert (run.visible.sum(axis=1) == 1).all() and run.command.shape[1] == 2


def row(k):
    return f"{xyz(k, 2)},{pulled(k)}"


WAVE = [np.sin(2 * np.pi * k / 20) for k in range(200)]  # of 1 s
NOT_LONG = {
    "rows of a coarse second": (
        "sec,sample,tip_x,tip_y,tip_z,u1,u2",
        [f"{k // 10},{k % 10},{row(k)}" for k in range(FRAMES)],
    ),
    "a second, and a number that repeats with the motion": (
        "time,k,tip_x,tip_y,tip_z,u1",
        [
            f"{k // 20},{k % 20},{9 * x:.3f},{3 * x:.3f},{80 - x * x:.3f},{x:.3f}"
            for k, x in enumerate(WAVE)
        ],
    ),
    "seconds and milliseconds": (
        "sec,ms,tip_x,tip_y,tip_z,u1",
        [
            f"{k // 20},{k % 20 * 50},{9 * x:.3f},{3 * x:.3f},{80 - x * x:.3f},{x:.3f}"
            for k, x in enumerate(WAVE)
        ],
    ),
    "parts of a protocol": (
        "t,block,tip_x,tip_y,tip_z,u1,u2",
        [f"{T[k]:.3f},{'abcd'[k // 10]},{row(k)}" for k in range(FRAMES)],
    ),
    "poses in turn": (
        "t,pose,tip_x,tip_y,tip_z,u1,u2",
        [f"{T[k]:.3f},{'ab'[k % 2]},{row(k)}" for k in range(FRAMES)],
    ),
    "a slow clock": (
        "t,tip_x,tip_y,tip_z,u1,u2,mode",
        [f"{T[k]:.1f},{row(k)},{k % 5}" for k in range(FRAMES)],
    ),
}


@pytest.mark.parametrize("make", list(NOT_LONG))
def test_a_table_of_frames_stays_as_it_is(tmp_path, make):
    path = written(tmp_path, *NOT_LONG[make])
    text = guess_mapping([path]).text
    assert "\npivot" not in text and '["tip_x", "tip_y", "tip_z"]' in text


MAP = """schema = "softmap.mapping/1"
[[log]]
pivot = { frame = "t", marker = "marker" }
time = { column = "t" }
command = { columns = ["u1", "u2"] }
markers = { columns = [["m2.x", "m2.y", "m2.z"], ["m0.x", "m0.y", "m0.z"]] }
"""


def test_the_mapping_chooses_markers_and_their_order(tmp_path):
    path = written(tmp_path, *MAKES["a name, and commands repeated"])
    run = imported(path, MAP).run
    assert run.markers == pytest.approx(PLACES[:, [2, 0]]) and run.command.shape == (FRAMES, 2)
    assert run.extra["marker_labels"].tolist() == ["m2", "m0"]


@pytest.mark.parametrize("empty", [None, 0, 1])
def test_a_shared_column_that_differs_within_a_frame_is_refused(tmp_path, empty):
    """Also if one marker has no number there."""
    rows = [
        f"{T[k]:.3f},m{m},{xyz(k, m)},{'' if m == empty else round(U[k, 0] + m, 3)},{U[k, 1]:.3f}"
        for k, m in BY_FRAME
    ]
    path = written(tmp_path, "t,marker,x,y,z,u1,u2", rows)
    with pytest.raises(RunError, match="'u1' differs within 40 of 40 frames, .*'m0.u1'"):
        imported(path, MAP)
    mapping = MAP.replace('"u1"', '"m2.u1"')
    assert imported(path, mapping).run.command[:, 0] == pytest.approx(U[:, 0] + 2, abs=1e-3)


def test_a_single_infinite_number_differs_from_the_others_of_its_frame(tmp_path):
    rows = [f"{T[k]:.3f},m{m},{xyz(k, m)},{pulled(k)}" for k, m in BY_FRAME]
    rows[40] = ",".join([*rows[40].split(",")[:-2], "inf", "0.0"])
    with pytest.raises(RunError, match="'u1' differs within 1 of 40 frames"):
        imported(written(tmp_path, "t,marker,x,y,z,u1,u2", rows), MAP)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('frame = "t", ', "", "frame = None, expected a column"),
        ('"marker" }', '["marker", "marker"] }', "expected a column or a list"),
        ('"marker" }', '"markr" }', "no column markr; there are t, marker"),
        ('"marker" }', '"marker", by = 1 }', "by"),
        ('frame = "t"', 'frame = "marker"', "'m0' is not a number"),
        ('"m0.x"', '"m7.x"', "no column m7.x"),
    ],
)
def test_a_wrong_pivot_is_one_error(tmp_path, old, new, message):
    path = written(tmp_path, *MAKES["a name, and commands repeated"])
    with pytest.raises(RunError, match=message):
        imported(path, MAP.replace(old, new))


def test_a_mapping_without_pivot_names_it_where_times_repeat(tmp_path):
    path = written(tmp_path, *MAKES["a name, and commands repeated"])
    text = MAP.replace('pivot = { frame = "t", marker = "marker" }\n', "")
    text = text.replace(', ["m0.x", "m0.y", "m0.z"]', "").replace("m2.", "")
    with pytest.raises(RunError, match="set pivot = .* if the log has a row for each marker"):
        imported(path, text)
    head, rows = MAKES["one marker after another, numbered"]
    path = written(tmp_path, head.replace("cmd_", "u").replace("time", "t").lower(), rows)
    with pytest.raises(RunError, match="set pivot = .* if the log lists one marker after another"):
        imported(path, text)


def test_too_many_names_are_no_markers(tmp_path):
    rows = [f"{T[k % FRAMES]:.3f},name{k},{k},0,0,1,1" for k in range(1500)]
    path = written(tmp_path, "t,marker,x,y,z,u1,u2", rows)
    with pytest.raises(RunError, match="holds 1500 different names, at most 1000"):
        imported(path, MAP)


def test_a_name_as_long_as_a_book_is_refused_before_memory_is_taken(tmp_path):
    rows = [f"{T[k % FRAMES]:.3f},{'m' * 300_000 if k == 5 else 'm'},0,0,0,1,1" for k in range(999)]
    path = written(tmp_path, "t,marker,x,y,z,u1,u2", rows)
    with pytest.raises(RunError, match="its longest text has 300000 characters"):
        imported(path, MAP)


def test_markers_in_a_plane_with_labels_of_the_protocol(tmp_path):
    rows = [
        f'{T[k]:.3f},"tag {m}, left",{PLACES[k, m, 0]},{PLACES[k, m, 2]},{U[k, 0]:.3f},{"ab"[k // 20]}'
        for k, m in BY_FRAME
    ]
    path = written(tmp_path, "t,tag,x,y,u1,phase", rows)
    run = imported(path, guess_mapping([path]).text).run
    assert run.markers.shape == (FRAMES, MARKERS, 3) and str(run.extra["plane"]) in "xyz"
    assert run.block.tolist() == ["a"] * 20 + ["b"] * 20


def test_parts_of_a_long_table(tmp_path):
    head, rows = MAKES["a name, and commands repeated"]
    paths = [tmp_path / "run_1.csv", tmp_path / "run_2.csv"]
    for path, part in zip(paths, (rows[:60], rows[60:])):
        path.write_text("\n".join([head, *part]) + "\n")
    text = guess_mapping(paths).text
    run = import_logs(paths, parse_mapping(text, paths[0])).run
    assert run.markers.shape == (FRAMES, MARKERS, 3)


@pytest.mark.parametrize("head", ["t,marker,x,x,z,u1,u2", "t,marker,x,y,z,m1.x,u2"])
def test_names_that_would_be_there_twice_are_refused(tmp_path, head):
    path = written(tmp_path, head, MAKES["a name, and commands repeated"][1])
    with pytest.raises(RunError, match="two columns would be called 'm[01].x'"):
        imported(path, MAP)
