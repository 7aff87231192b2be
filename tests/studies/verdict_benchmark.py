"""How often what is recommended is right: random aeroplanes in thirteen situations, three flights each, fitted jointly.

    python -m tests.studies.verdict_benchmark [SIMULATOR] [AEROPLANES] [METHODS] [SITUATION ...]

SIMULATOR: `other` (default: `tests.studies.second_truth`, on which no threshold was chosen) or `own` (`random_aeroplanes`, on
which they
were). Wrong: one of the eight main derivatives more than 3 corrected bounds from truth. The last table is kept in
docs/validation.md.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.aircraft import Aircraft, load_aircraft
from estimation.models import load_model
from estimation.session import runner
from groundstation.flight import Flight
from tests.studies import random_aeroplanes as own
from tests.studies import second_truth as other

METHODS = ("ml", "fem", "ls")
WRONG = 3.0  # corrected bounds
FLIGHTS = 3

Made = tuple[list[Flight], Aircraft, Mapping[str, float]]


@dataclass(frozen=True)
class Outcome:
    """One aeroplane in one situation. worst: bounds by which the estimate shown misses the truth in a main derivative."""

    recommended: str
    worst: float
    named: tuple[str, ...]

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


def outcome(made: Made, methods: Sequence[str]) -> Outcome:
    """The joint estimate of one aeroplane and its verdict."""
    flights, aircraft, truth = made
    session = runner.estimate(load_model("lateral", aircraft), flights, aircraft, methods, joint=True)
    assert session.verdict is not None
    chosen = session.verdict.recommended
    shown = session.joint.get(chosen.method) or session.joint[methods[0]]
    told = [(shown.parameters[n], truth[n]) for n in own.MAIN if shown.parameters[n].identifiable]
    worst = max(abs(e.estimate - true) / e.std_coloured for e, true in told)
    odd = ("odd",) if any(o.flight == flights[-1].name for o in session.odd) else ()
    return Outcome(chosen.method, worst, (*odd, *chosen.lacks))


def row(situation: own.Situation, outcomes: Sequence[Outcome]) -> str:
    """One line of the table."""
    right = sum(o.recommended != "none" and not o.wrong for o in outcomes)
    refused = [o for o in outcomes if o.recommended == "none"]
    spared = sum(o.worst <= WRONG for o in refused)
    named = sum(bool(set(situation.causes) & set(o.named)) for o in refused) if situation.causes else 0
    cause = f"{named} of {len(refused)}" if situation.causes and refused else "-"
    wrong = sum(o.wrong for o in outcomes)
    worst = max(o.worst for o in outcomes)
    return f"| {situation.name} | {len(outcomes)} | {right} | {wrong} | {len(refused)} | {spared} | {cause} | {worst:.1f} |"


def table(simulator: str, count: int, methods: Sequence[str], names: Sequence[str] = ()) -> Iterator[str]:
    """The table, line by line."""
    yield "| situation | aeroplanes | right | wrong | none | of these right | cause named | worst, bounds |"
    yield "|---|---|---|---|---|---|---|---|"
    for situation in own.situations(names):
        yield row(situation, [outcome(SIMULATORS[simulator](situation, k), methods) for k in range(count)])


if __name__ == "__main__":
    words = sys.argv[1:]
    which = words[0] if words else "other"
    wanted = tuple(words[2].split(",")) if len(words) > 2 else METHODS
    for line in table(which, int(words[1]) if len(words) > 1 else 2, wanted, words[3:]):
        print(line, flush=True)
