"""The kinematic gate: is it an instrument or the aircraft?

Flight-path reconstruction without any aerodynamics: sideslip and bank integrated from measured rates and side
acceleration must agree with the vane and the attitude. Scale, lag, position and timing errors of instruments show here;
aerodynamic, inertial and actuator effects cannot. Scored and calibrated on nulls like everything else.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from estimation.engine.kernel import Array
from estimation.gap.baseline import channel_noise, filtered_attitudes, fit_baseline, screen_round
from estimation.gap.bench import build_bench
from estimation.gap.dormant import with_dormant
from estimation.gap.effects.base import Effect, Group
from estimation.gap.errors import GapError
from estimation.gap.nuisance import with_nuisance
from estimation.gap.nulls import input_errors
from estimation.gap.whitening import force_states
from estimation.models.base import Model, Parameter, Signal
from groundstation.flight import Flight

GRAVITY = 9.80665
NEEDED = ("beta", "phi", "p", "q", "r", "ay", "V", "alpha", "theta")

KINEMATIC = Model(
    name="kinematic",
    title="sideslip and bank from measured rates and side acceleration, no aerodynamics",
    states=(Signal("beta", "rad"), Signal("phi", "rad")),
    inputs=tuple(Signal(n) for n in ("p", "q", "r", "ay", "V", "alpha", "theta", "V_dot")),
    outputs=(Signal("beta", "rad"), Signal("phi", "rad")),
    parameters=(
        Parameter("bias_gyro_p", "rad/s", local=True, prior_mean=0.0, prior_std=0.02),
        Parameter("bias_gyro_r", "rad/s", local=True, prior_mean=0.0, prior_std=0.02),
        Parameter("bias_accelerometer_y", "m/s2", local=True, prior_mean=0.0, prior_std=0.2),
        Parameter("scale_gyro_p", prior_mean=0.0, prior_std=0.005),
        Parameter("scale_gyro_r", prior_mean=0.0, prior_std=0.005),
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


@dataclass(frozen=True)
class Gate:
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


def kinematic_gate(flights: Sequence[Flight], effects: Sequence[Effect], nulls: int, seed: int) -> Gate:
    """Score every instrument error on the kinematics of the training flights alone."""
    import numpy as np

    lacking = sorted({n for f in flights for n in NEEDED if not f.measured(n)})
    if lacking:
        return Gate("undecided", "", 0.0, 0.0, f"not measured: {', '.join(lacking)}")
    instruments = tuple(e for e in effects if e.group is Group.SENSOR and not e.tied_to)
    bench = build_bench(KINEMATIC, instruments, flights, ())
    scatter: Array = channel_noise(bench.records)
    filtered = filtered_attitudes(bench.records, bench.base.output_names, scatter)
    interval = float(np.median([np.median(np.diff(r.time)) for r in bench.records]))
    clean = with_nuisance(KINEMATIC, dict(zip(KINEMATIC.output_names, scatter, strict=True)), interval, filtered)
    working = with_dormant(clean, instruments, bench.available, force_states(KINEMATIC))
    errors = [input_errors(r, clean, np.random.default_rng([seed, 49979687, i])) for i, r in enumerate(bench.records)]
    try:
        baseline = fit_baseline(working, clean, bench, scatter)
        round_ = screen_round(baseline, bench, instruments, errors, nulls, seed + 31)
    except GapError as error:  # the gate alone cannot say: the search among the hypotheses goes on without it
        return Gate("undecided", "", 0.0, 0.0, str(error))
    scores = round_.standardised()
    if not scores.size:
        return Gate("undecided", "", 0.0, round_.threshold, "no instrument error applies")
    best = int(np.argmax(scores))
    label, score = round_.screen.hypotheses[best].label, float(scores[best])
    if score > round_.threshold:
        return Gate("sensor", label, score, round_.threshold, "measured motion contradicts its own kinematics")
    return Gate("physics", label, score, round_.threshold, "measured motion agrees with its kinematics")
