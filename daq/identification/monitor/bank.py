"""Effects that the monitor can name: by how much each is stepped to see its signature, and where it enters.

Names are those of the gap workflow's catalogue where it has them; derivatives and constants stand for sudden changes of the
aircraft itself (a surface that sticks, ice, a mass that shifts).
"""

from collections.abc import Mapping
from dataclasses import dataclass

from daq.identification.airframe import DERIVATIVES, Airframe

CHANNELS = ("beta", "p", "r", "phi", "ay")
"""Outputs of the predictor, whose innovations are looked at."""

EQUATION_OF_CHANNEL: Mapping[str, str] = {
    "ay": "CY",
    "p": "Cl",
    "r": "Cn",
    "beta": "kinematics",
    "phi": "kinematics",
}


@dataclass(frozen=True, slots=True)
class MonitoredEffect:
    """One effect. step: its size for the signature, in `unit`. equation: where it enters. title: for a person.

    prior: standard deviation [unit] of what the model itself may be wrong by; 0 for what it does not have.
    """

    name: str
    title: str
    equation: str
    step: float
    unit: str
    prior: float = 0.0


SIZES: Mapping[str, float] = {"CY_0": 0.01, "Cl_0": 0.002, "Cn_0": 0.001}
"""Steps of the constants; other derivatives are stepped by a tenth."""
LEAST: Mapping[str, float] = {"CY": 0.01, "Cl": 0.003, "Cn": 0.002}
"""Least step of a derivative, for those believed to be about zero."""
PRIOR, PRIOR_WEAK = 0.01, 0.05  # of a derivative: what an estimate of a good flight leaves open, strong and weak ones
WEAK = ("CY_p", "CY_r", "Cl_r", "Cl_dr", "Cn_p")
LEVELS: Mapping[str, float] = {"CY_0": 0.002, "Cl_0": 0.0004, "Cn_0": 0.0002}
"""Standard deviation of the constants: trim and offsets drift."""

MISSING = (
    MonitoredEffect("Cn_da", "adverse yaw from aileron", "Cn", 0.005, "1/rad"),
    MonitoredEffect("CY_da", "side force from aileron", "CY", 0.02, "1/rad"),
    MonitoredEffect("aileron_delay", "aileron acts late", "actuator", 0.02, "s"),
    MonitoredEffect("rudder_delay", "rudder acts late", "actuator", 0.02, "s"),
    MonitoredEffect("beta_lag", "sideslip vane lags", "sensor", 0.03, "s"),
    MonitoredEffect("beta_bias", "sideslip vane has slipped", "sensor", 0.02, "rad"),
)
TITLES: Mapping[str, str] = {
    "Cl_da": "aileron effectiveness",
    "Cn_dr": "rudder yaw effectiveness",
    "CY_dr": "rudder side force",
    "Cl_p": "roll damping",
    "Cn_r": "yaw damping",
    "Cn_beta": "directional stability",
    "Cl_beta": "dihedral effect",
    "CY_beta": "side force from sideslip",
    "Cl_0": "rolling trim (mass or surface out of place)",
    "Cn_0": "yawing trim",
    "CY_0": "side force at rest",
}


def bank(airframe: Airframe, values: Mapping[str, float], stds: Mapping[str, float]) -> tuple[MonitoredEffect, ...]:
    """All effects for a model with these derivative values [1/rad].

    stds: what the model states of its derivatives' standard deviations; where it states nothing, 1 % or 5 %.
    """
    effects = []
    for name in DERIVATIVES:
        value, equation = abs(values.get(name, 0.0)), name.split("_")[0]
        if name in SIZES:
            step, prior = SIZES[name], LEVELS[name]
        else:
            step = max(0.1 * value, LEAST[equation])
            share = PRIOR_WEAK if name in WEAK else PRIOR
            prior = stds.get(name, max(share * value, share * LEAST[equation]))
        effects.append(MonitoredEffect(name, TITLES.get(name, f"derivative {name}"), equation, step, "1/rad", prior))
    return (*effects, *MISSING)
