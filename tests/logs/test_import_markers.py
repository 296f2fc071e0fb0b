"""Markers by name: those that drop out, exchange their labels or sit on the clamp; labels of the
protocol for folds.
"""

import numpy as np
import pytest
from logs import ONE_LOG, fault, imported, made_log

from softmap_edge.logs.mapping import _label
from softmap_edge.logs.swaps import find_swaps, mend_swaps

NAMES = ("first", "second", "third")
MAP = """schema = "softmap.mapping/1"
[[log]]
block = "part"
time = { column = "t" }
markers = { columns = [["first x", "first y", "first z"], ["second x", "second y", "second z"], \
    ["third x", "third y", "third z"]] }
"""


def chain(frames=400, seed=0):
    """Times and three markers (K, 3, 3) mm, 40 mm apart, that swing by 30 mm; noise 0.05 mm."""
    t = np.arange(frames) / 50
    swing = 30 * np.sin(2 * t)[:, None] * [0.1, 0.4, 1.0]
    points = np.stack([swing, 0 * swing, np.broadcast_to([40.0, 80.0, 120.0], swing.shape)], axis=2)
    return t, points + 0.05 * np.random.default_rng(seed).normal(size=points.shape)


def written(t, points, part=None):
    head = ["t", *(f"{name} {axis}" for name in NAMES for axis in "xyz"), "part"]
    rows = [
        [
            f"{x:.4f}",
            *("" if np.isnan(v) else f"{v:.6f}" for v in row),
            part[k] if part is not None else "all",
        ]
        for k, (x, row) in enumerate(zip(t, points.reshape(len(t), -1)))
    ]
    return "\n".join(",".join(row) for row in [head, *rows])


def exchanged(points, first, last, order):
    """The same points with the labels of the frames from `first` to before `last` exchanged."""
    mixed = points.copy()
    mixed[first:last] = points[first:last][:, list(order)]
    return mixed


def test_a_swap_is_reported_by_name_and_frame_and_left(tmp_path):
    t, points = chain()
    done = imported(tmp_path, written(t, exchanged(points, 100, 180, (0, 2, 1))), MAP)
    assert [
        d
        for d in done.doubts
        if "second and third change places at frame 100 (2 s)" in d and '"mend"' in d
    ]
    assert [d for d in done.doubts if "second and third change places at frame 180 (3.6 s)" in d]
    assert done.run.markers[150, 1, 2] == pytest.approx(120, abs=0.5)


def test_a_swap_is_mended_where_the_mapping_says_so(tmp_path):
    t, points = chain()
    mixed = exchanged(exchanged(points, 100, 180, (0, 2, 1)), 250, 400, (1, 2, 0))
    done = imported(
        tmp_path, written(t, mixed), MAP.replace('"third z"]]', '"third z"]], swaps = "mend"')
    )
    assert done.run.markers == pytest.approx(points, abs=1e-6) and all(
        "without commands" in doubt for doubt in done.doubts
    )
    assert sum("mended" in note for note in done.notes) == 3
    assert any("first, second and third change places at frame 250" in note for note in done.notes)


def test_a_swap_behind_a_short_dropout_is_found(tmp_path):
    t, points = chain()
    mixed = exchanged(points, 200, 400, (1, 0, 2))
    mixed[195:200, :2] = np.nan
    done = imported(
        tmp_path, written(t, mixed), MAP.replace('"third z"]]', '"third z"]], swaps = "mend"')
    )
    seen = done.run.visible
    assert done.run.markers[seen] == pytest.approx(points[seen], abs=1e-6) and (~seen).sum() == 10


@pytest.mark.parametrize("seed", range(5))
def test_markers_that_keep_their_places_are_never_accused(seed):
    t, points = chain(seed=seed)
    assert find_swaps(points, t, NAMES) == []
    # dropouts are no swaps
    points[np.random.default_rng(seed).random(points.shape[:2]) < 0.3] = np.nan
    assert find_swaps(points, t, NAMES) == []
    few = points[::25]  # half a second between frames: each moves as far as the others are
    assert find_swaps(few, t[::25], NAMES) == []


@pytest.mark.parametrize("seed", range(10))
def test_many_swaps_of_many_markers_are_reversed_exactly(seed):
    """Random exchanges of random groups of eight markers, any of them again, with 5 % of the sights
    lost.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(600) / 100
    base = rng.permutation(
        np.stack(np.meshgrid([0, 30.0], [0, 30.0], [40, 80.0]), -1).reshape(8, 3)
    )
    points = base + 2 * np.sin(3 * t)[:, None, None] + 0.05 * rng.normal(size=(600, 8, 3))
    mixed, order, orders = points.copy(), np.arange(8), [tuple(range(8))] * 600
    for frame in np.sort(rng.choice(np.arange(5, 595), 12, replace=False)):
        group = rng.choice(8, rng.integers(2, 5), replace=False)
        order[group] = order[np.roll(group, 1)]
        mixed[frame:] = points[frame:][:, order]
        orders[frame:] = [tuple(order.tolist())] * (600 - frame)
    swaps = find_swaps(mixed, t, tuple("abcdefgh"))
    assert len(swaps) == 12
    mended, first = mend_swaps(mixed, swaps)
    begin = max(dict.fromkeys(orders), key=orders.count)  # what each label shows in most frames
    assert mended == pytest.approx(points[:, list(begin)])
    assert first == (begin == tuple(range(8)))


@pytest.mark.parametrize(
    ("first", "order"), [(1, (1, 0, 2)), (30, (0, 2, 1)), (120, (1, 2, 0)), (199, (1, 0, 2))]
)
def test_a_log_that_begins_with_exchanged_markers_gets_the_names_of_most_frames(
    tmp_path, first, order
):
    t, points = chain()
    mixed = exchanged(points, 0, first, order)
    done = imported(
        tmp_path, written(t, mixed), MAP.replace('"third z"]]', '"third z"]], swaps = "mend"')
    )
    assert done.run.markers == pytest.approx(points, abs=1e-6)
    assert any("names of most of its frames" in note for note in done.notes)


def test_of_two_halves_the_first_gives_the_names(tmp_path):
    t, points = chain()
    mixed = exchanged(points, 200, 400, (1, 0, 2))
    done = imported(
        tmp_path, written(t, mixed), MAP.replace('"third z"]]', '"third z"]], swaps = "mend"')
    )
    assert done.run.markers == pytest.approx(points, abs=1e-6)


def test_dropouts_are_counted_by_name(tmp_path):
    t, points = chain()
    points[::4, 2] = np.nan
    points[7, 0] = np.nan
    done = imported(tmp_path, written(t, points), MAP)
    assert any("third 25.0 %, first 0.2 %" in note for note in done.notes)
    assert done.run.visible.sum() == 1200 - 101


@pytest.mark.parametrize(
    ("x", "label"),
    [
        ("marker_0_x_mm", "marker_0"),
        ("marker_0 x (mm)", "marker_0"),
        ("Marker A (Position X) [m]", "Marker A (Position)"),
        ("tip-X(µm)", "tip"),
        ("tip (x)", "tip"),
        ("tip_x_base_mm", "tip_base"),
        ("box_x", "box"),
        ("px_tip", "p_tip"),
        ("x_mm", "marker 7"),  # the unit names no marker
        ("x1", "marker 1"),
    ],
)
def test_the_name_of_a_marker_is_that_of_its_columns_without_axis_and_unit(x, label):
    place = max(x.rfind("x"), x.rfind("X"))
    names = [x[:place] + axis + x[place + 1 :] for axis in ("xyz" if x[place] == "x" else "XYZ")]
    assert _label(names, 7) == label


def test_labels_are_the_columns_common_names_or_given(tmp_path):
    t, points = chain()
    assert list(imported(tmp_path, written(t, points), MAP).run.extra["marker_labels"]) == list(
        NAMES
    )
    given = MAP.replace('"third z"]]', '"third z"]], labels = ["a", "b", "tip"]')
    assert list(imported(tmp_path, written(t, points), given).run.extra["marker_labels"]) == [
        "a",
        "b",
        "tip",
    ]
    message = fault(tmp_path, written(t, points), given.replace('"a", ', ""))
    assert "labels = " in message and "expected 3 texts" in message
    text, _ = made_log()
    assert list(imported(tmp_path, text).run.extra["marker_labels"]) == ["marker 0", "marker 1"]


def test_markers_on_the_clamp_stand_next_to_the_others(tmp_path):
    t, points = chain()
    apart = (
        MAP.replace('["first x", "first y", "first z"], ', "")
        + 'base = { columns = ["first x", "first y", "first z"] }\n'
    )
    done = imported(
        tmp_path,
        written(t, points),
        apart + "[frame]\norigin_mm = [0, 0, 40]\n[seen]\nrate_hz = 10\n",
    )
    run = done.run
    assert run.markers.shape == (80, 2, 3) and run.extra["base_markers"].shape == (80, 1, 3)
    assert run.extra["base_markers"][:, 0] == pytest.approx(points[::5, 0] - [0, 0, 40], abs=1e-5)
    alone = ONE_LOG.replace("markers =", "base =")
    assert "base markers belong to the log with the markers" in fault(
        tmp_path, made_log()[0], alone
    )


def test_labels_of_the_protocol_become_blocks_and_folds(tmp_path):
    """A label for each part, in whatever order: folds hold out complete labels (`folds.py`)."""
    from softmap_edge.run.folds import folds

    t, points = chain()
    part = [f"pattern {k // 20}" for k in range(400)]
    run = imported(tmp_path, written(t, points, part), MAP).run
    assert list(run.block) == part
    for trained, tested in folds(run.t_seen, 5, 0.0, run.block):
        assert not set(run.block[tested]) & set(run.block[trained])
