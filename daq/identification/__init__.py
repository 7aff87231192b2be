"""Recursive identification of the lateral derivatives while the aircraft flies; numpy only.

One estimator for three places: on board, at the ground on what came down, and after the flight on a file
(`estimation.estimators.methods.live`). It lives in `daq` because the aircraft may import nothing of the ground's, and both
the ground station and the laboratory may import this room: the same code, so the same numbers from the same samples. It
knows no sensor, no recording and no clock: it is given calibrated samples in SI and radians with their times.

Method (docs/live.md): each interval between two scans is one row of three equations, rolling and yawing moment and side
force, integrated over the interval by the cubic through the four nearest scans; instruments are the same columns of a
motion that is simulated from the measured surfaces. Sources: Soderstrom and Stoica, Instrumental Variable Methods for
System Identification (1983); Morelli and Klein, Aircraft System Identification, 2nd ed., chapters 5 and 8.
"""
