"""Handling-quality numbers of a fit, each with its definition and source, and levels for aircraft to which the standards apply.

MIL-F-8785C (1980): roll mode time constant 3.3.1.2, Dutch roll 3.3.1.1, short period 3.2.2.1, control anticipation parameter
3.2.2.1.1 and figures 1 to 3. MIL-STD-1797A (1990): equivalent time delay and bandwidth, 4.2.1.2. All limits hold for piloted
aircraft and for the response to the stick; here it is the response to the measured surface, without the servo before it.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from daq.utilities.constants import GRAVITY
from estimation.errors import EstimationError
from estimation.frequency.forms import SURFACE_OF
from estimation.frequency.response import FrequencyResponse
from estimation.frequency.transfer import TransferFunction
from groundstation.flight import Array

LIGHTEST = 150.0  # kg; the standards are based on aircraft with a pilot aboard
CLASSES = ("I", "II", "III", "IV")
CATEGORIES = ("A", "B", "C")

# MIL-F-8785C table VII: largest roll mode time constant [s] of levels 1, 2, 3
ROLL_MODE = {
    **dict.fromkeys((("A", True), ("C", True)), (1.0, 1.4, 10.0)),
    **dict.fromkeys((("A", False), ("B", True), ("B", False), ("C", False)), (1.4, 3.0, 10.0)),
}
# table VI: least damping, least damping times frequency [rad/s], least frequency [rad/s] of levels 1, 2, 3
DUTCH_ROLL = {
    ("A", True): ((0.19, 0.35, 1.0), (0.02, 0.05, 0.4), (0.0, -math.inf, 0.4)),
    ("A", False): ((0.19, 0.35, 0.4), (0.02, 0.05, 0.4), (0.0, -math.inf, 0.4)),
    ("B", True): ((0.08, 0.15, 0.4), (0.02, 0.05, 0.4), (0.0, -math.inf, 0.4)),
    ("B", False): ((0.08, 0.15, 0.4), (0.02, 0.05, 0.4), (0.0, -math.inf, 0.4)),
    ("C", True): ((0.08, 0.15, 1.0), (0.02, 0.05, 0.4), (0.0, -math.inf, 0.4)),
    ("C", False): ((0.08, 0.10, 0.4), (0.02, 0.05, 0.4), (0.0, -math.inf, 0.4)),
}
# table IV: damping of the short period, from and to, of levels 1, 2, 3
SHORT_PERIOD = {
    "A": ((0.35, 1.30), (0.25, 2.00), (0.15, math.inf)),
    "B": ((0.30, 2.00), (0.20, 2.00), (0.15, math.inf)),
    "C": ((0.35, 1.30), (0.25, 2.00), (0.15, math.inf)),
}
# figures 1 to 3: control anticipation parameter [1/(g s2)] of levels 1 and 2
ANTICIPATION = {"A": ((0.28, 3.6), (0.16, 10.0)), "B": ((0.085, 3.6), (0.038, 10.0)), "C": ((0.16, 3.6), (0.096, 10.0))}
DELAY = (0.10, 0.20, 0.25)  # s, MIL-STD-1797A: largest equivalent delay of levels 1, 2, 3
STEP, LEAST_SIZE = 1e-5, 1e-6  # of a parameter, for a difference: relative, and of the least size
GAIN_MARGIN_DB, PHASE_MARGIN = 6.0, np.pi / 4  # of the bandwidth, MIL-STD-1797A
BANDWIDTH_POINTS = 2000  # frequencies of the fit in which crossings are searched


@dataclass(frozen=True)
class RatedAircraft:
    """The aircraft that levels are for. kind: class I to IV, "" for none; category: of flight phase; mass: kg or NaN."""

    kind: str = ""
    category: str = "B"
    mass: float = math.nan

    def __post_init__(self) -> None:
        if self.kind and self.kind not in CLASSES:
            raise EstimationError(f"class {self.kind!r}: MIL-F-8785C knows {', '.join(CLASSES)}")
        if self.category not in CATEGORIES:
            raise EstimationError(f"category {self.category!r}: MIL-F-8785C knows {', '.join(CATEGORIES)}")

    @property
    def why_no_level(self) -> str:
        """Why no levels are given; empty where they apply."""
        if self.mass < LIGHTEST:
            return (
                "no levels: the limits of MIL-F-8785C and MIL-STD-1797 are of piloted aircraft, and this one weighs "
                f"{self.mass:.3g} kg; frequencies of a small aircraft are higher by about the root of its scale, so neither its "
                "numbers nor its levels compare"
            )
        return "" if self.kind else "no levels: name the class of the aircraft with --class I, II, III or IV"

    @property
    def small_or_agile(self) -> bool:
        return self.kind in ("I", "IV")


@dataclass(frozen=True)
class Number:
    """One handling-quality number. std: NaN where it has none. level: 1 to 3, 4 beyond them, None where none applies."""

    name: str
    value: float
    std: float
    unit: str
    definition: str
    source: str
    level: int | None = None

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "std": self.std if math.isfinite(self.std) else None}


DEFINED: Mapping[str, tuple[str, str, str]] = {
    "T_R": ("s", "time constant of the roll mode", "MIL-F-8785C 3.3.1.2, table VII"),
    "zeta_d": ("1", "damping ratio of the Dutch roll", "MIL-F-8785C 3.3.1.1, table VI"),
    "omega_d": ("rad/s", "undamped natural frequency of the Dutch roll", "MIL-F-8785C 3.3.1.1, table VI"),
    "zeta_d omega_d": ("rad/s", "decay rate of the Dutch roll", "MIL-F-8785C 3.3.1.1, table VI"),
    "zeta_sp": ("1", "damping ratio of the short period", "MIL-F-8785C 3.2.2.1.2, table IV"),
    "omega_sp": ("rad/s", "undamped natural frequency of the short period", "MIL-F-8785C 3.2.2.1.1"),
    "n/alpha": ("g/rad", "V / (g T_theta2), steady normal acceleration per angle of attack", "MIL-F-8785C 3.2.2.1.1"),
    "CAP": (
        "1/(g s2)",
        "omega_sp^2 / (n/alpha), control anticipation parameter",
        "MIL-F-8785C 3.2.2.1.1, figures 1-3",
    ),
    "tau": ("s", "equivalent time delay, surface to output", "MIL-STD-1797A 4.2.1.2"),
    "omega_BW": (
        "rad/s",
        "bandwidth of the attitude: 45 deg of phase or 6 dB of gain margin, the lower",
        "MIL-STD-1797A 4.2.1.2",
    ),
    "tau_p": (
        "s",
        "phase delay of the attitude: (phase at w180 - phase at 2 w180) / 2 w180",
        "MIL-STD-1797A 4.2.1.2",
    ),
}
"""Name of a number -> unit, definition, source."""


def _number(name: str, value: float, std: float = math.nan, level: int | None = None) -> Number:
    return Number(name, value, std, *DEFINED[name], level)


def handling(response: FrequencyResponse, fit: TransferFunction, aircraft: RatedAircraft) -> tuple[Number, ...]:
    """The numbers that the form and the band of a fit define."""
    return (*_of_mode(response, fit, aircraft), *_delay(fit, aircraft), *_bandwidth(response, fit))


def _of_mode(response: FrequencyResponse, fit: TransferFunction, aircraft: RatedAircraft) -> Iterator[Number]:
    p = fit.parameters
    rated = not aircraft.why_no_level
    if fit.form.mode == "roll":
        T = p["T_R"]
        level = _level_below(T.estimate, ROLL_MODE[aircraft.category, aircraft.small_or_agile]) if rated else None
        yield _number("T_R", T.estimate, T.std, level)
    elif fit.form.mode == "dutch-roll":
        yield from _dutch_roll(fit, aircraft, rated)
    elif fit.form.mode == "short-period":
        yield from _short_period(response, fit, aircraft, rated)


def _dutch_roll(fit: TransferFunction, aircraft: RatedAircraft, rated: bool) -> Iterator[Number]:
    zeta, omega = fit.parameters["zeta_d"], fit.parameters["omega_d"]
    product, spread = _derived(fit, lambda v: v["zeta_d"] * v["omega_d"])
    rated_values = (zeta.estimate, product, omega.estimate)
    limits = DUTCH_ROLL[aircraft.category, aircraft.small_or_agile]
    level = next(
        (
            k + 1
            for k, lowest_values in enumerate(limits)
            if all(a >= b for a, b in zip(rated_values, lowest_values, strict=True))
        ),
        4,
    )
    level_shown = level if rated else None
    yield _number("zeta_d", zeta.estimate, zeta.std, level_shown)
    yield _number("omega_d", omega.estimate, omega.std, level_shown)
    yield _number("zeta_d omega_d", product, spread, level_shown)


def _short_period(
    response: FrequencyResponse, fit: TransferFunction, aircraft: RatedAircraft, rated: bool
) -> Iterator[Number]:
    zeta, omega = fit.parameters["zeta_sp"], fit.parameters["omega_sp"]
    level = _level_within(zeta.estimate, SHORT_PERIOD[aircraft.category]) if rated else None
    yield _number("zeta_sp", zeta.estimate, zeta.std, level)
    yield _number("omega_sp", omega.estimate, omega.std)
    lead = fit.parameters.get("1/T_theta2")
    if response.output != "q" or lead is None or not lead.estimate > 0.0 or not math.isfinite(response.speed):
        return
    V = response.speed
    yield _number("n/alpha", *_derived(fit, lambda v: V / GRAVITY * v["1/T_theta2"]))
    cap, cap_std = _derived(fit, lambda v: v["omega_sp"] ** 2 * GRAVITY / (V * v["1/T_theta2"]))
    level = _level_within(cap, ANTICIPATION[aircraft.category]) if rated else None
    yield _number("CAP", cap, cap_std, level)


def _delay(fit: TransferFunction, aircraft: RatedAircraft) -> Iterator[Number]:
    tau = fit.parameters["tau"]
    level = None if aircraft.why_no_level else _level_below(tau.estimate, DELAY)
    yield _number("tau", tau.estimate, tau.std, level)


def _derived(fit: TransferFunction, value: Callable[[dict[str, float]], float]) -> tuple[float, float]:
    """A function of the parameters and its bound, to first order."""
    estimates = {n: p.estimate for n, p in fit.parameters.items()}
    slopes = np.zeros(len(estimates))
    for i, (name, v) in enumerate(estimates.items()):
        h = STEP * max(abs(v), LEAST_SIZE)
        slopes[i] = (value({**estimates, name: v + h}) - value({**estimates, name: v - h})) / (2 * h)
    return value(estimates), float(np.sqrt(max(float(slopes @ fit.covariance @ slopes), 0.0)))


def _level_below(value: float, limits: tuple[float, ...]) -> int:
    return next((k + 1 for k, limit in enumerate(limits) if value <= limit), 4)


def _level_within(value: float, limits: tuple[tuple[float, float], ...]) -> int:
    return next((k + 1 for k, (low, high) in enumerate(limits) if low <= value <= high), len(limits) + 1)


# ------------------------------------------------------------------------------------------------------- bandwidth


def _bandwidth(response: FrequencyResponse, fit: TransferFunction) -> Iterator[Number]:
    """Bandwidth and phase delay of the attitude, for a rate of its integral, from the fit within its band; none where the phase
    does not reach -180 deg there."""
    control = SURFACE_OF.get(response.input, response.input)
    if (control, response.output) not in (("delta_e", "q"), ("delta_e", "theta"), ("delta_a", "p"), ("delta_a", "phi")):
        return
    omega = np.geomspace(fit.omega[0], fit.omega[1], BANDWIDTH_POINTS)
    H = fit.at(omega)
    if response.output in ("p", "q"):
        H = H / (1j * omega)
    phase = np.unwrap(np.angle(H))
    phase += -np.pi / 2 - phase[0] + _without_half_turns(phase[0] + np.pi / 2)
    crossing = _first_crossing(omega, phase, -np.pi)
    by_phase = _first_crossing(omega, phase, PHASE_MARGIN - np.pi)
    if crossing is None or by_phase is None:
        return
    decibels = 20 * np.log10(np.abs(H))
    by_gain = _first_crossing(omega, decibels, float(np.interp(crossing, omega, decibels)) + GAIN_MARGIN_DB)
    width = min(by_phase, by_gain if by_gain is not None else math.inf)
    yield _number("omega_BW", width)
    if 2 * crossing <= omega[-1]:
        phase_lag = -np.pi - float(np.interp(2 * crossing, omega, phase))
        yield _number("tau_p", phase_lag / (2 * crossing))


def _without_half_turns(offset: float) -> float:
    """A phase offset [rad] less the half turns that the sign of a gain adds."""
    return offset - np.pi * round(offset / np.pi)


def _first_crossing(omega: Array, values: Array, level: float) -> float | None:
    """Frequency at which values first fall through a level; None where they do not."""
    crossings = np.flatnonzero((values[1:] <= level) & (values[:-1] > level))
    if not crossings.size:
        return None
    k = int(crossings[0])
    share = (values[k] - level) / (values[k] - values[k + 1])
    return float(omega[k] + share * (omega[k + 1] - omega[k]))
