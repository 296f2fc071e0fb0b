"""Sound files and sound arguments that ask for absurd work are refused at once, in one line, before
memory is taken.
"""

import os
import time
from dataclasses import replace

import numpy as np
import pytest

from softmap_edge import _core
from softmap_edge.cli import main
from softmap_edge.errors import BundleError, FingerError, SoftmapError
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator
from softmap_edge.files.atomic import write_atomically
from softmap_edge.files.npz import read_npz, write_npz
from softmap_edge.model.bundle import builtin_model, load_bundle, save_bundle
from softmap_edge.run.run import Run

LONG_AXIS = np.arange(2.0**21)
AT_ONCE = 5.0  # s on a busy machine; the work itself would take hours or all the memory


def simulator():
    return Simulator(Finger.builtin().replace(core=1, layers=8))


def million_frames():
    times = np.arange(1_000_000.0)
    return builtin_model().predict(Run(t=times[[0, -1]], command=np.zeros((2, 2)), t_seen=times))


REQUESTS = {
    "a mesh of half a million nodes": lambda: Simulator(
        Finger.builtin().replace(core=16, rings=16, layers=400)
    ),
    "a million layers": lambda: Finger.builtin().replace(layers=10**6),
    "a profile of many pairs": lambda: Finger.builtin().replace(
        profile=tuple((z / 1e3, 9.0) for z in range(10**5))
    ),
    "a layer count of 5000 digits": lambda: Finger.builtin().replace(layers=10**5000),
    "a young's modulus of 5000 digits": lambda: Finger.builtin().replace(young_mpa=10**5000),
    "a file of 5000 digits": lambda: Finger.from_toml("name = " + "1" * 5000),
    "a key of two lines": lambda: Finger.from_toml('"a\\nb" = 1'),
    "a sweep of 25 million commands": lambda: simulator().sweep([np.linspace(-1, 1, 5000)] * 2),
    "a path of ten million commands": lambda: simulator().path(
        np.broadcast_to(np.zeros(2), (10**7, 2))
    ),
    "fields of a million commands": lambda: simulator().fields(np.zeros((10**6, 2))),
    "a command of 1e308 mm": lambda: simulator().path([[1e308, 0.0]]),
    "a gravity of 1e300 g": lambda: simulator().path([[0.0, 0.0]], gravity=[1e300, 0, 0]),
    # 2^21 · 2^22 · 2^21 nodes are 2^64, which is 0 where the product wraps around
    "a grid whose size overflows": lambda: _core.Table(
        [LONG_AXIS, np.arange(2.0**22), LONG_AXIS], np.zeros((0, 1)), np.zeros(3), np.ones((1, 3))
    ),
    "a rod of a million channels": lambda: _core.Rod(
        np.zeros(3), np.zeros(10**6), np.ones(10**6), 4, np.zeros((1, 2)), np.zeros((1, 1))
    ),
    "monomials of a million variables": lambda: _core.monomials(np.zeros((1, 10**6)), 4),
    "a prediction of a million frames": million_frames,
}


@pytest.mark.parametrize("ask", REQUESTS.values(), ids=REQUESTS)
def test_is_refused_at_once(ask):
    start = time.process_time()
    with pytest.raises(SoftmapError) as fault:
        ask()
    assert "\n" not in str(fault.value) and len(str(fault.value)) < 500
    assert time.process_time() - start < AT_ONCE


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e308, -1e10])
@pytest.mark.parametrize("file", ["prior", "fields", "template"])
def test_a_bundle_of_numbers_beyond_any_robot_is_refused(file, value, tmp_path):
    """The hash is right, the shape is right: only the number is absurd."""
    model = builtin_model()
    folder = save_bundle(model, tmp_path / "bundle")
    content = read_npz(folder / f"{file}.npz")
    key = next(key for key in content if key.startswith(("coefficients", "rest")))
    content[key] = np.array(content[key], float)
    content[key][0, 0] = value
    replaced(folder, f"{file}.npz", content)
    with pytest.raises(BundleError, match=f"{file}.npz: '"):
        load_bundle(folder)


def replaced(folder, name, content):
    """Write other arrays into a bundle and put its hash right."""
    before = (folder / "manifest.json").read_text()
    from softmap_edge.files.atomic import sha256_of

    old = sha256_of(folder / name)
    write_npz(folder / name, content)
    (folder / "manifest.json").write_text(before.replace(old, sha256_of(folder / name)))


def test_a_template_with_an_empty_slice_is_refused(tmp_path):
    folder = save_bundle(builtin_model(), tmp_path / "bundle")
    content = read_npz(folder / "template.npz")
    content["rest"] = np.array(content["rest"], float)
    content["rest"][0, 2] = 1e4  # one vertex far away: the slices between hold nothing
    replaced(folder, "template.npz", content)
    with pytest.raises(BundleError, match="holds none"):
        load_bundle(folder)


@pytest.mark.parametrize(
    ("handles", "says"),
    [
        (
            np.zeros(0, np.uint32),
            r"shape \(0,\), expected 1 to 548 of its vertices 0 to 547, ascending",
        ),
        (np.uint32([3, 3, 5]), "ascending"),
        (np.uint32([5, 3]), "ascending"),
        (np.uint32([[1, 2]]), r"shape \(1, 2\)"),
        (np.uint32([7, 548]), "0 to 547"),
        (np.int32([-1, 4]), "0 to 547"),
        (np.array(4, np.uint32), r"shape \(\)"),
        (np.array([1.0, 2.0]), "whole numbers"),
    ],
)
def test_a_template_with_wrong_handles_is_refused(handles, says, tmp_path):
    folder = save_bundle(replace(builtin_model(), handles=np.array([2, 9])), tmp_path / "bundle")
    assert list(load_bundle(folder).handles) == [2, 9]
    replaced(folder, "template.npz", read_npz(folder / "template.npz") | {"handles": handles})
    with pytest.raises(BundleError, match=says):
        load_bundle(folder)


def test_a_finger_file_of_megabytes_is_refused(tmp_path):
    (tmp_path / "finger.toml").write_text("#" * 2_000_000)
    with pytest.raises(FingerError, match="more than 1000000 bytes"):
        Finger.load(tmp_path / "finger.toml")


def test_what_is_large_but_reasonable_still_works():
    """Without this the limits could refuse everything."""
    finger = Finger.builtin().replace(core=6, rings=3, layers=60)
    assert len(Simulator(finger).template.vertices) > 1500
    assert Finger.builtin().replace(core=16, layers=40).other_mesh().solid.core == 15


BUILD, GUESS = ["build", "--out", "b"], ["import", "--guess", "--out", "map.toml"]


@pytest.mark.parametrize(
    "argv",
    [["diagnose"], ["check"], ["add", "gain", "--out", "b", "--from"], ["next"], BUILD, GUESS],
)
def test_devices_and_pipes_are_no_files(argv, tmp_path, capsys, monkeypatch):
    """They never end: reading them completely fills the memory, or waits for ever."""
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    for name in ("pipe", "/dev/zero"):
        assert main([*argv, name]) in (1, 2)
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and name in said


def test_a_small_file_of_many_numbers_is_refused_before_they_are_made_floats(tmp_path):
    times = np.arange(2.0)
    zeros = np.zeros((2, 20_000_000, 3), np.int8)
    write_npz(tmp_path / "run.npz", {"t": times, "t_seen": times, "vertices": zeros})
    with pytest.raises(SoftmapError, match="numbers, at most"):
        Run.load(tmp_path / "run.npz")


def test_a_file_is_replaced_atomically_and_its_neighbours_stay(tmp_path):
    (tmp_path / "d.json.part").write_text("precious")
    write_atomically(tmp_path / "d.json", "{}")
    assert (tmp_path / "d.json").stat().st_mode & 0o777 == (
        tmp_path / "d.json.part"
    ).stat().st_mode & 0o777
    with pytest.raises(FileNotFoundError, match="absent"):
        write_atomically(tmp_path / "absent" / "d.json", "{}")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["d.json", "d.json.part"]
    assert (tmp_path / "d.json.part").read_text() == "precious"
