"""Find out whether a recording of the loop is truncated or damaged, and where if that is known.

The file ends with a checksum of its data and the number of its messages. The compiled reader stops
at a damaged record. Pinned by tests/robot/test_recording.py and
tests/robot/test_recording_damage.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from softmap_edge import _core
from softmap_edge.errors import SoftmapError
from softmap_edge.files.mcap_records import MESSAGE, Closing, Damage, Walk, read_closing

CUT = "its loop did not close it: cut short"
# how the reader's message begins if the checksum of all data fails
_ANYWHERE = "damaged (Data section CRC"


@dataclass(frozen=True)
class Shortfall:
    """Why a recording may be incomplete (None if complete), and a sentence on missing data.

    doubtful: the checksum of the data fails at an unknown place, so any number may be wrong.
    """

    why: str | None = None
    sentence: Damage | None = None
    doubtful: bool = False


def find_shortfall(
    file: Path, messages: int, read: int, seconds: float, broken: str | None
) -> Shortfall:
    """Return why a recording is incomplete, and by how much.

    Args:
        file: the recording
        messages: number of messages that the reader found
        read: number of messages that are used, all before the first one that is `broken`
        seconds: s from the first period to the last that is used
        broken: why the next message is not a document; None if all messages are
    """
    why = broken or _why(file)
    with open(file, "rb") as stream:
        size = file.stat().st_size
        closing = read_closing(stream, size)
        if why is None and closing is None:
            why = CUT
        if why is None:
            return Shortfall(None, _unchecked(file, closing, Walk(stream, size)))
        start = size if closing is not None else _readable(Walk(stream, size), size)
    doubtful = why.startswith(_ANYWHERE)
    if doubtful:
        text = (
            f"{file} is damaged: the checksum of its data does not match, so any of its {read} "
            "messages may be wrong"
        )
        return Shortfall(why, Damage(text), True)
    parts = [
        _head(file, why, closing),
        f"it is read up to {seconds:.2f} s",
        *_missing(closing, messages, read),
    ]
    if start < size:
        parts.append(f"{size - start} of {size} bytes cannot be read")
    if closing is None:
        parts.append("without its end it carries no checksum")
    return Shortfall(why, Damage("; ".join(parts)))


def _why(file: Path) -> str | None:
    """Return why a recording may be incomplete: damaged inside, or not closed by its loop."""
    try:
        _, ended = _core.Reading(str(file)).more()
    except SoftmapError as fault:
        return str(fault).removeprefix(f"{file}: ")
    return None if ended else CUT


def _head(file: Path, why: str, closing: Closing | None) -> str:
    cause = why.removesuffix("; record again")
    if closing is None:
        return f"{file} was cut short: its loop did not close it" + (
            "" if why == CUT else f", and it is {cause}"
        )
    return f"{file} is damaged at its end" if why == CUT else f"{file} is {cause}"


def _missing(closing: Closing | None, messages: int, read: int) -> list[str]:
    """Return the number of missing messages, of those that the file states or that were found."""
    stated = 0 if closing is None or closing.total is None else closing.total
    total = max(messages, stated)
    if total > read:
        return [f"{total - read} of {total} messages missing"]
    return ["no message is missing"] if stated == read else []


def _unchecked(file: Path, closing: Closing | None, walk: Walk) -> Damage | None:
    """Return the damage of a file without a checksum; the loop always writes one."""
    if (closing is not None and closing.data is not None) or all(
        record.kind != MESSAGE for record in walk
    ):
        return None  # each chunk has its own checksum, which the reader verifies
    return Damage(
        f"{file} carries no checksum of its data: numbers that were damaged would not be noticed"
    )


def _readable(walk: Walk, size: int) -> int:
    """Return the end of the readable records."""
    for _ in walk:
        if walk.gaps:
            break
    return walk.gaps[0][0] if walk.gaps else size
