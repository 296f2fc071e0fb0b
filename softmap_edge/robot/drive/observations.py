"""Camera frames of a robot while it is driven, saved as they arrive.

If the program is interrupted, at most the last second is lost. The file has one JSON document per
line (softmap.seen/3): the robot, the clock of the command file, the arrival of each frame, the
selected frames, and the CRC-32 of the line; the last line marks the end. Files of softmap.seen/2
lack the last line; those of softmap.seen/1 also lack the CRC. A thread appends lines and flushes
them to disk every half second. Together with the recording of the loop, the file makes a run
(`recorded.py`). Pinned by tests/robot/test_record_cut.py and tests/robot/test_recorded.py.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import queue
import re
import threading
import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self, SupportsFloat

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RecordingBroken, RunError
from softmap_edge.files.atomic import Document, finite
from softmap_edge.files.refusals import refusal
from softmap_edge.model.model import Model
from softmap_edge.robot.link.frames import Frame, HostClock, Seen

SEEN = ".seen"  # suffix of such a file, next to the recording of the loop
SCHEMA, ENDLESS, UNCHECKED = "softmap.seen/3", "softmap.seen/2", "softmap.seen/1"
SAFE = 0.5  # s after which data are on the disk
LONGEST = 1 << 24  # characters of a line
POINTS = LONGEST // 40  # points of all frames in a line: 32 characters each in base64
NONE = np.zeros((0, 3))  # stands for the points of a frame of which only the time is stored
LOOK = 0.2  # s between two checks for new data
LATELY = 200  # newest frames that each check examines
LATEST = 2.0  # s from exposure to arrival of a frame, at most
NAME = 200  # characters of a robot's name

_CRC = re.compile(rb', "crc": "([0-9a-f]{8})"}\n$')

Pair = tuple[float, float]


@dataclass
class Kept:
    """The stored frames of a robot.

    Attributes:
        camera: clock of the camera
        taken: selected frames, each with the capture of the command file that it belongs to (else
            their number)
        clock: pairs of (host s, s of the command file); empty without one
        robot: name of the robot; None if it is not in the file
        vertices: number of points in a frame of the full body; None if not in the file, or for
            markers
        lacks: a sentence on the part that cannot be read
    """

    clock: list[Pair] = field(default_factory=list)
    taken: list[tuple[int, Frame]] = field(default_factory=list)
    camera: HostClock = field(default_factory=HostClock)
    robot: str | None = None
    vertices: int | None = None
    lacks: str | None = None


def vertices_of(model: Model) -> int | None:
    """Return the number of points in a frame of the full body; None for a model of markers."""
    return None if model.markers else len(model.rest)


def seen_file(recording: str | Path) -> Path:
    """Return the file next to a recording that holds the frames."""
    return Path(recording).with_suffix(SEEN)


class Keeper:
    """Write the frames of the robot of `model` to a new file, from entering to leaving.

    `fault` is why it ended early, if it did. `late` s is the delay of the fastest frame.

    Raises:
        RunError: the file exists, cannot be written, or could not be read back.
    """

    def __init__(self, file: Path, late: float, model: Model) -> None:
        self.fault: str | None = None
        self._lines: queue.SimpleQueue[Document | None] = queue.SimpleQueue()
        head = {
            "schema": SCHEMA,
            "late": late,
            "robot": model.robot,
            "vertices": vertices_of(model),
        }
        self._lines.put(head)
        try:
            _head(head)
        except ValueError as fault:
            raise RunError(
                f"{file}: {fault!s:.60}, which nothing could read again; give another"
            ) from None
        try:
            self._stream = open(file, "x", encoding="utf-8")  # noqa: SIM115 - closed by its thread
        except FileExistsError:
            raise RunError(f"{file} exists; give another name to record to") from None
        except OSError as fault:
            raise RunError(refusal(fault, file)) from None
        self._thread = threading.Thread(target=self._write, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._lines.put(None)
        self._thread.join()

    def add(
        self, clock: Sequence[Pair], taken: Sequence[tuple[int, Frame]], came: Sequence[Frame]
    ) -> None:
        """Store new data (`Kept`) and the arrival of its frames; never wait for the disk."""
        if self.fault is not None:
            return
        try:
            self._lines.put(_document(clock, taken, came))
        except (ValueError, TypeError) as fault:
            self.fault = f"{fault!s:.100}"

    def _write(self) -> None:
        saved = time.monotonic()
        with contextlib.suppress(OSError), self._stream as stream:
            try:
                ended = False
                while not ended:
                    line = self._lines.get()
                    ended = line is None
                    if line is None:
                        # later data were not stored, so there is no end mark
                        if self.fault is not None:
                            break
                        line = {**_document([], [], []), "end": True}
                    stream.write(with_crc(json.dumps(line, allow_nan=False)))
                    if time.monotonic() - saved > SAFE:
                        stream.flush()
                        os.fsync(stream.fileno())
                        saved = time.monotonic()
                stream.flush()
                os.fsync(stream.fileno())
            except OSError as fault:
                self.fault = (fault.strerror or str(fault)).lower()
            except Exception as fault:  # any fault ends the storing
                self.fault = f"{type(fault).__name__}: {fault!s:.80}"


@contextlib.contextmanager
def keeping(recording: str | Path, seen: Seen, model: Model, late: float = 0.0) -> Iterator[Keeper]:
    """Store every frame seen during a recording in a file next to it.

    Together they are a run of the robot of `model`.

    Args:
        seen: returns the frames that have arrived, oldest first
        late: s from exposure to arrival of the fastest frame

    Raises:
        RunError: the file exists, or cannot be written.
        RecordingBroken: on leaving, if storing ended early, for example on a full disk.
    """
    camera, end = HostClock(late), threading.Event()
    number = 0

    def look() -> None:
        nonlocal number
        for frame in camera.add(seen()[-LATELY:]):
            keeper.add([], [(number, frame)], [frame])
            number += 1

    def watch() -> None:
        try:
            while not end.wait(LOOK):
                look()
            look()
        # whatever `seen` raises, the robot goes on and the fault is reported
        except Exception as fault:
            keeper.fault = f"{type(fault).__name__}: {fault!s:.80}"

    with Keeper(seen_file(recording), late, model) as keeper:
        watching = threading.Thread(target=watch, daemon=True)
        watching.start()
        try:
            yield keeper
        finally:
            end.set()
            watching.join()
    if keeper.fault is not None:
        raise RecordingBroken(
            f"{keeper.fault}: {seen_file(recording)}; what was seen until then is kept"
        )


def read_kept(file: Path) -> Kept:
    """Return the stored frames: every line with a correct checksum, up to the last complete one.

    Raises:
        RunError: it is not such a file, or it is damaged and no checksum shows where.
    """
    try:
        if file.exists() and not file.is_file():
            raise ValueError("no file of bytes")
        with open(file, "rb") as lines:
            text, checked = _checked(lines.readline(LONGEST))
            head = json.loads(text)
            kept = _head(head)
            if not checked and head["schema"] != UNCHECKED:
                raise ValueError("its first line fails its checksum")
            _read_lines(lines, kept, checked, file, ends=head["schema"] == SCHEMA)
    except OSError as fault:
        raise RunError(
            f"{file}: {(fault.strerror or '').lower()}; give the `.seen` file of a recording"
        ) from None
    except (ValueError, KeyError, TypeError, IndexError, OverflowError, RecursionError) as fault:
        message = "".join(c if c.isprintable() else "?" for c in f"{fault!s:.60}")
        raise RunError(
            f"{file}: damaged, or no `.seen` file of a recording ({message}); without it the "
            "recording counts as one without camera frames"
        ) from None
    return kept


def _read_lines(lines: BinaryIO, kept: Kept, checked: bool, file: Path, ends: bool) -> None:
    """Add the content of the lines after the first to `kept`, and what cannot be read of them."""
    wrong = []
    count = 1
    line = b"\n"
    ended = not ends
    while (line := lines.readline(LONGEST)).endswith(b"\n"):
        count += 1
        text, sound = _checked(line)
        if checked and not sound:
            wrong.append(count)
            continue
        document = json.loads(text)
        _add(kept, document)
        ended = ended or document.get("end") is True
    if len(line) >= LONGEST:
        raise ValueError(f"a line of more than {LONGEST} characters")
    parts = (
        [f"{file} was cut short: its last line is torn, and what was seen after it is missing"]
        if line
        else []
    )
    if not line and not ended:
        parts.append(
            f"{file} was cut short: it has no line that ends it, and what was seen later is missing"
        )
    if wrong:
        parts.append(
            f"{file} is damaged: {len(wrong)} of {count} lines fail their checksum, the first is "
            f"line {wrong[0]}; the frames in them are left out"
        )
    if not checked:
        parts.append(f"{file} carries no checksum: numbers that were damaged would not be noticed")
    kept.lacks = "; ".join(parts) or None


def _document(
    clock: Sequence[Pair], taken: Sequence[tuple[int, Frame]], came: Sequence[Frame]
) -> Document:
    """Return the content of a line as numbers that are read back exactly.

    Raises:
        ValueError: a time is not finite, points are not (N, 3), or they are too many for a line.
    """
    size = sum(len(frame.points) for _, frame in taken)
    if size > POINTS:
        raise ValueError(f"frames of {size} points at once, at most {POINTS} are kept")
    return {
        "clock": [[_plain(host), _plain(at)] for host, at in clock],
        "came": [[_plain(one.stamp), _plain(one.arrived)] for one in came],
        "taken": [
            [int(look), _plain(one.stamp), _plain(one.arrived), _text(one.points)]
            for look, one in taken
        ],
    }


def _plain(number: SupportsFloat) -> float:
    return _number(float(number))


def _add(kept: Kept, one: Document) -> None:
    kept.camera.add([_frame(stamp, arrived, NONE) for stamp, arrived in _list(one["came"])])
    kept.clock += [(_number(host), _number(at)) for host, at in _list(one["clock"])]
    kept.taken += [
        (int(_number(look)), _frame(stamp, arrived, _points(text)))
        for look, stamp, arrived, text in _list(one["taken"])
    ]


def with_crc(document: str) -> str:
    """Return a line: a JSON document with its own CRC-32 as the last entry."""
    return f'{document[:-1]}, "crc": "{zlib.crc32(document.encode()):08x}"}}\n'


def _checked(line: bytes) -> tuple[bytes, bool]:
    """Return the document of a line without its checksum, and whether that is correct."""
    found = _CRC.search(line)
    if found is None:
        return line, False
    document = line[: found.start()] + b"}"
    return document, zlib.crc32(document) == int(found[1], 16)


def _head(head: Document) -> Kept:
    """Return the content of the first line, before any frame is stored."""
    late, robot, vertices = _number(head["late"]), head.get("robot"), head.get("vertices")
    if head["schema"] not in (SCHEMA, ENDLESS, UNCHECKED):
        raise ValueError(f"schema {head['schema']!s:.20}")
    if not 0.0 <= late <= LATEST:
        raise ValueError(f"frames {late:g} s late, 0 to {LATEST:g} s is allowed")
    if robot is not None and not (
        isinstance(robot, str) and len(robot) <= NAME and robot.isprintable()
    ):
        raise ValueError("the name of the robot")
    if vertices is not None and not (type(vertices) is int and vertices >= 1):
        raise ValueError("the number of vertices")
    return Kept(camera=HostClock(late), robot=robot, vertices=vertices)


def _list(found: object) -> list[Any]:
    if not isinstance(found, list):
        raise TypeError(f"a list is {type(found).__name__}")
    return found


def _number(found: object) -> float:
    if not finite(found):
        raise ValueError(f"'{found!s:.20}' is not a finite number")
    return float(found)


def _frame(stamp: object, arrived: object, points: NDArray[np.float64]) -> Frame:
    return Frame(_number(stamp), _number(arrived), points)


def _text(points: object) -> str:
    array = np.ascontiguousarray(points, "<f8")
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"points of shape {array.shape}, expected (N, 3)")
    return base64.b64encode(array.tobytes()).decode("ascii")


def _points(text: str) -> NDArray[np.float64]:
    return np.frombuffer(base64.b64decode(text, validate=True), "<f8").reshape(-1, 3)
