"""The design of an input: kinds of input, the doublets that each is compared with, and the result as data."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from daq.contract.manoeuvre import FINENESS, Manoeuvre, checked
from daq.utilities.plain_words import did_you_mean
from estimation.aircraft import Aircraft
from estimation.design.limits import Condition, Limits, trimmed, usual_limits
from estimation.design.measured_inputs import DRAWS, expected_errors
from estimation.design.optimal import (
    Criterion,
    Designed,
    a_optimal,
    d_optimal,
    fitted_sizes,
    measure,
    multisine,
    one_parameter,
    optimal,
    worst_of,
)
from estimation.design.predict import INTEGRATION_STEP, DesignSetting, estimated_names, with_values
from estimation.design.shapes import PATTERNS, chirp, pattern, relative_peak_factor
from estimation.errors import EstimationError
from estimation.estimators.result import finite_or_none
from estimation.models.base import Model

KINDS = ("doublet", "121", "3211", "chirp", "multisine", "optimal")
CRITERIA = ("worst", "D", "A")
USUAL_BAND = (0.1, 1.5)
"""Frequencies of chirps and multisines [Hz]: from a tenth of a Dutch roll to above the roll mode of a small aircraft."""
WIDTHS = (0.2, 0.25, 0.33, 0.4, 0.5, 0.65, 0.8, 1.0)
"""Step widths [s] that are tried for patterns: periods of 0.4 to 2 s for a doublet."""
NARROWER = (1.0, 0.8, 0.65, 0.5)
"""Upper ends of the bands that are tried for an optimal input, over that of the band given."""
FIRST = 0.5  # s of trim before the first pattern
REPEATS = 2  # patterns of each control in a set
SHORTEST_S, LONGEST_S = 2.0, 600.0  # of a manoeuvre
FILLED = 0.8  # of its slot, by a pattern too long for all of WIDTHS
SWEPT = 0.95  # of its slot, by a chirp
UNTOLD = 0.3
"""Bound over size beyond which a derivative counts as not identifiable: three bounds reach from zero to twice its value."""


@dataclass(frozen=True)
class DesignTask:
    """What to design. controls: empty for all of the model. criterion: one of CRITERIA or a parameter's name.

    duration [s], speed [m/s], density [kg/m3], band [Hz]. separate: parameters to be told apart, in place of the criterion.
    sizes: by which errors are measured. values, noise: from an estimate where there is one, with noise_of_residuals. rate_hz: of
    the samples. held: whether a pilot holds bank and pitch. draws: flights with noisy inputs from which the prediction comes.
    """

    kind: str
    duration: float
    speed: float
    density: float = 1.17
    controls: tuple[str, ...] = ()
    band: tuple[float, float] = USUAL_BAND
    criterion: str = "worst"
    separate: tuple[str, ...] = ()
    sizes: Mapping[str, float] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    rate_hz: float = 20.0
    held: bool = False
    seed: int = 1
    noise_of_residuals: bool = False
    draws: int = DRAWS


@dataclass(frozen=True)
class InputDesign:
    """The designed input, doublets of equal length under the same limits, and the sizes by which errors are measured."""

    task: DesignTask
    setting: DesignSetting
    limits: Limits
    best: Designed
    doublets: Designed
    sizes: Mapping[str, float]
    aircraft: str = ""
    notes: tuple[str, ...] = ()

    @cached_property
    def expected(self) -> dict[str, float]:
        """Predicted standard deviation of each parameter, with all sensors noisy."""
        return self._expected(self.best)

    @cached_property
    def expected_of_doublets(self) -> dict[str, float]:
        """The same for the doublets."""
        return self.expected if self.best is self.doublets else self._expected(self.doublets)

    def _expected(self, designed: Designed) -> dict[str, float]:
        task = self.task
        return expected_errors(self.setting, designed.motion, designed.information.std, task.seed, task.draws)

    @property
    def relative(self) -> dict[str, float]:
        """Predicted standard deviation over size of each derivative that has one."""
        return relative_errors(self.expected, self.sizes)

    @property
    def untold(self) -> tuple[str, ...]:
        """Derivatives that this input does not identify."""
        return tuple(n for n, r in self.relative.items() if r > UNTOLD)

    @property
    def gain(self) -> float:
        """Worst relative prediction of the doublets over that of this input."""
        return max(relative_errors(self.expected_of_doublets, self.sizes).values()) / max(self.relative.values())

    def manoeuvre(self) -> Manoeuvre:
        """The manoeuvre as in the file that is flown."""
        commands = np.round(self.best.commands / FINENESS) * FINENESS
        commands[[0, -1]] = 0.0
        std = self.expected
        return checked(
            Manoeuvre(
                self.best.kind,
                INTEGRATION_STEP,
                {c: tuple(commands[:, i].tolist()) for i, c in enumerate(self.setting.controls)},
                aircraft=self.aircraft,
                model=self.setting.model.name,
                limits={u.name: {"used": u.used, "allowed": u.allowed} for u in self.best.used},
                predicted={n: {"std": s} for n, s in std.items() if math.isfinite(s)},
                about={
                    "speed": self.task.speed,
                    "density": self.task.density,
                    "pilot_holds": self.task.held,
                    "seed": self.task.seed,
                    "gain_over_doublets": self.gain,
                },
            )
        )

    def to_json(self) -> dict[str, Any]:
        """As in the interface description, with limits, motion and notes besides."""
        bounds = self.best.information.std
        return {
            "kind": self.best.kind,
            "time": self.best.motion.time.tolist(),
            "inputs": {c: self.best.commands[:, i].tolist() for i, c in enumerate(self.setting.controls)},
            "predicted": {
                n: {
                    "std": finite_or_none(s),
                    "std_outputs": finite_or_none(bounds[n]),
                    "relative": finite_or_none(self.relative.get(n, math.nan)),
                }
                for n, s in self.expected.items()
            },
            "peak_factor": self.peak_factors(),
            "limits": {u.name: {"used": u.used, "allowed": u.allowed} for u in self.best.used},
            "untold": list(self.untold),
            "gain_over_doublets": self.gain,
            "motion": {n: v.tolist() for n, v in self.best.motion.signals.items()},
            "notes": list(self.notes),
        }

    def peak_factors(self) -> dict[str, float]:
        """Relative peak factor of each control; of multisines over a period."""
        rows = self.best.commands[:-1] if self.best.waves else self.best.commands
        return {c: relative_peak_factor(rows[:, i]) for i, c in enumerate(self.setting.controls)}


def relative_errors(std: Mapping[str, float], sizes: Mapping[str, float]) -> dict[str, float]:
    """Standard deviation over size, for the parameters that have a size."""
    return {n: std[n] / abs(size) for n, size in sizes.items() if n in std and size != 0.0}


def relative_bounds(designed: Designed, sizes: Mapping[str, float]) -> dict[str, float]:
    """Cramer-Rao bound over size, by which inputs are compared."""
    return relative_errors(designed.information.std, sizes)


def design(model: Model, aircraft: Aircraft, task: DesignTask, limits: Limits | None = None) -> InputDesign:
    """Design an input. Raises EstimationError with a way out for an input that cannot be designed."""
    if task.kind not in KINDS:
        raise EstimationError(
            f"kind {task.kind!r} is unknown; choose from {', '.join(KINDS)}{did_you_mean(task.kind, KINDS)}"
        )
    if not SHORTEST_S <= task.duration <= LONGEST_S:
        raise EstimationError(f"--time {task.duration:g}: give from {SHORTEST_S:g} to {LONGEST_S:g} s")
    limits_allowed = limits or usual_limits()
    valued_model = with_values(model, task.values)
    condition = trimmed(valued_model, aircraft, task.speed, task.density)
    setting = _setting(valued_model, condition, task)
    sizes = _sizes(valued_model, task)
    rng = np.random.default_rng([task.seed, 20])
    doublets = pattern_set(setting, limits_allowed, "doublet", task.duration, sizes)
    _refuse_untold(setting, doublets, task)
    if task.kind == "doublet":
        chosen_design = doublets
    elif task.kind in PATTERNS:
        chosen_design = pattern_set(setting, limits_allowed, task.kind, task.duration, sizes)
    elif task.kind == "chirp":
        chosen_design = chirp_set(setting, limits_allowed, task.duration, task.band)
    else:
        chosen_design = _sines(setting, limits_allowed, task, sizes, rng, doublets)
    return InputDesign(task, setting, limits_allowed, chosen_design, doublets, sizes, aircraft.name, condition.notes)


def _setting(model: Model, condition: Condition, task: DesignTask) -> DesignSetting:
    controls = task.controls or tuple(s.name for s in model.inputs if s.control)
    values = {p.name: p.start for p in model.parameters}
    return DesignSetting(
        model, condition, controls, values, task.noise, task.rate_hz, task.held, task.noise_of_residuals
    )


def _sizes(model: Model, task: DesignTask) -> dict[str, float]:
    """By what the error of each derivative is measured: the stated size, else the estimate, else the prior value."""
    believed = {
        n: (model.parameter(n).reference or model.parameter(n).start) for n in estimated_names(model.parameters)
    }
    sizes = {n: task.values.get(n) or size for n, size in believed.items()}
    sizes |= {n: s for n, s in task.sizes.items() if n in model.parameter_names}
    requested_names = task.separate or (() if task.criterion in CRITERIA else (task.criterion,))
    unknown = [n for n in requested_names if n not in sizes]
    if unknown:
        raise EstimationError(
            f"{unknown[0]!r} is no parameter with a size of model {model.name}; it has {', '.join(sizes)}"
        )
    return {n: sizes[n] for n in task.separate} if task.separate else sizes


def _refuse_untold(setting: DesignSetting, doublets: Designed, task: DesignTask) -> None:
    """Raise EstimationError for parameters that doublets on every control do not separate: no motion of these controls does."""
    std = doublets.information.std
    tied = [n for n in task.separate if math.isinf(std[n])]
    if tied:
        raise EstimationError(
            f"{' and '.join(tied)}: no motion of {', '.join(setting.controls)} in model {setting.model.name} tells them from the "
            "other parameters; design with a model of more controls (--model six-dof), or look on the setting"
        )


def pattern_set(
    setting: DesignSetting, limits: Limits, name: str, duration: float, sizes: Mapping[str, float]
) -> Designed:
    """A pattern REPEATS times on each control, one after the other, of the step width with the smallest worst relative bound."""
    time = np.arange(0.0, duration + 0.5 * INTEGRATION_STEP, INTEGRATION_STEP)
    slots = REPEATS * len(setting.controls)
    room = (duration - FIRST) / slots
    widths = [w for w in WIDTHS if len(PATTERNS[name]) * w + FIRST <= room] or [FILLED * room / len(PATTERNS[name])]

    def with_width(width: float) -> Designed:
        commands = np.zeros((time.size, len(setting.controls)))
        for slot in range(slots):
            i = slot % len(setting.controls)
            control = setting.controls[i]
            start = FIRST + slot * room
            commands[:, i] += pattern(name, time, start, width, limits.amplitude_of(control), limits.rate_of(control))
        return measure(setting, limits, name, fitted_sizes(setting, limits, commands) * commands)

    return min(map(with_width, widths), key=lambda d: max(relative_bounds(d, sizes).values()))


def chirp_set(setting: DesignSetting, limits: Limits, duration: float, band: tuple[float, float]) -> Designed:
    """A sweep on each control, one after the other."""
    time = np.arange(0.0, duration + 0.5 * INTEGRATION_STEP, INTEGRATION_STEP)
    room = (duration - FIRST) / len(setting.controls)
    columns = [
        chirp(time, FIRST + i * room, SWEPT * room, band, limits.amplitude_of(c))
        for i, c in enumerate(setting.controls)
    ]
    commands = np.column_stack(columns)
    return measure(setting, limits, "chirp", fitted_sizes(setting, limits, commands) * commands)


def _sines(
    setting: DesignSetting,
    limits: Limits,
    task: DesignTask,
    sizes: Mapping[str, float],
    rng: np.random.Generator,
    doublets: Designed,
) -> Designed:
    """A multisine; of kind optimal, the best of optimal and flat multisines, doublets and 3-2-1-1s."""
    try:
        if task.kind == "multisine":
            return multisine(setting, limits, task.duration, task.band, rng)
        choose, judge = _criterion(task, sizes)
        steps = pattern_set(setting, limits, "3211", task.duration, sizes)
        sines = [
            optimal(setting, limits, task.duration, band, rng, sizes, choose, judge) for band in _bands(setting, task)
        ]
        return min((*sines, steps, doublets), key=judge)
    except ValueError as error:
        raise EstimationError(f"--time {task.duration:g}: {error}; give more time or a wider --band") from error


def _bands(setting: DesignSetting, task: DesignTask) -> list[tuple[float, float]]:
    """Bands that are tried for an optimal input: the one given, and narrower ones with two harmonics for each control. Where a
    limited signal answers low frequencies most, power near the top of the band is wasted."""
    low, high = task.band
    fewest = 2 * len(setting.controls) / task.duration
    return [(low, f * high) for f in NARROWER if f == 1.0 or f * high - low > fewest]


def _criterion(
    task: DesignTask, sizes: Mapping[str, float]
) -> tuple[Callable[[tuple[str, ...]], Criterion], Callable[[Designed], float]]:
    """(criterion for the allocation of power, from the names of parameters; judge of a simulated input, smaller is better)."""

    def worst(designed: Designed) -> float:
        return max(relative_bounds(designed, sizes).values())

    def worst_among(names: Sequence[str]) -> Criterion:
        return worst_of(np.array([n in sizes for n in names]))

    def negative_log_determinant(designed: Designed) -> float:
        return -float(np.linalg.slogdet(designed.information.matrix)[1])

    def sum_of_squares(designed: Designed) -> float:
        return math.fsum(r**2 for r in relative_bounds(designed, sizes).values())

    if task.separate or task.criterion == "worst":
        return worst_among, worst
    if task.criterion == "D":
        return (lambda names: d_optimal), negative_log_determinant
    if task.criterion == "A":
        return (lambda names: a_optimal), sum_of_squares
    name = task.criterion
    return (lambda names: one_parameter(names.index(name))), lambda designed: designed.information.std[name]
