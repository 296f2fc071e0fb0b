"""Read a topic of a rosbag2 recording in SQLite (.db3), as `mcap_file.py` does.

There is one row per message, with columns from `cdr.py`. The database may be malicious, so Python's
`sqlite3` opens it read-only, without views, triggers, extensions or memory maps, and with limits on
size and steps. A log left by an interrupted recorder (`-wal`) is merged in a copy. Recordings up to
Humble hold no message definitions: `message_types.py` has the common ones, and a message must then
be used up to its last byte. SQLite files have no checksum.
"""

from __future__ import annotations

import contextlib
import itertools
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from softmap_edge.errors import RunError, brief
from softmap_edge.files.printable import listed as listed_words
from softmap_edge.files.refusals import NO_ROOM, refusal
from softmap_edge.logs.readers.cdr import CdrError, Types, parse_definition, read_message
from softmap_edge.logs.readers.mcap_file import Topic
from softmap_edge.logs.readers.message_types import known_definition
from softmap_edge.logs.readers.messages import (
    MessageRows,
    TopicColumns,
    no_message,
    several_topics,
)

MAGIC = b"SQLite format 3\0"
LIMIT = 2**33  # bytes of one file
_LONGEST = 2**26  # bytes of one message
_TOPICS = 4096
_STEPS = 100_000  # steps of SQLite's machine between two checks of their number
_MOST_STEPS = 30_000_000  # for a small file: some seconds
_STEPS_A_BYTE = 4  # additional steps for a large file; a message takes some 20 steps
_TABLES = {
    "topics": {"id", "name", "type", "serialization_format"},
    "messages": {"topic_id", "timestamp", "data"},
}
_RECOVER = "copy it again, or save the readable part: sqlite3 FILE .recover | sqlite3 NEW.db3"


@dataclass(frozen=True)
class _Channel:
    """A topic of the database: its rows in `topics`, message type and definition."""

    ids: tuple[int, ...]
    name: str
    type: str
    encoding: str
    definition: str | None  # from the file
    count: int


def topics_of_db3(path: Path) -> list[Topic]:
    """Return the recorded topics.

    Raises:
        RunError: the file is damaged, or not a recording of rosbag2.
    """
    with _opened(path) as (database, _):
        found = _channels(path, database)
    return [
        Topic(one.name, one.type, one.count, one.count > 0 and _types(one) is not None)
        for one in found
    ]


def open_db3(
    path: Path, topic: str | None, most: int | None = None, frame: str | None = None
) -> TopicColumns:
    """Read the messages of a topic.

    Args:
        path: the recording.
        topic: None for the only one.
        most: limits the number of messages.
        frame: the only frame whose places are read; None for all.

    Raises:
        RunError: the file is damaged, the topic is absent or cannot be decoded, or nothing is in
            the frame.
    """
    with _opened(path) as (database, notes):
        channels = _channels(path, database)
        notes += _unlisted(database, channels)
        channel = _chosen(path, channels, topic)
        types = _types_or_fault(path, channel)
        rows = MessageRows(path, channel.name, frame)
        for k, (logged, data) in enumerate(_messages(path, database, channel, most)):
            try:
                content = read_message(channel.type, types, data, channel.definition is None, frame)
            except CdrError as fault:
                why = "the file is damaged"
                if channel.definition is None:
                    why += (
                        f", or its {channel.type} is not the common one: convert it with `ros2 "
                        "bag convert` to MCAP"
                    )
                raise RunError(
                    f"{path}: topic {channel.name[:60]}, message {k + 1}: {fault}; {why}"
                ) from None
            rows.add(content, 1e-9 * logged)
    return rows.columns(tuple(notes), by_time=True)


def _chosen(path: Path, channels: list[_Channel], topic: str | None) -> _Channel:
    """Return the channel of a topic, or the only one."""
    fits = [one for one in channels if topic is None or one.name == topic]
    if topic is None and len(fits) != 1:
        raise several_topics(path, {one.name: one.type for one in channels})
    if not fits or not fits[0].count:
        raise no_message(
            path, fits[0].name if fits else str(topic), (one.name for one in channels if one.count)
        )
    return fits[0]


# --- definitions ---------------------------------------------------------------------------
def _types(channel: _Channel) -> Types | None:
    """Return the fields of a channel's messages; None if unknown."""
    text = channel.definition or known_definition(channel.type)
    if channel.encoding != "cdr" or text is None:
        return None
    try:
        return parse_definition(channel.type, text)
    except CdrError:
        return None


def _types_or_fault(path: Path, channel: _Channel) -> Types:
    found = _types(channel)
    if found is not None:
        return found
    where = f"{path}: topic {channel.name[:60]}"
    if channel.encoding != "cdr":
        raise RunError(
            f"{where} is {channel.encoding[:40] or 'of no encoding'}, expected cdr, as rosbag2 "
            "writes"
        )
    if channel.definition is not None:
        raise RunError(
            f"{where}: the definition of {channel.type[:60]} cannot be read; the file is damaged"
        )
    raise RunError(
        f"{where}: its type {channel.type[:60]} is not one of the common ones, and the file holds "
        "no definition; convert the recording where ROS knows the type: `ros2 bag convert` to "
        "MCAP"
    )


# --- the database --------------------------------------------------------------------------
@contextlib.contextmanager
def _opened(path: Path) -> Iterator[tuple[sqlite3.Connection, list[str]]]:
    """Open the database with limits; convert every fault reported by SQLite to one error."""
    notes: list[str] = []
    with contextlib.ExitStack() as stack:
        try:
            size = path.stat().st_size
            if size > LIMIT:
                raise RunError(
                    f"{path}: {size} bytes, at most {LIMIT} are read; split the recording"
                )
            file = _merged(path, notes, stack)
            database = sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
            stack.callback(database.close)
            _harden(database, size)
            yield database, notes
        except sqlite3.Error as fault:
            why = "it takes too long to read" if "interrupted" in str(fault) else brief(fault)
            raise RunError(f"{path}: is a damaged SQLite file ({why}); {_RECOVER}") from None
        except (OverflowError, UnicodeError) as fault:
            raise RunError(
                f"{path}: is a damaged SQLite file ({brief(fault)}); {_RECOVER}"
            ) from None
        except OSError as cause:
            if cause.errno in NO_ROOM:  # of the copy with what the recorder left
                raise RunError(
                    f"{path}: cannot be copied: {refusal(cause, tempfile.gettempdir())}"
                ) from cause
            raise RunError(
                f"{path}: cannot be read ({cause.strerror or cause}); give the path of a log"
            ) from cause


def _merged(path: Path, notes: list[str], stack: contextlib.ExitStack) -> Path:
    """Return the file, or a copy merged with the log of an interrupted recorder next to it."""
    log = path.with_name(path.name + "-wal")
    if not log.is_file() or log.stat().st_size == 0:
        return path
    if log.stat().st_size + path.stat().st_size > LIMIT:
        raise RunError(f"{path}: with its -wal more than {LIMIT} bytes; split the recording")
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="softmap-")))
    copy = folder / "copy.db3"
    shutil.copyfile(path, copy)
    shutil.copyfile(log, folder / "copy.db3-wal")
    with contextlib.closing(sqlite3.connect(copy)) as database:
        _harden(database, copy.stat().st_size)
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    notes.append(f"the recorder was interrupted; what it left in {log.name} is read too")
    return copy


def _harden(database: sqlite3.Connection, size: int) -> None:
    """Set limits for an untrusted database of `size` bytes."""
    calls = itertools.count(1)
    most = (_MOST_STEPS + _STEPS_A_BYTE * size) // _STEPS
    database.set_progress_handler(lambda: next(calls) > most, _STEPS)
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
    database.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
    database.text_factory = lambda data: data.decode("utf-8", "replace")
    for pragma in (
        "trusted_schema = OFF",
        "cell_size_check = ON",
        "mmap_size = 0",
        "cache_size = -16384",
    ):
        database.execute(f"PRAGMA {pragma}").fetchall()


def _channels(path: Path, database: sqlite3.Connection) -> list[_Channel]:
    """Return the topics of a recording."""
    tables = dict(
        database.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table' LIMIT 1000")
    )
    for name, columns in _TABLES.items():
        held = {row[1]: row[6] for row in database.execute(f"PRAGMA table_xinfo({name})")}
        virtual = str(tables.get(name)).lstrip().upper().startswith("CREATE VIRTUAL")
        if (
            name not in tables
            or virtual
            or not columns <= held.keys()
            or any(held[one] for one in columns)
        ):
            raise RunError(
                f"{path}: is an SQLite file, but no recording of rosbag2 (no table `{name}` with "
                "its columns); export its rows as CSV: sqlite3 -header -csv FILE 'SELECT * FROM "
                "TABLE' > LOG.csv"
            )
    counts = dict(
        database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id LIMIT 4096")
    )
    definitions = _definitions(database) if "message_definitions" in tables else {}
    found: dict[str, _Channel] = {}
    listed = database.execute(
        f"SELECT id, name, type, serialization_format FROM topics LIMIT {_TOPICS}"
    )
    for number, *texts in listed:
        if not isinstance(number, int) or not all(isinstance(text, str) for text in texts):
            raise RunError(
                f"{path}: is a damaged SQLite file (a topic without a name or type); {_RECOVER}"
            )
        name, kind, encoding = texts
        had = found.get(name)
        count = int(counts.get(number, 0)) + (had.count if had else 0)
        ids = (*(had.ids if had else ()), number)
        found[name] = _Channel(ids, name, kind, encoding, definitions.get(kind), count)
    return list(found.values())


def _unlisted(database: sqlite3.Connection, channels: list[_Channel]) -> list[str]:
    """Return a sentence on messages whose topic is not in the list of topics."""
    listed = {number for one in channels for number in one.ids}
    counts = database.execute(
        "SELECT topic_id, count(*) FROM messages GROUP BY topic_id LIMIT 4096"
    )
    lost = {f"{number}"[:20]: int(count) for number, count in counts if number not in listed}
    if not lost:
        return []
    return [
        f"{sum(lost.values())} messages of topic_id {listed_words(lost, 3)} are left out: the "
        "file does not list their topic, so it is damaged or its recorder was interrupted"
    ]


def _definitions(database: sqlite3.Connection) -> dict[str, str]:
    """Return the definitions in the file, by type."""
    columns = "topic_type, encoding, encoded_message_definition"
    rows = database.execute(f"SELECT {columns} FROM message_definitions LIMIT {_TOPICS}")
    return {
        kind: text
        for kind, how, text in rows
        if how == "ros2msg" and isinstance(text, str) and text
    }


def _messages(
    path: Path, database: sqlite3.Connection, channel: _Channel, most: int | None
) -> Iterator[tuple[int, bytes]]:
    """Yield time (ns) and bytes of a channel's messages, in the order of writing."""
    marks = ", ".join("?" * len(channel.ids))
    rows = database.execute(
        f"SELECT timestamp, data FROM messages WHERE topic_id IN ({marks}) LIMIT ?",
        (*channel.ids, -1 if most is None else most),
    )
    for logged, data in rows:
        if not isinstance(logged, int) or not isinstance(data, bytes):
            raise RunError(
                f"{path}: is a damaged SQLite file (a message without time or bytes); {_RECOVER}"
            )
        yield logged, data
