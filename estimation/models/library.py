"""The models that come with Sideslip: `lateral`, `lateral-simple`, `longitudinal`, `six-dof`.

Body axes x forward, y right, z down; SI and radians; derivatives per rad, rates non-dimensional as p b / 2V, q c / 2V,
r b / 2V. +delta_r trailing edge to port (force to +y, nose left), +delta_a rolls left. All sensors are taken at the CG:
calibration brings them there.

Source of the lateral aerodynamics: The Aeronautical Journal (2018), pp 889-912, eqs 14-20.
"""

from dataclasses import replace

from estimation.aircraft import Aircraft
from estimation.models.base import Model, Parameter, Signal
from estimation.models.parts import usual_role

BETA = Signal("beta", "rad", "angle of sideslip")
ROLL_RATE = Signal("p", "rad/s", "roll rate")
PITCH_RATE = Signal("q", "rad/s", "pitch rate")
YAW_RATE = Signal("r", "rad/s", "yaw rate")
BANK = Signal("phi", "rad", "bank angle")
PITCH = Signal("theta", "rad", "pitch attitude")
ALPHA = Signal("alpha", "rad", "angle of attack")
AIRSPEED = Signal("V", "m/s", "true airspeed")
SIDE_ACCELERATION = Signal("ay", "m/s2", "specific force at the CG, y")
AXIAL_ACCELERATION = Signal("ax", "m/s2", "specific force at the CG, x", optional=True)
NORMAL_ACCELERATION = Signal("az", "m/s2", "specific force at the CG, z", optional=True)
DENSITY = Signal("rho", "kg/m3", "air density")
THRUST = Signal("thrust", "N", "thrust along x")
AIRSPEED_RATE = Signal("V_dot", "m/s2", "rate of change of true airspeed")
ELEVATOR = Signal("delta_e", "rad", "elevator (mean elevon)", control=True, servo=True)
AILERON = Signal("delta_a", "rad", "aileron (antisymmetric elevon)", control=True, servo=True)
RUDDER = Signal("delta_r", "rad", "rudder", control=True, servo=True)

LATERAL_AERODYNAMICS = (
    "q_dyn = 0.5*rho*V^2",
    "p_hat = p*b/(2*V)",
    "r_hat = r*b/(2*V)",
    "CY = CY_0 + CY_beta*beta + CY_p*p_hat + CY_r*r_hat + CY_dr*delta_r",
    "Cl = Cl_0 + Cl_beta*beta + Cl_p*p_hat + Cl_r*r_hat + Cl_da*delta_a + Cl_dr*delta_r",
    "Cn = Cn_0 + Cn_beta*beta + Cn_p*p_hat + Cn_r*r_hat + Cn_dr*delta_r",
    "ay = q_dyn*S/m*CY",
)
LATERAL_DERIVATIVES = (
    "CY_0", "CY_beta", "CY_p", "CY_r", "CY_dr",
    "Cl_0", "Cl_beta", "Cl_p", "Cl_r", "Cl_da", "Cl_dr",
    "Cn_0", "Cn_beta", "Cn_p", "Cn_r", "Cn_dr",
)  # fmt: skip
LONGITUDINAL_AERODYNAMICS = (
    "q_hat = q*c/(2*V)",
    "CL = CL_0 + CL_alpha*alpha + CL_q*q_hat + CL_de*delta_e",
    "CD = CD_0 + CD_k*CL^2",
    "Cm = Cm_0 + Cm_alpha*alpha + Cm_q*q_hat + Cm_de*delta_e",
    "CX = CL*sin(alpha) - CD*cos(alpha)",
    "CZ = -CL*cos(alpha) - CD*sin(alpha)",
    "ax = (q_dyn*S*CX + thrust)/m",
    "az = q_dyn*S*CZ/m",
)
LONGITUDINAL_DERIVATIVES = (
    "CL_0", "CL_alpha", "CL_q", "CL_de", "CD_0", "CD_k", "Cm_0", "Cm_alpha", "Cm_q", "Cm_de",
)  # fmt: skip
ROLL_AND_YAW = (
    "inertia = Ixx*Izz - Ixz^2",
    "roll = q_dyn*S*b*Cl + Ixz*p*q - (Izz - Iyy)*q*r",
    "yaw = q_dyn*S*b*Cn - Ixz*q*r - (Iyy - Ixx)*p*q",
    "p_dot = (Izz*roll + Ixz*yaw)/inertia",
    "r_dot = (Ixx*yaw + Ixz*roll)/inertia",
)


def _unit(name: str) -> str:
    return "1" if name.endswith("_0") else "1/rad"


def aerodynamic_parameters(names: tuple[str, ...], aircraft: Aircraft) -> tuple[Parameter, ...]:
    """Derivatives as parameters that start from, and are printed beside, the values believed of the aircraft."""
    parameters = []
    for name in names:
        prior = aircraft.prior(name)
        if prior is None:
            parameters.append(Parameter(name, _unit(name), role=usual_role(name)))
        else:
            parameters.append(
                Parameter(
                    name,
                    _unit(name),
                    start=prior.value,
                    reference=prior.value,
                    reference_std=prior.std,
                    reference_source=prior.source,
                    role=usual_role(name),
                )
            )
    return tuple(parameters)


MOTION = {
    "beta": "beta", "p": "p_hat", "r": "r_hat", "da": "delta_a", "dr": "delta_r",
    "alpha": "alpha", "q": "q_hat", "de": "delta_e",
}  # fmt: skip
"""Ending of a derivative -> symbol of the variable that it multiplies."""


def stated_terms(model: Model, aircraft: Aircraft) -> Model:
    """The model with those derivatives of the general linear model that the aircraft file states and the model lacks.

    They start from the stated value, which is a prior where a standard deviation is stated: a term worth stating is not dropped
    because one flight cannot determine it.
    """
    terms: dict[str, str] = {}
    parameters = []
    symbols = {*model.state_names, *model.input_names, *model.definitions}
    for name, prior in aircraft.derivatives.items():
        line, _, ending = name.partition("_")
        regressor = MOTION.get(ending)
        if name in model.parameter_names or line not in model.definitions or regressor not in symbols:
            continue
        terms[line] = f"{terms[line]} + {name}*{regressor}" if line in terms else f"{name}*{regressor}"
        (parameter,) = aerodynamic_parameters((name,), aircraft)
        parameters.append(
            replace(parameter, prior_mean=None if prior.std is None else prior.value, prior_std=prior.std)
        )
    return model.plus(terms=terms, parameters=parameters) if parameters else model


def not_in_model(model: Model, aircraft: Aircraft) -> tuple[str, ...]:
    """Derivatives that the aircraft file states of coefficients of the model, but for which the model has no term."""
    return tuple(
        n
        for n in aircraft.derivatives
        if n not in model.parameter_names and n not in model.constants and n.partition("_")[0] in model.definitions
    )


def lateral(aircraft: Aircraft) -> Model:
    """Lateral-directional motion with full kinematics; measured V, alpha, theta, q enter as known inputs.

    beta_dot = p sin(alpha) - r cos(alpha) + (ay + g cos(theta) sin(phi)) / (V cos(beta)) - V_dot/V tan(beta) is exact;
    V_dot is differentiated from the de-noised airspeed where the flight has no such column. p_dot and r_dot
    contain the p q and q r couplings.
    """
    return Model(
        name="lateral",
        title="lateral-directional, full kinematics",
        states=(BETA, ROLL_RATE, YAW_RATE, BANK),
        inputs=(AILERON, RUDDER, AIRSPEED, ALPHA, PITCH, PITCH_RATE, AIRSPEED_RATE, DENSITY),
        outputs=(BETA, ROLL_RATE, YAW_RATE, BANK, SIDE_ACCELERATION),
        parameters=aerodynamic_parameters(LATERAL_DERIVATIVES, aircraft),
        constants=aircraft.constants(),
        equations=(
            *LATERAL_AERODYNAMICS,
            *ROLL_AND_YAW,
            "beta_dot = p*sin(alpha) - r*cos(alpha) + (ay + g*cos(theta)*sin(phi))/(V*cos(beta)) - V_dot/V*tan(beta)",
            "phi_dot = p + tan(theta)*(q*sin(phi) + r*cos(phi))",
        ),
    )


def lateral_simple(aircraft: Aircraft) -> Model:
    """The paper's lateral-directional model, eqs 14-20, with a PLUS sign before the side-force term of beta_dot.

    The paper prints a minus there, which contradicts its own C_Y = m a_y / (q S) (eq 4): with data made by the plus
    sign, the minus model estimates CY_beta = +0.09 and leaves a 4.5 sigma residual in a_y; the plus model recovers
    -0.119. Known error of this form: p sin(alpha) is dropped, worth 0.06-0.18 p at usual angles of attack.
    """
    return Model(
        name="lateral-simple",
        title="lateral-directional, kinematics of the paper",
        states=(BETA, ROLL_RATE, YAW_RATE, BANK),
        inputs=(AILERON, RUDDER, AIRSPEED, DENSITY),
        outputs=(BETA, ROLL_RATE, YAW_RATE, BANK, SIDE_ACCELERATION),
        parameters=aerodynamic_parameters(LATERAL_DERIVATIVES, aircraft),
        constants=aircraft.constants(),
        equations=(
            *LATERAL_AERODYNAMICS,
            "inertia = Ixx*Izz - Ixz^2",
            "beta_dot = -r + g/V*sin(phi) + rho*V*S/(2*m)*CY",
            "p_dot = q_dyn*S*b*(Izz*Cl + Ixz*Cn)/inertia",
            "r_dot = q_dyn*S*b*(Ixx*Cn + Ixz*Cl)/inertia",
            "phi_dot = p",
        ),
    )


def longitudinal(aircraft: Aircraft) -> Model:
    """Longitudinal motion: V, alpha, theta, q with lift, drag polar, pitching moment and thrust.

    Bank, roll and yaw rate, sideslip and side force enter as known inputs where the flight has them (zero otherwise).
    """
    lateral_inputs = (BETA, ROLL_RATE, YAW_RATE, BANK, SIDE_ACCELERATION)
    return Model(
        name="longitudinal",
        title="longitudinal, drag polar",
        states=(AIRSPEED, ALPHA, PITCH, PITCH_RATE),
        inputs=(
            ELEVATOR,
            THRUST,
            DENSITY,
            *(Signal(s.name, s.unit, s.description, optional=True) for s in lateral_inputs),
        ),
        outputs=(AIRSPEED, ALPHA, PITCH, PITCH_RATE, AXIAL_ACCELERATION, NORMAL_ACCELERATION),
        parameters=aerodynamic_parameters(LONGITUDINAL_DERIVATIVES, aircraft),
        constants=aircraft.constants(),
        equations=(
            "q_dyn = 0.5*rho*V^2",
            *LONGITUDINAL_AERODYNAMICS,
            "gx = ax - g*sin(theta)",
            "gz = az + g*cos(theta)*cos(phi)",
            "V_dot = (gx*cos(alpha) + gz*sin(alpha))*cos(beta) + (ay + g*cos(theta)*sin(phi))*sin(beta)",
            "alpha_dot = q - tan(beta)*(p*cos(alpha) + r*sin(alpha)) + (gz*cos(alpha) - gx*sin(alpha))/(V*cos(beta))",
            "theta_dot = q*cos(phi) - r*sin(phi)",
            "q_dot = (q_dyn*S*c*Cm + (Izz - Ixx)*p*r - Ixz*(p^2 - r^2))/Iyy",
        ),
    )


def six_dof(aircraft: Aircraft) -> Model:
    """Motion in all axes: V, alpha, beta, p, q, r, phi, theta with the aerodynamics of both planes."""
    return Model(
        name="six-dof",
        title="six degrees of freedom",
        states=(AIRSPEED, ALPHA, BETA, ROLL_RATE, PITCH_RATE, YAW_RATE, BANK, PITCH),
        inputs=(ELEVATOR, AILERON, RUDDER, THRUST, DENSITY),
        outputs=(
            AIRSPEED, ALPHA, BETA, ROLL_RATE, PITCH_RATE, YAW_RATE, BANK, PITCH,
            AXIAL_ACCELERATION, SIDE_ACCELERATION, NORMAL_ACCELERATION,
        ),
        parameters=aerodynamic_parameters((*LONGITUDINAL_DERIVATIVES, *LATERAL_DERIVATIVES), aircraft),
        constants=aircraft.constants(),
        equations=(
            *LATERAL_AERODYNAMICS,
            *LONGITUDINAL_AERODYNAMICS,
            *ROLL_AND_YAW,
            "gx = ax - g*sin(theta)",
            "gy = ay + g*cos(theta)*sin(phi)",
            "gz = az + g*cos(theta)*cos(phi)",
            "V_dot = gx*cos(alpha)*cos(beta) + gy*sin(beta) + gz*sin(alpha)*cos(beta)",
            "alpha_dot = q - tan(beta)*(p*cos(alpha) + r*sin(alpha)) + (gz*cos(alpha) - gx*sin(alpha))/(V*cos(beta))",
            "beta_dot = p*sin(alpha) - r*cos(alpha)"
            " + (gy*cos(beta) - (gx*cos(alpha) + gz*sin(alpha))*sin(beta))/V",
            "q_dot = (q_dyn*S*c*Cm + (Izz - Ixx)*p*r - Ixz*(p^2 - r^2))/Iyy",
            "phi_dot = p + tan(theta)*(q*sin(phi) + r*cos(phi))",
            "theta_dot = q*cos(phi) - r*sin(phi)",
        ),
    )  # fmt: skip


WHOLE = ("lateral", "longitudinal", "six-dof")
"""Models that `stated_terms` extends by derivatives of the general linear model; `lateral-simple` stays as in the paper."""

BUILDERS = {"lateral": lateral, "lateral-simple": lateral_simple, "longitudinal": longitudinal, "six-dof": six_dof}
