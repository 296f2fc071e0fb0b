"""Write files and folders that are complete or absent; read texts and numbers of documents."""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeGuard

from softmap_edge.errors import SoftmapError

Document = dict[str, Any]  # content of a JSON or TOML file

_LONGEST_PREFIX = 40  # characters: a name of any allowed length has room for a temporary one
MOST_TEXT = 64 << 20  # bytes of a document at most


def finite(value: object, most: float = sys.float_info.max) -> TypeGuard[float]:
    """Return whether a value of a document is a number within ±`most`.

    True and false are not numbers, though Python counts them as integers. NaN, infinity and an
    integer that no float can hold are not within any limit.
    """
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= most


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

    It replaces `file` once complete, and is deleted on failure. Errors of the system name `file`.
    A folder, a device or a pipe is never replaced.
    """
    with _errors_name(file) as prefix:
        if file.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))
        if file.exists() and not file.is_file():
            raise OSError(errno.EINVAL, "a device or a pipe, not a file", str(file))
        descriptor, name = tempfile.mkstemp(prefix=prefix, dir=file.parent)
        partial = Path(name)
        try:
            os.close(descriptor)
            yield partial
            partial.chmod(0o666 & ~_mask())
            partial.replace(file)
        finally:
            partial.unlink(missing_ok=True)


@contextmanager
def replacement_of_folder(folder: Path) -> Iterator[Path]:
    """Yield a new folder next to `folder` to write into.

    It replaces `folder` once complete, and is deleted on failure; then `folder` stays as it was.
    Errors of the system name `folder`.
    """
    with _errors_name(folder) as prefix:
        if folder.exists() and not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder))
        folder.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=prefix, dir=folder.parent))
        partial, before = work / "new", work / "before"
        try:
            partial.mkdir()
            yield partial
            try:
                if folder.exists():
                    folder.replace(before)
                partial.replace(folder)
            except BaseException:
                if before.exists() and not folder.exists():
                    before.replace(folder)
                raise
        finally:
            shutil.rmtree(work, ignore_errors=True)


@contextmanager
def _errors_name(path: Path) -> Iterator[str]:
    """Yield the start of the names of temporary files; errors of the system name `path` instead."""
    prefix = f".{path.name[:_LONGEST_PREFIX]}."
    try:
        yield prefix
    except OSError as error:
        other = error.filename is not None and prefix not in str(error.filename)
        if error.errno is None or other:
            raise
        words = os.strerror(error.errno) if error.strerror is None else error.strerror
        raise type(error)(error.errno, words, str(path)) from error


def _mask() -> int:
    """Return the rights that new files do not get; temporary files are for their owner alone."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def sha256_of(file: Path) -> str:
    """Return the SHA-256 of a file's bytes, 64 hexadecimal digits."""
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def own_text(path: str | Path, most: int, *, keep_line_ends: bool = False) -> str:
    """Return the text of a file of at most `most` bytes, without its byte order mark.

    Nothing is read of a folder, a device or a pipe: they may be endless.

    Args:
        path: the file.
        most: bytes that are allowed.
        keep_line_ends: leave CR and CR LF as they are; otherwise each becomes a line feed.

    Raises:
        OSError: it cannot be opened, is not a regular file or is too long; `strerror` is the
            reason.
        UnicodeDecodeError: it is not UTF-8.
    """
    file = Path(path)
    if file.exists() and not file.is_file():
        what = "a folder" if file.is_dir() else "not a regular file"
        raise OSError(errno.EINVAL, what, str(file))
    with file.open("rb") as stream:
        content = stream.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"more than {most} bytes", str(file))
    text = content.decode("utf-8-sig")
    return text if keep_line_ends else text.replace("\r\n", "\n").replace("\r", "\n")


def read_document(path: str | Path, error: type[SoftmapError] = SoftmapError) -> str:
    """Return a document's text; raise `error` if it is not a text file or too large."""
    file = Path(path)
    if file.exists() and not file.is_file():
        raise error(f"{path}: not a file; give a document")
    if file.exists() and file.stat().st_size > MOST_TEXT:
        raise error(
            f"{path}: {file.stat().st_size >> 20} MB, documents of up to {MOST_TEXT >> 20} MB are "
            "read"
        )
    return file.read_text(encoding="utf-8-sig")
