"""Use the topics of a recording on one clock and in one frame.

Stamps and log times are two clocks, which differ by the delay of the messages, or by any amount if
another computer sets the stamps. So `time` is the stamp only if every topic of the mapping has
stamps; otherwise it is the log time in all of them. A mapping may name `header.stamp` or `log_time`
of a topic; two clocks are then reported. Places in different frames (`header.frame_id`) are
refused; `frame_id` in the mapping selects one frame. Lists without names whose length changes are
reported. Pinned by tests/logs/test_recorded_topics.py.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.printable import listed
from softmap_edge.files.toml import quoted
from softmap_edge.logs.mapping import Log
from softmap_edge.logs.measured import Column
from softmap_edge.logs.readers.columns import Array, Columns
from softmap_edge.logs.readers.messages import OWN, TopicColumns, frames_listed
from softmap_edge.logs.readers.parts import JoinedColumns

_TIME, _LOGGED = OWN
_ELEMENT = re.compile(r"(?P<list>.*)\[(?P<at>\d{1,6})\](\.[^\[\]]*)?$")  # `poses[2].position.x`
_APART_S = 1.0  # messages of one computer are logged within this time
_NAMED = 3  # frames and topics that are listed


@dataclass(frozen=True)
class OneClock:
    """The logs of a mapping, with the clock of each topic decided, and sentences on it."""

    logs: tuple[Log, ...]
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


def topics_in(columns: Columns) -> list[TopicColumns]:
    """Return the messages of a topic, one table for each file; empty for another kind of log."""
    each = [one for _, one in columns.parts] if isinstance(columns, JoinedColumns) else [columns]
    return [one for one in each if isinstance(one, TopicColumns)]


# --- clocks --------------------------------------------------------------------------------
def on_one_clock(logs: Sequence[Log], opened: Sequence[Columns]) -> OneClock:
    """Decide whether `time` is the stamp or the log time, for all topics of a mapping alike.

    Args:
        logs: of the mapping.
        opened: the columns of each log.
    """
    tables = [topics_in(columns) for columns in opened]
    stamped = [_stamped(log, topic) for log, topic in zip(logs, tables)]
    free = [log.clock.columns == [_TIME] and bool(topic) for log, topic in zip(logs, tables)]
    bare = [k for k, found in enumerate(stamped) if False in found]
    with_stamps = [k for k, found in enumerate(stamped) if True in found]
    if not bare or not with_stamps:
        return OneClock(tuple(logs), doubts=_far(tables, with_stamps))
    # a mapping that names a clock decides for its topic only
    changed = [k for k in with_stamps if free[k]] if any(free[k] for k in bare) else []
    decided = tuple(
        replace(log, clock=replace(log.clock, column=_LOGGED)) if k in changed else log
        for k, log in enumerate(logs)
    )
    without = listed(dict.fromkeys(_name(tables[k]) for k in bare), _NAMED)
    notes = tuple(
        f"topic {_name(tables[k])}: time is the log time, as in {without}, where some "
        f"messages have no stamp: stamps are another clock ({_delay(tables[k])}); time = {{ column "
        '= "header.stamp" } takes the stamps'
        for k in changed
    )
    left = [k for k in with_stamps if k not in changed]
    doubts = tuple(
        f"t: two clocks: topic {_name(tables[k])} counts by its stamps ({_delay(tables[k])}), "
        f'{without} by the log time: name column = "{_LOGGED}" in all of them unless the stamps '
        "are right and of this computer"
        for k in left
    )
    return OneClock(decided, notes, doubts)


def _stamped(log: Log, topic: Sequence[TopicColumns]) -> set[bool]:
    """Return whether the times of a log are stamps, for each of its files; empty if neither."""
    if log.clock.columns == [_TIME]:
        return {one.stamped for one in topic}
    if log.clock.columns == [_LOGGED]:
        return {False} if topic else set()
    named = [str(column) for column in log.clock.columns]
    return {True} if topic and any(name.endswith("header.stamp") for name in named) else set()


def _far(tables: Sequence[Sequence[TopicColumns]], with_stamps: Sequence[int]) -> tuple[str, ...]:
    """Return the doubt that stamps of several topics are of clocks that are not set alike."""
    delays = [(float(np.median(found)), k) for k in with_stamps if len(found := _late(tables[k]))]
    if not delays or max(delays)[0] - min(delays)[0] <= _APART_S:
        return ()
    both = " and ".join(
        f"{_name(tables[k])} {_delay(tables[k])}" for _, k in (min(delays), max(delays))
    )
    return (
        f"t: the stamps of the topics are of clocks that are not set alike: {both}: name column = "
        f'"{_LOGGED}" in all of them, or give time.offset_s of one',
    )


def _late(topic: Sequence[TopicColumns]) -> Array:
    """Return log time minus stamp (messages,) s of a topic."""
    each = [
        one.numbers[:, one.names.index(_LOGGED)] - one.numbers[:, one.names.index("header.stamp")]
        for one in topic
        if "header.stamp" in one.names and one.stamped
    ]
    late = np.concatenate(each) if each else np.zeros(0)
    return late[np.isfinite(late)]


def _delay(topic: Sequence[TopicColumns]) -> str:
    late = _late(topic)
    if not len(late):
        return "of its elements"
    low, middle, high = np.quantile(late, (0.05, 0.5, 0.95))
    return f"{middle:.4g} s before the log time, 5 to 95 %: {low:.4g} to {high:.4g} s"


def _name(topic: Sequence[TopicColumns]) -> str:
    return topic[0].topic[:60]


# --- frames --------------------------------------------------------------------------------
def check_frames(log: Log, columns: Columns) -> list[str]:
    """Check that all places of a log are in one frame, and each of its outputs too.

    Returns:
        list[str]: the doubt that some messages do not name their frame.

    Raises:
        RunError: places are in different frames.
    """
    topic = topics_in(columns)
    if not topic:
        return []
    places = [column for points in (log.markers, log.base) if points for column in points.columns]
    doubts = _check_alike(topic, "places", places)
    for column in () if log.output is None else log.output.columns:
        doubts += _check_alike(topic, f"output {column}", [column])
    return doubts


def _check_alike(topic: Sequence[TopicColumns], what: str, columns: Sequence[Column]) -> list[str]:
    counts, first = Counter[str](), dict[str, str]()
    for one in topic:
        for column in columns:
            name = column if isinstance(column, str) else one.names[column]
            found = one.frames_of(name)
            for frame, count in found.items():
                counts[frame] = max(counts[frame], count)
                first.setdefault(frame, name)
    named = Counter({frame: count for frame, count in counts.items() if frame})
    where = f"topic {_name(topic)}: {what}"
    if len(named) > 1:
        usual = min(named, key=lambda frame: (-named[frame], frame))
        shown = "; ".join(f"{first[frame][:60]} is in {frame[:60]}" for frame in list(named)[:2])
        each = f" ({shown})" if len({first[frame] for frame in named}) > 1 else ""
        raise RunError(
            f"{topic[0].path}: {where} in {len(named)} frames, by header.frame_id in messages: "
            f"{frames_listed(named)}{each}; places in different frames are not one: set frame_id = "
            f"{quoted(usual)} in this [[log]] to read one of them only, or record them in one frame"
        )
    if named and counts[""]:
        return [
            f"{where} are in frame {next(iter(named))[:60]}, but {counts['']} messages name no "
            "frame: they are taken to be in the same; set frame_id to leave them out"
        ]
    return []


# --- lists ---------------------------------------------------------------------------------
def doubts_of_lists(log: Log, columns: Columns) -> list[str]:
    """Report columns from lists without names that hold another number of elements in places.

    The elements after a missing one move up, so a column may hold several things.
    """
    topic = topics_in(columns)
    used = [
        column
        for one in (*log.rows.values(), log.markers, log.base, log.output)
        if one
        for column in one.columns
    ]
    lists: dict[str, str] = {}
    for column in used:
        name = column if isinstance(column, str) else columns.names[column]
        if topic and (found := _ELEMENT.match(name)):
            lists.setdefault(found["list"], name)
    doubts = []
    for path, name in lists.items():
        counts = Counter[int]()
        for one in topic:
            counts.update(_lengths(one, path).tolist())
        counts.pop(0, None)  # an empty list confuses nothing
        if len(counts) > 1:
            usual = max(counts, key=lambda length: (counts[length], length))
            other = sum(counts.values()) - counts[usual]
            lengths = listed([f"{n} ({count})" for n, count in counts.most_common()], _NAMED)
            doubts.append(
                f"topic {_name(topic)}: {path} has {usual} elements in most messages, another "
                f"number in {other}: {lengths}; elements without names move up when one is "
                f"missing, so {name[:60]} may show several things: give all elements, or record "
                "them with names"
            )
    return doubts


def _lengths(topic: TopicColumns, path: str) -> NDArray[np.int64]:
    """Return the number of elements (messages,) of a list, by the numbers that are there."""
    lengths = np.zeros(len(topic.numbers), np.int64)
    for k, name in enumerate(topic.names):
        found = _ELEMENT.match(name)
        if found and found["list"] == path:
            there = ~np.isnan(topic.numbers[:, k])
            lengths[there] = np.maximum(lengths[there], int(found["at"]) + 1)
    return lengths
