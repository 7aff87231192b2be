"""Whole runs: a flight through the real logger, bench recordings, campaigns, and flights without the hardware."""
