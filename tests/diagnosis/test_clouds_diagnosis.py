"""A finger that is seen as clouds is diagnosed like one whose vertices are known, but for its
roll.
"""

from dataclasses import replace

import numpy as np
import pytest

from softmap_edge.alignment.register import register
from softmap_edge.diagnosis.diagnose import diagnose
from softmap_edge.model.bundle import builtin_model
from softmap_edge.run.protocol import standard_protocol
from softmap_edge.run.run import ROLL_SEEN, Run
from softmap_edge.synthetic.depth_camera import TWO
from softmap_edge.synthetic.finger import hide

pytestmark = pytest.mark.long

MODEL = builtin_model()
THIN = 2  # every second frame of the standard protocol


def thinned(protocol):
    return replace(protocol, t_seen=protocol.t_seen[::THIN], block=protocol.block[::THIN])


@pytest.fixture(scope="module")
def registered():
    """A finger with backlash, seen by two cameras with outliers and a hole; its vertices as
    registration finds them.
    """
    truth, protocol = hide(["backlash"], 4), thinned(standard_protocol(2))
    rng, cameras = np.random.default_rng(4), replace(TWO, points=2000, hole_mm=10.0)
    clouds = [cameras.look(shape, MODEL.triangles, rng) for shape in truth.shapes(protocol)]
    seen = replace(
        truth.measure(protocol),
        vertices=None,
        points=np.vstack(clouds),
        start=np.cumsum([0, *map(len, clouds)]),
    )
    return truth, register(MODEL, seen).run(seen)


def rolled(run, degrees):
    """The same vertices, each frame's turned about the local axis of the body, more towards the
    tip.
    """
    own = MODEL.structure.feature_map
    centres = own.weights[own.positions] @ run.vertices
    along = np.gradient(centres, axis=1)
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    section = MODEL.sections
    axis, arm = along[:, section], run.vertices - centres[:, section]
    turn = (
        np.radians(degrees)[:, None] * MODEL.structure.arc_length / MODEL.structure.arc_length.max()
    )
    moved = np.cross(axis, arm) * np.sin(turn)[..., None]
    moved += np.cross(axis, np.cross(axis, arm)) * (1.0 - np.cos(turn))[..., None]
    return replace(run, vertices=run.vertices + moved)


def test_a_law_is_named_and_twist_is_not_testable(registered):
    truth, run = registered
    document = diagnose(MODEL, run).to_dict()
    assert document["verdict"] == "identified"
    assert [effect["name"] for effect in document["effects"]] == ["backlash"]
    gap = document["effects"][0]["params"]["backlash.gap"]["value"]
    assert gap == pytest.approx(2.0 * np.mean(truth.hidden[0].law.half_width_mm), rel=0.05)
    first, last = (document["error"]["ladder"][-1]["value"], document["error"]["model"])
    assert first < 0.15 * last
    why = {one["name"]: one["why"] for one in document["not_testable"]}
    assert "do not show what it does about its own axis" in why["twist"]


def test_roll_is_not_looked_at(registered):
    _, run = registered
    assert not run.extra[ROLL_SEEN]
    turned = rolled(run, np.full(run.frames, 6.0))
    features = MODEL.seen_features(run)
    assert features.shape == (run.frames, 9, 3) and MODEL.features(run).shape == (run.frames, 9, 3)
    reported = np.isfinite(features)
    assert np.abs(MODEL.seen_features(turned) - features)[reported].max() < 0.12
    assert [e["name"] for e in diagnose(MODEL, turned).to_dict()["effects"]] == ["backlash"]
    # As of vertices that were tracked, the directions would be looked at too, which no one
    # measured.
    one, other = (
        MODEL.seen_features(replace(r, extra={ROLL_SEEN: np.array(True)})) for r in (run, turned)
    )
    assert one.shape == (run.frames, 27, 3) and np.nanmax(np.abs(other - one)) > 0.7


def test_turned_tendons_and_a_turned_frame_stay_open(registered):
    """About its axis a round finger looks the same from everywhere: nothing seen says what is
    turned.
    """
    _, run = registered
    angle = np.radians(5.0)
    about_z = np.array(
        [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    document = diagnose(MODEL, replace(run, vertices=run.vertices @ about_z.T)).to_dict()
    assert document["verdict"] == "ambiguous" and not document["faults"]
    named = {effect["name"]: effect["params"] for effect in document["effects"]}
    assert set(named) == {"backlash", "routing"}
    for phase in named["routing"].values():
        assert phase["value"] == pytest.approx(5.0, abs=1.0)
    assert ["backlash", "mount"] in [other["effects"] for other in document["alternatives"]]


def test_what_was_seen_of_the_roll_stays_in_the_file(registered, tmp_path):
    _, run = registered
    run.save(tmp_path / "run.npz")
    again = Run.load(tmp_path / "run.npz")
    assert not again.extra[ROLL_SEEN] and MODEL.run_feature_map(again).positions.all()
    assert len(MODEL.run_form_error(again)) == 9
