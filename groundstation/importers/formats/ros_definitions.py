"""Definitions of the ROS 2 messages that aircraft log, for bags that carry none (rosbag2 before Iron).

Source: ros2/common_interfaces and mavlink/mavros, .msg files; comments and constants left out.
"""

from collections.abc import Mapping

_LINE = "=" * 80
_STAMP = "int32 sec\nuint32 nanosec\n"
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"
_PARTS: Mapping[str, str] = {
    "builtin_interfaces/Time": _STAMP,
    "std_msgs/Header": _HEADER,
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "sensor_msgs/NavSatStatus": "int8 status\nuint16 service\n",
}
_MESSAGES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "sensor_msgs/msg/Imu": (
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
        ("geometry_msgs/Quaternion", "geometry_msgs/Vector3"),
    ),
    "sensor_msgs/msg/NavSatFix": (
        "std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\nfloat64 altitude\n"
        "float64[9] position_covariance\nuint8 position_covariance_type\n",
        ("sensor_msgs/NavSatStatus",),
    ),
    "sensor_msgs/msg/FluidPressure": ("std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance\n", ()),
    "sensor_msgs/msg/Temperature": ("std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n", ()),
    "geometry_msgs/msg/Vector3Stamped": ("std_msgs/Header header\ngeometry_msgs/Vector3 vector\n", ("geometry_msgs/Vector3",)),
    "geometry_msgs/msg/QuaternionStamped": (
        "std_msgs/Header header\ngeometry_msgs/Quaternion quaternion\n",
        ("geometry_msgs/Quaternion",),
    ),
    "geometry_msgs/msg/TwistStamped": (
        "std_msgs/Header header\ngeometry_msgs/Twist twist\n", ("geometry_msgs/Twist", "geometry_msgs/Vector3"),
    ),
    "geometry_msgs/msg/PoseStamped": (
        "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
        ("geometry_msgs/Pose", "geometry_msgs/Point", "geometry_msgs/Quaternion"),
    ),
    "mavros_msgs/msg/VfrHud": (
        "std_msgs/Header header\nfloat32 airspeed\nfloat32 groundspeed\nint16 heading\nfloat32 throttle\n"
        "float32 altitude\nfloat32 climb\n",
        (),
    ),
    "mavros_msgs/msg/RCOut": ("std_msgs/Header header\nuint16[] channels\n", ()),
    "mavros_msgs/msg/RCIn": ("std_msgs/Header header\nuint8 rssi\nuint16[] channels\n", ()),
}  # fmt: skip


def _with_parts(text: str, parts: tuple[str, ...]) -> str:
    """A definition followed by those of its parts."""
    names = ("std_msgs/Header", "builtin_interfaces/Time", *parts)
    return text + "".join(f"{_LINE}\nMSG: {n}\n{_PARTS[n]}" for n in names)


STANDARD: Mapping[str, str] = {name: _with_parts(*message) for name, message in _MESSAGES.items()}
"""Type -> its definition with those of its parts, in the form that MCAP uses."""
