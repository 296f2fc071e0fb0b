"""Lengths in cm or m where mm are declared: places, the origin of the base, the radius of a spool.

The robots differ in size, in what is seen of them, and in how they hang; none that is right is
doubted.
"""

import numpy as np
import pytest
from logs import fault, imported

T = np.arange(300) / 20
MAP = """schema = "softmap.mapping/1"
{top}
[[log]]
time = {{ column = "t" }}
command = {{ columns = {columns}{command} }}
markers = {{ columns = {places}{markers} }}
{base}
{frame}
"""


def log(
    length=120.0, stroke=12.0, radius=4.0, at=(0.4, 0.7, 1.0), away=(0, 0, 0), scale=1.0, **how
):
    """A bending robot: a sine of its tendons, arcs of its markers, in the frame of the camera.

    Args:
        length: of the body. stroke: of a tendon, to each side. radius: of the tendons. All mm.
        at: shares of the length at which markers sit.
        away: (3,) mm, the place of the clamp in the camera's frame.
        scale: what the places are multiplied with; `flip` hangs the robot along -z of the camera.
    """
    u = stroke * np.sin(0.9 * T)
    bend = np.maximum(np.abs(u) / radius * how.get("stiff", 0.5), 1e-9) * np.sign(u + 1e-12)
    points = np.stack(
        [
            np.column_stack(
                [length * s * (1 - np.cos(s * bend)) / (s * bend), 0 * T]
                + [length * s * np.sin(s * bend) / (s * bend)]
            )
            for s in at
        ],
        axis=1,
    )
    points = points + 0.02 * np.random.default_rng(1).normal(size=points.shape)
    if how.get("flip"):
        points = points * [1, -1, -1]
    points = (points + np.asarray(away, float)) * scale
    columns = [T, u, -u, *points.reshape(len(T), -1).T]
    if how.get("base"):
        plate = (np.array([[9.0, 4, -2], [-8, 5, -2], [1, -9, -2]]) + away) * scale
        columns += [np.full(len(T), x) for x in plate.reshape(-1)]
    names = ["t", "u", "v", *(f"c{k}" for k in range(len(columns) - 3))]
    rows = "\n".join(",".join(f"{x:.9g}" for x in row) for row in np.column_stack(columns))
    return f"{','.join(names)}\n{rows}\n"


def mapping(places=3, one=False, **parts):
    triples = [[f"c{3 * k + i}" for i in range(3)] for k in range(places)]
    plate = [[f"c{3 * k + i}" for i in range(3)] for k in range(places, places + 3)]
    keep = 'not_seen = "keep"'  # the plate has no noise here
    base = f"base = {{ {keep}, columns = {plate} }}" if parts.get("base") else ""
    text = MAP.format(
        top=parts.get("top", ""),
        columns=["u"] if one else ["u", "v"],
        command=parts.get("command", ""),
        places=triples,
        markers=parts.get("markers", ""),
        base=base,
        frame=parts.get("frame", ""),
    )
    return text.replace("'", '"')


# --- centimetres ---------------------------------------------------------------------------
ROBOTS = {
    "finger": {"length": 117, "stroke": 12, "radius": 9},
    "trunk": {"length": 320, "stroke": 35, "radius": 22, "at": (0.3, 0.6, 0.8, 1.0)},
    "tip alone": {"length": 90, "stroke": 11, "radius": 5, "at": (1.0,)},
    "catheter": {"length": 60, "stroke": 4, "radius": 2, "at": (0.5, 1.0)},
    "stubby": {"length": 40, "stroke": 16, "radius": 12},
}


@pytest.mark.parametrize("name", ROBOTS)
def test_centimetres_read_as_millimetres_are_doubted(tmp_path, name):
    robot = ROBOTS[name]
    count = len(robot.get("at", "abc"))
    found = imported(tmp_path, log(scale=0.1, **robot), mapping(count)).doubts
    assert any("the places look like cm" in line and 'set unit = "cm"' in line for line in found)
    declared = mapping(count, markers=', unit = "cm"')
    assert imported(tmp_path, log(scale=0.1, **robot), declared).doubts == ()


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_in_millimetres_is_not_doubted(tmp_path, name):
    robot = ROBOTS[name]
    assert imported(tmp_path, log(**robot), mapping(len(robot.get("at", "abc")))).doubts == ()


def test_a_stroke_in_another_unit_than_mm_shows_no_size(tmp_path):
    reported = mapping(top='command_unit = "deg"', command=', unit = "deg"')
    small = {"length": 30, "stroke": 60, "radius": 20}
    assert imported(tmp_path, log(**small), reported).doubts == ()


def test_places_that_were_not_seen_show_no_size(tmp_path):
    lines = log(scale=0.1, length=117, stroke=12, radius=9).splitlines()
    for k in range(5, 300, 40):
        cells = lines[k].split(",")
        lines[k] = ",".join(cells[:3] + ["nan", "", "9999"] + cells[6:])
    reported = mapping(markers=", not_seen = [9999.0]")
    found = imported(tmp_path, "\n".join(lines), reported).doubts
    assert any("the places look like cm" in line for line in found)


# --- metres --------------------------------------------------------------------------------
CLAMPS = {
    "in front of the camera": ((40.0, -75.0, 480.0), False, 'axes = ["x", "y", "z"]'),
    "hanging from a frame": ((310.0, 5.0, 905.0), True, 'axes = ["x", "-y", "-z"]'),
    "on the table": ((120.0, 0.0, 0.0), False, ""),
    "far along its axis": ((0.0, 0.0, -640.0), False, ""),
}


@pytest.mark.parametrize("name", CLAMPS)
@pytest.mark.parametrize("seen", ["markers", "one marker", "base"])
def test_an_origin_in_metres_is_doubted(tmp_path, name, seen):
    away, flip, axes = CLAMPS[name]
    at = (1.0,) if seen == "one marker" else (0.35, 0.7, 1.0)
    made = log(at=at, away=away, flip=flip, base=seen == "base")
    right = ", ".join(f"{x:g}" for x in away)
    wrong = ", ".join(f"{x / 1000:g}" for x in away)

    def doubts(origin):
        frame = f"[frame]\norigin_mm = [{origin}]\n{axes}"
        return imported(tmp_path, made, mapping(len(at), base=seen == "base", frame=frame)).doubts

    found = doubts(wrong)
    assert len(found) == 1 and "looks like metres" in found[0], found
    assert f"set origin_mm = [{right}]" in found[0]
    assert doubts(right) == ()


@pytest.mark.parametrize("origin", [[0.4, -0.7, 0.0], [0.0, 0.0, 0.5], [1.2, 2.1, -2.5], [0, 0, 0]])
def test_an_origin_of_less_than_a_millimetre_is_not_doubted(tmp_path, origin):
    frame = f"[frame]\norigin_mm = {origin}"
    for at in ((1.0,), (0.4, 0.7, 1.0)):
        made = log(at=at, away=origin)
        assert imported(tmp_path, made, mapping(len(at), frame=frame)).doubts == ()


def test_a_spool_radius_in_metres_is_named(tmp_path):
    for unit, turned in (("rad", 1.1), ("deg", 63.0)):
        made = log(stroke=turned, radius=turned / 1.4)
        declared = f', unit = "{unit}", spool_radius_mm = %s'
        message = imported(tmp_path, made, mapping(command=declared % "0.011")).doubts
        assert any("set spool_radius_mm = 11" in line for line in message), message
        assert imported(tmp_path, made, mapping(command=declared % "11.0")).doubts == ()


def test_a_body_that_no_robot_has_is_still_refused(tmp_path):
    message = fault(tmp_path, log(scale=1e-3), mapping())
    assert "metres" in message or 'set unit = "m"' in message
