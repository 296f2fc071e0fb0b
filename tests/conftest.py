"""One BLAS thread, as the command sets it: small factorisations are ten times slower with more."""

import os

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# One worker a file: the long ones begin first, so that none is left to one worker at the end.
LONG = [
    "test_hidden_effects", "test_three_tendons", "test_truth", "test_demo", "test_readme", "test_diagnosis",
    "test_bank", "test_refit_finger", "test_mutated_files", "test_tdcr", "test_trunk", "test_own_effect_page",
    "test_design_fields", "test_faults", "test_record_robot",
]  # fmt: skip


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: LONG.index(item.path.stem) if item.path.stem in LONG else len(LONG))


@pytest.fixture(autouse=True)
def folder_is_left_as_it_was():
    """Whoever goes to another folder comes back: the next test of the worker would begin there."""
    before = os.getcwd()
    yield
    left = os.getcwd()
    os.chdir(before)
    assert left == before, f"left in {left}"
