"""Follow a recording while a loop writes it: the periods that are new since one asked last.

    mark · (opcode u8, length u64, content) …      message: channel u16, sequence u32, times 2 × u64, data

Plain MCAP as the loop writes it, no chunks (https://mcap.dev/spec); what is not yet whole is read when it is. A
recording is somebody else's file: what is damaged ends it with a reason. Pinned by tests/test_live.py.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

from softmap_edge.errors import RunError
from softmap_edge.servo.recording import LOOP, SETUP

Document = dict[str, Any]

MARK = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
CHANNEL, MESSAGE, DATA_END = 0x04, 0x05, 0x0F
LONGEST = 1 << 24  # bytes of a record


class Following:
    """A recording that grows.

    `.setup` is the document of the loop once it is there, `.ended` whether its loop has closed it.

    Raises:
        RunError: there is no such file, or it is no recording.
    """

    def __init__(self, path: str | Path) -> None:
        self._path, self._rest, self._begun = Path(path), b"", False
        self._topics: dict[int, str] = {}
        self.setup: Document | None = None
        self.ended = False
        try:
            self._file = self._path.open("rb")
        except OSError as fault:
            raise RunError(f"{path}: {fault.strerror}; give the file that a loop records to (--record)") from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def new(self) -> list[Document]:
        """Return the periods that came since the last call.

        Raises:
            RunError: what is there is no recording of a loop.
        """
        self._rest += self._file.read()
        if not self._begun:
            if len(self._rest) < len(MARK):
                return []
            if not self._rest.startswith(MARK):
                raise RunError(f"{self._path}: no recording of a control loop; give what `softmap` recorded")
            self._rest, self._begun = self._rest[len(MARK) :], True
        periods, at = [], 0
        while not self.ended and at + _RECORD.size <= len(self._rest):
            opcode, length = _RECORD.unpack_from(self._rest, at)
            if length > LONGEST or opcode == 0:
                raise RunError(f"{self._path}: damaged, a record of {length} bytes; record again")
            end = at + _RECORD.size + length
            if end > len(self._rest):
                break
            content, at = self._rest[at + _RECORD.size : end], end
            try:
                period = self._take(opcode, content)
            except (ValueError, KeyError, struct.error, RecursionError) as fault:
                raise RunError(f"{self._path}: damaged ({type(fault).__name__} {fault!s:.60}); record again") from None
            periods += [] if period is None else [period]
        self._rest = self._rest[at:]
        return periods

    def _take(self, opcode: int, content: bytes) -> Document | None:
        """Take a record; returns the period that it holds, if it does."""
        if opcode == CHANNEL:
            (number, _, length) = struct.unpack_from("<HHI", content)
            self._topics[number] = content[8 : 8 + length].decode()
        elif opcode == MESSAGE:
            topic = self._topics.get(_MESSAGE.unpack_from(content)[0])
            if topic in (SETUP, LOOP):
                document = json.loads(content[_MESSAGE.size :])
                if not isinstance(document, dict):
                    raise ValueError("a message that is no object")
                if topic == LOOP:
                    return document
                self.setup = document
        elif opcode == DATA_END:
            self.ended = True
        return None
