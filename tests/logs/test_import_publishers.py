"""Rows of another publisher or device, which hold nothing that the mapping names, decide about no
other row.
"""

import numpy as np
import pytest
from recordings import JOINT_STATE, TRANSFORMS, joint_state, transforms, write_mcap

from softmap_edge.errors import RunError, differing_times
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs, read_mapping
from softmap_edge.run.run import Run

START = 1_700_000_000.0
ARM, GRIPPER = ("left", "right"), ("gripper_l", "gripper_r")
MAP = """schema = "softmap.mapping/1"
command_unit = "rad"
zero_time = true
[[log]]
topic = "/goal"
time = { column = "time"REPEATED }
command = { columns = ["position[left]", "position[right]"], unit = "rad" }
"""


def two_publishers(folder, ahead=0.0, late=0.0, repeated=""):
    """Import a topic of the arm at 50 Hz and the gripper, whose stamps are ahead of when they are
    logged.
    """
    messages = []
    for k in range(200):
        at = START + 0.02 * k
        messages.append(("/goal", JOINT_STATE, joint_state(at, (0.1 * k, -k), ARM), at))
        messages.append(("/goal", JOINT_STATE, joint_state(at + ahead, (7, 7), GRIPPER), at + late))
    path = write_mcap(folder / "run.mcap", messages)
    (folder / "map.toml").write_text(MAP.replace("REPEATED", repeated))
    return import_logs([path], read_mapping(folder / "map.toml"))


@pytest.mark.parametrize("repeated", ["", ', repeated = "drop"', ', repeated = "spread"'])
@pytest.mark.parametrize("ahead", [0.0, 0.15, -0.15, 3600.0])
def test_messages_of_another_publisher_are_left_out_and_counted(tmp_path, ahead, repeated):
    done = two_publishers(tmp_path, ahead, repeated=repeated)
    assert done.run.t == pytest.approx(0.02 * np.arange(200), abs=1e-6)
    assert done.run.command[:, 1] == pytest.approx(-np.arange(200))
    assert any(
        "200 of 400 messages hold none of the columns that the mapping names" in note
        for note in done.notes
    )


def test_transforms_of_another_node_are_left_out(tmp_path):
    """Its clock is 2 s ahead; a frame in which the marker alone is missing is of this node and is
    not counted.
    """
    messages = []
    for k in range(60):
        at = START + 0.04 * k
        messages.append(
            ("/tf", TRANSFORMS, transforms(at, np.full((1, 3), 0.001 * k), ("tip",)), at)
        )
        messages.append(
            ("/tf", TRANSFORMS, transforms(at + 2.0, np.ones((1, 3)), ("base_link",)), at)
        )
    path = write_mcap(tmp_path / "run.mcap", messages)
    tip = ", ".join(f'"transforms[tip].transform.translation.{axis}"' for axis in "xyz")
    (tmp_path / "map.toml").write_text(
        'schema = "softmap.mapping/1"\n[[log]]\ntopic = "/tf"\ntime = { column = "transforms[tip].header.stamp" }\n'
        f'markers = {{ unit = "m", columns = [[{tip}]] }}\n'
    )
    assert import_logs([path], read_mapping(tmp_path / "map.toml")).run.frames == 60


def test_a_proposed_mapping_takes_the_columns_of_one_publisher(tmp_path):
    two_publishers(tmp_path, 0.15)
    found = guess_mapping([tmp_path / "run.mcap"])
    (tmp_path / "map.toml").write_text(found.text)
    done = import_logs([tmp_path / "run.mcap"], read_mapping(tmp_path / "map.toml"))
    assert done.run.channels == 2 and len(done.run.t) == 200, found.text


def test_columns_of_two_publishers_are_no_command(tmp_path):
    two_publishers(tmp_path, 0.01)
    both = MAP.replace('"position[right]"', '"position[right]", "position[gripper_l]"').replace(
        "REPEATED", ""
    )
    (tmp_path / "map.toml").write_text(both)
    with pytest.raises(
        RunError, match="no row has all commands; name in `command` the columns of one publisher"
    ):
        import_logs([tmp_path / "run.mcap"], read_mapping(tmp_path / "map.toml"))


CSV = """schema = "softmap.mapping/1"
[[log]]
time = { column = "t" }
command = { columns = ["u"], unit = "mm" }
"""


def csv(folder, lines):
    (folder / "log.csv").write_text("t,u,grip\n" + "\n".join(lines) + "\n")
    (folder / "map.toml").write_text(CSV)
    return import_logs([folder / "log.csv"], read_mapping(folder / "map.toml"))


def test_lines_of_another_device_in_one_table_are_left_out(tmp_path):
    lines = [
        line for k in range(50) for line in (f"{0.1 * k:.2f},{k},", f"{0.1 * k - 0.05:.2f},,1")
    ]
    done = csv(tmp_path, lines)
    assert list(done.run.command[:, 0]) == list(range(50))
    assert any("50 of 100 rows hold none of the columns" in note for note in done.notes)


def test_empty_cells_at_times_that_rise_stay_what_they_were(tmp_path):
    done = csv(tmp_path, [f"{0.1 * k:.2f},{k if k % 5 else ''}," for k in range(1, 50)])
    assert "log.csv: 9 of 49 rows have no command and were left out" in [
        f"log.csv: {n}" for n in done.notes
    ]


def test_times_in_errors_differ_where_they_do(tmp_path):
    for step, said in (
        (0.0002, "1700000000.9998 s after 1700000001 s"),
        (0.5, "1700000000.5 s after 1700000001 s"),
    ):
        with pytest.raises(RunError) as fault:
            csv(
                tmp_path,
                ["1700000000,0,", "1700000001,1,", f"{1700000001 - step},2,", "1700000002,3,"],
            )
        assert said in str(fault.value)
    with pytest.raises(
        RunError, match="stands still at row 2 .*: 1700000001.25 s after 1700000001.25 s"
    ):
        csv(tmp_path, ["1700000000,0,", "1700000001.25,1,", "1700000001.25,2,"])
    with pytest.raises(
        RunError,
        match="t_seen: 1700000009 to 1700000010 s lies outside .* 1700000000 to 1700000002 s",
    ):
        Run(
            t=np.array([0.0, 2.0]) + START,
            command=np.zeros((2, 1)),
            t_seen=np.array([9.0, 10.0]) + START,
            markers=np.ones((2, 1, 3)),
            robot="r",
        )


@pytest.mark.parametrize(
    ("times", "texts"),
    [
        ((0.1, 0.2), ["0.1", "0.2"]),
        ((12.5, 13.0), ["12.5", "13"]),
        ((1e-9, 2e-9), ["1e-09", "2e-09"]),
        ((-0.5, 0.0), ["-0.5", "0"]),
        ((1700000000.0000001, 1700000000.0000005), ["1700000000", "1700000000.0000005"]),
    ],
)
def test_times_are_printed_plainly(times, texts):
    assert differing_times(*times) == texts
