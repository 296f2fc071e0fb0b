"""Wrong units, y-up logs and swapped axes are suspected in one line that names the remedy; right
ones are not.
"""

import numpy as np
import pytest
from logs import ROOT, fault, imported, published

from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.logs.plausible import axes_for, rest_axis

T = np.arange(400) / 20
HEAD = "t,u,v,p,q," + ",".join(f"{axis}{k}" for k in range(3) for axis in "xyz")
MAP = """schema = "softmap.mapping/1"
{top}
[[log]]
time = {{ column = "t"{time} }}
command = {{ columns = ["u", "v"]{command} }}
present = {{ columns = ["p", "q"]{present} }}
markers = {{ columns = [["x0", "y0", "z0"], ["x1", "y1", "z1"], ["x2", "y2", "z2"]]{markers} }}
{frame}
"""


def robot(
    time=1.0,
    command=1.0,
    present=1.0,
    markers=1.0,
    turn=((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    shift=0.0,
):
    """A log of a hanging robot of 120 mm, ±30° of two motors that move it by 40 mm; each kind times
    a factor.
    """
    u = 30 * np.column_stack([np.sin(0.9 * T), np.sin(1.3 * T)])
    q = 30 * np.column_stack([np.sin(0.9 * T - 0.1), np.sin(1.3 * T - 0.1)])
    points = np.stack(
        [np.column_stack([1.3 * s**2 * q, np.full(len(T), 120 * s)]) for s in (0.33, 0.66, 1.0)],
        axis=1,
    )
    points = points + 0.05 * np.random.default_rng(0).normal(size=points.shape)
    seen = ((points + shift) @ np.asarray(turn).T).reshape(len(T), 9) * markers
    rows = np.column_stack([T * time, u * command, q * present, seen])
    return HEAD + "\n" + "\n".join(",".join(f"{x:.9g}" for x in row) for row in rows)


def mapping(top='command_unit = "deg"', time="", command="", present="", markers="", frame=""):
    return MAP.format(
        top=top, time=time, command=command, present=present, markers=markers, frame=frame
    )


def doubts(folder, log, reported):
    return imported(folder, log, reported).doubts


def test_a_log_as_it_should_be_raises_no_doubt(tmp_path):
    assert doubts(tmp_path, robot(), mapping()) == ()
    assert doubts(tmp_path, robot(markers=1e-3), mapping(markers=', unit = "m"')) == ()
    assert doubts(tmp_path, robot(command=np.pi / 180), mapping(command=', unit = "rad"')) == ()
    assert doubts(tmp_path, robot(time=1000), mapping(time=', unit = "ms"')) == ()


@pytest.mark.parametrize(
    ("factors", "reported", "words"),
    [
        (
            {"command": np.pi / 180},
            {},
            ["command: at most 0.523", 'unit = "deg" looks like rad', 'set unit = "rad"'],
        ),
        ({}, {"command": ', unit = "rad"'}, ["command: at most 30", "looks like deg"]),
        ({"present": np.pi / 180}, {}, ["times as far as command", "deg and rad"]),
        (
            {"command": 1e-4},
            {"top": "", "present": ", scale = 0.1"},
            ["command: at most 0.003", 'looks like m: set unit = "m"'],
        ),
        ({"command": 0.1, "present": 1e-4}, {"top": ""}, ["times as far as command", "mm and m"]),
        ({"time": 1000}, {}, ["t: rows are 50 s apart", 'time.unit = "ms"']),
        ({}, {"time": ', unit = "us"'}, ["t: rows are 5e-08 s apart"]),
        ({"markers": 60.0}, {}, ["markers: span", "check columns, unit and scale"]),
    ],
)
def test_another_unit_is_suspected(tmp_path, factors, reported, words):
    found = doubts(tmp_path, robot(**factors), mapping(**reported))
    assert any(all(word in doubt for word in words) for doubt in found), found


@pytest.mark.parametrize(
    ("factors", "reported", "words"),
    [
        ({"markers": 1e-3}, {}, ["markers:", 'unit = "mm", which looks like m: set unit = "m"']),
        (
            {},
            {"markers": ', unit = "m"'},
            ["markers:", 'unit = "m", which looks like mm: set unit = "mm"'],
        ),
        ({}, {"top": "", "command": ', unit = "m"'}, ["command:", "looks like mm"]),
    ],
)
def test_what_no_robot_can_be_is_refused_with_the_remedy(tmp_path, factors, reported, words):
    message = fault(tmp_path, robot(**factors), mapping(**reported))
    assert all(word in message for word in words), message


def test_other_quantities(tmp_path):
    lines = robot().splitlines()
    log = "\n".join([lines[0] + ",i,T,w", *(line + ",0.4,295,0.1" for line in lines[1:])])
    extra = 'current = { columns = ["i", "i"] }\nload = { columns = ["w"] }\n'
    reported = mapping().replace("markers =", extra + "markers =")
    assert any(
        "current: at most 0.4" in doubt and '"A"' in doubt
        for doubt in doubts(tmp_path, log, reported)
    )
    assert any(
        'looks like kg: set unit = "kg"' in doubt for doubt in doubts(tmp_path, log, reported)
    )
    message = fault(
        tmp_path, log, reported.replace("markers =", 'temperature = { columns = ["T"] }\nmarkers =')
    )
    assert 'temperature: at most 295 with unit = "degC" looks like K: set unit = "K"' in message


# --- axes ----------------------------------------------------------------------------------
TURNS = {
    "y-up, hanging": ([[1, 0, 0], [0, 0, -1], [0, 1, 0]], '["x", "z", "-y"]'),
    "y-up, standing": ([[1, 0, 0], [0, 0, 1], [0, -1, 0]], '["x", "-z", "y"]'),
    "z-up, hanging": ([[1, 0, 0], [0, -1, 0], [0, 0, -1]], '["x", "-y", "-z"]'),
    "along x": ([[0, 0, 1], [1, 0, 0], [0, 1, 0]], '["y", "z", "x"]'),
}


@pytest.mark.parametrize("turn", TURNS)
def test_a_frame_that_is_not_the_base_frame_is_seen_at_rest(tmp_path, turn):
    matrix, axes = TURNS[turn]
    found = doubts(tmp_path, robot(turn=matrix), mapping())
    assert (
        len(found) == 1
        and "at rest they run along" in found[0]
        and f"set frame.axes = {axes}" in found[0]
    )
    run = imported(tmp_path, robot(turn=matrix), mapping(frame=f"[frame]\naxes = {axes}"))
    assert run.doubts == () and np.median(run.run.markers[:, 2, 2]) == pytest.approx(120, abs=0.1)


def test_the_remedy_counts_from_the_axes_that_stand(tmp_path):
    matrix, axes = TURNS["y-up, hanging"]
    found = doubts(tmp_path, robot(turn=matrix), mapping(frame='[frame]\naxes = ["z", "x", "y"]'))
    assert f"set frame.axes = {axes}" in found[0]


def test_proposed_axes_are_never_a_mirror():
    for axis in range(3):
        for sign in (1, -1):
            rows = np.zeros((3, 3))
            for row, name in enumerate(axes_for(axis, sign)):
                rows[row, "xyz".index(name[-1])] = -1 if name[0] == "-" else 1
            assert np.linalg.det(rows) == 1 and rows[2, axis] == sign


def test_an_origin_far_from_the_robot_is_reported(tmp_path):
    found = doubts(tmp_path, robot(shift=[900, -400, 100]), mapping())
    assert any(
        "from the origin of the base frame" in doubt and "frame.origin_mm" in doubt
        for doubt in found
    )


def test_a_cloud_of_markers_has_no_axis():
    assert rest_axis(np.random.default_rng(0).normal(size=(20, 3)), None) is None
    assert rest_axis(np.array([[3.0, 0, 4]]), None) == pytest.approx([0.6, 0, 0.8])
    assert rest_axis(
        np.array([[10.0, 0, 0], [-10, 0, 0]]), np.array([0, 0, -50.0])
    ) == pytest.approx([0, 0, 1])


def test_right_logs_of_real_robots_raise_no_doubt(tmp_path):
    """The trunk by its own mapping; without its axes the y-up log is recognised."""

    folder, text = published("trunk"), (ROOT / "examples" / "trunk.toml").read_text()
    logs = [folder / "control_inputs_controlled_1.csv", folder / "observations_controlled_1.csv"]
    (tmp_path / "map.toml").write_text(text)
    assert import_logs(logs, read_mapping(tmp_path / "map.toml")).doubts == ()
    (tmp_path / "map.toml").write_text(text.replace('axes = ["x", "z", "-y"]', ""))
    found = import_logs(logs, read_mapping(tmp_path / "map.toml")).doubts
    assert any('set frame.axes = ["x", "z", "-y"]' in doubt for doubt in found)


BASED = """schema = "softmap.mapping/1"
[[log]]
time = { column = "t" }
markers = { columns = [["x", "y", "z"]], unit = "mm" }
base = { columns = [["p", "q", "r"], ["u", "v", "w"]], unit = "%s" }
"""


@pytest.mark.parametrize(
    ("stated", "scale", "said"), [("mm", 1e-3, "m"), ("m", 1.0, "mm"), ("mm", 1.0, None)]
)
def test_a_base_in_another_unit_is_doubted_by_its_own_key(tmp_path, stated, scale, said):
    base = scale * np.array([40.0, 3.0, 8.0, -38.0, 12.0, 9.0])
    lines = ["t,x,y,z,p,q,r,u,v,w"]
    for k in range(60):
        tip = [20 * np.sin(k / 9), 10 * np.cos(k / 7), 120.0]
        lines.append(
            ",".join(f"{x:.6f}" for x in (0.05 * k, *tip, *(base + 1e-5 * scale * np.sin(k))))
        )
    doubts = imported(tmp_path, "\n".join(lines) + "\n", BASED % stated).doubts
    named = [doubt for doubt in doubts if doubt.startswith("base: span")]
    assert bool(named) == (said is not None) and all(
        f'set unit = "{said}"' in doubt for doubt in named
    )
    assert not any(doubt.startswith("markers: span") for doubt in doubts)


READ = """schema = "softmap.mapping/1"
[[log]]
file = "part_*.csv"
time = { column = "t" }
command = { columns = ["a", "b"] }
present = { columns = ["d", "e"] }
current = { columns = ["i", "j"] }
"""


def readings(folder, frozen, begin, end, parts=(0, 300)):
    """Logs of two servos; the column `frozen` keeps its last reading in rows `begin` to before
    `end`.
    """
    rng, paths = np.random.default_rng(3), []
    table = {
        "t": 0.05 * np.arange(300),
        "a": 5 * np.sin(np.arange(300) / 9),
        "b": 4 * np.cos(np.arange(300) / 7),
    }
    table |= {
        "d": 0.9 * table["a"] + rng.normal(0, 0.02, 300),
        "e": 0.9 * table["b"] + rng.normal(0, 0.02, 300),
    }
    table |= {name: 100 + 40 * np.sin(np.arange(300) / 8) + rng.normal(0, 2, 300) for name in "ij"}
    if frozen:
        table[frozen][begin:end] = table[frozen][begin]
    for k, (first, last) in enumerate(zip(parts, parts[1:])):
        rows = [",".join(f"{table[name][row]:.4f}" for name in table) for row in range(first, last)]
        (folder / f"part_{k}.csv").write_text("\n".join([",".join(table), *rows]) + "\n")
        paths.append(folder / f"part_{k}.csv")
    (folder / "map.toml").write_text(READ)
    return import_logs(paths, read_mapping(folder / "map.toml")).doubts


@pytest.mark.parametrize(
    ("column", "name"),
    [("d", "present: column 1"), ("e", "present: column 2"), ("i", "current: column 1")],
)
@pytest.mark.parametrize("parts", [(0, 300), (0, 150, 300), (0, 100, 200, 300)])
def test_a_reading_that_stands_still_while_its_command_moves_is_named(
    tmp_path, column, name, parts
):
    named = [
        doubt
        for doubt in readings(tmp_path, column, 140, 220, parts)
        if "to the last digit" in doubt
    ]
    assert (
        len(named) == 1
        and named[0].startswith(f"{name} repeats")
        and "rows 140 to 219 (7 to 10.95 s)" in named[0]
    )


@pytest.mark.parametrize(("column", "begin", "end"), [("", 0, 0), ("d", 100, 112), ("a", 100, 200)])
def test_readings_that_move_are_not_named(tmp_path, column, begin, end):
    assert not [
        doubt for doubt in readings(tmp_path, column, begin, end) if "to the last digit" in doubt
    ]
