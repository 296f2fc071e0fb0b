"""Ctrl-C during long work: the command stops within a second or so, in one line, and leaves no half
file.
"""

import os
import signal
import subprocess
import time

import numpy as np
import pytest
from command import SOFTMAP, interruptible

from softmap_edge import Run, builtin_model
from softmap_edge.model.user_effect import template
from softmap_edge.run.protocol import standard_protocol

STOPPED = 2.0  # s after the signal, on a busy machine; the work itself takes minutes
STARTED = 1.5  # s of solving before the signal: within the first column of the sweep
REACHED = 4.0  # s until a diagnosis calls its laws


def stop(process, after):
    """Wait for a command to be at work, press Ctrl-C, and return its output before it ended."""
    try:
        assert process.stdout.readline() == "up\n"
        time.sleep(after)
        assert process.poll() is None  # it is at work
        os.kill(process.pid, signal.SIGINT)
        start = time.monotonic()
        _, said = process.communicate(timeout=60)
    finally:
        process.kill()
    assert time.monotonic() - start < STOPPED
    assert process.returncode == 130
    return said


@pytest.mark.parametrize("verb", ["build", "model sweep"])
def test_ctrl_c_stops_the_first_column_at_once(verb, tmp_path):
    with interruptible(
        *verb.split(), "--steps", "201", "--out", str(tmp_path / "out.npz")
    ) as process:
        assert stop(process, STARTED) == f"softmap {verb}: interrupted\n"
    assert not list(tmp_path.iterdir())


def test_a_law_of_a_user_that_never_ends_can_be_stopped(tmp_path):
    """Python looks for signals in its main thread only, and laws run in others."""
    law = (
        template("endless").split("def rollout")[0]
        + "def rollout(params, u, t, ctx):\n    while True:\n        pass\n"
    )
    (tmp_path / "endless.py").write_text(law)
    made, model = standard_protocol(), builtin_model()
    rest = np.repeat(model.rest[None], made.frames, axis=0)
    rest += 0.2 * np.random.default_rng(0).normal(size=rest.shape)
    run = Run(
        t=made.t, command=made.command, t_seen=made.t_seen, gravity=made.gravity, vertices=rest
    )
    run.save(tmp_path / "run.npz")
    argv = ("diagnose", str(tmp_path / "run.npz"), "--effects", str(tmp_path / "endless.py"))
    with interruptible(*argv, "--out", str(tmp_path / "d.json")) as process:
        assert stop(process, REACHED).endswith("softmap diagnose: interrupted\n")
    assert not (tmp_path / "d.json").exists()


def test_an_output_that_was_closed_ends_no_command_with_a_traceback():
    done = subprocess.run(
        f"{SOFTMAP} --version >&- ; {SOFTMAP} doctor --json >&-", shell=True, capture_output=True
    )
    assert b"Traceback" not in done.stderr, done.stderr
