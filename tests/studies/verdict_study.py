"""How often the verdict recommends what is right: simulated flights in still air and in gusts, with truth.

    python -m tests.studies.verdict_study [FLIGHTS]

Flies FLIGHTS (10) seeds at each gust with the independent six-degree-of-freedom simulator of `second_truth`, and pairs of
lateral manoeuvres of an aircraft of a twin jet's size (`tests.unit.estimation.truth.JET`) estimated jointly; methods ml, fem
and ls.
The last table is kept in docs/estimation.md.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.aircraft import Aircraft, load_aircraft
from estimation.estimators.result import Result
from estimation.models import load_model
from estimation.models.base import ParameterRole
from estimation.session import runner
from estimation.session.verdict import Verdict
from groundstation.flight import Flight
from tests.studies import second_truth
from tests.unit.estimation.truth import DEG, JET, JET_TRUE, Case, fly

METHODS = ("ml", "fem", "fem-noise", "ls")
GUSTS = (0.0, 0.15, 0.5, 1.0, 2.0, 3.5)  # deg of sideslip, rms
JET_GUSTS = (0.0, 0.3, 1.0, 1.5)  # m/s rms
OFF = 3.0  # corrected bounds
JET_NOISE = {
    "ay": 0.03, "p": 1e-3, "q": 1e-3, "r": 5e-4, "phi": 1e-3, "theta": 1e-3, "alpha": 1.5e-3, "beta": 1.5e-3, "V": 0.3,
    "delta_a": 5e-4, "delta_r": 5e-4,
}  # fmt: skip
JET_AIRCRAFT = Aircraft("jet", JET.span, JET.area, 3.2, JET.mass, JET.ixx, JET.iyy, JET.izz, JET.ixz)


@dataclass(frozen=True)
class Outcome:
    """One verdict. errors: method -> error over corrected bound of each derivative."""

    errors: Mapping[str, Sequence[float]]
    recommended: str

    def off(self, method: str) -> bool:
        """Whether a method is off by more than OFF corrected bounds in some derivative."""
        return max((abs(e) for e in self.errors.get(method, ())), default=np.inf) > OFF


def small_flights(gust: float, count: int) -> list[tuple[Flight, Mapping[str, float]]]:
    """Flights of the small aircraft with their true derivatives. gust: rms sideslip [deg]."""
    requests = [
        second_truth.Request(
            seed=100 + i, gust=gust * DEG, derivatives=second_truth.perturbed_derivatives(np.random.default_rng([7, i]))
        )
        for i in range(count)
    ]
    made = []
    for request, columns in zip(requests, second_truth.fly(requests), strict=True):
        data = dict(columns)
        made.append((Flight.build(f"gust_{gust}_{request.seed}", data.pop("time"), data), request.derivatives))
    return made


def jet_flights(gust: float, seed: int) -> list[Flight]:
    """Two lateral manoeuvres of 30 s at 25 Hz. gust: rms side gust [m/s], correlated over 3 s."""
    case = Case(
        seconds=30.0, rate=25.0, V=110.0, true=JET_TRUE, noise=JET_NOISE, gust=gust, gust_time=3.0, craft=JET,
        aileron=5 * DEG, rudder=4 * DEG,
    )  # fmt: skip
    return fly(case, np.random.default_rng([5, seed, int(10 * gust)]), 2)[0]


def outcome(results: Mapping[str, Result], verdict: Verdict | None, truth: Mapping[str, float]) -> Outcome:
    """Errors and recommendation of one set of results."""
    assert verdict is not None
    errors = {}
    for method, result in results.items():
        names = result.model.free_of(ParameterRole.DERIVATIVE)
        told = [(result.parameters[n], truth[n]) for n in names if result.parameters[n].identifiable]
        errors[method] = [(e.estimate - true) / e.std_coloured for e, true in told] if result.converged else []
    return Outcome(errors, verdict.recommended.method)


def small_outcomes(gust: float, count: int) -> list[Outcome]:
    """Verdicts on single flights of the small aircraft."""
    craft = load_aircraft("cdfp")
    model = load_model("lateral", craft)
    found = []
    for flight, truth in small_flights(gust, count):
        estimates = runner.estimate(model, [flight], craft, METHODS).flights[0]
        found.append(outcome(estimates.results, estimates.verdict, truth))
    return found


def jet_outcomes(gust: float, count: int) -> list[Outcome]:
    """Verdicts on joint estimates of pairs of manoeuvres of the jet."""
    model = load_model("lateral", JET_AIRCRAFT)
    found = []
    for seed in range(count):
        session = runner.estimate(model, jet_flights(gust, seed), JET_AIRCRAFT, METHODS, joint=True)
        found.append(outcome(session.joint, session.verdict, JET_TRUE))
    return found


def row(name: str, outcomes: Sequence[Outcome]) -> str:
    """One line of the table."""
    chosen = [o.recommended for o in outcomes]
    counts = " | ".join(str(chosen.count(m)) for m in (*METHODS, "none"))
    off = " | ".join(str(sum(o.off(m) for o in outcomes)) for m in METHODS)
    kept = [e for o in outcomes if o.recommended in o.errors for e in o.errors[o.recommended]]
    inside = f"{np.mean(np.abs(kept) <= 1.96):.0%}" if kept else "-"
    wrong = sum(o.recommended in o.errors and o.off(o.recommended) for o in outcomes)
    return f"| {name} | {len(outcomes)} | {counts} | {off} | {wrong} | {inside} |"


def table(count: int) -> Iterator[str]:
    """The table, line by line."""
    yield "| flights | sets | ml | fem | ls | none | ml off | fem off | ls off | recommended off | in 95 % |"
    yield "|---|---|---|---|---|---|---|---|---|---|---|"
    for gust in GUSTS:
        yield row(f"small, gusts {gust} deg", small_outcomes(gust, count))
    for gust in JET_GUSTS:
        yield row(f"jet, joint, gusts {gust} m/s", jet_outcomes(gust, max(2, count // 2)))


if __name__ == "__main__":
    for line in table(int(sys.argv[1]) if len(sys.argv) > 1 else 10):
        print(line, flush=True)
