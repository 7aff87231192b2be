"""A linear aircraft for autopilots' simulators, ArduPilot's SITL and Gazebo with PX4: written, proved, and read back."""
