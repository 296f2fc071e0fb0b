"""Where a verb may write, asked before the work and not after it."""

from __future__ import annotations

from pathlib import Path

from softmap_edge.bundle import check_folder
from softmap_edge.errors import SoftmapError


def check_file(option: str, path: str | None, suffix: str = "") -> None:
    """Raise SoftmapError when the file that `option` names cannot be written, or does not end in `suffix`."""
    if path is None:
        return
    file = Path(path)
    if suffix and file.suffix != suffix:
        raise SoftmapError(f"{option} {path}: it is saved as {suffix}; give a name that ends so")
    if file.is_dir():
        raise SoftmapError(f"{option} {path}: a folder; give the name of a file")
    if not file.parent.is_dir():
        raise SoftmapError(f"{option} {path}: there is no folder {file.parent}; make it first")


def check_bundle(path: str) -> None:
    """Raise BundleError when no bundle can be written at `path`."""
    check_folder(Path(path))
