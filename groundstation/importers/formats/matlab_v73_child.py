"""Reads one MATLAB 7.3 file and writes what is in it to standard output as .npz: run by `matlab_v73`, never imported.

Arguments: the file, and the most bytes of numbers in it. It imports nothing of ours, for it runs without our path.

Format: MathWorks, "MAT-File Versions", and HDF5 as MATLAB uses it: a struct is a group, an array of structs a group of arrays of
references, a cell an array of references, all into `#refs#`; arrays are transposed; MATLAB_class tells which is which.
"""

import io
import json
import resource
import sys
from typing import Any

DEEPEST = 16
MOST_NODES = 100_000
CPU_S = 30
OTHER_MEMORY = 2**29  # Python, numpy and HDF5 themselves


class _Hdf5Reader:
    def __init__(self, file: Any, most: int) -> None:
        self.file, self.bytes, self.nodes, self.left_out = file, most, MOST_NODES, 0
        self.arrays: dict[str, Any] = {}

    def node(self, item: Any, depth: int = 0) -> Any:
        """A struct, list, text or array as JSON; None for what is none of them."""
        import h5py

        self.nodes -= 1
        if self.nodes < 0 or depth > DEEPEST:
            raise MemoryError("too many parts")
        made = bytes(item.attrs.get("MATLAB_class", b"")).decode("ascii", "replace")
        if isinstance(item, h5py.Group):
            return self._group(item, depth)
        if item.dtype == h5py.ref_dtype:
            references = self._values(item).T.ravel(order="F")
            return {"list": [self.node(self.file[r], depth + 1) for r in references if r]}
        if item.attrs.get("MATLAB_empty", 0):
            return {"text": ""} if made == "char" else None
        if made == "char":
            return {"text": "".join(map(chr, self._values(item).ravel()[:4096].tolist()))}
        if item.dtype.kind not in "biuf" or made.startswith("function"):
            self.left_out += 1
            return None
        name = f"a{len(self.arrays)}"
        self.arrays[name] = self._values(item).T.astype(float)
        return {"array": name}

    def _group(self, item: Any, depth: int) -> Any:
        fields = {str(n): self.node(item[n], depth + 1) for n in item if not str(n).startswith("#")}
        lists = [v["list"] for v in fields.values() if isinstance(v, dict) and "list" in v]
        plain = [n for n in item if isinstance(fields.get(n), dict) and "MATLAB_class" not in item[n].attrs]
        if lists and len(plain) == len(fields) and len({len(found) for found in lists}) == 1:  # an array of structs
            count = len(lists[0])
            return {"list": [{"struct": {n: v["list"][i] for n, v in fields.items()}} for i in range(count)]}
        return {"struct": fields}

    def _values(self, item: Any) -> Any:
        size = item.dtype.itemsize
        for n in item.shape:
            size *= int(n)
        self.bytes -= 8 * size // max(1, item.dtype.itemsize)  # as they are kept, in double precision
        if self.bytes < 0:
            raise MemoryError("larger than allowed")
        return item[()]


def main(path: str, most: int) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        import h5py
        import numpy as np
    except ModuleNotFoundError:
        sys.exit(3)
    resource.setrlimit(resource.RLIMIT_DATA, (OTHER_MEMORY + 4 * most, OTHER_MEMORY + 4 * most))
    with h5py.File(path, "r") as file:
        reader = _Hdf5Reader(file, most)
        variables = {str(n): reader.node(file[n]) for n in file if not str(n).startswith("#")}
    out = io.BytesIO()
    tree = json.dumps({"variables": variables, "left_out": reader.left_out})
    np.savez(out, tree=np.array(tree), **reader.arrays)
    sys.stdout.buffer.write(out.getvalue())


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
