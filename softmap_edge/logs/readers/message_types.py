"""Definitions of common ROS 2 messages, for recordings without them (rosbag2's .db3 to Humble).

Only types with the same fields in every distribution from Dashing to Lyrical are included; for any
other the recording must contain the definition. Reference: the .msg files of common_interfaces,
geometry2 and control_msgs.
"""

from __future__ import annotations

import re

_NUMBERS = (
    "Bool:bool Byte:byte Char:char Float32:float32 Float64:float64 Int8:int8 Int16:int16 "
    "Int32:int32 Int64:int64"
)
_NUMBERS += " UInt8:uint8 UInt16:uint16 UInt32:uint32 UInt64:uint64"
_HEADER = "std_msgs/Header header"
_XYZ = "float64 x, float64 y, float64 z"
_TYPES = {
    "std_msgs/Header": "builtin_interfaces/Time stamp, string frame_id",
    "std_msgs/String": "string data",
    "std_msgs/ColorRGBA": "float32 r, float32 g, float32 b, float32 a",
    "std_msgs/MultiArrayDimension": "string label, uint32 size, uint32 stride",
    "std_msgs/MultiArrayLayout": "MultiArrayDimension[] dim, uint32 data_offset",
    "geometry_msgs/Point": _XYZ,
    "geometry_msgs/Point32": "float32 x, float32 y, float32 z",
    "geometry_msgs/Vector3": _XYZ,
    "geometry_msgs/Quaternion": f"{_XYZ}, float64 w",
    "geometry_msgs/Pose": "Point position, Quaternion orientation",
    "geometry_msgs/Pose2D": "float64 x, float64 y, float64 theta",
    "geometry_msgs/PoseArray": f"{_HEADER}, Pose[] poses",
    "geometry_msgs/Polygon": "Point32[] points",
    "geometry_msgs/PolygonStamped": f"{_HEADER}, Polygon polygon",
    "geometry_msgs/Transform": "Vector3 translation, Quaternion rotation",
    "geometry_msgs/TransformStamped": f"{_HEADER}, string child_frame_id, Transform transform",
    "geometry_msgs/Twist": "Vector3 linear, Vector3 angular",
    "geometry_msgs/Accel": "Vector3 linear, Vector3 angular",
    "geometry_msgs/Wrench": "Vector3 force, Vector3 torque",
    "geometry_msgs/PoseWithCovariance": "Pose pose, float64[36] covariance",
    "geometry_msgs/TwistWithCovariance": "Twist twist, float64[36] covariance",
    "sensor_msgs/JointState": (
        f"{_HEADER}, string[] name, float64[] position, float64[] velocity, float64[] effort"
    ),
    "sensor_msgs/Imu": (
        f"{_HEADER}, geometry_msgs/Quaternion orientation, float64[9] orientation_covariance, "
        "geometry_msgs/Vector3 angular_velocity, float64[9] angular_velocity_covariance, "
        "geometry_msgs/Vector3 linear_acceleration, float64[9] linear_acceleration_covariance"
    ),
    "sensor_msgs/MagneticField": f"{_HEADER}, geometry_msgs/Vector3 magnetic_field, "
    "float64[9] magnetic_field_covariance",
    "sensor_msgs/Temperature": f"{_HEADER}, float64 temperature, float64 variance",
    "sensor_msgs/FluidPressure": f"{_HEADER}, float64 fluid_pressure, float64 variance",
    "sensor_msgs/RelativeHumidity": f"{_HEADER}, float64 relative_humidity, float64 variance",
    "sensor_msgs/Illuminance": f"{_HEADER}, float64 illuminance, float64 variance",
    "sensor_msgs/Joy": f"{_HEADER}, float32[] axes, int32[] buttons",
    "sensor_msgs/ChannelFloat32": "string name, float32[] values",
    "sensor_msgs/PointCloud": (
        f"{_HEADER}, geometry_msgs/Point32[] points, ChannelFloat32[] channels"
    ),
    "sensor_msgs/MultiDOFJointState": (
        f"{_HEADER}, string[] joint_names, geometry_msgs/Transform[] transforms, "
        "geometry_msgs/Twist[] twist, geometry_msgs/Wrench[] wrench"
    ),
    "nav_msgs/Odometry": (
        f"{_HEADER}, string child_frame_id, geometry_msgs/PoseWithCovariance pose, "
        "geometry_msgs/TwistWithCovariance twist"
    ),
    "nav_msgs/Path": f"{_HEADER}, geometry_msgs/PoseStamped[] poses",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "trajectory_msgs/JointTrajectoryPoint": (
        "float64[] positions, float64[] velocities, float64[] accelerations, "
        "float64[] effort, builtin_interfaces/Duration time_from_start"
    ),
    "trajectory_msgs/JointTrajectory": (
        f"{_HEADER}, string[] joint_names, JointTrajectoryPoint[] points"
    ),
    "control_msgs/InterfaceValue": "string[] interface_names, float64[] values",
    "control_msgs/DynamicJointState": (
        f"{_HEADER}, string[] joint_names, InterfaceValue[] interface_values"
    ),
}
for _pair in _NUMBERS.split():
    _name, _, _kind = _pair.partition(":")
    _TYPES[f"std_msgs/{_name}"] = f"{_kind} data"
    if _name not in ("Bool", "Char"):
        _TYPES[f"std_msgs/{_name}MultiArray"] = f"MultiArrayLayout layout, {_kind}[] data"
for _name in ("Point", "Vector3", "Quaternion", "Pose", "Twist", "Accel", "Wrench"):
    _TYPES[f"geometry_msgs/{_name}Stamped"] = (
        f"{_HEADER}, {_name} {_name.removesuffix('3').lower()}"
    )
for _name in ("Pose", "Twist"):
    _TYPES[f"geometry_msgs/{_name}WithCovarianceStamped"] = (
        f"{_HEADER}, {_name}WithCovariance {_name.lower()}"
    )


def known_definition(name: str) -> str | None:
    """Return a common type's definition as rosbag2 writes it; None for another type.

    It includes the definitions of contained types.

    Args:
        name: the type, such as `sensor_msgs/msg/JointState`.
    """
    first = name.replace("/msg/", "/")
    if first not in _TYPES:
        return None
    asked = [first]
    for owner in asked:  # grows: types within types
        asked += [inner for inner in _within(owner) if inner not in asked]
    parts = [
        ("" if k == 0 else f"MSG: {one}\n") + _TYPES[one].replace(", ", "\n")
        for k, one in enumerate(asked)
    ]
    return f"\n{'=' * 80}\n".join(parts)


def _within(owner: str) -> list[str]:
    """Return the types that a type contains."""
    kinds = [re.sub(r"\[\d*\]$", "", field.split()[0]) for field in _TYPES[owner].split(", ")]
    known = [kind if "/" in kind else f"{owner.split('/')[0]}/{kind}" for kind in kinds]
    return [kind for kind in known if kind in _TYPES]
