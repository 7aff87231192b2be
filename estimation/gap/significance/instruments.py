"""Is it an instrument or the aircraft? The kinematic check, and columns of the wrong sign, unit or time.

Flight-path reconstruction without any aerodynamics: sideslip and bank integrated from measured rates and side
acceleration must agree with the vane and the attitude. Scale, lag, position and timing errors of instruments show here;
aerodynamic, inertial and actuator effects cannot. Scored and calibrated on nulls like everything else. For a model that pitches,
the same check uses airspeed, angle of attack and pitch attitude; a model of all axes has both, and the clearer answer counts.

A column that is turned, in another unit or late shows in the first fit of the model.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.utilities.constants import GRAVITY
from estimation.errors import GapError
from estimation.estimators.normal_equations import pseudo_inverse
from estimation.estimators.result import Estimate
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect, Group
from estimation.gap.fit.baseline import Baseline, fit_baseline
from estimation.gap.fit.noise import channel_noise, filtered_attitudes
from estimation.gap.records.candidate_model import (
    GYROS,
    TIMING,
    TOGETHER,
    rare_commands,
    timing_of,
    with_dormant,
    with_nuisance,
)
from estimation.gap.records.flight_records import prepare_flights, sample_interval
from estimation.gap.significance.calibration import Round, beyond_doubt, screen_round
from estimation.gap.significance.nulls import KINEMATIC, Stream, input_errors
from estimation.models.base import Model, Parameter, ParameterRole, Signal
from estimation.models.dependence import force_states
from estimation.session.sanity_checks import (
    controls_of_another_unit,
    turned_controls,
    turned_outputs,
    turned_side_force,
)
from groundstation.flight import Flight

MOST_NULLS = 100  # enough to tell sensor from physics
NEEDED_TO_PITCH = ("V", "alpha", "theta", "q", "ax", "az")
OPTIONAL = ("beta", "p", "r", "phi", "ay")  # zero where a flight lacks them
NEEDED = ("beta", "phi", "p", "q", "r", "ay", "V", "alpha", "theta")


def pitch_kinematic_model(criteria: Criteria) -> Model:
    """Flight-path reconstruction in the plane of symmetry without aerodynamics; biases and scale errors with priors."""
    gyro = scale = criteria.instrument_error  # rad/s, and a share
    accelerometer = criteria.instrument_error * GRAVITY
    return Model(
        name="kinematic",
        title="airspeed, angle of attack and pitch attitude from measured rates and forces, no aerodynamics",
        states=(Signal("V", "m/s"), Signal("alpha", "rad"), Signal("theta", "rad")),
        inputs=(*(Signal(n) for n in ("q", "ax", "az")), *(Signal(n, optional=True) for n in OPTIONAL)),
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


def kinematic_model(criteria: Criteria) -> Model:
    """Sideslip and bank from measured rates and side acceleration; biases and scale errors with priors."""
    gyro = scale = criteria.instrument_error  # rad/s, and a share
    accelerometer = criteria.instrument_error * GRAVITY
    return Model(
        name="kinematic",
        title="sideslip and bank from measured rates and side acceleration, no aerodynamics",
        states=(Signal("beta", "rad"), Signal("phi", "rad")),
        inputs=tuple(Signal(n) for n in ("p", "q", "r", "ay", "V", "alpha", "theta", "V_dot")),
        outputs=(Signal("beta", "rad"), Signal("phi", "rad")),
        parameters=(
            _instrument("bias_gyro_p", "rad/s", gyro, local=True),
            _instrument("bias_gyro_r", "rad/s", gyro, local=True),
            _instrument("bias_accelerometer_y", "m/s2", accelerometer, local=True),
            _instrument("scale_gyro_p", "1", scale),
            _instrument("scale_gyro_r", "1", scale),
        ),
        constants={"g": GRAVITY},
        equations=(
            "p_true = p*(1 + scale_gyro_p) + bias_gyro_p",
            "r_true = r*(1 + scale_gyro_r) + bias_gyro_r",
            "beta_dot = p_true*sin(alpha) - r_true*cos(alpha)"
            " + (ay + bias_accelerometer_y + g*cos(theta)*sin(phi))/(V*cos(beta)) - V_dot/V*tan(beta)",
            "phi_dot = p_true + tan(theta)*(q*sin(phi) + r_true*cos(phi))",
        ),
    )


def _instrument(name: str, unit: str, width: float, local: bool = False) -> Parameter:
    return Parameter(name, unit, prior_mean=0.0, prior_std=width, local=local, role=ParameterRole.INSTRUMENT)


@dataclass(frozen=True)
class KinematicCheck:
    """origin: sensor | physics | undecided. best: the instrument error that fits the kinematics best."""

    origin: str
    best: str
    score: float
    threshold: float
    why: str

    def to_json(self) -> dict[str, Any]:
        return {
            "origin": self.origin,
            "best": self.best,
            "score": round(self.score, 2),
            "threshold": round(self.threshold, 2),
            "why": self.why,
        }


def kinematic_check(
    flights: Sequence[Flight],
    effects: Sequence[Effect],
    nulls: int,
    seed: int,
    criteria: Criteria,
    model: Model | None = None,
) -> KinematicCheck:
    """Score every instrument error on the kinematics of the training flights, with `nulls` nulls. model: its planes are checked;
    default the lateral."""
    lines = model.definitions if model is not None else {}
    planes: list[tuple[Model, tuple[str, ...]]] = []
    if "Cm" not in lines or "CY" in lines:
        planes.append((kinematic_model(criteria), NEEDED))
    if "Cm" in lines:
        planes.append((pitch_kinematic_model(criteria), NEEDED_TO_PITCH))
    return clearest([_checked(base, needed, flights, effects, nulls, seed, criteria) for base, needed in planes])


def clearest(checks: Sequence[KinematicCheck]) -> KinematicCheck:
    """The check with the highest score over its threshold; an undecided one only where all are."""
    return max(checks, key=lambda c: (c.origin != "undecided", c.score / c.threshold if c.threshold > 0.0 else 0.0))


def _checked(
    base: Model,
    needed: Sequence[str],
    flights: Sequence[Flight],
    effects: Sequence[Effect],
    nulls: int,
    seed: int,
    criteria: Criteria,
) -> KinematicCheck:
    missing = sorted({n for f in flights for n in needed if not f.measured(n)})
    if missing:
        return KinematicCheck("undecided", "", 0.0, 0.0, f"not measured: {', '.join(missing)}")
    instruments = tuple(e for e in effects if e.group is Group.SENSOR and not e.tied_to)
    prepared = prepare_flights(base, instruments, flights, (), criteria)
    scatter = channel_noise(prepared.records)
    filtered = filtered_attitudes(prepared.records, base.output_names, scatter, criteria)
    noise, interval = dict(zip(base.output_names, scatter, strict=True)), sample_interval(prepared.records)
    clean = with_nuisance(base, noise, interval, criteria, filtered)
    working = with_dormant(clean, instruments, prepared.available, force_states(base))
    errors = [
        input_errors(r, clean, Stream.KINEMATIC_INPUT_ERRORS.generator(seed, i)) for i, r in enumerate(prepared.records)
    ]
    try:
        baseline = fit_baseline(working, clean, prepared, scatter)
        round_ = screen_round(baseline, prepared, instruments, errors, min(nulls, MOST_NULLS), seed + KINEMATIC)
        decides = beyond_doubt(float(round_.standardised().max(initial=0.0)), round_.threshold)
        return origin_of_error(round_ if decides else round_.with_enough_nulls)
    except GapError as error:  # the check is undecided: the search goes on without it
        return KinematicCheck("undecided", "", 0.0, 0.0, str(error))


def origin_of_error(round_: Round) -> KinematicCheck:
    """Sensor where an instrument error is above the threshold, physics where none is."""
    scores = round_.standardised()
    if not scores.size:
        return KinematicCheck("undecided", "", 0.0, round_.threshold, "no instrument error applies")
    leader = int(np.argmax(scores))
    label, score = round_.screen.hypotheses[leader].label, float(scores[leader])
    origin, agreement = ("physics", "agrees with its kinematics")
    if score > round_.threshold:
        origin, agreement = ("sensor", "contradicts its own kinematics")
    return KinematicCheck(origin, label, score, round_.threshold, f"measured motion {agreement}")


# ---- what the first fit shows
def turned_signs(baseline: Baseline) -> list[str]:
    """One sentence for each column that contradicts the base model or its reference values in sign or unit."""
    problem, fit = baseline.problem, baseline.fit
    base, bounds = problem.base, fit.std()
    pairs = [(record.z, record.z - e) for record, e in zip(problem.coarse, fit.residuals, strict=True)]
    estimates = {
        n: Estimate(n, fit.values[n], bounds[n], bounds[n], reference=base.parameter(n).reference)
        for n in base.starts()
        if n in bounds
    }
    return [
        *turned_outputs(base, pairs),
        *turned_side_force(base, estimates),
        *turned_controls(base, estimates),
        *controls_of_another_unit(base, estimates),
    ]


def late_commands(flights: Sequence[Flight], baseline: Baseline) -> str:
    """A sentence on controls recorded as commands no more often than the motion: how long before their record they moved, as the
    gyros show it; empty without such controls."""
    fit, intervals = baseline.fit, rare_commands(baseline.clean, flights)
    signals = [s for s in baseline.clean.inputs if s.name in intervals]
    if not signals:
        return ""
    back = [float(np.mean([f.dated_back(s.source) for f in flights])) for s in signals]
    shifts = [timing_of(s.name, fit.values) for s in signals]
    weight = {TOGETHER: -1.0, GYROS: 1.0} | {f"{TIMING}{s.name}": -1.0 / len(signals) for s in signals}
    share = np.array([weight.get(n, 0.0) for n in fit.free])
    before = np.mean(back) - np.mean(shifts) + fit.values.get(GYROS, 0.0)
    bound = np.sqrt(max(share @ pseudo_inverse(fit.hessian)[0] @ share, 0.0))
    are, they = ("are commands", "they") if len(signals) > 1 else ("is a command", "it")
    return (
        f"{' and '.join(s.name for s in signals)} {are} that the log has every {1e3 * max(intervals.values()):.0f} ms, recorded "
        f"{1e3 * before:.0f} +- {1e3 * bound:.0f} ms after {they} moved by what the gyros show, each move by another time "
        "within that interval: counted."
    )
