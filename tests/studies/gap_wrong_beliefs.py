"""What the gap workflow answers where the aircraft file is wrong: mass, inertia, derivatives of another class of aircraft.

    python -m tests.studies.gap_wrong_beliefs [--models lateral longitudinal six-dof] [--nulls N] [--start SEED] [--only CASE...]

Flights of the second truth. A right answer is the one that right beliefs give; where only thrust over mass tells, `mass_error` or
`thrust_scale`, a set of two, is what was done to the file.
"""

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import replace

from estimation.aircraft import Aircraft, PriorDerivative, load_aircraft
from estimation.gap.search.state import Options
from estimation.gap.workflow import run_gap
from estimation.models.load import load_model
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import SUBJECTS, flights, requests, same_class

LIGHT_AIRPLANE: Mapping[str, float] = {
    "CY_beta": -0.393, "CY_p": -0.075, "CY_r": 0.214, "CY_dr": 0.187, "Cl_beta": -0.0923, "Cl_p": -0.484, "Cl_r": 0.0798,
    "Cl_da": -0.229, "Cl_dr": 0.0147, "Cn_beta": 0.0587, "Cn_p": -0.0278, "Cn_r": -0.0937, "Cn_dr": -0.0645,
    "CL_0": 0.31, "CL_alpha": 5.143, "CL_q": 3.9, "CL_de": 0.43, "CD_0": 0.031, "CD_k": 0.054, "Cm_0": -0.015, "Cm_alpha": -0.89,
    "Cm_q": -12.4, "Cm_de": -1.28,
}  # fmt: skip
"""A four-seat aircraft with a tail, as handbooks have it."""


def _scaled(*names: str, by: float = 1.2) -> Callable[[Aircraft], Aircraft]:
    return lambda craft: replace(craft, **{n: by * getattr(craft, n) for n in names})


def _of_another_class(craft: Aircraft) -> Aircraft:
    return replace(
        craft, derivatives={n: PriorDerivative(v, 0.2 * abs(v), "handbook") for n, v in LIGHT_AIRPLANE.items()}
    )


CASES: Mapping[str, Callable[[Aircraft], Aircraft]] = {
    "as it is": lambda craft: craft,
    "mass 20 % high": _scaled("mass"),
    "mass 20 % low": _scaled("mass", by=0.8),
    "all inertia 20 % high": _scaled("Ixx", "Iyy", "Izz", "Ixz"),
    "roll inertia 20 % low": _scaled("Ixx", by=0.8),
    "pitch inertia 20 % high": _scaled("Iyy"),
    "no product of inertia": _scaled("Ixz", by=0.0),
    "believed a light aeroplane": _of_another_class,
    "no beliefs": lambda craft: replace(craft, derivatives={}),
}
HIDDEN: Mapping[str, tuple[str, ...]] = {
    "lateral": ("", "Cn_da", "beta_lag"),
    "longitudinal": ("", "alpha_lag", "Cm_alphadot"),
    "six-dof": ("", "Cm_beta2"),
}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--models", nargs="*", default=list(HIDDEN))
    parser.add_argument("--only", nargs="*", default=list(CASES))
    parser.add_argument("--nulls", type=int, default=60)
    parser.add_argument("--start", type=int, default=1)
    a = parser.parse_args()
    print("| model | aircraft file | hidden | answer | named, score of threshold, held-out gap closed | s |")
    print("|---" * 6 + "|")
    for base in a.models:
        for hidden in HIDDEN[base]:
            seed = 700_000 + 1000 * a.start + 10 * len(hidden)
            asked = requests({hidden: 1.0} if hidden else {}, seed, 0.15, SUBJECTS[base][-1])
            four = flights(truth.fly(asked))
            for case in a.only:
                model = load_model(base, CASES[case](load_aircraft("cdfp")))
                began = time.process_time()
                result = run_gap(model, four[:3], four[3:], options=Options(seed=1, nulls=a.nulls))
                told = "; ".join(
                    f"{s.effect} {s.score:.1f} of {s.threshold:.1f}, {s.holdout.counted:.2f}" if s.holdout else s.effect
                    for s in result.steps
                )
                names = [s.effect for s in result.steps]
                right = not names if not hidden else bool(names) and same_class(names[0], hidden)
                row = (
                    base,
                    case,
                    hidden or "nothing",
                    result.verdict.value,
                    told,
                    f"{time.process_time() - began:.0f}",
                )
                print(f"| {' | '.join(row)} |{'' if right else ' <!-- other -->'}", flush=True)


if __name__ == "__main__":
    main()
