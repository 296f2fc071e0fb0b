"""Columns of one quantity in different units that no log states: the import asks. Markers near the
origin that belong there, and drives of one unit, are no question.
"""

import numpy as np
import pytest

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.mixed_units import drives_question, places_in_metres

K, M = 200, 5
T = 0.02 * np.arange(K)
U = np.stack([5 * np.sin(3 * T), 4 * np.cos(2.5 * T) - 4], axis=1)
RNG = np.random.default_rng(2)


def body(first=20.0, noise=0.05):
    """Markers of a bending body 25 mm apart, the first at a height above the clamp."""
    height = first + 25.0 * np.arange(M)
    x, y = (np.outer(u, height**2) / 1500 for u in U.T)
    z = np.tile(height, (K, 1)) - np.outer((U**2).sum(axis=1), height) / 1500
    return np.stack([x, y, z], axis=2) + RNG.normal(0, noise, (K, M, 3))


AWAY = {"at the clamp": (0, 0, 0), "at a camera": (310, 45, 820), "far": (-900, 20, 1500)}
PARTS = {"the tip": [4], "the upper half": [3, 4], "the lower half": [0, 1], "every other": [1, 3]}


@pytest.mark.parametrize("part", list(PARTS))
@pytest.mark.parametrize("away", list(AWAY))
def test_markers_in_metres_among_millimetres_are_found(away, part):
    points = body() + np.array(AWAY[away])
    assert not len(places_in_metres(points))
    points[:, PARTS[part]] /= 1000.0
    assert places_in_metres(points).tolist() == PARTS[part]
    assert places_in_metres(points / 1000.0).tolist() == PARTS[part]  # whatever unit is declared


def compliant():
    """The first marker is zeroed and gives way a little under load."""
    points = body()
    points[:, 0] = 0.0016 * (points[:, 4] - points[0, 4]) + RNG.normal(0, 0.02, (K, 3))
    return points


GOOD = {
    "one body": body(),
    "a marker at the origin": body(first=0.3),
    "a marker that is the origin": body(first=0.0),
    "a mount that gives way": compliant(),
    "at rest": np.tile(body()[:1], (K, 1, 1)),
    "one marker": body()[:, :1] / 1000.0,
    "few frames": body()[:5],
    "nothing seen": np.full((K, M, 3), np.nan),
}


@pytest.mark.parametrize("make", list(GOOD))
def test_markers_of_one_unit_are_no_question(make):
    assert not len(places_in_metres(GOOD[make]))


def written(folder, points, commands):
    head = ["t", "cmd_1", "cmd_2", *(f"m{m}_{c}" for m in range(points.shape[1]) for c in "xyz")]
    rows = [
        ",".join(
            [f"{T[k]:.3f}", *(f"{x:.6g}" for x in commands[k]), *(f"{x:.6f}" for x in one.ravel())]
        )
        for k, one in enumerate(points)
    ]
    path = folder / "log.csv"
    path.write_text("\n".join([",".join(head), *rows]) + "\n")
    return path


def test_the_import_asks_and_scale_answers(tmp_path):
    points = body()
    points[:, 3:] /= 1000.0
    path = written(tmp_path, points, U)
    found = guess_mapping([path])
    assert any("m3, m4: 2 of 5 markers" in line and "set scale" in line for line in found.said)
    with pytest.raises(RunError, match="m3, m4: 2 of 5 markers are about 1000 times nearer"):
        import_logs([path], parse_mapping(found.text, path))
    factors = ", ".join(["1"] * 9 + ["1000"] * 6)
    for scale, factor in ((f"[{factors}]", 1000.0), ("1.0", 1.0)):
        text = found.text.replace("markers = { ", f"markers = {{ scale = {scale}, ")
        run = import_logs([path], parse_mapping(text, path)).run
        spans = np.ptp(run.markers[:, 4, 2]), np.ptp(points[:, 4, 2])
        assert spans[0] / spans[1] == pytest.approx(factor, rel=1e-3)


TICKS = np.rint(2048 + 80 * U[:, 1])
DEGREES = np.degrees(U[:, 0] / 8)


@pytest.mark.parametrize(
    "columns", [[DEGREES, TICKS], [TICKS, TICKS + 7, DEGREES], [U[:, 0], 20 * TICKS]]
)
def test_ticks_among_degrees_are_asked_about(columns):
    question = drives_question("command", np.stack(columns, axis=1), ["a", "b", "c"])
    assert "ticks" in question and "set scale and offset of command" in question


@pytest.mark.parametrize(
    "columns",
    [
        [TICKS, TICKS + 300],
        [DEGREES, 3 * DEGREES],
        [DEGREES, np.rint(DEGREES)],
        [TICKS, 0 * TICKS],
        [10 * DEGREES, DEGREES],
    ],
)
def test_drives_of_one_unit_are_no_question(columns):
    assert drives_question("command", np.stack(columns, axis=1), ["a", "b"]) is None


def test_the_import_asks_about_ticks_and_scale_answers(tmp_path):
    path = written(tmp_path, body(), np.stack([DEGREES, TICKS], axis=1))
    text = guess_mapping([path]).text
    with pytest.raises(RunError, match="cmd_2 look like ticks .*cmd_1"):
        import_logs([path], parse_mapping(text, path))
    line = next(line for line in text.splitlines() if line.startswith("command ="))
    mended = line.replace(" }", ", scale = [1, 0.08789], offset = [0, -180] }")
    run = import_logs([path], parse_mapping(text.replace(line, mended), path)).run
    assert np.abs(run.command).max() < 180
