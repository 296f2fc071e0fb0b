"""The start after a kill says how the last session ended; one that ended in order says nothing."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rigs import calibration, emulated_rig, torque

from softmap_edge.errors import SessionWarning
from softmap_edge.robot.control import session_mark
from softmap_edge.robot.control.controller import Controller

PROGRAM = """
import sys, time
from rigs import *
from softmap_edge.robot.control import session_mark
from softmap_edge.robot.control.controller import Controller
session_mark.EMULATED = "none"
rig = Rig(sys.argv[1], BAUD, tuple(RigServo(id, MODEL, HOME) for id in (1, 2)))
limits = loop_limits([servo_limits(MODEL, HOME, WINDOW)] * 2, 200.0)
with Controller(rig, calibration(), limits, record=sys.argv[2]) as robot:
    robot.engage()
    print("driving", flush=True)
    while True:
        robot.target([1.0, 1.0])
        time.sleep(0.02)
"""


@pytest.fixture
def marks(tmp_path, monkeypatch):
    """Let emulated benches have marks, in a folder of the test."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(session_mark, "EMULATED", "none")
    return tmp_path / "state" / "softmap"


def gone():
    """Return the id of a process that has ended."""
    done = subprocess.Popen([sys.executable, "-c", ""])
    done.wait()
    return done.pid


def left(marks, **changes):
    """Leave the mark of a session at a port as one that was killed does; return its file."""
    file = session_mark.begin("/dev/ttyTEST", Path("drive.mcap"), gone())
    about = json.loads(file.read_text())
    file.write_text(json.dumps(about | {"pid": gone()} | changes) + "\n")
    return file


def test_the_start_after_a_killed_program_says_so(marks, tmp_path):
    with emulated_rig(200.0) as (bus, rig, limits):
        record = tmp_path / "killed.mcap"
        words = [sys.executable, "-c", PROGRAM, rig.port, str(record)]
        path = os.pathsep.join(
            [str(Path(__file__).parents[1] / "support"), os.environ.get("PYTHONPATH", "")]
        )
        process = subprocess.Popen(
            words, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": path}
        )
        assert process.stdout.readline() == "driving\n"
        process.kill()
        process.wait()
        process.stdout.close()
        until = time.monotonic() + 30.0
        while "released" not in next(marks.iterdir()).read_text():
            assert time.monotonic() < until
            time.sleep(0.05)
        assert not torque(bus)
        said = (
            r"the last session of this rig \(-c, begun .*\) ended without shutting down: "
            r"its program was killed, and "
            r"the control loop released the servos; `softmap servo replay \S*killed.mcap` reads what it recorded"
        )
        with pytest.warns(SessionWarning, match=said), Controller(rig, calibration(), limits):
            pass
        assert not list(marks.iterdir())
        with Controller(rig, calibration(), limits):  # without a warning
            assert len(list(marks.iterdir())) == 1
        assert not list(marks.iterdir())


def test_a_loop_that_is_killed_is_reported_at_once_and_not_again(marks):
    with emulated_rig(200.0) as (_, rig, limits):
        robot = Controller(rig, calibration(), limits)
        robot.__enter__()
        robot._process.kill()
        robot.close()
        with Controller(rig, calibration(), limits):
            pass


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "its program was killed, and its control loop died before it released the servos"),
        ({"loop_pid": 1}, "its control loop still runs: it releases the servos, or it is frozen"),
        ({"boot": "before"}, "the computer stopped or was restarted meanwhile"),
        ({"boot": "before", "pid": 1}, "the computer stopped or was restarted meanwhile"),
        ({"program": "\x1b[2J\nx" + "y" * 500, "record": None}, "was killed"),
    ],
)
def test_how_it_ended_is_one_line(marks, changes, said):
    line = session_mark.last_session(left(marks, **changes))
    assert said in line and line.isprintable() and len(line) < 400
    assert ("drive.mcap" in line) == (changes.get("record", "") is not None)


def test_a_session_that_runs_or_ended_in_order_says_nothing(marks):
    assert session_mark.last_session(left(marks, pid=os.getpid())) is None
    assert session_mark.last_session(left(marks, pid=1, pid_began=session_mark._began(1))) is None
    session_mark.end(left(marks))
    session_mark.report_last("/dev/ttyTEST")


@pytest.mark.parametrize(
    "text", ["", "x", "[]", "{}", "7\n8", '{"pid": "a"}', "\x00" * 100, "[" * 100_000]
)
def test_a_mark_that_is_damaged_stops_no_start(marks, text):
    file = left(marks)
    file.write_text(text)
    session_mark.report_last("/dev/ttyTEST")
    file.unlink()
    file.mkdir()
    session_mark.report_last("/dev/ttyTEST")
    session_mark.begin("/dev/ttyTEST", None, gone())
    session_mark.note_released(str(file))


def test_emulated_robots_have_no_mark(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with emulated_rig(200.0) as (_, rig, limits), Controller(rig, calibration(), limits):
        assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("field", ["pid", "loop_pid"])
def test_another_process_that_got_the_old_id_is_not_taken_for_the_session(marks, field):
    """Ids of processes are used again after a while."""
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as other:
        name = field.removesuffix("_pid") + "_began"
        file = left(marks, **{field: other.pid, name: session_mark._began(other.pid) - 100})
        said = session_mark.last_session(file)
        assert said is not None and "still runs" not in said
        file = left(marks, **{field: other.pid, name: session_mark._began(other.pid)})
        said = session_mark.last_session(file)
        assert said is None if field == "pid" else "still runs" in said
        file = left(marks, **{field: other.pid, name: None})
        assert session_mark.last_session(file) == said, (
            "a mark of an older version counts by its id"
        )
        other.communicate(b"")


def test_when_a_process_began_is_read_behind_any_name(tmp_path):
    odd = tmp_path / "a) 1 2 (b"
    odd.symlink_to("/bin/sleep")
    with subprocess.Popen([str(odd), "5"]) as other:
        with subprocess.Popen(["/bin/sleep", "5"]) as plain:
            assert 0 <= session_mark._began(plain.pid) - session_mark._began(other.pid) < 500
            plain.kill()
        other.kill()
    assert session_mark._began(other.pid) is None
