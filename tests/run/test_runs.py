"""A run is checked, saved, cut and described; each fault is one line that names the field and the
remedy.
"""

import dataclasses
import io
import json
import zipfile
from typing import get_args

import numpy as np
import pytest
from sound_run import C, K, N, T, fields, sound

from softmap_edge.cli import main
from softmap_edge.errors import RunError
from softmap_edge.run.fields import AXES, FieldName, RealField
from softmap_edge.run.run import Run


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            dict(t=np.arange(T)[::-1] * 0.25),
            ["t: time goes backwards at row 1", "14.5 s after 14.75 s", "sort"],
        ),
        (dict(t=np.r_[0.0, np.arange(T - 1)]), ["t: time stands still at row 1", "drop repeated"]),
        (
            dict(t_seen=np.r_[np.nan, fields()["t_seen"][1:]]),
            ["t_seen: 1 values are not finite", "[0]"],
        ),
        (
            dict(command=np.zeros((T, 3)), present=np.zeros((T, 2))),
            ["present: shape (60, 2)", "C = 3 from command"],
        ),
        (dict(command=np.zeros(T)), ["command: shape (60,)", "(T, C)", "T = 60 from t", "column"]),
        (dict(command=np.zeros((C, T)), present=None), ["command: shape (2, 60)", "transposed"]),
        (dict(command=np.full((T, C), np.inf)), ["command: 120 values are not finite"]),
        (dict(command=np.full((T, C), 2048.0)), ["command: up to 2048 mm", "ticks"]),
        (dict(command=[["a", "b"]] * T), ["command: values of type <U1", "real numbers"]),
        (dict(command=[[1.0], [1.0, 2.0]]), ["command: is not a rectangular array"]),
        (dict(ticks=np.zeros((T, C), int)), ["command and ticks", "one of the two"]),
        (dict(command=None, ticks=np.full((T, C), 0.5)), ["ticks: fractions", "command"]),
        (
            dict(markers=np.zeros((K, N, 2))),
            ["markers: shape (12, 5, 2)", "(K, N, 3) with K = 12", "x, y, z"],
        ),
        (
            dict(markers=fields()["markers"][:-1]),
            ["markers: shape (11, 5, 3)", "K = 12 from t_seen"],
        ),
        (
            dict(markers=fields()["markers"] / 1000, marker_rest=None),
            ["markers: all points lie within", "metres", "1000"],
        ),
        (
            dict(markers=fields()["markers"] * 1000),
            ["markers: ", "expected -10000 to 10000 mm", "convert"],
        ),
        (
            dict(markers=np.full((K, N, 3), np.nan)),
            ["markers: 180 values are not finite", "visible"],
        ),
        (
            dict(vertices=fields()["markers"]),
            ["vertices and markers", "one of vertices, markers, points"],
        ),
        (dict(visible=np.ones((K, 3), bool)), ["visible: shape (12, 3)", "N = 5 from markers"]),
        (dict(visible=np.full((K, N), 2)), ["visible: values other than 0 and 1"]),
        (dict(sigma=np.array(-1.0)), ["sigma: -1 mm", "standard deviation"]),
        (dict(sigma=np.ones((K, 2))), ["sigma: shape (12, 2)", "N = 5"]),
        (dict(gravity=np.array([0, 0, 9.81])), ["gravity: length 9.81", "unit vector"]),
        (dict(gravity=np.zeros(3)), ["gravity: length 0", "unit vector"]),
        (dict(gravity=np.zeros((T, 2))), ["gravity: shape (60, 2)"]),
        (dict(load=np.full(T, -5.0)), ["load: -5 g", "grams"]),
        (dict(temperature=np.full(T, 295.0)), ["temperature: 295 °C", "273.15"]),
        (dict(block=np.arange(K - 1)), ["block: shape (11,)", "K = 12"]),
        (dict(block=np.linspace(0, 1, K)), ["block: labels of type float64", "integers or text"]),
        (dict(marker_rest=np.zeros((N, 2))), ["marker_rest: shape (5, 2)"]),
        (dict(markers=None, visible=None, points=np.ones((7, 3))), ["start: missing", "K + 1"]),
        (
            dict(markers=None, visible=None, points=np.ones((7, 3)), start=np.arange(K + 1)),
            ["start: runs from 0 to 12", "P = 7"],
        ),
        (dict(markers=None), ["visible: given for each point", "no vertices or markers"]),
        (
            dict(t_seen=fields()["t_seen"] + 1e6),
            ["t_seen: 1000001 to 1000015 s", "outside the commands", "one clock"],
        ),
        (
            dict(
                t=np.zeros(0), command=None, present=None, current=None, temperature=None, load=None
            ),
            ["t: empty"],
        ),
        (dict(command_unit=""), ["command_unit"]),
    ],
)
def test_each_fault_is_one_line_that_names_field_and_remedy(change, words):
    with pytest.raises(RunError) as fault:
        sound(**change)
    message = str(fault.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_sound_run_has_no_fault_and_knows_its_sizes():
    run = sound()
    assert (run.channels, run.frames, run.seen_points.shape) == (C, K, (K, N, 3))
    assert run.validate() is None
    with pytest.raises(ValueError, match="read-only"):
        run.command[0, 0] = 1.0


def test_the_names_of_fields_are_those_of_the_table():
    assert set(get_args(FieldName)) == set(AXES)
    assert set(get_args(RealField)) == {name for name, (_, kind) in AXES.items() if kind == "real"}
    run = sound()
    assert all(run.array(name) is getattr(run, name) for name in AXES)


@pytest.mark.parametrize("kind", ["vertices", "markers", "points", None])
def test_a_run_says_which_field_holds_what_was_seen(kind):
    points = np.random.default_rng(0).normal(size=(4, 5, 3)) * 20.0
    clouds = {"points": points.reshape(-1, 3), "start": np.arange(5) * 5}
    seen = {} if kind is None else clouds if kind == "points" else {kind: points}
    run = Run(t=np.arange(4.0), t_seen=np.arange(4.0), **seen)
    assert run.seen == kind
    assert run.places is (run.array(kind) if kind in ("vertices", "markers") else None)


def test_nan_is_allowed_only_where_not_visible():
    markers = fields()["markers"].copy()
    markers[3, 2] = np.nan
    visible = np.ones((K, N), bool)
    with pytest.raises(RunError, match="3 values are not finite"):
        sound(markers=markers, visible=visible)
    visible[3, 2] = False
    assert np.isnan(sound(markers=markers, visible=visible).markers[3, 2]).all()


def test_nothing_commanded_and_nothing_seen_are_valid(tmp_path):
    still = Run(t=np.arange(4.0), t_seen=np.arange(4.0), markers=fields()["markers"][:4])
    blind = Run(t=np.arange(4.0), command=np.ones((4, 2)))
    for run, size in ((still, (0, 4)), (blind, (2, 0))):
        run.save(tmp_path / "run.npz")
        again = Run.load(tmp_path / "run.npz")
        assert (again.channels, again.frames) == size
        assert again.hash() == run.hash()
    assert still.command.shape == (4, 0)
    assert still.command_at([0.5, 9.0]).shape == (2, 0)


def test_a_file_without_command_times_takes_those_of_the_frames(tmp_path):
    np.savez(tmp_path / "still.npz", t_seen=np.arange(4.0), markers=fields()["markers"][:4])
    assert np.array_equal(Run.load(tmp_path / "still.npz").t, np.arange(4.0))
    np.savez(tmp_path / "bad.npz", t_seen=np.arange(4.0), command=np.zeros((4, 1)))
    with pytest.raises(RunError, match="t: missing"):
        Run.load(tmp_path / "bad.npz")


def test_what_is_saved_comes_back_with_unknown_fields_and_equal_bytes(tmp_path):
    run = sound(
        extra={"wind": np.arange(3.0), "camera": np.array("left")}, sigma=np.full((K, N), 0.2)
    )
    run.save(tmp_path / "a.npz")
    again = Run.load(tmp_path / "a.npz")
    for name, array in run.arrays().items():
        assert np.array_equal(again.arrays()[name], array), name
    assert set(again.extra) == {"wind", "camera"}
    assert again.robot == "bench finger"
    again.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert again.hash() == run.hash() != sound().hash()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "b.npz"]


def test_one_number_stands_for_a_constant_load_and_temperature(tmp_path):
    run = sound(load=5.0, temperature=30.0)
    assert np.array_equal(run.load, np.full(T, 5.0))
    np.savez(tmp_path / "plain.npz", **{**fields(), "load": 5.0, "robot": "x"})
    assert np.array_equal(Run.load(tmp_path / "plain.npz").load, np.full(T, 5.0))


def test_frames_are_chosen_and_commands_stay():
    run = sound(sigma=np.arange(K * N, dtype=float).reshape(K, N) + 1)
    part = run.at(run.block == 1)
    assert part.frames == 4 and len(part.t) == T
    assert np.array_equal(part.markers, run.markers[4:8])
    assert np.array_equal(part.sigma, run.sigma[4:8])
    assert np.array_equal(run.at([0, 11]).t_seen, run.t_seen[[0, 11]])
    assert run.at([]).frames == 0
    base = np.arange(K * 6, dtype=float).reshape(K, 2, 3)
    with_base = sound(extra={"base_markers": base, "wind": np.arange(K)}).at([3, 5])
    assert (
        np.array_equal(with_base.extra["base_markers"], base[[3, 5]])
        and len(with_base.extra["wind"]) == K
    )
    for bad in (np.ones(3, bool), [12], [0.5]):
        with pytest.raises(RunError, match="select"):
            run.at(bad)


def test_clouds_are_chosen_completely():
    start = np.array([0, 2, 2, 5])
    run = Run(
        t=[0.0, 3.0], t_seen=[0.0, 1.0, 2.0], points=np.arange(15.0).reshape(5, 3), start=start
    )
    part = run.at([1, 2])
    assert np.array_equal(part.start, [0, 0, 3])
    assert np.array_equal(part.points, run.points[2:])
    with pytest.raises(RunError, match="no correspondence"):
        _ = run.seen_points


def test_a_slice_of_time_keeps_the_command_that_still_holds():
    run = sound()
    part = run.slice_time(3.1, 6.0)
    assert (part.t[0], part.t[-1]) == (3.0, 5.75)
    assert part.t_seen.min() >= 3.1 and part.t_seen.max() < 6.0
    assert np.array_equal(part.command, run.command[12:24])
    assert np.array_equal(part.gravity, run.gravity)
    with pytest.raises(RunError, match="no rows"):
        run.slice_time(5.0, 5.0)
    with pytest.raises(RunError, match="lasts from 0 to 14.75"):
        run.slice_time(-3.0, -1.0)


def test_commands_between_rows_and_by_source():
    run = sound()
    # halfway up a step of one row
    assert run.command_at([2.375]) == pytest.approx(np.array([[4.0, -1.5]]))
    assert np.array_equal(run.command_at([-1.0, 99.0]), run.command[[0, -1]])
    assert run.commands() is run.present and run.commands("goal") is run.command
    assert dataclasses.replace(run, present=None).commands() is not None
    with pytest.raises(RunError, match="no encoder positions"):
        dataclasses.replace(run, present=None).commands("present")
    with pytest.raises(RunError, match="holds ticks"):
        Run(t=[0.0, 1.0], ticks=np.zeros((2, 1), int)).commands()


def write_entry(path, header, data=b"", name="t.npy", version=b"\x01\x00", fill=None):
    text = header.encode("latin1")
    raw = b"\x93NUMPY" + version + len(text).to_bytes(2, "little") + text + data
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, raw if fill is None else fill)


def test_headers_are_not_trusted(tmp_path):
    path = tmp_path / "bomb.npz"
    write_entry(path, "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,)}\n")
    with pytest.raises(RunError, match=r"bomb\.npz.*8000000000000 bytes"):
        Run.load(path)
    write_entry(path, "", fill=bytes(40 * 2**20))  # 40 MiB of zeros in 40 kB
    assert path.stat().st_size < 100_000
    with pytest.raises(RunError, match="at most 1048576"):
        Run.load(path, limit=2**20)
    write_entry(path, "{'descr': '|O', 'fortran_order': False, 'shape': (1,)}\n", b"cos\nsystem\n")
    with pytest.raises(RunError, match="objects"):
        Run.load(path)
    np.savez(path, t=np.array([{"a": 1}], dtype=object))
    with pytest.raises(RunError, match="objects"):
        Run.load(path)


@pytest.mark.parametrize("content", [b"", b"PK", b"not a zip at all" * 10])
def test_what_is_no_archive_is_reported(tmp_path, content):
    (tmp_path / "x.npz").write_bytes(content)
    with pytest.raises(RunError, match=r"x\.npz"):
        Run.load(tmp_path / "x.npz")
    with pytest.raises(RunError, match="no such file"):
        Run.load(tmp_path / "absent.npz")
    with pytest.raises(RunError):
        Run.load(tmp_path)
    (tmp_path / "log.csv").write_bytes(content)
    with pytest.raises(RunError, match="a log becomes a run with `softmap import`"):
        Run.load(tmp_path / "log.csv")
    for name in ("d.json", "page.html", "map.TOML"):  # nothing that an import could read
        (tmp_path / name).write_bytes(content)
        with pytest.raises(RunError, match=r"give a run \(.npz\) or a recording \(.mcap\)$"):
            Run.load(tmp_path / name)


def test_every_shorter_file_is_refused(tmp_path):
    sound().save(tmp_path / "run.npz")
    whole = (tmp_path / "run.npz").read_bytes()
    for length in range(0, len(whole), max(1, len(whole) // 40)):
        (tmp_path / "cut.npz").write_bytes(whole[:length])
        with pytest.raises(RunError, match=r"cut\.npz"):
            Run.load(tmp_path / "cut.npz")


def test_check_says_what_a_run_holds(tmp_path, capsys):
    sound().save(tmp_path / "run.npz")
    assert main(["check", str(tmp_path / "run.npz"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert next(iter(document)) == "schema" and document["schema"] == "softmap.check/1"
    assert (document["channels"], document["frames"], document["rate_hz"]) == (2, 12, 4.0)
    assert document["command_range"] == [[0.0, 8.0], [-3.0, 0.0]]
    assert document["home_visits"] == 3 and document["places_revisited"] == 1
    assert document["missing"] == []
    assert main(["check", str(tmp_path / "run.npz")]) == 0
    text = capsys.readouterr().out
    assert "2 channels" in text and "12 frames of 5 markers" in text and "visits of home: 3" in text


def test_check_names_what_is_missing_and_fails_on_a_fault(tmp_path, capsys):
    Run(t=np.arange(4.0), command=np.arange(4.0)[:, None]).save(tmp_path / "blind.npz")
    assert main(["check", str(tmp_path / "blind.npz"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert "gravity" in " ".join(document["missing"])
    assert (
        document["cannot_tell"][0]["text"] == "anything: no frame was seen"
        and document["can_tell"] == []
    )
    np.savez(tmp_path / "bad.npz", t=[0.0, 1.0], command=np.zeros((3, 1)))
    assert main(["check", str(tmp_path / "bad.npz")]) == 1
    assert "command: shape (3, 1)" in capsys.readouterr().err
    assert main(["check", str(tmp_path / "bad.npz"), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["sound"] is False
    assert main(["check", str(tmp_path / "absent.npz")]) == 2


def test_show_lists_every_field(tmp_path, capsys):
    sound(extra={"wind": np.arange(3.0)}).save(tmp_path / "run.npz")
    assert main(["show", str(tmp_path / "run.npz"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "softmap.show/1"
    by_name = {field["name"]: field for field in document["fields"]}
    assert by_name["markers"]["shape"] == [K, N, 3] and by_name["wind"]["high"] == 2.0
    assert main(["show", str(tmp_path / "run.npz")]) == 0
    shown = capsys.readouterr().out
    assert "markers" in shown and "█" in shown


def test_a_stream_of_numbers_survives_any_byte_order(tmp_path):
    packed = {name: np.asarray(value) for name, value in fields().items()}
    packed["command"] = packed["command"].astype(">f4")
    packed["markers"] = np.asfortranarray(packed["markers"])
    with io.BytesIO() as stream:
        np.savez_compressed(stream, **packed)
        (tmp_path / "other.npz").write_bytes(stream.getvalue())
    again = Run.load(tmp_path / "other.npz")
    assert again.command.dtype == np.float64 and np.array_equal(again.command, fields()["command"])
    assert np.array_equal(again.markers, fields()["markers"])


def test_check_and_show_take_a_bundle_too(tmp_path, capsys):
    from softmap_edge.model.bundle import builtin_model, save_bundle

    folder = save_bundle(builtin_model(), tmp_path / "finger")
    assert main(["check", str(folder), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["kind"], document["sound"], document["manifest"]["channels"]) == (
        "bundle",
        True,
        2,
    )
    assert main(["show", str(folder)]) == 0
    assert "held_out_error_mm" in capsys.readouterr().out
    (folder / "prior.npz").write_bytes(b"damaged")
    assert main(["check", str(folder)]) == 1
    assert "prior.npz" in capsys.readouterr().err


def test_text_that_is_no_text_is_refused(tmp_path):
    label = np.zeros(12, "<U3")
    label.view(np.uint32)[1] = 0x7FFFFFFF
    np.savez(tmp_path / "run.npz", **(fields() | {"block": label}))
    with pytest.raises(RunError, match="block.*text that is not Unicode"):
        Run.load(tmp_path / "run.npz")
