"""Shared output of commands: checks of output paths, and the next command to type."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from softmap_edge.errors import BundleError, SoftmapError
from softmap_edge.files.npz import archive_names
from softmap_edge.files.printable import shell_file
from softmap_edge.model.bundle import check_folder
from softmap_edge.robot.remedies import filled


class JsonOption(Protocol):
    """Options that every command has."""

    @property
    def json(self) -> bool: ...


def next_command(*words: str | None, bundle: str | None = None) -> str:
    """Return the last line of a command's text: the command to type next.

    Args:
        words: the command without `softmap`, its options by their long names; None is left out.
        bundle: value of `--bundle`, left out for the built-in finger.
    """
    given = [word for word in words if word is not None]
    given += [] if bundle is None else ["--bundle", bundle]
    shown = (word if word.startswith("--") else shell_file(word) for word in given)
    return " ".join(["next: softmap", *shown])


def check_idle(given: Mapping[str, object], why: str) -> None:
    """Raise SoftmapError for the first of these options that has a value: it would do nothing.

    Args:
        given: value of each option by its name; None, False and empty if it was not given
        why: why it does nothing, and what to do
    """
    for option, value in given.items():
        if value is not None and value is not False and value != [] and value != "":
            raise SoftmapError(f"{option}: {why}")


def check_file(option: str, path: str | None, suffix: str = "", *, new: bool = False) -> None:
    """Raise SoftmapError if `option`'s file cannot be written or does not end in `suffix`.

    With `new`, the path must not exist, because its content would be lost.
    """
    if path is None:
        return
    file = Path(path)
    if file.is_dir():
        raise SoftmapError(f"{option} {path}: a folder; give the name of a file")
    if suffix and file.suffix != suffix:
        raise SoftmapError(f"{option} {path}: it is saved as {suffix}; give a name that ends so")
    if not file.parent.is_dir():
        raise SoftmapError(f"{option} {path}: there is no folder {file.parent}; make it first")
    _check_writable(f"{option} {path}", file.parent)
    if new and file.exists():
        raise SoftmapError(f"{option} {path}: it exists; give another name")


def _check_writable(what: str, folder: Path) -> None:
    """Raise SoftmapError if nothing can be written into `folder`, before the work that it costs."""
    if folder.is_dir() and not os.access(folder, os.W_OK):
        raise SoftmapError(f"{what}: nothing can be written into {folder}; give another place")


def check_picture(option: str, path: str | None) -> None:
    """Raise SoftmapError if the picture that `option` names cannot be drawn or written."""
    if path is None:
        return
    from softmap_edge.report.pages import pictures_missing

    check_file(option, path, ".svg")
    if install := pictures_missing():
        raise SoftmapError(
            f"{option} {path}: pictures need matplotlib; {install}, or leave {option} out"
        )


def with_files(text: str, args: object) -> str:
    """Return a message with the rig and the bundle of a command's options, if it has these."""
    rig, bundle = (vars(args).get(name) for name in ("rig", "bundle"))
    return filled(
        text, rig if isinstance(rig, str) else None, bundle if isinstance(bundle, str) else None
    )


def check_no_run(option: str, path: str | None, force: bool | None = None) -> None:
    """Raise SoftmapError if `option` would overwrite a run or recording with another kind of file.

    `force` is that of the command; None if it has none.
    """
    if path is None or force:
        return
    names = archive_names(Path(path))
    if "t.npy" in names and "t_seen.npy" in names:
        way = "remove it" if force is None else "--force to replace it"
        raise SoftmapError(
            f"{option} {path}: a run stands there and would be lost; give another name or {way}"
        )


def check_kept(path: str, what: str, force: bool) -> None:
    """Raise SoftmapError if `path` is a file that users edit and `force` is not set."""
    if Path(path).exists() and not force:
        raise SoftmapError(
            f"--out {path}: {what} stands there already, perhaps with notes of yours; give "
            "another name, or --force to replace it"
        )


def bundle_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the output path of a bundle, the same for every command that writes one."""
    parser.add_argument("--out", required=True, metavar="DIR", help="bundle folder to write")
    parser.add_argument("--force", action="store_true", help="overwrite an existing bundle")


def check_bundle(path: str, force: bool | None, option: str = "--out") -> None:
    """Raise BundleError if no bundle can be written at `path`.

    The path holds something else, or a bundle without `force`. `force` is that of the command; None
    if it has none.
    """
    folder = Path(path)
    check_folder(folder)
    _check_writable(f"{option} {path}", folder.absolute().parent)
    if not force and (folder / "manifest.json").exists():
        way = "remove it" if force is None else "--force to replace it"
        raise BundleError(
            f"{option} {path}: a bundle stands there already; give another name, or {way}"
        )


def to_stderr(line: str) -> None:
    """Print a line while a command runs, to stderr: standard output is for the result."""
    print(line, file=sys.stderr, flush=True)
