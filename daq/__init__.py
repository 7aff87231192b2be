"""What runs on the aircraft: sensors over the bus, 20 Hz scans, MCAP recorder, MAVLink downlink."""
