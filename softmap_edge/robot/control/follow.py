"""Follow a recording while a loop writes it: return the periods that are new since the last call.

The compiled core reads it (`rust/control/recording.rs`); a period is read once it is complete. A
recording is untrusted input: damaged data ends it with a reason. Pinned by
tests/robot/test_live.py.
"""

from __future__ import annotations

import json
from pathlib import Path

from softmap_edge import _core
from softmap_edge.errors import RunError, SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.robot.control.recording import LOOP, SETUP


class Following:
    """A growing recording.

    `.setup` is the document of the loop once it is written; `.ended` is whether the loop has closed
    the file.

    Raises:
        RunError: there is no such file.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self.setup: Document | None = None
        self.ended = False
        try:
            self._recording = _core.Reading(str(path))
        except SoftmapError as fault:
            raise RunError(f"{fault}; give the file that a loop records to (--record)") from None

    def new(self) -> list[Document]:
        """Return the periods that were added since the last call.

        Raises:
            RunError: the file is not a recording of a loop.
        """
        try:
            messages, self.ended = self._recording.more()
            documents = [
                (topic, json.loads(message))
                for topic, _, message in messages
                if topic in (SETUP, LOOP)
            ]
        except SoftmapError as fault:
            raise RunError(str(fault)) from None
        except (ValueError, RecursionError) as fault:
            raise RunError(
                f"{self._path}: damaged ({type(fault).__name__} {fault!s:.60}); record again"
            ) from None
        if not all(isinstance(document, dict) for _, document in documents):
            raise RunError(f"{self._path}: damaged (a message that is not an object); record again")
        self.setup = next((document for topic, document in documents if topic == SETUP), self.setup)
        return [document for topic, document in documents if topic == LOOP]
