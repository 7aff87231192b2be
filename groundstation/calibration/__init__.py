"""Calibration: from counts of a raw recording to the SI columns of a flight, and fitting it on the bench."""
