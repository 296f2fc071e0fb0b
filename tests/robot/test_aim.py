"""Where hand and knob lead: the commands themselves, or the tip by inverse kinematics; and what of
it is drawn.
"""

import numpy as np
import pytest
from rigs import calibration

from softmap_edge import builtin_model
from softmap_edge.errors import TeleopError
from softmap_edge.robot.motion.kinematics import Kinematics
from softmap_edge.robot.teleop.mapping import DirectMapping, TipMapping
from softmap_edge.robot.teleop.sketch import ShapePreview


@pytest.fixture(scope="module")
def model():
    return builtin_model()


def test_the_direct_map_leads_the_commands_within_their_range(model):
    aim = DirectMapping(Kinematics(model))
    np.testing.assert_allclose(aim.box, [[-16, 16], [-16, 16]])
    np.testing.assert_allclose(aim.command([3.0, -99.0]), [3.0, -16.0])
    np.testing.assert_allclose(aim.point([1.0, 2.0]), [1.0, 2.0])


def test_the_tip_goes_where_it_is_led(model):
    aim, rest = TipMapping(Kinematics(model, axes="xy")), model.tip(np.zeros((1, 2)))[0]
    assert (aim.box[:, 0] < -40).all() and (aim.box[:, 1] > 40).all()
    for point in ([0.0, 0.0], [12.0, 0.0], [-20.0, 15.0], [3.0, -30.0]):
        u = aim.command(point)
        np.testing.assert_allclose((model.tip(u[None])[0] - rest)[:2], point, atol=0.01)
        np.testing.assert_allclose(aim.point(u), point, atol=0.01)
    far = aim.command([500.0, 0.0])
    assert np.isfinite(far).all() and far[0] == pytest.approx(16.0, abs=0.1)


def test_a_model_of_another_number_of_commands_is_led_by_its_tip_only(model):
    class Three:
        class model:
            channels = 3

    with pytest.raises(TeleopError, match="takes 3 commands, a hand drives two; give --tip"):
        DirectMapping(Three())
    with pytest.raises(TeleopError, match="the kinematics count xyz"):
        TipMapping(Kinematics(model))


def test_the_drawn_finger_is_the_models_through_its_effects(model):
    home = np.full(2, 2000.0)
    plain = ShapePreview(model, calibration())
    np.testing.assert_allclose(
        plain.points(home, 1.0), model.prior.evaluate(np.zeros((1, 2))).reshape(-1, 3), atol=1e-9
    )
    bent = plain.points(home + [1400.0, 0.0], 1.03)
    np.testing.assert_allclose(
        bent, model.prior.evaluate(np.array([[5.0, 0.0]])).reshape(-1, 3), atol=1e-9
    )
    loose = ShapePreview(model.with_effects(["backlash"], {"backlash.gap": 2.0}), calibration())
    loose.points(home, 1.0)
    for k in range(1, 15):
        behind = loose.points(home + [100.0 * k, 0.0], 1.0 + 0.03 * k)
    np.testing.assert_allclose(
        behind, model.prior.evaluate(np.array([[4.0, 0.0]])).reshape(-1, 3), atol=1e-6
    )
