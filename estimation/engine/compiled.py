"""The compiled back end: C of the traced equations by CasADi, an integration loop (`loop.c`), compiled by gcc, called by ctypes.

Libraries are cached (`compiled_library`), so a later process neither traces nor compiles. Without gcc the virtual machine does
the work.

`Chain` applies a step function to the rows of a table, such as a filter to a record: CasADi's virtual machine takes some 30
microseconds for a Kalman step of a flight-path reconstruction and as long again to pass arrays; compiled C takes two. Both
give the same numbers to rounding.
"""

import ctypes
import hashlib
import os
import re
from functools import cached_property, lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import casadi as ca
import numpy as np

from estimation.engine.compiled_library import library_made
from estimation.engine.kernel import Array, SegmentInputs, SegmentMotion, SensitivityColumns
from estimation.engine.trace import Traced, hoist_inputs, trace
from estimation.models import expressions
from estimation.models.parts import ModelStructure

LOOP = Path(__file__).with_name("loop.c")


class CompiledKernel:
    """See `estimation.engine.kernel`; one shared library."""

    label = "compiled"

    def __init__(self, library: ctypes.CDLL, sizes: tuple[int, int, int, int]) -> None:
        pointer = ctypes.c_void_p
        library.integrate.argtypes = [ctypes.c_int] * 4 + [pointer] * 18
        library.integrate.restype = ctypes.c_int
        library.pointwise.argtypes = [ctypes.c_int] + [pointer] * 7
        library.pointwise.restype = None
        self._library = library
        self.sizes = sizes

    def run(
        self,
        drive: SegmentInputs,
        p: Array,
        x0: Array,
        substeps: int,
        columns: SensitivityColumns | None = None,
        gain: Array | None = None,
    ) -> SegmentMotion:
        nx, _, _, ny = self.sizes
        count = drive.dt.size
        x, y = np.empty((count, nx)), np.empty((count, ny))
        n = columns.count if columns is not None else 0
        dy = np.empty((count, ny, n)) if columns is not None else None
        nt = drive.du.shape[2] if columns is not None else 0
        empty: Array = np.zeros(0)
        gain_rows = None if gain is None else np.ascontiguousarray(gain)  # the C code reads it by rows
        finite_samples = self._library.integrate(
            count, substeps, n, nt,
            _pointer(drive.dt), _pointer(drive.u), _pointer(drive.u_mid), _pointer(drive.u_end),
            _pointer(drive.du), _pointer(drive.du_mid), _pointer(drive.du_end),
            _pointer(p), _pointer(x0),
            *((_pointer(columns.parameter), _pointer(columns.state), _pointer(columns.transform), _pointer(columns.gain))
              if columns is not None else (None,) * 4),
            _pointer(gain_rows) if gain_rows is not None else None, _pointer(drive.z),
            _pointer(x), _pointer(y), _pointer(dy) if dy is not None else _pointer(empty),
        )  # fmt: skip
        return SegmentMotion(x, y, dy, int(finite_samples))

    def evaluate(self, x: Array, u: Array, p: Array) -> tuple[Array, Array, Array, Array]:
        nx, _, np_, ny = self.sizes
        count = x.shape[0]
        f, fp = np.empty((count, nx)), np.empty((count, nx, np_))
        y, yp = np.empty((count, ny)), np.empty((count, ny, np_))
        x, u = np.ascontiguousarray(x), np.ascontiguousarray(u)
        self._library.pointwise(count, *(_pointer(a) for a in (x, u, p, f, fp, y, yp)))
        return f, fp, y, yp


def _pointer(array: np.ndarray) -> int:  # type: ignore[type-arg]
    return array.ctypes.data


def compile_kernel(structure: ModelStructure) -> CompiledKernel | None:
    """The compiled back end, compiled now where it is not cached; None where there is no working compiler."""
    library = library_made(lambda: _kernel_source(trace(structure)), structure.digest, _generator_digest())
    return None if library is None else CompiledKernel(library, structure.sizes)


@lru_cache(maxsize=1)
def _generator_digest() -> str:
    """Digest of the code that, with the equations, determines a library."""
    parts = (LOOP, LOOP.with_name("trace.py"), Path(__file__), Path(expressions.__file__))
    return hashlib.sha256(b"".join(p.read_bytes() for p in parts)).hexdigest()


def _kernel_source(traced: Traced) -> str:
    """C of the traced functions, their sizes and sparsity patterns, and the integration loop."""
    rates = [hoist_inputs(f, traced.sizes) for f in (traced.rates, traced.rates_jacobian, traced.rates_by_all)]
    functions = (*(f for pair in rates for f in pair), traced.outputs, traced.outputs_jacobian, traced.outputs_by_all)
    nx, nu, np_, ny = traced.sizes
    parts = [_without_null_checks(_generated_c(*functions))]
    parts.append(f"enum {{ NX = {nx}, NU = {nu}, NP = {np_}, NY = {ny} }};")
    for key, (rows, columns) in traced.patterns.items():
        parts.append(f"enum {{ NZ_{key} = {len(rows)} }};")
        for name, values in (("row", rows), ("col", columns)):
            parts.append(f"static const int {name}_{key}[] = {{ {', '.join(map(str, values)) or '0'} }};")
    work = max(sum(max(getattr(f, size)(), 1) for size in ("sz_arg", "sz_res", "sz_iw", "sz_w")) for f in functions)
    hoisted_size = max(hoist.size1_out(0) for _, hoist in rates)
    parts.append(f"enum {{ WORK = {work + 16}, HOISTED = {hoisted_size + 1} }};")
    parts.append(LOOP.read_text(encoding="utf-8"))
    return "\n".join(parts)


def _generated_c(*functions: ca.Function) -> str:
    """C of CasADi functions."""
    with TemporaryDirectory() as folder:
        generator = ca.CodeGenerator("generated.c", {"with_export": False, "casadi_int": "int"})
        for function in functions:
            generator.add(function)
        generator.generate(folder + os.sep)
        return (Path(folder) / "generated.c").read_text(encoding="utf-8")


def _without_null_checks(source: str) -> str:
    """CasADi's C without its checks for null arguments and results: `loop.c` passes all of them. Saves a tenth of the time."""
    source = re.sub(r"arg\[(\d+)\] ?\? ?(arg\[\1\]\[\d+\]) : 0", r"\2", source)
    return re.sub(r"if \(res\[\d+\] ?!= ?0\) ", "", source)


CHUNK = 256  # rows per call of the accumulated function, where there is no compiler
_LOOP = """
#include <math.h>
int chain(int rows, int nx, int nd, int ny, const double *start, const double *data, const double *fixed, double *out)
{
    const casadi_real *arg[%(arg)d]; casadi_real *res[%(res)d];
    casadi_int iw[%(iw)d]; casadi_real w[%(w)d];
    casadi_real state[2][%(nx)d];
    int k, i, now = 0;
    for (i = 0; i < nx; i++) state[0][i] = start[i];
    for (k = 0; k < rows; k++, now = 1 - now) {
        arg[0] = state[now]; arg[1] = data + (long)k * nd; arg[2] = fixed;
        res[0] = state[1 - now]; res[1] = out + (long)k * ny;
        %(name)s(arg, res, iw, w, 0);
        for (i = 0; i < ny; i++) if (!isfinite(out[(long)k * ny + i])) return k;
    }
    return rows;
}
"""


class Chain:
    """step: a dense function (state (nx,), row (nd,), fixed (nf,)) -> (state of the next row (nx,), outputs (ny,))."""

    def __init__(self, step: ca.Function) -> None:
        self._step = step
        self._sizes = step.numel_in(0), step.numel_in(1), step.numel_out(1)

    def run(self, start: Array, rows: Array, fixed: Array) -> Array:
        """(N, ny) outputs at each row, or those up to the first row with one that is not finite.

        start: (nx,); rows: (N, nd); fixed: (nf,), the same at every row.
        """
        compiled = self._compiled
        return self._accumulated(start, rows, fixed) if compiled is None else self._looped(compiled, start, rows, fixed)

    @cached_property
    def _compiled(self) -> ctypes.CDLL | None:
        source = _chain_source(self._step)
        library = library_made(lambda: source, source)
        if library is None:
            return None
        library.chain.argtypes = [ctypes.c_int] * 4 + [ctypes.c_void_p] * 4
        library.chain.restype = ctypes.c_int
        return library

    def _looped(self, library: ctypes.CDLL, start: Array, rows: Array, fixed: Array) -> Array:
        nx, nd, ny = self._sizes
        arguments = [np.ascontiguousarray(a, np.float64) for a in (start, rows, fixed)]
        outputs = np.empty((len(rows), ny))
        last = library.chain(len(rows), nx, nd, ny, *(a.ctypes.data for a in (*arguments, outputs)))
        return outputs[: last + 1]

    @cached_property
    def _many(self) -> ca.Function:
        return self._step.mapaccum(CHUNK)

    def _accumulated(self, start: Array, rows: Array, fixed: Array) -> Array:
        """As `run`, on the virtual machine, CHUNK rows at a time."""
        count = len(rows)
        # rows of zeros fill up the last chunk; they do not change earlier outputs
        table = np.vstack([rows, np.zeros((-count % CHUNK, rows.shape[1]))]).T
        parameters = np.tile(fixed[:, None], (1, CHUNK))
        state, parts = start, []
        for first in range(0, table.shape[1], CHUNK):
            states, block = self._many(state, table[:, first : first + CHUNK], parameters)
            parts.append(np.asarray(block))
            state = np.asarray(states)[:, -1]
            if not np.all(np.isfinite(parts[-1][:, : count - first])):
                break
        outputs = np.hstack(parts).T[:count]
        broken = np.flatnonzero(~np.isfinite(outputs).all(axis=1))
        return outputs[: broken[0] + 1] if broken.size else outputs


def _chain_source(step: ca.Function) -> str:
    sizes = {"arg": step.sz_arg(), "res": step.sz_res(), "iw": step.sz_iw(), "w": step.sz_w()}
    lengths = {key: value + 1 for key, value in sizes.items()}  # C has no arrays of length zero
    return _generated_c(step) + _LOOP % {**lengths, "nx": step.numel_in(0), "name": step.name()}
