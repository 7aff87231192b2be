"""Autopilots at the level of MAVLink messages: an ArduPlane, and one that reports its servo outputs."""
