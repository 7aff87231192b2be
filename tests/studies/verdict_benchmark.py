"""How often what is recommended is right: random aeroplanes in thirteen situations, three flights each, fitted jointly.

    python -m tests.studies.verdict_benchmark run SETS.jsonl [FIRST LAST]    # in pieces; sets that the file has are not run again
    python -m tests.studies.verdict_benchmark table SETS.jsonl

Set k is situation k mod 13 of aeroplane k div 13; every third aeroplane is flown by `tests.studies.second_truth`, on which no
threshold was chosen, the others by `random_aeroplanes`. Every second aeroplane is estimated by ml, fem and ls at once, the others
as the program asks: by ml, and by all three where its sentence says so. Wrong: one of the eight main derivatives more than 3
corrected bounds from truth. The last table is kept in docs/validation.md.
"""

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from estimation.aircraft import Aircraft, load_aircraft
from estimation.models import load_model
from estimation.session import runner
from estimation.session.structured import StructureWish
from groundstation.flight import Flight
from tests.studies import random_aeroplanes as own
from tests.studies import second_truth as other

METHODS = ("ml", "fem", "ls")
WRONG = 3.0  # corrected bounds
FLIGHTS = 3
ALL = 300  # sets
FIRST_SEED = 100  # thresholds were chosen in sight of smaller ones
ADVICE = "--method ml,fem,ls"

Made = tuple[list[Flight], Aircraft, Mapping[str, float]]


@dataclass(frozen=True)
class Outcome:
    """One aeroplane in one situation. worst: bounds by which the estimate shown misses the truth in a main derivative; named:
    what the model is said to lack, or what was added to it; told: main derivatives that are."""

    recommended: str
    worst: float
    named: tuple[str, ...]
    which: str = ""
    told: int = len(own.MAIN)
    why: str = ""

    @property
    def wrong(self) -> bool:
        """Whether a wrong estimate was recommended."""
        return self.recommended != "none" and self.worst > WRONG


def own_flights(situation: own.Situation, seed: int) -> Made:
    """Flights of a drawn aeroplane, the aircraft as its file has it, and the truth."""
    rng = np.random.default_rng([78, seed])
    craft = own.Aeroplane.drawn(rng)
    aircraft = Aircraft("drawn", craft.span, craft.area, craft.chord, craft.mass, *craft.inertia)
    return own.fly(craft, situation, rng, FLIGHTS), aircraft, craft.derivatives


EFFECTS: Mapping[str, Mapping[str, float]] = {
    "Cn_da hidden": {"Cn_da": 1.0},
    "CY_da hidden": {"CY_da": 1.5},
    "vane scale 1.25": {"beta_scale": 2.5},
    "vane lags 60 ms": {"beta_lag": 0.86},
    "aileron lags its record by 50 ms": {"aileron_delay": 0.83},
    "rudder recorded 50 ms late": {"rudder_delay": -0.83},
    "Ixz more than the file's": {"Ixz_error": 1.0},
}
"""Situation -> effects of `second_truth`, in multiples of their typical sizes."""


def other_flights(situation: own.Situation, seed: int) -> Made:
    """Flights of the small delta with drawn derivatives, by the other simulator."""
    rng = np.random.default_rng([79, seed])
    truth = other.perturbed_derivatives(rng, 0.3)
    base = other.Request(
        seed=0,
        speed=float(rng.uniform(14.5, 19.0)),
        derivatives=truth,
        gust=1.0 * other.DEG if situation.gust else 0.0,
        effects=_effects(situation),
    )
    requests = [replace(base, seed=1000 * seed + i) for i in range(FLIGHTS)]
    if situation.odd != 1.0:
        changed = {
            n: v * (situation.odd if n in ("Cn_beta", "Cl_beta", "Cn_r", "CY_beta") else 1.0) for n, v in truth.items()
        }
        requests[-1] = replace(requests[-1], derivatives=changed)
    made = [_changed(columns, situation, rng, i) for i, columns in enumerate(other.fly(requests))]
    craft = load_aircraft("cdfp")
    bare = replace(craft, derivatives={}, mass=other.MASS, **other.INERTIA)
    return made, bare, truth


def _effects(situation: own.Situation) -> Mapping[str, float]:
    known = EFFECTS.get(situation.name, {})
    return {n: v for n, v in known.items() if v > 0.0}


def _changed(
    columns: Mapping[str, np.ndarray], situation: own.Situation, rng: np.random.Generator, index: int
) -> Flight:
    """The record as the situation has it: thinner, noisier, a control recorded late."""
    data = {n: np.array(v) for n, v in columns.items()}
    time = data.pop("time")
    if situation.noise != 1.0:
        extra = np.sqrt(situation.noise**2 - 1.0)
        data |= {n: data[n] + extra * s * rng.standard_normal(time.size) for n, s in other.NOISE.items() if n in data}
    if situation.rudder_late:
        data["delta_r"] = np.interp(time + situation.rudder_late, time, data["delta_r"])
    step = round(20.0 / situation.rate)
    return Flight.build(f"f{index}", time[::step], {n: v[::step] for n, v in data.items()})


SIMULATORS: Mapping[str, Callable[[own.Situation, int], Made]] = {"own": own_flights, "other": other_flights}


def set_of(number: int) -> tuple[str, own.Situation, int]:
    """Simulator, situation and seed of a set."""
    aeroplane, which = divmod(number, len(own.SITUATIONS))
    situation = own.SITUATIONS[which]
    other_can = aeroplane % 3 == 2 and not situation.clocked
    return "other" if other_can else "own", situation, FIRST_SEED + aeroplane


def outcome(made: Made, methods: Sequence[str], structure: StructureWish = StructureWish.TEST) -> Outcome:
    """The joint estimate of one aeroplane and its verdict."""
    flights, aircraft, truth = made
    session = runner.estimate(
        load_model("lateral", aircraft), flights, aircraft, methods, joint=True, structure=structure
    )
    assert session.verdict is not None
    chosen = session.verdict.recommended
    shown = session.joint.get(chosen.method) or session.joint[methods[0]]
    identifiable = {n: shown.parameters[n] for n in own.MAIN if shown.parameters[n].identifiable}
    misses = {n: abs(e.estimate - truth[n]) / e.std_coloured for n, e in identifiable.items()}
    which, worst = max(misses.items(), key=lambda item: item[1], default=("", 0.0))
    odd = ("odd",) if any(o.flight == flights[-1].name for o in session.odd) else ()
    added = session.structure.added if session.structure is not None else ()
    names = (*odd, *chosen.lacks, *(n for n in added if n not in chosen.lacks))
    return Outcome(chosen.method, worst, names, which, len(identifiable), chosen.why)


def record_of(number: int) -> dict[str, Any]:
    """One set as a line of the file: what was recommended, and what `--structure auto` makes of it where a cause is hidden."""
    simulator, situation, seed = set_of(number)
    made = SIMULATORS[simulator](situation, seed)
    methods: tuple[str, ...] = METHODS if seed % 2 else ("ml",)
    first = outcome(made, methods)
    if first.recommended == "none" and ADVICE in first.why:
        methods = METHODS
        first = outcome(made, methods)
    record = {"set": number, "simulator": simulator, "situation": situation.name, "seed": seed, "methods": methods}
    auto = None
    if situation.causes and situation.causes != ("odd",) and first.recommended == "none":
        auto = asdict(outcome(made, methods, StructureWish.AUTO))
    return {**record, "test": asdict(first), "auto": auto}


def run(path: Path, first: int, last: int) -> None:
    """Sets that the file has not yet, one line each."""
    known = {r["set"] for r in records(path)}
    for number in (n for n in range(first, last) if n not in known):
        try:
            record = record_of(number)
        except Exception as error:  # noqa: BLE001 - a set that fails is a line of the table, not the end of the study
            record = {"set": number, "situation": set_of(number)[1].name, "failed": f"{type(error).__name__}: {error}"}
        with path.open("a") as file:
            file.write(json.dumps(record, default=float) + "\n")


def records(path: Path) -> list[dict[str, Any]]:
    """Lines of the file so far."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []


def row(situation: own.Situation, sets: Sequence[Mapping[str, Any]]) -> str:
    """One line of the table."""
    shown = [_read(r["test"]) for r in sets if "failed" not in r]
    auto = [_read(r["auto"]) for r in sets if r.get("auto")]
    right = sum(o.recommended != "none" and not o.wrong for o in shown)
    refused = [o for o in shown if o.recommended == "none"]
    spared = sum(o.worst <= WRONG for o in refused)
    named = sum(bool(set(situation.causes) & set(o.named)) for o in refused)
    cause = f"{named} of {len(refused)}" if situation.causes and refused else "-"
    inside = f"{sum(o.worst <= WRONG for o in auto)} of {len(auto)}" if auto else "-"
    wrong = sum(o.wrong for o in shown)
    worst = max((o.worst for o in shown if o.recommended != "none"), default=float("nan"))
    failed = sum("failed" in r for r in sets)
    cells = (situation.name, len(sets), right, wrong, len(refused), spared, cause, inside, f"{worst:.1f}", failed)
    return "| " + " | ".join(map(str, cells)) + " |"


def _read(data: Mapping[str, Any]) -> Outcome:
    return Outcome(**{**data, "named": tuple(data["named"])})


def table(path: Path) -> Iterator[str]:
    """The table, line by line."""
    yield (
        "| situation | sets | right | wrong | none | of these right | cause named | right by auto"
        " | worst recommended, bounds | failed |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|"
    by_situation = {s.name: [r for r in records(path) if r["situation"] == s.name] for s in own.SITUATIONS}
    for situation in own.SITUATIONS:
        if by_situation[situation.name]:
            yield row(situation, by_situation[situation.name])


if __name__ == "__main__":
    verb, path, *numbers = sys.argv[1:]
    if verb == "run":
        run(Path(path), *(map(int, numbers) if numbers else (0, ALL)))
    else:
        print("\n".join(table(Path(path))))
