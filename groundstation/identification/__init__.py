"""Live identification on the ground: from received scans, some lost or late, to derivatives and advice as text.

The estimator is `daq.identification`, as on board and over a file. Here the samples of a scan are aligned to one instant and put
in order, and the estimates are compared with prior beliefs: time to the wanted bounds, and what to fly next.
"""
