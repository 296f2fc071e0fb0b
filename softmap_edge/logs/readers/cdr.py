"""Convert a serialised ROS 2 message to named numbers without ROS.

    definition (.msg text)  →  fields of each type        message (CDR, XCDR1)  →  {name: number}

Names are such as `pose.position.x` or `position[j1]`. Elements of sequences get their index in
brackets, or a name if the message has one: from a sibling `name` or `joint_names` of the same
length (JointState), or from the element's own `child_frame_id` or `…name` (TFMessage, rigid
bodies). Times are in s. Texts, bytes and sequences of more than 1024 elements are skipped; of texts
only the frames (`header.frame_id`) are kept, because places in two frames are not one. The bytes
are not trusted: each length is checked against the remaining bytes before use, the nesting of types
is limited, and every fault is a `CdrError`. Reference: OMG DDS-XTypes 1.3, 7.4.1 (plain CDR); the
.msg grammar of ROS 2. Pinned by tests/logs/test_import_mcap.py against mcap-ros2-support.

Why not mcap-ros2-support 0.6.0 itself: 10 000 messages and definitions with 1 to 4 mutations were
tried (joint states, transforms, empty types). This reader returned 1343 and raised CdrError for
8657. The other one raised 11 kinds of exceptions for 8284, including RecursionError and NameError,
and printed 2600 lines about definitions. It cannot read a message with text that is not UTF-8 (2757
of them). Both need less than 0.03 s and 2 MB for any of these messages.
"""

from __future__ import annotations

import dataclasses
import re
import struct
from collections import Counter
from collections.abc import Container
from dataclasses import dataclass

from softmap_edge.logs.readers.packed import ZSTD

PRIMITIVES = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
}
PRIMITIVES |= {
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
LONGEST = 1024  # elements of a sequence that become columns
MOST = 4096  # numbers of one message
_DEEPEST = 16  # types within types
_STEPS_A_BYTE = 4  # fields and structs read per byte of a message, at most
_PADDING = 8  # bytes that some writers leave after a message
_LARGEST = 2**26  # bytes of one unpacked message
_BYTES = ("byte", "char", "int8", "uint8")
_TIMES = ("builtin_interfaces/Time", "builtin_interfaces/Duration")
_FIELD = re.compile(r"^([\w/]+)(<=\d+)?(\[(?:<=)?\d*\])?\s+(\w+)")


FRAME = 200  # characters of the name of a frame


class CdrError(ValueError):
    """A message or its definition cannot be read."""


@dataclass
class Message:
    """The content of one message.

    Attributes:
        numbers: the numbers by name, in the message's order.
        frames: `frame_id` of each struct with a header, by the start of the names of its numbers:
            "" for the message, `transforms[tip].` for an element. An element whose frame is empty
            is in that of the struct around it.
        others: frames that were left out, with the number of headers that name them.
    """

    numbers: dict[str, float] = dataclasses.field(default_factory=dict)
    frames: dict[str, str] = dataclasses.field(default_factory=dict)
    others: Counter[str] = dataclasses.field(default_factory=Counter)


@dataclass(frozen=True)
class Field:
    """One field: `count` is None for a single value, -1 for a sequence, else the array's length."""

    name: str
    type: str
    count: int | None


Types = dict[str, list[Field]]


def parse_definition(name: str, text: str) -> Types:
    """Return the fields of a type and of all types that it contains.

    Args:
        name: the type, such as `sensor_msgs/msg/JointState`.
        text: its definition, followed by those of the contained types after lines of `=`.

    Raises:
        CdrError: a line is not a field, or a contained type is not defined.
    """
    types: Types = {}
    for k, part in enumerate(re.split(r"^={20,}\s*$", text, flags=re.MULTILINE)):
        lines = part.strip().splitlines()
        key = _short(name)
        if k:
            if not lines or not lines[0].startswith("MSG:"):
                raise CdrError("a definition does not begin with MSG:")
            key, lines = _short(lines[0][4:].strip()), lines[1:]
        types[key] = [field for line in lines if (field := _field(line, key)) is not None]
    known = {*PRIMITIVES, *_TIMES, "string", "wstring"}
    for fields in types.values():
        for field in fields:
            if field.type not in known and field.type not in types:
                raise CdrError(f"the type {field.type[:60]} is not defined")
    return types


def _short(name: str) -> str:
    return name.replace("/msg/", "/")


def _field(line: str, owner: str) -> Field | None:
    line = line.split("#")[0].strip()
    if not line or re.match(r"^[\w/]+(<=\d+)?\s+\w+\s*=", line):  # a constant
        return None
    found = _FIELD.match(line)
    if found is None:
        raise CdrError(f"'{line[:60]}' is not a field of a message")
    kind, array, name = found[1], found[3], found[4]
    if kind not in PRIMITIVES and kind not in ("string", "wstring"):
        kind = _short(kind if "/" in kind else f"{owner.split('/')[0]}/{kind}")
        kind = {"time": _TIMES[0], "duration": _TIMES[1]}.get(kind.split("/")[-1], kind)
    if array is None:
        return Field(name, kind, None)
    count = array[1:-1]
    if len(count) > 18 and count.isdecimal():
        raise CdrError(f"an array of {count[:20]} elements is longer than any message")
    return Field(name, kind, int(count) if count.isdecimal() else -1)


# --- messages ------------------------------------------------------------------------------
def read_message(
    name: str, types: Types, data: bytes, complete: bool = False, frame: str | None = None
) -> Message:
    """Return the numbers of a message by name, and the frames of its places.

    Args:
        name: the type, such as `sensor_msgs/msg/JointState`.
        types: its fields, from `parse_definition`.
        data: the message as CDR, compressed with zstd if rosbag2 compressed each message.
        complete: whether the message must be used up to its last byte, except padding.
        frame: the only frame whose numbers are returned; None for all.

    Raises:
        CdrError: the bytes do not match the definition.
    """
    reader = _Reader(_plain(data), frame)
    message = Message()
    try:
        _struct(_short(name), types, reader, "", message, 0)
    except struct.error:
        raise CdrError("a message ends early") from None
    if complete and len(reader.data) - reader.at >= _PADDING:
        raise CdrError(f"{len(reader.data) - reader.at} bytes of a message are left over")
    _inherit(message.frames)
    return message if frame is None else _only(message, frame)


def frame_path(column: str, frames: Container[str]) -> str | None:
    """Return the start of a column's name under which its frame is stated; None if it has none."""
    ends = [k + 1 for k, mark in enumerate(column) if mark == "."]
    return next((column[:end] for end in (*reversed(ends), 0) if column[:end] in frames), None)


def _inherit(frames: dict[str, str]) -> None:
    """Set empty frames to that of the struct around them."""
    for path in sorted((path for path in frames if path and not frames[path]), key=len):
        around = frame_path(path[:-1], frames)
        frames[path] = "" if around is None else frames[around]


def _only(message: Message, frame: str) -> Message:
    """Return the numbers of one frame; the frames of the others are counted."""
    others = message.others + Counter(name for name in message.frames.values() if name != frame)
    numbers = {
        name: value
        for name, value in message.numbers.items()
        if (path := frame_path(name, message.frames)) is not None and message.frames[path] == frame
    }
    frames = {path: name for path, name in message.frames.items() if name == frame}
    return Message(numbers, frames, others)


def _plain(data: bytes) -> bytes:
    """Return a message as CDR, unpacked if rosbag2 compressed each message."""
    if not data.startswith(ZSTD):
        return data
    try:
        import zstandard
    except ImportError:
        raise CdrError(
            "messages packed by zstd need zstandard; run pip install 'softmap-edge[logs]'"
        ) from None
    try:
        with zstandard.ZstdDecompressor(max_window_size=_LARGEST).stream_reader(data) as stream:
            plain = bytes(stream.read(_LARGEST + 1))
    except zstandard.ZstdError:
        raise CdrError("a message packed by zstd is damaged") from None
    if len(plain) > _LARGEST:
        raise CdrError(f"a message packed by zstd holds more than {_LARGEST} bytes")
    return plain


class _Reader:
    """The bytes of one message and the read position."""

    def __init__(self, data: bytes, frame: str | None = None) -> None:
        if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
            raise CdrError(
                f"a message begins with {data[:2].hex()}, expected plain CDR (0000 or 0001)"
            )
        self.data, self.at, self.order = data, 4, "<" if data[1] else ">"
        self.frame = frame  # the only one that is asked for
        self.steps = _STEPS_A_BYTE * len(data) + MOST

    def step(self) -> None:
        """Count a field or a struct, because arrays of structs without bytes could be endless."""
        self.steps -= 1
        if self.steps < 0:
            raise CdrError("a message states far more values than it has bytes")

    def one(self, code: str) -> float:
        size = struct.calcsize(code)
        self.at += -(self.at - 4) % size
        (value,) = struct.unpack_from(self.order + code, self.data, self.at)
        self.at += size
        return float(value) if code in "fd" else value

    def many(self, code: str, count: int) -> tuple[float, ...]:
        if count == 0:
            return ()
        size = struct.calcsize(code)
        self.at += -(self.at - 4) % size
        self.left(count, size)
        values = struct.unpack_from(f"{self.order}{count}{code}", self.data, self.at)
        self.at += count * size
        return values

    def length(self, size: int) -> int:
        count = int(self.one("I"))
        self.left(count, size)
        return count

    def left(self, count: int, size: int) -> None:
        if count * size > len(self.data) - self.at:
            raise CdrError(f"a sequence of {count} elements is longer than its message")

    def text(self) -> str:
        count = self.length(1)
        raw = self.data[self.at : self.at + count]
        self.at += count
        return raw.rstrip(b"\0").decode("utf-8", "replace")


def _struct(
    name: str, types: Types, reader: _Reader, path: str, out: Message, depth: int
) -> dict[str, str]:
    """Read one struct into `out`; return its texts."""
    reader.step()
    if depth > _DEEPEST:
        raise CdrError("types are nested without end")
    if name in _TIMES and name not in types:
        out.numbers[path.rstrip(".")] = reader.one("i") + 1e-9 * reader.one("I")
        return {}
    texts: dict[str, str] = {}
    keys: list[str] = []  # names of the elements of sequences in this struct
    if not types[name]:  # an empty type takes one byte
        reader.one("B")
    for field in types[name]:
        reader.step()
        here = f"{path}{field.name}"
        if field.count is None:
            if field.type == "string":
                texts[field.name] = reader.text()
            elif field.type in PRIMITIVES:
                _put(out, here, reader.one(PRIMITIVES[field.type]))
            elif field.type in _TIMES:
                _put(out, here, reader.one("i") + 1e-9 * reader.one("I"))
            else:
                inner = _nested(field, types, reader, f"{here}.", out, depth)
                texts |= {f"{field.name}.{name}": text for name, text in inner.items()}
            continue
        count = reader.length(1) if field.count < 0 else field.count
        if field.type in PRIMITIVES:
            values = reader.many(PRIMITIVES[field.type], count)
            if field.type not in _BYTES and count <= LONGEST:
                named = keys if len(keys) == count else [str(k) for k in range(count)]
                for key, value in zip(named, values):
                    _put(out, f"{here}[{key}]", float(value))
        elif field.type == "string":
            reader.left(count, 4)
            found = [reader.text() for _ in range(count)]
            keys = (
                found
                if field.name in ("name", "names", "joint_names") and len(set(found)) == count
                else keys
            )
        else:
            reader.left(count, 1)
            for k in range(count):
                _element(k, field, types, reader, here, out, depth)
    if (frame := texts.get("header.frame_id")) is not None:
        out.frames[path] = frame.removeprefix("/")[:FRAME]
    return texts


def _nested(
    field: Field, types: Types, reader: _Reader, here: str, out: Message, depth: int
) -> dict[str, str]:
    if field.type == "wstring":
        raise CdrError("texts of type wstring are not read")
    return _struct(field.type, types, reader, here, out, depth + 1)


def _element(
    k: int,
    field: Field,
    types: Types,
    reader: _Reader,
    here: str,
    out: Message,
    depth: int,
) -> None:
    """Read one struct of a sequence, named by its own name field if it has one."""
    own = Message()
    texts = _nested(field, types, reader, "", own, depth)
    key = next(
        (
            v
            for n, v in texts.items()
            if v and (n == "child_frame_id" or re.fullmatch(r"(\w+_)?name", n))
        ),
        str(k),
    )
    frame = own.frames.get("", "")
    # left out here: another element of this name may be in the frame asked for
    if frame and reader.frame is not None and frame != reader.frame:
        if frame in out.others or len(out.others) < LONGEST:
            out.others[frame] += 1
    elif k < LONGEST:
        for name, value in own.numbers.items():
            _put(out, f"{here}[{key}].{name}", value)
        out.frames |= {f"{here}[{key}].{path}": name for path, name in own.frames.items()}
    out.others += own.others


def _put(out: Message, name: str, value: float) -> None:
    if len(out.numbers) >= MOST:
        raise CdrError(f"a message holds more than {MOST} numbers")
    out.numbers[name] = float(value)
