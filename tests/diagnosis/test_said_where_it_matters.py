"""A plane of markers, short blocks and channels that move one at a time are reported by check,
learn and compare.
"""

from dataclasses import replace

import numpy as np
import pytest
from recorded_arms import arc, recorded, wander

from softmap_edge import Run, diagnose, learn_model, save_bundle
from softmap_edge.checks.advice import advice
from softmap_edge.cli import main
from softmap_edge.model.coverage import apart
from softmap_edge.model.training_range import command_extrapolation
from softmap_edge.run.plane import plane_of


def run_of(u, t, noise=0.1, **more):
    seen = arc(u if u.shape[1] == 2 else np.c_[u, 0 * u][:, :2])[::2]
    seen = seen + np.random.default_rng(0).normal(0, noise, seen.shape)
    return Run(t=t, command=u, t_seen=t[::2], markers=seen, **more)


def words(run, about):
    return [word.text for word in advice(run, 3) if word.about == about and not word.tells]


def notes(run, **options):
    return learn_model(run, static=True, **options).made_from["notes"]


# --- a plane ------------------------------------------------------------------------------------
def planar(axis=1, at=0.0, turn=None):
    """An arm of one channel that bends in a plane; the coordinate across is a constant."""
    t = np.arange(0.0, 60.0, 0.05)
    run = run_of(np.stack([9.0 * np.sin(0.8 * t)], axis=1), t)
    seen = np.array(run.markers)
    seen[..., 1] = at
    seen = np.roll(seen, axis - 1, axis=2)
    return replace(run, markers=seen if turn is None else seen @ turn.T)


TURN = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
PLANES = {
    "xz": (planar(), "xz plane through the origin"),
    "xy": (planar(2), "set frame.axes"),
    "beside": (planar(at=12.5), "xz plane 12.5 mm from the origin"),
    "turned": (planar(turn=TURN), "one plane through the origin"),
}


@pytest.mark.parametrize(("run", "reported"), PLANES.values(), ids=PLANES)
def test_a_plane_of_markers_is_reported_by_check_learn_and_compare(run, reported, tmp_path, capsys):
    assert any(reported in text for text in words(run, "markers"))
    found = notes(run)
    assert any(reported in note and "no effect across it" in note for note in found)
    run.save(tmp_path / "run.npz")
    save_bundle(learn_model(run, static=True), tmp_path / "b")
    assert main(["compare", str(tmp_path / "run.npz"), "--bundle", str(tmp_path / "b")]) == 0
    assert reported in capsys.readouterr().err


def test_points_in_space_and_outputs_lie_in_no_plane():
    flat = planar()
    noisy = replace(
        flat, markers=flat.markers + np.random.default_rng(1).normal(0, 0.01, flat.markers.shape)
    )
    one_channel = run_of(
        np.stack([9.0 * np.sin(np.arange(0, 60, 0.05))], axis=1), np.arange(0, 60, 0.05)
    )
    for run in (noisy, one_channel, recorded(seconds=20.0), Run(t=np.arange(3.0))):
        assert plane_of(run) is None
    line = replace(flat, markers=flat.markers * [0.0, 0.0, 1.0])
    assert plane_of(line) is None  # a line has its own sentence
    half = np.zeros((flat.frames, 3), bool)
    half[:, :2] = True
    assert (
        plane_of(
            replace(flat, markers=np.where(half[..., None], flat.markers, np.nan), visible=half)
        )
        is not None
    )
    t = np.arange(60) * 0.1
    outputs = Run.of_outputs(
        np.stack([np.sin(t), np.cos(t)], axis=1), "N", t_seen=t, t=t, command=np.sin(t)[:, None]
    )
    assert plane_of(outputs) is None


# --- blocks -------------------------------------------------------------------------------------
def test_blocks_shorter_than_the_gap_are_reported_by_check_learn_and_diagnose():
    t = np.arange(0.0, 40.0, 0.05)
    run = run_of(wander(t, 9.0), t)
    count = run.frames
    short = replace(run, block=np.arange(count) // 4 % 20)  # 20 labels that change every 0.4 s
    long = replace(run, block=np.arange(count) // 80)
    brief = run_of(wander(t[:50], 9.0), t[:50])
    # too few labels: spans of time
    alternate = replace(run, block=np.where(np.arange(count) // 3 % 2, "a", "b"))
    assert any("no gap of 1 s" in text for text in words(short, "folds"))
    assert any("no gap of 1 s" in text for text in words(brief, "folds"))
    assert not words(long, "folds") and not words(run, "folds") and not words(alternate, "folds")
    found = diagnose(
        learn_model(run, static=True),
        replace(short, markers=short.markers + 0.01),
        effects=["offset"],
    )
    assert any("no gap of 1 s" in remark for remark in found.remarks)
    assert any("short for the gap of 2 s" in note for note in notes(brief))
    assert not any("short for the gap" in note for note in [*notes(run), *notes(brief, gap_s=0.1)])


# --- one channel at a time ----------------------------------------------------------------------
def alone(channels, low=-1.0):
    """Each channel goes to its ends and back while the others rest."""
    up = np.sin(np.linspace(0, np.pi, 150)) * 9.0
    one = np.r_[up, low * up] if low else np.r_[up, up]
    u = np.zeros((channels * len(one), channels))
    for c in range(channels):
        u[c * len(one) : (c + 1) * len(one), c] = one
    return u


def together(channels):
    t = np.arange(0, 90, 0.1)
    return np.stack([9 * np.sin((0.5 + 0.17 * c) * t + c) for c in range(channels)], axis=1)


@pytest.mark.parametrize(("channels", "low"), [(2, -1.0), (3, -1.0), (2, 0.0), (4, -0.4)])
def test_channels_moved_one_at_a_time_are_found_by_leverage(channels, low):
    pairs = [(i, j) for i in range(channels) for j in range(i + 1, channels)]
    assert apart(alone(channels, low)) == pairs
    assert apart(together(channels)) == []
    t = np.arange(0, 90, 0.1)
    circle = np.stack([9 * np.sin(t), 9 * np.cos(t)], axis=1)
    assert apart(circle) == apart(circle[:, :1]) == []
    assert apart(np.c_[circle, 0 * t]) == []  # a channel that never moves has its own sentence
    half = np.concatenate([alone(3), np.c_[circle, 0 * t]])
    assert apart(half) == [(0, 2), (1, 2)]
    assert apart(2048 + 100 * alone(2)) == [(0, 1)]  # ticks, home in the middle


def test_a_reference_of_one_axis_at_a_time_is_reported_by_check_learn_and_compare():
    u = alone(2)
    t = np.arange(len(u)) * 0.05
    run = run_of(u, t)
    assert any("0 and 1 are never far from home at once" in text for text in words(run, "together"))
    assert not words(run_of(together(2), np.arange(900) * 0.05), "together")
    model = learn_model(run, static=True)
    assert any("commands 1 and 2 are never far" in note for note in model.made_from["notes"])
    corner = run_of(
        np.tile([[7.0, 7.0]], (40, 1)) * np.linspace(0.9, 1.0, 40)[:, None], np.arange(40) * 0.05
    )
    (reported,) = command_extrapolation(model, corner)
    assert (
        "each channel stays within its range, but they were never moved together like this"
        in reported
    )
    assert command_extrapolation(model, run) == []
