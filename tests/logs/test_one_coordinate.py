"""One coordinate that stands for "not seen": a depth of 0 or 65535 among others; numbers that were
measured stay.
"""

import numpy as np
import pytest
from lost_markers import BUT_ALSO, GOOD, ROWS, SINES, K, T, body

from softmap_edge.checks.lost_points import lost_points
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.logs.not_seen import not_seen
from softmap_edge.logs.one_coordinate import lost_coordinates
from softmap_edge.run.run import Run

AWAY = np.array([20.0, -30.0, 500.0])  # of a camera, mm
MAP = """schema = "softmap.mapping/1"
[[log]]
time = { column = "t" }
command = { columns = ["u", "v"] }
markers = { %scolumns = [["x0", "y0", "z0"], ["x1", "y1", "z1"], ["x2", "y2", "z2"], ["x3", "y3", "z3"]] }
"""


def turned(points):
    """The places as a camera has them: x, −z, and the depth."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1) + AWAY


LOST = {
    "depth 0": (2, 0.0, False),
    "depth 65535, and x and y with it": (2, 65535.0, True),
    "depth -1": (2, -1.0, False),
    "no x": (0, -1000.0, False),
    "the end of a range": (2, 10000.0, False),
}


@pytest.mark.parametrize("name", list(LOST))
@pytest.mark.parametrize("how", [name for name in ROWS if name != "once"])
@pytest.mark.parametrize("make", ["noise", "no noise", "stairs", "no commands", "one marker"])
def test_a_coordinate_at_one_far_number_is_not_seen(make, how, name):
    points, u = GOOD[make]
    axis, number, scaled = LOST[name]
    camera, rows = turned(points), ROWS[how]
    lost = camera.copy()
    if scaled:
        lost[rows, -1] *= number / camera[rows, -1, 2:]
    lost[rows, -1, axis] = number
    found = not_seen(np.round(lost, 3), u)
    assert (found.mask[:, -1] == rows).all() and not found.mask[:, :-1].any()
    if found.coordinates:
        (line,) = found.lines([f"m{k}" for k in range(camera.shape[1])], "so")
        assert (
            f"with {'xyz'[axis]} at exactly {number:g} are taken as not seen: "
            f"m{camera.shape[1] - 1}" in line
        )


def test_a_number_that_two_markers_show_once_each():
    camera = turned(body(SINES))
    camera[70, 1, 2] = camera[90, 3, 2] = 0.0
    found = not_seen(camera, SINES).mask
    assert found[70, 1] and found[90, 3] and found.sum() == 2


@pytest.mark.parametrize("name", [*GOOD, *BUT_ALSO])
@pytest.mark.parametrize("digits", [None, 1, 0])
def test_coordinates_that_were_measured_stay(name, digits):
    """Resting fingers, a plane, a marker at the origin, coarse digits; of a camera, and of the
    finger itself.
    """
    points, u = (GOOD | BUT_ALSO)[name]
    for places in (points, turned(points)):
        seen = places if digits is None else np.round(places, digits)
        assert not lost_coordinates(seen, None if u is None else u / np.ptp(u, axis=0))


def test_a_planar_robot_and_one_that_snaps_to_a_stop_stay():
    planar = body(SINES)
    planar[..., 1] = 0.0
    assert not lost_coordinates(planar, SINES / 16)
    u = np.repeat([0.0, 2, 4, 8, 4, 2, 0, 8], 50)[:, None] * [1.0, 0.5]
    snapped = body(u, noise=0)
    snapped[u[:, 0] == 8, :, 2] += 250.0  # it snaps to a stop under one command
    assert not lost_coordinates(snapped, u / np.ptp(u, axis=0))


def test_an_import_sets_them_aside_and_a_run_is_searched(tmp_path):
    camera, rows = np.round(turned(body(SINES)), 3), ROWS["here and there"]
    camera[rows, 2, 2] = 0.0
    head = ",".join(["t", "u", "v", *(f"{a}{m}" for m in range(4) for a in "xyz")])
    table = np.column_stack([T, SINES, camera.reshape(K, -1)])
    (tmp_path / "log.csv").write_text(
        head + "\n" + "\n".join(",".join(f"{x:.4f}" for x in row) for row in table)
    )
    for keys, found in (("", True), ('not_seen = "keep", ', False)):
        (tmp_path / "map.toml").write_text(MAP % keys)
        done = import_logs([tmp_path / "log.csv"], read_mapping(tmp_path / "map.toml"))
        assert (
            any(
                "with z at exactly 0 are taken as not seen: marker 2" in text
                for text in done.doubts
            )
            == found
        )
        assert done.run.visible is None or (done.run.visible[:, 2] == ~rows).all() == found
    mask, (line,) = lost_points(Run(t=T, command=SINES, t_seen=T, markers=camera))
    assert (mask[:, 2] == rows).all() and mask.sum() == rows.sum() and "with z at exactly 0" in line
