"""The kinematic check of the pitching plane: airspeed, angle of attack and pitch attitude from measured rates and forces."""

from daq.contract.constants import GRAVITY
from estimation.gap.criteria import Criteria
from estimation.models.base import Model, Parameter, ParameterRole, Signal

NEEDED = ("V", "alpha", "theta", "q", "ax", "az")
ASIDE = ("beta", "p", "r", "phi", "ay")  # taken as zero where a flight does not have them


def pitch_kinematic_model(criteria: Criteria) -> Model:
    """Flight-path reconstruction in the plane of symmetry without aerodynamics; biases and scale errors with priors."""
    gyro, scale, accelerometer = (
        criteria.kinematic_gyro_bias,
        criteria.kinematic_gyro_scale,
        criteria.kinematic_accelerometer_bias,
    )
    return Model(
        name="kinematic",
        title="airspeed, angle of attack and pitch attitude from measured rates and forces, no aerodynamics",
        states=(Signal("V", "m/s"), Signal("alpha", "rad"), Signal("theta", "rad")),
        inputs=(*(Signal(n) for n in ("q", "ax", "az")), *(Signal(n, optional=True) for n in ASIDE)),
        outputs=(Signal("V", "m/s"), Signal("alpha", "rad"), Signal("theta", "rad")),
        parameters=(
            _instrument("bias_gyro_q", "rad/s", gyro, local=True),
            _instrument("bias_accelerometer_x", "m/s2", accelerometer, local=True),
            _instrument("bias_accelerometer_z", "m/s2", accelerometer, local=True),
            _instrument("scale_gyro_q", "1", scale),
        ),
        constants={"g": GRAVITY},
        equations=(
            "q_true = q*(1 + scale_gyro_q) + bias_gyro_q",
            "gx = ax + bias_accelerometer_x - g*sin(theta)",
            "gz = az + bias_accelerometer_z + g*cos(theta)*cos(phi)",
            "V_dot = (gx*cos(alpha) + gz*sin(alpha))*cos(beta) + (ay + g*cos(theta)*sin(phi))*sin(beta)",
            "alpha_dot = q_true - tan(beta)*(p*cos(alpha) + r*sin(alpha)) + (gz*cos(alpha) - gx*sin(alpha))/(V*cos(beta))",
            "theta_dot = q_true*cos(phi) - r*sin(phi)",
        ),
    )


def _instrument(name: str, unit: str, width: float, local: bool = False) -> Parameter:
    return Parameter(name, unit, prior_mean=0.0, prior_std=width, local=local, role=ParameterRole.INSTRUMENT)
