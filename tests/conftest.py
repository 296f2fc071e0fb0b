"""One thread for BLAS, as the command sets it, and for torch: small work is slower with more."""

import os

import pytest

for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

# One worker a file: the long ones begin first, so that none is left to one worker at the end; those
# that compute and those that wait for a robot (track, record, servo, move, teleop, faults) take
# turns.
LONG = [
    "test_hidden_effects",
    "test_track",
    "test_adaptation",
    "test_bank",
    "test_record_robot",
    "test_residual_network",
    "test_training_page",
    "test_servo_verbs",
    "test_three_tendons",
    "test_record_cut",
    "test_truth",
    "test_teleop_page",
    "test_evaluate",
    "test_move",
    "test_registration_page",
    "test_readme",
    "test_faults",
    "test_calibration",
    "test_diagnosis",
    "test_commission_page",
    "test_mutated_files",
    "test_benches",
    "test_controller",
    "test_second_level",
    "test_pull",
    "test_refit_finger",
    "test_tdcr",
    "test_baselines",
    "test_design_fields",
]


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: LONG.index(item.path.stem) if item.path.stem in LONG else len(LONG))


@pytest.fixture(autouse=True)
def folder_is_left_as_it_was():
    """Restore the working folder after each test: the next test of the worker would begin there."""
    before = os.getcwd()
    yield
    left = os.getcwd()
    os.chdir(before)
    assert left == before, f"left in {left}"
