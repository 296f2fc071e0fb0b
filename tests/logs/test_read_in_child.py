"""Parsers of foreign formats run within limits: whatever they do, the parent gets arrays or one
error.
"""

import os
import resource
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from softmap_edge.errors import RunError
from softmap_edge.logs.readers import in_child
from softmap_edge.logs.readers.in_child import MEGABYTES, Answer, read_in_child


# --- parsers, called in the child ----------------------------------------------------------
def answer(path, rows):
    print("a parser that prints")
    text = path.read_text()
    return Answer(
        {"x": np.arange(rows * 2.0).reshape(rows, 2), "none": np.zeros((0, 3))}, {"text": text}
    )


def use(path, how):
    print(how)
    match how:
        case "memory":
            # twice the limit: a child may give memory back that it inherited
            np.ones(MEGABYTES * 2**18)
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
    core, file = (
        resource.getrlimit(what)[0] for what in (resource.RLIMIT_CORE, resource.RLIMIT_FSIZE)
    )
    return Answer(document={"fds": len(os.listdir("/proc/self/fd")), "core": core, "file": file})


# --- what the parent sees ------------------------------------------------------------------
@pytest.fixture
def path(tmp_path):
    (tmp_path / "file").write_text("text")
    return tmp_path / "file"


def test_arrays_and_a_document_come_back(path):
    found = read_in_child(path, "file", answer, rows=3)
    assert found.arrays["x"].tolist() == [[0, 1], [2, 3], [4, 5]] and found.arrays[
        "none"
    ].shape == (0, 3)
    assert found.document == {"text": "text"}


def test_a_path_is_taken_from_where_the_caller_works(path, tmp_path, monkeypatch):
    (tmp_path / "other").mkdir()
    (tmp_path / "other/file").write_text("another")
    found = []
    for folder in (tmp_path, tmp_path / "other"):
        monkeypatch.chdir(folder)
        found.append(read_in_child(Path("file"), "file", answer, rows=1).document["text"])
    assert found == ["text", "another"]


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("memory", "needs more than 1024 MB to be read"),
        ("nested", "needs more than 1024 MB to be read"),
        ("deep", "is a damaged file (RecursionError"),
        ("crash", "crashed (signal 11)"),
        ("exit", "crashed (exit 7)"),
        ("refuse", "file: no"),
        ("fail", "is a damaged file (KeyError: 'a"),
    ],
)
def test_whatever_a_parser_does_is_one_error_and_the_next_file_is_read(path, how, words):
    with pytest.raises(RunError) as fault:
        read_in_child(path, "file", use, how=how)
    assert words in str(fault.value) and "\n" not in str(fault.value)
    assert read_in_child(path, "file", answer, rows=1).document == {"text": "text"}


def test_a_parser_without_end_is_stopped(path, monkeypatch):
    monkeypatch.setattr(in_child, "SECONDS", 0.5)
    started = time.monotonic()
    with pytest.raises(RunError, match="was not read within 1 s|was not read within 0 s"):
        read_in_child(path, "file", use, how="loop")
    assert time.monotonic() - started < 10


def test_several_threads_read_at_once(path):
    found = []
    work = [
        threading.Thread(target=lambda: found.append(read_in_child(path, "file", answer, rows=2)))
        for _ in range(6)
    ]
    for thread in work:
        thread.start()
    for thread in work:
        thread.join()
    assert len(found) == 6 and all(one.arrays["x"].shape == (2, 2) for one in found)


def test_the_child_opens_little_and_leaves_no_core(path):
    document = read_in_child(path, "file", limits).document
    assert document["core"] == 0 and document["fds"] < 12 and document["file"] == 0
