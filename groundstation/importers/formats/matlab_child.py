"""Reads one MATLAB file and writes its content to standard output as .npz: run by `matlab`, never imported.

Arguments: the file, and the largest number of bytes of its numbers. It runs without Sideslip's path and imports nothing of it.
The libraries trust a file's own sizes and offsets: a damaged one can crash them, loop forever or take all memory, and this
process contains that.

Format: MathWorks, "MAT-File Format" (level 5) and "MAT-File Versions" (7.3: HDF5). In HDF5 as MATLAB uses it a struct is a group,
an array of structs a group of arrays of references, a cell an array of references, all into `#refs#`; arrays are transposed;
the attribute MATLAB_class distinguishes them.
"""

import contextlib
import io
import json
import struct
import sys
import warnings
from collections.abc import Iterator
from typing import Any

DEEPEST = 16  # structs within structs; flight records have three or four
MOST_NODES = 100_000  # arrays within arrays
LONGEST_TEXT = 4096  # letters, in HDF5
CPU_S = 30
OTHER_MEMORY = 2**29  # bytes of Python, numpy, scipy and HDF5 themselves
COPIES = 4  # of the numbers, that reading and writing hold at once
NO_PACKAGE = 3  # exit status
HDF5 = b"\x89HDF\r\n\x1a\n"
V5_HEADER = 128  # bytes


class Tree:
    """Budget and arrays of a file's content, which becomes JSON: {"struct": ...}, {"list": ...}, {"text": ...}, {"array": name}.

    bytes, nodes: that may still come; left_out: number of parts that cannot be read.
    """

    def __init__(self, most_bytes: int) -> None:
        self.bytes, self.nodes, self.left_out = most_bytes, MOST_NODES, 0
        self.arrays: dict[str, Any] = {}

    def count(self, depth: int) -> None:
        """Count one part. Raises MemoryError for one too many."""
        self.nodes -= 1
        if self.nodes < 0 or depth > DEEPEST:
            raise MemoryError("too many parts")

    def reserve(self, elements: int) -> None:
        """Count so many numbers in double precision. Raises MemoryError where they are too many."""
        self.bytes -= 8 * elements
        if self.bytes < 0:
            raise MemoryError("larger than allowed")

    def array(self, values: Any) -> dict[str, str]:
        """Store an array of numbers; returns its node."""
        name = f"a{len(self.arrays)}"
        self.arrays[name] = values.astype(float)
        return {"array": name}


# ---------------------------------------------------------------------------------------------------- MATLAB 5 (-v6, -v7)


def v5_variables(data: bytes, tree: Tree) -> dict[str, Any]:
    """The variables, read one by one, so that a damaged one, or one that only MATLAB can read, affects no other."""
    from scipy.io import loadmat

    variables: dict[str, Any] = {}
    for element in _v5_elements(data):
        try:
            content = loadmat(io.BytesIO(data[:116] + bytes(8) + data[124:V5_HEADER] + element), chars_as_strings=True)
            variables |= {str(n): _v5_node(v, tree) for n, v in content.items() if not str(n).startswith("__")}
        except Exception:  # noqa: BLE001 - whatever the library raises on damage
            tree.left_out += 1
    return variables


def _v5_elements(data: bytes) -> Iterator[bytes]:
    """The data elements of a file, each with its head."""
    order = "<" if data[126:V5_HEADER] == b"IM" else ">"
    start = V5_HEADER
    while start + 8 <= len(data):
        _, size = struct.unpack_from(order + "II", data, start)
        yield data[start : start + 8 + size]
        start += 8 + size


def _v5_node(value: Any, tree: Tree, depth: int = 0) -> Any:
    """The node of a value. Raises ValueError for objects, tables and functions, which only MATLAB reads, and sparse matrices."""
    import numpy as np

    tree.count(depth)
    if type(value) is not np.ndarray:
        raise ValueError(type(value).__name__)
    if value.dtype.names:
        records = [
            {"struct": {n: _v5_node(item[n], tree, depth + 1) for n in value.dtype.names}}
            for item in value.ravel(order="F")
        ]
        return records[0] if len(records) == 1 else {"list": records}
    if value.dtype == object:
        return {"list": [_v5_node(v, tree, depth + 1) for v in value.ravel(order="F")]}
    if value.dtype.kind == "U":
        return {"text": "".join(str(v) for v in value.ravel()[:1])}
    if value.dtype.kind not in "biuf":
        return None
    tree.reserve(value.size)
    return tree.array(value)


# --------------------------------------------------------------------------------------------------------- MATLAB 7.3, HDF5


def hdf5_variables(path: str, tree: Tree) -> dict[str, Any]:
    """The variables of the file, with references followed."""
    import h5py

    with h5py.File(path, "r") as file:
        return {str(n): _hdf5_node(file[n], file, tree) for n in file if not str(n).startswith("#")}


def _hdf5_node(item: Any, file: Any, tree: Tree, depth: int = 0) -> Any:
    """The node of a group or dataset; None for what is no struct, list, text or array."""
    import h5py

    tree.count(depth)
    matlab_class = bytes(item.attrs.get("MATLAB_class", b"")).decode("ascii", "replace")
    if isinstance(item, h5py.Group):
        return _hdf5_group(item, file, tree, depth)
    if item.dtype == h5py.ref_dtype:
        references = _hdf5_values(item, tree).T.ravel(order="F")
        return {"list": [_hdf5_node(file[r], file, tree, depth + 1) for r in references if r]}
    if item.attrs.get("MATLAB_empty", 0):
        return {"text": ""} if matlab_class == "char" else None
    if matlab_class == "char":
        return {"text": "".join(map(chr, _hdf5_values(item, tree).ravel()[:LONGEST_TEXT].tolist()))}
    if item.dtype.kind not in "biuf" or matlab_class.startswith("function"):
        tree.left_out += 1
        return None
    return tree.array(_hdf5_values(item, tree).T)


def _hdf5_group(item: Any, file: Any, tree: Tree, depth: int) -> Any:
    """The node of a struct or of an array of structs."""
    fields = {str(n): _hdf5_node(item[n], file, tree, depth + 1) for n in item if not str(n).startswith("#")}
    lists = [v["list"] for v in fields.values() if isinstance(v, dict) and "list" in v]
    unclassed = [n for n in item if isinstance(fields.get(n), dict) and "MATLAB_class" not in item[n].attrs]
    if lists and len(unclassed) == len(fields) and len({len(entries) for entries in lists}) == 1:  # an array of structs
        return {"list": [{"struct": {n: v["list"][i] for n, v in fields.items()}} for i in range(len(lists[0]))]}
    return {"struct": fields}


def _hdf5_values(item: Any, tree: Tree) -> Any:
    """The content of a dataset, within the budget."""
    elements = 1
    for n in item.shape:
        elements *= int(n)
    tree.reserve(elements)
    return item[()]


def _limit(name: str, value: int) -> None:
    """Limit a resource of this process; without such limits (Windows), the time and sizes that the reader allows remain."""
    try:
        import resource
    except ModuleNotFoundError:
        return
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(getattr(resource, name), (value, value))


def main(path: str, most_bytes: int) -> None:
    """Read the file at `path` and write the .npz."""
    _limit("RLIMIT_CPU", CPU_S)
    _limit("RLIMIT_CORE", 0)
    with open(path, "rb") as file:
        data = file.read()
    hdf5 = HDF5 in (data[:8], data[512:520])
    try:
        import numpy as np

        if hdf5:
            import h5py  # noqa: F401 - before memory is limited
        else:
            import scipy.io  # noqa: F401
    except ModuleNotFoundError:
        sys.exit(NO_PACKAGE)
    _limit("RLIMIT_DATA", OTHER_MEMORY + COPIES * most_bytes)
    warnings.simplefilter("ignore")
    tree = Tree(most_bytes)
    variables = hdf5_variables(path, tree) if hdf5 else v5_variables(data, tree)
    text = json.dumps({"variables": variables, "left_out": tree.left_out})
    archive = io.BytesIO()
    np.savez(archive, tree=np.array(text), **tree.arrays)
    sys.stdout.buffer.write(archive.getvalue())


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
