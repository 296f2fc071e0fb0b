"""The same input gives the same bytes: in another folder, with other threads, another order of
hashes, later.
"""

import os
import shutil
import subprocess
import sys
import time

import numpy as np
import pytest

from softmap_edge import builtin_model, save_bundle
from softmap_edge.run.protocol import standard_protocol
from softmap_edge.run.run import Run

# Folder by folder: how many threads the core has, and in which order Python keeps what it hashes.
PLACES = {"here": ("1", "1"), "a longer way/there": ("2", "77")}
SECRET = {"backlash.gap": 1.5, "payload.mass": 12.0}


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    """Two folders with the same run and the same bundle, written at different times."""
    p, model = standard_protocol(), builtin_model()
    some = np.arange(0, p.frames, 3)
    blank = Run(t=p.t, command=p.command, gravity=p.gravity, t_seen=p.t_seen[some], robot="finger")
    truth = model.with_effects(("backlash", "payload"), SECRET)
    vertices = truth.predict(blank) + 0.2 * np.random.default_rng(0).normal(
        size=(len(some), len(model.rest), 3)
    )
    run = Run(**{**blank.arrays(), "command_unit": "mm", "robot": "finger", "vertices": vertices})
    folders = [tmp_path_factory.mktemp("bytes") / name for name in PLACES]
    for folder in folders:
        if folder != folders[0]:
            time.sleep(2.1)  # file times in archives are even seconds
        folder.mkdir(parents=True)
        run.save(folder / "run.npz")
    save_bundle(model, folders[0] / "bundle")
    shutil.copytree(folders[0] / "bundle", folders[1] / "bundle")
    return folders


def said(folder, *argv):
    """Run the command in a folder, and return the bytes it prints."""
    threads, hashes = PLACES["here" if folder.name == "here" else "a longer way/there"]
    environment = os.environ | {"RAYON_NUM_THREADS": threads, "PYTHONHASHSEED": hashes}
    code = "import sys; from softmap_edge.cli import main; sys.exit(main())"
    done = subprocess.run(
        [sys.executable, "-c", code, *argv], cwd=folder, env=environment, capture_output=True
    )
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


def test_runs_and_bundles_are_the_same_bytes(places):
    assert (places[0] / "run.npz").read_bytes() == (places[1] / "run.npz").read_bytes()


@pytest.mark.long
def test_diagnosis_page_and_next_experiment_are_the_same_bytes(places):
    wanted = (
        "run.npz",
        "--bundle",
        "bundle",
        "--out",
        "diagnosis.json",
        "--html",
        "page.html",
        "--json",
    )
    printed = [said(folder, "diagnose", *wanted) for folder in places]
    assert printed[0] == printed[1] and b"backlash" in printed[0]
    for name in ("diagnosis.json", "page.html"):
        one, other = ((folder / name).read_bytes() for folder in places)
        assert one == other and str(places[0]).encode() not in one
    ask = (
        "diagnosis.json",
        "--bundle",
        "bundle",
        "--run",
        "run.npz",
        "--out",
        "next.csv",
        "--json",
    )
    printed = [said(folder, "next", *ask) for folder in places]
    assert printed[0] == printed[1]
    files = [folder / "next.csv" for folder in places]
    assert files[0].exists() == files[1].exists()
    assert not files[0].exists() or files[0].read_bytes() == files[1].read_bytes()


def test_a_comparison_is_the_same_bytes(places):
    one, other = (
        said(folder, "compare", "run.npz", "--bundle", "bundle", "--json") for folder in places
    )
    assert one == other and b"rms_mm" in one


def test_another_run_gives_other_bytes(places):
    """Without this the documents could say nothing."""
    run = Run.load(places[0] / "run.npz")
    run.at(np.arange(100)).save(places[0] / "part.npz")
    assert said(places[0], "compare", "part.npz", "--json") != said(
        places[0], "compare", "run.npz", "--json"
    )
