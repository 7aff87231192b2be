"""The base model around a simulation: our equations of motion with its coefficients, and parameters for their errors.

Each coefficient is

    C = k_C C_sim + C_0 + (C_x - mean_C_x) x + ...

with C_sim the simulation's coefficient along the flight (`along_flight`), a factor k_C (1 as it flies) and an increment C_0 (0).
C_x are derivatives in the usual form (per rad, rates non-dimensional). They start at `mean_C_x`, the simulation's mean slope over
the flights; an estimate minus this start is the increment that the simulation lacks. Effects append their terms.

Lift by the rate of alpha would define itself, for that rate follows from the lift; the equation of alpha is solved for it.

Where the simulation's induced drag depends on alpha alone (SITL), the model adds share_CD CD_k (CL^2 - CL(alpha)^2). Its files
cannot express that term, so share_CD (0: as the simulation flies, 1: a parabolic polar) is estimated with the constants.
"""

from dataclasses import asdict, replace
from enum import StrEnum

from estimation.aircraft import Aircraft
from estimation.models.base import Model, Parameter, Signal
from estimation.models.load import load_model
from estimation.models.parts import usual_role
from estimation.simulation.along_flight import AlongFlights, coefficients_in, column_name, variables_of
from estimation.simulation.oracle import ALPHA_RATE, Simulation

REGRESSORS = {
    "alpha": ("alpha", "alpha"), "beta": ("beta", "beta"), "p": ("p_hat", "p"), "q": ("q_hat", "q"), "r": ("r_hat", "r"),
    "de": ("delta_e", "delta_e"), "da": ("delta_a", "delta_a"), "dr": ("delta_r", "delta_r"),
}  # fmt: skip
"""Ending of a derivative's name -> its regressor, and the variable in that."""
SHARE = "share_CD"
RATE_BY_LIFT = "alpha_dot_solved"
"""The rate of alpha as lift by that rate reads it: an effect added to the lift does not move it. By its ending the search for
shapes knows that this line, which repeats the derivatives of lift, is no coefficient."""
SHARE_WORDS = "induced drag by the lift of elevator and pitch rate, not in the simulation: share of a parabolic polar"
DESCRIPTION = "Base: the simulation {}"


class Free(StrEnum):
    """What of a simulation is estimated: factors and constants (for the search for effects, which frees single derivatives),
    derivatives and constants (to estimate each from the flights), or nothing."""

    FACTORS = "factors"
    DERIVATIVES = "derivatives"
    NOTHING = "nothing"


def base_model(
    simulation: Simulation, which: str, aircraft: Aircraft, along_flights: AlongFlights, free: Free
) -> Model:
    """The built-in model `which` with the coefficients of a simulation that was evaluated along the flights."""
    built_in = load_model(which, aircraft)
    coefficients = coefficients_in(built_in)
    variables = variables_of(built_in)
    lines, parameters, constants = dict(built_in.definitions), [], dict(built_in.constants)
    for c in coefficients:
        zero = f"{c}_0"
        derivatives = [p.name for p in built_in.parameters if p.name.startswith(f"{c}_") and p.name != zero]
        own_derivatives = [d for d in derivatives if d.removeprefix(f"{c}_") in REGRESSORS]
        terms = [f"k_{c}*{c}_sim", zero]
        parameters.append(Parameter(f"k_{c}", "1", 1.0, reference=1.0, fixed=free is not Free.FACTORS,
                                    description=f"factor on the simulation's {c}"))  # fmt: skip
        parameters.append(Parameter(zero, "1", fixed=free is Free.NOTHING, role=usual_role(zero), reference=0.0,
                                    description=f"increment to the simulation's {c}"))  # fmt: skip
        if c == "CD" and simulation.polar is not None:
            terms.append(f"{SHARE}*polar_CD_k*(CL^2 - (polar_CL_0 + polar_CL_alpha*alpha)^2)")
            constants |= {f"polar_{n}": v for n, v in asdict(simulation.polar).items()}
            parameters.append(Parameter(SHARE, "1", fixed=free is Free.NOTHING, reference=0.0, description=SHARE_WORDS))
        for name in own_derivatives:
            regressor, variable = REGRESSORS[name.removeprefix(f"{c}_")]
            mean = _derivative(along_flights, c, variable, aircraft)
            constants[f"mean_{name}"] = mean
            terms.append(f"({name} - mean_{name})*{regressor}")
            parameters.append(Parameter(name, "1/rad", mean, fixed=free is not Free.DERIVATIVES, reference=mean,
                                        reference_source=f"simulation {simulation.name}"))  # fmt: skip
        slopes = [f"{column_name(c, v)}*{v}" for v in variables if column_name(c, v) in along_flights.names]
        offset = [column_name(c)] if column_name(c) in along_flights.names else []
        by_rate = column_name(c, ALPHA_RATE)
        if c == "CL" and by_rate in along_flights.names:
            slopes.remove(f"{by_rate}*{ALPHA_RATE}")
            still = " + ".join([f"k_CL*({' + '.join([*offset, *slopes]) or '0'})", *terms[1:]])
            lines[RATE_BY_LIFT] = alpha_rate_solved(f"({still})", f"k_CL*{by_rate}")
            slopes.append(f"{by_rate}*{RATE_BY_LIFT}")
        lines[f"{c}_sim"] = " + ".join([*offset, *slopes]) or "0"
        lines[c] = " + ".join(terms)
    return replace(
        built_in,
        name=f"{built_in.name}-{simulation.name}",
        title=f"{built_in.title}; coefficients of the simulation {simulation.name}",
        description=DESCRIPTION.format(simulation.spec),
        inputs=(
            *built_in.inputs,
            *(Signal(n, description="of the simulation", computed=True) for n in along_flights.names),
        ),
        parameters=tuple(parameters),
        constants=constants,
        equations=tuple(f"{name} = {text}" for name, text in lines.items()),
    )


def alpha_rate_solved(lift: str, by_rate: str) -> str:
    """The rate of alpha where lift depends on it: the equation of alpha with that part of the lift moved to its left side.

    lift: the lift coefficient without that part; by_rate: its change per rad/s.
    """
    return (
        "(q - tan(beta)*(p*cos(alpha) + r*sin(alpha)) + (g*(cos(theta)*cos(phi)*cos(alpha) + sin(theta)*sin(alpha))"
        f" - thrust/m*sin(alpha) - q_dyn*S/m*{lift})/(V*cos(beta)))/(1 + q_dyn*S/(m*V*cos(beta))*{by_rate})"
    )


def _derivative(along_flights: AlongFlights, coefficient: str, variable: str, aircraft: Aircraft) -> float:
    """Mean slope as a derivative: per rad, for rates per rate times length over twice the mean airspeed."""
    slope = along_flights.means.get((coefficient, variable), 0.0)
    length = {"p": aircraft.span, "q": aircraft.chord, "r": aircraft.span}.get(variable)
    return slope if length is None else slope * 2.0 * along_flights.speed / length
