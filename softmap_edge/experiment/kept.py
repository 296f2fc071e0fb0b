"""What a camera saw while a robot is driven, kept in a file as it comes: a cut loses its last second at most.

A JSON document a line (softmap.seen/1): whose robot it is, how a command file's clock went, when each frame came, the
frames that were taken. It is only added to, by a thread of its own, and on the disk every half a second. With what the
loop recorded meanwhile it becomes a run (`recorded.py`). Pinned by tests/test_record_cut.py and tests/test_recorded.py.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import queue
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from softmap_edge.camera.frames import Frame, HostClock, Seen
from softmap_edge.errors import RunError
from softmap_edge.model import Model

SEEN = ".seen"  # ends the name of such a file, beside what the loop recorded
SCHEMA = "softmap.seen/1"
SAFE = 0.5  # s after which what came is on the disk
LONGEST = 1 << 24  # characters of a line
NONE = np.zeros((0, 3))  # the points of a frame that only its time is kept of
LOOK = 0.2  # s between two looks at what came
LATELY = 200  # frames, the newest, that are looked through


@dataclass
class Played:
    """What happened: `clock` pairs of (host s, s of the pace), the frames that were taken, how the playing ended; of
    what was kept also whose `robot` it is and how many `vertices` it has, None where it is seen by markers."""

    clock: list[tuple[float, float]] = field(default_factory=list)
    taken: list[tuple[int, Frame]] = field(default_factory=list)  # the look, its frame
    camera: HostClock = field(default_factory=HostClock)
    waited: float = 0.0  # s in which it waited for the robot to settle
    unsettled: int = 0  # rests that went on before all was still
    whole: bool = False
    robot: str | None = None
    vertices: int | None = None


def vertices_of(model: Model) -> int | None:
    """Return how many points a frame of the whole body has; None where a model is of markers."""
    return None if model.markers else len(model.rest)


def seen_file(recording: str | Path) -> Path:
    """Return the file beside a recording that holds what was seen meanwhile."""
    return Path(recording).with_suffix(SEEN)


class Keeper:
    """Writes what is seen of the robot of `model` to a new file, from entering to leaving; `fault` says why it ended
    early, if it did. `late` s is what the quickest frame takes.

    Raises:
        FileExistsError: the file is there already.
    """

    def __init__(self, file: Path, late: float, model: Model) -> None:
        self.fault: str | None = None
        self._lines: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._lines.put({"schema": SCHEMA, "late": late, "robot": model.robot, "vertices": vertices_of(model)})
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


@contextlib.contextmanager
def keeping(recording: str | Path, seen: Seen, model: Model, late: float = 0.0) -> Iterator[Keeper]:
    """Keep every frame that is seen meanwhile beside a recording: with that it is a run of the robot of `model`.

    Args:
        seen: gives the frames that have arrived, oldest first. late: s that the quickest frame takes.

    Raises:
        FileExistsError: something is kept there already.
    """
    played, end = Played(camera=HostClock(late)), threading.Event()

    def look() -> None:
        came = played.camera.add(seen()[-LATELY:])
        played.taken += enumerate(came, len(played.taken))
        keeper.add(played, came)

    def watch() -> None:
        while not end.wait(LOOK):
            look()
        look()

    with Keeper(seen_file(recording), late, model) as keeper:
        watching = threading.Thread(target=watch, daemon=True)
        watching.start()
        try:
            yield keeper
        finally:
            end.set()
            watching.join()


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
            robot, vertices = head.get("robot"), head.get("vertices")
            if not isinstance(robot, str | None) or not isinstance(vertices, int | None):
                raise ValueError("whose robot it is")
            played = Played(camera=HostClock(float(head["late"])), robot=robot, vertices=vertices)
            while (line := lines.readline(LONGEST)).endswith("\n"):
                one = json.loads(line)
                played.camera.add([Frame(float(stamp), float(arrived), NONE) for stamp, arrived in one["came"]])
                played.clock += [(float(host), float(at)) for host, at in one["clock"]]
                played.taken += [
                    (int(look), Frame(float(a), float(b), _points(text))) for look, a, b, text in one["taken"]
                ]
    except OSError as fault:
        raise RunError(f"{file}: {(fault.strerror or '').lower()}; give what was kept beside a recording") from None
    except (ValueError, KeyError, TypeError, IndexError, OverflowError, RecursionError) as fault:
        raise RunError(f"{file}: damaged, or not what is kept beside a recording ({fault!s:.60})") from None
    return played


def _text(points: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(points, "<f8").tobytes()).decode("ascii")


def _points(text: str) -> Any:
    return np.frombuffer(base64.b64decode(text, validate=True), "<f8").reshape(-1, 3)
