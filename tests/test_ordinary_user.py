"""Ports that are busy or forbidden, as an ordinary user meets them: root may open what others may not."""

import os
import warnings

import pytest
from rigs import BAUD, bench

from softmap_edge import _core
from softmap_edge.errors import ServoError

NOBODY = 65534


def as_ordinary_user(what):
    """Return what a ServoError of `what()` says to somebody who is not root; "" if there is none."""
    if os.geteuid() != 0:
        return said(what)
    mine, theirs = os.pipe()
    with warnings.catch_warnings():
        # The child calls compiled code alone and never returns, so that other threads of this process matter not.
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
    """Return what a ServoError of `what()` says."""
    try:
        what()
    except ServoError as fault:
        return str(fault)
    return ""


def test_no_permission_says_which_group_to_join():
    with bench() as (bus, _, _):
        os.chmod(bus.path, 0o000)
        line = as_ordinary_user(lambda: _core.ServoBus(bus.path, BAUD))
        assert line.startswith(f"{bus.path}: no permission") and "usermod -aG dialout" in line
        os.chmod(bus.path, 0o666)
        assert as_ordinary_user(lambda: _core.ServoBus(bus.path, BAUD)) == "", "allowed, it opens"


def test_a_busy_port_is_no_other_user_s():
    with bench() as (bus, _, _):
        os.chmod(bus.path, 0o666)
        first = _core.ServoBus(bus.path, BAUD)
        line = as_ordinary_user(lambda: _core.ServoBus(bus.path, BAUD))
        assert line == f"{bus.path} is in use by another program; close it first"
        assert said(lambda: _core.ServoBus(bus.path, BAUD)) == line, "nor root's a second time"
        first.close()
        assert as_ordinary_user(lambda: _core.ServoBus(bus.path, BAUD)) == ""
