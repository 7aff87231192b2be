"""A linear aircraft for the simulators of autopilots, ArduPilot's and Gazebo with PX4: written, proved, and read back."""
