"""Awkward flights of JSBSim's aircraft, with truth: what each method gives, and whom the verdict believes.

    python -m tests.studies.gallery [SEEDS [ROW...]]

SEEDS (1) flights of each aircraft in each row; ROW... are numbers of rows (all). The last table is kept in docs/validation.md.
"""

import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import savemat

from estimation.compatibility.correct import correct_flight
from estimation.compatibility.reconstruction import compatibility
from estimation.models import load_model
from estimation.models.base import Model, Parameter, ParameterRole
from estimation.models.kinematic import STANDARD_FACTORS
from estimation.session import runner
from groundstation.flight import Flight
from groundstation.importers.run import import_data
from tests.support.gallery import records
from tests.support.gallery.aircraft import Kind
from tests.support.gallery.records import DEG, Columns, Flown, fly, recorded

METHODS = ("ml", "fem", "fem-noise", "ls")
OFF = 3.0  # corrected bounds
KINDS = (
    Kind("J3Cub", 28.0, 0.7, 4 * DEG, 6 * DEG),
    Kind("L17", 50.0, 0.7, 4 * DEG, 4 * DEG),
    Kind("p51d", 100.0, 0.6, 3 * DEG, 3 * DEG),
    Kind("A4", 130.0, 0.5, 3 * DEG, 4 * DEG),
    Kind("C130", 100.0, 1.5, 5 * DEG, 4 * DEG),
    Kind("787-8", 130.0, 2.0, 7 * DEG, 4 * DEG),
)
"""From 0.4 to 190 t."""
RATES = {"J3Cub": 50, "L17": 20, "p51d": 25, "A4": 50, "C130": 20, "787-8": 10}


def model_of(flown: Flown) -> Model:
    """`lateral` with the yawing moment of the ailerons, which these aircraft have."""
    return load_model("lateral", flown.craft).plus(parameters=[Parameter("Cn_da")], terms={"Cn": "Cn_da*delta_a"})


@dataclass(frozen=True)
class Row:
    """One kind of awkwardness. change: what the instruments do; mend: what a person does about it before the estimate."""

    title: str
    change: Callable[[Columns, Flown], Columns] | None = None
    flight: Mapping[str, Any] = field(default_factory=dict)
    mend: Callable[[Flight, Flown], Flight] = lambda flight, flown: flight


def referred_to_the_cg(flight: Flight, flown: Flown) -> Flight:
    """`sideslip check --factors x_vane=...,x_imu=... --write`."""
    span = flown.craft.span
    result = compatibility(
        flight, STANDARD_FACTORS, known={"x_vane": records.BOOM * span, "x_imu": records.AHEAD * span}
    )
    return correct_flight(flight, result)


def by_way_of_matlab(flight: Flight, flown: Flown) -> Flight:
    """Saved as somebody else's MATLAB file, in degrees, knots and g, and imported with a mapping."""
    angles = ("alpha", "beta", "phi", "theta", "psi", "delta_e", "delta_a", "delta_r")
    units = {
        **dict.fromkeys(angles, "deg"),
        **dict.fromkeys("pqr", "deg/s"),
        **dict.fromkeys(("ax", "ay", "az"), "g"),
        "V": "knots",
        "rho": "kg/m3",
    }
    scale = {"deg": DEG, "deg/s": DEG, "knots": 1852 / 3600, "g": 9.80665, "kg/m3": 1.0}
    with tempfile.TemporaryDirectory() as folder:
        data, mapping = Path(folder) / "run.mat", Path(folder) / "map.toml"
        savemat(
            data,
            {"t": flight.time, **{f"{n.upper()}_x": flight[n] / scale[u] for n, u in units.items()}},
            oned_as="column",
        )
        lines = [f'{n} = {{ column = "{n.upper()}_x", unit = "{u}" }}' for n, u in units.items()]
        mapping.write_text('format = 1\n[time]\ncolumn = "t"\n[columns]\n' + "\n".join(lines) + "\n")
        return import_data(data, mapping)


ROWS = (
    Row("plain"),
    Row("12 bits", records.quantised),
    Row("attitude and airspeed at 5 Hz, repeated", records.slow),
    Row(
        "vanes half a span ahead, IMU off the CG, referred to it by `check`", records.on_a_boom, mend=referred_to_the_cg
    ),
    Row("a gap", records.with_a_gap),
    Row("rudder at rest", flight={"rest": True}),
    Row("MATLAB file in degrees, knots and g", mend=by_way_of_matlab),
    Row("gusts of 0.3 m/s", flight={"gust": 0.3}),
    Row("gusts of 1 m/s", flight={"gust": 1.0}),
    Row("gusts of 1 m/s, 12 bits, 5 Hz, a gap", records.all_at_once, flight={"gust": 1.0}),
)


def row_named(title: str) -> Row:
    """The row of that title."""
    return next(r for r in ROWS if r.title == title)


@dataclass(frozen=True)
class Outcome:
    """errors: method -> error over corrected bound of each derivative that it says can be told."""

    kind: str
    errors: Mapping[str, Mapping[str, float]]
    recommended: str

    def off(self, method: str) -> bool:
        """Whether some derivative of a method is more than OFF corrected bounds from the truth."""
        return max((abs(e) for e in self.errors.get(method, {}).values()), default=np.inf) > OFF


def outcome(row: Row, kind: Kind, seed: int, folder: Path) -> Outcome:
    """Fly, record, mend, estimate."""
    flown = fly(kind, folder, seed, rate=RATES[kind.name], duration=60.0 if kind.pace > 1.0 else 30.0, **row.flight)
    flight = row.mend(recorded(flown, seed, row.change), flown)
    told = runner.estimate(model_of(flown), [flight], flown.craft, METHODS).flights[0]
    errors = {}
    for method, result in told.results.items():
        names = [n for n in result.model.free_of(ParameterRole.DERIVATIVE) if result.parameters[n].identifiable]
        found = {n: result.parameters[n] for n in names}
        errors[method] = (
            {n: (e.estimate - flown.truth[n]) / e.std_coloured for n, e in found.items()} if result.converged else {}
        )
    assert told.verdict is not None
    return Outcome(kind.name, errors, told.verdict.recommended.method)


def line(title: str, outcomes: Sequence[Outcome]) -> str:
    """One line of the table."""
    chosen = [o.recommended for o in outcomes]
    counts = " | ".join(str(chosen.count(m)) for m in (*METHODS, "none"))
    off = " | ".join(str(sum(o.off(m) for o in outcomes)) for m in METHODS)
    kept = [e for o in outcomes for e in o.errors.get(o.recommended, {}).values()]
    inside = f"{np.mean(np.abs(kept) <= 1.96):.0%} of {len(kept)}" if kept else "-"
    wrong = sum(o.recommended in o.errors and o.off(o.recommended) for o in outcomes)
    return f"| {title} | {len(outcomes)} | {counts} | {off} | {wrong} | {inside} |"


def table(seeds: int, rows: Sequence[Row] = ROWS) -> Iterator[str]:
    """The table, line by line; behind it what the recommended method missed."""
    heads = ["flights", "n", *METHODS, "none", *(f"{m} off" for m in METHODS), "recommended off", "in 95 %"]
    yield f"| {' | '.join(heads)} |"
    yield "|---" * len(heads) + "|"
    everything: list[Outcome] = []
    with tempfile.TemporaryDirectory() as folder:
        for row in rows:
            outcomes = [outcome(row, kind, 10 + seed, Path(folder)) for kind in KINDS for seed in range(seeds)]
            everything += outcomes
            yield line(row.title, outcomes)
            for o in outcomes:
                for name, error in o.errors.get(o.recommended, {}).items():
                    if abs(error) > OFF:
                        yield f"<!-- {row.title}: {o.kind} {o.recommended} {name} {error:+.1f} -->"
    yield line("all", everything)


if __name__ == "__main__":
    for text in table(int(sys.argv[1]) if len(sys.argv) > 1 else 1, [ROWS[int(n)] for n in sys.argv[2:]] or ROWS):
        print(text, flush=True)
