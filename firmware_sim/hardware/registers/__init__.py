"""The simulated chips at register level, one file each, written from the datasheets named there.

They know nothing of the drivers that read them: both were written from the datasheet, so that a mistake in one shows.
Physical inputs come as functions of time in nanoseconds; what a chip returns are bytes.
"""
