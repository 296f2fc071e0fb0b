"""Text exports of Qualisys, Vicon, LabVIEW and the older OptiTrack: names, units, rates, and what
is damaged.
"""

import numpy as np
import pytest
from bench_rows import NAMES, STEP, rows, values, write

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.table import open_log

TIP = np.array([values(k)[2:] for k in range(40)])
TIPS = [",".join(f"{x:.3f}" for x in row) for row in TIP]
MIDS = [",".join(f"{x:.3f}" for x in row / 2) for row in TIP]


def imported(path):
    """The run of the mapping that is proposed."""
    return import_logs([path], parse_mapping(guess_mapping([path]).text, path)).run


# --- Qualisys ------------------------------------------------------------------------------
QTM = [
    "NO_OF_FRAMES\t40",
    "NO_OF_CAMERAS\t8",
    "NO_OF_MARKERS\t2",
    "FREQUENCY\t20",
    "NO_OF_ANALOG\t0",
    "DESCRIPTION\t--",
]
QTM += [
    "TIME_STAMP\t2031-05-07, 10:15:00.000\t12.345",
    "DATA_INCLUDED\t3D",
    "MARKER_NAMES\tmid\ttip",
]


def qtm_rows(lead=lambda k: ""):
    return [lead(k) + f"{MIDS[k]},{TIPS[k]}".replace(",", "\t") for k in range(40)]


@pytest.mark.parametrize(
    "lines",
    [
        [*QTM, *qtm_rows()],
        [*QTM, *(line + "\t" for line in qtm_rows())],
        [*QTM, "TRAJECTORY_TYPES\tMeasured\tMixed", *qtm_rows()],
        [
            *QTM,
            "Frame\tTime\tmid X\tmid Y\tmid Z\ttip X\ttip Y\ttip Z",
            *qtm_rows(lambda k: f"{k + 1}\t{STEP * k:.5f}\t"),
        ],
        [
            *QTM[1:3],
            *QTM[3:],
            "Frame\tmid X\tmid Y\tmid Z\ttip X\ttip Y\ttip Z",
            *qtm_rows(lambda k: f"{k + 1}\t"),
        ],
    ],
)
def test_a_tsv_of_qualisys(tmp_path, lines):
    run = imported(write(tmp_path / "qtm.tsv", lines))
    assert list(run.extra["marker_labels"]) == ["mid", "tip"] and run.frames == 40
    assert np.diff(run.t_seen) == pytest.approx(STEP)
    size = np.linalg.norm(run.markers[:, 1] - run.markers[:, 0], axis=1)
    assert size == pytest.approx(np.linalg.norm(TIP / 2, axis=1), abs=2e-3)  # mm


def test_bodies_of_qualisys(tmp_path):
    head = [
        "NO_OF_FRAMES\t40",
        "NO_OF_BODIES\t1",
        "FREQUENCY\t20",
        "DATA_INCLUDED\t6D",
        "BODY_NAMES\tplate",
    ]
    rest = "\t0\t0\t0\t0.1" + "\t1\t0\t0\t0\t1\t0\t0\t0\t1"
    path = write(tmp_path / "qtm.tsv", head, [line.replace(",", "\t") + rest for line in TIPS])
    columns = open_log(path)
    assert columns.names[:4] == ["plate.x", "plate.y", "plate.z", "plate.rotation.roll"]
    assert (
        columns.read([0, 1, 2]).numbers == pytest.approx(TIP, abs=6e-4)
        and columns.units["plate.x"] == "mm"
    )


# --- Vicon ---------------------------------------------------------------------------------
def nexus(names, *columns):
    head = [
        ",," + ",".join(f"{name},," for name in names),
        "Frame,Sub Frame," + ",".join(["X,Y,Z"] * len(names)),
    ]
    lines = [f"{k + 1},0," + ",".join(column[k] for column in columns) for k in range(40)]
    return ["Trajectories", "20", *head, ",," + ",".join(["mm,mm,mm"] * len(names)), *lines]


DEVICES = ["Devices", "1000", ",,Force plate,,", "Frame,Sub Frame,Fx,Fy,Fz", ",,N,N,N"]
DEVICES += [f"{k // 50 + 1},{k % 50},1.5,2.5,3.5" for k in range(2000)]


@pytest.mark.parametrize(
    "above",
    [[], [*DEVICES, ""], ["Devices,,,,", "1000,,,,", "Frame,Sub Frame,F", ",,N", "1,0,2", ""]],
)
@pytest.mark.parametrize(
    "below", [[], ["", "Model Outputs", "20", "Frame,Sub Frame,a", ",,deg", "1,0,7"]]
)
def test_trajectories_of_nexus(tmp_path, above, below):
    path = write(
        tmp_path / "nexus.csv", above, nexus(["robot:mid", "robot:tip"], MIDS, TIPS), below
    )
    columns = open_log(path)
    assert columns.units["robot:tip.X"] == "mm"
    run = imported(path)
    assert list(run.extra["marker_labels"]) == ["robot:mid", "robot:tip"]
    assert run.frames == 40 and run.t_seen == pytest.approx(STEP * np.arange(40))


def test_one_marker_of_nexus_keeps_its_name(tmp_path):
    assert list(
        imported(write(tmp_path / "a.csv", nexus(["tip"], TIPS))).extra["marker_labels"]
    ) == ["tip"]


def test_nexus_without_trajectories_names_what_it_holds(tmp_path):
    with pytest.raises(RunError, match="holds Devices and no section Trajectories"):
        open_log(write(tmp_path / "nexus.csv", DEVICES))


# --- LabVIEW -------------------------------------------------------------------------------
def lvm(columns="One", mark="\t", point=".", names=None, delta="0.05"):
    names = names or ["X_Value", *NAMES[1:], "Comment"]
    head = [
        f"LabVIEW Measurement{mark}",
        f"Writer_Version{mark}2",
        "Separator" + {"\t": "\tTab", ",": ",Comma"}[mark],
    ]
    head += [
        f"Decimal_Separator{mark}{point}",
        f"X_Columns{mark}{columns}",
        f"***End_of_Header***{mark}",
        mark,
    ]
    head += [f"Channels{mark}5{mark * 5}", f"Samples{mark}" + mark.join(["40"] * 5)]
    head += [
        f"Delta_X{mark}" + mark.join([delta.replace(".", point)] * 5),
        f"***End_of_Header***{mark * 5}",
    ]
    return [*head, mark.join(names)]


def without_x(lines, mark):
    return [mark + line.split(mark, 1)[1] for line in lines]


def with_x_each(lines, mark):
    return [
        mark.join(f"{line.split(mark)[0]}{mark}{cell}" for cell in line.split(mark)[1:])
        for line in lines
    ]


MULTI = [name for channel in NAMES[1:] for name in ("X_Value", channel)]


@pytest.mark.parametrize(
    "lines",
    [
        [*lvm(), *rows(cut="\t")],
        [*lvm(point=","), *rows(cut="\t", point=",")],
        [*lvm(mark=","), *rows()],
        [*lvm("No"), *without_x(rows(cut="\t"), "\t")],
        [*lvm("No", point=","), *without_x(rows(cut="\t", point=","), "\t")],
        [*lvm("Multi", names=[*MULTI, "Comment"]), *with_x_each(rows(cut="\t"), "\t")],
        [*lvm(), *(line + ("\tstart" if k == 3 else "") for k, line in enumerate(rows(cut="\t")))],
    ],
)
def test_a_measurement_of_labview(tmp_path, lines):
    run = imported(write(tmp_path / "log.lvm", lines))
    assert run.t == pytest.approx(STEP * np.arange(40)) and run.channels == 2
    assert run.command == pytest.approx(np.array([values(k)[:2] for k in range(40)]), abs=6e-4)


def test_a_step_that_is_no_number_is_refused(tmp_path):
    for delta in ("0", "soon", "-1", "nan"):
        with pytest.raises(RunError, match="Delta_X"):
            open_log(
                write(tmp_path / "log.lvm", lvm("No", delta=delta), without_x(rows(cut="\t"), "\t"))
            )


# --- the older OptiTrack -------------------------------------------------------------------
def typed(frames):
    return ['comment,"Export of a tracker"', "righthanded", "info,version,1.1", *frames]


def marker(k, name, number):
    return ",".join(f"{x / 1000:.5f}" for x in TIP[k] * (number / 2)) + f",{number},{name}"


def test_rows_of_types(tmp_path):
    frames = ["frame,0,0.000000,0,0", "frame,1,0.010000,0,0"]
    frames += [
        f"frame,{k},{0.01 * k:.6f},0,2,{marker(k, 'Marker-11', 1)},{marker(k, 'Marker-12', 2)}"
        for k in range(2, 30)
    ]
    path = write(tmp_path / "old.csv", typed(frames))
    run = imported(path)
    assert list(run.extra["marker_labels"]) == ["Marker-11", "Marker-12"] and run.frames == 28
    assert run.t_seen == pytest.approx(0.01 * np.arange(2, 30))
    assert np.linalg.norm(run.markers[0, 1] - run.markers[0, 0]) == pytest.approx(
        np.linalg.norm(TIP[2] / 2), abs=0.1
    )


def test_rows_of_types_keep_markers_by_name_whatever_their_order(tmp_path):
    def row(k):
        seen = [marker(k, "a", 1), marker(k, "b", 2)]
        seen = seen[1:] if k % 5 == 0 else seen
        seen = seen[::-1] if k % 2 else seen
        return f"frame,{k},{0.01 * k},0,{len(seen)},{','.join(seen)}"

    columns = open_log(write(tmp_path / "old.csv", typed(map(row, range(40)))))
    numbers = columns.read([columns.names.index(name) for name in ("a.x", "b.x")]).numbers
    assert numbers[:, 1] == pytest.approx(TIP[:, 0] / 1000, abs=1e-5)
    lost = np.isnan(numbers[:, 0])
    assert list(np.flatnonzero(lost)) == list(range(0, 40, 5)) and np.allclose(
        numbers[~lost, 0], TIP[~lost, 0] / 2000, atol=1e-5
    )


def test_rows_of_types_with_bodies(tmp_path):
    body = "7,0.01,0.02,0.3,0,0,0,1,0,0,0"
    frames = [f"frame,{k},{0.01 * k},1,{body},1,{marker(k, 'tip', 2)}" for k in range(30)]
    columns = open_log(write(tmp_path / "old.csv", typed(frames)))
    assert {"body 7.x", "body 7.rotation.w", "tip.x"} <= set(columns.names) and columns.units[
        "body 7.x"
    ] == "m"


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (
            "frame,3,0.03,0,2,0.1,0.2,0.3,1,a",
            "states 0 bodies and 2 markers and has 10 cells, expected 15",
        ),
        ("frame,3,0.03,x,0", "cell 4: x is not a count"),
        ("frame,3", "cell 4: nothing is not a count"),
        ("frame,3,0.03,0,1,oops,0.2,0.3,1,a", "'oops' is not a number"),
        ("frame,3,0.03,99999,1", "cell .*: nothing is not a count"),
    ],
)
def test_damaged_rows_of_types_are_refused_in_one_line(tmp_path, row, words):
    with pytest.raises(RunError, match=words) as fault:
        open_log(write(tmp_path / "old.csv", typed(["frame,0,0.0,0,0", row])))
    assert "\n" not in str(fault.value)


def test_names_without_end_are_refused(tmp_path):
    frames = [f"frame,{k},{0.01 * k},0,1,0.1,0.2,0.3,{k},m{k}" for k in range(6000)]
    with pytest.raises(RunError, match="more than 2000 names"):
        open_log(write(tmp_path / "old.csv", typed(frames)))


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (
            ["NO_OF_FRAMES\t40", "FREQUENCY\t20", "MARKER_NAMES\ta\tb", "1\t2\t3"],
            "names 2 markers and its rows have 3",
        ),
        (["NO_OF_FRAMES\t40", "FREQUENCY\t20", "MARKER_NAMES\ta"], "holds no frames"),
        (
            ["NO_OF_FRAMES\t40", "FREQUENCY\tfast", "MARKER_NAMES\ta", "1\t2\t3"],
            "states the rate 'fast'",
        ),
        (
            ["NO_OF_FRAMES\t40", "FREQUENCY\t-20", "MARKER_NAMES\ta", "1\t2\t3"],
            "states the rate '-20'",
        ),
        (["NO_OF_FRAMES\t40", "FREQUENCY\t20", "1\t2\t3"], "names 0 markers"),
    ],
)
def test_damaged_heads_of_qualisys(tmp_path, lines, words):
    with pytest.raises(RunError, match=words):
        open_log(write(tmp_path / "qtm.tsv", lines))
