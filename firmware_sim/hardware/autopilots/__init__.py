"""Autopilots between receiver and servos, at the level of MAVLink messages: an ArduPlane and a PX4."""
