"""Bytes and frames between two ends, used by both: ports that never wait, MAVLink framing, signing."""
