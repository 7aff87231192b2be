"""What the gap workflow answers where one criterion is 0.7 or 1.4 times its value, on flights of the second truth.

`python -m tests.studies.gap_sensitivity [--criteria NAME ...] [--sets KIND:LABEL:SEED[:MODEL] ...] [--nulls N]
[--budget SECONDS]`: every set of flights is first answered as set, then with each criterion moved (whole numbers to the next
one at least; quantiles: what is beyond them times 0.7 and 1.4). One JSON line per answer, appended as it comes; what is in the
file is not run again, so the study can be stopped and continued. `--summary` prints counts, `--write` puts them where
docs/gap-criteria.md is made from.
Kinds: null, effect, half, unknown, function. A set counts as right where nothing, the effect itself as the first name, an
unknown effect, or a shape and no name is the answer. Beside the answers two numbers tell what a move does before any answer
changes: the evidence of the first name (score over threshold), and the sizes of effects that would have been seen (geometric
mean over those in both answers).
"""

import argparse
import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from docs.generated_pages import SENSITIVITY
from estimation.gap.criteria import AS_SET, Criteria, Criterion
from estimation.gap.workflow import Options, run_gap
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import SUBJECTS, flights, requests
from tests.studies.nameless_truth import FUNCTIONS

FACTORS = (0.7, 1.4)
SMALL = 0.005  # a move of evidence or of sizes below it is none
KINDS = {"null": 0.0, "effect": 1.0, "half": 0.5, "unknown": 1.0, "function": 0.0}
SETS = (
    "null:none:9401",
    "half:aileron_delay:401004",
    "unknown:stale_vane:401006",
    "function:CY dead band in beta:9410",
    "half:alpha_lag:401009:longitudinal",
)


@dataclass(frozen=True)
class Case:
    """One set of flights and one criterion at one factor ("" and 1: as set)."""

    flights: str
    criterion: str
    factor: float


def cases(sets: Sequence[str], chosen: Sequence[str]) -> Iterator[Case]:
    """Criterion after criterion, so that a study cut short has whole rows."""
    for name, factor in (("", 1.0), *((name, factor) for name in chosen for factor in FACTORS)):
        for one in sets:
            yield Case(one, name, factor)


def criteria_with(case: Case) -> Criteria:
    """The record with one criterion moved."""
    if not case.criterion:
        return AS_SET
    known = next(c for c in AS_SET.described() if c.name == case.criterion)
    return replace(AS_SET, **{case.criterion: moved(known, case.factor)})


def moved(criterion: Criterion, factor: float) -> float:
    """Its value times a factor; a whole number goes to the next one at least, a quantile by what is beyond it."""
    if isinstance(criterion.value, int):
        return max(math.floor(factor * criterion.value), 1) if factor < 1.0 else math.ceil(factor * criterion.value)
    if criterion.unit.startswith("quantile of"):
        return 1.0 - (1.0 - criterion.value) * factor
    return factor * criterion.value


def answered(case: Case, nulls: int) -> dict[str, Any]:
    """One run of the workflow, as a row of the file."""
    kind, label, _, model = whole(case.flights)
    four = flown(case.flights)
    options = Options(seed=1, nulls=nulls, criteria=criteria_with(case))
    result = run_gap(load_model(model, "cdfp"), four[:3], four[3:], options=options)
    named = [s.effect for s in result.steps]
    first = next((s for s in result.steps if s.effect != "unknown"), None)
    return {
        "flights": case.flights,
        "criterion": case.criterion,
        "factor": case.factor,
        "nulls": nulls,
        "verdict": result.verdict.value,
        "named": named,
        "right": right(kind, label, named, result.verdict.value),
        "evidence": None if first is None else round(first.score / first.threshold, 4),
        "seen": {n: float(f"{v:.4g}") for n, v in result.minimum_detectable.items() if v > 0.0},
    }


def whole(named: str) -> tuple[str, str, int, str]:
    """(kind, label, seed, model) of a set as the command line has it."""
    kind, label, seed, *model = named.split(":")
    return kind, label, int(seed), model[0] if model else "lateral"


@cache
def flown(named: str) -> list[Flight]:
    """Three flights to train on and one to hold out; flown once for all criteria."""
    kind, label, seed, model = whole(named)
    hidden = {label: KINDS[kind]} if KINDS[kind] else {}
    part = FUNCTIONS[label] if kind == "function" else None
    asked = requests(hidden, seed, 0.15, SUBJECTS[model][-1])
    return flights(truth.fly([replace(one, hidden=part) for one in asked]))


def right(kind: str, label: str, named: Sequence[str], verdict: str) -> bool:
    """Whether an answer is the one wanted."""
    if kind == "null":
        return not named
    if kind == "function":
        return list(named) == ["unknown"] and verdict == "gap_reduced"
    return verdict == "unknown_effect" if kind == "unknown" else named[:1] == [label]


def rows_of(path: Path) -> list[dict[str, Any]]:
    """What has been answered so far."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


def summed_up(rows: Sequence[dict[str, Any]]) -> dict[str, str]:
    """Criterion -> right answers at both factors beside those as set, of the same sets of flights, and what else changed."""
    as_set = {r["flights"]: r for r in rows if not r["criterion"]}
    told = {}
    for name in dict.fromkeys(r["criterion"] for r in rows if r["criterion"]):
        parts = []
        for factor in FACTORS:
            pairs = [
                (r, as_set[r["flights"]])
                for r in rows
                if r["criterion"] == name and r["factor"] == factor and r["flights"] in as_set
            ]
            if pairs:
                now, before = sum(r["right"] for r, _ in pairs), sum(b["right"] for _, b in pairs)
                other = sum((r["verdict"], r["named"]) != (b["verdict"], b["named"]) for r, b in pairs)
                counted = f"{factor:g}: {now} right of {len(pairs)} sets (as set {before}), {other} answers other"
                parts.append(counted + "".join(_moves(pairs)))
        if parts:
            told[name] = "; ".join(parts)
    return told


def _moves(pairs: Sequence[tuple[dict[str, Any], dict[str, Any]]]) -> Iterator[str]:
    """What moved without changing an answer: evidence of the first name, sizes that would be seen; nothing where none did."""
    both = [(r, b) for r, b in pairs if r["named"][:1] == b["named"][:1]]
    evidence = [r["evidence"] / b["evidence"] for r, b in both if r.get("evidence") and b.get("evidence")]
    seen = [
        math.exp(sum(math.log(r["seen"][n] / b["seen"][n]) for n in common) / len(common))
        for r, b in pairs
        if (common := r.get("seen", {}).keys() & b.get("seen", {}).keys())
    ]
    for what, ratios in (("evidence", evidence), ("sizes seen", seen)):
        if ratios and max(abs(x - 1.0) for x in ratios) >= SMALL:
            yield f", {what} x {min(ratios):.2f} to {max(ratios):.2f}"


def main() -> None:
    """Answer, append, sum up."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--criteria", nargs="*", default=[c.name for c in AS_SET.described()])
    parser.add_argument("--sets", nargs="*", default=SETS)
    parser.add_argument("--nulls", type=int, default=100)
    parser.add_argument("--budget", type=float, default=math.inf, help="begin no further run after so many seconds")
    parser.add_argument("--out", type=Path, default=Path("build/gap_sensitivity.jsonl"))
    parser.add_argument("--summary", action="store_true")
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    done = {(r["flights"], r["criterion"], r["factor"]) for r in rows_of(given.out)}
    given.out.parent.mkdir(parents=True, exist_ok=True)
    begun = time.monotonic()
    for case in () if given.summary or given.write else cases(given.sets, given.criteria):
        if (case.flights, case.criterion, case.factor) in done:
            continue
        if time.monotonic() - begun > given.budget:
            break
        row = answered(case, given.nulls)
        with given.out.open("a", encoding="utf-8") as handle:
            handle.write(json.dumps(row) + "\n")
        print(row, flush=True)
    told = summed_up(rows_of(given.out))
    for name, words in told.items():
        print(f"{name:30s} {words}")
    if given.write:
        SENSITIVITY.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
