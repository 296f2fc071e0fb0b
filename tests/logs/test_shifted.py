"""A list of markers that gets shorter when one is lost: identities shift, and columns show their
neighbours.
"""

import numpy as np
import pytest
from recordings import POSES, write_mcap

from softmap_edge.checks.lost_points import lost_points
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.logs.shifted import find_shifted
from softmap_edge.run.run import Run

K = 300
T = np.arange(K) * 0.02


def markers(count=5, noise=0.05, seed=0, digits=None):
    """Markers (K, M, 3) mm up a finger that bends."""
    rng = np.random.default_rng(seed)
    s = np.linspace(1 / count, 1, count)
    points = np.stack(
        [np.c_[30 * a**2 * np.sin(T), 10 * a**2 * np.cos(T), 100 * a + 0 * T] for a in s], axis=1
    )
    points = points + noise * rng.normal(size=points.shape)
    return points if digits is None else np.round(points, digits)


def listed(points, lost):
    """What a tracker without labels writes: the markers that it sees, one after the other; and
    which they are.
    """
    rows, shows = (
        np.full_like(points, np.nan),
        np.tile(np.arange(points.shape[1]), (len(points), 1)),
    )
    for k in range(len(points)):
        seen = np.flatnonzero(~lost[k])
        rows[k, : len(seen)], shows[k, : len(seen)] = points[k, seen], seen
    return rows, shows


def stretches(*parts, count=5):
    lost = np.zeros((K, count), bool)
    for marker, first, end in parts:
        lost[first:end, marker] = True
    return lost


LOST = {
    "one": stretches((1, 50, 80)),
    "the first": stretches((0, 50, 80)),
    "two one after the other": stretches((1, 50, 80), (3, 100, 130)),
    "two at once": stretches((1, 50, 80), (3, 60, 70)),
    "one returns as another goes": stretches((1, 50, 80), (3, 80, 110)),
    "from the beginning": stretches((2, 0, 40)),
    "to the end": stretches((0, 250, K)),
    "here and there": np.random.default_rng(1).random((K, 5)) < 0.05,
}


@pytest.mark.parametrize("name", list(LOST))
def test_columns_that_show_a_neighbour_are_found_and_mended(name):
    points, lost = markers(), LOST[name]
    rows, shows = listed(points, lost)
    found = find_shifted(rows)
    assert np.array_equal(
        found.shows[np.isfinite(rows).all(axis=2)], shows[np.isfinite(rows).all(axis=2)]
    )
    assert np.array_equal(
        found.mended(rows), np.where(lost[..., None], np.nan, points), equal_nan=True
    )


@pytest.mark.parametrize("count", [2, 3, 12])
def test_lists_of_any_length(count):
    points = markers(count)
    rows, shows = listed(points, stretches((0, 100, 150), count=count))
    assert np.array_equal(
        find_shifted(rows).wrong, (shows != np.arange(count)) & np.isfinite(rows).all(axis=2)
    )


def test_columns_that_keep_their_markers_stay():
    points = markers()
    assert find_shifted(points) is None
    for lost in LOST.values():  # empty cells where the marker is lost
        assert find_shifted(np.where(lost[..., None], np.nan, points)) is None
    # the tip, and it is last
    assert find_shifted(np.where(stretches((4, 50, 90))[..., None], np.nan, points)) is None
    assert find_shifted(markers(1)) is None and find_shifted(np.full((K, 5, 3), np.nan)) is None


def test_markers_that_move_too_far_between_frames_are_not_checked():
    points = markers()[::60]
    rows, _ = listed(points, np.arange(len(points))[:, None] % 2 * (np.arange(5) == 1) > 0)
    found = find_shifted(rows + 80 * np.random.default_rng(0).normal(size=(len(rows), 1, 3)))
    assert found is None or found.wrong.sum() <= 8


def repeated_last(points, lost):
    """A list whose empty cells repeat its last place."""
    rows, shows = listed(points, lost)
    for k in range(len(rows)):
        n = int((~lost[k]).sum())
        rows[k, n:] = rows[k, n - 1]
    return rows, shows


def empty_first(points, lost):
    """A list whose empty cells come first."""
    rows, shows = listed(points[:, ::-1], lost[:, ::-1])
    return rows[:, ::-1], points.shape[1] - 1 - shows[:, ::-1]


@pytest.mark.parametrize("name", list(LOST))
@pytest.mark.parametrize("make", [repeated_last, empty_first])
@pytest.mark.parametrize("count", [2, 4, 5])
def test_other_lists_that_get_shorter(make, name, count):
    points, lost = markers(count, digits=3), LOST[name][:, :count]
    lost[lost.all(axis=1)] = False
    if not lost.any():
        return
    rows, _ = make(points, lost)
    right = (rows == points).all(axis=2)
    found = find_shifted(rows)
    wrong = np.isfinite(rows).all(axis=2) & ~right
    assert (found is not None) == wrong.any()
    if found is not None:
        assert np.array_equal(found.wrong & np.isfinite(rows).all(axis=2), wrong)
        assert np.array_equal(
            found.mended(rows), np.where(lost[..., None], np.nan, points), equal_nan=True
        )


@pytest.mark.parametrize("pair", [(2, 3), (3, 2), (0, 4), (4, 0), (1, 0)])
@pytest.mark.parametrize("rows", [np.s_[50:90], np.s_[::7], np.s_[:30], np.s_[100:101]])
def test_two_markers_at_one_place_are_one_measurement(pair, rows):
    points = markers(digits=3)
    lost, other = pair
    merged = points.copy()
    merged[rows, lost] = merged[rows, other]
    found = find_shifted(merged)
    expected = np.zeros((K, 5), bool)
    expected[rows, lost] = True
    assert np.array_equal(found.wrong, expected) or (
        rows == np.s_[:30] and found.wrong[:30, list(pair)].any(axis=1).all()
    )
    (line,) = found.lines("abcde", "")
    assert (
        f"{expected.any(axis=1).sum()} of 300 frames give two markers one place" in line
        and "abcde"[lost] in line
    )


def test_markers_that_are_always_at_one_place():
    points = markers(digits=3)
    points[:, 3] = points[:, 2]
    assert find_shifted(points).wrong.sum(axis=0).tolist() == [0, 0, 0, K, 0]


def test_markers_that_round_to_one_place_stay():
    """Coarse digits, a resting finger, a plane, and a marker at the origin."""
    near = markers(12, digits=0)
    near[:, 1] = np.round(near[:, 0] + np.random.default_rng(0).normal(size=(K, 3)) * 0.5)
    assert (near[:, 0] == near[:, 1]).all(axis=1).any() and find_shifted(near) is None
    for digits in (0, 1, 3):
        rest = np.repeat(markers(digits=digits)[:1], K, axis=0)
        plane = markers(digits=digits)
        plane[..., 1] = 0.0
        base = np.concatenate([np.zeros((K, 1, 3)), markers(digits=digits)], axis=1)
        assert find_shifted(rest) is find_shifted(plane) is find_shifted(base) is None


def written(folder, rows, fill):
    names = [f"m{k}" for k in range(rows.shape[1])]
    lines = [",".join(["t", "u", *(f"{n}_{axis}" for n in names for axis in "xyz")])]
    for t, row in zip(T, rows.reshape(len(rows), -1)):
        cells = [fill if np.isnan(x) else f"{x:.3f}" for x in row]
        lines.append(",".join([f"{t:.2f}", f"{np.sin(t):.4f}", *cells]))
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return folder / "log.csv"


def mapped(folder, columns, keys="", head='time = { column = "t" }\ncommand = { columns = ["u"] }'):
    text = f'schema = "softmap.mapping/1"\n[[log]]\n{head}\nmarkers = {{ {keys}columns = {columns} }}\n'
    (folder / "map.toml").write_text(text.replace("'", '"'))
    return read_mapping(folder / "map.toml")


COLUMNS = [[f"m{k}_{axis}" for axis in "xyz"] for k in range(5)]


@pytest.mark.parametrize("fill", ["", "0.000", "nan"])
def test_an_import_sets_them_aside_or_mends_them(tmp_path, fill):
    points, lost = markers(), LOST["one"]
    rows, shows = listed(points, lost)
    log = written(tmp_path, rows, fill)
    done = import_logs([log], mapped(tmp_path, COLUMNS))
    right = np.isfinite(rows).all(axis=2) & (shows == np.arange(5))
    assert np.array_equal(done.run.visible, right)
    assert any(
        "30 of 300 frames list fewer markers" in doubt and "m1, m2, m3" in doubt
        for doubt in done.doubts
    )
    mended = import_logs([log], mapped(tmp_path, COLUMNS, 'swaps = "mend", '))
    assert np.array_equal(mended.run.visible, ~lost)
    assert mended.run.markers[~lost] == pytest.approx(points[~lost], abs=1e-3)
    kept = import_logs([log], mapped(tmp_path, COLUMNS, 'not_seen = "keep", '))
    assert not any("list fewer" in line for line in (*kept.notes, *kept.doubts))


def test_a_list_of_poses_in_a_recording(tmp_path):
    points, lost = markers(3), LOST["one"][:, :3]
    turn = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    messages = []
    for k, t in enumerate(T):
        poses = [
            {"position": dict(zip("xyz", map(float, place))), "orientation": turn}
            for place in points[k, ~lost[k]]
        ]
        stamp = {"sec": int(t), "nanosec": int(round(t % 1 * 1e9))}
        messages.append(
            (
                "/markers",
                POSES,
                {"header": {"stamp": stamp, "frame_id": ""}, "poses": poses},
                float(t),
            )
        )
    log = write_mcap(tmp_path / "log.mcap", messages)
    columns = [[f"poses[{k}].position.{axis}" for axis in "xyz"] for k in range(3)]
    done = import_logs([log], mapped(tmp_path, columns, head='time = { column = "time" }'))
    assert not done.run.visible[50:80, 1:].any() and done.run.visible[50:80, 0].all()
    assert any("list fewer markers" in doubt for doubt in done.doubts)


def test_a_run_of_other_origin_is_looked_at():
    rows, shows = listed(markers(), LOST["one"])
    run = Run(t=T, t_seen=T, markers=np.nan_to_num(rows), visible=np.isfinite(rows).all(axis=2))
    mask, (line,) = lost_points(run)
    assert (
        np.array_equal(mask, (shows != np.arange(5)) & run.visible) and "list fewer markers" in line
    )
