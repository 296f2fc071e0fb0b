"""Ports that are busy or forbidden, as an ordinary user meets them: root may open what others may
not.
"""

import os

from ordinary_user import as_ordinary_user, said
from rigs import BAUD, emulated_rig

from softmap_edge import _core


def test_no_permission_says_which_group_to_join():
    with emulated_rig() as (bus, _, _):
        os.chmod(bus.path, 0o000)
        line = as_ordinary_user(lambda: _core.ServoBus(bus.path, BAUD))
        assert line.startswith(f"{bus.path}: no permission") and "usermod -aG dialout" in line
        os.chmod(bus.path, 0o666)
        assert as_ordinary_user(lambda: _core.ServoBus(bus.path, BAUD)) == "", "allowed, it opens"


def test_a_busy_port_is_no_other_user_s():
    with emulated_rig() as (bus, _, _):
        os.chmod(bus.path, 0o666)
        first = _core.ServoBus(bus.path, BAUD)
        line = as_ordinary_user(lambda: _core.ServoBus(bus.path, BAUD))
        assert line == f"{bus.path} is in use by another program; close it first"
        assert said(lambda: _core.ServoBus(bus.path, BAUD)) == line, "nor root's a second time"
        first.close()
        assert as_ordinary_user(lambda: _core.ServoBus(bus.path, BAUD)) == ""
