"""Encoders that are read more slowly than they are logged are found, reported and corrected;
stillness is left alone.
"""

import numpy as np
import pytest
from logs import ONE_LOG, imported

from softmap_edge.logs.importer import unhold


def test_unholding_removes_the_lag_of_a_slow_encoder():
    t = np.arange(2000) / 100
    truth = np.column_stack([30 * np.sin(t), 20 * np.cos(0.7 * t)])
    held = truth[(np.arange(2000) // 5) * 5]
    smooth, found = unhold(t, held)
    assert found.hold_s == pytest.approx(0.05) and found.share == pytest.approx(0.8, abs=0.01)
    inside = slice(0, 1995)  # the last hold has no next value
    # the farthest a line over one hold leaves a curve of this acceleration
    chord = 30 * 0.05**2 / 8
    assert np.abs(smooth - truth)[inside].max() <= chord + 1e-12
    assert np.abs(held - truth)[inside].max() > 50 * chord  # doing nothing fails


def test_stillness_stays_and_slow_poses_are_left_alone():
    t = np.arange(1000) / 100
    # still, moves, still for 3 s, moves
    ramp = np.minimum(np.maximum(t - 2, 0), 3.0) + np.maximum(t - 8, 0)
    smooth, found = unhold(t, ramp[(np.arange(1000) // 5) * 5][:, None])
    assert found.hold_s == pytest.approx(0.05)
    assert np.abs(smooth[:, 0] - ramp)[:990].max() <= 0.05 + 1e-9
    for rows in (
        np.repeat(np.arange(20.0), 50)[:, None],
        np.arange(1000.0)[:, None],
        np.zeros((1000, 1)),
    ):
        same, found = unhold(t, rows)
        assert found.hold_s == 0.0 and np.array_equal(same, rows)


def test_channels_read_in_turn_are_unheld_one_by_one():
    """A bus that asks one motor a row: some value is new in every row, and each is six rows old at
    most.
    """
    t = np.arange(3000) / 100
    truth = 30 * np.sin(t[:, None] * [0.7, 0.8, 0.9, 1.0, 1.1, 1.2])
    row = np.arange(3000)[:, None]
    held = np.take_along_axis(truth, row - (row - np.arange(6)) % 6 * (row >= 6), axis=0)
    smooth, found = unhold(t, held)
    assert found.in_turn and found.hold_s == pytest.approx(0.06) and "in turn" in str(found)
    chord = 30 * 1.2**2 * 0.06**2 / 8
    assert np.abs(smooth - truth)[12:2990].max() <= chord + 1e-9
    assert np.abs(held - truth)[12:2990].max() > 20 * chord


def test_a_coarse_encoder_in_slow_motion_is_not_held():
    """Repeats because the value moves less than a tick between rows have no beat."""
    t = np.arange(4000) / 100
    slow = 5 * np.column_stack([np.sin(0.31 * t), np.sin(0.23 * t + 1), np.sin(0.17 * t + 2)])
    ticks = np.rint(slow / 0.088) * 0.088
    assert (np.diff(ticks, axis=0) == 0).mean() > 0.7
    same, found = unhold(t, ticks)
    assert found.hold_s == 0.0 and np.array_equal(same, ticks)


HELD_MAP = ONE_LOG.replace(
    'command = { columns = ["a", "b"] }',
    'command = { columns = ["a"] }\npresent = { columns = ["b"] }',
)


def held_log():
    """A log whose encoder b follows the command a at once, and is read in every fifth row only."""
    t = np.arange(500) / 100
    a = 30 * np.sin(2 * t)
    b = a[(np.arange(500) // 5) * 5]
    points = 0.1 * np.sin(t[:, None] + np.arange(6)) + np.arange(6)
    return "t,a,b,x,y,z,p,q,r\n" + "\n".join(
        ",".join(map(repr, map(float, row))) for row in np.column_stack([t, a, b, points])
    )


def test_the_import_says_what_was_held_and_undoes_it(tmp_path):
    done = imported(tmp_path, held_log(), HELD_MAP)
    assert any(
        "80 % of the rows repeat" in note and "every 50 ms" in note and "un-held" in note
        for note in done.notes
    )
    assert np.abs(done.run.present - done.run.command)[:495].max() < 0.1
    kept = imported(tmp_path, held_log(), HELD_MAP.replace('["b"]', '["b"], held = "keep"'))
    assert np.abs(kept.run.present - kept.run.command)[:495].max() > 2.0 and not any(
        "un-held" in n for n in kept.notes
    )


def test_repeated_frames_are_old_pictures(tmp_path):
    """A camera at 25 Hz in a log at 100 Hz; a still of one second is kept and reported."""
    lines = held_log().splitlines()
    cells = [line.split(",") for line in lines[1:]]
    for k, row in enumerate(cells):
        row[3:] = cells[k - k % 4 if k < 300 or k >= 400 else 300][3:]
    text = "\n".join([lines[0], *(",".join(row) for row in cells)])
    done = imported(tmp_path, text, HELD_MAP)
    assert done.run.frames == 75 + 100 + 25 and np.all(
        np.diff(done.run.markers[:75], axis=0).any(axis=(1, 2))
    )
    assert any("300 frames" in note and "slower than the log" in note for note in done.notes)
    assert any("repeat" in doubt and "0.25 s" in doubt for doubt in done.doubts)
    kept = imported(tmp_path, text, HELD_MAP.replace('unit = "m"', 'unit = "m", held = "keep"'))
    assert kept.run.frames == 500
