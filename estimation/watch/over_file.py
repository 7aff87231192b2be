"""The monitor that also runs live, over a flight: same code, and what it would have said when."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import DERIVATIVES, SIGNALS, Sample
from daq.identification.monitor.bank import bank
from daq.identification.monitor.monitor import Alarm, GapMonitor, MonitorState
from daq.identification.monitor.nulls import NullConditions
from daq.identification.monitor.threshold import Calibration, calibrated
from daq.identification.movement import ManoeuvreDetector
from estimation.aircraft import Aircraft
from estimation.engine.derived import with_derived
from estimation.errors import EstimationError
from estimation.estimators.recursive import airframe_of, samples_of, values_of
from estimation.models.base import Model
from estimation.report.drawing.figures import Picture, picture, styled
from estimation.report.markup.html import write_page
from estimation.report.provenance import provenance_table
from estimation.report.tables import ReportTable, significant, write_all
from groundstation.flight import Flight
from groundstation.flight.quality.noise import noise

Array = NDArray[np.float64]

FLYING, FLYING_S = 9.0, 2.0  # m/s and s from which on the aircraft flies, as the ground station has them
GRID_S, FINEST_S = 0.05, 0.045  # s between scans that are looked at, as on board; faster ones are left out in between
FEWEST_S = 10.0  # s of manoeuvring below which nothing was watched to speak of
NOISES = {"beta": "beta", "p": "p", "r": "r", "phi": "phi", "ay": "ay", "V": "V"}


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
    model: Model, flight: Flight, aircraft: Aircraft, *, seed: int = 1, hours: float = 2.5, rate: float = 1.0
) -> Watched:
    """Watch a flight with a model of the lateral derivatives; thresholds for `rate` false alarms an hour of manoeuvring.

    hours: of simulated manoeuvring they are taken from. Raises EstimationError for another model, or a flight with less than ten
    seconds of manoeuvring, MissingColumnError for one without the measured motion.
    """
    airframe = airframe_of(model, aircraft)
    if set(airframe.beliefs) != set(DERIVATIVES):
        raise EstimationError(f"the gap monitor knows the derivatives of model lateral only, not those of {model.name}")
    flight.require([s for s in SIGNALS if s != "rho"], "watch")
    values, stds = values_of(model)
    effects = bank(airframe, values, stds)
    derived = with_derived(flight, ["rho"])
    samples, seconds = _manoeuvring(derived, grid_of(derived))
    _refuse_short(flight, seconds)
    conditions = conditions_of(derived)
    rng = np.random.default_rng([seed, len(effects)])
    calibration = calibrated(airframe, values, effects, conditions, rng=rng, hours=hours, rate=rate)
    monitor = GapMonitor(airframe, values, effects, calibration)
    history = tuple(state for s in samples if (state := monitor.add(s)) is not None)
    _refuse_short(flight, monitor.watched)
    return Watched(flight, model.name, tuple(monitor.alarms), history, monitor.watched, calibration)


def grid_of(flight: Flight) -> float:
    """Seconds between scans that are looked at: of fast ones a whole number of intervals, about those on board."""
    step = float(np.median(_steps(flight)))
    return step * max(1, round(GRID_S / step)) if step < FINEST_S else GRID_S


def _manoeuvring(flight: Flight, grid: float) -> tuple[list[Sample], float]:
    """Samples of the stretches about movements, and how long those are [s]: at least what can be watched."""
    shortest = 0.9 * grid
    stretches, last = ManoeuvreDetector(FLYING, FLYING_S), -math.inf
    samples: list[Sample] = []
    for part in flight.segments:
        for sample in samples_of(flight, part):
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


def conditions_of(flight: Flight) -> NullConditions:
    """Noise of the flight's own instruments, its airspeed and its rate; what it does not tell is as usual."""
    defaults = NullConditions()
    levels: dict[str, float] = {}
    for name, column in NOISES.items():
        level = noise(flight[column])
        if level:
            levels[name] = level
    surfaces = [s for c in ("delta_a", "delta_r") if (s := noise(flight[c]))]
    if surfaces:
        levels["surface"] = max(surfaces)
    flying = flight["V"][flight["V"] > FLYING]
    if flying.size:
        levels["speed"] = float(np.median(flying))
    levels["grid"] = grid_of(flight)
    levels["rate"] = min(1.0 / levels["grid"], 1.0 / float(np.mean(_steps(flight))))
    return replace(defaults, **levels)  # type: ignore[arg-type]


def _steps(flight: Flight) -> Array:
    """Steps in time [s] between scans that belong together."""
    steps = np.diff(flight.time)
    connected = steps[steps < 0.5]
    return connected if connected.size else np.array([0.05])


HERE = Path(__file__).parent
BEFORE_S, AFTER_S = 30.0, 20.0  # s about an alarm that are cut out for the gap workflow
PAUSE_S = 2.0  # between two words of the monitor, beyond which no control moved and no line is drawn


def lines(found: Watched) -> Iterator[str]:
    """For a terminal."""
    c = found.calibration
    yield (
        f"{found.flight.name}, model {found.model}: {found.manoeuvring_s:.0f} s of manoeuvring watched; thresholds for "
        f"{c.rate:g} false alarm an hour from {c.hours:.1f} h of simulated flight"
    )
    if not found.alarms:
        yield f"no alarm; the largest score was {max((w.score for w in found.history), default=0.0):.0%} of its threshold"
    for a in found.alarms:
        yield f"t = {a.time:.1f} s: {a.text}"


def stretch(found: Watched) -> Flight:
    """The part of the flight about its first alarm, for the gap workflow."""
    first, time = found.alarms[0], found.flight.time
    keep = (time >= first.since - BEFORE_S) & (time <= first.time + AFTER_S)
    return found.flight.part(keep, f"{found.flight.name}_alarm")


def gap_command(path: Path, model: str, aircraft: str | None) -> str:
    """What to type next."""
    return f"sideslip gap {path} --model {model}" + ("" if aircraft is None else f" --aircraft {aircraft}")


def write_watch_report(found: Watched, folder: Path, command: str) -> Path:
    """Write folder/index.html, with its tables as CSV and LaTeX beside it; returns the page."""
    tables = {"alarms": _alarm_table(found), "provenance": provenance_table([found.flight])}
    write_all(list(tables.values()), folder / "tables")
    head, *rest = lines(found)
    return write_page(
        folder / "index.html",
        "watch.html.j2",
        templates=HERE,
        title=f"Gap monitor: {found.flight.name}",
        lead=f"{head}.",
        tables=tables,
        figure=history_picture(found),
        said=rest,
        command=command if found.alarms else "",
    )


def history_picture(found: Watched) -> Picture:
    """Score in units of its threshold over the flight."""
    from matplotlib.figure import Figure

    with styled():
        figure = Figure(figsize=(7.2, 2.6), layout="constrained")
        draw_history(found, figure.subplots())
    return picture(
        figure, "watch_history", "The larger of both statistics over its threshold; blank where no control moved."
    )


def draw_history(found: Watched, axes: Any) -> None:
    """The score over its threshold on axes, with a line where an alarm was told."""
    time, score = np.array([w.time for w in found.history]), np.array([w.score for w in found.history])
    pauses = np.flatnonzero(np.diff(time) > PAUSE_S) + 1
    axes.plot(np.insert(time, pauses, np.nan), np.insert(score, pauses, np.nan), color="#0072B2")
    axes.axhline(1.0, color="#D55E00", linestyle="--")
    for a in found.alarms:
        axes.axvline(a.time, color="#D55E00", linewidth=0.8)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("score / threshold")


def _alarm_table(found: Watched) -> ReportTable:
    rows = tuple(
        (
            f"{a.time:.1f}",
            f"{a.since:.1f}",
            a.equation,
            ", ".join(a.channels),
            f"{a.score:.1f}",
            f"{a.threshold:.1f}",
            "; ".join(f"{n.effect} {significant(n.size, 2)} {n.unit}" for n in a.leading) or "none of the list",
        )
        for a in found.alarms
    )
    head = ("noticed [s]", "since [s]", "equation", "shown by", "score", "threshold", "leading")
    return ReportTable("alarms", "Alarms", head, rows, symbols=False, texts=(6,))
