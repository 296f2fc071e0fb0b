"""Find the files for the paths of `softmap import`, and assign them to logs.

Paths are files, folders and packed files. A folder stands for its files, a packed file for its
contents. Several recordings that match one log are its parts. Logs whose mappings differ only in
`file` are one log in parts. Pinned by tests/logs/test_containers.py.
"""

from __future__ import annotations

import fnmatch
import glob
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from softmap_edge.errors import RunError
from softmap_edge.files.printable import listed
from softmap_edge.logs.mapping import Log, Mapping
from softmap_edge.logs.numbered import without_numbers
from softmap_edge.logs.readers.columns import Columns
from softmap_edge.logs.readers.kinds import ARRAYS, PACKED, RECORDINGS, kind_of
from softmap_edge.logs.readers.mcap_file import Topic, open_mcap, topics
from softmap_edge.logs.readers.messages import no_message, several_topics
from softmap_edge.logs.readers.packed import unpack
from softmap_edge.logs.readers.parquet_log import episodes_in
from softmap_edge.logs.readers.parts import JoinedColumns, joined
from softmap_edge.logs.readers.rosbag_folder import files_of
from softmap_edge.logs.readers.rosbag_sqlite import open_db3, topics_of_db3
from softmap_edge.logs.table import columns_named, header_hint, open_log
from softmap_edge.logs.time_keys import Clock

_NAMED = 4  # files and patterns that are named


@dataclass(frozen=True)
class Part:
    """One file to read.

    Attributes:
        given: the path given by the user: the file, or its folder.
        path: the file on disk.
        file: the same, or its unpacked content.
        kind: its format, from `kind_of`.
        notes: remarks on the given path.
        keep: an object that must stay alive while the file is read.
    """

    given: Path
    path: Path
    file: Path
    kind: str
    notes: tuple[str, ...] = ()
    keep: object = None

    @property
    def of_folder(self) -> bool:
        """Return whether the user gave its folder."""
        return self.given != self.path


def parts_of(paths: Sequence[Path]) -> list[Part]:
    """Return the files that paths stand for.

    Raises:
        RunError: a path cannot be read, is not a recording, or has an unsupported format.
    """
    found: list[Part] = []
    for path in (path if path.name not in ("", "..") else path.resolve() for path in paths):
        if path.is_dir():
            folder = files_of(path)
            parts = [_part(path, file) for file in folder.files]
            found += [replace(parts[0], notes=folder.notes), *parts[1:]]
        else:
            found.append(_part(path, path))
    return found


def _part(given: Path, path: Path) -> Part:
    kind = kind_of(path)
    if kind not in PACKED:
        return Part(given, path, path, kind)
    plain = unpack(path)
    with called(plain.file, path):
        inner = kind_of(plain.file)
    if inner in PACKED:
        raise RunError(f"{path}: is packed twice; unpack it yourself and give the log inside")
    return Part(given, path, plain.file, inner, keep=plain)


@contextmanager
def called(file: Path, path: Path) -> Iterator[None]:
    """Make errors show the path given by the user, not the unpacked file."""
    try:
        yield
    except RunError as fault:
        if file == path:
            raise
        raise RunError(str(fault).replace(str(file), str(path))) from None


@contextmanager
def named(parts: Sequence[Part]) -> Iterator[None]:
    """Make errors show the paths given by the user, as `called` does, for all files."""
    with ExitStack() as stack:
        for part in parts:
            stack.enter_context(called(part.file, part.path))
        yield


# --- opening -------------------------------------------------------------------------------
def topics_of(part: Part) -> list[Topic]:
    """Return the topics of a recording.

    Raises:
        RunError: it is damaged.
    """
    with called(part.file, part.path):
        return topics_of_db3(part.file) if part.kind == "db3" else topics(part.file, part.path)


def open_topic(
    part: Part, topic: str | None, most: int | None = None, frame: str | None = None
) -> Columns:
    """Open a topic of a recording; `frame` limits it to places in this frame.

    Raises:
        RunError: it is damaged, or the topic is absent.
    """
    with called(part.file, part.path):
        if part.kind == "db3":
            return open_db3(part.file, topic, most, frame)
        return open_mcap(part.file, topic, most, part.path, frame)


def open_parts(parts: Sequence[Part], log: Log) -> Columns:
    """Open the files of one log of a mapping.

    Raises:
        RunError: one of them cannot be read, or they are not parts of one recording.
    """
    first = parts[0]
    if first.kind in RECORDINGS:
        return _recording(parts, log.topic, frame=log.frame_id)
    if log.frame_id is not None:
        raise RunError(
            f"{first.path}: frame_id = '{log.frame_id[:60]}' is for recordings of ROS, which this "
            "is not; leave it out"
        )
    if len(parts) == 1:
        with called(first.file, first.path):
            return open_log(first.file, log)
    if log.clock.column is None:
        names = ", ".join(part.path.name for part in parts)
        raise RunError(
            f"{names}: only a column of time could put them in order; import each file alone"
        )
    opened = [(part.path.name, open_parts([part], log)) for part in parts]
    _check_alike(first.path, opened, log)
    return joined(first.path, opened, log.clock)


def _check_alike(path: Path, opened: Sequence[tuple[str, Columns]], log: Log) -> None:
    """Raise RunError if files are not parts of one log: a column is missing, or units differ."""
    asked = [column for column in columns_named(log) if isinstance(column, str)]
    known = {column for column in asked if any(column in columns.names for _, columns in opened)}
    for name, columns in opened:
        missing = [column for column in asked if column in known and column not in columns.names]
        if missing:
            raise RunError(
                f"{path}: {len(opened)} of the given files fit one log, but {name} has no column "
                f"{missing[0][:40]}{header_hint(columns.head_line)}; give exactly one, or change "
                "`file` in the mapping"
            )
    units = [{name: columns.units.get(name) for name in known} for _, columns in opened]
    other = next((k for k, one in enumerate(units) if one != units[0]), None)
    if other is not None:
        raise RunError(
            f"{path}: states other units than {opened[other][0]}; import each file alone"
        )


def _recording(
    parts: Sequence[Part], topic: str | None, most: int | None = None, frame: str | None = None
) -> Columns:
    """Open a topic of a recording in one or several files."""
    if len(parts) == 1:
        return open_topic(parts[0], topic, most, frame)
    held = [[one for one in topics_of(part) if one.count] for part in parts]
    named = {one.name: one.type for listed in held for one in listed}
    if topic is None and len(named) != 1:
        raise several_topics(parts[0].given, named)
    asked = next(iter(named)) if topic is None else topic
    holders = [part for part, listed in zip(parts, held) if asked in (one.name for one in listed)]
    if not holders:
        raise no_message(parts[0].given, asked, named)
    opened = tuple((part.path.name, open_topic(part, asked, most, frame)) for part in holders)
    return (
        opened[0][1]
        if len(opened) == 1
        else JoinedColumns(parts[0].given, opened, Clock("log_time", 1.0))
    )


def open_recording(parts: Sequence[Part], topic: str, most: int) -> Columns:
    """Open the first messages of a topic of a recording in one or several files.

    Raises:
        RunError: as `open_parts`.
    """
    return _recording(parts, topic, most)


def groups_of(parts: Sequence[Part]) -> list[list[Part]]:
    """Return files in groups: parts of one recording, by folder or by names with different numbers.

    A dataset of several files is also one group; every other file is alone.
    """
    found: dict[tuple[str, str], list[Part]] = {}
    for part in parts:
        key = ("folder", str(part.given)) if part.of_folder else ("file", str(part.path))
        if not part.of_folder and part.kind in RECORDINGS:
            key = ("parts", without_numbers(str(part.path)))
        found.setdefault(key, []).append(part)
    return list(found.values())


def pattern_of(group: Sequence[Part]) -> str:
    """Return the `file` of a group for a mapping."""
    first = group[0]
    if first.of_folder or len(group) == 1:
        return glob.escape(first.given.name)
    return without_numbers(glob.escape(first.path.name), "*")


# --- which log is which --------------------------------------------------------------------
@dataclass(frozen=True)
class Chosen:
    """The files of one log of a mapping, and their name in messages."""

    label: str
    parts: tuple[Part, ...]

    @property
    def path(self) -> Path:
        """The path shown in messages."""
        return self.parts[0].path if len(self.parts) == 1 else self.parts[0].given


def assign(parts: list[Part], mapping: Mapping) -> tuple[Mapping, list[Chosen]]:
    """Find the files of each log of a mapping.

    Returns:
        The mapping, with logs merged that differ only in `file`, and the files of each of its
        logs.

    Raises:
        RunError: a `file` fits no given file; a log has no file, or several that are not parts of
            one recording; or a file has no log.
    """
    logs, patterns = _alike(mapping.logs)
    mapping = replace(mapping, logs=tuple(logs))
    _refuse_unmatched(parts, patterns, mapping)
    if len(logs) == 1 and len(parts) == 1:
        return mapping, [_chosen(parts)]
    chosen = [_fitting(parts, log, names, mapping) for log, names in zip(logs, patterns)]
    # files of a folder may belong to other logs or to none
    used = {part.given for fits in chosen for part in fits}
    spare = list(dict.fromkeys(part.given.name for part in parts if part.given not in used))
    named = ", ".join(pattern for names in patterns for pattern in names)
    again = [
        (tuple(part.path for part in fits), log.topic)
        for fits, log in zip(chosen, logs)
        if fits[0].kind not in ARRAYS
    ]
    if spare or len(set(again)) < len(again):
        raise RunError(
            f"{mapping.path}: {', '.join(spare) or 'one file'} fits no log of its own; the "
            f"mapping has {named}"
        )
    return mapping, [_chosen(fits) for fits in chosen]


def _refuse_unmatched(parts: list[Part], patterns: list[list[str]], mapping: Mapping) -> None:
    """Raise RunError if a `file` of a mapping fits none of the given files."""
    unmatched = [
        pattern
        for names in patterns
        for pattern in names
        if not any(_matches(part, pattern) for part in parts)
    ]
    if not unmatched:
        return
    given = listed(dict.fromkeys(part.given.name for part in parts), _NAMED)
    named = listed(dict.fromkeys(unmatched), _NAMED)
    raise RunError(
        f"{mapping.path}: log '{named}': no given file fits (given: {given}); "
        "give the file, or change `file` in the mapping"
    )


def _chosen(parts: list[Part]) -> Chosen:
    folders = {part.given for part in parts if part.of_folder}
    alone = len(parts) == 1 or len(folders) == 1 == len({part.given for part in parts})
    label = parts[0].given.name if alone else f"{parts[0].path.name} and {len(parts) - 1} more"
    return Chosen(label, tuple(parts))


def _alike(logs: tuple[Log, ...]) -> tuple[list[Log], list[list[str]]]:
    """Return logs that differ in more than `file`, and the patterns of their files."""
    found: dict[str, tuple[Log, list[str]]] = {}
    for log in logs:
        key = (
            _described(replace(log, file=None))
            if log.file is not None
            else _described(log) + f" {len(found)}"
        )
        found.setdefault(key, (log, []))[1].append(log.file or "*")
    return [log for log, _ in found.values()], [names for _, names in found.values()]


def _described(value: object) -> str:
    """Return all keys of a log in a mapping, as text."""
    if isinstance(value, np.ndarray):
        return str(value.tolist())
    if isinstance(value, dict):
        return str([(key, _described(one)) for key, one in value.items()])
    if hasattr(value, "__dataclass_fields__"):
        return str([(key, _described(getattr(value, key))) for key in value.__dataclass_fields__])
    return repr(value)


def _fitting(parts: list[Part], log: Log, patterns: list[str], mapping: Mapping) -> list[Part]:
    """Return the files of a log: one, or the parts of one recording."""
    fits = [part for part in parts if any(_matches(part, pattern) for pattern in patterns)]
    if len(fits) > 1 and all(part.kind == "parquet" for part in fits):
        fits = _with_episode(fits, log, mapping)
    recorded = bool(fits) and all(part.kind in RECORDINGS for part in fits)
    parted = (
        len(fits) > 1
        and log.clock.column is not None
        and (log.file is not None or len(mapping.logs) == 1)
    )
    alike = parted and not any(part.kind in (*RECORDINGS, "parquet") for part in fits)
    if len(fits) == 1 or recorded or alike or (1 < len(fits) == len(patterns)):
        return fits
    names = ", ".join(part.path.name for part in fits)
    found = f"{len(fits)} of the given files fit ({names[:300]})" if fits else "no given file fits"
    raise RunError(
        f"{mapping.path}: log '{', '.join(patterns)}': {found}; give exactly one, or change "
        "`file` in the mapping"
    )


def _with_episode(fits: list[Part], log: Log, mapping: Mapping) -> list[Part]:
    """Return the file of a dataset that contains the episode of a log."""
    if log.episode is None:
        raise RunError(
            f"{mapping.path}: {fits[0].given.name} holds many episodes in {len(fits)} files, and "
            "each is a run of its own; name one in the mapping: episode = 0"
        )
    # LeRobot before v3
    called = [part for part in fits if part.path.stem == f"episode_{log.episode:06d}"]
    for part in called or fits:
        span = episodes_in(part.file)
        if span is not None and span[0] <= log.episode <= span[1]:
            return [part]
    raise RunError(
        f"{mapping.path}: no file of {fits[0].given.name} holds episode {log.episode}; change "
        "`episode`"
    )


def _matches(part: Part, pattern: str) -> bool:
    names = {part.path.name, part.given.name, part.file.name}
    return any(fnmatch.fnmatch(name, pattern) for name in names)
