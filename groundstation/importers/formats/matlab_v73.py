"""MATLAB 7.3 files, which are HDF5: read by h5py in a process of its own, whose memory and time are limited.

The HDF5 library trusts what a file says of itself; a spoilt one can make it crash, turn in circles or take all memory. There
that ends a child and becomes a sentence here.
"""

import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.matlab_v5 import LEAST_UNPACKED, MOST_TIMES_PACKED

SECONDS = 60
"""For a file; 100 MB take some 2 s."""
_NO_PACKAGE = 3


def read_v73(path: Path) -> tuple[dict[str, Any], int]:
    """Variables by name: dictionaries, lists, texts and arrays of numbers; and how many parts were left out.

    Raises ImportDataError for a file that cannot be read.
    """
    most = max(LEAST_UNPACKED, MOST_TIMES_PACKED * path.stat().st_size)
    child = [
        sys.executable,
        "-I",
        str(Path(__file__).with_name("matlab_v73_child.py")),
        str(path.absolute()),
        str(most),
    ]
    try:
        done = subprocess.run(child, capture_output=True, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired:
        raise ImportDataError(f"{path}: damaged MATLAB 7.3 file (no end after {SECONDS} s); save it anew") from None
    if done.returncode == _NO_PACKAGE:
        raise ImportDataError(
            f"{path}: reading MATLAB 7.3 files needs the package h5py; pip install 'sideslip[ground]'"
        )
    if done.returncode:
        raise ImportDataError(
            f"{path}: damaged MATLAB 7.3 file, or larger than {most} bytes when unpacked; save it anew with -v7"
        )
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as arrays:
        tree = json.loads(str(arrays["tree"]))
        return {n: _built(v, arrays) for n, v in tree["variables"].items()}, int(tree["left_out"])


def _built(node: Any, arrays: Any) -> Any:
    match node:
        case {"array": str(name)}:
            return arrays[name]
        case {"struct": dict(fields)}:
            return {n: _built(v, arrays) for n, v in fields.items()}
        case {"list": list(items)}:
            return [_built(v, arrays) for v in items]
        case {"text": str(text)}:
            return text
    return None
