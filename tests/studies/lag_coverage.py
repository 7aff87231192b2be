"""Whether the stated bound of a lag covers the truth: those of the fourth simulator and the second truth, found by `gap`.

    python -m tests.studies.lag_coverage [--cases EFFECT:RATE ...] [--seed N] [--nulls N]

Three flights and one held out, of an aircraft of its own in every set. Beside each estimate stands the distance to the truth in
stated bounds. Accelerometers: those of a flight at 200 Hz, 40 ms before. Results: docs/validation/gap.md.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.gap.effects import catalogue
from estimation.gap.workflow import Options, run_gap
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import fourth_simulator as fourth
from tests.studies import second_truth
from tests.studies.gap_benchmark import SPEEDS, SUBJECTS, flights, requests

MODEL = {
    "elevator_lag": "longitudinal", "alpha_lag": "longitudinal", "aileron_lag": "lateral", "rudder_lag": "lateral",
    "beta_lag": "lateral", "accelerometers": "lateral",
}  # fmt: skip
LATE = 0.04  # s, of accelerometers


@dataclass(frozen=True)
class Case:
    """One effect at one rate [Hz] with its true size [s]. `source`: fourth or second (20 Hz alone)."""

    effect: str
    rate: int
    source: str = "fourth"

    @property
    def truth(self) -> float:
        if self.effect == "accelerometers":
            return LATE
        sizes = fourth.HIDDEN if self.source == "fourth" else {**second_truth.TYPICAL, **second_truth.pitch.PITCH}
        return float(sizes[self.effect])

    def flown(self, seed: int) -> list[Flight]:
        if self.source == "second":
            return flights(second_truth.fly(requests({self.effect: 1.0}, seed, 0.15, SUBJECTS[MODEL[self.effect]][-1])))
        shifted = self.effect == "accelerometers"
        kind = fourth.Kind(axes=MODEL[self.effect], rate=self.rate, hidden=() if shifted else ((self.effect, 1.0),))
        if not shifted:
            return list(fourth.fly(seed, kind, SPEEDS))
        fine = fourth.fly(seed, replace(kind, rate=fine_rate(self.rate)), SPEEDS)
        return [_late_accelerometers(f, fine_rate(self.rate), self.rate) for f in fine]


def fine_rate(rate: int) -> int:
    """A multiple of `rate` [Hz] of which a sample is a whole part of the lateness."""
    return rate * round(200 / rate)


def _late_accelerometers(flight: Flight, fine: int, rate: int) -> Flight:
    """Every so many samples of a flight at `fine` Hz, with accelerometers of LATE before."""
    shift, every = round(LATE * fine), fine // rate
    index = np.arange(0, flight.time.size, every)
    columns = {n: np.asarray(flight.columns[n])[index] for n in flight.columns if n != "time"}
    for name in ("ax", "ay", "az"):
        columns[name] = np.asarray(flight.columns[name])[np.maximum(index - shift, 0)]
    return Flight.build(flight.name, flight.time[index], columns, provenance=flight.provenance)


def line(case: Case, seed: int, nulls: int) -> str:
    four, base = case.flown(seed), load_model(MODEL[case.effect], "cdfp")
    result = run_gap(base, four[:3], four[3:], catalogue(model=base), Options(seed=1, nulls=nulls))
    head = f"{case.source} {case.rate} Hz {case.effect} {seed}"
    if not result.steps or not result.steps[0].estimates:
        return f"{head}: {result.verdict.value}"
    step = result.steps[0]
    name, (value, std) = next(iter(step.estimates.items()))
    off = (value - case.truth) / std
    return (
        f"{head}: {', '.join(s.effect for s in result.steps)}: {name} {1e3 * value:.1f} +- {1e3 * std:.1f} of"
        f" {1e3 * case.truth:g} ms, off {off:.1f} bounds, score {step.score:.1f}"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--cases", nargs="*", default=[f"{e}:{r}" for e in MODEL for r in (20, 50)], metavar="EFFECT:RATE[:SOURCE]"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--nulls", type=int, default=30)
    given = parser.parse_args(arguments)
    for number, text in enumerate(given.cases):
        effect, rate, *source = text.split(":")
        print(line(Case(effect, int(rate), *source), 100 * given.seed + number, given.nulls), flush=True)


if __name__ == "__main__":
    main()
