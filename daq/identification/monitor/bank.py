"""Effects that the monitor can name: by how much each is stepped to see its signature, and where it enters.

Names are those of the gap workflow's catalogue where it has them; derivatives and constants stand for sudden changes of the
aircraft itself (a surface that sticks, ice, a mass that shifts).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from daq.identification.regression import LATERAL, LONGITUDINAL, PlaneRegression


@dataclass(frozen=True, slots=True)
class MonitoredEffect:
    """One effect. step: its size for the signature, in `unit`. equation: where it enters. title: for a person.

    prior: standard deviation [unit] of what the model itself may be wrong by; 0 for what it does not have. moves: parameter ->
    what a step changes of it, for an effect that is of several.
    """

    name: str
    title: str
    equation: str
    step: float
    unit: str
    prior: float = 0.0
    moves: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class MonitoredPlane:
    """What is predicted and named of one plane.

    regression: whose derivatives these are. channels: outputs of the predictor, whose innovations are looked at: states, that of
    the vane first, then forces; equations: where an innovation of each belongs. delays: effects that make each of the controls
    late. constants, least: steps of the constants, and least steps of a derivative by coefficient, for those believed to be about
    zero; other derivatives are stepped by a tenth. levels: standard deviation of the constants: trim and offsets drift. weak:
    what an estimate of a good flight leaves open by 5 % and not 1. missing: what the model does not have.
    """

    regression: PlaneRegression
    channels: tuple[str, ...]
    states: int
    equations: Mapping[str, str]
    delays: tuple[str, ...]
    constants: Mapping[str, float]
    least: Mapping[str, float]
    levels: Mapping[str, float]
    weak: tuple[str, ...]
    missing: tuple[MonitoredEffect, ...]

    @property
    def name(self) -> str:
        """That of the model of this plane."""
        return self.regression.name

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Signals of the controls."""
        return tuple(self.regression.controls.values())

    @property
    def parameters(self) -> tuple[str, ...]:
        """Derivatives and constants that its motion knows, those that its model does not have behind."""
        absent = (e.name for e in self.missing if e.name.partition("_")[0] in self.least)
        return (*self.regression.derivatives, *absent)


PRIOR, PRIOR_WEAK = 0.01, 0.05  # of a derivative: what an estimate of a good flight leaves open, strong and weak ones


def _delay(control: str) -> MonitoredEffect:
    return MonitoredEffect(f"{control}_delay", f"{control} acts late", "actuator", 0.02, "s")


def _vane(angle: str, words: str) -> tuple[MonitoredEffect, MonitoredEffect]:
    return (
        MonitoredEffect(f"{angle}_lag", f"{words} vane lags", "sensor", 0.03, "s"),
        MonitoredEffect(f"{angle}_bias", f"{words} vane has slipped", "sensor", 0.02, "rad"),
    )


LATERAL_PLANE = MonitoredPlane(
    LATERAL,
    ("beta", "p", "r", "phi", "ay"),
    4,
    {"ay": "CY", "p": "Cl", "r": "Cn", "beta": "kinematics", "phi": "kinematics"},
    ("aileron_delay", "rudder_delay"),
    {"CY_0": 0.01, "Cl_0": 0.002, "Cn_0": 0.001},
    {"CY": 0.01, "Cl": 0.003, "Cn": 0.002},
    {"CY_0": 0.002, "Cl_0": 0.0004, "Cn_0": 0.0002},
    ("CY_p", "CY_r", "Cl_r", "Cl_dr", "Cn_p"),
    (
        MonitoredEffect("Cn_da", "adverse yaw from aileron", "Cn", 0.005, "1/rad"),
        MonitoredEffect("CY_da", "side force from aileron", "CY", 0.02, "1/rad"),
        _delay("aileron"),
        _delay("rudder"),
        *_vane("beta", "sideslip"),
    ),
)
PITCH_PLANE = MonitoredPlane(
    LONGITUDINAL,
    ("alpha", "q", "theta", "ax", "az"),
    3,
    {"az": "CL", "ax": "CD", "q": "Cm", "alpha": "kinematics", "theta": "kinematics"},
    ("elevator_delay",),
    {"CL_0": 0.03, "CD_0": 0.004, "Cm_0": 0.005},
    {"CL": 0.05, "CD": 0.005, "Cm": 0.02},
    {"CL_0": 0.005, "CD_0": 0.001, "Cm_0": 0.001},
    ("CL_q", "CL_de", "CD_k", "Cm_q"),
    (_delay("elevator"), *_vane("alpha", "angle of attack")),
)
PLANES: Mapping[str, MonitoredPlane] = {p.name: p for p in (LATERAL_PLANE, PITCH_PLANE)}
"""By the regression of each."""

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
    "CL_0": "lift at rest (or mass)",
    "CL_alpha": "lift slope",
    "CD_0": "drag at rest (or thrust)",
    "CD_k": "induced drag",
    "Cm_0": "pitching trim",
    "Cm_alpha": "pitch stiffness (or centre of gravity)",
    "Cm_q": "pitch damping",
    "Cm_de": "elevator effectiveness",
}


MASS_STEP, CG_STEP = 0.05, 0.02  # share of the mass; part of the chord


def _loading(values: Mapping[str, float]) -> tuple[MonitoredEffect, ...]:
    """A mass that is another, thrust and drag still in balance, and a centre of gravity that has moved: what coefficients about
    the old one would show."""
    lift = {n: v for n, v in values.items() if n.startswith("CL_")}
    heavier = {n: -MASS_STEP * v for n, v in lift.items()} | {"CD_k": 2.0 * MASS_STEP * values.get("CD_k", 0.0)}
    aft = {f"Cm_{n.removeprefix('CL_')}": CG_STEP * v for n, v in lift.items() if n != "CL_q"}
    return (
        MonitoredEffect("mass", "mass has changed, share of it", "CL", MASS_STEP, "1", 0.0, heavier),
        MonitoredEffect("cg", "centre of gravity has moved aft, in chords", "Cm", CG_STEP, "1", 0.0, aft),
    )


def bank(
    values: Mapping[str, float], stds: Mapping[str, float], plane: MonitoredPlane = LATERAL_PLANE
) -> tuple[MonitoredEffect, ...]:
    """All effects for a model with these derivative values [1/rad].

    stds: what the model states of its derivatives' standard deviations; where it states nothing, 1 % or 5 %. What a plane may be
    missing is no such effect where the model has it.
    """
    effects = []
    missing = [e for e in plane.missing if e.name not in values]
    for name in (n for n in plane.parameters if n in values or n in plane.regression.derivatives):
        value, equation = abs(values.get(name, 0.0)), name.partition("_")[0]
        if name in plane.constants:
            step, prior, unit = plane.constants[name], plane.levels[name], "1"
        else:
            step, unit = max(0.1 * value, plane.least[equation]), "1" if name == "CD_k" else "1/rad"
            share = PRIOR_WEAK if name in plane.weak else PRIOR
            prior = stds.get(name, max(share * value, share * plane.least[equation]))
        effects.append(MonitoredEffect(name, TITLES.get(name, f"derivative {name}"), equation, step, unit, prior))
    return (*effects, *missing, *(_loading(values) if plane is PITCH_PLANE else ()))
