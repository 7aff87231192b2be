"""Faults in the air and the gap monitor: precision, recall and delay as published for real flights in which something failed.

    python -m tests.studies.faults [-n 10] [--hours 2.5] [KIND...]

A model is estimated from three flights in which nothing fails; then flights of 52 s are watched with it, N of each kind, in which
something fails after 20 s, and as many in which nothing does. Other equations of motion than the monitor's fly them. A flight
with a fault counts as found where the first alarm comes after the fault, as falsely alarmed where it comes before; any alarm in a
flight without fault is false. Precision is found over all alarmed, recall is found over all faults, the delay is from fault to
alarm. Thresholds are drawn once: all flights have the same instruments and air. The table is kept in docs/validation/faults.md.
"""

import argparse
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import sideslip as ss
from daq.identification.monitor.threshold import Calibration
from estimation.watch import over_file
from firmware_sim.physics.effects.sudden import BEGINS_S
from firmware_sim.runs.direct import direct_flights, write_csv
from firmware_sim.world.scenario import Scenario, load_scenario

FLIGHT_S = 52.0
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


def scenario(kind: str, seed: int) -> Scenario:
    """One aircraft, whose derivatives are not those of its file, at a speed and with a pilot's hand of the flight's own."""
    speed = float(np.random.default_rng([seed, 48]).uniform(16.0, 18.0))
    flight = {
        "duration_s": FLIGHT_S, "derivative_scatter": 0.15, "derivative_seed": 7,
        "speed_m_s": speed, "hand_deg": 1.0, "seed": seed,
    }  # fmt: skip
    base = load_scenario("rich").altered(flight=flight)
    return base if kind == "none" else base.altered(hidden=[{"name": kind}])


def flown(kind: str, seeds: Sequence[int], folder: Path) -> list[Path]:
    """Flights as files."""
    paths = [folder / f"{kind}_{seed}.csv" for seed in seeds]
    scenarios = [scenario(kind, seed) for seed in seeds]
    for path, columns in zip(paths, direct_flights(scenarios, list(seeds)), strict=True):
        write_csv(path, columns)
    return paths


class Thresholds:
    """Thresholds that are drawn for the first flight and hold for all that follow."""

    def __init__(self) -> None:
        self.calibration: Calibration | None = None
        self._draw = over_file.calibrated

    def __call__(self, *conditions: Any, **options: Any) -> Calibration:
        if self.calibration is None:
            self.calibration = self._draw(*conditions, **options)
        return self.calibration


def watched(kinds: Sequence[str], n: int, hours: float, folder: Path) -> list[Alarmed]:
    """Every flight as `sideslip watch` sees it."""
    before = flown("none", (901, 902, 903), folder)
    estimate = ss.estimate(before, "lateral", aircraft="cdfp", joint=True)
    flights = []
    with patch.object(over_file, "calibrated", Thresholds()):
        for kind in kinds:
            for path in flown(kind, range(1, n + 1), folder):
                alarms = ss.watch(path, estimate.model, aircraft="cdfp", hours=hours).alarms
                first = min(alarms, key=lambda a: a.time, default=None)
                flights.append(Alarmed(kind, *((None,) if first is None else (first.time, first.equation))))
    return flights


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
    parser.add_argument("-n", type=int, default=10, help="flights of each kind")
    parser.add_argument("--hours", type=float, default=2.5, help="of simulated manoeuvring for the thresholds")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print("\n".join(table(watched(options.kinds or list(KINDS), options.n, options.hours, Path(folder)))))


if __name__ == "__main__":
    main()
