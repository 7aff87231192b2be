"""Significance of hypotheses, nameless signals and gaps, calibrated on simulated nulls."""
