"""Whether stated bounds hold where records are slow and servos unknown: random aeroplanes at 10 and 20 Hz, one flight at a time.

    python -m tests.studies.input_edges run SETS.jsonl [FIRST LAST]    # in pieces; sets that the file has are not run again
    python -m tests.studies.input_edges table SETS.jsonl

Surfaces follow commanded steps through a first-order servo of 20 to 80 ms that the estimate does not know; edges lie at random
between samples, or all of them on the sampling clock. Set k is flight k mod 4 of aeroplane k div 4 (`random_aeroplanes`). Right:
the 95 % interval of corrected bounds holds the truth in 90 to 99 % of the eight main derivatives. The last table is kept in
docs/validation.md.
"""

import json
import sys
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from daq.utilities.errors import UserError
from estimation.aircraft import Aircraft
from estimation.models import load_model
from estimation.session import runner
from groundstation.flight import Flight
from tests.studies import random_aeroplanes as own
from tests.studies.verdict_benchmark import records

ALL = 200  # sets
FLIGHTS = 4  # of an aeroplane
KINDS = ((10.0, False), (20.0, True), (10.0, True), (20.0, False))  # rate [Hz] and whether edges lie on the clock
INSIDE = 1.959964  # bounds of a 95 % interval


@lru_cache(maxsize=1)
def flown(aeroplane: int) -> tuple[list[Flight], Aircraft, Mapping[str, float], own.Situation]:
    """Flights of a drawn aeroplane with a drawn servo, its aircraft file, its truth, and how it was flown."""
    rng = np.random.default_rng([83, aeroplane])
    craft = own.Aeroplane.drawn(rng)
    rate, clocked = KINDS[aeroplane % len(KINDS)]
    situation = own.Situation("edges", rate=rate, clocked=clocked, servo=float(rng.uniform(0.02, 0.08)))
    aircraft = Aircraft("drawn", craft.span, craft.area, craft.chord, craft.mass, *craft.inertia)
    return own.fly(craft, situation, rng, FLIGHTS), aircraft, craft.derivatives, situation


def record_of(number: int) -> dict[str, Any]:
    """Errors of one flight's estimate in corrected bounds, by derivative."""
    aeroplane, index = divmod(number, FLIGHTS)
    flights, aircraft, truth, situation = flown(aeroplane)
    record = {"set": number, "rate": situation.rate, "clocked": situation.clocked, "servo": situation.servo}
    try:
        session = runner.estimate(load_model("lateral", aircraft), [flights[index]], aircraft, ("ml",))
    except UserError as error:
        return {**record, "failed": str(error)}
    (answer,) = session.flights
    assert answer.verdict is not None
    shown = answer.results["ml"].parameters
    errors = {n: (e.estimate - truth[n]) / e.std_coloured for n in own.MAIN if (e := shown[n]).identifiable}
    share = {n: e.std_coloured / abs(truth[n]) for n in own.MAIN if (e := shown[n]).identifiable}
    return {**record, "errors": errors, "share": share, "recommended": answer.verdict.recommended.method}


def table(path: Path) -> Iterator[str]:
    """The table, line by line."""
    yield "| | sets | recommended | error / corrected bound, rms | 95 % coverage | bound, median % of the value |"
    yield "|---|---|---|---|---|---|"
    made = [r for r in records(path) if "errors" in r]
    groups = {f"{rate:g} Hz, {'edges on the clock' if c else 'edges anywhere'}": (rate, c) for rate, c in sorted(KINDS)}
    for name, kind in groups.items():
        yield _row(name, [r for r in made if (r["rate"], r["clocked"]) == kind])
    yield _row("all", made)


def _row(name: str, sets: list[dict[str, Any]]) -> str:
    errors = np.array([e for r in sets for e in r["errors"].values()])
    shares = [s for r in sets for s in r["share"].values()]
    if not errors.size:
        return f"| {name} | 0 | - | - | - | - |"
    recommended = sum(r["recommended"] != "none" for r in sets)
    inside = np.mean(np.abs(errors) <= INSIDE)
    rms = np.sqrt(np.mean(errors**2))
    return f"| {name} | {len(sets)} | {recommended} | {rms:.2f} | {inside:.1%} of {errors.size} | {100 * np.median(shares):.1f} |"


def run(path: Path, first: int, last: int) -> None:
    """Sets that the file has not yet, one line each."""
    known = {r["set"] for r in records(path)}
    for number in (n for n in range(first, last) if n not in known):
        record = record_of(number)
        with path.open("a") as file:
            file.write(json.dumps(record, default=float) + "\n")


if __name__ == "__main__":
    verb, where, *numbers = sys.argv[1:]
    if verb == "run":
        run(Path(where), *(map(int, numbers) if numbers else (0, ALL)))
    else:
        print("\n".join(table(Path(where))))
