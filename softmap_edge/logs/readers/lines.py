"""Read the lines of a text log block by block, in the encoding detected from its first bytes.

A file that is too large, damaged or not text is rejected with the reason and the remedy. Pinned by
tests/logs/test_import_csv.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice, takewhile
from pathlib import Path

from softmap_edge.errors import RunError
from softmap_edge.logs.readers.encoding import PLAIN, decoded, encoding_of, is_wide

LIMIT = 2**30  # bytes of one log: about 5 million rows of 16 columns
LONGEST = 2**20  # characters of one line: 50 000 columns
_BLOCK = 2**22  # characters read at a time
_BLANK = 2**20  # blank lines at the end that are buffered with those to skip


def first_lines(path: Path, count: int, first: int = 1) -> list[str]:
    """Return at most `count` lines of a text log from line `first` on; fewer if they are long."""
    found: list[str] = []
    for _, lines in blocks(path, first):
        found += lines[: count - len(found)]
        if len(found) == count or (len(found) > 8 and sum(map(len, found)) > 2 * _BLOCK):
            break
    return found


def lines_of(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text log with their numbers, from 1, in one pass."""
    for first, lines in blocks(path, 1):
        yield from enumerate(lines, first)


def lines_that(path: Path, fits: Callable[[str], bool], most: int = 100) -> list[tuple[int, str]]:
    """Return at most `most` short lines of a text log that satisfy `fits`, numbered from 1."""
    found: list[tuple[int, str]] = []
    for number, line in lines_of(path):
        if len(line) < 200 and fits(line):
            found.append((number, line))
            if len(found) == most:
                break
    return found


def blocks(path: Path, first: int, stop: int | None = None) -> Iterator[tuple[int, list[str]]]:
    """Yield blocks of lines from number `first` to before `stop`, each with its first number.

    A block has some thousand lines.
    """
    number, rest, encoding = 1, "", PLAIN
    try:
        if not path.is_file():
            raise RunError(
                f"{path}: {'a folder' if path.is_dir() else 'cannot be read'}; give the path of a "
                "log"
            )
        if path.stat().st_size > LIMIT:
            raise RunError(
                f"{path}: {path.stat().st_size} bytes, at most {LIMIT} are read; split the log"
            )
        encoding = encoding_of(path)[0]
        for text in decoded(path, encoding, _BLOCK):
            if "\0" in text:
                raise RunError(f"{path}: holds zero bytes; the file is damaged or not a CSV log")
            lines = (rest + text).split("\n")
            rest = lines.pop()
            if len(rest) > LONGEST:
                raise RunError(
                    f"{path}: line {number + len(lines)} is longer than {LONGEST} characters; "
                    "export again"
                )
            if number + len(lines) > first:
                end = len(lines) if stop is None else max(stop - number, 0)
                yield max(number, first), lines[max(first - number, 0) : end]
            number += len(lines)
            if stop is not None and number >= stop:
                return
    except OSError as cause:
        raise RunError(
            f"{path}: cannot be read ({cause.strerror or cause}); give the path of a log"
        ) from cause
    except UnicodeDecodeError as cause:
        if is_wide(encoding):
            raise RunError(
                f"{path}: is damaged text in {encoding.upper()} ({cause.reason}); export it again"
            ) from cause
        if b"\0" in cause.object:
            raise RunError(f"{path}: is not text; give the log of a recording, as CSV") from cause
        raise RunError(
            f"{path}: is not text in UTF-8 (byte {cause.start} of a part); save the log as UTF-8"
        ) from cause
    if rest.strip() and number >= first:
        yield number, [rest]


def held_back(
    blocks: Iterator[tuple[int, list[str]]], count: int
) -> Iterator[tuple[int, list[str]]]:
    """Yield the same blocks without the last `count` lines that are not blank."""
    held: list[str] = []
    start = 1
    for first, lines in blocks:
        start = start if held else first
        held += lines
        # blank lines at the end do not count
        keep = count + (_blank_at_end(held) if count else 0)
        if len(held) > keep:
            yield start, held[: len(held) - keep]
            start, held = start + len(held) - keep, held[len(held) - keep :]
    while count and held and not held[-1].strip():
        held.pop()
    if count and len(held) > count:
        yield start, held[:-count]


def _blank_at_end(lines: list[str]) -> int:
    """Return the number of blank lines at the end, at most `_BLANK`."""
    blank = takewhile(lambda line: not line.strip(), islice(reversed(lines), _BLANK))
    return sum(1 for _ in blank)
