"""The motion integrated from accelerations and rates alone, for comparison with the measured one (Figure 7 of the paper).

Only the start of each piece is fitted. A long record is integrated in pieces, because noise of the inertial sensors integrates to
a drift of metres per second within about a minute.
"""

from functools import lru_cache

import casadi as ca
import numpy as np

from estimation.compatibility.kalman import FilterRecord
from estimation.engine.compiled import Chain
from estimation.engine.trace import rk4, trace
from estimation.models.base import Model
from estimation.models.parts import ModelStructure
from groundstation.flight import Array

PIECE_S = 30.0
MOTION = ("u", "v", "w", "phi", "theta", "psi")
_ROUNDS = 4
_STEP = 1e-4  # of each state, for differences: m/s or rad
_CONVERGED = 1e-6  # of the sum of squares: a round that lowers it by less moves the motion by a thousandth of its error


def integrated_motion(model: Model, record: FilterRecord, p: Array, states: Array, spread: Array) -> Array:
    """(N, ny) outputs of a record integrated from its inputs.

    p: (n,) parameters. states: (N, nx) of the filter, from which starts are taken. spread: (ny,) expected difference of each
    output, which weights the fit of the starts.
    """
    pieces = record.parts(max(1, int(np.ceil(len(record.time) * record.step / PIECE_S))))
    return np.vstack([_Piece(model, r, p, record.step).fitted(states[r.first - record.first], spread) for r in pieces])


class _Piece:
    """A piece of a record, integrated from a given start. step: sample interval of the record [s]."""

    def __init__(self, model: Model, record: FilterRecord, p: Array, step: float) -> None:
        self.model, self.time, self.z = model, record.time, record.z
        u = record.u
        self._inputs = np.hstack([u, np.vstack([u[1:], u[-1:]])])
        self._fixed = np.concatenate([p, [model.constants[n] for n in model.structure.remaining_constants], [step]])
        self._delays = [
            (model.output_names.index(o), float(p[model.parameter_names.index(d)]))
            for o, d in model.output_delays.items()
        ]

    def fitted(self, start: Array, spread: Array) -> Array:
        """(N, ny) outputs from the start that fits the measured ones best. start: (nx,) first guess."""
        states = [i for i, s in enumerate(self.model.state_names) if s in MOTION]
        x0 = np.zeros_like(start)  # the other states are errors of an attitude filter
        x0[states] = start[states]
        measured = np.isfinite(self.z)
        y = self.motion(x0)
        residual = ((self.z - y) / spread)[measured]
        if not np.isfinite(residual).all():
            return y
        # the motion is nearly linear in its start, so that the slopes at the first one do for every round
        slopes = [((self.motion(x) - y) / _STEP / spread)[measured] for x in x0 + _STEP * np.eye(x0.size)[states]]
        columns = np.column_stack(slopes)
        for _ in range(_ROUNDS):
            change, *_ = np.linalg.lstsq(columns, residual, rcond=1e-8)
            trial = x0.copy()
            trial[states] += change
            outputs = self.motion(trial)
            trial_residual = ((self.z - outputs) / spread)[measured]
            before, after = float(residual @ residual), float(trial_residual @ trial_residual)
            if not np.isfinite(outputs).all() or after > before:
                break
            x0, y, residual = trial, outputs, trial_residual
            if before - after < _CONVERGED * before:
                break
        return y

    def motion(self, x0: Array) -> Array:
        """(N, ny) outputs from a start (nx,); NaN from where they diverge."""
        rows = _chain(self.model.structure).run(x0, self._inputs, self._fixed)
        y = np.full(self.z.shape, np.nan)
        y[: len(rows)] = rows
        for j, delay in self._delays:
            y[:, j] = np.interp(self.time - delay, self.time, y[:, j])
        return y


@lru_cache(maxsize=16)
def _chain(structure: ModelStructure) -> Chain:
    traced = trace(structure)
    nx, nu, np_, _ = traced.sizes
    x, u0, u1 = ca.SX.sym("x", nx), ca.SX.sym("u0", nu), ca.SX.sym("u1", nu)
    p, h = ca.SX.sym("p", np_), ca.SX.sym("h")
    (next_state,) = rk4(lambda states, u: (traced.rates(*states, u, p),), (x,), (u0, (u0 + u1) / 2, u1), h)
    fixed = ca.vertcat(p, h)
    shown = ca.cse([ca.densify(e) for e in (next_state, traced.outputs(x, u0, p))])
    return Chain(ca.Function("integrate", [x, ca.vertcat(u0, u1), fixed], shown))
