"""Ctrl-C during long work: the command stops within a second or so, says so in one line, and leaves no half file."""

import os
import signal
import subprocess
import sys
import time

import pytest

STOPPED = 2.0  # s after the signal, on a busy machine; the work itself takes minutes
STARTED = 1.5  # s of solving before the signal: within the first column of the sweep


def softmap(*argv):
    # A shell starts what it puts in the background with SIGINT ignored, and children inherit that.
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from softmap_edge.cli import main; print('up', flush=True); sys.exit(main())"
    )
    return subprocess.Popen(
        [sys.executable, "-c", code, *argv], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.parametrize("verb", ["build", "sweep"])
def test_ctrl_c_stops_the_first_column_at_once(verb, tmp_path):
    with softmap(verb, "--steps", "201", "--out", str(tmp_path / "out.npz")) as process:
        try:
            assert process.stdout.readline() == "up\n"
            time.sleep(STARTED)
            assert process.poll() is None  # it is at work
            os.kill(process.pid, signal.SIGINT)
            start = time.monotonic()
            _, said = process.communicate(timeout=60)
        finally:
            process.kill()
    assert time.monotonic() - start < STOPPED
    assert process.returncode == 130
    assert said == f"softmap {verb}: interrupted\n"
    assert not list(tmp_path.iterdir())
