"""Flights made awkward on purpose: what the gap workflow answers, and what a right answer would be.

Run: python -m tests.studies.gap_decoys [--only NAME...] [--nulls N] [--out JSONL]
"""

import argparse
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from daq.utilities.errors import UserError
from estimation.gap.effects import catalogue
from estimation.gap.search.state import Options
from estimation.gap.workflow import run_gap
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import flights, requests

Columns = dict[str, Any]
Change = Callable[[list[Columns], np.random.Generator], list[Columns]]


def _each(change: Callable[[Columns, np.random.Generator], Columns], which: Sequence[int] = (0, 1, 2, 3)) -> Change:
    return lambda four, rng: [change(dict(c), rng) if i in which else c for i, c in enumerate(four)]


def _every(n: int) -> Change:
    return _each(lambda c, rng: {k: v[::n] for k, v in c.items()})


def _later(c: Columns, rng: np.random.Generator) -> Columns:
    return {k: v[130:] for k, v in c.items()}


def _spike(c: Columns, rng: np.random.Generator) -> Columns:
    beta = c["beta"].copy()
    beta[222] += 0.35
    return c | {"beta": beta}


def _dropout(c: Columns, rng: np.random.Generator) -> Columns:
    r = c["r"].copy()
    r[300:312] = np.nan
    return c | {"r": r}


def _noisy(c: Columns, rng: np.random.Generator) -> Columns:
    return c | {
        n: c[n] + 3.0 * truth.NOISE[n] * rng.standard_normal(c[n].size) for n in ("p", "r", "beta", "phi", "ay")
    }


def _rough_bank(c: Columns, rng: np.random.Generator) -> Columns:
    return c | {"phi": c["phi"] + 0.02 * rng.standard_normal(c["phi"].size)}


def _swapped(four: list[Columns], rng: np.random.Generator) -> list[Columns]:
    return [four[0], four[1] | {"delta_a": four[2]["delta_a"]}, *four[2:]]


@dataclass(frozen=True)
class Decoy:
    """effects hidden, what is done to the four flights, and the answers that are right (verdicts or effect names)."""

    effects: Mapping[str, float]
    change: Change
    right: tuple[str, ...]
    training: int = 3
    holdout: int = 1
    rate: int = 20
    manoeuvres: str = "rich"
    without: tuple[str, ...] = ()


AS_FLOWN: Change = lambda four, rng: four  # noqa: E731
NAMED, CALM = {"Cn_da": 1.0}, {}
RIGHT = ("Cn_da", "Ixz_error")
DECOYS: Mapping[str, Decoy] = {
    "one flight only": Decoy(NAMED, AS_FLOWN, RIGHT, 1, 0),
    "one flight only, nothing hidden": Decoy(CALM, AS_FLOWN, ("no_gap", "cannot_tell"), 1, 0),
    "no held-out flight": Decoy(NAMED, AS_FLOWN, RIGHT, 3, 0),
    "no heading": Decoy(NAMED, _each(lambda c, rng: {k: v for k, v in c.items() if k != "psi"}), RIGHT),
    "50 Hz": Decoy(NAMED, _every(4), RIGHT, rate=200),
    "50 Hz, nothing hidden": Decoy(CALM, _every(4), ("no_gap",), rate=200),
    "11.8 Hz": Decoy(NAMED, _every(17), RIGHT, rate=200),
    "11.8 Hz, nothing hidden": Decoy(CALM, _every(17), ("no_gap",), rate=200),
    "begun within a manoeuvre": Decoy(NAMED, _each(_later), RIGHT),
    "spike on the vane": Decoy(CALM, _each(_spike, (1,)), ("no_gap", "unknown_effect")),
    "dropout of the yaw gyro": Decoy(CALM, _each(_dropout, (1,)), ("no_gap",)),
    "one noisy flight": Decoy(CALM, _each(_noisy, (1,)), ("no_gap",)),
    "coarse attitude": Decoy(NAMED, _each(_rough_bank), RIGHT),
    "aileron off zero": Decoy(CALM, _each(lambda c, rng: c | {"delta_a": c["delta_a"] + 0.02}), ("no_gap",)),
    "vane off zero": Decoy(CALM, _each(lambda c, rng: c | {"beta": c["beta"] + 0.01}), ("no_gap",)),
    "air density 10 % high": Decoy(CALM, _each(lambda c, rng: c | {"rho": c["rho"] * 1.1}), ("no_gap",)),
    "ailerons of another flight": Decoy(CALM, _swapped, ("unknown_effect", "refused")),
    "aileron only, nothing hidden": Decoy(CALM, AS_FLOWN, ("cannot_tell",), manoeuvres="aileron_only"),
    "aileron only, fin stall": Decoy({"Cn_dr3": 1.0}, AS_FLOWN, ("cannot_tell",), manoeuvres="aileron_only"),
    "only impostors in the catalogue": Decoy(
        {"beta_lag": 1.0}, AS_FLOWN, ("unknown_effect", "time_skew", "vane_position"), without=("beta_lag",)
    ),
}


def fly(decoy: Decoy, seed: int) -> list[Flight]:
    """Four flights of the second truth, changed."""
    usual = truth.SAMPLE
    truth.SAMPLE = decoy.rate
    try:
        columns = truth.fly(requests(dict(decoy.effects), seed, 0.15, decoy.manoeuvres))
    finally:
        truth.SAMPLE = usual
    return flights(decoy.change(columns, np.random.default_rng([seed, 5])))


def run(name: str, seed: int, nulls: int) -> dict[str, Any]:
    decoy = DECOYS[name]
    four = fly(decoy, seed)
    effects = tuple(e for e in catalogue() if e.name not in decoy.without)
    began = time.perf_counter()
    try:
        result = run_gap(
            load_model("lateral", "cdfp"),
            four[: decoy.training],
            four[3 : 3 + decoy.holdout],
            effects,
            Options(seed=1, nulls=nulls),
        )
    except UserError as error:
        return {"decoy": name, "seed": seed, "answer": "refused", "text": str(error), "right": "refused" in decoy.right}
    answer = result.steps[0].effect if result.steps and result.steps[0].effect != "unknown" else result.verdict.value
    return {
        "decoy": name,
        "seed": seed,
        "answer": answer,
        "verdict": result.verdict.value,
        "steps": [s.effect for s in result.steps],
        "right": answer in decoy.right,
        "text": result.text,
        "notes": [n for n in result.notes if "derived" not in n],
        "seconds": round(time.perf_counter() - began, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--only", nargs="*", default=list(DECOYS))
    parser.add_argument("--seed", type=int, default=7001)
    parser.add_argument("--nulls", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("build/gap_decoys.jsonl"))
    a = parser.parse_args()
    a.out.parent.mkdir(parents=True, exist_ok=True)
    for i, name in enumerate(a.only):
        row = run(name, a.seed + i, a.nulls)
        with a.out.open("a", encoding="utf-8") as handle:
            handle.write(json.dumps(row) + "\n")
        print("ok" if row["right"] else "--", name, row["answer"], row.get("steps"), row.get("notes"), flush=True)


if __name__ == "__main__":
    main()
