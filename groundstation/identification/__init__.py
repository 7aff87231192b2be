"""Live identification at the ground: from scans as they come down, with losses and late ones, to derivatives in words.

The estimator itself is `daq.identification`, the same that runs on board and over a file. Here scans are brought to one
instant each, put in order, and what comes out is said: against belief, how long until a wanted bound, what to fly next.
"""
