"""State in plain words what the operating system refused, with the file and the remedy."""

from __future__ import annotations

import errno

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # the file that is written has no room
_ANOTHER = "give another place"
# error number → what is wrong, and the remedy
_WORDS: dict[int, tuple[str, str]] = {
    errno.ENOSPC: ("the disk is full", f"free some space, or {_ANOTHER}"),
    errno.EDQUOT: ("your share of this disk (quota) is used up", f"free some space, or {_ANOTHER}"),
    errno.EFBIG: (
        "it would be larger than the limit for files here",
        "raise the limit (`ulimit -f unlimited`), or give a disk that takes larger files",
    ),
    errno.EROFS: ("the disk is read-only", _ANOTHER),
    errno.EACCES: ("permission denied", "give a path that you may use, or change its permissions"),
    errno.EPERM: ("permission denied", "give a path that you may use, or change its permissions"),
    errno.ENAMETOOLONG: ("the name is too long", "give a shorter one"),
    errno.EISDIR: ("a folder", "give the name of a file"),
    errno.ENOTDIR: ("a part of this path is a file, not a folder", "correct the path"),
    # of a folder that is made: its place is taken
    errno.EEXIST: ("a part of this path is a file, not a folder", "correct the path"),
    errno.ENOENT: ("no such file or folder", "give a path that exists"),
    errno.EIO: ("the disk reports an error", f"check the disk, or {_ANOTHER}"),
    errno.ESTALE: ("the network disk is gone", f"connect it again, or {_ANOTHER}"),
    errno.EMFILE: ("too many files are open", "raise the limit (`ulimit -n`)"),
    errno.EBUSY: ("it is in use", "end the program that uses it"),
}


def refusal(error: OSError, file: object = None) -> str:
    """Return one sentence: the file, what is wrong, and what to do.

    Args:
        error: of the operating system.
        file: the name to show; None for that of the error.
    """
    name = error.filename2 or error.filename if file is None else file
    what, remedy = _WORDS.get(
        error.errno or 0,
        ((error.strerror or str(error) or type(error).__name__).lower(), "give another path"),
    )
    return f"{what}; {remedy}" if name is None else f"{name}: {what}; {remedy}"
