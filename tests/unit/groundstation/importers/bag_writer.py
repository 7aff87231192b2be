"""Bags for the importer's tests, written by rosbags: an implementation that has nothing to do with the reader."""

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
START = 1_700_000_000.0
PX4 = {
    "px4_msgs/msg/SensorCombined": "uint64 timestamp\nfloat32[3] gyro_rad\nfloat32[3] accelerometer_m_s2\n",
    "px4_msgs/msg/VehicleAttitude": "uint64 timestamp\nfloat32[4] q\n",
}


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """w, x, y, z of yaw, pitch, roll in turn."""
    a, b, c = roll / 2, pitch / 2, yaw / 2
    return (
        float(np.cos(a) * np.cos(b) * np.cos(c) + np.sin(a) * np.sin(b) * np.sin(c)),
        float(np.sin(a) * np.cos(b) * np.cos(c) - np.cos(a) * np.sin(b) * np.sin(c)),
        float(np.cos(a) * np.sin(b) * np.cos(c) + np.sin(a) * np.cos(b) * np.sin(c)),
        float(np.cos(a) * np.cos(b) * np.sin(c) - np.sin(a) * np.sin(b) * np.cos(c)),
    )


def attitude(t: float) -> tuple[float, float, float]:
    """phi, theta, psi in our axes."""
    return 0.4 * np.sin(0.8 * t), 0.1 + 0.05 * np.sin(0.5 * t), 1.0 + 0.02 * t


def rates(t: float) -> tuple[float, float, float]:
    """p, q, r by differences of the attitude."""
    h = 1e-5
    (f, th, _), d = attitude(t), (np.array(attitude(t + h)) - np.array(attitude(t - h))) / (2 * h)
    return (
        d[0] - np.sin(th) * d[2],
        np.cos(f) * d[1] + np.sin(f) * np.cos(th) * d[2],
        -np.sin(f) * d[1] + np.cos(f) * np.cos(th) * d[2],
    )


def ros_messages() -> list[tuple[str, str, float, Any]]:
    """Topic, type, time and message, of 20 s: x forward, y left, z up; east, north, up."""
    t = STORE.types
    vector, header, stamp = t["geometry_msgs/msg/Vector3"], t["std_msgs/msg/Header"], t["builtin_interfaces/msg/Time"]
    cov = np.zeros(9)
    out = []
    for k in range(400):
        at = 0.05 * k
        time = START + at
        head = header(stamp(int(time), round(1e9 * (time % 1))), "base_link")
        phi, theta, psi = attitude(at)
        p, q, r = rates(at)
        w, x, y, z = quaternion(phi, -theta, np.pi / 2 - psi)
        force = (9.81 * np.sin(theta), 9.81 * np.sin(phi) * np.cos(theta), 9.81 * np.cos(phi) * np.cos(theta))
        imu = t["sensor_msgs/msg/Imu"](
            head, t["geometry_msgs/msg/Quaternion"](x, y, z, w), cov, vector(p, -q, -r), cov,
            vector(force[0], force[1], force[2]), cov,
        )  # fmt: skip
        out.append(("/mavros/imu/data", "sensor_msgs/msg/Imu", time + 0.003, imu))
        twist = t["geometry_msgs/msg/Twist"](vector(7.0, 18.0, 0.5), vector(0.0, 0.0, 0.0))
        out.append(
            (
                "/mavros/local_position/velocity_local",
                "geometry_msgs/msg/TwistStamped",
                time + 0.004,
                t["geometry_msgs/msg/TwistStamped"](head, twist),
            )
        )
        press = t["sensor_msgs/msg/FluidPressure"](head, 95_000.0 + k, 0.0)
        out.append(("/mavros/imu/static_pressure", "sensor_msgs/msg/FluidPressure", time + 0.004, press))
    return out


def write_bag(
    folder: Path, plugin: StoragePlugin, messages: list[tuple[str, str, float, Any]], store: Any = STORE
) -> Path:
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        made: dict[str, Any] = {}
        for topic, kind, time, message in messages:
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(made[topic], round(1e9 * time), store.serialize_cdr(message, kind))
    return next(p for p in folder.iterdir() if p.suffix in (".mcap", ".db3"))
