"""Read a Parquet log, such as an episode of a LeRobot dataset, with pyarrow in a child process.

A column of numbers keeps its name. A column of lists of numbers becomes `action[0]` …, or
`action[shoulder_pan.pos]` if the dataset's `meta/info.json` names the elements. Only one of several
episodes is read. Times are converted to seconds, texts to labels; checksums of pages are checked if
present. Images and structs are left out and listed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softmap_edge.errors import RunError
from softmap_edge.files.atomic import Document
from softmap_edge.logs.lerobot import Info, info_near
from softmap_edge.logs.readers.arrays import MOST_COLUMNS, ArrayColumns, columns_of_arrays
from softmap_edge.logs.readers.columns import as_floats, as_floats_or_booleans
from softmap_edge.logs.readers.in_child import MOST, Answer, read_in_child

if TYPE_CHECKING:
    from pyarrow import Array as PyArray
    from pyarrow import DataType
    from pyarrow.parquet import ParquetFile

EPISODE = "episode_index"
LIMIT = 2**32  # bytes of one file
_BATCH = 2**14  # rows at a time
_SHOWN = 3  # episodes that a message lists


def open_parquet(path: Path, episode: int | None = None, first: bool = False) -> ArrayColumns:
    """Read a Parquet file.

    Args:
        path: the file.
        episode: the episode to read, if there are several.
        first: whether to read the first of several if none is requested.

    Raises:
        RunError: pyarrow is not installed, the file is damaged or too large, or the episode is
            absent.
    """
    if path.stat().st_size > LIMIT:
        raise RunError(
            f"{path}: {path.stat().st_size} bytes, at most {LIMIT} are read; split the log"
        )
    answer = read_in_child(path, "Parquet file", read_parquet, episode=episode, first=first)
    info = info_near(path)
    document = answer.document
    notes = [str(note) for note in document["notes"]]
    labels = {} if info is None else info.names
    return columns_of_arrays(
        path, answer.arrays, document["texts"], labels, notes, _left_out(document, info)
    )


def _left_out(document: Document, info: Info | None) -> list[str]:
    absent = [str(entry) for entry in document["left_out"]]
    return (
        absent
        if info is None
        else [*absent, *(f"{name} (in files of video)" for name in _videos(document, info))]
    )


def _videos(document: Document, info: Info) -> list[str]:
    return [
        name
        for name in info.names
        if name.startswith("observation.image") and name not in document["names"]
    ]


def episodes_in(path: Path) -> tuple[int, int] | None:
    """Return the first and last episode of a file; None without episodes.

    Raises:
        RunError: as `open_parquet`.
    """
    found = read_in_child(path, "Parquet file", read_episodes).document["episodes"]
    return None if found is None else (int(found[0]), int(found[1]))


# --- in the child --------------------------------------------------------------------------
def _file(path: Path) -> ParquetFile:
    try:
        import pyarrow.parquet
    except ImportError:
        raise RunError(
            f"{path}: Parquet needs pyarrow; run pip install 'softmap-edge[logs]'"
        ) from None
    return pyarrow.parquet.ParquetFile(
        path, page_checksum_verification=True, pre_buffer=False, memory_map=False
    )


def read_episodes(path: Path) -> Answer:
    """Return the first and last episode; runs in the child."""
    with _file(path) as file:
        if EPISODE not in file.schema_arrow.names:
            return Answer(document={"episodes": None})
        known: list[int] = []
        for batch in file.iter_batches(_BATCH, columns=[EPISODE], use_threads=False):
            column = as_floats(batch.column(0).to_numpy(zero_copy_only=False))
            known += [int(column.min()), int(column.max())] if len(column) else []
    return Answer(document={"episodes": [min(known), max(known)] if known else None})


def read_parquet(path: Path, episode: int | None, first: bool) -> Answer:
    """Read the columns of one episode, or of a file without episodes; runs in the child.

    Raises:
        RunError: as `open_parquet`.
    """
    with _file(path) as file:
        import pyarrow

        schema = file.schema_arrow
        if len(schema) > MOST_COLUMNS:
            raise RunError(f"{path}: {len(schema)} columns, at most {MOST_COLUMNS} are read")
        names = list(dict.fromkeys(one.name for one in schema if _is_read(pyarrow, one.type)))
        gathered = _Gathered(path, names, episode)
        gathered.left_out = [
            f"{one.name} ({str(one.type)[:30]})" for one in schema if one.name not in names
        ]
        for batch in file.iter_batches(_BATCH, columns=names, use_threads=False):
            table = {name: batch.column(k) for k, name in enumerate(batch.schema.names)}
            keep = gathered.of_episode(table)
            if len(gathered.seen) > 1 and episode is None and not first:
                _ask(path, file.metadata.num_rows)
            if keep is None or keep.any():
                for name in names:
                    gathered.add(name, _values(pyarrow, table[name]), keep)
    return gathered.answer()


class _Gathered:
    """The columns of one episode, collected batch by batch."""

    def __init__(self, path: Path, names: list[str], episode: int | None) -> None:
        self.path, self.names, self.episode = path, names, episode
        self.parts: dict[str, list[NDArray[np.generic]]] = {name: [] for name in names}
        self.left_out: list[str] = []
        self.seen: set[int] = set()  # numbers of episodes
        self.ragged: set[str] = set()
        self.numbers = 0

    def of_episode(self, table: Mapping[str, PyArray]) -> NDArray[np.bool_] | None:
        """Return which rows of a batch belong to the episode; None where there are no episodes."""
        if EPISODE not in table:
            return None
        each = as_floats(table[EPISODE].to_numpy(zero_copy_only=False))
        self.seen |= {int(x) for x in np.unique(each[np.isfinite(each)])}
        if self.episode is None and self.seen:
            self.episode = min(self.seen)
        return np.asarray(each == self.episode)

    def add(
        self, name: str, values: NDArray[np.generic] | None, keep: NDArray[np.bool_] | None
    ) -> None:
        """Add the rows `keep` (rows,) of a column's values (rows, …).

        `values` is None if they have no common shape.

        Raises:
            RunError: the file holds too many numbers.
        """
        had = self.parts[name]
        if values is None or (had and values.shape[1:] != had[0].shape[1:]):
            self.ragged.add(name)
            return
        values = values if keep is None else values[keep]
        self.numbers += values.size
        if self.numbers > MOST:
            raise RunError(f"{self.path}: holds more than {MOST} numbers; split the log")
        had.append(values)

    def answer(self) -> Answer:
        """Return all columns as the child's answer.

        Raises:
            RunError: the file does not contain the episode.
        """
        if EPISODE in self.names and not self.parts[EPISODE]:
            listed = f"{min(self.seen)} to {max(self.seen)}" if self.seen else "none"
            raise RunError(
                f"{self.path}: holds no episode {self.episode}; there are {listed}; change "
                "`episode` in the mapping"
            )
        columns = {
            name: np.concatenate(parts)
            for name, parts in self.parts.items()
            if parts and name not in self.ragged
        }
        for name in self.names:
            if name not in columns:
                why = "lists of different lengths" if name in self.ragged else "empty"
                self.left_out.append(f"{name} ({why})")
        arrays = {
            name: as_floats_or_booleans(one)
            for name, one in columns.items()
            if one.dtype.kind in "biuf"
        }
        texts = {
            name: [str(text)[:200] for text in one]
            for name, one in columns.items()
            if one.dtype.kind == "O"
        }
        notes = [] if self.episode is None else [f"episode {self.episode}"]
        document = {"texts": texts, "left_out": self.left_out, "notes": notes, "names": self.names}
        return Answer(arrays, document)


def _ask(path: Path, rows: int) -> None:
    raise RunError(
        f"{path}: holds several episodes ({rows} rows), and each is a run of its own; name one in "
        "the mapping: episode = 0"
    )


def _is_read(pyarrow: ModuleType, kind: DataType) -> bool:
    """Whether a column holds numbers, lists of numbers, times or texts."""
    types = pyarrow.types
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        return bool(types.is_floating(kind.value_type) or types.is_integer(kind.value_type))
    if types.is_dictionary(kind):
        return _is_read(pyarrow, kind.value_type)
    numbers = (
        types.is_floating(kind)
        or types.is_integer(kind)
        or types.is_boolean(kind)
        or types.is_decimal(kind)
    )
    times = types.is_timestamp(kind) or types.is_duration(kind)
    return bool(numbers or times or types.is_string(kind) or types.is_large_string(kind))


def _values(pyarrow: ModuleType, column: PyArray) -> NDArray[np.generic] | None:
    """Return a column as an array: (rows,), or (rows, elements) of lists.

    None for lists of different lengths.
    """
    types = pyarrow.types
    kind = column.type
    if types.is_dictionary(kind):
        column, kind = column.dictionary_decode(), kind.value_type
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        return _lists(column)
    if types.is_timestamp(kind) or types.is_duration(kind):
        per_second = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[kind.unit]
        ticks = column.cast(pyarrow.int64())
        return as_floats(ticks.to_numpy(zero_copy_only=False)) / per_second
    if types.is_boolean(kind) and not column.null_count:
        return np.asarray(column.to_numpy(zero_copy_only=False), bool)
    if types.is_decimal(kind) or types.is_boolean(kind):
        column = (
            column.cast(pyarrow.float64())
            if types.is_decimal(kind)
            else column.cast(pyarrow.int8())
        )
    if types.is_string(kind) or types.is_large_string(kind):
        return np.array(["" if text is None else text for text in column.to_pylist()], dtype=object)
    return as_floats(column.to_numpy(zero_copy_only=False))


def _lists(column: PyArray) -> NDArray[np.float64] | None:
    """Return lists of one length as rows; None where they differ or one is absent."""
    if column.null_count:
        return None
    lengths = (
        np.unique(np.asarray(column.value_lengths().to_numpy(zero_copy_only=False)))
        if len(column)
        else [0]
    )
    if len(lengths) != 1 or not 0 < lengths[0] <= MOST_COLUMNS:
        return None
    flat = as_floats(column.flatten().to_numpy(zero_copy_only=False))
    return flat.reshape(len(column), int(lengths[0]))
