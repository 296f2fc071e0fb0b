"""Damaged files of every format give an error of ours: never a crash, a hang, a warning or another exception.

Each format is one line of FORMATS. A child process with a memory and a time limit (this file, run as a
program) spoils a sound sample in ways drawn from fixed seeds and loads it. Archives are spoiled inside and
packed again with right checksums, and a bundle's hashes are put right, so that the damage gets past the
first door.
"""

import faulthandler
import io
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import traceback
import warnings
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

MEMORY = 3 * 2**30  # bytes of address space: the interpreter, numpy and a sample take under 1 GiB
PATIENCE = 20.0  # s for one file
NUMBERS = ["nan", "-nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "0", "-0", "-1", "1e5", "2147483648"]
NUMBERS += ["9223372036854775808", "0x10", "1_0"]
WORDS = ["true", '""', "''", "[]", "[[]]", "{}", '"\\u0000"', "é", "\ufeff", "\0", ",", ";", "\n", "\r", '"', "=", "#"]
NASTY = [*NUMBERS, *WORDS, "1" * 400, "[" * 300, "[[log]]", "a = 1", "1979-05-27T07:32:00Z", "../../x"]


@dataclass(frozen=True)
class Format:
    """A kind of file: how a sound sample is made, spoiled and used."""

    name: str
    sample: Callable[[Path], Path]
    spoil: Callable[[Path, Path, np.random.Generator], Path]
    use: Callable[[Path], object]


# --- sound samples -------------------------------------------------------------------------
def run_sample(folder):
    from softmap_edge.run import Run

    t = np.arange(12) * 0.5
    Run(
        t=t,
        command=np.column_stack([t, -t]),
        gravity=np.array([0.0, 0, 1]),
        temperature=np.full(12, 20.0),
        frame=np.eye(3, 4),
        frame_sigma=np.ones(6),
        t_seen=t[::2],
        markers=np.arange(72.0).reshape(6, 4, 3),
        visible=np.ones((6, 4), bool),
        sigma=np.array(0.1),
        block=np.array(list("aabbcc")),
        robot="sample",
        extra={"wind": np.arange(3)},
    ).save(folder / "run.npz")
    return folder / "run.npz"


def clouds_sample(folder):
    from softmap_edge.run import Run

    start = np.array([0, 4, 4, 9])
    clouds = Run(t=[0.0, 3.0], ticks=[[1], [2]], t_seen=[0.0, 1, 2], points=np.arange(27.0).reshape(9, 3), start=start)
    clouds.save(folder / "run.npz")
    return folder / "run.npz"


LOG = "t,a,b,x,y,z\n" + "".join(f"{k / 10},{k % 3},-{k % 5},{k},{2 * k},7.5\n" for k in range(20))
MAP = """schema = "softmap.mapping/1"
robot = "bench"
command_unit = "deg"
zero_time = true
[[log]]
file = "*.csv"
skip_rows = 0
time = { column = "t", unit = "s", offset_s = 0.5, repeated = "refuse" }
command = { columns = ["a"], unit = "rad", scale = [-1], offset = 0.1 }
present = { columns = ["b"], held = "unhold" }
markers = { columns = [["x", "y", "z"]], unit = "cm" }
[frame]
axes = ["x", "z", "-y"]
origin_mm = [1.0, 2.0, 3.0]
[commands]
rate_hz = 20
[seen]
rate_hz = 5
from_s = 0.6
[blocks]
count = 3
[constant]
gravity = [0.0, 0.0, 1.0]
load_g = { "*" = 5.0 }
"""


def logs_sample(folder):
    (folder / "log.csv").write_text(LOG)
    (folder / "map.toml").write_text(MAP)
    return folder


def finger_sample(folder):
    from softmap_edge import finger

    (folder / "finger.toml").write_text(finger._template(), encoding="utf-8")
    return folder / "finger.toml"


def robot_sample(folder):
    shutil.copy(Path(__file__).parents[1] / "examples/tdcr_robot.toml", folder / "robot.toml")
    return folder / "robot.toml"


def diagnosis_sample(folder):
    from test_diagnosis import SOUND

    (folder / "d.json").write_text(json.dumps(SOUND, indent=1), encoding="utf-8")
    return folder / "d.json"


def sweep_sample(folder):
    from softmap_edge.finger import Finger
    from softmap_edge.simulator import Simulator

    Simulator(Finger.builtin().replace(core=1, layers=4)).sweep([[0.0, 1.0], [0.0]]).save(folder / "sweep.npz")
    return folder / "sweep.npz"


def bundle_sample(folder):
    from softmap_edge.bundle import builtin_model, save_bundle

    return save_bundle(builtin_model(), folder / "bundle")


def elastic_sample(folder):
    from softmap_edge.bundle import save_bundle
    from softmap_edge.robot import Robot
    from softmap_edge.rod import learn_model
    from softmap_edge.run import Run

    robot = Robot.load(robot_sample(folder))
    (folder / "robot.toml").unlink()
    t = np.arange(0.0, 40.0, 0.5)
    command = 4.0 * np.sin((0.3 + 0.1 * np.arange(9)) * t[:, None])
    markers = robot.layout.compiled(robot.start).evaluate(command).reshape(-1, 1, 3)
    return save_bundle(
        learn_model(Run(t=t, command=command, t_seen=t, markers=markers), robot=robot), folder / "bundle"
    )


# --- damage --------------------------------------------------------------------------------
def spoil_bytes(data, rng):
    """One to four local injuries: flipped, lost, doubled, swapped, overwritten or cut bytes."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        if not data:
            break
        at, length = int(rng.integers(len(data))), int(rng.integers(1, 1 + min(64, len(data))))
        match rng.integers(6):
            case 0:
                data[at] ^= 1 << int(rng.integers(8))
            case 1:
                del data[at : at + length]
            case 2:
                data[at:at] = data[at : at + length]
            case 3:
                data[at : at + length] = bytes([int(rng.integers(256))]) * length
            case 4:
                data[at : at + length] = rng.bytes(length)
            case _:
                del data[at:]
    return bytes(data)


def spoil_text(text, rng):
    """Replace, drop or double words and lines, put in what parsers dislike; now and then injure the bytes."""
    if rng.random() < 0.2:
        return spoil_bytes(text.encode(), rng)
    for _ in range(rng.integers(1, 4)):
        words = list(re.finditer(r"[\w.+-]+|[^\w\s]", text))
        word = words[int(rng.integers(len(words)))] if words else None
        lines = text.split("\n")
        line = int(rng.integers(len(lines)))
        kind = int(rng.integers(5))
        if kind <= 1 and word:
            text = text[: word.start()] + NASTY[int(rng.integers(len(NASTY)))] + text[word.end() :]
        elif kind == 2 and word:
            text = text[: word.start()] + text[word.end() :]
        elif kind == 3:
            text = "\n".join(lines[:line] + lines[line + 1 :])
        else:
            text = "\n".join([*lines[:line], lines[line], *lines[line:]])
    return text.encode("utf-8", "replace")


def spoil_npz(data, rng):
    """Injure the archive itself, or an array in it (its header, its type, its values), packed again soundly."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = [[entry.filename, archive.read(entry)] for entry in archive.infolist()]
    if rng.random() < 0.25 or not entries:
        return spoil_bytes(data, rng)
    entry = entries[int(rng.integers(len(entries)))]
    kind = int(rng.integers(6))
    if kind == 0:
        entry[1] = spoil_bytes(entry[1], rng)
    elif kind == 1:  # the header only
        cut = entry[1].index(b"\n") + 1
        entry[1] = spoil_text(entry[1][10:cut].decode("latin1"), rng).join([entry[1][:10], entry[1][cut:]])
    elif kind == 2:
        entries.remove(entry)
    elif kind == 3:  # another array under its name
        entry[1] = packed(odd_array(rng))
    elif kind == 4:  # some values are odd
        array = np.load(io.BytesIO(entry[1]))
        if array.dtype.kind in "iuf" and array.size:
            array = array.astype(float)
            where = rng.integers(array.size, size=3)
            array.reshape(-1)[where] = rng.choice([np.nan, np.inf, -np.inf, 1e308, -1.0, 0.0, 1e-320, 2**53, 1e5], 3)
        entry[1] = packed(array.reshape(-1)[:-1] if rng.random() < 0.2 else array)
    else:
        entry[0] = entries[int(rng.integers(len(entries)))][0]
    stream = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore")  # two entries of one name are meant
        for name, raw in entries:
            archive.writestr(name, raw)
    return stream.getvalue()


def odd_array(rng):
    shape = tuple(int(n) for n in rng.integers(0, 5, int(rng.integers(0, 5))))
    dtype = str(rng.choice(["<f8", ">f4", "<i8", "|u1", "|b1", "<U3", "|S2", "<c16", "<M8[s]", "<f2", "<U0"]))
    return np.zeros(shape, dtype)


def packed(array):
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(array), allow_pickle=False)
    return stream.getvalue()


def spoil_npz_file(sample, folder, rng):
    (folder / "bad.npz").write_bytes(spoil_npz(sample.read_bytes(), rng))
    return folder / "bad.npz"


def spoil_text_file(sample, folder, rng):
    (folder / sample.name).write_bytes(spoil_text(sample.read_text(encoding="utf-8"), rng))
    return folder / sample.name


def spoil_one_of(name):
    """Spoil one file of a folder and copy the others."""

    def spoil(sample, folder, rng):
        for path in sample.iterdir():
            data = spoil_text(path.read_text(), rng) if path.name == name else path.read_bytes()
            (folder / path.name).write_bytes(data)
        return folder

    return spoil


def spoil_bundle(sample, folder, rng):
    """Spoil one file of the bundle; mostly its hash in the manifest is put right again."""
    shutil.copytree(sample, folder / "bundle", dirs_exist_ok=True)
    files = sorted(path for path in (folder / "bundle").iterdir() if path.is_file())
    victim = files[int(rng.integers(len(files)))]
    data = victim.read_bytes()
    victim.write_bytes(spoil_npz(data, rng) if victim.suffix == ".npz" else spoil_text(data.decode(), rng))
    manifest = folder / "bundle" / "manifest.json"
    if victim != manifest and rng.random() < 0.9:
        document = json.loads(manifest.read_text(encoding="utf-8"))
        document["sha256"][victim.name] = sha256(victim.read_bytes()).hexdigest()
        manifest.write_text(json.dumps(document), encoding="utf-8")
    return folder / "bundle"


# --- use: load, and what everybody does next -----------------------------------------------
def use_run(path):
    from softmap_edge.run import Run
    from softmap_edge.run_summary import sentences, summary

    run = Run.load(path)
    json.dumps(summary(run))
    sentences(summary(run))
    run.at(np.arange(run.frames) % 2 == 0)
    run.save(path.with_name("again.npz"))
    assert Run.load(path.with_name("again.npz")).hash() == run.hash()


def use_logs(folder):
    from softmap_edge.importer import import_logs, read_mapping

    import_logs([folder / "log.csv"], read_mapping(folder / "map.toml"))


def use_finger(path):
    from softmap_edge.finger import Finger
    from softmap_edge.simulator import Simulator

    finger = Finger.load(path)
    Simulator(finger)
    assert Finger.from_toml(finger.to_toml()) == finger


def use_robot(path):
    from softmap_edge.robot import Robot

    robot = Robot.load(path)
    robot.layout.compiled(robot.coordinates().numbers(np.zeros(len(robot.coordinates().labels))))


def use_diagnosis(path):
    from softmap_edge.bundle import builtin_model
    from softmap_edge.diagnosis import Diagnosis

    found = Diagnosis.load(path)
    str(found)
    for entry in found.effects:
        builtin_model().with_effects([entry["name"]], found.params_of(entry["name"]))


def use_sweep(path):
    from softmap_edge.simulator import Sweep

    sweep = Sweep.load(path)
    sweep.save(path.with_name("again.npz"))
    np.testing.assert_array_equal(Sweep.load(path.with_name("again.npz")).vertices, sweep.vertices)


def use_bundle(path):
    from softmap_edge.bundle import load_bundle
    from softmap_edge.run import Run

    model = load_bundle(path)
    model.prior.evaluate(np.zeros((2, model.channels)))
    run = Run(t=[0.0, 1.0], command=np.ones((2, model.channels)), t_seen=[0.5], gravity=[1.0, 0, 0], load=5.0)
    model.predict(run)
    model.features(run)


FORMATS = [
    Format("run", run_sample, spoil_npz_file, use_run),
    Format("run of clouds", clouds_sample, spoil_npz_file, use_run),
    Format("log", logs_sample, spoil_one_of("log.csv"), use_logs),
    Format("mapping", logs_sample, spoil_one_of("map.toml"), use_logs),
    Format("finger", finger_sample, spoil_text_file, use_finger),
    Format("sweep", sweep_sample, spoil_npz_file, use_sweep),
    Format("diagnosis", diagnosis_sample, spoil_text_file, use_diagnosis),
    Format("robot", robot_sample, spoil_text_file, use_robot),
    Format("bundle", bundle_sample, spoil_bundle, use_bundle),
    Format("elastic bundle", elastic_sample, spoil_bundle, use_bundle),
]


def _die_at_7(path):
    if path.name == "spoilt" and (path.parent.parent / "seed").read_text() == "7":
        os.abort()


# Not a format: what the test of this file's own report uses.
DYING = Format("dying", lambda folder: folder, lambda _, folder, __: folder / "spoilt", _die_at_7)


# --- the child -----------------------------------------------------------------------------
class Hang(BaseException):
    """One file took longer than PATIENCE."""


def _hang(*_):
    raise Hang


def child(name, first, count, folder):
    """Spoil and use samples; print how many were refused and accepted, or the first that broke a promise."""
    from softmap_edge.errors import SoftmapError

    form = next(form for form in [*FORMATS, DYING] if form.name == name)
    (folder / "sound").mkdir()
    sample = form.sample(folder / "sound")
    form.use(sample)  # the sample itself is sound
    signal.signal(signal.SIGALRM, _hang)
    faulthandler.enable()  # a crash of the compiled core says where
    refused = accepted = 0
    for seed in range(first, first + count):
        (folder / "seed").write_text(str(seed))  # what a crash leaves behind
        place = folder / "place"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        spoilt = form.spoil(sample, place, np.random.default_rng([seed, len(name)]))
        signal.setitimer(signal.ITIMER_REAL, PATIENCE)
        faulthandler.dump_traceback_later(2 * PATIENCE, exit=True)  # compiled code does not hear the alarm
        try:
            form.use(spoilt)
            accepted += 1
        except SoftmapError as fault:
            refused += 1
            if "\n" in str(fault) or not str(fault).strip() or len(str(fault)) > 1000:
                print(f"seed {seed}: the message is not one line: {str(fault)[:2000]!r}")
                return 1
        except BaseException:
            print(f"seed {seed}: not an error of ours:\n{traceback.format_exc()}")
            return 1
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            faulthandler.cancel_dump_traceback_later()
    print(json.dumps({"refused": refused, "accepted": accepted}))
    return 0


def spoil_many(form, first, count, folder):
    """Run a child over the seeds `first` and on; a child that fails, dies or hangs is told with its format and seed."""

    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    folder.mkdir(exist_ok=True)
    argv = [sys.executable, "-W", "error", __file__, form.name, str(first), str(count), str(folder)]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            argv, capture_output=True, text=True, timeout=120 + count, preexec_fn=limit, env=environment, check=False
        )
        end, said = f"exit {done.returncode}", done.stdout[-3000:] + done.stderr[-3000:]
    except subprocess.TimeoutExpired as late:
        done, end, said = None, f"stopped after {late.timeout:.0f} s", ""
    seed = (folder / "seed").read_text() if (folder / "seed").exists() else "none"
    again = f"{Path(__file__).name} '{form.name}' {seed} 1 FOLDER"
    assert done is not None and done.returncode == 0, f"{form.name}, seed {seed}: {end}; again: {again}\n{said}"
    return json.loads(done.stdout)


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_500_damaged_files(form, tmp_path):
    result = spoil_many(form, 0, 500, tmp_path)
    assert result["refused"] + result["accepted"] == 500
    assert result["refused"] > 100  # the damage is felt: an oracle that accepts everything fails here


@pytest.mark.prove
@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_10000_damaged_files(form, tmp_path):
    parts = range(0, 10_000, 2500)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        results = list(pool.map(lambda first: spoil_many(form, first, 2500, tmp_path / str(first)), parts))
    assert sum(result["refused"] + result["accepted"] for result in results) == 10_000
    assert sum(result["refused"] for result in results) > 2000


def test_a_child_that_dies_names_its_seed(tmp_path):
    """Without this a crash of the core would leave no way to see it again."""
    with pytest.raises(AssertionError, match="dying, seed 7: exit -6"):
        spoil_many(DYING, 0, 10, tmp_path)


if __name__ == "__main__":
    sys.exit(child(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4])))
