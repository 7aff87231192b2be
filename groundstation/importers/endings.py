"""Files that `sideslip import` reads, by ending and first bytes (installed packages may add more), and advice on others."""

TABLES = (".csv", ".txt", ".tsv", ".asc", ".dat", ".parquet", ".mat")
LOGS = {".ulg": "px4", ".ulog": "px4", ".bin": "ardupilot", ".log": "ardupilot", ".tlog": "mavlink"}
"""Logs of autopilots -> the built-in map of their channels."""

BAGS = (".mcap", ".db3")
"""ROS 2 bags and MCAP files of other programs; Sideslip's recordings and flights are MCAP files, too."""

FOREIGN = frozenset({".csv", ".parquet", ".mat", ".ulg", ".ulog", ".tlog"})
"""Endings that no recording of Sideslip has; a file rescued from a damaged disk may be called .bin, .dat or .txt."""

ULOG_MAGIC = b"ULog\x01\x12\x35"
SQLITE_MAGIC = b"SQLite format 3\0"

_PACKED = "packed; unpack it ('{tool} {{file}}') and import what was in it"
OTHERS = {
    ".bag": "a ROS 1 bag; 'rosbags-convert --src {file} --dst {stem}' (pip install rosbags) makes a folder of it that is read",
    ".zstd": _PACKED.format(tool="zstd -d"),
    ".zst": _PACKED.format(tool="zstd -d"),
    ".lz4": _PACKED.format(tool="lz4 -d"),
    ".gz": _PACKED.format(tool="gunzip"),
    ".xz": _PACKED.format(tool="xz -d"),
    ".bz2": _PACKED.format(tool="bunzip2"),
    ".zip": _PACKED.format(tool="unzip"),
    ".7z": _PACKED.format(tool="7z x"),
    ".xlsx": "an Excel workbook; save its sheet as CSV UTF-8 and import that",
    ".xls": "an Excel workbook; save its sheet as CSV UTF-8 and import that",
    ".ods": "a spreadsheet; save its sheet as CSV and import that",
    ".json": "JSON is not read; write its records as a table (pandas: read_json, to_csv) and import that",
    ".bbl": "a Betaflight blackbox; 'blackbox_decode {file}' makes a CSV of it",
    ".bfl": "a Betaflight blackbox; 'blackbox_decode {file}' makes a CSV of it",
    ".tdms": "a LabVIEW file; write its channels as a table (npTDMS: as_dataframe, to_csv) and import that",
    ".mf4": "an ASAM MDF file; write its channels as a table (asammdf: to_dataframe, to_csv) and import that",
    ".h5": "HDF5 of no layout that is known; write its channels as a table, or as a MATLAB 7.3 file (.mat)",
    ".hdf5": "HDF5 of no layout that is known; write its channels as a table, or as a MATLAB 7.3 file (.mat)",
    ".pkl": "a pickle runs code when it is read, so it is not; write the frame by to_parquet or to_csv",
    ".npz": "numpy's arrays are not read; write them as a table (pandas: DataFrame, to_csv) or as .mat (scipy: savemat)",
    ".npy": "numpy's arrays are not read; write them as a table (numpy: savetxt, with a header) or as .mat (scipy: savemat)",
}
"""Endings of other common files -> what they are, and how to convert them."""

BEGINNINGS: dict[bytes, tuple[str, tuple[str, ...]]] = {
    ULOG_MAGIC: ("a PX4 ULog", (".ulg", ".ulog")),
    b"\x89MCAP0\r\n": ("an MCAP file", BAGS),
    SQLITE_MAGIC: ("an SQLite bag", BAGS),
    b"PAR1": ("a Parquet table", (".parquet",)),
    b"PK\x03\x04": ("an Excel workbook or another packed file", (".xlsx, and save its sheet as CSV",)),
}
"""First bytes -> kind of the file, and its usual endings."""
