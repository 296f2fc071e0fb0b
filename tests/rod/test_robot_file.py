"""`robot.toml`: every fault gets one line that names the key."""

from pathlib import Path

import pytest
from tendon_arm import ARM

from softmap_edge import Robot
from softmap_edge.errors import RobotError


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('schema = "softmap.robot/1"', "", "schema"),
        ("segments = 2", "", "segments is missing"),
        ("segments = 2", "segments = 99", "segments"),
        ("segments = 2", "segments = true", "segments"),
        ("segment = [1, 1, 1, 2, 2, 2]", "segment = [1, 1, 1, 2, 2, 3]", "segment"),
        ("segment = [1, 1, 1, 2, 2, 2]", "segment = []", "segment"),
        (
            "segment = [1, 1, 1, 2, 2, 2]",
            "segment = [1, 1, 1, 2, 2, 2]\ncommand = [1, 1, 2]",
            "command",
        ),
        (
            "segment = [1, 1, 1, 2, 2, 2]",
            "segment = [1, 1, 1, 2, 2, 2]\ncommand = [1, 1, 1, 3, 3, 3]",
            "command",
        ),
        ("radius_mm = 6", "radius_mm = -6", "radius_mm"),
        ("radius_mm = 6", "radius_mm = [6, 6]", "radius_mm has 2 numbers"),
        ("radius_mm = 6", 'radius_mm = "six"', "radius_mm"),
        ("radius_mm = 6", "radius_mm = nan", "radius_mm"),
        ("radius_mm = 6", "", "radius_mm is missing"),
        ("slack = 0.0", "slack = 2.0", "slack"),
        ("slack = 0.0", "slak = 0.0", "slak"),
        ("slack = 0.0", "pull = 0", "mm per unit"),
        ("markers = [1, 1.5, 2]", "markers = [2.1]", "markers"),
        ("markers = [1, 1.5, 2]", "markers = [[1]]", "markers"),
        ("length_mm = [70, 50]", "length_mm = [70, [50, 40]]", "length_mm"),
        ('angle = "each"', 'angle = "some"', "known, shared, each"),
        ('tilt = "fitted"', 'tilt = "each"', "known, fitted"),
        ("angle_deg = [0, 120, 240, 60, 180, 300]\n", "", None),
        ('angle = "each"', "", None),
        ("[body]", "[body", "TOML"),
        ("[fit]", "[fit]\nwarp = 1", "warp"),
        ("[fit]", "[[fit]]", "fit"),
    ],
)
def test_a_faulty_robot_is_refused_in_one_line(old, new, word, tmp_path):
    assert old in ARM
    (tmp_path / "robot.toml").write_text(ARM.replace(old, new, 1))
    # sound: angles may be left out where they are fitted, or known where they are given
    if word is None:
        Robot.load(tmp_path / "robot.toml")
        return
    with pytest.raises(RobotError) as refused:
        Robot.load(tmp_path / "robot.toml")
    message = str(refused.value)
    assert (
        word in message and "robot.toml" in message and "\n" not in message and len(message) < 400
    )


def test_angles_neither_given_nor_fitted_are_refused():
    text = ARM.replace("angle_deg = [0, 120, 240, 60, 180, 300]\n", "").replace(
        'angle = "each"\n', ""
    )
    with pytest.raises(RobotError, match="angle_deg is missing"):
        Robot.from_toml(text)
    with pytest.raises(RobotError, match=r"robot\.toml"):
        Robot.load(Path("no/robot.toml"))
