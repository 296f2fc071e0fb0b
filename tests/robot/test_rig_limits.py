"""A Controller drives about the confirmed homes and within the limits of the rig, whatever user
made the limits.
"""

from dataclasses import replace

import pytest
from rigs import HOME, MODEL, WINDOW, calibration, emulated_rig

from softmap_edge.errors import ServoError
from softmap_edge.robot.control.controller import Controller
from softmap_edge.robot.servo.loop_limits import loop_limits, servo_limits
from softmap_edge.robot.servo.rig_ceiling import Ceiling


def test_limits_about_another_home_than_the_confirmed_one_are_refused():
    with emulated_rig() as (_, rig, _):
        limits = loop_limits(
            [servo_limits(MODEL, HOME, WINDOW), servo_limits(MODEL, HOME + 3000, WINDOW)]
        )
        with pytest.raises(
            ServoError, match="servo 2: the limits are about home at 5000, the rig's is 2000"
        ):
            Controller(rig, calibration(), limits)


@pytest.mark.parametrize(
    ("ceiling", "said"),
    [
        ({"low": -800.0}, "servo 1: low is -900, the rig allows -800"),
        ({"high": 800.0}, "servo 1: high is 900, the rig allows 800"),
        ({"slew": 500.0}, "servo 1: slew is 2000, the rig allows 500"),
        ({"current_mA": 100.0}, "servo 1: current_mA is 612.5, the rig allows 100"),
        ({"hold": 0.2}, "hold is .*, the rig allows 0.2"),
        ({"ramp": 5.0}, "ramp is .*, the rig allows 5"),
        ({"jump": (10.0, 20.0)}, "jump is .*, the rig allows 10"),
    ],
)
def test_limits_above_the_ceiling_of_the_rig_are_refused(ceiling, said):
    with emulated_rig() as (_, rig, limits):
        with pytest.raises(ServoError, match=said):
            Controller(replace(rig, ceiling=Ceiling(tuple(ceiling.items()))), calibration(), limits)
        first = replace(rig.servos[0], high=500)
        with pytest.raises(ServoError, match="servo 1: high is 900, the rig allows 500"):
            Controller(replace(rig, servos=(first, rig.servos[1])), calibration(), limits)
        Controller(rig, calibration(), limits)
