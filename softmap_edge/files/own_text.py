"""Read the texts of this package (mapping, finger, robot, rig, JSON): regular files in UTF-8.

Pinned by tests/files/test_own_text.py.
"""

from __future__ import annotations

import errno
from pathlib import Path


def own_text(path: str | Path, most: int, *, keep_line_ends: bool = False) -> str:
    """Return the text of a file of at most `most` bytes, without its byte order mark.

    Nothing is read of a folder, a device or a pipe: they may be endless.

    Args:
        path: the file.
        most: bytes that are allowed.
        keep_line_ends: leave CR and CR LF as they are; otherwise each becomes a line feed.

    Raises:
        OSError: it cannot be opened, is no regular file or is too long; `strerror` is the reason.
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
