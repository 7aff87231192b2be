"""The monitor that also runs live, over a flight: same code, and what it would have said when."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import Airframe, Sample
from daq.identification.monitor import FALSE_ALARMS
from daq.identification.monitor.bank import PLANES, MonitoredPlane, bank
from daq.identification.monitor.monitor import Alarm, GapMonitor, GapMonitors, MonitorState
from daq.identification.monitor.nulls import FINEST_S, GRID_S, NEARLY, NullConditions, watched_step
from daq.identification.monitor.threshold import Calibration, calibrated
from daq.identification.movement import ManoeuvreDetector
from estimation.aircraft import Aircraft
from estimation.errors import EstimationError
from estimation.estimators.linear_terms import LinearTerms, linear_terms
from estimation.estimators.recursive import airframe_of, samples_of, values_of
from estimation.models.base import Model
from estimation.prepare.columns import with_derived
from groundstation.flight import Flight
from groundstation.flight.quality.noise import noise

Array = NDArray[np.float64]

FLYING, FLYING_S = 9.0, 2.0  # m/s and s from which on the aircraft flies, as the ground station has them
EVEN, EVEN_SHARE = 0.1, 0.8  # of the usual step, and of all steps: what is even differs by less in more of them
FEWEST_S = 10.0  # s of manoeuvring below which nothing was watched to speak of


@dataclass(frozen=True)
class Watched:
    """What the monitor said of one flight. history: every half second of manoeuvring; manoeuvring_s: how long that was."""

    flight: Flight
    model: str
    alarms: tuple[Alarm, ...]
    history: tuple[MonitorState, ...]
    manoeuvring_s: float
    calibration: Calibration

    def to_json(self) -> dict[str, Any]:
        """As `watch --json` has it."""
        time = self.flight.time
        return {
            "flight": self.flight.name,
            "model": self.model,
            "alarms": [_alarm_json(a) for a in self.alarms],
            "duration_s": float(time[-1] - time[0]),
            "watched_s": self.manoeuvring_s,
            "false_alarm_rate_per_hour": self.calibration.rate,
            "simulated_hours": self.calibration.hours,
            "history": {"time": [w.time for w in self.history], "score": [w.score for w in self.history]},
        }


def _alarm_json(a: Alarm) -> dict[str, Any]:
    return {
        "time": a.time,
        "since": a.since,
        "equation": a.equation,
        "channels": list(a.channels),
        "score": a.score,
        "threshold": a.threshold,
        "leading": [n.effect for n in a.leading],
        "named": a.named,
        "sizes": {n.effect: {"estimate": n.size, "unit": n.unit, "score": n.score} for n in a.leading},
    }


def watch(
    model: Model, flight: Flight, aircraft: Aircraft, *, seed: int = 1, hours: float = 2.5, rate: float = FALSE_ALARMS
) -> Watched:
    """Watch a flight with a linear model of one plane or both; thresholds for `rate` false alarms an hour of manoeuvring.

    hours: of simulated manoeuvring they are taken from. Raises EstimationError for another model, or a flight with less than ten
    seconds of manoeuvring, MissingColumnError for one without the measured motion.
    """
    airframe, terms = airframe_of(model, aircraft), linear_terms(model)
    planes = _planes(model, terms)
    flight.require(list(terms.signals), "watch")
    values, stds = ({terms.names[n]: v for n, v in numbers.items()} for numbers in values_of(model))
    derived = with_derived(flight, ["rho"])
    samples, seconds = _manoeuvring(derived, grid_of(derived), terms, airframe)
    _refuse_short(flight, seconds)
    monitors, calibrations = [], []
    for plane in planes:
        stated = {n: v for n, v in values.items() if n in plane.parameters}
        effects = bank(stated, stds, plane)
        rng, conditions = np.random.default_rng([seed, len(effects)]), conditions_of(derived, plane)
        each = rate / len(planes)
        try:
            calibration = calibrated(
                airframe, stated, effects, conditions, rng=rng, hours=hours, rate=each, plane=plane
            )
        except (np.linalg.LinAlgError, ArithmeticError, ValueError) as error:
            raise EstimationError(
                f"model {model.name}: no thresholds, an aircraft of these values does not fly ({error}); check them and the units"
            ) from error
        calibrations.append(calibration)
        monitors.append(GapMonitor(airframe, stated, effects, calibration, plane))
    monitor = GapMonitors(monitors)
    history = tuple(state for s in samples if (state := monitor.add(s)) is not None)
    _refuse_short(flight, monitor.watched)
    calibration = replace(calibrations[0], rate=rate)
    return Watched(flight, model.name, monitor.alarms, history, monitor.watched, calibration)


def _planes(model: Model, terms: LinearTerms) -> list[MonitoredPlane]:
    """Planes that a model is watched in. Raises EstimationError for terms that the monitor does not predict with."""
    planes = [PLANES[r.name] for r in terms.regressions]
    known = {n for plane in planes for n in plane.parameters}
    strange = [parameter for parameter, place in terms.names.items() if place not in known]
    if strange:
        raise EstimationError(
            f"the gap monitor does not know {', '.join(strange)} of model {model.name}: watch with a model without, "
            "or look at the whole flight with sideslip gap"
        )
    return planes


def grid_of(flight: Flight) -> float:
    """Seconds between scans that are looked at: of fast ones a whole number of intervals, about those on board."""
    step = float(np.median(_steps(flight)))
    if step < FINEST_S:
        return watched_step(step)
    return step / max(1, round(step / GRID_S)) if _even(flight) else GRID_S


def _even(flight: Flight) -> bool:
    """Whether scans come evenly, but for some that are lost; those of a decimated link do not."""
    steps = _steps(flight)
    step = float(np.median(steps))
    return float(np.quantile(np.abs(steps - step), EVEN_SHARE)) < EVEN * step


def _manoeuvring(flight: Flight, grid: float, terms: LinearTerms, airframe: Airframe) -> tuple[list[Sample], float]:
    """Samples of the stretches about movements, and how long those are [s]: at least what can be watched."""
    shortest = NEARLY * grid
    stretches, last = ManoeuvreDetector(FLYING, FLYING_S, terms.regressions), -math.inf
    samples: list[Sample] = []
    for part in flight.segments:
        for sample in samples_of(flight, part, terms.regressions, airframe):
            if sample.time - last < shortest:
                continue
            last = sample.time
            samples += stretches.take(sample)
    return samples, sum(end - begin for begin, end in stretches.found)


def _refuse_short(flight: Flight, seconds: float) -> None:
    if seconds < FEWEST_S:
        raise EstimationError(
            f"{flight.name}: only {seconds:.0f} s of manoeuvring; nothing can be watched where no control moves"
        )


def conditions_of(flight: Flight, plane: MonitoredPlane) -> NullConditions:
    """Noise of the flight's own instruments, its airspeed and its rate; what it does not tell is as usual."""
    defaults = NullConditions()
    levels: dict[str, float] = {}
    for name in (*plane.channels, "V"):
        level = noise(flight[name])
        if level:
            levels[name] = level
    surfaces = [s for c in plane.surfaces if (s := noise(flight[c]))]
    if surfaces:
        levels["surface"] = max(surfaces)
    flying = flight["V"][flight["V"] > FLYING]
    if flying.size:
        levels["speed"] = float(np.median(flying))
    levels["grid"] = grid_of(flight)
    levels["rate"] = min(1.0 / levels["grid"], 1.0 / float(np.mean(_steps(flight))))
    if _even(flight) and (step := float(np.median(_steps(flight)))) >= FINEST_S:
        levels["loss"] = max(0.0, 1.0 - step * levels["rate"])
        levels["rate"] = 1.0 / step
    return replace(defaults, **levels)  # type: ignore[arg-type]


def _steps(flight: Flight) -> Array:
    """Steps in time [s] between scans that belong together."""
    steps = np.diff(flight.time)
    connected = steps[steps < 0.5]
    return connected if connected.size else np.array([0.05])
