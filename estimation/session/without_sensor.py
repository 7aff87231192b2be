"""Built-in models on a flight without a sideslip vane, a side accelerometer, or a record of thrust.

Sideslip follows from p, r, phi and ay by the kinematics of the model, except for its initial value. A flight that lacks both the
vane and ay is refused, because nothing then measures side force. Thrust that is constant within a flight becomes one unknown
force along x. It cannot be separated from CD_0, which also absorbs how thrust changes with airspeed; lift and pitch lose nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from daq.utilities.constants import GRAVITY
from daq.utilities.errors import UserError
from estimation.engine.kernel import Array
from estimation.errors import DataError
from estimation.estimators.arithmetic import NumericalFailure, numerical_failures
from estimation.estimators.equation_error import equation_error
from estimation.estimators.result import Result
from estimation.models.base import Model, Parameter, ParameterRole
from estimation.prepare.columns import EITHER, EITHER_IN
from groundstation.flight import Flight
from groundstation.flight.arrays import integral
from groundstation.flight.findings import Finding, FindingKind

KINEMATIC = "beta_kinematic"

LACKING: Mapping[str, str] = {
    "beta": (
        "beta not measured: it is integrated from p, r, phi and ay, from an unknown initial value, so that CY_0, Cl_0 and Cn_0 "
        "cannot be told from the initial sideslip, and motion slower than the manoeuvres gives no information on beta"
    ),
    "ay": (
        "ay not measured: the side force CY follows only from the motion of beta, and errors of the air or the vane act like a "
        "side force: the bounds of every CY are several times as wide"
    ),
    "thrust": (
        "thrust not measured: taken as constant within the flight and unknown, so that CD_0 cannot be told from it; its moment "
        "about the CG is counted as Cm_0"
    ),
}
"""Column that may be lacking -> what then cannot be determined."""

MAY_LACK: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(EITHER_IN, EITHER),
    **dict.fromkeys(("longitudinal", "six-dof"), ("thrust",)),
}
"""Built-in model -> columns of which its flights may lack one."""

THRUST = "thrust"
DRAG = "CD_0"  # cannot be separated from an unknown thrust
NO_THRUST = "thrust was not measured"
"""First words of the reason for which a parameter is not identifiable without a record of thrust."""
UNUSED = Finding(FindingKind.NOT_MEASURED, "thrust is not used, as other flights lack it: estimate those by themselves")
STEADY_THROTTLE = 0.05
"""Standard deviation of a recorded throttle (0 to 1) up to which thrust passes for constant: a fifth of the thrust of level
flight of a small propeller aeroplane at half throttle, the size of its zero-lift drag's usual bound."""


def without_sensor(model: Model, flights: Sequence[Flight]) -> tuple[Model, Sequence[Flight]]:
    """Model and flights as a fit can use them: where a flight lacks one of the columns of LACKING, the model does without it and
    a note of the flight says what can no longer be determined. Unchanged where no column or more than one is lacking, and for
    other than built-in models.

    Raises DataError for a flight without thrust whose throttle moves.
    """
    absent = [[n for n in MAY_LACK.get(model.name, ()) if not f.measured(n)] for f in flights]
    columns = {n for names in absent for n in names}
    if not columns or any(len(names) > 1 for names in absent):
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
    if THRUST in columns:
        slim = _without_thrust(slim, [f for f, names in zip(flights, absent, strict=True) if names])
        noted = [f if names else f.with_notes(UNUSED) for f, names in zip(noted, absent, strict=True)]
    without_vane = [f for f, names in zip(noted, absent, strict=True) if "beta" in names]
    return (_with_kinematic_starts(slim, without_vane) if without_vane else slim), noted


def _without_thrust(model: Model, flights: Sequence[Flight]) -> Model:
    """The model with thrust as an unknown of each flight instead of an input. Raises DataError where the throttle moves."""
    for f in flights:
        moves = float(np.nanstd(f["throttle"])) if f.measured("throttle") else 0.0
        if moves > STEADY_THROTTLE:
            raise DataError(
                f"{f.name}: thrust is not measured and the throttle moves (by {moves:.2f} of its range, one sigma), "
                "so that thrust cannot be taken as constant; add the column thrust, or choose a stretch at constant throttle"
            )
    unknown = Parameter(THRUST, "N", local=True, description="constant in a flight", role=ParameterRole.CONSTANT)
    inputs = tuple(s for s in model.inputs if s.name != THRUST)
    return replace(model, inputs=inputs, parameters=(*model.parameters, unknown))


def with_unknown_thrust(result: Result) -> Result:
    """The result with zero-lift drag and thrust marked not identifiable where thrust is an unknown."""
    if THRUST not in result.model.parameter_names or DRAG not in result.parameters:
        return result
    why = f"{NO_THRUST}: the record determines only thrust less drag"
    names = [n for n in (DRAG, THRUST) if n in result.parameters]
    blind = {n: replace(result.parameters[n], identifiable=False, why=why) for n in names}
    return replace(result, parameters={**result.parameters, **blind})


def _with_kinematic_starts(model: Model, flights: Sequence[Flight]) -> Model:
    """The model with start values for derivatives without a belief, by a regression on the kinematic sideslip."""
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
    """beta (N,) [rad] by beta_dot = p sin(alpha) - r cos(alpha) + (ay + g cos(theta) sin(phi)) / V, less a straight line in each
    segment, which errors of gyro and bank cause. Good enough for start values only."""
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
    """A column (N,) interpolated linearly over missing samples; zeros where it is not measured at all."""
    if not flight.measured(name):
        return np.zeros(len(flight))
    measured = np.isfinite(flight[name])
    return np.asarray(np.interp(flight.time, flight.time[measured], flight[name][measured]))
