"""The model of hands for tests, built from mediapipe's wheel 0.10.18, downloaded once into the
user's cache.
"""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from softmap_edge.errors import TeleopError
from softmap_edge.robot.teleop.model_file import KNOWN, WHEEL, check_model, fetch_model
from softmap_edge.robot.teleop.requirements import libraries, processor

CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "softmap-tests"


def hand_model(tmp):
    """Return the path of the task file; without PyPI, or where mediapipe cannot run, the test is
    skipped.
    """
    for need in (libraries(), processor()):
        if not need.fine:
            pytest.skip(f"not run: {need.name}: {need.found}")
    task = CACHE / "hand_landmarker.task"
    try:
        if check_model(task).sha256 in KNOWN:
            return task
    except TeleopError:
        pass  # not there yet, or damaged
    words = [
        sys.executable,
        "-m",
        *shlex.split(WHEEL),
        "--quiet",
        "--disable-pip-version-check",
        "--dest",
        str(tmp),
    ]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
    if done.returncode:
        pytest.skip(
            "not run: the wheel of mediapipe cannot be had from PyPI "
            f"({done.stderr.strip()[-200:]})"
        )
    (wheel,) = Path(tmp).glob("mediapipe-0.10.18-*.whl")
    return fetch_model(wheel, task, force=True).path
