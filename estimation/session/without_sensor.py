"""The built-in lateral models on a flight without a sideslip vane, or without a side accelerometer.

Sideslip follows from p, r, phi and ay by the kinematics of the model, but for where it began. Both lacking is refused as before:
side force would then be told by nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from daq.utilities.constants import GRAVITY
from daq.utilities.errors import UserError
from estimation.engine.kernel import Array
from estimation.estimators.arithmetic import NumericalFailure, numerical_failures
from estimation.estimators.equation_error import equation_error
from estimation.models.base import Model
from estimation.prepare.columns import EITHER_IN
from groundstation.flight import Flight
from groundstation.flight.arrays import integral
from groundstation.flight.findings import Finding, FindingKind

KINEMATIC = "beta_kinematic"

LACKING: Mapping[str, str] = {
    "beta": (
        "beta not measured: it follows from p, r, phi and ay and begins at zero as an unknown, so that CY_0, Cl_0 and Cn_0 "
        "cannot be told from the sideslip at the beginning, and what is slower than the manoeuvres tells nothing of beta"
    ),
    "ay": (
        "ay not measured: the side force CY is told by how beta moves alone, and what turns the air or the vane passes for it: "
        "the bounds of every CY are several times as wide"
    ),
}
"""Column that may be lacking -> what that leaves open."""


def without_sensor(model: Model, flights: Sequence[Flight]) -> tuple[Model, Sequence[Flight]]:
    """Model and flights as a fit can use them: where a flight lacks one of LACKING, the model does not ask for it, and the flight
    says what can no longer be told. Both as they are where nothing, or more than one, is lacking, and for other models."""
    absent = [[n for n in LACKING if not f.measured(n)] for f in flights]
    columns = {n for names in absent for n in names}
    if model.name not in EITHER_IN or not columns or any(len(names) > 1 for names in absent):
        return model, flights
    outputs = tuple(replace(s, optional=True) if s.source in columns else s for s in model.outputs)
    states = tuple(
        replace(s, start=0.0) if s.source in columns and s.start is None and not s.held else s for s in model.states
    )
    noted = [
        f.with_notes(*(Finding(FindingKind.NOT_MEASURED, LACKING[n]) for n in names)) if names else f
        for f, names in zip(flights, absent, strict=True)
    ]
    slim = replace(model, outputs=outputs, states=states)
    blind = [f for f, names in zip(noted, absent, strict=True) if "beta" in names]
    return (_started(slim, blind) if blind else slim), noted


def _started(model: Model, flights: Sequence[Flight]) -> Model:
    """The model with starts for derivatives of which nothing is believed, by a regression on the sideslip of the kinematics."""
    states = tuple(replace(s, column=KINEMATIC) if s.source == "beta" else s for s in model.states)
    with_kinematics = [f.with_columns(**{KINEMATIC: kinematic_sideslip(f)}) for f in flights]
    try:
        with numerical_failures():
            estimated = equation_error(replace(model, states=states), with_kinematics).values
    except (UserError, NumericalFailure):
        return model
    unknown = [p.name for p in model.parameters if not p.fixed and p.reference is None]
    return model.with_starts({n: estimated[n] for n in unknown if np.isfinite(estimated.get(n, np.nan))})


def kinematic_sideslip(flight: Flight) -> Array:
    """beta (N,) rad by beta_dot = p sin(alpha) - r cos(alpha) + (ay + g cos(theta) sin(phi)) / V, without the straight line that
    errors of gyro and bank put into each segment: good for a start, and for no result."""
    from scipy.signal import detrend

    names = ("p", "r", "ay", "phi", "V", "alpha", "theta")
    beta = np.full(len(flight), np.nan)
    for part in flight.segments:
        p, r, ay, phi, V, alpha, theta = (_filled(flight, n)[part] for n in names)
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = p * np.sin(alpha) - r * np.cos(alpha) + (ay + GRAVITY * np.cos(theta) * np.sin(phi)) / V
        if rate.size > 2 and np.isfinite(rate).all():
            beta[part] = detrend(integral(flight.time[part], rate))
    return beta


def _filled(flight: Flight, name: str) -> Array:
    """A column with its holes on straight lines; zero where it is not measured."""
    if not flight.measured(name):
        return np.zeros(len(flight))
    measured = np.isfinite(flight[name])
    return np.asarray(np.interp(flight.time, flight.time[measured], flight[name][measured]))
