"""docs/do/own_effect.md as its reader runs it: an unknown error remains, and the user's own effect
explains it.

The finger is that of off_centre.py: solved by finite elements, with exact winding, which no effect
of any form is.
"""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from off_centre import story
from page import ROOT, blocks, lines

from softmap_edge import builtin_model, diagnose
from softmap_edge.cli import main
from softmap_edge.comparison.comparison import compare
from softmap_edge.model.user_effect import forget_effect, loaded
from softmap_edge.robot.emulated.named_laws import OffCentreSpool
from softmap_edge.run.run import Run

pytestmark = pytest.mark.long

PAGE = (ROOT / "docs/do/own_effect.md").read_text(encoding="utf-8")
EXAMPLE = (ROOT / "examples/off_centre_pulley.py").read_text(encoding="utf-8")
FALL = 0.8  # of the removable error


def test_the_truth_winds_by_its_moment_arm():
    """Virtual work: the slope of the shortening is the distance of the free tendon from the
    axis.
    """
    law, off, phase = OffCentreSpool(), 0.9, 0.6
    angle = np.linspace(-3.0, 3.0, 60_001)
    slope = np.gradient(law.wound(angle, off, phase), angle)[1:-1]
    middle = off * np.stack([np.cos(angle + phase), np.sin(angle + phase)], axis=1)[1:-1]
    away = np.array([law.guide_mm, 0.0]) - middle
    far = np.linalg.norm(away, axis=1)
    turn = np.arctan2(away[:, 1], away[:, 0]) + np.arccos(law.radius_mm / far)
    touch = middle + law.radius_mm * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    along = (np.array([law.guide_mm, 0.0]) - touch) / np.linalg.norm(
        np.array([law.guide_mm, 0.0]) - touch, axis=1
    )[:, None]
    arm = np.abs(touch[:, 0] * along[:, 1] - touch[:, 1] * along[:, 0])
    np.testing.assert_allclose(slope, arm, rtol=1e-6)
    np.testing.assert_allclose(law.wound(angle, 0.0, 0.0), law.radius_mm * angle, atol=1e-12)


def test_the_page_shows_the_example():
    (shown,) = [
        text for language, text in blocks(PAGE) if language == "python" and "EFFECT" in text
    ]
    assert shown == EXAMPLE
    assert len(EXAMPLE.splitlines()) <= 25


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    """The reader's folder after all blocks of the page were run, in their order."""
    there = tmp_path_factory.mktemp("own_effect")
    floor = story()[2]
    (there / "examples").mkdir()
    (there / "examples/off_centre_pulley.py").write_text(EXAMPLE, encoding="utf-8")
    names = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(there)
        for language, text in blocks(PAGE):
            if language == "python":
                exec(text, names if "EFFECT" not in text else {})
                continue
            for words in lines(text):
                assert words[0] == "softmap" and main(words[1:]) == 0, words
    yield there, floor, names
    for name in loaded():
        forget_effect(name)


def document(there, name):
    return json.loads((Path(there) / name).read_text(encoding="utf-8"))


def test_without_it_something_unknown_is_left(read):
    before = document(read[0], "before.json")
    assert before["verdict"] == "partly_explained"
    (family,) = before["families"]
    assert (family["name"], family["law"], family["effects"]) == ("static map", "open", [])
    assert family["moved_mm"] == pytest.approx(stated(r"(\S+) mm RMS"), abs=0.03)


def stated(pattern):
    return float(re.search(pattern, PAGE).group(1))


def test_with_it_the_removable_error_falls(read):
    there, floor, names = read
    found = document(there, "found.json")
    assert found["verdict"] == "identified"
    assert [effect["name"] for effect in found["effects"]] == ["off_centre_pulley"]
    radius = found["effects"][0]["params"]["off_centre_pulley.radius"]
    assert radius["value"] == pytest.approx(OffCentreSpool().radius_mm, rel=0.05)
    other = Run.load(there / "other.npz")
    before, after = (
        compare(model, other).error["rms_mm"] for model in (builtin_model(), names["model"])
    )
    assert before - after >= FALL * (before - floor)
    assert not before - before >= FALL * (before - floor)  # doing nothing fails it
    assert (before, after) == pytest.approx(
        (stated(r"from\s+(\S+) mm to"), stated(r"mm to (\S+) mm;")), abs=0.02
    )
    assert floor == pytest.approx(stated(r"middle has (\S+) mm\."), abs=0.02)
    # The effects of the library do not get there.
    gain = diagnose(builtin_model(), Run.load(there / "run.npz"), effects=["gain"]).model
    assert before - compare(gain, other).error["rms_mm"] < 0.7 * (before - floor)


def test_the_simulator_takes_what_it_gives(read):
    names = read[2]
    assert names["solved"].shape == names["points"][:3].shape
    miss = np.sqrt(np.mean(np.sum((names["solved"] - names["points"][:3]) ** 2, axis=-1)))
    assert miss < 0.5  # mm: what interpolating a sweep costs, and no more
    unbent = np.abs(names["acts"] - names["model"].commands(names["run"])[: len(names["acts"])])
    assert unbent.max() > 0.1
