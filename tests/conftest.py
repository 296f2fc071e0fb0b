"""One thread for BLAS, as the command sets it, and for torch: small work is slower with more."""

import os
from itertools import zip_longest

import pytest

for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

# One worker a file: those that take long begin first, so that none is left to one worker at the end.
# Those that wait for a robot and those that compute take turns.
# fmt: off
WAIT = [
    "set_up", "servo_remedies", "presence", "faults", "move", "servo_verbs", "teleop_page",
    "known_state", "controller", "track", "reboot", "home", "pull", "conditions", "calibrate_rig",
    "nobody_watches", "emulated_finger", "teleop_drive", "record_robot", "record_cut",
    "landmarker", "teleop_verb", "live", "emergency",
]
COMPUTE = [
    "learned_memory", "simple_robots", "diagnosis", "two_levels", "mutated_containers", "bad_runs",
    "report_page", "elsewhere", "next_experiment", "residual", "mutated_files", "decision",
    "calibration", "strange_names", "mutated_shapes", "mutated_logs", "advice", "cli_words",
    "remedies", "jitter", "remembered", "taught", "rod", "baselines", "elastic", "leverage",
    "evaluate", "hidden_effects", "adaptation", "bank", "residual_network", "training_page",
    "three_tendons", "truth", "registration_page", "readme", "second_level", "refit_finger",
    "tdcr", "design_fields",
]
# fmt: on
FIRST = [f"test_{name}" for pair in zip_longest(WAIT, COMPUTE) for name in pair if name]


def pytest_collection_modifyitems(items):
    place = {name: k for k, name in enumerate(FIRST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))


@pytest.fixture(autouse=True)
def folder_is_left_as_it_was():
    """Restore the working folder after each test: the next test of the worker would begin there."""
    before = os.getcwd()
    yield
    left = os.getcwd()
    os.chdir(before)
    assert left == before, f"left in {left}"
