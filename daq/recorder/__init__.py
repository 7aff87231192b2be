"""Scans onto the card without ever making the scan loop wait: segments, their syncing, the counts of slots."""
