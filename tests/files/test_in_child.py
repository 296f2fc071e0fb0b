"""A foreign parser affects only its child process: crash, hang, memory, files, output; plain
values come back.
"""

import ctypes
import os
import resource
import sys
import threading
import time

import numpy as np
import pytest

from softmap_edge.errors import FingerError, SoftmapError
from softmap_edge.files.child import ChildFault, in_child


def test_plain_values_come_back_as_they_are():
    value = {
        "points": np.arange(6.0).reshape(2, 3),
        "cells": [np.arange(4), np.zeros((0, 4), np.int64), np.array(["a", "é"])],
        "names": {"tip": np.array([True, False]), "n": 3, "text": "ä\n", "nothing": None, "x": 0.1},
        "number": np.float64(2.5),
    }
    found = in_child(lambda: value)
    np.testing.assert_array_equal(found["points"], value["points"])
    for got, given in zip(found["cells"], value["cells"], strict=True):
        np.testing.assert_array_equal(got, given)
        assert got.dtype == given.dtype
    assert (
        found["names"]["text"] == "ä\n"
        and found["names"]["nothing"] is None
        and found["number"] == 2.5
    )
    assert in_child(lambda a, b: a + b, 2, 3) == 5
    big = in_child(lambda: np.arange(5_000_000))
    assert big.sum() == 4_999_999 * 2_500_000


def test_a_program_with_many_open_files_gets_its_answer():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard < 4096:
        pytest.skip("this user may not open so many files")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 4096), hard))
    open_files = [os.open(os.devnull, os.O_RDONLY) for _ in range(1100)]
    try:
        assert in_child(lambda: 5) == 5
    finally:
        for file in open_files:
            os.close(file)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def hang():
    time.sleep(60)


def spin():
    while True:
        pass


def hungry():
    return np.ones(10**9)


def hungry_list():
    parts = []
    while True:
        parts.append("x" * 10**6 + str(len(parts)))


def deep():
    def down(n):
        return down(n + 1)

    return down(0)


def crash():
    ctypes.string_at(0)


def leave():
    sys.exit("parsers do that")


def vanish():
    os._exit(3)


def objects():
    return np.array([None, {}], dtype=object)


@pytest.mark.parametrize(
    "function, says",
    [
        (hang, "longer than 1 s"),
        (spin, "longer than 1 s"),
        (hungry, "needs more than 300 MB"),
        (hungry_list, "needs more than 300 MB"),
        (deep, "RecursionError"),
        (crash, "crashed .signal 11"),
        (leave, "SystemExit: parsers do that"),
        (vanish, "crashed .exit 3"),
        (objects, "ValueError"),
        (lambda: {1: object()}, "TypeError"),
    ],
)
def test_what_goes_wrong_is_one_error(function, says):
    seconds = 1.0 if "longer" in says else 30.0
    started = time.monotonic()
    with pytest.raises(ChildFault, match=says) as fault:
        in_child(function, megabytes=300, seconds=seconds)
    assert time.monotonic() - started < seconds + 4.0 and "\n" not in str(fault.value)
    with pytest.raises(ChildProcessError):  # no child is left behind
        os.waitpid(-1, os.WNOHANG)


def test_errors_of_this_package_keep_their_class():
    def refuse():
        raise FingerError("no finger")

    with pytest.raises(FingerError, match="^no finger$"):
        in_child(refuse)
    assert issubclass(ChildFault, SoftmapError)


def test_the_child_writes_no_file_and_prints_nothing(tmp_path, capfd):
    def write():
        print("from the parser")
        os.write(2, b"and more")
        (tmp_path / "made").write_text("x" * 10_000)

    with pytest.raises(ChildFault):
        in_child(write)
    assert not (tmp_path / "made").exists() or not (tmp_path / "made").read_text()
    assert capfd.readouterr() == ("", "")


def test_it_works_while_threads_run():
    stop = threading.Event()
    workers = [
        threading.Thread(target=lambda: [np.ones(1000).sum() for _ in iter(stop.is_set, True)])
        for _ in "ab"
    ]
    for worker in workers:
        worker.start()
    try:
        for k in range(20):
            assert in_child(lambda k: np.full(3, k), k).tolist() == [k] * 3
    finally:
        stop.set()
        for worker in workers:
            worker.join()


def test_the_child_holds_nothing_of_what_the_parent_has_open(tmp_path):
    """A port or a socket of the caller is no parser's; only the standard streams, the null device
    and the pipe stay.
    """

    def still_open():
        links = [f"/proc/self/fd/{number}" for number in os.listdir("/proc/self/fd")]
        # that of the listing is closed
        return [os.readlink(link) for link in links if os.path.lexists(link)]

    with open(tmp_path / "port", "w") as port:
        names = in_child(still_open)
    assert port.name not in names and set(names) <= {
        os.devnull,
        *(n for n in names if n.startswith("pipe:")),
    }
    assert len(names) < 8
