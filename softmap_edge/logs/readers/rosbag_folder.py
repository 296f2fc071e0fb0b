"""Find the files of a recording folder: rosbag2 with `metadata.yaml`, or a LeRobot dataset.

From metadata.yaml only the names in the list of files are read; paths out of the folder are not
followed. Without metadata.yaml, as after an interrupted recording, all recordings in the folder are
its files.
"""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from pathlib import Path

from softmap_edge.errors import RunError
from softmap_edge.files.printable import listed
from softmap_edge.logs.lerobot import dataset_files, is_dataset

METADATA = "metadata.yaml"
_ENDINGS = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd", ".mcap.zst", ".db3.zst")
_KEY = re.compile(r"^(?P<indent> *)relative_file_paths:[ \t]*(?P<rest>.*)$", re.MULTILINE)
_ITEM = re.compile(r"^(?P<indent> *)-[ \t]+(?P<item>\S.*?)[ \t]*$")
_MOST = 10_000  # entries of a folder
_LONGEST = 2**24  # bytes of a metadata.yaml that are read


@dataclass(frozen=True)
class Folder:
    """The files of a recording, and remarks on them."""

    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()


def files_of(folder: Path) -> Folder:
    """Return the files of a recording folder.

    Raises:
        RunError: it is not a recording, or a file listed in metadata.yaml is absent.
    """
    if is_dataset(folder):
        return Folder(tuple(dataset_files(folder)))
    inside = _inside(folder)
    recordings = [path for path in inside if path.name.lower().endswith(_ENDINGS)]
    if not (folder / METADATA).is_file():
        if recordings:
            return Folder(
                tuple(recordings),
                (f"{folder.name} has no {METADATA}: the recorder was interrupted, or it is lost",),
            )
        raise RunError(
            f"{folder}: a folder without a recording: {_contents(inside)}; give the path of a log"
        )
    names = named_files(_text(folder / METADATA))
    files = [_present(folder, name) for name in names]
    absent = [name for name, file in zip(names, files) if file is None]
    if absent:
        raise RunError(
            f"{folder}: {METADATA} names {len(names)} files, and {', '.join(absent)[:200]} is not "
            "there; copy it too, or give the files that you have instead of the folder"
        )
    found = [file for file in files if file is not None]
    if not found:
        if not recordings:
            raise RunError(
                f"{folder}: {METADATA} names no files, and no recording is there; copy the folder "
                "again"
            )
        return Folder(
            tuple(recordings), (f"{METADATA} names no files; those of the folder are read",)
        )
    spare = [path.name for path in recordings if path not in found]
    remarks = (f"not named in {METADATA} and left out: {', '.join(spare)[:200]}",) if spare else ()
    return Folder(tuple(dict.fromkeys(found)), remarks)


def named_files(text: str) -> list[str]:
    """Return the names in `relative_file_paths` of a metadata.yaml, without folders."""
    key = _KEY.search(text)
    if key is None:
        return []
    rest = key["rest"].split(" #")[0].strip()
    if rest.startswith("["):  # the short form of a list
        listed = re.findall(
            r"'(?:[^']|'')*'|\"(?:[^\"\\]|\\.)*\"|[^\s,\[\]]+", rest.partition("]")[0]
        )
        return [_name(item) for item in listed]
    names: list[str] = []
    for line in text[key.end() :].splitlines()[1:]:
        item = _ITEM.match(line)
        if item is None or len(item["indent"]) < len(key["indent"]):
            if line.strip() and not line.lstrip().startswith("#"):
                break
            continue
        names.append(_name(item["item"]))
    return [name for name in names if name]


def _name(item: str) -> str:
    """Return a file name from a YAML scalar, plain or quoted, without its folder."""
    if quoted := re.match(r"'((?:[^']|'')*)'", item):
        text = quoted[1].replace("''", "'")
    elif quoted := re.match(r'"(?:[^"\\]|\\.)*"', item):
        try:
            text = str(json.loads(quoted[0]))
        except ValueError:
            text = quoted[0].strip('"')
    else:
        text = item.split(" #")[0].strip()
    return re.split(r"[/\\]", text)[-1]


def _present(folder: Path, name: str) -> Path | None:
    """Return the file with this name, or its packed form."""
    if name in ("", ".", ".."):
        return None
    for ending in ("", ".zstd", ".zst"):
        file = folder / f"{name}{ending}"
        if os.path.isfile(file):  # false for an impossible file name
            return file
    return None


def _text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return file.read(_LONGEST).decode("utf-8", "replace")
    except OSError as cause:
        raise RunError(
            f"{path}: cannot be read ({cause.strerror or cause}); copy the folder again"
        ) from cause


def _inside(folder: Path) -> list[Path]:
    try:
        found = [path for path, _ in zip(folder.iterdir(), range(_MOST))]
    except OSError as cause:
        raise RunError(
            f"{folder}: cannot be read ({cause.strerror or cause}); give the path of a log"
        ) from cause
    return sorted(found)


def _contents(inside: list[Path]) -> str:
    """Return a text on the contents of a folder."""
    bags = [
        path.name
        for path in inside
        if path.is_dir() and ((path / METADATA).is_file() or is_dataset(path))
    ]
    if bags:
        return f"it holds the recordings {', '.join(bags)[:200]}: give one of them"
    names = [path.name for path in inside if path.is_file()]
    if not names:
        return "it holds no files"
    return f"it holds {listed(names, 5, 40)}"
