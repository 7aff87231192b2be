"""Which files `sideslip import` reads, by the ending of their names; those of installed packages come on top."""

TABLES = (".csv", ".txt", ".tsv", ".asc", ".dat", ".parquet", ".mat")
LOGS = {".ulg": "px4", ".ulog": "px4", ".bin": "ardupilot", ".log": "ardupilot", ".tlog": "mavlink"}
"""Logs of autopilots -> the built-in map of their channels."""

BAGS = (".mcap", ".db3")
"""MCAP files and ROS 2 bags of other programs; our own recordings and flights are MCAP files, too."""

FOREIGN = frozenset({".csv", ".parquet", ".mat", ".ulg", ".ulog", ".tlog"})
"""Those that no recording of ours has; what a rescue tool writes may be called .bin, .dat or .txt."""
