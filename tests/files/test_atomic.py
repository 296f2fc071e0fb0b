"""Results are complete or absent: a failed write names the file and leaves nothing behind."""

import errno
import resource
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from finger_runs import finger_run

from softmap_edge.cli import main
from softmap_edge.files.atomic import replacement_of, replacement_of_folder, write_atomically
from softmap_edge.files.toml import MOST_PARTS, parsed

LIMITED = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)),) * 2)
from softmap_edge.cli import main
sys.exit(main())
"""


def limited(size, *argv, cwd):
    """Run a command that can write no file of more than `size` bytes."""
    return subprocess.run(
        [sys.executable, "-c", LIMITED, str(size), *argv],
        capture_output=True,
        text=True,
        cwd=cwd,
        check=False,
    )


def full(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("place", [replacement_of, replacement_of_folder])
def test_a_failed_write_names_the_file_and_leaves_nothing(place, tmp_path):
    with pytest.raises(OSError, match="No space left") as failed, place(tmp_path / "result"):
        full()
    assert failed.value.filename == str(tmp_path / "result")
    assert list(tmp_path.iterdir()) == []


def test_an_error_about_another_file_keeps_its_name(tmp_path):
    with pytest.raises(FileNotFoundError) as failed, replacement_of(tmp_path / "result"):
        (tmp_path / "input.csv").read_bytes()
    assert failed.value.filename == str(tmp_path / "input.csv")


def test_a_failed_write_keeps_what_was_there(tmp_path):
    write_atomically(tmp_path / "d.json", "before")
    with pytest.raises(OSError, match="No space left"), replacement_of(tmp_path / "d.json"):
        full()
    with (
        pytest.raises(OSError, match="No space"),
        replacement_of_folder(tmp_path / "bundle") as new,
    ):
        (new / "half").write_text("half")
        full()
    assert (tmp_path / "d.json").read_text() == "before"
    assert [file.name for file in tmp_path.iterdir()] == ["d.json"]


def test_a_diagnosis_that_cannot_be_written_is_printed(tmp_path):
    finger_run(["backlash"], {"backlash.gap": 1.5}).save(tmp_path / "run.npz")
    done = limited(1000, "diagnose", "run.npz", "--out", "d.json", cwd=tmp_path)
    assert done.returncode == 2 and "backlash" in done.stdout
    assert done.stderr.rstrip().endswith("or give a disk that takes larger files")
    assert "d.json: " in done.stderr and "Traceback" not in done.stderr
    assert [file.name for file in tmp_path.iterdir()] == ["run.npz"]


def test_a_bundle_that_cannot_be_written_leaves_nothing(tmp_path):
    done = limited(1000, "add", "backlash", "--out", "better", "--from", "d.json", cwd=tmp_path)
    assert done.returncode == 2
    finger_run(["backlash"], {"backlash.gap": 1.5}).save(tmp_path / "run.npz")
    assert main(["diagnose", str(tmp_path / "run.npz"), "--out", str(tmp_path / "d.json")]) == 0
    done = limited(1000, "add", "--from", "d.json", "--out", "better", cwd=tmp_path)
    assert done.returncode == 2 and f"{tmp_path / 'better'}: it would be larger" in done.stderr
    assert sorted(file.name for file in tmp_path.iterdir()) == ["d.json", "run.npz"]


def test_a_full_disk_has_its_own_remedy(tmp_path, monkeypatch, capsys):
    finger_run().save(tmp_path / "run.npz")
    monkeypatch.setattr("softmap_edge.files.atomic.tempfile.mkstemp", full)
    argv = ["run", "cut", str(tmp_path / "run.npz"), "--from", "0", "--to", "30"]
    assert main([*argv, "--out", str(tmp_path / "piece.npz")]) == 2
    assert (
        f"{tmp_path / 'piece.npz'}: the disk is full; free some space, or give another place"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    "argv",
    [
        ["diagnose", "run.npz", "--out", "kept/d.json"],
        ["compare", "run.npz", "--html", "kept/c.html"],
        ["learn", "run.npz", "--out", "kept/rod"],
    ],
)
def test_a_place_that_cannot_be_written_is_refused_before_the_work(
    argv, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    finger_run().save("run.npz")
    Path("kept").mkdir()
    monkeypatch.setattr("softmap_edge.commands.output.os.access", lambda folder, how: False)
    assert main(argv) == 2
    said = capsys.readouterr()
    assert said.out == "" and "nothing can be written into" in said.err


# --- keys of TOML -----------------------------------------------------------------------------------

LONG = ".".join("a" for _ in range(60_000))


@pytest.mark.parametrize(
    "text",
    [
        f"{LONG} = 1",
        f"[{LONG}]",
        f"x = 1\nlist = [1, {{{LONG} = 1}}]",
        " . ".join(["'a'"] * 5000) + " = 1",
        ".".join(['"b c"'] * (MOST_PARTS + 1)) + " = 1",
    ],
)
def test_a_long_dotted_key_is_refused_before_it_takes_memory(text):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(tomllib.TOMLDecodeError, match="more than 16 parts"):
        parsed(text)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # kB


@pytest.mark.parametrize(
    "text",
    [
        "a.b.c = 1\n[d.e]\n'f g'.h = 2\n",
        f'note = "{"word. " * 1000}"\n',
        f"numbers = [{', '.join(['1.5'] * 1000)}]\n",
        f"note = '{'x' * 500_000}'\n",
        'names = ["1.2.3.4", "a.b.c.npz"]\n',
        f"# {'a.' * 100}\nx = 1\n",
        'note = """' + "a." * 100 + "\n" + "b." * 100 + '"""\n',
        "note = '''" + "a." * 100 + "'''\n",
        'note = "quoted \\"' + "a." * 100 + '\\" end"\n',
    ],
)
def test_ordinary_texts_are_read(text):
    assert parsed(text) == tomllib.loads(text)
