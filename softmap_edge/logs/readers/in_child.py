"""Run parsers of foreign formats on files of unknown origin in a child process with limits of memory and time.

`read_in_child(path, what, call, **arguments)` asks a server process, started once, which imports the parser and forks
for each file. The fork takes at most MEMORY more than the server has, and SECONDS of processor time (more for large
files). The parent gets arrays and a document, or raises one RunError. The answer is a JSON head and plain float64
numbers in a temporary file: nothing is unpickled. Pinned by tests/test_read_in_child.py.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import json
import math
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError, brief

Array = NDArray[np.float64]
MEMORY = 2**30  # bytes that a parser may take
MOST = 2**25  # numbers of one file: a million rows of 32 columns, 256 MiB
SECONDS = 2.5  # of processor time for a small file
PER_SECOND = 2**22  # bytes of a file that a parser reads in a second, at least
_PATIENCE = 4.0  # real time for each second of processor time: the computer may be busy
_HEAD = 2**26  # bytes of the head of an answer
_OPTIONS = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"}
_OPTIONS |= {"HDF5_PLUGIN_PRELOAD": "::"}  # HDF5 loads no filter from outside its library
_START = (
    "import sys, json; sys.path[:] = json.loads(sys.argv[1]); "
    "from softmap_edge.logs.readers.in_child import serve; serve()"
)


@dataclass
class Answer:
    """The result of a parser.

    Attributes:
        arrays: numbers by name, of any shape.
        document: all other results, as JSON.
    """

    arrays: dict[str, Array] = field(default_factory=dict)
    document: dict[str, Any] = field(default_factory=dict)


def read_in_child(path: Path, what: str, call: str, **arguments: Any) -> Answer:
    """Call a parser on a file in a child process with limits.

    Args:
        path: the file.
        what: its format, for messages: `MATLAB file`.
        call: `module:function`; the function takes the path and the arguments and returns an `Answer`.
        arguments: of the function, as JSON.

    Raises:
        RunError: the parser refuses the file, fails, crashes, or takes too much memory or time.
    """
    with tempfile.TemporaryDirectory(prefix="softmap-") as folder:
        out = Path(folder) / "answer"
        seconds = SECONDS + path.stat().st_size / PER_SECOND
        job = {"call": call, "path": str(path), "arguments": arguments, "out": str(out), "seconds": seconds}
        job["folder"] = os.getcwd()
        end = _server().ask(job)
        if end == "done":
            return _answer(path, what, out)
    if end == "late":
        raise RunError(f"{path}: this {what} was not read within {seconds:.0f} s; it is damaged or too large: split it")
    raise RunError(f"{path}: is a damaged {what} ({end} while it was read); export it again")


def _answer(path: Path, what: str, out: Path) -> Answer:
    with out.open("rb") as file:
        head = json.loads(file.readline(_HEAD))
        if "refused" in head:
            raise RunError(head["refused"])
        if "memory" in head:
            raise RunError(f"{path}: this {what} needs more than {MEMORY >> 20} MB to be read; split it")
        if "damaged" in head:
            raise RunError(f"{path}: is a damaged {what} ({head['damaged']}); export it again")
        arrays = {name: _array(file, shape) for name, shape in head["arrays"]}
    return Answer(arrays, head["document"])


def _array(file: BinaryIO, shape: list[int]) -> Array:
    return np.fromfile(file, np.float64, int(np.prod(shape, dtype=object))).reshape(shape)


# --- the server, seen from the parent ------------------------------------------------------
class _Server:
    """The process that forks for each file; it ends with this one."""

    def __init__(self) -> None:
        argv = [sys.executable, "-P", "-W", "ignore", "-c", _START, json.dumps(_folders())]
        self.owner, self.lock = os.getpid(), threading.Lock()
        self.process = subprocess.Popen(
            argv,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | _OPTIONS,
            start_new_session=True,  # Ctrl-C reaches it through its parent
        )

    def ask(self, job: dict[str, Any]) -> str:
        """Return how a job ended: `done`, `late` or what went wrong."""
        assert self.process.stdin is not None and self.process.stdout is not None
        with self.lock:
            try:
                self.process.stdin.write(json.dumps(job).encode() + b"\n")
                self.process.stdin.flush()
                line = self.process.stdout.readline()
            except BaseException as cause:
                self.close()  # an answer that comes later belongs to no question
                if isinstance(cause, BrokenPipeError):
                    return "the process that reads it ended"
                raise
        return json.loads(line) if line else "the process that reads it ended"

    def close(self) -> None:
        """End the process without waiting for its work."""
        if os.getpid() == self.owner:
            for stream in (self.process.stdin, self.process.stdout):
                with contextlib.suppress(OSError):
                    assert stream is not None
                    stream.close()
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()

    def forget(self) -> None:
        """Leave the process to its owner, or end it where that is this process."""
        self.close()
        self.process.returncode = self.process.returncode or 0


def _folders() -> list[str]:
    """Return where Python looks for packages, without the working folder, which may be that of the logs."""
    own = str(Path(__file__).resolve().parents[3])
    return list(dict.fromkeys([*(folder or own for folder in sys.path), own]))


_servers: list[_Server] = []


def _server() -> _Server:
    """Return the server of this process, started if there is none."""
    if not _servers or _servers[-1].owner != os.getpid() or _servers[-1].process.poll() is not None:
        for other in _servers:
            other.forget()
        _servers[:] = [_Server()]
        atexit.register(_servers[-1].close)
    return _servers[-1]


# --- the server itself ---------------------------------------------------------------------
def serve() -> None:
    """Answer questions on standard input until it ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 1)  # the output of a parser is no answer
    for line in sys.stdin.buffer:
        print(json.dumps(_in_fork(json.loads(line))), file=answers, flush=True)


def _in_fork(job: dict[str, Any]) -> str:
    module = importlib.import_module(job["call"].partition(":")[0])
    with contextlib.suppress(ImportError):
        module.preload()  # once, for all files to come
    child = os.fork()
    if child == 0:
        try:
            os.chdir(job["folder"])
            _limit(job["seconds"])
            _work(job)
        finally:
            os._exit(1)
    return _waited(child, job["seconds"] * _PATIENCE)


def _limit(seconds: float) -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY
    for what, value in (
        (resource.RLIMIT_AS, most),
        (resource.RLIMIT_CPU, math.ceil(seconds)),
        (resource.RLIMIT_FSIZE, 8 * MOST + _HEAD),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(what)[1]
        value = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(what, (value, value))


def _work(job: dict[str, Any]) -> None:
    """Run the parser and write its answer; the fork ends here."""
    module, _, name = job["call"].partition(":")
    try:
        answer = getattr(importlib.import_module(module), name)(Path(job["path"]), **job["arguments"])
        _write(Path(job["out"]), answer)
    except RunError as fault:
        _write_head(job, {"refused": str(fault)})
    except (MemoryError, RecursionError) as fault:
        _write_head(job, {"memory": type(fault).__name__})
    except Exception as fault:
        memory = "memory" in str(fault).lower() or "allocate" in str(fault).lower()
        _write_head(job, {"memory" if memory else "damaged": brief(fault) or type(fault).__name__})
    os._exit(0)


def _write(out: Path, answer: Answer) -> None:
    shapes = [[name, list(array.shape)] for name, array in answer.arrays.items()]
    with out.open("wb") as file:
        file.write(json.dumps({"arrays": shapes, "document": answer.document}).encode() + b"\n")
        for array in answer.arrays.values():
            np.ascontiguousarray(array, np.float64).tofile(file)


def _write_head(job: dict[str, Any], head: dict[str, Any]) -> None:
    Path(job["out"]).write_bytes(json.dumps(head).encode() + b"\n")


def _waited(child: int, seconds: float) -> str:
    """Wait for the fork; return how it ended."""
    late = time.monotonic() + seconds
    pause = 0.001
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            break
        if time.monotonic() > late:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "late"
        time.sleep(pause)
        pause = min(1.5 * pause, 0.05)
    code = os.waitstatus_to_exitcode(status)
    if code == 0:
        return "done"
    if -code in (signal.SIGXCPU, signal.SIGKILL):
        return "late"
    return f"the parser ended with {signal.Signals(-code).name}" if code < 0 else f"the parser ended with {code}"
