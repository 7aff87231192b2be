"""A step function applied down the rows of a table: a filter over a record, compiled where there is a compiler.

CasADi's virtual machine takes some 30 microseconds for a Kalman step of a flight-path reconstruction and as long again to hand
arrays over; compiled C takes two. Both give the same numbers to rounding.
"""

import ctypes
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import casadi as ca
import numpy as np

from estimation.engine.compiled import library_of
from estimation.engine.kernel import Array

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
    """step: a dense function (state (nx,), row (nd,), fixed (nf,)) -> (state of the next row, shown (ny,))."""

    def __init__(self, step: ca.Function) -> None:
        self._step = step
        self._sizes = step.numel_in(0), step.numel_in(1), step.numel_out(1)

    def run(self, start: Array, rows: Array, fixed: Array) -> Array:
        """What is shown at each row, (N, ny); fewer rows where a row showed a number that is not finite, that row the last.

        start: (nx,); rows: (N, nd); fixed: (nf,), the same at every row.
        """
        compiled = self._compiled
        return self._accumulated(start, rows, fixed) if compiled is None else self._looped(compiled, start, rows, fixed)

    @cached_property
    def _compiled(self) -> ctypes.CDLL | None:
        path = library_of(_source(self._step))
        if path is None:
            return None
        library = ctypes.CDLL(str(path))
        library.chain.argtypes = [ctypes.c_int] * 4 + [ctypes.c_void_p] * 4
        library.chain.restype = ctypes.c_int
        return library

    def _looped(self, library: ctypes.CDLL, start: Array, rows: Array, fixed: Array) -> Array:
        nx, nd, ny = self._sizes
        given = [np.ascontiguousarray(a, np.float64) for a in (start, rows, fixed)]
        out = np.empty((len(rows), ny))
        reached = library.chain(len(rows), nx, nd, ny, *(a.ctypes.data for a in (*given, out)))
        return out[: reached + 1]

    @cached_property
    def _many(self) -> ca.Function:
        return self._step.mapaccum(CHUNK)

    def _accumulated(self, start: Array, rows: Array, fixed: Array) -> Array:
        count = len(rows)
        # rows of zeros behind the last: they change nothing that is shown before them
        table = np.vstack([rows, np.zeros((-count % CHUNK, rows.shape[1]))]).T
        held = np.tile(fixed[:, None], (1, CHUNK))
        state, parts = start, []
        for first in range(0, table.shape[1], CHUNK):
            states, shown = self._many(state, table[:, first : first + CHUNK], held)
            parts.append(np.asarray(shown))
            state = np.asarray(states)[:, -1]
            if not np.all(np.isfinite(parts[-1][:, : count - first])):
                break
        out = np.hstack(parts).T[:count]
        broken = np.flatnonzero(~np.isfinite(out).all(axis=1))
        return out[: broken[0] + 1] if broken.size else out


def _source(step: ca.Function) -> str:
    with TemporaryDirectory() as folder:
        generator = ca.CodeGenerator("step.c", {"with_export": False, "casadi_int": "int"})
        generator.add(step)
        generator.generate(f"{folder}/")
        text = (Path(folder) / "step.c").read_text(encoding="utf-8")
    sizes = {"arg": step.sz_arg(), "res": step.sz_res(), "iw": step.sz_iw(), "w": step.sz_w()}
    needed = {key: value + 1 for key, value in sizes.items()}  # an array of none is no C
    return text + _LOOP % {**needed, "nx": step.numel_in(0), "name": step.name()}
