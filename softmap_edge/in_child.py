"""Run a foreign parser on an untrusted file in a child process with a limit on its memory and its time.

    arrays = in_child(parse, path, megabytes=1000, seconds=60)

The child is forked, so it starts in milliseconds and needs no import. It cannot write to any file, and its output is
dropped. Its result comes back as JSON and raw arrays: no pickle is read. If it crashes, hangs or takes more memory than
allowed, only the child ends. Pinned by tests/test_in_child.py.
"""

from __future__ import annotations

import faulthandler
import io
import json
import os
import resource
import select
import signal
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from softmap_edge import errors
from softmap_edge.errors import SoftmapError, brief

PAGE = 1 << 16  # bytes read at a time from the child
_PAGE_SIZE = os.sysconf("SC_PAGE_SIZE")


class ChildFault(SoftmapError):
    """The child raised another library's exception, crashed, or exceeded a limit; the message states which."""


def in_child(function: Callable[..., Any], *args: Any, megabytes: int = 1000, seconds: float = 60.0) -> Any:
    """Call `function(*args)` in a forked child and return its result.

    Args:
        function: returns arrays of numbers or text, numbers, text or None, or lists or dicts (by text) of them.
        args: its arguments.
        megabytes: memory that the child may take beyond that of this process, and size of the answer.
        seconds: time that it may take.

    Returns:
        Any: what the function returned.

    Raises:
        SoftmapError: the function raised an error of this package; it is raised again with its class and message.
        ChildFault: it raised anything else, crashed, or met a limit.
    """
    ours, theirs = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a fork while threads run: the child uses none of them
        pid = os.fork()
    if pid == 0:
        os.close(ours)
        _be_child(theirs, function, args, megabytes, seconds)
    os.close(theirs)
    try:
        content = _read(ours, megabytes << 20, time.monotonic() + seconds)
    finally:
        os.close(ours)
        os.kill(pid, signal.SIGKILL)  # it is done, or it is too late
        status = os.waitpid(pid, 0)[1]
    return _answer(content, status, megabytes, seconds)


def _read(pipe: int, most: int, deadline: float) -> bytes | None:
    """Return all bytes from a pipe; None if it does not end in time or exceeds `most` bytes."""
    content = bytearray()
    while (left := deadline - time.monotonic()) > 0.0 and len(content) <= most:
        if select.select([pipe], [], [], left)[0]:
            part = os.read(pipe, PAGE)
            if not part:
                return bytes(content)
            content += part
    return None


def _answer(content: bytes | None, status: int, megabytes: int, seconds: float) -> Any:
    if content is None:
        raise ChildFault(f"takes longer than {seconds:g} s, or gives more than {megabytes} MB")
    if not content:
        how = f"signal {os.WTERMSIG(status)}" if os.WIFSIGNALED(status) else f"exit {os.waitstatus_to_exitcode(status)}"
        raise ChildFault(f"the parser crashed ({how})")
    stream = io.BytesIO(content)
    try:
        kind, value = json.loads(stream.readline())
    except ValueError:
        raise ChildFault("the parser crashed while it answered") from None
    if kind == "answer":
        return _unpacked(value, stream)
    raised = getattr(errors, kind, None)
    raise (raised if isinstance(raised, type) and issubclass(raised, SoftmapError) else ChildFault)(value)


# --- in the child --------------------------------------------------------------------------
def _be_child(pipe: int, function: Callable[..., Any], args: tuple[Any, ...], megabytes: int, seconds: float) -> None:
    """Run the function under limits, write its answer, and end at once; never returns."""
    try:
        _limit(megabytes, seconds)
        _silence()
        _write(pipe, _result(function, args, megabytes))
    finally:
        os._exit(0)


def _limit(megabytes: int, seconds: float) -> None:
    with open("/proc/self/statm", encoding="ascii") as file:
        taken = int(file.read().split()[0]) * _PAGE_SIZE
    faulthandler.disable()  # its report would go where the caller's goes
    limits = {
        resource.RLIMIT_AS: taken + (megabytes << 20),
        resource.RLIMIT_CPU: int(seconds) + 2,
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_CORE: 0,
    }
    for which, most in limits.items():
        hard = resource.getrlimit(which)[1]
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(which, (most, most))
    for number in (signal.SIGALRM, signal.SIGTERM):  # handlers of this process are not the child's
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a write to a file fails, and a library may go on without it
    signal.setitimer(signal.ITIMER_REAL, 0)


def _silence() -> None:
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nowhere, stream)


def _result(function: Callable[..., Any], args: tuple[Any, ...], megabytes: int) -> bytes:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            arrays: list[bytes] = []
            document = _packed(function(*args), arrays)
            return b"".join([json.dumps(["answer", document]).encode() + b"\n", *arrays])
    except SoftmapError as fault:
        return json.dumps([type(fault).__name__, str(fault)]).encode() + b"\n"
    except MemoryError:
        return json.dumps(["", f"needs more than {megabytes} MB of memory"]).encode() + b"\n"
    except BaseException as fault:  # a parser may raise anything, SystemExit included
        return json.dumps(["", f"{type(fault).__name__}: {brief(fault)}"]).encode() + b"\n"


def _write(pipe: int, content: bytes) -> None:
    view = memoryview(content)
    while view:
        view = view[os.write(pipe, view) :]


def _packed(value: Any, arrays: list[bytes]) -> Any:
    """Return a value as JSON holds it; arrays go to `arrays`, and their places are marked."""
    if isinstance(value, np.ndarray):
        stream = io.BytesIO()
        np.lib.format.write_array(stream, value, allow_pickle=False)
        arrays.append(stream.getvalue())
        return {"array": len(arrays) - 1}
    if isinstance(value, dict):
        return {"dict": [[str(key), _packed(item, arrays)] for key, item in value.items()]}
    if isinstance(value, list | tuple):
        return {"list": [_packed(item, arrays) for item in value]}
    return value.item() if isinstance(value, np.generic) else value


# --- in the parent again -------------------------------------------------------------------
def _unpacked(document: Any, stream: io.BytesIO) -> Any:
    """Return the value of a document; its arrays follow one another in `stream`, in the order of the document."""
    if not isinstance(document, dict):
        return document
    if "array" in document:
        return np.lib.format.read_array(stream, allow_pickle=False)
    if "dict" in document:
        return {key: _unpacked(item, stream) for key, item in document["dict"]}
    return [_unpacked(item, stream) for item in document["list"]]
