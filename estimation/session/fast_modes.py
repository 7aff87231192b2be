"""Modes that decay within one sampling interval of the control that drives them.

A rate with damping L [1/s] (`p`: Cl_p) answers a step of its control with the time constant T = 1/L. Where the control was logged
at intervals longer than T, another time of the step within its interval and another damping give the same samples. Damping and
control power then trade against each other, and the record determines only their ratio, the steady rate per deflection.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.utilities.constants import SEA_LEVEL_DENSITY
from estimation.estimators.result import Result
from estimation.prepare.columns import with_derived
from groundstation.flight import Flight

SLOWEST_RECORD = 1.0
"""Sampling interval of a control over the mode's time constant from which damping and control power cannot be separated: 63 % of
the response is over within it. Applies to held records only, not to an interpolated record of the true deflection."""
DAMPING: Mapping[str, tuple[str, str]] = {"Cl_p": ("Ixx", "b"), "Cm_q": ("Iyy", "c"), "Cn_r": ("Izz", "b")}
"""Damping -> its inertia and its length among the constants of a model."""
CONTROLS: Mapping[str, tuple[str, str]] = {
    "Cl_p": ("Cl_da", "delta_a"),
    "Cm_q": ("Cm_de", "delta_e"),
    "Cn_r": ("Cn_dr", "delta_r"),
}
"""Damping -> the control derivative that drives the same rate, and its control."""


@dataclass(frozen=True)
class FastMode:
    """A damping that the record of a control is too slow for. interval, time_constant [s]; ratio: control derivative over
    damping; std: its corrected bound."""

    damping: str
    control: str
    interval: float
    time_constant: float
    ratio: float
    std: float

    @property
    def text(self) -> str:
        """For a person."""
        return (
            f"{self.damping} cannot be told at {1.0 / self.interval:.3g} Hz: the motion that it damps decays in"
            f" {self.time_constant * 1e3:.0f} ms and the surface was logged every {self.interval * 1e3:.0f} ms; {self.control}/"
            f"{self.damping} can: {self.ratio:.3g} +- {self.std:.2g}; log the servo outputs faster to tell both"
        )


def fast_modes(result: Result, flights: Sequence[Flight]) -> list[FastMode]:
    """Dampings of a result that the records of these flights are too slow for."""
    modes = []
    for damping, (inertia, length) in DAMPING.items():
        control, surface = CONTROLS[damping]
        intervals = [i for f in flights if (i := f.held(surface)) is not None]
        measured = len(intervals) < len(flights)  # one record of the deflection itself determines the damping for all
        constants = [result.model.constants.get(n, math.nan) for n in (inertia, length, "S")]
        if damping not in result.parameters or control not in result.parameters or measured or not intervals:
            continue
        rate = _damping_rate(abs(result.parameters[damping].estimate), constants, flights)
        if rate * min(intervals) > SLOWEST_RECORD:
            modes.append(FastMode(damping, control, min(intervals), 1.0 / rate, *_ratio(result, control, damping)))
    return modes


def with_fast_modes(result: Result, flights: Sequence[Flight]) -> Result:
    """The result with such dampings and their control derivatives marked not identifiable."""
    parameters = dict(result.parameters)
    for mode in fast_modes(result, flights):
        for name in (mode.damping, mode.control):
            if parameters[name].identifiable:
                parameters[name] = replace(parameters[name], identifiable=False, why=mode.text)
    return replace(result, parameters=parameters)


def _damping_rate(derivative: float, constants: Sequence[float], flights: Sequence[Flight]) -> float:
    """L [1/s] at the median airspeed and density of the flights; NaN where one is not known. constants: inertia, length, area."""
    inertia, length, area = constants
    mass_flows = [_density(f) * float(np.nanmedian(f["V"])) for f in flights if f.measured("V")]  # rho V
    return 0.25 * derivative * float(np.median(mass_flows)) * area * length**2 / inertia if mass_flows else math.nan


def _density(flight: Flight) -> float:
    dense = with_derived(flight, ["rho"])
    return float(np.nanmedian(dense["rho"])) if dense.measured("rho") else SEA_LEVEL_DENSITY


def _ratio(result: Result, control: str, damping: str) -> tuple[float, float]:
    """Control derivative over damping, and its bound from the corrected bounds of both, taken as independent: their covariance
    does not contain the errors of the steps' times."""
    estimates = [result.parameters[n] for n in (control, damping)]
    ratio = estimates[0].estimate / estimates[1].estimate
    return ratio, abs(ratio) * math.hypot(*(e.std_coloured / abs(e.estimate) for e in estimates))
