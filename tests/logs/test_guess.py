"""`softmap import --guess` proposes a mapping that imports, reports what it assumed and what no
log shows.
"""

import json
import re
import tomllib

import numpy as np
import pytest
from logs import ROOT, made_log, published
from recordings import places, robot_messages, write_c3d, write_mcap, write_motive, write_trc

from softmap_edge.cli import main
from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs, read_mapping


def imported(folder, found, paths):
    """The run of a proposal, and what the import says of it."""
    (folder / "map.toml").write_text(found.text, encoding="utf-8")
    return import_logs(paths, read_mapping(folder / "map.toml"))


def written(folder, text, name="log.csv"):
    (folder / name).write_text(text)
    return folder / name


def reported(lines, *words):
    return any(all(word in line for word in words) for line in lines)


# --- published logs ------------------------------------------------------------------------
def test_the_trunk(tmp_path):
    """Two files, a counter, commands and encoders in degrees, three bodies in metres, y up,
    hanging.
    """
    folder = published("trunk")
    logs = [folder / "control_inputs_controlled_1.csv", folder / "observations_controlled_1.csv"]
    found = guess_mapping(logs)
    done = imported(tmp_path, found, logs)
    right = import_logs(logs, read_mapping(ROOT / "examples" / "trunk.toml")).run
    run = done.run
    *rates, held = done.doubts  # single frames of Motive, equal to the one before to the last digit
    assert len(rates) == 2 and all("a rate that is assumed" in doubt for doubt in rates)
    assert "marker 1 105, marker 3 14" in held
    assert run.command_unit == "deg"
    for name in ("t", "command", "present", "t_seen", "block"):
        assert np.array_equal(getattr(run, name), getattr(right, name)), name
    shift = run.markers - right.markers  # the place of the clamp is a guess, and is reported as one
    assert np.nanmax(np.abs(shift - shift[0])) < 1e-9 and np.linalg.norm(shift[0, 0]) < 5.0
    # the example keeps them
    assert np.isnan(run.markers).any() and not np.isnan(right.markers).any()
    assert reported(found.unknown, "how fast 'ID' counts", "100 Hz") and reported(
        found.unknown, "where the clamp is"
    )
    assert reported(found.unknown, "gravity is not declared") and reported(
        found.unknown, "radius of the spools"
    )
    assert reported(found.assumed, "encoders: in deg", "12-bit servo") and reported(
        found.assumed, "runs along -y"
    )
    assert reported(found.said, "79 % of the rows repeat")


@pytest.mark.parametrize("name", ["val.csv", "train.csv"])
def test_the_tdcr(tmp_path, name):
    """Nine tendons named by servo, out of order: the order of the file is kept; a tip; labels of
    patterns.
    """
    path = published("tdcr") / name
    found = guess_mapping([path])
    done = imported(tmp_path, found, [path])
    raw = np.genfromtxt(path, delimiter=",", skip_header=1)
    run = done.run
    assert run.command_unit == "mm" and np.array_equal(run.command, raw[:, 2:11])
    assert run.markers[:, 0] == pytest.approx(raw[:, 11:], abs=1e-9) and run.present is None
    assert run.t == pytest.approx(raw[:, 0] - raw[0, 0], abs=1e-6) and done.doubts == ()
    assert len(set(run.block)) == len(
        {line.split(",")[1] for line in path.read_text().splitlines()[1:]}
    )
    assert reported(found.assumed, "in the order of the file") and reported(
        found.assumed, "'pattern_label'"
    )


def test_the_beam(tmp_path):
    path = published("beam") / "beam_load52_V2_a.c3d"
    found = guess_mapping([path])
    done = imported(tmp_path, found, [path])
    assert (done.run.channels, done.run.frames) == (0, 600) and all(
        "without commands" in doubt for doubt in done.doubts
    )
    assert list(done.run.extra["marker_labels"]) == ["Tip - 1", "Tip - 2", "Tip - 3"]
    assert done.run.extra["base_markers"].shape == (600, 3, 3)
    # the base frame is at the clamp, z to the tip
    assert np.median(done.run.markers, axis=(0, 1))[2] > 80
    assert reported(found.unknown, "what was commanded") and reported(
        found.assumed, "softmap run align", "b0:X,Y,Z"
    )


# --- recordings of motion capture and ROS --------------------------------------------------
@pytest.mark.parametrize(
    ("write", "name", "unit"),
    [(write_trc, "a.trc", "mm"), (write_motive, "a.csv", "Meters"), (write_c3d, "a.c3d", "m")],
)
def test_motion_capture(tmp_path, write, name, unit):
    t, points = places()
    points[20:25, 1] = np.nan
    turned = np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)  # y up, hanging
    path = write(tmp_path / name, t, turned / (1 if unit == "mm" else 1000), unit)
    found = guess_mapping([path])
    done = imported(tmp_path, found, [path])
    assert all("without commands" in doubt for doubt in done.doubts) and done.run.markers.shape == (
        60,
        2,
        3,
    )
    # from the marker "base"
    assert np.nanmedian(done.run.markers[:, 1], axis=0)[2] == pytest.approx(120.0, abs=0.1)
    assert 'axes = ["x", "z", "-y"]' in found.text and 'unit = "file"' in found.text
    assert done.run.visible.sum() == 120 - 5 and reported(
        found.assumed, "1 markers are on the clamp"
    )


def test_a_recording_of_ros(tmp_path):
    path = write_mcap(tmp_path / "run.mcap", robot_messages(200))
    found = guess_mapping([path])
    run = imported(tmp_path, found, [path]).run
    assert run.command_unit == "rad" and run.channels == 2 and run.markers.shape[1] in (2, 3)
    assert run.present[:-1] == pytest.approx(0.9 * run.command[:-1], abs=0.01) and run.t[0] == 0.0
    assert 'topic = "/goal"' in found.text and 'topic = "/joint_states"' in found.text


# --- logs of a laboratory ------------------------------------------------------------------
def bench_log(head, t, u, points, mark=","):
    rows = np.column_stack([t, u, points.reshape(len(t), -1)])
    return mark.join(head) + "\n" + "\n".join(mark.join(f"{x:.9g}" for x in row) for row in rows)


XYZ = [f"m{k}_{axis}" for k in range(3) for axis in "xyz"]


@pytest.mark.parametrize(
    ("head", "scale", "words"),
    [
        (
            ["time_ms", "cmd_1_deg", "cmd_2_deg"],
            (1000, 60, 1),
            ['unit = "ms"', 'command_unit = "deg"'],
        ),
        (
            ["Time [s]", "u1 (mm)", "u2 (mm)"],
            (1, 8, 1e-3),
            ['column = "Time [s]", unit = "s"', 'unit = "m", columns'],
        ),
        (["stamp", "motor_a", "motor_b"], (1e9, 0.8, 1), ['unit = "ns"', 'command_unit = "rad"']),
        (["t", "goal1", "goal2"], (1, 2000.4, 1), ["goal1"]),
        (["t", "servo_x_deg", "servo_y_deg"], (1, 60, 1), ['"servo_x_deg", "servo_y_deg"']),
        (
            ["t", "left_motor_deg", "right_motor_deg"],
            (1, 60, 1),
            ['"left_motor_deg", "right_motor_deg"'],
        ),
    ],
)
def test_names_and_ranges_identify_units(tmp_path, head, scale, words):
    t, points = places(400)
    u = scale[1] * np.column_stack([np.sin(t), np.cos(t)])
    path = written(tmp_path, bench_log([*head, *XYZ], t * scale[0], u, points * scale[2]))
    found = guess_mapping([path])
    assert all(word in found.text for word in words), found.text
    run = imported(tmp_path, found, [path]).run
    assert (
        run.markers[5, 2, 2] - run.markers[5, 0, 2] == pytest.approx(120, abs=0.2)
        and run.channels == 2
    )
    assert run.t == pytest.approx(t, abs=1e-5)


def test_a_force_next_to_a_place_is_no_marker(tmp_path):
    """Taken for one, it would also turn the frame: the robot would run from its tip to its
    force.
    """
    t, points = places(100)
    force = np.column_stack([0 * t, 0 * t, 1 + 0 * t])
    head = ["time", "u1", "u2", "x", "y", "z", "fx", "fy", "fz"]
    seen = np.stack([points[:, 2], force], axis=1)
    found = guess_mapping(
        [written(tmp_path, bench_log(head, t, np.column_stack([np.sin(t), np.cos(t)]), seen))]
    )
    assert (
        '["x", "y", "z"]' in found.text
        and '"fx"' not in found.text
        and reported(found.unknown, "fx, fy, fz", "force")
    )


def test_units_in_the_names_of_markers_are_believed(tmp_path):
    """A robot of 12 mm in mm: by its range alone it would be 12 cm in cm."""
    t, points = places(400)
    u = 8 * np.column_stack([np.sin(t), np.cos(t)])
    names = [f"{name} (mm)" for name in XYZ]
    path = written(tmp_path, bench_log(["t (s)", "u1 (mm)", "u2 (mm)", *names], t, u, points / 10))
    found = guess_mapping([path])
    assert 'markers = { unit = "mm"' in found.text and reported(
        found.assumed, "their names state mm"
    )
    tall = np.ptp(imported(tmp_path, found, [path]).run.markers[5], axis=0)[2]
    assert tall == pytest.approx(12, abs=0.1)


def test_rings_of_markers_have_their_clamp_in_the_middle(tmp_path):
    t = np.arange(400) / 50
    angle = np.tile(np.arange(4) * np.pi / 2, 5)
    rest = np.column_stack(
        [12 * np.cos(angle), 12 * np.sin(angle), np.repeat([20, 45, 70, 95, 120], 4)]
    )
    u = 8 * np.column_stack([np.sin(3 * t), np.cos(2 * t), 0 * t])
    points = rest + u[:, None] * (rest[:, 2:] / 60) + [300.0, 40.0, 0.0]
    names = [f"{axis}{k}" for k in range(20) for axis in "xyz"]
    path = written(tmp_path, bench_log(["t", "u0", "u1", *names], t, u[:, :2], points))
    found = guess_mapping([path])
    origin = json.loads(re.search(r"origin_mm = (\[.*?\])", found.text)[1])
    assert (
        origin == pytest.approx([300, 40, 20], abs=4)
        and imported(tmp_path, found, [path]).doubts == ()
    )


def test_names_of_another_language(tmp_path):
    """The first column rises evenly: a clock, whatever its name. Two neighbours differ in the last
    word: two motors.
    """
    t, points = places(400)
    u = 60 * np.column_stack([np.sin(t), np.cos(t), 0.1 * np.sin(t), 1 + 0 * t])
    head = ["Zeit", "motor_links", "motor_rechts", "pumpe7", "leer"]
    path = written(tmp_path, bench_log([*head, *XYZ], t + 3, u, points, ";"))
    found = guess_mapping([path])
    run = imported(tmp_path, found, [path]).run
    assert run.t == pytest.approx(t + 3, abs=1e-6) and np.allclose(run.command, u[:, :2], atol=1e-6)
    assert reported(found.assumed, "'Zeit' rises throughout")
    assert reported(found.unknown, "pumpe7 (", "left out") and not reported(found.unknown, "leer")


def test_ticks_stay_ticks(tmp_path):
    t, points = places(400)
    u = np.rint(2048 + 900 * np.column_stack([np.sin(t), np.cos(t)]))
    path = written(
        tmp_path,
        bench_log(
            ["t", "goal_1", "goal_2", "present_1", "present_2", *XYZ], t, np.hstack([u, u]), points
        ),
    )
    found = guess_mapping([path])
    run = imported(tmp_path, found, [path]).run
    assert (
        run.command_unit == "ticks"
        and np.array_equal(run.command, u)
        and np.array_equal(run.present, u)
    )
    assert reported(found.unknown, "home: the ticks at which the robot rests", "offset = [-")


def test_semicolons_labels_current_and_doubled_stamps(tmp_path):
    t, points = places(300)
    t = np.arange(300) // 4 / 25  # four rows a stamp
    u = np.column_stack([8 * np.sin(t), 8 * np.cos(t), 300 * np.sin(t), 250 + 0 * t, 21 + 0 * t])
    head = ["t", "u1", "u2", "current_1_ma", "current_2_ma", "temp_c"]
    lines = bench_log([*head, *XYZ], t, u, points, ";").replace(".", ",").splitlines()
    parts = ["part"] + ["up"] * 150 + ["down"] * 150
    path = written(tmp_path, "\n".join(f"{line};{part}" for line, part in zip(lines, parts)))
    found = guess_mapping([path])
    run = imported(tmp_path, found, [path]).run
    assert (
        set(run.block) == {"up", "down"}
        and run.current.shape == (300, 2)
        and run.temperature[0] == 21.0
    )
    assert 'repeated = "spread"' in found.text and np.diff(run.t) == pytest.approx(0.01, abs=1e-9)


def test_without_a_header_it_says_that_it_cannot_know(tmp_path):
    text, _ = made_log()
    path = written(tmp_path, text.split("\n", 1)[1])
    with pytest.raises(
        RunError, match=r"no column looks like a command or a marker .*0 \(0 to 1\.9\)"
    ) as fault:
        guess_mapping([path])
    assert "docs/reference/mapping.md" in str(fault.value) and "\n" not in str(fault.value)


def test_what_fails_on_trial_is_reported(tmp_path):
    """A row that goes back in time is beyond the rows that are looked at."""
    t, points = places(21_000)
    t[20_500] = 1.0
    u = np.column_stack([np.sin(t), np.cos(t)])
    path = written(tmp_path, bench_log(["t", "u1_mm", "u2_mm", *XYZ], t, u, points))
    found = guess_mapping([path])
    assert reported(found.said, "as it stands it cannot be imported", "time goes backwards")


# --- the command ----------------------------------------------------------------------------------
def test_the_command_prints_or_writes_what_it_proposes(tmp_path, capsys):
    t, points = places()
    path = str(write_c3d(tmp_path / "a.c3d", t, points))
    assert main(["import", path, "--guess"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("# Proposed") and re.search(
        r"^# UNKNOWN .*where the clamp is", printed, re.MULTILINE
    )
    out = str(tmp_path / "map.toml")
    assert main(["import", path, "--guess", "--out", out]) == 0
    said = capsys.readouterr().out
    assert (
        "assumed   markers" in said
        and "unknown   what was commanded" in said
        and f"--map {out}" in said
    )
    assert main(["import", path, "--map", out, "--out", str(tmp_path / "run.npz")]) == 0
    assert main(["import", path, "--map", out, "--out", str(tmp_path / "run.npz")]) == 2
    assert "a run stands there and would be lost" in capsys.readouterr().err
    assert main(["import", path, "--map", out, "--out", str(tmp_path / "run.npz"), "--force"]) == 0
    (tmp_path / "map.toml").write_text("corrected by hand")
    assert main(["import", path, "--guess", "--out", out]) == 2
    assert (
        "stands there already" in capsys.readouterr().err
        and (tmp_path / "map.toml").read_text()[:3] == "cor"
    )
    assert main(["import", path, "--guess", "--out", out, "--force"]) == 0
    capsys.readouterr()
    assert main(["import", path, "--guess", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (
        document["schema"] == "softmap.guess/1"
        and document["mapping"] in printed
        and document["unknown"]
    )


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--guess", "--out", "run.npz"], "saved as .toml"),
        (["--map", "map.toml"], "--out is missing"),
        ([], "one of the arguments --map --guess is required"),
    ],
)
def test_wrong_use_of_the_command(tmp_path, capsys, argv, words):
    path = str(written(tmp_path, made_log()[0]))
    assert main(["import", path, *argv]) == 2
    assert words in capsys.readouterr().err


def test_a_name_does_not_end_its_comment_and_become_a_key(tmp_path):
    path = tmp_path / 'log\nrobot = "other" #.csv'
    path.write_text(made_log(60)[0])
    text = guess_mapping([path]).text
    assert "robot" in text.splitlines()[0] and "robot" not in tomllib.loads(text)


@pytest.mark.parametrize("rows", [0, 1])
def test_a_log_that_holds_no_motion_is_not_guessed_at(tmp_path, rows):
    lines = ["t,u1,u2,x,y,z", *["0.1,1,2,0,0,90"] * rows]
    with pytest.raises(RunError, match=r"log\.csv.* (no|1) row"):
        guess_mapping([written(tmp_path, "\n".join(lines) + "\n")])


@pytest.mark.parametrize("shape", [(3,), (1, 3), (3, 3)])
def test_places_that_were_never_seen_are_reported(tmp_path, shape):
    """A file of arrays may hold markers that were never seen."""
    t = np.arange(40) * 0.05
    tip = np.full((40, *shape), np.nan)
    np.savez(tmp_path / "log.npz", t=t, u=np.sin(np.stack([t, 2 * t], axis=1)), tip=tip)
    found = guess_mapping([tmp_path / "log.npz"])
    assert reported(
        [*found.assumed, *found.unknown], "no row has all coordinates of one place"
    ) or reported(found.unknown, "nothing is seen in this run")
