"""Flight-path kinematics with instrument factors: the model of the data-compatibility check.

Measured specific forces and rates drive the motion; from it follows, without any aerodynamics, what vanes, pitot and attitude
filter should have shown. Conventions: measured = true + bias for accelerations and rates (so measured - bias drives the
motion), measured = K true + bias for alpha, beta, V. SI, radians, body axes x forward, y right, z down, all at the centre of
gravity.

Source: kinematic equations of a rigid body over a flat earth; factors as in The Aeronautical Journal (2018), pp 889-912,
Table 2.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from daq.utilities.constants import GRAVITY
from estimation.errors import ModelError
from estimation.models.base import Model, Parameter, ParameterRole, Signal

STANDARD_FACTORS = ("dax", "day", "daz", "dp", "dq", "dr", "K_beta", "dbeta")
"""Table 2 of the paper."""

AIR = ("V", "alpha", "beta")
"""Outputs in which specific force shows: it changes the air-relative velocity and nothing else."""


@dataclass(frozen=True)
class InstrumentFactor:
    """An instrument factor. channels: outputs of which at least one must be measured for it to be estimated; none for a bias of a
    rate.

    delayed: the output that the factor delays, else empty.
    """

    parameter: Parameter
    channels: tuple[str, ...] = ()
    delayed: str = ""


def _factor(name: str, unit: str, description: str, *channels: str, start: float = 0.0) -> InstrumentFactor:
    return InstrumentFactor(
        Parameter(name, unit, start, description=description, role=ParameterRole.INSTRUMENT), channels
    )


LONGEST_DELAY = 0.3  # s, of either sign: beyond any sensor or filter on board


def _delay(channel: str) -> InstrumentFactor:
    name = f"tau_{channel}"
    return InstrumentFactor(
        Parameter(name, "s", lower=-LONGEST_DELAY, upper=LONGEST_DELAY, role=ParameterRole.INSTRUMENT),
        (channel,),
        channel,
    )


_FACTORS = (
    *(_factor(f"da{x}", "m/s2", f"bias of the specific force, {x}", *AIR) for x in "xyz"),
    *(_factor(f"d{r}", "rad/s", f"bias of the rate {r}") for r in "pqr"),
    _factor("K_alpha", "1", "scale of angle of attack", "alpha", start=1.0),
    _factor("dalpha", "rad", "bias of angle of attack", "alpha"),
    _factor("K_beta", "1", "scale of sideslip", "beta", start=1.0),
    _factor("dbeta", "rad", "bias of sideslip", "beta"),
    _factor("K_V", "1", "scale of airspeed", "V", start=1.0),
    _factor("dV", "m/s", "bias of airspeed", "V"),
    _factor("dphi", "rad", "bias of bank angle", "phi"),
    _factor("dtheta", "rad", "bias of pitch attitude", "theta"),
    _factor("x_imu", "m", "IMU ahead of the centre of gravity", *AIR),
    _factor("y_imu", "m", "IMU right of the centre of gravity", *AIR),
    _factor("z_imu", "m", "IMU below the centre of gravity", *AIR),
    _factor("x_vane", "m", "vane ahead of the centre of gravity", "alpha", "beta"),
    _factor("y_vane", "m", "alpha vane right of the centre of gravity", "alpha", "beta"),
    _factor("z_vane", "m", "beta vane below the centre of gravity", "alpha", "beta"),
    *(_delay(c) for c in ("alpha", "beta", "V", "phi", "theta", "psi")),
)
FACTORS: Mapping[str, InstrumentFactor] = {f.parameter.name: f for f in _FACTORS}

ATTITUDE = ("phi", "theta", "psi")

FILTER_ERRORS: Mapping[str, tuple[float, float]] = {"level": (1.0, 30.0), "swing": (0.35, 0.7)}
"""Error of an attitude filter -> share of its stated uncertainty, time constant [s]. A level error, from accelerometer bias,
lasts a flight; the filter corrects errors from manoeuvres within a second. Sizes as found on simulated flights
(docs/compatibility.md)."""

MEASUREMENTS = {
    "V": Signal("V", "m/s", "true airspeed"),
    "alpha": Signal("alpha", "rad", "angle of attack"),
    "beta": Signal("beta", "rad", "sideslip"),
    "phi": Signal("phi", "rad", "bank angle"),
    "theta": Signal("theta", "rad", "pitch attitude"),
    "psi": Signal("psi", "rad", "heading"),
}


def compatibility_model(
    factors: Iterable[str] = STANDARD_FACTORS,
    outputs: Iterable[str] = tuple(MEASUREMENTS),
    known: Mapping[str, float] | None = None,
    *,
    filtered_attitude: bool = False,
) -> Model:
    """Kinematic model with the named factors free, and those of `known` fixed at given values, such as measured lengths.

    filtered_attitude: phi, theta and psi come from an onboard filter and carry its errors, states `phi_level`,
    `phi_swing` and so on [rad], first-order Gauss-Markov as in FILTER_ERRORS.

    Raises ModelError for a factor that does not exist, and for free IMU and vane positions along the same axis: the kinematics
    hold at any point of the body, so only the difference of the two can be estimated.
    """
    free, measured = tuple(factors), tuple(outputs)
    fixed = dict(known or {})
    unknown = [f for f in (*free, *fixed) if f not in FACTORS]
    if unknown:
        raise ModelError(f"compatibility: no factor {unknown[0]!r}; choose from {', '.join(FACTORS)}")
    for axis in "xyz":
        if f"{axis}_imu" in free and f"{axis}_vane" in free:
            raise ModelError(
                f"compatibility: {axis}_imu and {axis}_vane cannot be told from each other, only their difference shows; "
                f"measure one and give it, like {axis}_imu=0.06"
            )

    errors = [(a, e) for a in ATTITUDE for e in FILTER_ERRORS] if filtered_attitude else []
    lever = tuple(n for n in ("x_imu", "y_imu", "z_imu") if n in free or n in fixed)
    delays = {FACTORS[f].delayed: f for f in free if FACTORS[f].delayed}
    return Model(
        name="compatibility",
        title="flight-path kinematics",
        states=(
            Signal("u", "m/s", "velocity forward"),
            Signal("v", "m/s", "velocity right"),
            Signal("w", "m/s", "velocity down"),
            *(MEASUREMENTS[a] for a in ATTITUDE),
            *(Signal(f"{a}_{e}", "rad", f"{e} error of the measured {a}") for a, e in errors),
        ),
        inputs=(
            *(Signal(n, "m/s2") for n in ("ax", "ay", "az")),
            *(Signal(n, "rad/s") for n in "pqr"),
            *(Signal(f"{n}_dot", "rad/s2") for n in "pqr" if lever),
        ),
        outputs=tuple(MEASUREMENTS[n] for n in measured),
        parameters=tuple(FACTORS[f].parameter for f in free),
        equations=_equations(free, fixed, lever, errors),
        constants={"g": GRAVITY},
        output_delays=delays,
    )


def _equations(
    free: Collection[str], fixed: Mapping[str, float], lever: Collection[str], errors: Collection[tuple[str, str]]
) -> tuple[str, ...]:
    """Lines of the model. lever: IMU positions, free or fixed; errors: (angle, kind) of an attitude filter."""

    def value(name: str, neutral: float) -> str:
        return name if name in free else f"({fixed.get(name, neutral)!r})"

    def corrected(name: str, bias: str) -> str:
        return f"({name} - {value(bias, 0.0)})" if bias in free or bias in fixed else name

    def filter_errors(angle: str) -> str:
        return "".join(f" + {a}_{e}" for a, e in errors if a == angle)

    p, q, r = (corrected(n, f"d{n}") for n in "pqr")
    ax, ay, az = (corrected(f"a{x}", f"da{x}") for x in "xyz")
    if lever:
        X, Y, Z = (value(n, 0.0) for n in ("x_imu", "y_imu", "z_imu"))
        # specific force at the centre of gravity: minus omega_dot x arm and omega x (omega x arm)
        ax = f"({ax} - (q_dot*{Z} - r_dot*{Y} + {p}*({q}*{Y} + {r}*{Z}) - ({q}^2 + {r}^2)*{X}))"
        ay = f"({ay} - (r_dot*{X} - p_dot*{Z} + {q}*({p}*{X} + {r}*{Z}) - ({p}^2 + {r}^2)*{Y}))"
        az = f"({az} - (p_dot*{Y} - q_dot*{X} + {r}*({p}*{X} + {q}*{Y}) - ({p}^2 + {q}^2)*{Z}))"
    vane = {n: value(n, 0.0) for n in ("x_vane", "y_vane", "z_vane")}
    return (
        f"u_dot = {r}*v - {q}*w - g*sin(theta) + {ax}",
        f"v_dot = {p}*w - {r}*u + g*cos(theta)*sin(phi) + {ay}",
        f"w_dot = {q}*u - {p}*v + g*cos(theta)*cos(phi) + {az}",
        f"phi_dot = {p} + tan(theta)*({q}*sin(phi) + {r}*cos(phi))",
        f"theta_dot = {q}*cos(phi) - {r}*sin(phi)",
        f"psi_dot = ({q}*sin(phi) + {r}*cos(phi))/cos(theta)",
        "speed = sqrt(u^2 + v^2 + w^2)",
        f"u_vane = u - {r}*{vane['y_vane']} + {q}*{vane['z_vane']}",
        f"v_vane = v + {r}*{vane['x_vane']} - {p}*{vane['z_vane']}",
        f"w_vane = w - {q}*{vane['x_vane']} + {p}*{vane['y_vane']}",
        f"V = {value('K_V', 1.0)}*speed + {value('dV', 0.0)}",
        f"alpha = {value('K_alpha', 1.0)}*atan2(w_vane, u_vane) + {value('dalpha', 0.0)}",
        f"beta = {value('K_beta', 1.0)}*atan2(v_vane, sqrt(u_vane^2 + w_vane^2)) + {value('dbeta', 0.0)}",
        f"phi_measured = phi + {value('dphi', 0.0)}{filter_errors('phi')}",
        f"theta_measured = theta + {value('dtheta', 0.0)}{filter_errors('theta')}",
        f"psi_measured = psi{filter_errors('psi')}",
        *(f"{a}_{e}_dot = -{a}_{e}/{FILTER_ERRORS[e][1]!r}" for a, e in errors),
    )
