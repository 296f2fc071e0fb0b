"""Files that are there whole or not at all: written beside their place, then moved there."""

from __future__ import annotations

from pathlib import Path


def write_whole(path: str | Path, content: str | bytes) -> None:
    """Write text (UTF-8; what has no such form as `?`) or bytes to `path`, replacing it only when complete."""
    file = Path(path)
    partial = file.with_name(file.name + ".part")
    partial.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "replace"))
    partial.replace(file)
