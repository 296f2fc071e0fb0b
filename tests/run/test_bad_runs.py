"""Runs as they go wrong: each is refused in one line with the remedy, or diagnosed without what is
no measurement.

Every case is a file on the command line. Two robots stand behind them: one that is as its model
says, where nothing may be claimed, and one with play, which has to be found wherever the run still
shows it.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from diagnosed_runs import CANDIDATES, PLAY, diagnosed, scaled, written
from finger_runs import finger_run

from softmap_edge import builtin_model, diagnose
from softmap_edge.cli import main
from softmap_edge.diagnosis.clean import clean_run
from softmap_edge.errors import SoftmapError
from softmap_edge.experiment.blocks import chosen, plan
from softmap_edge.run.protocol import Limits, standard_protocol
from softmap_edge.run.run import Run


def some(fields, index, **change):
    """Keep some frames."""
    return (
        fields | {"t_seen": fields["t_seen"][index], "vertices": fields["vertices"][index]} | change
    )


def wrong(fields, name, index, value):
    array = np.array(fields[name], float)
    array[index] = value
    return fields | {name: array}


def seen_only(fields, pick):
    visible = np.zeros(fields["vertices"].shape[:2], bool)
    visible[pick] = True
    return fields | {"visible": visible}


def swapped_rows(name):
    def change(f):
        array = f[name].copy()
        array[[50, 51]] = array[[51, 50]]
        return f | {name: array}

    return change


def shuffled(axis):
    def change(f):
        order = np.random.default_rng(0).permutation(f["vertices"].shape[axis])
        return f | {"vertices": np.take(f["vertices"], order, axis)}

    return change


REFUSED = {
    "no frame": (lambda f: some(f, slice(0, 0)), "is empty, so nothing was seen"),
    "one frame": (lambda f: some(f, slice(0, 1)), "1 seen frames are too few"),
    "five frames": (lambda f: some(f, slice(0, 5)), "5 seen frames are too few"),
    "one picture": (
        lambda f: f | {"vertices": np.repeat(f["vertices"][:1], 300, 0)},
        "1 usable frames, at least 8",
    ),
    "nothing visible": (
        lambda f: seen_only(f, np.s_[:0]),
        "no point is visible in any of the 300 frames",
    ),
    "a point a frame": (
        lambda f: seen_only(f, np.s_[:, -1]),
        "none of the 300 frames shows enough",
    ),
    "five frames visible": (
        lambda f: seen_only(f, np.s_[:5]),
        "295 of 300 frames are set aside: they show no point",
    ),
    "NaN in time": (lambda f: wrong(f, "t", 9, np.nan), "t: 1 values are not finite"),
    "infinite frame time": (
        lambda f: wrong(f, "t_seen", 9, np.inf),
        "t_seen: 1 values are not finite",
    ),
    "NaN in a command": (
        lambda f: wrong(f, "command", (9, 1), np.nan),
        "command: 1 values are not finite",
    ),
    "NaN in gravity": (
        lambda f: wrong(f, "gravity", (9, 1), np.nan),
        "gravity: 1 values are not finite",
    ),
    "infinite vertex": (
        lambda f: wrong(f, "vertices", (9, 1, 2), np.inf),
        "mark unseen points in `visible`",
    ),
    "NaN in sigma": (lambda f: f | {"sigma": np.array(np.nan)}, "sigma: 1 values are not finite"),
    "sigma of zero": (lambda f: f | {"sigma": np.array(0.0)}, "give the standard deviation"),
    "time goes back": (swapped_rows("t"), "t: time goes backwards at row 51"),
    "frames out of order": (swapped_rows("t_seen"), "t_seen: time goes backwards at row 51"),
    "time stands still": (
        lambda f: wrong(f, "t", 51, f["t"][50]),
        "t: time stands still at row 51",
    ),
    "frames on another clock": (
        lambda f: f | {"t_seen": f["t_seen"] + 1e5},
        "bring both to one clock",
    ),
    "frames in ms": (scaled("t_seen", 1000), "frames are set aside: they were seen up to"),
    "frames half a run late": (lambda f: f | {"t_seen": f["t_seen"] + 60.0}, "frames 60"),
    "a channel too few": (
        lambda f: f | {"command": f["command"][:, :1]},
        "it is a run of another robot",
    ),
    "a channel too many": (
        lambda f: f | {"command": f["command"][:, [0, 1, 0]]},
        "it is a run of another robot",
    ),
    "other points": (
        lambda f: f | {"vertices": f["vertices"][:, :500]},
        "run of another robot or template",
    ),
    "metres": (scaled("vertices", 1e-3), "looks like metres"),
    "centimetres": (scaled("vertices", 0.1), "looks like centimetres"),
    "micrometres": (scaled("vertices", 1e3), "convert the points to mm"),
    "commands in cm": (scaled("command", 0.1), "the commands are in another unit than mm"),
    "commands in tenths of a mm": (scaled("command", 10.0), "3 times the length of 'moe-finger'"),
    "commands in ticks": (scaled("command", 1000.0), "give ticks as `ticks`"),
    "commands in N": (lambda f: f | {"command_unit": np.array("N")}, "a length is not a tension"),
    "every sign turned": (scaled("command", -1.0), "with the opposite sign the commands explain"),
    "a load in mg": (
        lambda f: f | {"load": np.where(f["t"] > 60, 2e4, 0.0)},
        "the run declares a load of up to 2e+04 g",
    ),
    "a negative load": (
        lambda f: f | {"load": np.full(len(f["t"]), -5.0)},
        "give the hanging mass in grams",
    ),
    "kelvin": (lambda f: f | {"temperature": np.array(296.0)}, "subtract 273.15"),
    "gravity in m/s²": (scaled("gravity", 9.81), "divide it by its length"),
    "points in another order": (shuffled(1), "the points are in another order"),
    "mirrored": (scaled("vertices", [-1.0, 1.0, 1.0]), "the points are mirrored"),
    "a frame 12 mm away": (
        lambda f: f | {"vertices": f["vertices"] + [0, 0, 12.0]},
        "frame of reference is 12 mm off",
    ),
    "a frame 30 mm aside": (
        lambda f: f | {"vertices": f["vertices"] + [30.0, 0, 0]},
        "frame of reference is 30 mm off",
    ),
    "in the frame of a camera": (
        lambda f: f | {"vertices": f["vertices"] + [0, 0, 900.0]},
        "`softmap run align`",
    ),
    "clouds": (
        lambda f: (
            {k: v for k, v in f.items() if k != "vertices"}
            | {
                "points": f["vertices"].reshape(-1, 3),
                "start": np.arange(301) * f["vertices"].shape[1],
            }
        ),
        "clouds have no correspondence",
    ),
    "ticks only": (
        lambda f: (
            {k: v for k, v in f.items() if k != "command"}
            | {"ticks": np.rint(f["command"] * 100).astype(int)}
        ),
        "`softmap model calibrate RUN --bundle DIR --out DIR2` calibrates a model of this robot",
    ),
    "nothing seen": (
        lambda f: {k: v for k, v in f.items() if k != "vertices"},
        "the run holds neither",
    ),
}


def repeats(count):
    return lambda f: f | {"vertices": f["vertices"][np.arange(300) // count * count]}


def freezes(f):
    return f | {"vertices": f["vertices"][np.minimum(np.arange(300), 200)]}


def stamped_twice(f):
    twice = some(f, np.repeat(np.arange(300), 2))
    return twice | {"t_seen": twice["t_seen"] + np.tile([0.0, 1e-3], 300)}


def clipped(f):
    return f | {"vertices": np.minimum(f["vertices"], [15.0, np.inf, np.inf])}


def astray(f):
    rng = np.random.default_rng(1)
    hit = rng.random(300) < 0.04
    return wrong(
        f, "vertices", hit, f["vertices"][hit] + 60 * rng.normal(size=(int(hit.sum()), 1, 3))
    )


def astray_points(f):
    rng = np.random.default_rng(1)
    hit = rng.random(f["vertices"].shape[:2]) < 0.02
    return wrong(f, "vertices", hit, f["vertices"][hit] + 40.0)


def gap(f):
    kept = (f["t"] < 60) | (f["t"] > 110)
    return f | {name: f[name][kept] for name in ("t", "command", "gravity")}


def begins_bent(f):
    kept = f["t"] >= f["t_seen"][100]
    return some(f, slice(101, 300)) | {name: f[name][kept] for name in ("t", "command", "gravity")}


# What still shows the play, less what is no measurement: with the remark on it, or None.
TOLERATED = {
    "as it is": (lambda f: f, None),
    "twelve frames": (
        lambda f: some(f, np.linspace(0, 299, 12).astype(int)),
        "12 frames leave too few for validation",
    ),
    "no replicates": (lambda f: some(f, np.arange(0, 300, 8)), "too few repeated poses"),
    "a camera that hangs": (
        repeats(3),
        "200 of 300 frames are set aside: each repeats the picture before",
    ),
    "a camera that stops": (freezes, "99 of 300 frames are set aside: each repeats"),
    "frames stamped twice": (stamped_twice, "300 of 600 frames are set aside: each repeats"),
    "clipped at a border": (clipped, "x is exactly 15 mm in all of them"),
    "frames astray": (astray, "they jump away from their neighbours in time"),
    "points astray": (astray_points, "they jump away from their neighbours in time"),
    "a gap in the commands": (gap, "were seen in a gap of 50"),
    "upper half unseen": (
        lambda f: seen_only(f, np.s_[:, f["vertices"][0, :, 2] < 60]),
        "points are never seen: what acts there only is not tested",
    ),
    "begins bent": (begins_bent, None),
    "time since 1970": (lambda f: f | {"t": f["t"] + 1.7e9, "t_seen": f["t_seen"] + 1.7e9}, None),
    "time in ms": (
        lambda f: f | {"t": f["t"] * 1e3, "t_seen": f["t_seen"] * 1e3},
        "which looks like ms",
    ),
    "another robot's name": (
        lambda f: f | {"robot": np.array("trunk")},
        "the run is one of 'trunk'",
    ),
    "another unit's name": (
        lambda f: f | {"command_unit": np.array("deg")},
        "commands are in deg, the model takes mm",
    ),
    "a load in kg": (lambda f: f | {"load": np.array(0.02)}, "`load` is in grams, not kg"),
    "an absurd sigma": (
        lambda f: f | {"sigma": np.array(500.0)},
        "`sigma` declares 8.7e+02 mm a point",
    ),
    "no gravity": (
        lambda f: {k: v for k, v in some(f, slice(0, 140)).items() if k != "gravity"},
        "the orientation is not declared",
    ),
}


def command(change):
    return lambda f: f | {"command": change(f["command"].copy())}


# Errors that no effect explains: nothing physical may be named, and the verdict names the place to
# look.
UNRELATED = {
    "constant commands": (command(lambda u: np.full_like(u, 5.0)), "the commands never change"),
    "a channel that is not logged": (command(lambda u: u * [1.0, 0.0]), "it never moves"),
    "two channels logged as one": (command(lambda u: u[:, [0, 0]]), "they move together"),
    "commands in m": (scaled("command", 1e-3), "if they are not in mm, set their unit"),
    "frames out of order": (shuffled(0), ""),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_no_fit_could_use_is_refused_in_one_line(case, tmp_path, capsys):
    change, words = REFUSED[case]
    code, document, said = diagnosed(written(tmp_path, change, True), capsys)
    assert code == 2 and document is None
    assert words in said.splitlines()[-1] and len(said.splitlines()[-1]) < 500


@pytest.mark.parametrize("case", TOLERATED)
def test_the_rest_of_a_run_is_diagnosed_and_the_trouble_is_reported(case, tmp_path, capsys):
    change, words = TOLERATED[case]
    for play in (False, True):
        code, document, _ = diagnosed(written(tmp_path, change, play), capsys)
        named = [entry["name"] for entry in [*document["effects"], *document["faults"]]]
        assert code == 0 and named == (["backlash"] if play else []), (
            document["sentence"],
            document["remarks"],
        )
        assert words is None or any(words in remark for remark in document["remarks"]), document[
            "remarks"
        ]
        assert words is not None or document["remarks"] == []


@pytest.mark.parametrize("case", UNRELATED)
def test_what_does_not_follow_the_commands_is_no_physics(case, tmp_path, capsys):
    change, words = UNRELATED[case]
    code, document, _ = diagnosed(written(tmp_path, change, True), capsys)
    assert code == 0 and document["verdict"] == "measurement_fault" and document["effects"] == []
    assert "does not follow the commands" in document["sentence"] and document["alternatives"] == []
    assert ("The commands never change in this log" in document["sentence"]) == (
        case == "constant commands"
    )
    assert not words or any(words in remark for remark in document["remarks"])


def test_a_swapped_servo_is_still_a_fault_that_is_found(tmp_path, capsys):
    change = command(lambda u: u[:, ::-1])
    _, document, _ = diagnosed(written(tmp_path, change, False), capsys)
    assert document["verdict"] == "measurement_fault" and [
        f["name"] for f in document["faults"]
    ] == ["servo_swap"]


@pytest.mark.parametrize("end", [6.0, 8.4])
def test_a_clipped_log_of_commands_is_a_doubt_about_what_is_named(end, tmp_path, capsys):
    _, document, _ = diagnosed(
        written(tmp_path, command(lambda u: np.clip(u, -end, end)), False), capsys
    )
    assert any("the log may be clipped there" in remark for remark in document["remarks"])
    assert f"commands are logged at exactly {-end:g} mm" in document["sentence"]
    assert document["verdict"] != "identified"


HELD_LONG = ["levels of both signs", "staircase with long dwells", "a long dwell"]
SLOW = {
    "creep": {"creep.strength": 0.4, "creep.tau": 8.0},
    "lag": {"lag.tau": 1.0},
    "hysteresis": {"hysteresis.strength": 0.4, "hysteresis.reach": 6.0},
    "gain": {"gain.factor[0]": 0.3},
}


@pytest.mark.parametrize("name", SLOW)
def test_a_command_that_is_really_held_at_its_extreme_is_not_called_clipped(name):
    model = builtin_model()
    made = plan(chosen(HELD_LONG), Limits.of(model.command_range))
    run = Run(
        t=made.t,
        command=made.command,
        t_seen=made.t_seen,
        gravity=made.gravity,
        command_unit="mm",
        vertices=np.repeat(model.rest[None], made.frames, axis=0),
    )
    seen = model.with_effects((name,), SLOW[name]).predict(run)
    ends = np.abs(made.command) >= np.abs(made.command).max(axis=0) - 1e-9
    assert np.mean(ends[np.searchsorted(run.t, run.t_seen) - 1].any(axis=1)) > 0.1
    assert clean_run(model, replace(run, vertices=seen)).doubts == ()


def test_frames_out_of_order_in_a_dwell_are_set_aside_and_hide_nothing(tmp_path, capsys):
    """Five frames of 300 turned round: by themselves a dwell of 10 mm scatter, with which nothing
    would stand out.
    """

    def turned(fields):
        seen = fields["vertices"].copy()
        seen[100:105] = seen[100:105][::-1]
        return fields | {"vertices": seen}

    for play in (False, True):
        _, document, _ = diagnosed(written(tmp_path, turned, play), capsys)
        named = [entry["name"] for entry in document["effects"]]
        assert document["verdict"] != "nothing" and named == (["backlash"] if play else []), (
            document["sentence"]
        )
        assert any(
            "while nothing is commanded the points jump" in remark for remark in document["remarks"]
        )
        assert document["error"]["noise_floor"] < 0.3


def test_a_slow_lag_is_a_lag_and_its_scatter_at_rest_is_reported():
    found = diagnose(
        builtin_model(),
        finger_run(["lag"], {"lag.tau": 2.0}),
        effects=["lag", "rate_limit", "creep"],
    )
    assert found.verdict == "identified" and [entry.name for entry in found.effects] == ["lag"]
    assert any(
        "this counts as noise and hides smaller effects" in remark for remark in found.remarks
    )


def test_a_recording_has_one_place(tmp_path):
    run = finger_run()
    with pytest.raises(SoftmapError, match="same run is given twice"):
        diagnose(builtin_model(), [run, run])
    with pytest.raises(SoftmapError, match="validates nothing"):
        diagnose(builtin_model(), run, run)
    with pytest.raises(SoftmapError, match="the reference is the run itself"):
        diagnose(builtin_model(), run, reference=[run])
    run.save(tmp_path / "run.npz")
    (tmp_path / "d.json").write_text("{}")
    argv = [
        "diagnose",
        str(tmp_path / "run.npz"),
        "--since",
        str(tmp_path / "d.json"),
        "--out",
        str(tmp_path / "d.json"),
    ]
    assert main(argv) == 2 and (tmp_path / "d.json").read_text() == "{}"


def test_the_report_prints_the_remarks(tmp_path, capsys):
    path = written(tmp_path, freezes, True)
    page = tmp_path / "page.html"
    assert main(["diagnose", str(path), "--effects", CANDIDATES, "--html", str(page)]) == 0
    assert "About the run" in capsys.readouterr().out
    assert (
        "About the run" in page.read_text() and "99 of 300 frames are set aside" in page.read_text()
    )


def test_a_run_without_noise_that_rests_in_a_play_is_left_alone():
    """The same pose again and again is what a model without noise shows; nothing of it is a camera
    that hangs.
    """
    p, model = standard_protocol(), builtin_model().with_effects(("backlash",), PLAY)
    run = Run(t=p.t, command=p.command, gravity=p.gravity, t_seen=p.t_seen)
    run = Run(**{**run.arrays(), "command_unit": "mm", "vertices": model.predict(run)})
    found = clean_run(builtin_model(), run)
    assert found.run.frames == run.frames and found.run.visible is None and found.remarks == ()


@pytest.mark.parametrize(
    "case", ["no frame", "nothing visible", "other points", "metres", "a channel too few"]
)
def test_compare_refuses_in_one_line_too(case, tmp_path, capsys):
    assert main(["compare", str(written(tmp_path, REFUSED[case][0], True)), "--json"]) == 2
    out, said = capsys.readouterr()
    assert out == "" and len(said.splitlines()) == 1


@pytest.mark.parametrize(
    "case", ["a camera that stops", "a load in kg", "another robot's name", "time in ms"]
)
def test_compare_goes_on_and_says_what_a_diagnosis_would(case, tmp_path, capsys):
    change, words = TOLERATED[case]
    assert main(["compare", str(written(tmp_path, change, True)), "--json"]) == 0
    out, said = capsys.readouterr()
    assert json.loads(out)["frames"] == 300 and words in said


def test_compare_says_that_the_commands_never_change(tmp_path, capsys):
    assert (
        main(["compare", str(written(tmp_path, command(lambda u: 0.0 * u + 3.0), True)), "--json"])
        == 0
    )
    assert "the commands never change" in capsys.readouterr().err
    assert main(["compare", str(written(tmp_path, command(lambda u: u), True)), "--json"]) == 0
    assert "never change" not in capsys.readouterr().err


def test_compare_says_that_points_are_mirrored(tmp_path, capsys):
    change, words = REFUSED["mirrored"]
    assert main(["compare", str(written(tmp_path, change, True)), "--json"]) == 0
    assert words in capsys.readouterr().err
