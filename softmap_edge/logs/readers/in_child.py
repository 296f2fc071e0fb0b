"""Run a third-party parser on an untrusted log in a child process with limited memory and time.

A fault of the parser becomes one RunError. Pinned by tests/logs/test_read_in_child.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.atomic import Document
from softmap_edge.files.child import ChildFault, ChildLate, ChildMemory, in_child

Array = NDArray[np.float64]
MEGABYTES = 1024  # memory limit of a parser
MOST = 2**25  # numbers of one file: a million rows of 32 columns, 256 MiB
SECONDS = 2.5  # s of processor time for a small file
PER_SECOND = 2**22  # bytes per second that a parser reads, at least


@dataclass
class Answer:
    """The result of a parser.

    Attributes:
        arrays: numbers by name, of any shape.
        document: texts and numbers by name.
    """

    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    document: Document = field(default_factory=dict)


def read_in_child(
    path: Path, what: str, parse: Callable[..., Answer], **arguments: object
) -> Answer:
    """Call a parser on a file in a child process with limits.

    Args:
        path: the file.
        what: its format, for messages: `MATLAB file`.
        parse: takes the path and the arguments.
        arguments: of the parser.

    Raises:
        RunError: the parser rejects the file, fails, crashes, or exceeds its memory or time.
    """
    seconds = SECONDS + path.stat().st_size / PER_SECOND
    try:
        return Answer(
            *in_child(
                partial(_parts, parse, path, **arguments), megabytes=MEGABYTES, seconds=seconds
            )
        )
    except ChildMemory:
        raise RunError(
            f"{path}: this {what} needs more than {MEGABYTES} MB to be read; split it"
        ) from None
    except ChildLate:
        raise RunError(
            f"{path}: this {what} was not read within {seconds:.0f} s; it is damaged or too "
            "large: split it"
        ) from None
    except ChildFault as fault:
        raise RunError(f"{path}: is a damaged {what} ({fault}); export it again") from None


def _parts(
    parse: Callable[..., Answer], path: Path, **arguments: object
) -> tuple[dict[str, Array], Document]:
    answer = parse(path, **arguments)
    return answer.arrays, answer.document
