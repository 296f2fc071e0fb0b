"""The messages between the page and the lab: requests as JSON, answers as JSON or binary.

    request   {"id": 7, "do": "shape", "run": 0, "frame": 12}
    answer    {"re": 7, …} or {"re": 7, "error": "one sentence"}
    binary    length of a JSON header (uint32), the header padded with spaces to 4 bytes, then the
              arrays that it lists as {"arrays": [[name, shape], …]}, float32, little endian

Every request is checked: known keys, types and sizes. Pinned by tests/lab/test_messages.py.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import LabError
from softmap_edge.files.atomic import Document
from softmap_edge.lab.journal import names_in, numbers_in

LONGEST = 16384  # bytes of a request
KEYS: dict[str, tuple[str, ...]] = {
    "state": (),
    "library": (),
    "run": ("run",),
    "shape": ("run", "frame"),
    "comparison": ("run",),
    "check": (),
    "diagnose": (),
    "diagnosis": (),
    "try": ("run", "frame", "effects", "params"),
    "fit": ("effects", "params"),
    "accept": ("effects", "params"),
    "accept_diagnosis": (),
    "experiments": (),
    "undo": (),
    "redo": (),
}
LARGEST = 1 << 31  # of a number of a request, a run or a frame


@dataclass(frozen=True)
class Request:
    """A request of the page; keys that its kind does not have keep their defaults."""

    id: int
    do: str
    run: int = 0
    frame: int = 0
    effects: tuple[str, ...] = ()
    params: Mapping[str, float] = field(default_factory=dict)


class BadRequest(LabError):
    """A request that is not valid; `id` is its number, None if it has none."""

    id: int | None = None


def read_request(message: str | bytes) -> Request:
    """Return a checked request.

    Raises:
        BadRequest: it is not one.
    """
    if not isinstance(message, str):
        raise BadRequest("a request is text, not binary")
    try:
        document = json.loads(message, parse_constant=lambda name: None)
    except (ValueError, RecursionError):
        raise BadRequest("a request is a JSON object; this is not JSON") from None
    if not isinstance(document, dict):
        raise BadRequest("a request is a JSON object")
    number = document.get("id")
    known = number if type(number) is int and 0 <= number < LARGEST else None
    try:
        if known is None:
            raise BadRequest("a request has an 'id', a whole number from 0")
        do = document.get("do")
        if not isinstance(do, str) or do not in KEYS:
            raise BadRequest(f"no request {do!r:.40}; there are {', '.join(KEYS)}")
        required = {"id", "do", *KEYS[do]}
        if set(document) != required:
            raise BadRequest(f"the request '{do}' has the keys {', '.join(sorted(required))}")
        return Request(
            known,
            do,
            run=_index("run", document.get("run", 0)),
            frame=_index("frame", document.get("frame", 0)),
            effects=names_in(document.get("effects", [])),
            params=numbers_in(document.get("params", {})),
        )
    except LabError as fault:
        bad = BadRequest(str(fault))
        bad.id = known
        raise bad from None


def _index(key: str, value: object) -> int:
    if type(value) is not int or not 0 <= value < LARGEST:
        raise BadRequest(f"'{key}' is {value!r:.40}, expected a whole number from 0")
    return value


def text(document: Document) -> str:
    """Return a message without arrays; numbers that are not finite become null."""
    return json.dumps(_finite(document), allow_nan=False)


def binary(document: Document, arrays: Mapping[str, NDArray[np.float32]]) -> bytes:
    """Return a message with arrays."""
    listed = [[name, list(array.shape)] for name, array in arrays.items()]
    header = text(document | {"arrays": listed}).encode()
    header += b" " * (-len(header) % 4)
    data = [np.ascontiguousarray(array, "<f4").tobytes() for array in arrays.values()]
    return b"".join([struct.pack("<I", len(header)), header, *data])


def _finite(value: object) -> object:
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(one) for one in value]
    return value
