"""A model moved by the steps that JSBSim takes, so that a comparison with JSBSim sees equations and not integrators.

JSBSim's rule of the proof is the Adams-Bashforth rule of second order,

    x[k+1] = x[k] + h (3 f[k] - f[k-1]) / 2

with f[k] at the surfaces of that frame. While a surface moves this is half a frame late against inputs on straight lines: a rate
differs by h/2 times what its acceleration changed by in the last frame, however right both are. Lagging states of effects are
`lag_filter`s in JSBSim, by the trapezoidal rule, and are so here.
"""

import numpy as np

from estimation.engine.simulate import Simulator
from estimation.engine.trace import trace
from estimation.models.base import Model
from estimation.prepare.flight_data import FlightData, Segment
from estimation.simulation.oracle import Array

UNIT = 1.0  # of a filter's state: its rate is linear in it, so that any step gives its slope


def stepped(model: Model, data: FlightData, x0: Array, filters: tuple[str, ...]) -> Array:
    """(samples, ny) what a model shows that is moved by JSBSim's steps, one a sample, from x0 (nx,); NaN outside segments.

    filters: its states of the form x_dot = (input - x)/tau, which JSBSim has in its flight control. The flight begins steady: the
    rate before the first sample is that of the first.
    """
    simulator = Simulator.build(model, (), substeps=1)
    values = model.starts()
    shown = np.full((data.samples, len(model.outputs)), np.nan)
    p = simulator.vector(values)
    filtered = [model.state_names.index(n) for n in filters]
    for segment in data.segments:
        u = simulator.drive(segment, values, False).u
        shown[segment.first : segment.first + len(segment)] = _moved(model, segment, u, p, x0, filtered)
    return shown


def _moved(model: Model, segment: Segment, u: Array, p: Array, x0: Array, filtered: list[int]) -> Array:
    """(N, ny) outputs of one segment with inputs u (N, nu)."""
    functions = trace(model.structure)

    def rates(x: Array, k: int) -> Array:
        return np.asarray(functions.rates(x, u[k], p), float).ravel()

    x, h = x0.astype(float), np.diff(segment.time)
    f = before = rates(x, 0)
    shown = [np.asarray(functions.outputs(x, u[0], p), float).ravel()]
    for k in range(len(segment) - 1):
        after = x + 0.5 * h[k] * (3.0 * f - before)
        after[filtered] = x[filtered]
        for i in filtered:  # in the order in which JSBSim has them: one may read another
            drive = rates(after, k + 1)[i]
            raised = after.copy()
            raised[i] += UNIT
            slope = rates(raised, k + 1)[i] - drive
            after[i] += 0.5 * h[k] * (f[i] + drive) / (1.0 - 0.5 * h[k] * slope)
        x, before, f = after, f, rates(after, k + 1)
        shown.append(np.asarray(functions.outputs(x, u[k + 1], p), float).ravel())
        if not np.isfinite(x).all():
            shown += [np.full(len(model.outputs), np.nan)] * (len(segment) - len(shown))
            break
    return np.array(shown)
