"""Places relative to the base, and a base in another frame: what is assumed is reported."""

import tomllib

import numpy as np
import pytest
from bench_rows import write

from softmap_edge.alignment.base_motion import base_motion, excluded, kept_places
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.plausible import frame_of, is_base, is_relative

COUNT = 60
SPOTS = np.array([[20.0, 0, 0], [-10, 17, 0], [-10, -17, 0]])


def log(folder, base, names=("base{}", "tip"), relative=False):
    """A tip, and three markers of a base with places (K, 3, 3)."""
    random, u = np.random.default_rng(0), 5 * np.sin(np.arange(COUNT) / 6)
    tip = np.column_stack([2 * u, 0 * u, 90 - np.abs(u)]) + 0.01 * random.normal(size=(COUNT, 3))
    points = np.concatenate([base, tip[:, None]], axis=1) - (base[:, :1] if relative else 0.0)
    labels = [*(names[0].format(b) for b in range(base.shape[1])), names[1]]
    head = ["time", "cmd_1", *(f"{label}_{axis}" for label in labels for axis in "xyz")]
    lines = [
        ",".join(f"{x:.4f}" for x in (0.05 * k, u[k], *points[k].ravel())) for k in range(COUNT)
    ]
    return write(folder / "log.csv", ",".join(head), lines)


def measured(noise=0.05):
    return SPOTS + noise * np.random.default_rng(1).normal(size=(COUNT, 3, 3))


def read(path):
    return import_logs([path], parse_mapping(guess_mapping([path]).text, path))


@pytest.mark.parametrize(
    ("base", "relative"),
    [
        (measured(0.0), False),  # typed, or measured once
        (measured(), True),  # the first marker is the origin: exactly zero
        (np.repeat(SPOTS[None] - SPOTS[0], COUNT, axis=0), False),
    ],
)
def test_a_base_that_was_not_measured_excludes_no_mount(tmp_path, base, relative):
    done = read(log(tmp_path, base, relative=relative))
    said = " ".join(doubt for doubt in done.doubts if doubt.startswith("base: "))
    assert "tip minus base" in said and "`mount` and `camera_drift` cannot be tested" in said
    assert base_motion(done.run) is None and kept_places([done.run]) == {}
    assert excluded([done.run], [base_motion(done.run)], 100.0, 0.5) == {}


def test_a_measured_base_is_no_doubt_and_excludes_a_drift(tmp_path):
    done = read(log(tmp_path, measured()))
    assert not any(doubt.startswith("base: ") for doubt in done.doubts)
    assert "camera_drift" in excluded([done.run], [base_motion(done.run)], 100.0, 2.0)
    assert base_motion(done.run, done.run) is not None


@pytest.mark.parametrize("name", ["tip_minus_base", "tip_wrt_base", "tip_rel", "rel_base_tip"])
def test_a_name_that_says_relative_is_a_place_of_the_tip(tmp_path, name):
    guess = guess_mapping([log(tmp_path, measured(), names=("plate{}", name))])
    markers = tomllib.loads(guess.text)["log"][0]["markers"]["columns"]
    assert [f"{name}_x", f"{name}_y", f"{name}_z"] in markers
    said = [line for line in guess.assumed if "relative to the base by their names" in line]
    assert len(said) == 1 and "`mount` and `camera_drift` cannot be tested" in said[0]


@pytest.mark.parametrize(
    ("names", "apart"),
    [
        (("base{}_in_cam", "tip_in_world"), True),
        (("base{} wrt camera_frame", "tip wrt robot_frame"), True),
        (("clamp{}_in_marker", "tip_in_lab"), True),
        (("base{}_in_cam", "tip_in_cam"), False),
        (("base{}", "tip"), False),
    ],
)
def test_a_base_in_another_frame_is_left_out_with_a_question(tmp_path, names, apart):
    guess = guess_mapping([log(tmp_path, measured(), names=names)])
    entry = tomllib.loads(guess.text)["log"][0]
    assert len(entry["markers"]["columns"]) == 1 and ("base" in entry) is not apart
    asked = any("where the base is in the frame of the markers" in one for one in guess.unknown)
    assert asked is apart
    assert apart or any("measured in the same frame as the others" in one for one in guess.assumed)


@pytest.mark.parametrize(
    ("name", "base", "relative", "frame"),
    [
        ("base_x", True, False, None),
        ("tip_in_base_x", False, True, "base"),
        ("tip_in_world_frame_x", False, False, "world"),
        ("mount_1.x", True, False, None),
        ("tip relative to clamp x", False, True, None),
        ("p_main_x", False, False, None),
    ],
)
def test_what_a_name_says_of_the_base(name, base, relative, frame):
    assert (is_base(name), is_relative(name), frame_of(name)) == (base, relative, frame)
