"""A write that fails gives one line with file, reason and remedy; the earlier file stays."""

import errno
import os
import re
import resource
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from finger_runs import finger_run

from softmap_edge import cli
from softmap_edge.cli import main
from softmap_edge.files.atomic import replacement_of, replacement_of_folder, write_atomically
from softmap_edge.files.refusals import refusal
from softmap_edge.model.bundle import builtin_model, save_bundle

COMMANDS = {
    "import": ("import log.csv --map map.toml --force --out", "out.npz"),
    "guess": ("import log.csv --guess --force --out", "out.toml"),
    "cut": ("run cut run.npz --from 0 --to 30 --force --out", "out.npz"),
    "join": ("run join run.npz other.npz --force --out", "out.npz"),
    "remove": ("model remove backlash --bundle bundle --force --out", "out"),
    "predict": ("model predict 8,-4 --out", "out.npz"),
    "next": ("next --standard --out", "out.csv"),
    "track": ("track S --plan --picture", "out.svg"),
}


def system_refuses(number):
    @contextmanager
    def fault(monkeypatch, _):
        def refuse(*_, **__):
            raise OSError(number, os.strerror(number))

        for name in ("mkstemp", "mkdtemp"):
            monkeypatch.setattr(f"softmap_edge.files.atomic.tempfile.{name}", refuse)
        yield

    return fault


@contextmanager
def limited(*_):
    """Files may have 16 bytes, so a write fails half way."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (16, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextmanager
def folder_there(_, out):
    if out.is_file():
        out.unlink()
    (out / "inside").mkdir(parents=True, exist_ok=True)
    yield


FAULTS = {
    "full": (system_refuses(errno.ENOSPC), "the disk is full; free some space"),
    "quota": (system_refuses(errno.EDQUOT), "quota) is used up; free some space"),
    "read-only": (system_refuses(errno.EROFS), "the disk is read-only; give another place"),
    "denied": (system_refuses(errno.EACCES), "permission denied; give a path that you may use"),
    "broken": (system_refuses(errno.EIO), "the disk reports an error; check the disk"),
    "limit": (limited, "larger than the limit for files here; raise the limit"),
}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    finger_run().save(folder / "run.npz")
    finger_run(seed=1).save(folder / "other.npz")
    t = 0.05 * np.arange(60)
    rows = np.c_[t, 8 * np.sin(t), 20 * np.sin(t), 5 * np.cos(t), 100 - t]
    lines = [",".join(f"{x:.5f}" for x in row) for row in rows]
    (folder / "log.csv").write_text("\n".join(["t,u,x,y,z", *lines]) + "\n")
    (folder / "map.toml").write_text(
        'schema = "softmap.mapping/1"\n[[log]]\ntime = { column = "t" }\n'
        'command = { columns = ["u"] }\nmarkers = { columns = [["x", "y", "z"]] }\n'
    )
    save_bundle(
        builtin_model().with_effects(["backlash"], {"backlash.gap": 1.0}), folder / "bundle"
    )
    return folder


def stand(path):
    """Return the names and contents of all files below a folder."""
    return {
        str(one.relative_to(path)): one.read_bytes() for one in path.rglob("*") if one.is_file()
    }


@pytest.mark.parametrize("command", COMMANDS)
def test_every_refused_write_names_file_reason_and_remedy(
    command, inputs, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(inputs)
    words, name = COMMANDS[command]
    argv = [*words.split(), str(tmp_path / name)]
    assert main(argv) == 0  # the earlier result
    before = stand(tmp_path)
    assert before
    for fault, said in FAULTS.values():
        capsys.readouterr()
        with monkeypatch.context() as patch, fault(patch, tmp_path / name):
            assert main(argv) == 2
        lines = capsys.readouterr().err.strip().splitlines()
        told = lines[-1]
        assert str(tmp_path / name) in told and said in told, told
        assert "Errno" not in told and "Traceback" not in told
        assert stand(tmp_path) == before


@pytest.mark.parametrize("command", COMMANDS)
def test_impossible_names_are_refused_before_the_work(
    command, inputs, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(inputs)
    words, name = COMMANDS[command]
    (tmp_path / "file").write_text("kept")
    long = tmp_path / ("n" * 260 + Path(name).suffix)
    below = tmp_path / "file" / name
    with folder_there(None, tmp_path / name):
        for out in (tmp_path / name, long, below):
            assert main([*words.split(), str(out)]) == 2
            told = capsys.readouterr().err.strip().splitlines()
            assert len(told) == 1 and str(out)[:60] in told[0] and ";" in told[0], told
            assert "Errno" not in told[0]
    assert stand(tmp_path) == {"file": b"kept"}


# --- one place -----------------------------------------------------------------------------
def test_a_name_of_the_longest_length_has_room_for_a_temporary_one(tmp_path):
    for name in ("n" * 255, "ä" * 127):
        write_atomically(tmp_path / name, "all")
        assert (tmp_path / name).read_text() == "all"
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_only_files_are_replaced(tmp_path, kind):
    out = Path("/dev/null") if kind == "device" else tmp_path / "out"
    if kind == "pipe":
        os.mkfifo(out)
    elif kind == "folder":
        out.mkdir()
    with pytest.raises(OSError, match=r"a device or a pipe|Is a directory") as failed:
        write_atomically(out, "lost")
    assert failed.value.filename == str(out) and out.exists() and not out.is_file()


def test_a_folder_that_cannot_be_put_in_place_leaves_the_old_one(tmp_path, monkeypatch):
    out = tmp_path / "bundle"
    out.mkdir()
    (out / "a").write_text("old")
    real = Path.replace

    def once(self, target):
        if self.name == "new":
            raise OSError(errno.EIO, "Input/output error", str(self))
        return real(self, target)

    monkeypatch.setattr(Path, "replace", once)
    with pytest.raises(OSError, match="Input/output"), replacement_of_folder(out) as new:
        (new / "a").write_text("new")
    assert stand(tmp_path) == {"bundle/a": b"old"}


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (OSError(errno.ENOSPC, "x", "f"), "f: the disk is full; free some space, or give another"),
        (OSError(errno.ELOOP, "Too many levels", "f"), "f: too many levels; give another path"),
        (OSError("odd"), "odd; give another path"),
        (OSError(errno.ENOENT, "x", "a", None, "b"), "b: no such file or folder; give a path"),
    ],
)
def test_every_fault_of_the_system_has_plain_words(fault, said):
    assert refusal(fault).startswith(said)


# --- signals and streams -------------------------------------------------------------------
HALF_WAY = """
import sys, time, zipfile
from softmap_edge.cli import main
write = zipfile.ZipFile.writestr
def slow(self, *args, **options):
    write(self, *args, **options)
    print("up", flush=True)
    time.sleep(20)
zipfile.ZipFile.writestr = slow
sys.exit(main())
"""


@pytest.mark.parametrize(
    ("number", "said"),
    [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated"), (signal.SIGHUP, "terminated")],
)
def test_a_signal_during_a_write_leaves_no_partial_file(number, said, inputs, tmp_path):
    out = tmp_path / "out.npz"
    out.write_bytes(b"before")
    argv = ["run", "cut", str(inputs / "run.npz"), "--from", "0", "--to", "30", "--out", str(out)]
    heard = (  # a shell in the background, or `nohup`, has ignored them
        "import signal\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", heard + HALF_WAY, *argv],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout.readline() == "up\n"
        process.send_signal(number)
        told = process.communicate(timeout=60)[1]
    assert process.returncode == 128 + number and told == f"softmap run: {said}\n"
    assert stand(tmp_path) == {"out.npz": b"before"}


@pytest.mark.parametrize("argv", [["--version"], ["help"], ["show", "run.npz"]])
def test_a_full_disk_behind_standard_output_is_one_line(argv, inputs):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "softmap_edge", *argv],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            cwd=inputs,
            check=False,
        )
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "standard output: the disk is full; free some space" in done.stderr


UNCHANGED = {  # files that are new each time, grow, or lie in a folder of `replacement_of`
    "files/atomic.py": "the one place",
    "files/child.py": "/dev/null",
    "model/bundle.py": "in a folder of replacement_of_folder",
    "robot/teleop/model_file.py": "in a file of replacement_of",
    "robot/drive/command_file.py": "in a file of replacement_of",
    "robot/drive/observations.py": "a recording, kept up to its last line",
    "robot/control/session_mark.py": "a mark of a session that may have crashed",
    "robot/link/session.py": "a new key for its owner alone",
    "logs/readers/packed.py": "an unpacked copy in a temporary folder",
    "logs/readers/json_lines.py": "a table in a temporary folder",
}


def test_results_are_written_in_one_place():
    writes = re.compile(
        r"\.write_(text|bytes)\(|open\([^)\n]*[\"'][wxa]b?[\"']|np\.save|\.to_csv\(|\.tofile\("
    )
    folder = Path(cli.__file__).parent
    found = {
        str(file.relative_to(folder))
        for file in folder.rglob("*.py")
        if writes.search(file.read_text(encoding="utf-8"))
    }
    assert found <= UNCHANGED.keys(), found - UNCHANGED.keys()


def test_a_partial_file_is_removed_when_its_writer_stops(tmp_path):
    for stop in (KeyboardInterrupt, SystemExit, MemoryError):
        with pytest.raises(stop), replacement_of(tmp_path / "out") as partial:
            partial.write_text("half")
            raise stop
    assert not list(tmp_path.iterdir())
