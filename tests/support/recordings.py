"""Small recordings in the formats of motion capture and ROS 2, written for the tests of `softmap
import`.
"""

import warnings

import numpy as np

LABELS = ("base", "middle", "tip")
JOINTS = ("left", "right")
_EQUALS = "=" * 80
STAMP = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
VECTOR = "float64 x\nfloat64 y\nfloat64 z\n"
QUATERNION = VECTOR + "float64 w\n"
BAG_START = 1_700_000_000.0  # s since 1970
BAG_MAP = """schema = "softmap.mapping/1"
command_unit = "rad"
zero_time = true
[[log]]
topic = "/goal"
time = { column = "time" }
command = { columns = ["position[left]", "position[right]"], unit = "rad" }
[[log]]
topic = "/poses"
time = { column = "time" }
markers = { unit = "m", columns = [["poses[2].position.x", "poses[2].position.y", "poses[2].position.z"]] }
"""
JOINT_STATE = (
    "sensor_msgs/msg/JointState",
    "# the state of joints\nstd_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] "
    f"velocity\nfloat64[] effort\n{_EQUALS}\n{STAMP}",
)
POSES = (
    "geometry_msgs/msg/PoseArray",
    f"std_msgs/Header header\ngeometry_msgs/Pose[] poses\n{_EQUALS}\n{STAMP}{_EQUALS}\nMSG: "
    f"geometry_msgs/Pose\nPoint position\nQuaternion orientation\n{_EQUALS}\nMSG: "
    f"geometry_msgs/Point\n{VECTOR}{_EQUALS}\nMSG: geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 "
    "y 0\nfloat64 z 0\nfloat64 w 1\n",
)
TRANSFORMS = (
    "tf2_msgs/msg/TFMessage",
    f"geometry_msgs/TransformStamped[] transforms\n{_EQUALS}\nMSG: "
    "geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\nTransform "
    f"transform\n{_EQUALS}\n{STAMP}{_EQUALS}\nMSG: geometry_msgs/Transform\nVector3 "
    f"translation\nQuaternion rotation\n{_EQUALS}\nMSG: "
    f"geometry_msgs/Vector3\n{VECTOR}{_EQUALS}\nMSG: geometry_msgs/Quaternion\n{QUATERNION}",
)


def places(frames=60, rate=100.0, seed=0):
    """Times (K,) s and three markers (K, 3, 3) mm on a hanging robot that bends; noise 0.02 mm."""
    t = np.arange(frames) / rate
    bend = 30 * np.sin(3 * t)[:, None]
    points = np.stack(
        [np.stack([bend[:, 0] * s**2, 0 * t, 120 * s + 0 * t], axis=1) for s in (0.0, 0.5, 1.0)],
        axis=1,
    )
    return t, points + 0.02 * np.random.default_rng(seed).normal(size=points.shape) + [
        0.0,
        0.0,
        5.0,
    ]


def write_trc(path, t, points, unit="mm", labels=LABELS):
    """As OpenSim and QTM write it: tabs after each label, a blank line, an empty cell for what is
    not seen.
    """
    rate = 1 / (t[1] - t[0])
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate:.2f}\t{rate:.2f}\t{len(t)}\t{len(labels)}\t{unit}\t{rate:.2f}\t1\t{len(t)}",
        "Frame#\tTime\t" + "\t\t\t".join(labels) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{k + 1}" for k in range(len(labels)) for axis in "XYZ"),
        "",
    ]
    for k, (time, row) in enumerate(zip(t, points.reshape(len(t), -1))):
        lines.append(
            "\t".join(
                [str(k + 1), f"{time:.5f}", *("" if np.isnan(x) else f"{x:.6f}" for x in row)]
            )
        )
    path.write_text("\n".join(lines) + "\n")
    return path


def write_motive(path, t, points, unit="Meters", labels=LABELS):
    """An export of Motive with a rigid body next to the markers; empty cells for what is not
    seen.
    """
    head = [
        "Format Version",
        "1.23",
        "Take Name",
        "Take 1",
        "Capture Frame Rate",
        "100.000000",
        "Length Units",
        unit,
    ]
    kinds = ["Rigid Body"] * 8 + [kind for _ in labels for kind in ["Marker"] * 3]
    names = ["Plate"] * 8 + [label for label in labels for _ in range(3)]
    what = (
        ["Rotation"] * 4
        + ["Position"] * 3
        + ["Mean Marker Error"]
        + ["Position"] * (3 * len(labels))
    )
    axes = [*"XYZW", *"XYZ", ""] + [*"XYZ"] * len(labels)
    lines = [",".join([*head, "Coordinate Space", "Global"]), "", ",".join(["", "Type", *kinds])]
    lines += [
        ",".join(["", "Name", *names]),
        ",".join(["", "ID", *(f'"{k:X}"' for k in range(len(names)))]),
    ]
    lines += [",".join(["", "", *what]), ",".join(["Frame", "Time (Seconds)", *axes])]
    plate = "0.000000,0.000000,0.000000,1.000000,0.010000,0.020000,0.030000,0.000100"
    for k, (time, row) in enumerate(zip(t, points.reshape(len(t), -1))):
        lines.append(
            ",".join(
                [str(k), f"{time:.6f}", plate, *("" if np.isnan(x) else f"{x:.9f}" for x in row)]
            )
        )
    path.write_text("\n".join(lines) + "\n", encoding="utf-8-sig")
    return path


def write_c3d(path, t, points, unit="mm", labels=LABELS):
    """A C3D file of floating-point coordinates; a residual of -1 for what is not seen."""
    import c3d

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        writer = c3d.Writer(
            point_rate=1 / (t[1] - t[0]), analog_rate=0, point_scale=-1.0, point_units=f"{unit:<4}"
        )
        writer.set_point_labels([f"{label:<32}" for label in labels])
        for row in points:
            lost = np.isnan(row).any(axis=1)
            frame = np.column_stack(
                [np.where(lost[:, None], 0.0, row), np.where(lost, -1.0, 0.1), np.zeros(len(row))]
            )
            writer.add_frames([(frame, np.array([[]]))])
        with path.open("wb") as file:
            writer.write(file)
    return path


def write_mcap(path, messages, compression="zstd"):
    """A recording of (topic, definition, message, s) in their order, as rosbag2 writes it."""
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    kind = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}[
        compression
    ]
    with path.open("wb") as file:
        writer = Writer(file, compression=kind)
        definitions = dict(definition for _, definition, _, _ in messages)
        schemas = {name: writer.register_msgdef(name, text) for name, text in definitions.items()}
        for k, (topic, (name, _), message, seconds) in enumerate(messages):
            if k % 200 == 199:
                writer._writer.flush()  # chunks of 200 messages
            ns = int(round(seconds * 1e9))
            writer.write_message(topic, schemas[name], message, log_time=ns, publish_time=ns)
        writer.finish()
    return path


def header(seconds):
    return {
        "stamp": {"sec": int(seconds), "nanosec": int(round(seconds % 1 * 1e9))},
        "frame_id": "world",
    }


def joint_state(seconds, position, names=JOINTS):
    return {
        "header": header(seconds),
        "name": list(names),
        "position": list(position),
        "velocity": [],
        "effort": [],
    }


def pose_array(seconds, row):
    turned = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    poses = [
        {"position": dict(zip("xyz", map(float, point))), "orientation": turned} for point in row
    ]
    return {"header": header(seconds), "poses": poses}


def transforms(seconds, row, labels=LABELS):
    turned = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    return {
        "transforms": [
            {
                "header": header(seconds),
                "child_frame_id": label,
                "transform": {
                    "translation": dict(zip("xyz", map(float, point))),
                    "rotation": turned,
                },
            }
            for label, point in zip(labels, row)
            if np.isfinite(point).all()
        ]
    }


def robot_messages(frames=60, start=1_700_000_000.0):
    """Goals at 100 Hz, joint states at 50, poses in m at 25 and transforms with dropouts, of one
    robot.
    """
    t, points = places(frames)
    messages = []
    for k, s in enumerate(t):
        goal = np.array([np.sin(3 * s), np.cos(3 * s)])
        messages.append(("/goal", JOINT_STATE, joint_state(start + s, goal), start + s))
        if k % 2 == 0:
            messages.append(
                (
                    "/joint_states",
                    JOINT_STATE,
                    joint_state(start + s, 0.9 * goal),
                    start + s + 0.001,
                )
            )
        if k % 4 == 0:
            row = points[k] / 1000
            messages.append(("/poses", POSES, pose_array(start + s, row), start + s + 0.002))
            seen = np.where((np.arange(3) == 2)[:, None] & (k == 8), np.nan, row)
            messages.append(("/tf", TRANSFORMS, transforms(start + s, seen), start + s + 0.003))
    return messages
