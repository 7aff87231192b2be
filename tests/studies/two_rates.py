"""Bounds and errors of one record at its own 50 Hz and averaged to 10 Hz, as `import --rate 10` does it.

`python -m tests.studies.two_rates run OUT.jsonl [FIRST LAST]`, then `table OUT.jsonl`: a flight of each of drawn aeroplanes.
What is lost by averaging has to be lost from the errors as well: coverage stays, and errors grow as bounds do.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from daq.utilities.errors import UserError
from estimation.aircraft import Aircraft
from estimation.models import load_model
from estimation.session import runner
from groundstation.flight import Flight
from groundstation.importers.series import TimeSeries, resample
from tests.studies import random_aeroplanes as own

RATES = (50.0, 10.0)
ALL = 24


def averaged(flight: Flight, rate: float) -> Flight:
    """The flight on a coarser time base, as an import makes it."""
    time = np.arange(flight.time[0], flight.time[-1], 1.0 / rate)
    columns = {n: resample(TimeSeries(flight.time, v), time) for n, v in flight.columns.items() if flight.measured(n)}
    return Flight.build(flight.name, time, columns)


def record_of(number: int) -> dict[str, Any]:
    """Relative error and corrected bound of each derivative at both rates; empty where no estimate came."""
    rng = np.random.default_rng([97, number])
    craft = own.Aeroplane.drawn(rng)
    (flight,) = own.fly(craft, own.Situation("two rates", rate=RATES[0], servo=float(rng.uniform(0.03, 0.08))), rng, 1)
    aircraft = Aircraft("drawn", craft.span, craft.area, craft.chord, craft.mass, *craft.inertia)
    record: dict[str, Any] = {"set": number}
    for rate in RATES:
        part = flight if rate == RATES[0] else averaged(flight, rate)
        try:
            session = runner.estimate(load_model("lateral", aircraft), [part], aircraft, ("ml",))
        except UserError as error:
            record[f"{rate:g}"] = {"failed": str(error)}
            continue
        shown = session.flights[0].results["ml"].parameters
        record[f"{rate:g}"] = {
            n: [
                (e.estimate - craft.derivatives[n]) / abs(craft.derivatives[n]),
                e.std_coloured / abs(craft.derivatives[n]),
            ]
            for n in own.MAIN
            if (e := shown[n]).identifiable
        }
    return record


def table(path: Path) -> Iterator[str]:
    """Rows of the page: each derivative at both rates."""
    records = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    fast, slow = (f"{r:g}" for r in RATES)
    pairs = {n: [(r[fast][n], r[slow][n]) for r in records if n in r[fast] and n in r[slow]] for n in own.MAIN}
    everything = {**pairs, "all": [p for some in pairs.values() for p in some]}
    for name, pair in ((n, p) for n, p in everything.items() if p):
        values = np.array(pair)  # (sets, rate, error and bound)
        error, bound = values[:, :, 0], values[:, :, 1]
        rms = np.sqrt(np.mean((error / bound) ** 2, axis=0))
        inside = np.mean(np.abs(error) < 1.96 * bound, axis=0)
        wider = float(np.median(bound[:, 1] / bound[:, 0]))
        larger = float(np.median(np.abs(error[:, 1])) / np.median(np.abs(error[:, 0])))
        shares = f"{inside[0]:.0%} | {inside[1]:.0%}"
        yield f"| {name} | {len(pair)} | {rms[0]:.2f} | {rms[1]:.2f} | {shares} | {wider:.2f} | {larger:.2f} |"


def main(arguments: list[str]) -> None:
    path = Path(arguments[1])
    if arguments[0] == "table":
        print("\n".join(table(path)))
        return
    first, last = (int(a) for a in arguments[2:4]) if len(arguments) > 2 else (0, ALL)
    with path.open("a", encoding="utf-8") as file:
        for number in range(first, last):
            file.write(json.dumps(record_of(number)) + "\n")
            file.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
