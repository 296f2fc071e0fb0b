"""A finger with three tendons (C = 3): it is built from its file, and the demo's story passes on
it.
"""

from pathlib import Path

import numpy as np
import pytest

from softmap_edge import Finger, Simulator, load_bundle
from softmap_edge.cli import main
from softmap_edge.commands.demo import trial
from softmap_edge.synthetic.finger import hide

pytestmark = pytest.mark.long

FILE = Path(__file__).parents[2] / "examples/three_tendons.toml"
FALL = 0.85  # of the removable error, as the two pairs of the built-in finger promise


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    folder = tmp_path_factory.mktemp("three")
    assert main(["build", str(FILE), "--out", str(folder / "three"), "--steps", "7"]) == 0
    return load_bundle(folder / "three")


def test_a_turn_of_the_commands_turns_the_shape():
    simulator = Simulator(Finger.load(FILE))
    rest = simulator.template.vertices
    end = rest[:, 2] > rest[:, 2].max() - 1e-6
    tips = (simulator.path(8.0 * np.eye(3)) - rest)[:, end].mean(axis=1)
    turn = np.array([[-0.5, -np.sqrt(0.75)], [np.sqrt(0.75), -0.5]])
    assert np.linalg.norm(tips[0, :2]) > 10.0
    for one, next_one in ((0, 1), (1, 2), (2, 0)):
        # The mesh has the symmetry of quarter turns, not of thirds: its error is left, a share of
        # the motion.
        assert np.linalg.norm(turn @ tips[one, :2] - tips[next_one, :2]) < 0.03 * np.linalg.norm(
            tips[0, :2]
        )


@pytest.mark.parametrize("name", ["hysteresis", pytest.param("gravity", marks=pytest.mark.prove)])
def test_the_story_of_the_demo_passes(name, model):
    assert model.channels == 3 and model.vertex_error_mm < 1.0
    story = trial(model, hide([name], 1, finger=Finger.load(FILE)))
    found = story.diagnosis.to_dict()
    assert found["effects"][0]["name"] == name, found["sentence"]
    assert story.fall >= FALL and story.before_mm > story.floor_mm + 0.3, found["sentence"]
