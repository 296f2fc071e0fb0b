"""Sweeps into a Zarr store: the numbers of `Simulator.sweep`, killed and gone on with, on a
cluster, damaged.
"""

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import zarr
from softmap_training.simulated import SimulatedSet
from softmap_training.store import open_store
from softmap_training.sweeps import sweep_to_zarr

from softmap_edge.cli import main
from softmap_edge.commands.progress import Bar
from softmap_edge.errors import SimulationError, SoftmapError
from softmap_edge.fem.finger import Finger
from softmap_edge.fem.simulator import Simulator

FINGER = Finger.builtin().replace(core=2, layers=8)
AXES = [np.linspace(-6.0, 6.0, 5), np.linspace(-4.0, 4.0, 4)]  # 20 commands
ROWS = 6  # in a chunk: four chunks, the last of two rows
# mm: two equilibria of one command, each settled to 2e-4 mm a Newton step, in float32
TOLERANCE = 2e-3


@pytest.fixture(scope="module")
def finger_file(tmp_path_factory):
    file = tmp_path_factory.mktemp("finger") / "finger.toml"
    file.write_text(FINGER.to_toml())
    return str(file)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    path = tmp_path_factory.mktemp("store") / "sweep.zarr"
    sweep_to_zarr(FINGER, path, AXES, ROWS)
    return path


@pytest.fixture
def copy(store, tmp_path):
    return shutil.copytree(store, tmp_path / "copy.zarr")


def test_chunks_solved_by_themselves_are_the_sweep_within_the_solvers_tolerance(store):
    sweep, made = Simulator(FINGER).sweep(AXES), open_store(store)
    assert made.done.tolist() == [True] * 4 and made.vertices.dtype == np.float32
    assert np.array_equal(made.command, sweep.command) and np.array_equal(
        made.triangles, sweep.triangles
    )
    assert np.abs(made.vertices[:] - sweep.vertices).max() < TOLERANCE
    np.testing.assert_allclose(made.pull[:], sweep.pull, atol=TOLERANCE)
    assert Finger.from_toml(made.attributes["finger"]) == FINGER
    assert made.attributes["units"]["vertices"] == "mm" and made.attributes["gravity"] == list(
        FINGER.gravity
    )


def test_a_set_gives_the_same_shapes_from_a_store_and_from_a_file(store, tmp_path):
    Simulator(FINGER).sweep(AXES).save(tmp_path / "sweep.npz")
    one, other = SimulatedSet.load(store), SimulatedSet.load(tmp_path / "sweep.npz")
    rows = np.array([19, 0, 7, 7, 5, 6])
    assert np.array_equal(one.command, other.command) and np.array_equal(
        one.triangles, other.triangles
    )
    assert one.finger == other.finger == FINGER.to_toml()
    assert np.array_equal(one.shapes(rows), np.asarray(one.vertices[:])[rows])
    assert np.abs(one.shapes(rows) - other.shapes(rows)).max() < TOLERANCE
    for bad in ([20], [-1], [0.5], [[1]]):
        with pytest.raises(SimulationError, match="whole numbers from 0 to 19"):
            one.shapes(bad)


def test_the_split_is_frozen_and_leaves_no_row_out(store):
    """The numbers are those of the rule itself: should they ever change, results before and after
    do not compare.
    """
    made = SimulatedSet.load(store)
    split, again, other = made.split(0), made.split(0), made.split(1)
    assert sorted([*split.train, *split.validation, *split.test]) == list(range(20))
    assert (len(split.train), len(split.validation), len(split.test)) == (16, 2, 2)
    assert np.array_equal(split.train, again.train) and not np.array_equal(split.train, other.train)
    assert (split.rule, split.validation.tolist(), split.test.tolist()) == (
        "softmap.split/1",
        [0, 19],
        [3, 9],
    )
    with pytest.raises(SimulationError, match="seed -1"):
        made.split(-1)


def splitmix64(state):
    """One number of Steele, Lea and Flood's generator, in Python's own integers."""
    mask = (1 << 64) - 1
    z = state & mask
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    return z ^ (z >> 31)


def test_the_split_follows_splitmix64(store):
    """From seed 0 the generator gives 0xE220A8397B1DCDAF first (its reference implementation)."""
    golden = 0x9E3779B97F4A7C15
    assert splitmix64(golden) == 0xE220A8397B1DCDAF
    for seed in (0, 3):
        drawn = [
            splitmix64((golden * ((seed << 32) + row + 1)) & ((1 << 64) - 1)) for row in range(20)
        ]
        assert sorted(np.argsort(drawn)[:16]) == SimulatedSet.load(store).split(seed).train.tolist()


def test_a_killed_sweep_loses_at_most_a_chunk_and_goes_on(finger_file, tmp_path, capsys):
    out = tmp_path / "killed.zarr"
    argv = ["model", "sweep", finger_file, "--steps", "7", "--chunk", "5", "--out", str(out)]
    code = "import sys; from softmap_edge.cli import main; sys.exit(main())"
    with subprocess.Popen([sys.executable, "-c", code, *argv]) as process:
        try:
            while not any((out / "vertices" / "c").glob("*/0/0")):
                assert process.poll() is None
                time.sleep(0.005)
        finally:
            os.kill(process.pid, signal.SIGKILL)
    files = len(list((out / "vertices" / "c").glob("*/0/0")))
    killed = open_store(out)
    assert files - 1 <= killed.done.sum() < len(killed.done) == 10
    with pytest.raises(SimulationError, match=f"{killed.done.sum()} of 10 chunks are done"):
        SimulatedSet.load(out)
    assert main([*argv[:-4], "--out", str(out), "--json"]) == 0  # the chunk is that of the store
    reported = json.loads(capsys.readouterr().out)
    assert reported["commands"] == 49 and reported["solved"] == 49 - 5 * killed.done.sum()
    assert (
        main(argv) == 0
        and "49 commands, none failed, 49 of them were there" in capsys.readouterr().out
    )
    made = SimulatedSet.load(out)
    sweep = Simulator(FINGER).sweep(open_store(out).axes)
    assert np.abs(made.shapes(np.arange(49)) - sweep.vertices).max() < TOLERANCE


@pytest.fixture(scope="module")
def cluster():
    """Two workers, each a process of its own."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as made:
        yield made


def test_a_cluster_gives_the_same_numbers_though_a_worker_is_lost(cluster, store, tmp_path):
    lost = []

    def lose_one(share):
        if 0.0 < share < 1.0 and not lost:
            lost.append(next(iter(cluster.workers.values())).pid)
            os.kill(lost[0], signal.SIGKILL)

    path = tmp_path / "dask.zarr"
    made, solved = sweep_to_zarr(
        FINGER, path, AXES, 2, dask=cluster.scheduler_address, progress=lose_one
    )
    assert lost and solved == 20 and made.done.all()
    here, there = open_store(store), open_store(path)
    assert np.abs(here.vertices[:] - there.vertices[:]).max() < TOLERANCE
    np.testing.assert_allclose(here.pull[:], there.pull[:], atol=TOLERANCE)


def test_what_fails_on_a_cluster_is_reported_in_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr("softmap_training.sweeps.WAIT", 1)
    with pytest.raises(
        SimulationError, match="--dask tcp://127.0.0.1:9: .*; the same command goes on"
    ) as fault:
        sweep_to_zarr(FINGER, tmp_path / "none.zarr", AXES, ROWS, dask="tcp://127.0.0.1:9")
    assert "\n" not in str(fault.value)
    for address in ("nonsense", "tcp://here", "here:8786"):
        with pytest.raises(
            SimulationError, match="no address of a scheduler; give one as tcp://HOST:8786"
        ):
            sweep_to_zarr(FINGER, tmp_path / "never.zarr", AXES, ROWS, dask=address)
    assert not (tmp_path / "never.zarr").exists()


def test_what_a_worker_of_another_version_would_send_is_not_written(copy):
    made = open_store(copy, "r+")
    made.done[:] = False
    right, pull = np.zeros((ROWS, *made.vertices.shape[1:])), np.zeros((ROWS, 4))
    for vertices, pulled in (
        (right[:, 1:], pull),
        (right, pull[1:]),
        (np.full_like(right, np.nan), pull),
    ):
        with pytest.raises(
            SimulationError, match="chunk 0 came back with .*; give every worker this version"
        ):
            made.write(0, vertices, pulled)
    assert not made.done.any() and np.abs(made.vertices[:ROWS]).max() > 1.0


@pytest.mark.parametrize(
    "finger, axes, chunk, says",
    [
        (
            FINGER.replace(young_mpa=0.5),
            AXES,
            ROWS,
            r"another finger \('young_mpa = 0.25', not 'young_mpa = 0.5'\)",
        ),
        (FINGER, [AXES[0], AXES[0]], ROWS, r"another grid \(5 x 4, not 5 x 5\)"),
        (FINGER, [AXES[0], AXES[1] + 0.5], ROWS, "a grid of other commands"),
        (FINGER, AXES, 5, "chunks of 6 rows, not 5"),
    ],
)
def test_another_sweep_in_the_same_folder_is_refused_with_what_differs(
    finger, axes, chunk, says, copy
):
    before = {file: file.read_bytes() for file in copy.rglob("*") if file.is_file()}
    with pytest.raises(SimulationError, match=says):
        sweep_to_zarr(finger, copy, axes, chunk)
    assert before == {file: file.read_bytes() for file in copy.rglob("*") if file.is_file()}


def test_another_mesh_under_the_same_name_is_refused(copy):
    wanted = dict(open_store(copy).attributes) | {"mesh_sha256": "0" * 64}
    with pytest.raises(SimulationError, match="another mesh sha256"):
        open_store(copy).check_same(wanted)


def edit(path, change):
    """Change a zarr.json."""
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def attribute(name, value):
    return lambda path: edit(path / "zarr.json", lambda d: d["attributes"].__setitem__(name, value))


def field(name, key, value):
    return lambda path: edit(path / name / "zarr.json", lambda d: d.__setitem__(key, value))


def overwritten(name, place, value):
    def spoil(path):
        zarr.open_group(path, mode="r+")[name][place] = value

    return spoil


def replaced(name, **array):
    def spoil(path):
        zarr.open_group(path, mode="r+").create_array(name, overwrite=True, **array)

    return spoil


DAMAGE = {
    "schema": attribute("schema", "other/1"),
    "finger": attribute("finger", "name = 3"),
    "units": attribute("units", {"vertices": "m"}),
    "axes": attribute("axes", [[1.0, 0.0], [0.0, 1.0]]),
    "axes of text": attribute("axes", "abc"),
    "endless axes": attribute("axes", [[float("nan")], [0.0]]),
    "chunk": attribute("chunk", 0),
    "split": attribute("split", "softmap.split/9"),
    "no attributes": lambda path: edit(path / "zarr.json", lambda d: d.pop("attributes")),
    "no json": lambda path: (path / "zarr.json").write_text("{"),
    "a list": lambda path: (path / "zarr.json").write_text("[]"),
    "huge metadata": lambda path: (path / "zarr.json").write_bytes(b" " * (17 << 20)),
    "no pull": lambda path: shutil.rmtree(path / "pull"),
    "shape": field("vertices", "shape", [20, 7]),
    "a huge shape": field("vertices", "shape", [20, 10**15, 3]),
    "codecs": field(
        "pull", "codecs", [{"name": "bytes"}, {"name": "gzip", "configuration": {"level": 1}}]
    ),
    "type": replaced("vertices", shape=(20, 5, 3), dtype="float64"),
    "huge pieces": replaced(
        "vertices", shape=(20, 10**9, 3), dtype="float32", chunks=(6, 10**9, 3)
    ),
    "other pieces": replaced("vertices", shape=(20, 5, 3), dtype="float32", chunks=(3, 5, 3)),
    "command": overwritten("command", 0, 99.0),
    "triangles": overwritten("triangles", 0, 10**6),
    "negative triangles": overwritten("triangles", 0, -1),
}


@pytest.mark.parametrize("spoil", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_store_is_refused_in_one_line(spoil, copy):
    spoil(copy)
    for read in (SimulatedSet.load, lambda path: sweep_to_zarr(FINGER, path, AXES, ROWS)):
        with pytest.raises(SoftmapError) as fault:
            read(copy)
        assert "\n" not in str(fault.value) and str(copy) in str(fault.value)


def test_chunks_that_are_cut_off_gone_or_not_finite_are_refused_when_they_are_read(store, tmp_path):
    def shapes(spoil):
        path = shutil.copytree(store, tmp_path / spoil.__name__)
        spoil(path / "vertices" / "c" / "1" / "0" / "0")
        made = SimulatedSet.load(path)
        assert np.isfinite(made.shapes(np.arange(ROWS))).all()  # the others are as they were
        with pytest.raises(SimulationError, match="chunk 1 ") as fault:
            made.shapes([ROWS])
        assert "\n" not in str(fault.value)

    def cut(file):
        file.write_bytes(file.read_bytes()[:100])

    def gone(file):
        file.unlink()

    def infinite(file):
        zarr.open_group(file.parents[4], mode="r+")["vertices"][ROWS] = np.inf

    for spoil in (cut, gone, infinite):
        shapes(spoil)


def test_what_is_no_store_is_left_alone(finger_file, tmp_path, capsys):
    (tmp_path / "mine.zarr").mkdir()
    (tmp_path / "mine.zarr" / "notes.txt").write_text("mine")
    with pytest.raises(SimulationError, match="no Zarr 3 store"):
        sweep_to_zarr(FINGER, tmp_path / "mine.zarr", AXES)
    assert [file.name for file in (tmp_path / "mine.zarr").iterdir()] == ["notes.txt"]
    for argv, says in (
        (
            ["--out", str(tmp_path / "a.npz"), "--dask", "tcp://here:1"],
            "give a name that ends in .zarr",
        ),
        (["--out", str(tmp_path / "a.zarr"), "--chunk", "0"], "give 1 command or more"),
        (["--out", str(tmp_path / "none" / "a.zarr")], "make it first"),
    ):
        assert main(["model", "sweep", finger_file, *argv]) == 2
        assert says in capsys.readouterr().err


def test_without_the_training_package_one_line_says_what_to_install(
    finger_file, monkeypatch, tmp_path, capsys
):
    monkeypatch.setitem(sys.modules, "softmap_training.sweeps", None)
    assert main(["model", "sweep", finger_file, "--out", str(tmp_path / "a.zarr")]) == 2
    said = capsys.readouterr().err
    assert "pip install softmap-training" in said and said.count("\n") == 1


def test_the_bar_shows_the_time_left_at_the_recent_pace(monkeypatch):
    """A sweep that goes on at 60 % is not counted as having done these in no time."""
    drawn, now = io.StringIO(), [0.0]
    drawn.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", drawn)
    with Bar(clock=lambda: now[0]) as bar:
        bar("sweep", 0.6)
        now[0] = 60.0
        bar("sweep", 0.7)
        assert "70%, 3 min left" in drawn.getvalue()
        bar("fields", 0.0)
        assert "left" not in drawn.getvalue().split("\r")[-1]
