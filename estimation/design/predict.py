"""The motion that an input would cause, the limits that it would use, and the Cramer-Rao bounds of its flight.

The aircraft is the model with a first-order servo before each control and, where wanted, a pilot who gently holds bank and pitch.
The moved surfaces are those that a flight would measure: they drive the model again for the sensitivities S of its outputs. With
noise R the information is sum S' R^-1 S, initial states projected out.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.utilities.constants import GRAVITY
from estimation.design.limits import Condition, Limits
from estimation.engine.simulate import Simulator
from estimation.errors import EstimationError
from estimation.models.base import Model, Parameter, Signal
from estimation.prepare.flight_data import Segment
from groundstation.flight import Array

SERVO_LAG = 0.04
"""Time constant of a servo [s]: a hobby servo reaches a step in about 0.1 s."""
HOLD_GAIN = {"delta_a": ("phi", 0.10), "delta_e": ("theta", 0.18)}
"""Control -> (angle held, rad of control per rad): as a pilot holds an aircraft gently between manoeuvres."""
INTEGRATION_STEP = 0.02
"""Step of simulated motion [s]: the frame of servo pulses."""
NOISE = {
    "beta": math.radians(0.25), "alpha": math.radians(0.3), "p": math.radians(0.4), "q": math.radians(0.4),
    "r": math.radians(0.3), "phi": math.radians(0.3), "theta": math.radians(0.3), "psi": math.radians(0.6),
    "V": 0.15, "ax": 0.05, "ay": 0.05, "az": 0.08,
}  # fmt: skip
"""Noise of the outputs where no estimate gives one, 1 sigma: calibrated records of a small aircraft."""
OTHER_NOISE_SHARE = 0.02  # noise of an unknown instrument, over the range of its output in the manoeuvre
RANK = 1e-12  # of the largest eigenvalue of an information matrix: smaller ones count as zero
LEAST_COMPONENT = 1e-9  # squared, of a parameter along a direction without information: from there it has no bound


@dataclass(frozen=True)
class DesignSetting:
    """The setting that all inputs of a design share. controls: inputs that the design moves, in this order.

    values: parameters. noise: output -> sigma. rate_hz: of the samples. held: whether a pilot holds bank and pitch.
    noise_of_residuals: whether `noise` is that of the residuals of a flight, in which noise of its inputs is included.
    """

    model: Model
    condition: Condition
    controls: tuple[str, ...]
    values: Mapping[str, float]
    noise: Mapping[str, float]
    rate_hz: float = 20.0
    held: bool = False
    noise_of_residuals: bool = False

    def __post_init__(self) -> None:
        controls = [s.name for s in self.model.inputs if s.control]
        unknown_controls = [c for c in self.controls if c not in controls]
        if unknown_controls or not self.controls:
            raise EstimationError(
                f"model {self.model.name} has the controls {', '.join(controls) or 'none'},"
                f" not {', '.join(unknown_controls) or 'none'}"
            )


@dataclass(frozen=True)
class PredictedMotion:
    """time (N,); surfaces: control -> (N,) deflections [rad], trim included; signals: name -> (N,) states and outputs; reached:
    whether the motion stayed finite to the end."""

    time: Array
    surfaces: Mapping[str, Array]
    signals: Mapping[str, Array]
    reached: bool = True


@dataclass(frozen=True)
class LimitUse:
    """Use of one limit: largest deviation from trim or from the middle of its range, and the one allowed; SI and radians."""

    name: str
    used: float
    allowed: float

    @property
    def share(self) -> float:
        return self.used / self.allowed


@dataclass(frozen=True)
class DesignInformation:
    """names (n,); matrix (n, n): information of the parameters, initial states projected out."""

    names: tuple[str, ...]
    matrix: Array

    @property
    def std(self) -> dict[str, float]:
        """Cramer-Rao bound of each parameter, 1 sigma; inf where the input does not determine it."""
        scale = np.sqrt(np.diag(self.matrix))
        informed = scale > 0.0
        bound = np.full(len(self.names), np.inf)
        if informed.any():
            normal = self.matrix[np.ix_(informed, informed)] / np.outer(scale[informed], scale[informed])
            values, vectors = np.linalg.eigh(normal)
            inverse = np.where(values > RANK * values.max(), 1.0 / np.maximum(values, 1e-300), np.inf)
            spread = np.where(vectors**2 > LEAST_COMPONENT, vectors**2, 0.0)
            with np.errstate(invalid="ignore"):
                variance = np.nansum(np.where(spread > 0.0, spread * inverse, 0.0), axis=1)
            bound[informed] = np.sqrt(variance) / scale[informed]
        return dict(zip(self.names, bound.tolist(), strict=True))


def driven_model(setting: DesignSetting) -> Model:
    """The model with a servo before each control: control becomes a state, its command `<control>_command` an input."""
    model = setting.model
    inputs = tuple(s for s in model.inputs if s.name not in setting.controls)
    commands = tuple(Signal(f"{c}_command", "rad") for c in setting.controls)
    states = tuple(Signal(c, "rad") for c in setting.controls)
    lines = [f"{c}_dot = ({c}_command{_holding(setting, c)} - {c})/servo_lag" for c in setting.controls]
    return replace(
        model,
        name=f"{model.name}, driven",
        inputs=(*inputs, *commands),
        states=(*model.states, *states),
        outputs=(*model.outputs, *states),
        parameters=tuple(replace(p, fixed=True, local=False) for p in model.parameters),
        constants={**model.constants, "servo_lag": SERVO_LAG},
        equations=(*model.equations, *lines),
        transforms=(),
        output_delays={},
    )


def _holding(setting: DesignSetting, control: str) -> str:
    hold = HOLD_GAIN.get(control)
    if not setting.held or hold is None or hold[0] not in setting.model.state_names:
        return ""
    signal, gain = hold
    return f" + {gain}*({signal} - ({setting.condition.trim_value(signal)!r}))"


def fly(setting: DesignSetting, commands: Array) -> PredictedMotion:
    """The motion caused by commands (N, nu) [rad], increments from trim at INTEGRATION_STEP."""
    model = driven_model(setting)
    time = np.arange(len(commands), dtype=np.float64) * INTEGRATION_STEP
    u = np.tile([setting.condition.trim_value(s.name) for s in model.inputs], (len(time), 1))
    first = len(model.inputs) - len(setting.controls)
    trim = np.array([setting.condition.trim_value(c) for c in setting.controls])
    u[:, first:] = trim + commands
    x0 = np.array([setting.condition.trim_value(s.name) for s in model.states])
    z = np.full((len(time), len(model.outputs)), np.nan)
    simulator = Simulator.build(model, (), hold="linear")
    motion = simulator.run(Segment(0, time, u, z, x0), {**model.starts(), **setting.values}, x0)
    surfaces = {c: motion.x[:, len(setting.model.states) + i] for i, c in enumerate(setting.controls)}
    signals = {s.name: motion.x[:, i] for i, s in enumerate(setting.model.states)}
    signals |= {s.name: motion.y[:, i] for i, s in enumerate(setting.model.outputs)}
    return PredictedMotion(time, surfaces, signals, motion.reached == len(time))


def sampled(setting: DesignSetting, motion: PredictedMotion) -> NDArray[np.intp]:
    """Indices of the steps of the motion at which samples are taken."""
    return np.arange(0, len(motion.time), max(1, round(1.0 / (setting.rate_hz * INTEGRATION_STEP))))


def information(setting: DesignSetting, motion: PredictedMotion) -> DesignInformation:
    """The information of samples of this motion on the free parameters. EstimationError where the model diverges."""
    keep = sampled(setting, motion)
    model = setting.model
    u = np.tile([setting.condition.trim_value(s.name) for s in model.inputs], (keep.size, 1))
    for i, signal in enumerate(model.inputs):
        if signal.name in motion.surfaces:
            u[:, i] = motion.surfaces[signal.name][keep]
    x0 = np.array([setting.condition.trim_value(s.name) for s in model.states])
    z = np.full((keep.size, len(model.outputs)), np.nan)
    simulator = Simulator.build(model)
    run = simulator.run(
        Segment(0, motion.time[keep], u, z, x0), {**model.starts(), **setting.values}, x0, sensitivities=True
    )
    if run.dy is None or not run.finite:
        raise EstimationError(f"model {model.name} leaves all bounds in this manoeuvre; make it smaller or shorter")
    sigma = np.array([output_noise(setting, s, run.y[:, i]) for i, s in enumerate(model.outputs)])
    scaled = (run.dy / sigma[None, :, None]).reshape(-1, run.dy.shape[2])
    full = scaled.T @ scaled
    n = len(simulator.free)
    by_state = full[n:, n:]
    parameter_information = (
        full[:n, :n] - full[:n, n:] @ np.linalg.pinv(by_state, rcond=RANK, hermitian=True) @ full[n:, :n]
    )
    return DesignInformation(simulator.free, 0.5 * (parameter_information + parameter_information.T))


def output_noise(setting: DesignSetting, signal: Signal, values: Array) -> float:
    """Noise of one output's instrument, 1 sigma."""
    stated_noise = setting.noise.get(signal.name, NOISE.get(signal.name))
    return stated_noise if stated_noise else max(OTHER_NOISE_SHARE * float(np.ptp(values)), 1e-9)


def limits_used(setting: DesignSetting, limits: Limits, commands: Array, motion: PredictedMotion) -> list[LimitUse]:
    """The use of every limit by a manoeuvre; limits on signals that the model does not have are left out."""
    limit_uses = [
        LimitUse(c, float(np.abs(commands[:, i]).max()), limits.amplitude_of(c)) for i, c in enumerate(setting.controls)
    ]
    signals = dict(motion.signals)
    if "az" in signals:
        signals["load_factor"] = -signals["az"] / GRAVITY
    for name, (lowest, highest, relative) in limits.response.items():
        if name not in signals:
            continue
        trim = signals[name][0] if relative else 0.0
        middle, half = trim + 0.5 * (lowest + highest), 0.5 * (highest - lowest)
        limit_uses.append(LimitUse(name, float(np.abs(signals[name] - middle).max()), half))
    return limit_uses


def with_values(model: Model, values: Mapping[str, float]) -> Model:
    """The model with other parameter values; names that it does not have are ignored."""
    return model.with_starts({n: v for n, v in values.items() if n in model.parameter_names})


def estimated_names(parameters: Sequence[Parameter]) -> list[str]:
    """Derivatives whose relative bound has a meaning: no constants, and none with a prior of zero."""
    return [p.name for p in parameters if not p.fixed and not p.name.endswith("_0") and (p.reference or p.start) != 0.0]
