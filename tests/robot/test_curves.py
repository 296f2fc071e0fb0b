"""Figures: sizes, files in, files refused."""

import numpy as np
import pytest

from softmap_edge import SoftmapError
from softmap_edge.robot.motion.figures import FIGURES, even, figure


@pytest.mark.parametrize("name", FIGURES)
def test_figures_are_centred_and_as_large_as_asked(name):
    points = figure(name, 8.0)
    np.testing.assert_allclose((points.min(axis=0) + points.max(axis=0)) / 2, 0.0, atol=1e-9)
    assert np.ptp(points, axis=0).max() / 2 == pytest.approx(8.0)
    steps = np.linalg.norm(np.diff(even(points, 300), axis=0), axis=1)
    assert steps.max() < 1.01 * np.median(steps)


def turning(points):
    """Return by how much a line turns in all, in turns: left is positive."""
    steps = np.diff(points, axis=0)
    angle = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    return (angle[-1] - angle[0]) / (2 * np.pi)


def strokes(points):
    """Return the straight strokes of a letter as sorted pairs of corners, each once."""
    pairs = zip(points[:-1].tolist(), points[1:].tolist())
    return {tuple(sorted(map(tuple, pair))) for pair in pairs}


def test_the_figures_are_those_that_are_named_and_look_like_them():
    assert list(FIGURES) == ["S", "H", "O", "E", "circle", "eight"]
    s, h, o, e, circle, eight = FIGURES.values()
    np.testing.assert_allclose(s + s[::-1], 0.0, atol=1e-9)  # half a turn brings an S onto itself
    assert (
        s[0][0] > 0 > s[-1][0]
        and s[0][1] > 0 > s[-1][1]
        and turning(s[:60]) > 0.6
        and turning(s[60:]) < -0.6
    )
    assert np.ptp(s[:, 0]) < 0.6 * np.ptp(s[:, 1])
    left, right = -0.6, 0.6
    assert {((left, 0.0), (right, 0.0)), ((left, -1.0), (left, 1.0))} <= strokes(h)
    assert {x for x, y in h.tolist() if abs(y) == 1} == {left, right} and len(
        np.unique(h, axis=0)
    ) == 6
    bars = {(y, max(a, b)) for (a, y), (b, other) in strokes(e) if y == other}
    assert (
        {y for y, _ in bars} == {-1.0, 0.0, 1.0}
        and min(x for _, x in bars) > 0
        and e[:, 0].min() == left
    )
    for closed in (o, circle, eight):
        np.testing.assert_allclose(closed[0], closed[-1], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(circle, axis=1), 1.0)
    assert (
        abs(turning(circle)) > 0.99
        and abs(turning(o)) > 0.99
        and np.ptp(o[:, 0]) < 0.8 * np.ptp(o[:, 1])
    )
    middle = np.linalg.norm(eight, axis=1) < 1e-9
    assert middle.sum() == 3 and abs(turning(eight)) < 0.1  # once each way round


def test_an_even_line_keeps_its_ends_and_drops_doubled_points():
    line = even(np.array([(0.0, 0.0), (0.0, 0.0), (3.0, 0.0), (3.0, 1.0)]), 5)
    np.testing.assert_allclose(line, [(0, 0), (1, 0), (2, 0), (3, 0), (3, 1)])


def test_a_figure_of_a_csv_has_its_corners(tmp_path):
    (tmp_path / "a.csv").write_text("x,y\n0,0\n10,0\n\n10,4\n")
    np.testing.assert_allclose(figure(str(tmp_path / "a.csv"), 5.0), [(-5, -2), (5, -2), (5, 2)])


@pytest.mark.parametrize(
    "name, text, said",
    [
        ("a.csv", "1,2\n3\n", "line 2"),
        ("a.csv", "1,2\n", "1 points"),
        ("a.csv", "1,2\n1,2\n", "the same"),
        ("a.csv", "1,2\nnan,2\n", "finite"),
        ("a.csv", "0,1e308\n1,-1e308\n", "within ±1e\\+06"),
        (
            "a.svg",
            '<svg><path d="M0 4h10V0"/></svg>',
            r"drawings are not read; .* \.csv .* docs/do/track\.md",
        ),
    ],
)
def test_files_that_hold_no_figure_are_refused(tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    with pytest.raises(SoftmapError, match=said):
        figure(str(tmp_path / name), 5.0)


def test_names_and_amplitudes_that_are_none_are_refused(tmp_path):
    for name, amplitude in (
        ("Q", 5.0),
        ("S", 0.0),
        ("S", float("nan")),
        (str(tmp_path / "no.csv"), 5.0),
    ):
        with pytest.raises(SoftmapError):
            figure(name, amplitude)
