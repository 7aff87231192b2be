"""The live gap monitor over a recorded flight: the same code, with the alarms that it would have given."""

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

FLYING, FLYING_S = 9.0, 2.0  # airspeed [m/s] held this long [s] is flight, as at the ground station
EVEN, EVEN_SHARE = 0.1, 0.8  # scans are even where this share of steps differs by less than EVEN of the median step
FEWEST_S = 10.0  # s of manoeuvring that a result needs
LONGEST_STEP_S, USUAL_STEP_S = 0.5, 0.05  # between neighbouring scans at most; where there are none


@dataclass(frozen=True)
class Watched:
    """The monitor over one flight. history: states, every half second of manoeuvring; manoeuvring_s: duration of that."""

    flight: Flight
    model: str
    alarms: tuple[Alarm, ...]
    history: tuple[MonitorState, ...]
    manoeuvring_s: float
    calibration: Calibration

    def to_json(self) -> dict[str, Any]:
        """As in `watch --json`."""
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

    hours: of simulated manoeuvring for the thresholds. Raises EstimationError for another model, or a flight with less than
    FEWEST_S of manoeuvring, MissingColumnError for one without the measured motion.
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
    """The planes of a model. Raises EstimationError for terms that the monitor does not know."""
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
    """Time [s] between the scans used: for fast scans a multiple of their step, near that of the monitor on board."""
    step = float(np.median(_steps(flight)))
    if step < FINEST_S:
        return watched_step(step)
    return step / max(1, round(step / GRID_S)) if _even(flight) else GRID_S


def _even(flight: Flight) -> bool:
    """Whether scans come at an even step, apart from lost ones; those of a decimated link do not."""
    steps = _steps(flight)
    step = float(np.median(steps))
    return float(np.quantile(np.abs(steps - step), EVEN_SHARE)) < EVEN * step


def _manoeuvring(flight: Flight, grid: float, terms: LinearTerms, airframe: Airframe) -> tuple[list[Sample], float]:
    """Samples of the stretches with moved controls, and their duration [s]."""
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
    """Noise of the instruments, airspeed, rate and loss of scans of a flight; the defaults for what it does not show."""
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
    """Steps in time [s] between neighbouring scans."""
    steps = np.diff(flight.time)
    connected = steps[steps < LONGEST_STEP_S]
    return connected if connected.size else np.array([USUAL_STEP_S])
