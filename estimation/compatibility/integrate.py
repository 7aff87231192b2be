"""The motion that a flight's own accelerations and rates make, integrated without looking at what it is compared with.

This is what a person sees in the figure, as in Figure 7 of the paper. Only the start of each piece is fitted: noise of
the inertial sensors integrates to a drift of metres a second within a minute or so, so a long record is shown in pieces.
"""

from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from estimation.compatibility.kalman import FilterRecord, rk4
from estimation.engine.chain import CHUNK
from estimation.engine.trace import Traced, trace
from estimation.models.base import Model

Array = NDArray[np.float64]

PIECE_S = 30.0
MOTION = ("u", "v", "w", "phi", "theta", "psi")
_ROUNDS = 4
_STEP = 1e-4  # of each state, for differences: m/s or rad


def integrated(model: Model, record: FilterRecord, p: Array, states: Array, spread: Array) -> Array:
    """(N, ny) outputs of a record integrated from its inputs.

    p: (n,) parameters. states: (N, nx) of the filter, for the starts. spread: (ny,) by which each output is expected to
    differ: weights of the fit of the starts.
    """
    count = len(record.time)
    pieces = max(1, int(np.ceil(count * record.step / PIECE_S)))
    edges = np.linspace(0, count, pieces + 1).astype(int)
    out = [_piece(model, record, slice(a, b), p, states[a], spread) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    return np.vstack(out)


def _piece(model: Model, record: FilterRecord, rows: slice, p: Array, start: Array, spread: Array) -> Array:
    z = record.z[rows]
    known = np.isfinite(z)
    x0 = start.copy()
    moving = [i for i, s in enumerate(model.state_names) if s in MOTION]
    x0[[i for i in range(x0.size) if i not in moving]] = 0.0  # errors of the attitude filter are no motion
    y = _motion(model, record, rows, p, x0)
    for _ in range(_ROUNDS):
        slopes = []
        for i in moving:
            other = x0.copy()
            other[i] += _STEP
            slopes.append(((_motion(model, record, rows, p, other) - y) / _STEP / spread)[known])
        residual = ((z - y) / spread)[known]
        change, *_ = np.linalg.lstsq(np.column_stack(slopes), residual, rcond=1e-8)
        trial = x0.copy()
        trial[moving] += change
        after = _motion(model, record, rows, p, trial)
        if not np.isfinite(after).all() or np.sum(((z - after) / spread)[known] ** 2) > np.sum(residual**2):
            break
        x0, y = trial, after
    return y


def _motion(model: Model, record: FilterRecord, rows: slice, p: Array, x0: Array) -> Array:
    step = _stepper(trace(model.structure))
    u = record.u[rows]
    table = np.hstack([u, np.vstack([u[1:], u[-1:]])]).T
    count = table.shape[1]
    table = np.hstack([table, np.repeat(table[:, -1:], -count % CHUNK, axis=1)])
    constants = np.array([model.constants[n] for n in model.structure.constants_kept])
    fixed = np.tile(np.concatenate([p, constants, [record.step]])[:, None], (1, CHUNK))
    state, outs = x0, []
    for first in range(0, table.shape[1], CHUNK):
        states, out = step(state, table[:, first : first + CHUNK], fixed)
        outs.append(np.asarray(out))
        state = np.asarray(states)[:, -1]
    y = np.hstack(outs).T[:count]
    for name, delay in model.output_delays.items():
        j = model.output_names.index(name)
        late = float(p[model.parameter_names.index(delay)])
        y[:, j] = np.interp(record.time[rows] - late, record.time[rows], y[:, j])
    return np.asarray(y)


@lru_cache(maxsize=16)
def _stepper(traced: Traced) -> ca.Function:
    nx, nu, np_, _ = traced.sizes
    x, u0, u1 = ca.SX.sym("x", nx), ca.SX.sym("u0", nu), ca.SX.sym("u1", nu)
    p, h = ca.SX.sym("p", np_), ca.SX.sym("h")
    ahead = rk4(traced.rates, x, (u0, (u0 + u1) / 2, u1), p, h)
    once = ca.Function("integrate", [x, ca.vertcat(u0, u1), ca.vertcat(p, h)], [ahead, traced.outputs(x, u0, p)])
    return once.mapaccum(CHUNK)
