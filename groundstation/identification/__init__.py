"""Live identification on the ground: from received scans, some lost or late, to derivatives and advice as text.

The estimator is `daq.identification`, as on board and over a file. This package aligns the samples of a scan to one instant,
sorts them, and compares the estimates with prior beliefs: time to the wanted bounds, and what to fly next.
"""
