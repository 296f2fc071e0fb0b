"""Count read and lost parts of an MCAP file: skipped chunks, invalid bytes, messages.

Pinned by tests/files/test_mcap_damage.py.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from softmap_edge.files.mcap_records import Closing, Damage
from softmap_edge.files.printable import listed

SPANS = 3  # time spans that are listed


@dataclass(frozen=True)
class Lost:
    """A skipped chunk: its place in the file, the reason, and its times (ns) if known."""

    start: int
    end: int
    why: str
    span: tuple[int, int] | None


@dataclass
class Account:
    """The findings in a file of `size` bytes with the closing statements `closing`."""

    path: Path
    size: int
    closing: Closing | None
    chunks: int = 0
    lost: list[Lost] = field(default_factory=list)
    gaps: list[tuple[int, int]] = field(default_factory=list)  # bytes that are not records
    counts: Counter[int] = field(default_factory=Counter)  # messages read, by channel
    missing: int = 0  # messages stated by the indexes after the chunks but not found
    indexed: int = 0  # of the newest chunk: messages stated by its index, and messages read
    inside: int = 0
    strays: int = 0  # skipped messages: without a channel, or outside the chunks of a chunked file
    clashes: int = 0  # schemas and channels with conflicting definitions
    unchecked: int = 0  # chunks without a checksum, and messages outside chunks
    odd: int = 0  # records of unknown kind
    first: int | None = None  # log time of the first and last message read, ns
    last: int = 0

    def settle(self) -> None:
        """Finish the count of the newest chunk."""
        self.missing += max(0, self.indexed - self.inside)
        self.indexed = self.inside = 0

    def took(self, channel: int, time: int) -> None:
        """Count a message that was read."""
        self.inside += 1
        self.counts[channel] += 1
        self.first = time if self.first is None else min(self.first, time)
        self.last = max(self.last, time)

    @property
    def damage(self) -> Damage | None:
        """Return a sentence on the damage of the file; None if undamaged."""
        found = [*self._left_out(), *self._missing(), *self._contradictions()]
        if self.closing is not None and not found:
            return None
        cut = self.closing is None
        head = "was cut short" if cut else "is damaged"
        upto = (
            f"it is read up to {self._seconds(self.last)}" if cut and self.first is not None else ""
        )
        return Damage(
            f"{self.path} {head}: " + ("; ".join(filter(None, [upto, *found])) or "it has no end")
        )

    @property
    def remarks(self) -> list[str]:
        """Return further remarks on the file, as sentences."""
        sentences = []
        checked = self.closing is not None and self.closing.data
        if self.unchecked and not checked:
            every = self.unchecked >= self.chunks
            which = (
                "this file carries no checksums"
                if every
                else f"{self.unchecked} chunks carry no checksum"
            )
            sentences.append(f"{which}: numbers that were damaged would not be noticed")
        if self.odd:
            sentences.append(f"{self.odd} records of an unknown kind were passed over")
        return sentences

    def _left_out(self) -> list[str]:
        lines = []
        if self.lost:
            spans = [one.span for one in self.lost if one.span is not None]
            when = [
                f"{self._seconds(low, unit=False)} to {self._seconds(high)}" for low, high in spans
            ]
            times = f", {listed(when, SPANS)}" if when and self.first is not None else ""
            are = "is" if len(self.lost) == 1 else "are"
            lines.append(
                f"{len(self.lost)} of {self.chunks} chunks {are} left out ({self.lost[0].why}; "
                f"byte {self.lost[0].start}{times})"
            )
        gone = sum(end - start for start, end in self.gaps)
        if self.closing is None:  # a chunk before the truncated end is part of it
            gone += sum(one.end - one.start for one in self.lost)
        if gone:
            lines.append(f"{gone} of {self.size} bytes cannot be read")
        return lines

    def _missing(self) -> list[str]:
        total = None if self.closing is None else self.closing.total
        if self.closing is not None and total is not None:
            read, stated = dict(self.counts), self.closing.counts
            if stated is None:  # only their total
                read, stated = {0: self.counts.total()}, {0: total}
            missing = sum(max(0, count - read.get(channel, 0)) for channel, count in stated.items())
            spare = sum(max(0, count - stated.get(channel, 0)) for channel, count in read.items())
            lines = [f"{missing} of {total} messages are missing"] if missing else []
            return lines + ([f"{spare} messages more than its index states"] if spare else [])
        if self.missing:
            return [
                f"at least {self.missing} of {self.missing + self.counts.total()} messages are "
                "missing"
            ]
        return ["how many messages are missing is not known"] if self.lost else []

    def _contradictions(self) -> list[str]:
        lines = []
        if self.strays:
            lines.append(f"{self.strays} messages of no known channel or chunk are left out")
        if self.clashes:
            lines.append(
                f"{self.clashes} channels or schemas are defined twice, differently; the first "
                "one counts"
            )
        if self.closing is not None and self.closing.summary is False:
            lines.append("the checksum of its index does not match")
        if self.closing is not None and self.closing.data is False:
            lines.append(
                "the checksum of its data does not match, and only chunks with a checksum that "
                "matches are read"
            )
        return lines

    def _seconds(self, time: int, unit: bool = True) -> str:
        return f"{(time - (self.first or 0)) * 1e-9:.2f}{' s' * unit}"
