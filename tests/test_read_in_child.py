"""Parsers of foreign formats run within limits: whatever they do, the parent gets arrays or one error."""

import os
import resource
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from softmap_edge.errors import RunError
from softmap_edge.logs.readers import in_child
from softmap_edge.logs.readers.in_child import MEMORY, Answer, read_in_child

HERE = Path(__file__).parent


# --- parsers, called in the child ----------------------------------------------------------
def preload():
    pass


def answer(path, rows):
    print("a parser that prints")
    text = path.read_text()
    return Answer({"x": np.arange(rows * 2.0).reshape(rows, 2), "none": np.zeros((0, 3))}, {"text": text})


def use(path, how):
    print(how)
    match how:
        case "memory":
            np.ones(MEMORY // 8 + 2**20)
        case "loop":
            while True:
                pass
        case "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        case "exit":
            os._exit(7)
        case "refuse":
            raise RunError(f"{path}: no")
        case "fail":
            raise KeyError("a\nb")
        case "deep":
            return use(path, how)
        case "nested":
            raise MemoryError
    return Answer()


def limits(path):
    core, file = (resource.getrlimit(what)[0] for what in (resource.RLIMIT_CORE, resource.RLIMIT_FSIZE))
    return Answer(document={"fds": len(os.listdir("/proc/self/fd")), "core": core, "file": file})


# --- what the parent sees ------------------------------------------------------------------
@pytest.fixture
def path(tmp_path):
    (tmp_path / "file").write_text("text")
    return tmp_path / "file"


def test_arrays_and_a_document_come_back(path):
    found = read_in_child(path, "file", "test_read_in_child:answer", rows=3)
    assert found.arrays["x"].tolist() == [[0, 1], [2, 3], [4, 5]] and found.arrays["none"].shape == (0, 3)
    assert found.document == {"text": "text"}


def test_a_path_is_taken_from_where_the_caller_works(path, tmp_path, monkeypatch):
    (tmp_path / "other").mkdir()
    (tmp_path / "other/file").write_text("another")
    found = []
    for folder in (tmp_path, tmp_path / "other"):
        monkeypatch.chdir(folder)
        found.append(read_in_child(Path("file"), "file", "test_read_in_child:answer", rows=1).document["text"])
    assert found == ["text", "another"]


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("memory", "needs more than 1024 MB to be read"),
        ("nested", "needs more than 1024 MB to be read"),
        ("deep", "needs more than 1024 MB to be read"),
        ("crash", "SIGSEGV while it was read"),
        ("exit", "ended with 7 while it was read"),
        ("refuse", "file: no"),
        ("fail", "is a damaged file ('a"),
    ],
)
def test_whatever_a_parser_does_is_one_error_and_the_next_file_is_read(path, how, words):
    with pytest.raises(RunError) as fault:
        read_in_child(path, "file", "test_read_in_child:use", how=how)
    assert words in str(fault.value) and "\n" not in str(fault.value)
    assert read_in_child(path, "file", "test_read_in_child:answer", rows=1).document == {"text": "text"}


def test_a_parser_without_end_is_stopped(path, monkeypatch):
    monkeypatch.setattr(in_child, "SECONDS", 0.5)
    started = time.monotonic()
    with pytest.raises(RunError, match="was not read within 1 s|was not read within 0 s"):
        read_in_child(path, "file", "test_read_in_child:use", how="loop")
    assert time.monotonic() - started < 10


def test_the_server_is_started_again_when_it_was_killed(path):
    assert read_in_child(path, "file", "test_read_in_child:answer", rows=1)
    old = in_child._servers[-1].process
    old.kill()
    old.wait()
    assert read_in_child(path, "file", "test_read_in_child:answer", rows=1)
    assert in_child._servers[-1].process.pid != old.pid


def test_one_server_answers_several_threads(path):
    found = []
    work = [
        threading.Thread(target=lambda: found.append(read_in_child(path, "file", "test_read_in_child:answer", rows=2)))
        for _ in range(6)
    ]
    for thread in work:
        thread.start()
    for thread in work:
        thread.join()
    assert len(found) == 6 and all(one.arrays["x"].shape == (2, 2) for one in found)


def test_a_forked_process_has_a_server_of_its_own(path):
    read_in_child(path, "file", "test_read_in_child:answer", rows=1)
    child = os.fork()
    if child == 0:
        code = 1
        try:
            found = read_in_child(path, "file", "test_read_in_child:answer", rows=4)
            code = 0 if found.arrays["x"].shape == (4, 2) else 2
            in_child._servers[-1].close()
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert read_in_child(path, "file", "test_read_in_child:answer", rows=1)


def test_the_child_opens_little_and_leaves_no_core(path):
    document = read_in_child(path, "file", "test_read_in_child:limits").document
    assert document["core"] == 0 and document["fds"] < 12 and document["file"] <= 8 * in_child.MOST + 2**26


def test_the_server_ends_with_its_parent(path):
    script = (
        "import sys; sys.path[:0] = [sys.argv[2]]\n"
        "from pathlib import Path\nfrom softmap_edge.logs.readers import in_child\n"
        "in_child.read_in_child(Path(sys.argv[1]), 'file', 'test_read_in_child:answer', rows=1)\n"
        "print(in_child._servers[-1].process.pid, flush=True)\n"
    )
    for end in ("", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)\n"):
        done = subprocess.run(
            [sys.executable, "-c", script + end, str(path), str(HERE)], capture_output=True, text=True
        )
        server = int(done.stdout)
        for _ in range(100):
            if not Path(f"/proc/{server}").exists():
                break
            time.sleep(0.05)
        assert not Path(f"/proc/{server}").exists() and not done.stderr


def test_a_module_in_the_working_folder_is_not_imported(path, tmp_path):
    """A file called numpy.py next to the logs is no part of Python's path."""
    (tmp_path / "work").mkdir()
    (tmp_path / "work/numpy.py").write_text("open('run', 'w')")
    (tmp_path / "work/scipy.py").write_text("open('run', 'w')")
    script = (
        "import sys; sys.path.append(sys.argv[2])\n"
        "from pathlib import Path\nfrom softmap_edge.logs.readers import in_child\n"
        "in_child.read_in_child(Path(sys.argv[1]), 'file', 'test_read_in_child:answer', rows=1)\n"
    )
    script = script.replace("in_child.read", "sys.path[:0] = ['']  # as in a session\nin_child.read")
    argv = [sys.executable, "-P", "-c", script, str(path), str(HERE)]
    done = subprocess.run(argv, capture_output=True, text=True, cwd=tmp_path / "work")
    assert done.returncode == 0 and not (tmp_path / "work/run").exists(), done.stderr
