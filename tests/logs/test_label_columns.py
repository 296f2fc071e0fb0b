"""Columns of numbers that label the parts of a protocol are found by complete words."""

import numpy as np
import pytest

from softmap_edge.logs.guess import guess_mapping

ROWS = 90
T = np.arange(ROWS) / 30
POINT = np.stack([200 + 30 * np.sin(T), 300 + 20 * np.cos(T), 100 + np.sin(T)], axis=1)


def log(folder, name, values):
    lines = [f"t,tip_x,tip_y,tip_z,{name}"]
    for t, point, value in zip(T, POINT, values):
        lines.append(",".join([f"{t:.3f}", *(f"{x:.3f}" for x in point), f"{value:g}"]))
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return folder / "log.csv"


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("bodyparts", np.arange(ROWS)),
        ("bodyparts.coords", np.arange(ROWS) // 9),
        ("particles", np.arange(ROWS) // 30),
        ("partial_count", np.arange(ROWS) // 30),
        ("unblocked", np.arange(ROWS) // 30),
        ("trial_ms", np.arange(ROWS)),
        ("part", np.arange(ROWS)),  # as many values as rows
        ("trial_valid", np.arange(ROWS) % 2),
    ],
)
def test_counters_and_parts_of_words_are_no_labels(tmp_path, name, values):
    assert "\nblock =" not in guess_mapping([log(tmp_path, name, values)]).text


@pytest.mark.parametrize(
    "name", ["block", "Trial", "trial_no", "TrialNumber", "blockid", "Phase_2", "part", "segments"]
)
def test_labels_of_complete_words_stay_labels(tmp_path, name):
    text = guess_mapping([log(tmp_path, name, np.arange(ROWS) // 30)]).text
    assert f'\nblock = "{name}"' in text


def test_the_frame_counter_of_a_pose_estimator_is_no_label(tmp_path):
    parts = ("base", "mid", "tip")
    lines = [
        ",".join(["scorer", *(["net"] * 9)]),
        ",".join(["bodyparts", *(part for part in parts for _ in range(3))]),
        ",".join(["coords", *(["x", "y", "likelihood"] * 3)]),
    ]
    for k, (x, y, _) in enumerate(POINT):
        cells = [f"{z:.3f}" for j in range(3) for z in (x + 50 * j, y, 0.9 + 0.01 * (k % 9))]
        lines.append(",".join([str(k), *cells]))
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    found = guess_mapping([tmp_path / "log.csv"])
    assert "\nblock =" not in found.text and "markers = {" in found.text
    assert any("are likelihoods, not coordinates" in line for line in found.assumed)
