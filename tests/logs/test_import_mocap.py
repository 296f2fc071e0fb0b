"""TRC, Motive's CSV and C3D become runs by the same mapping: labels, units, dropouts, rates;
damaged ones do not.
"""

import time

import numpy as np
import pytest
from logs import published
from recordings import LABELS, places, write_c3d, write_motive, write_trc

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.table import open_log

MAP = """schema = "softmap.mapping/1"
[[log]]
time = { column = "time" }
markers = { columns = ["base.x", "base.y", "base.z", "middle.x", "middle.y", "middle.z", "tip.x", "tip.y", "tip.z"] }
"""
FORMATS = {
    "trc": (write_trc, "take.trc", {"mm": "mm", "m": "m"}, 2e-6),
    "motive": (write_motive, "take.csv", {"mm": "Millimeters", "m": "Meters"}, 2e-6),
    "c3d": (write_c3d, "take.c3d", {"mm": "mm", "m": "m"}, 1e-4),
}


def taken(folder, path, mapping=MAP):
    (folder / "map.toml").write_text(mapping)
    return import_logs([path], read_mapping(folder / "map.toml"))


def take(folder, form, unit, points, t):
    write, name, units, tolerance = FORMATS[form]
    return write(folder / name, t, points / (1000 if unit == "m" else 1), units[unit]), tolerance


@pytest.mark.parametrize("unit", ["mm", "m"])
@pytest.mark.parametrize("form", FORMATS)
def test_markers_come_in_mm_with_their_names(tmp_path, form, unit):
    t, points = places()
    path, tolerance = take(tmp_path, form, unit, points, t)
    done = taken(tmp_path, path)
    run = done.run
    assert run.markers == pytest.approx(points, abs=tolerance * 1000 if unit == "m" else tolerance)
    assert run.t_seen == pytest.approx(t, abs=1e-6) and run.channels == 0
    assert list(run.extra["marker_labels"]) == list(LABELS)
    assert all("without commands" in doubt for doubt in done.doubts)


@pytest.mark.parametrize("form", FORMATS)
def test_what_was_not_seen_is_not_visible(tmp_path, form):
    t, points = places()
    points[10:15, 2] = np.nan
    points[30] = np.nan
    path, tolerance = take(tmp_path, form, "mm", points, t)
    done = taken(tmp_path, path)
    assert done.run.frames == 59  # a frame of nothing is no frame
    assert not done.run.visible[10:15, 2].any() and done.run.visible.sum() == 59 * 3 - 5
    assert any("tip 8.5 %" in note for note in done.notes)
    assert done.run.markers[0] == pytest.approx(points[0], abs=tolerance)


@pytest.mark.parametrize("form", FORMATS)
def test_the_unit_of_the_file_is_followed_or_doubted(tmp_path, form):
    t, points = places()
    path, _ = take(tmp_path, form, "m", points, t)
    said = taken(tmp_path, path, MAP.replace('"tip.z"]', '"tip.z"], unit = "cm"'))
    assert any("the file states m, the mapping cm" in doubt for doubt in said.doubts)
    with pytest.raises(RunError, match="the file states m, the mapping mm"):
        taken(tmp_path, path, MAP.replace('"tip.z"]', '"tip.z"], unit = "mm"'))


def test_motive_distinguishes_rigid_bodies_from_markers(tmp_path):
    t, points = places()
    columns = open_log(write_motive(tmp_path / "take.csv", t, points / 1000))
    assert {"Plate.x", "Plate.rotation.w", "Plate.Mean Marker Error", "tip.z"} <= set(columns.names)
    assert columns.units["Plate.x"] == "m" and "Plate.rotation.w" not in columns.units


def test_two_c3d_markers_of_one_name_stay_two(tmp_path):
    t, points = places()
    names = open_log(write_c3d(tmp_path / "take.c3d", t, points, labels=("a", "a", ""))).names
    assert names[2:] == [f"{label}.{axis}" for label in ("a", "a #1", "marker 2") for axis in "xyz"]


@pytest.mark.parametrize(
    ("form", "change", "words"),
    [
        (
            "trc",
            lambda b: b.replace(b"Frame#", b"Farme"),
            ["line", "Frame#, Time and markers", "export it again"],
        ),
        ("trc", lambda b: b.replace(b"\tX3\tY3\tZ3", b""), ["3 markers, line 5 has 6"]),
        ("trc", lambda b: b"\n".join(b.split(b"\n")[:6]), ["holds no frames"]),
        ("trc", lambda b: b[:-30], ["cells, expected 11"]),
        (
            "motive",
            lambda b: b.replace(b"Name,Plate", b"Nome,Plate"),
            ["not a CSV export of Motive"],
        ),
        ("motive", lambda b: b"\n".join(b.split(b"\n")[:7]), ["holds no frames"]),
        ("c3d", lambda b: b[:100], ["is not a C3D file"]),
        ("c3d", lambda b: b"\x02\x51" + b[2:], ["is not a C3D file"]),
        ("c3d", lambda b: b[:700], ["C3D file"]),
    ],
)
def test_damaged_files_are_refused_in_one_line(tmp_path, form, change, words):
    t, points = places()
    path, _ = take(tmp_path, form, "mm", points, t)
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(RunError) as fault:
        taken(tmp_path, path)
    assert "\n" not in str(fault.value) and all(word in str(fault.value) for word in words), str(
        fault.value
    )


def test_a_c3d_file_that_ends_early_is_read_as_far_as_it_goes(tmp_path):
    t, points = places()
    path = write_c3d(tmp_path / "take.c3d", t, points)
    path.write_bytes(path.read_bytes()[:-1024])
    try:
        done = taken(tmp_path, path)
        assert 20 < done.run.frames < 60 and any("early" in note for note in done.notes)
    except RunError as fault:
        assert "do not fit" in str(fault)


def test_a_missing_package_says_what_to_install(tmp_path, monkeypatch):
    t, points = places()
    path = write_c3d(tmp_path / "take.c3d", t, points)
    monkeypatch.setitem(__import__("sys").modules, "c3d", None)
    with pytest.raises(RunError, match=r"pip install 'softmap-edge\[logs\]'"):
        taken(tmp_path, path)


def test_a_head_of_very_many_columns_is_read_in_linear_time(tmp_path):
    """What a damaged head may hold within one line; compared by pairs, its names alone would take
    minutes.
    """
    count = 40_000
    rows = [
        ["Format Version", "1.23"],
        ["", "Name", *map(str, range(count))],
        ["", "", *["Position"] * count],
        ["Frame", "Time", *["X"] * count],
        ["0", "0.0", *["1"] * count],
    ]
    path = tmp_path / "wide.csv"
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")
    began = time.process_time()
    assert len(open_log(path).names) == count + 2
    with pytest.raises(RunError, match="40002 columns, at most 4096"):
        guess_mapping([path])
    assert time.process_time() - began < 5.0  # 0.3 s; 8·10⁸ comparisons of names take 20 s


# --- the beam ------------------------------------------------------------------------------
BEAM = """schema = "softmap.mapping/1"
robot = "silicone-beam"
[[log]]
time = {{ column = "time" }}
markers = {{ columns = [{}] }}
base = {{ columns = [{}] }}
"""


def test_the_beam_falls_under_gravity_and_further_with_a_load(tmp_path):
    """Published recordings: nothing is commanded, six labelled markers at 100 Hz in m; the tip
    falls along -x.
    """
    named = {kind: [f"{kind} - {k}" for k in (1, 2, 3)] for kind in ("Tip", "Base")}
    columns = [
        ", ".join(str([f"{name}.{axis}" for axis in "xyz"]) for name in names)
        for names in named.values()
    ]
    drop = {}
    for name in ("gravity_V2_a", "load52_V2_a", "load101_V2_a"):
        done = taken(tmp_path, published("beam") / f"beam_{name}.c3d", BEAM.format(*columns))
        run = done.run
        base = run.extra["base_markers"]
        assert (run.channels, run.markers.shape[1], base.shape[1]) == (0, 3, 3) and np.diff(
            run.t_seen
        ) == pytest.approx(0.01)
        assert list(run.extra["marker_labels"]) == named["Tip"] and all(
            "without commands" in doubt for doubt in done.doubts
        )
        tip = run.markers.mean(axis=1) - base.mean(axis=1)
        assert 85 < tip[0, 2] < 100  # mm from the base along +z
        drop[name] = tip[0] - tip[-100:].mean(axis=0)
    assert [round(float(d[0])) for d in drop.values()] == pytest.approx([6, 16, 25], abs=1.5)


@pytest.mark.parametrize("kept", [59, 31, 12])
@pytest.mark.parametrize("form", ["trc", "motive"])
def test_frames_that_the_head_states_and_the_file_lacks_are_doubted(form, kept, tmp_path):
    t, points = places()
    if form == "trc":
        path = write_trc(tmp_path / "log.trc", t, points)
    else:
        path = write_motive(tmp_path / "log.csv", t, points / 1000)
        text = path.read_text("utf-8-sig")
        head = text.replace("Length Units", "Total Exported Frames,60,Length Units", 1)
        path.write_text(head, "utf-8-sig")
    lines = path.read_text("utf-8-sig").rstrip("\n").split("\n")
    mapping = 'schema = "softmap.mapping/1"\n[[log]]\ntime = { column = "time" }\n'
    mapping += 'markers = { columns = [["tip.x", "tip.y", "tip.z"]] }\n'
    assert not any(
        "head states" in d for d in import_logs([path], parse_mapping(mapping, path)).doubts
    )
    path.write_text("\n".join(lines[: len(lines) - 60 + kept]) + "\n", "utf-8-sig")
    done = import_logs([path], parse_mapping(mapping, path))
    assert done.run.frames == kept
    (doubt,) = [one for one in done.doubts if "head states" in one]
    assert f"60 frames, the file holds {kept}: {60 - kept} are missing" in doubt
