"""What a camera saw while a command file is played, kept in a file as it comes: a cut loses its last second at most.

A JSON document a line (softmap.seen/1): how the file's clock went, when each frame came, the frames that were taken.
It is only added to, by a thread of its own, and on the disk every half a second. With what the loop recorded meanwhile
it becomes the run (`softmap record --recover`). Pinned by tests/test_record_cut.py.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import queue
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from softmap_edge.camera.frames import Frame, HostClock
from softmap_edge.errors import RunError
from softmap_edge.experiment.play import Played

SCHEMA = "softmap.seen/1"
SAFE = 0.5  # s after which what came is on the disk
LONGEST = 1 << 24  # characters of a line
NONE = np.zeros((0, 3))  # the points of a frame that only its time is kept of


class Keeper:
    """Writes what is seen to a new file, from entering to leaving; `fault` says why it ended early, if it did.

    Raises:
        FileExistsError: the file is there already.
    """

    def __init__(self, file: Path, late: float) -> None:
        self.fault: str | None = None
        self._lines: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._lines.put({"schema": SCHEMA, "late": late})
        self._clock = self._taken = 0
        self._stream = open(file, "x", encoding="utf-8")  # noqa: SIM115 - closed by its thread
        self._thread = threading.Thread(target=self._write, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lines.put(None)
        self._thread.join()

    def add(self, played: Played, came: Sequence[Frame]) -> None:
        """Keep what is new of `played`, and the frames that came; never waits for the disk."""
        taken = [[look, frame.stamp, frame.arrived, _text(frame.points)] for look, frame in played.taken[self._taken :]]
        line = {"clock": played.clock[self._clock :], "came": [[one.stamp, one.arrived] for one in came]}
        self._clock, self._taken = len(played.clock), len(played.taken)
        self._lines.put(line | {"taken": taken})

    def _write(self) -> None:
        saved = time.monotonic()
        with contextlib.suppress(OSError), self._stream as stream:
            try:
                while (line := self._lines.get()) is not None:
                    if self.fault is None:
                        stream.write(json.dumps(line) + "\n")
                        if time.monotonic() - saved > SAFE:
                            stream.flush()
                            os.fsync(stream.fileno())
                            saved = time.monotonic()
                stream.flush()
                os.fsync(stream.fileno())
            except OSError as fault:
                self.fault = fault.strerror or str(fault)


def read_kept(file: Path) -> Played:
    """Return what was kept, to the last whole line.

    Raises:
        RunError: it is no such file, or damaged.
    """
    try:
        with open(file, encoding="utf-8") as lines:
            head = json.loads(lines.readline(LONGEST))
            if head["schema"] != SCHEMA:
                raise ValueError(f"schema {head['schema']!s:.20}")
            played = Played(camera=HostClock(float(head["late"])))
            while (line := lines.readline(LONGEST)).endswith("\n"):
                one = json.loads(line)
                played.camera.add([Frame(float(stamp), float(arrived), NONE) for stamp, arrived in one["came"]])
                played.clock += [(float(host), float(at)) for host, at in one["clock"]]
                played.taken += [
                    (int(look), Frame(float(a), float(b), _points(text))) for look, a, b, text in one["taken"]
                ]
    except OSError as fault:
        raise RunError(f"{file}: {(fault.strerror or '').lower()}; give what `softmap record` kept") from None
    except (ValueError, KeyError, TypeError, IndexError, OverflowError, RecursionError) as fault:
        raise RunError(f"{file}: damaged, or not what `softmap record` kept ({fault!s:.60})") from None
    return played


def _text(points: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(points, "<f8").tobytes()).decode("ascii")


def _points(text: str) -> Any:
    return np.frombuffer(base64.b64decode(text, validate=True), "<f8").reshape(-1, 3)
