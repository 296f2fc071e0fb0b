"""Write files completely or not at all: first next to their place, then moved there."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from softmap_edge.errors import SoftmapError

Document = dict[str, Any]  # content of a JSON or TOML file

MOST_TEXT = 64 << 20  # bytes of a document at most


def write_atomically(path: str | Path, content: str | bytes) -> None:
    """Write text or bytes to `path`, replacing it only when complete.

    Text is UTF-8; characters that it cannot encode become `?`.
    """
    with replacement_of(Path(path)) as partial:
        partial.write_bytes(
            content if isinstance(content, bytes) else content.encode("utf-8", "replace")
        )


@contextmanager
def replacement_of(file: Path) -> Iterator[Path]:
    """Yield a new file next to `file` to write into.

    It replaces `file` once complete, and is deleted on failure.
    """
    try:
        descriptor, name = tempfile.mkstemp(prefix=f".{file.name}.", dir=file.parent)
    except OSError as error:
        raise type(error)(error.errno, error.strerror, str(file)) from None
    os.close(descriptor)
    partial = Path(name)
    try:
        yield partial
        mask = os.umask(0)
        os.umask(mask)
        partial.chmod(0o666 & ~mask)
        partial.replace(file)
    finally:
        partial.unlink(missing_ok=True)


def read_document(path: str | Path, error: type[SoftmapError] = SoftmapError) -> str:
    """Return a document's text; raise `error` if it is not a text file or too large."""
    file = Path(path)
    if file.exists() and not file.is_file():
        raise error(f"{path}: no file; give a document")
    if file.exists() and file.stat().st_size > MOST_TEXT:
        raise error(
            f"{path}: {file.stat().st_size >> 20} MB, documents of up to {MOST_TEXT >> 20} MB are "
            "read"
        )
    return file.read_text(encoding="utf-8")
