"""Labels of markers in a report: none covers another label or another marker."""

from itertools import combinations

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from matplotlib.colors import Normalize
from matplotlib.text import Annotation

from softmap_edge.report.figures import _extent, _marker_figure

PLACES = {
    "two rows at one height": [[x, 0, z] for z in (40.0, 80.0, 120.0) for x in (-8.0, 8.0)],
    "four at one height": [[x, 0, 100.0 + 0.1 * k] for k, x in enumerate((-9.0, -3.0, 3.0, 9.0))],
    "close together": [[0.2 * k, 0, 100.0 + 2.0 * k] for k in range(6)],
    "a line": [[0.1 * k, 0, 30.0 * k] for k in range(6)],
    "two at one place": [[0, 0, 10.0], [0, 0, 10.0], [5.0, 0, 60.0]],
}


@pytest.mark.parametrize("places", PLACES.values(), ids=PLACES)
def test_labels_of_markers_do_not_overlap(places):
    values = np.linspace(0.3, 2.8, len(places))
    shown = [("before", values), ("after", values / 3)]
    figure = _marker_figure(np.array(places, float), shown, Normalize(0.0, 3.0))
    figure.draw_without_rendering()
    for axes in figure.axes[:2]:
        labels = [text for text in axes.texts if isinstance(text, Annotation)]
        boxes = [_extent(label) for label in labels]
        assert len(boxes) == len(places)
        assert not [pair for pair in combinations(boxes, 2) if pair[0].overlaps(pair[1])]


def test_a_label_with_room_stays_next_to_its_marker():
    figure = _marker_figure(np.array(PLACES["a line"]), [("error", np.ones(6))], Normalize(0, 1))
    labels = [text for text in figure.axes[0].texts if isinstance(text, Annotation)]
    assert all(label.xyann[1] == 0 and not label.arrow_patch.get_visible() for label in labels)
