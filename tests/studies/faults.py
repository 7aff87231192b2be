"""Faults in the air and the gap monitor: precision, recall and delay as published for real flights in which something failed.

    python -m tests.studies.faults [-n 8] [--hours 2.5] [--model six-dof|lateral] [KIND...]

A model is estimated from three flights in which nothing fails; then flights of 52 s are watched with it, N of each kind, in which
something fails after 20 s, and as many in which nothing does. Other equations of motion than the monitor's fly them. Thrust is
what the throttle asks for, as in an aircraft without a load cell. A flight with a fault counts as found where the first alarm
comes after the fault, as falsely alarmed where it comes before; any alarm in a flight without fault is false. Precision is found
over all alarmed, recall is found over all faults, the delay is from fault to alarm. Thresholds are drawn once: all flights have
the same instruments and air. Each flight is told as it ends (standard error). The table is kept in docs/validation/faults.md.
"""

import argparse
import math
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import sideslip as ss
from daq.identification.monitor.bank import MonitoredPlane
from daq.identification.monitor.threshold import Calibration
from estimation.aircraft import load_aircraft
from estimation.aircraft.aircraft import Engine
from estimation.watch import over_file
from firmware_sim.physics.effects.sudden import BEGINS_S
from firmware_sim.runs.direct import measured, write_csv
from firmware_sim.world.scenario import Scenario, load_scenario
from firmware_sim.world.world import simulate_many

Array = NDArray[np.float64]

FLIGHT_S = 52.0
RATE_HZ = 20.0
BEFORE = (901, 902, 903)  # seeds of the flights that the model is estimated from
MANOEUVRES = {"six-dof": "all_axes", "lateral": "rich"}
"""Model -> what moves the axes that it has."""
KINDS: Mapping[str, tuple[str, str]] = {
    "elevon_stuck": ("surface", "right elevon stays where it stood"),
    "rudder_stuck": ("surface", "fin stays where it stood"),
    "engine_out": ("engine", "thrust is gone"),
    "vane_slipped": ("sensor", "sideslip vane slips by 1.7 deg"),
    "gyro_jumped": ("sensor", "yaw gyro jumps by 2.9 deg/s"),
    "pitot_blocked": ("sensor", "airspeed falls by 40 %"),
    "none": ("", "nothing"),
}
"""Fault -> what it is a fault of, and in words."""


@dataclass(frozen=True)
class Alarmed:
    """What was said of one flight. first: of the first alarm [s], None where there was none; equation: in which."""

    kind: str
    first: float | None
    equation: str = ""

    @property
    def found(self) -> bool:
        return self.kind != "none" and self.first is not None and self.first >= BEGINS_S

    @property
    def false(self) -> bool:
        return self.first is not None and not self.found


@dataclass(frozen=True)
class Figures:
    """Of many flights."""

    precision: float
    recall: float
    delay: float

    @classmethod
    def of(cls, flights: Sequence[Alarmed]) -> "Figures":
        found = [f for f in flights if f.found]
        alarmed, faults = sum(f.first is not None for f in flights), sum(f.kind != "none" for f in flights)
        delays = [f.first - BEGINS_S for f in found if f.first is not None]
        return cls(
            len(found) / alarmed if alarmed else float("nan"),
            len(found) / faults if faults else float("nan"),
            float(np.mean(delays)) if delays else float("nan"),
        )


def scenario(kind: str, seed: int, model: str = "six-dof") -> Scenario:
    """One aircraft, whose derivatives are not those of its file, at a speed and with a pilot's hand of the flight's own."""
    speed = float(np.random.default_rng([seed, 48]).uniform(16.0, 18.0))
    flight = {
        "duration_s": FLIGHT_S, "derivative_scatter": 0.15, "derivative_seed": 7,
        "speed_m_s": speed, "hand_deg": 1.0, "seed": seed, "manoeuvres": MANOEUVRES[model],
    }  # fmt: skip
    base = load_scenario("rich").altered(flight=flight)
    return base if kind == "none" else base.altered(hidden=[{"name": kind}])


def asked_thrust(truth: Mapping[str, Array], engine: Engine) -> Array:
    """[N] (samples,): what a throttle's map makes of command and airspeed, with the engine's lag; not what the engine does."""
    wanted = truth["throttle"] * (engine.static_thrust - engine.thrust_fall * truth["V"])
    share = -math.expm1(-1.0 / (RATE_HZ * engine.lag))
    thrust = wanted.copy()
    for k in range(1, len(thrust)):
        thrust[k] = thrust[k - 1] + share * (wanted[k] - thrust[k - 1])
    return thrust


def flown(kind: str, seeds: Sequence[int], model: str, folder: Path) -> list[Path]:
    """Flights as files."""
    scenarios = [scenario(kind, seed, model) for seed in seeds]
    engine = load_aircraft("cdfp").engine
    assert engine is not None
    paths = [folder / f"{kind}_{seed}.csv" for seed in seeds]
    for path, seed, truth in zip(paths, seeds, simulate_many(scenarios, list(seeds), RATE_HZ), strict=True):
        write_csv(path, measured(truth, seed) | {"thrust": asked_thrust(truth, engine)})
    return paths


class Thresholds:
    """Thresholds that are drawn for each plane of the first flight and hold for all that follow."""

    def __init__(self) -> None:
        self._of_plane: dict[str, Calibration] = {}
        self._draw = over_file.calibrated

    def __call__(self, *conditions: Any, plane: MonitoredPlane, **options: Any) -> Calibration:
        if plane.name not in self._of_plane:
            self._of_plane[plane.name] = self._draw(*conditions, plane=plane, **options)
        return self._of_plane[plane.name]


def watched(kinds: Sequence[str], n: int, hours: float, model: str, folder: Path) -> Iterator[Alarmed]:
    """Every flight as `sideslip watch` sees it."""
    before = flown("none", BEFORE, model, folder)
    estimate = ss.estimate(before, model, aircraft="cdfp", joint=True)
    with patch.object(over_file, "calibrated", Thresholds()):
        for seed in range(1, n + 1):
            for kind in kinds:
                (path,) = flown(kind, [seed], model, folder)
                alarms = ss.watch(path, estimate.model, aircraft="cdfp", hours=hours).alarms
                first = min(alarms, key=lambda a: a.time, default=None)
                yield Alarmed(kind, *((None,) if first is None else (first.time, first.equation)))


def table(flights: Sequence[Alarmed]) -> list[str]:
    """What was found of each kind, and the published metric over all."""
    lines = [
        "| fault | flights | found | alarm before it | mean delay, s | longest, s | equations |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind, (of, words) in KINDS.items():
        members = [f for f in flights if f.kind == kind]
        if not members:
            continue
        delays = [f.first - BEGINS_S for f in members if f.found and f.first is not None]
        mean, longest = (f"{np.mean(delays):.1f}", f"{max(delays):.1f}") if delays else ("-", "-")
        where = ", ".join(
            f"{e} {c}" for e, c in Counter(f.equation for f in members if f.first is not None).most_common()
        )
        found = "-" if kind == "none" else str(len(delays))
        false = sum(f.false for f in members)
        lines.append(
            f"| {of + ': ' if of else ''}{words} | {len(members)} | {found} | {false} | {mean} | {longest} | {where} |"
        )
    groups = {
        "surfaces": ("surface",),
        "surfaces and sensors": ("surface", "sensor"),
        "all": ("surface", "sensor", "engine"),
    }
    lines += ["", "| faults | precision | recall | mean delay, s |", "|---|---|---|---|"]
    for title, kinds in groups.items():
        figures = Figures.of([f for f in flights if f.kind == "none" or KINDS[f.kind][0] in kinds])
        lines.append(f"| {title} | {figures.precision:.2f} | {figures.recall:.2f} | {figures.delay:.1f} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"of {', '.join(KINDS)} (all)")
    parser.add_argument("-n", type=int, default=8, help="flights of each kind")
    parser.add_argument("--hours", type=float, default=2.5, help="of simulated manoeuvring for the thresholds")
    parser.add_argument(
        "--model", choices=list(MANOEUVRES), default="six-dof", help="what is watched, and which axes are moved"
    )
    options = parser.parse_args()
    flights = []
    with tempfile.TemporaryDirectory() as folder:
        for flight in watched(options.kinds or list(KINDS), options.n, options.hours, options.model, Path(folder)):
            flights.append(flight)
            print(flight, file=sys.stderr, flush=True)
    print("\n".join(table(flights)))


if __name__ == "__main__":
    main()
