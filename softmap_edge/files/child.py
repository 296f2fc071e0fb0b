"""Run a third-party parser on an untrusted file in a child process with limited memory and time.

    arrays = in_child(parse, path, megabytes=1000, seconds=60)

The child is forked, so it starts in milliseconds and imports nothing. It cannot write files, its
output is discarded, and its answer returns as JSON and raw numbers: no pickle is read. If it
crashes, hangs or exceeds its memory, only the child ends. Pinned by tests/files/test_in_child.py.
"""

from __future__ import annotations

import contextlib
import faulthandler
import json
import os
import resource
import select
import signal
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any, TypeVarTuple

import numpy as np
from numpy.typing import NDArray

from softmap_edge import errors
from softmap_edge.errors import SoftmapError, brief

Given = TypeVarTuple("Given")
PAGE = 1 << 16  # bytes read at a time from the child
PATIENCE = 4.0  # real time per second of processor time: the computer may be busy
_ALIGNED = 64  # bytes: each array starts at a multiple
_PAGE_SIZE = os.sysconf("SC_PAGE_SIZE")


class ChildFault(SoftmapError):
    """The child raised another library's exception, crashed or reached a limit; see the message."""


class ChildMemory(ChildFault):
    """The child needs more memory than allowed."""


class ChildLate(ChildFault):
    """The child takes longer than allowed."""


def in_child(
    function: Callable[[*Given], object],
    *args: *Given,
    megabytes: int = 1000,
    seconds: float = 60.0,
) -> Any:
    """Return the result of `function(*args)` from a forked child.

    Args:
        function: returns arrays of numbers or text, numbers, strings, None, and lists or dicts
            (with text keys) of them.
        args: its arguments.
        megabytes: memory that the child may take in addition to this process, and size limit of the
            answer.
        seconds: processor time that it may take; the limit in real time is `PATIENCE` times that.

    Returns:
        Any: what the function returned.

    Raises:
        SoftmapError: the function raised an error of this package, which is raised again with its
            class and message.
        ChildMemory: the child needs more memory.
        ChildLate: the child takes longer, or its answer is too large.
        ChildFault: the child raised any other exception, or crashed.
    """
    ours, theirs = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about forking with threads: the child uses none of them
        pid = os.fork()
    if pid == 0:
        os.close(ours)
        _be_child(theirs, function, args, megabytes, seconds)
    os.close(theirs)
    try:
        content = _read(ours, megabytes << 20, time.monotonic() + PATIENCE * seconds)
    finally:
        os.close(ours)
        os.kill(pid, signal.SIGKILL)  # finished, or too late
        status = os.waitpid(pid, 0)[1]
    return _answer(content, status, megabytes, seconds)


def _read(pipe: int, most: int, deadline: float) -> bytearray | None:
    """Return all bytes from a pipe, or None if it does not end in time or exceeds `most`."""
    content = bytearray()
    poll = select.poll()  # `select` is limited to descriptors below 1024
    poll.register(pipe, select.POLLIN)
    while (left := deadline - time.monotonic()) > 0.0 and len(content) <= most:
        if poll.poll(1e3 * left):
            part = os.read(pipe, PAGE)
            if not part:
                return content
            content += part
    return None


def _answer(content: bytearray | None, status: int, megabytes: int, seconds: float) -> object:
    if content is None or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
        raise ChildLate(f"takes longer than {seconds:g} s, or gives more than {megabytes} MB")
    if not content:
        how = (
            f"signal {os.WTERMSIG(status)}"
            if os.WIFSIGNALED(status)
            else f"exit {os.waitstatus_to_exitcode(status)}"
        )
        raise ChildFault(f"the parser crashed ({how})")
    end = content.find(b"\n") + 1
    try:
        kind, value = json.loads(content[:end])
        if kind == "answer":
            return _Reader(memoryview(content)[end:]).value(value)
    except (ValueError, TypeError, KeyError):
        raise ChildFault("the parser crashed while it answered") from None
    if kind == "memory":
        raise ChildMemory(value)
    raised = getattr(errors, kind, None)
    raise (raised if isinstance(raised, type) and issubclass(raised, SoftmapError) else ChildFault)(
        value
    )


# --- in the child --------------------------------------------------------------------------
def _be_child(
    pipe: int,
    function: Callable[..., object],
    args: tuple[object, ...],
    megabytes: int,
    seconds: float,
) -> None:
    """Run the function under limits, write its answer, and end at once; never returns."""
    try:
        # do not import a module next to the file
        sys.path[:] = [folder for folder in sys.path if folder]
        faulthandler.disable()  # its report would go to the caller's output
        _limit(megabytes, seconds)
        _isolate(pipe)
        for part in _result(function, args, megabytes):
            _write(pipe, part)
    finally:
        os._exit(0)


def _limit(megabytes: int, seconds: float) -> None:
    with open("/proc/self/statm", encoding="ascii") as file:
        taken = int(file.read().split()[0]) * _PAGE_SIZE
    limits = {
        resource.RLIMIT_AS: taken + (megabytes << 20),
        resource.RLIMIT_CPU: int(seconds) + 1,
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_CORE: 0,
    }
    for which, most in limits.items():
        hard = resource.getrlimit(which)[1]
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        # the hard limit on time would be SIGKILL, which gives no reason
        resource.setrlimit(which, (most, hard if which == resource.RLIMIT_CPU else most))
    # signal handlers of the parent do not apply to the child
    for number in (signal.SIGALRM, signal.SIGTERM, signal.SIGXCPU):
        signal.signal(number, signal.SIG_DFL)
    # writing to a file fails; a library may continue without it
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    signal.setitimer(signal.ITIMER_REAL, 0)


def _isolate(pipe: int) -> None:
    """Close everything that is open (ports, sockets, files) except the pipe; discard output."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in map(int, os.listdir("/proc/self/fd")):
        if descriptor not in (pipe, nowhere):
            with contextlib.suppress(OSError):  # the descriptor of the listing is closed already
                os.close(descriptor)
    for stream in {0, 1, 2} - {pipe}:
        os.dup2(nowhere, stream)
    sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115


def _result(
    function: Callable[..., object], args: tuple[object, ...], megabytes: int
) -> list[memoryview]:
    """Return the answer in parts: a line of JSON, and arrays with the types and shapes it lists."""
    arrays: list[memoryview] = []
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return [_line(["answer", _packed(function(*args), arrays)]), *arrays]
    except SoftmapError as fault:
        return [_line([type(fault).__name__, str(fault)])]
    except MemoryError:
        return [_line(["memory", f"needs more than {megabytes} MB of memory"])]
    except BaseException as fault:  # a parser may raise anything, including SystemExit
        text = f"{type(fault).__name__}: {brief(fault)}"
        short = "memory" in text.lower() or "allocate" in text.lower()  # as C libraries report it
        return [
            _line(["memory", f"needs more than {megabytes} MB of memory"] if short else ["", text])
        ]


def _line(document: object) -> memoryview:
    text = json.dumps(document).encode()
    return memoryview(text + b" " * (-(len(text) + 1) % _ALIGNED) + b"\n")


def _write(pipe: int, part: memoryview) -> None:
    while part:
        part = part[os.write(pipe, part[: 1 << 20]) :]


def _packed(value: object, arrays: list[memoryview]) -> object:
    """Return a value as JSON holds it; the bytes of arrays go to `arrays`, padded to `_ALIGNED`."""
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject or value.dtype.names:
            raise ValueError(f"an array of {value.dtype}")
        flat = np.ascontiguousarray(value).reshape(-1)
        if flat.nbytes:
            arrays += [flat.view(np.uint8).data, memoryview(bytes(-flat.nbytes % _ALIGNED))]
        return {"array": [value.dtype.str, list(value.shape)]}
    if isinstance(value, dict):
        return {"dict": [[str(key), _packed(item, arrays)] for key, item in value.items()]}
    if isinstance(value, list | tuple):
        return {"list": [_packed(item, arrays) for item in value]}
    return value.item() if isinstance(value, np.generic) else value


# --- in the parent again -------------------------------------------------------------------
class _Reader:
    """Read the value of a document; its arrays lie in `content` in the order of the document."""

    def __init__(self, content: memoryview) -> None:
        self.content, self.at = content, 0

    def value(self, document: object) -> object:
        """Return the value of a part of the document; ValueError if it does not fit the content."""
        if not isinstance(document, dict):
            return document
        if "array" in document:
            return self._array(*document["array"])
        if "dict" in document:
            return {key: self.value(item) for key, item in document["dict"]}
        return [self.value(item) for item in document["list"]]

    def _array(self, kind: str, shape: list[int]) -> NDArray[np.generic]:
        dtype, count = np.dtype(kind), int(np.prod(shape, dtype=object))
        if dtype.hasobject:
            raise ValueError(f"an array of {dtype}")
        found = (
            np.frombuffer(self.content, dtype, count, self.at)
            if count * dtype.itemsize
            else np.zeros(count, dtype)
        )
        self.at += -(-count * dtype.itemsize // _ALIGNED) * _ALIGNED
        return found.reshape(shape)
