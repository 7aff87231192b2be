"""A process beside the logger that is given every scan and answers with numbers: live identification on board.

It needs the calibration and the aircraft file, which the logger does not know, and may take its time; so it is another process on
another core, behind a pipe that never makes the loop wait. Whatever becomes of it, the recording goes on.
"""
