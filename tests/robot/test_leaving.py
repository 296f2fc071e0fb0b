"""Messages on leaving a robot: a fault of the way home once, and none that was reported
before.
"""

import pytest
from rigs import calibration, emulated_rig, torque
from waiting import hold_for, until

from softmap_edge.errors import ServoError
from softmap_edge.robot.control.controller import Controller


def test_a_finger_that_does_not_come_home_at_the_end_is_reported():
    with emulated_rig() as (bus, rig, limits):
        limits["servos"] = [one | {"following": 300.0} for one in limits["servos"]]
        reported = pytest.raises(
            ServoError, match=r"in state fault \(servo 1 does not follow.*home the robot again"
        )
        with reported, Controller(rig, calibration(), limits) as robot:
            robot.engage()
            hold_for(robot, [2.5, 0.0], 1.5)
            bus.damage(0, jammed=True)  # seen only in reverse
        assert not torque(bus)


def test_what_ends_a_program_goes_on_as_what_it_is_with_what_the_finger_did():
    with emulated_rig() as (bus, rig, limits):
        limits["servos"] = [one | {"following": 300.0} for one in limits["servos"]]
        with pytest.raises(LookupError) as ended, Controller(rig, calibration(), limits) as robot:
            robot.engage()
            hold_for(robot, [2.5, 0.0], 1.5)
            bus.damage(0, jammed=True)
            raise LookupError("of its own")
        assert "home the robot again" in ended.value.__notes__[0] and not torque(bus)


def test_a_fault_that_its_program_has_seen_is_not_reported_again():
    with emulated_rig() as (bus, rig, limits):
        with Controller(rig, calibration(), limits) as robot:
            robot.engage()
            hold_for(robot, [1.0, 0.0], 0.5)
            bus.heat(0, 69.0)
            until(lambda: robot.report["state"] == "fault", 5.0)
        with pytest.raises(
            ServoError, match=r"servo 1 is too hot: \d+ °C, allowed is below 65 °C\).*Controller$"
        ):
            bus.heat(0, 30.0)
            with Controller(rig, calibration(), limits) as robot:
                robot.engage()
                bus.heat(0, 69.0)
                hold_for(robot, [1.0, 0.0], 9.0)
