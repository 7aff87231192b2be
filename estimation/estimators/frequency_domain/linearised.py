"""A traced model about one point of flight: matrices and their slopes by the parameters.

x_dot = f(x, u), y = g(x, u); A = df/dx, C = dg/dx at the mean state and input of a stretch of flight. What f and g have
beyond A x and C x at the measured motion is kept as a known input (`transformed`), so that a changing airspeed costs no
bias.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator
from estimation.engine.trace import Traced, trace

RELATIVE = 1e-4  # of a parameter: central difference of A and C, which parameters enter linearly or nearly so


@dataclass(frozen=True)
class LinearisedSystem:
    """A: (nx, nx), C: (ny, nx); A_p: (n, nx, nx), C_p: (n, ny, nx) their slopes by the n free parameters."""

    A: Array
    C: Array
    A_p: Array
    C_p: Array


def matrices(traced: Traced, state: Array, inputs: Array, p: Array) -> tuple[Array, Array]:
    """(A (nx, nx), C (ny, nx)) at one point. p: parameters and constants as traced."""
    nx, _, _, ny = traced.sizes
    found = []
    for function, key, rows in ((traced.rates_jacobian, "f_x", nx), (traced.outputs_jacobian, "y_x", ny)):
        matrix = np.zeros((rows, nx))
        matrix[traced.patterns[key]] = np.asarray(function(state, inputs, p)[1]).ravel()
        found.append(matrix)
    return found[0], found[1]


def linearised(simulator: Simulator, values: Mapping[str, float], state: Array, inputs: Array) -> LinearisedSystem:
    """The model of a simulator at parameter `values`, about state (nx,) and inputs (nu,)."""
    traced, p = trace(simulator.model.structure), simulator.vector(values)
    A, C = matrices(traced, state, inputs, p)
    A_p, C_p = np.zeros((len(simulator.free), *A.shape)), np.zeros((len(simulator.free), *C.shape))
    names = simulator.model.parameter_names
    for j, name in enumerate(simulator.free):
        h = RELATIVE * max(abs(values[name]), RELATIVE)
        up, down = p.copy(), p.copy()
        up[names.index(name)] += h
        down[names.index(name)] -= h
        (A1, C1), (A0, C0) = matrices(traced, state, inputs, up), matrices(traced, state, inputs, down)
        A_p[j], C_p[j] = (A1 - A0) / (2 * h), (C1 - C0) / (2 * h)
    return LinearisedSystem(A, C, A_p, C_p)
