"""Act as an ordinary user: a child of root gives its rights away first, for root may open what
others may not.
"""

import os
import warnings

import pytest

from softmap_edge.errors import ServoError

NOBODY = 65534


def as_ordinary_user(what):
    """Return what `what()` says (`said`) to somebody who is not root."""
    if os.geteuid() != 0:
        return said(what)
    mine, theirs = os.pipe()
    with warnings.catch_warnings():
        # The child asks one thing and never returns, so that other threads of this process matter
        # not.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        text, code = "", 1
        try:
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
            text, code = said(what), 0
        finally:
            os.write(theirs, text.encode())
            os._exit(code)
    os.close(theirs)
    with open(mine, encoding="utf-8") as pipe:
        text = pipe.read()
    if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0:
        pytest.skip("this system lets no process become an ordinary user")
    return text


def said(what):
    """Return the text that `what()` returns or the ServoError that it raises; "" where it is
    neither.
    """
    try:
        found = what()
    except ServoError as fault:
        return str(fault)
    return found if isinstance(found, str) else ""
