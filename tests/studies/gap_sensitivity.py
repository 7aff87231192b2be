"""What the gap workflow answers where one criterion is 0.7 or 1.4 times its value.

`python -m tests.studies.gap_sensitivity [--criteria NAME ...] [--sets KIND:LABEL:SEED[:MODEL] ...] [--nulls N]
[--budget SECONDS]`: every set of flights is first answered as set, then with each criterion moved (whole numbers to the next
one at least; quantiles: what is beyond them times 0.7 and 1.4). One JSON line per answer, appended as it comes; what is in the
file is not run again, so the study can be stopped and continued. `--summary` prints counts, `--write` puts them where
docs/gap-criteria.md is made from.
Kinds: null (label: a kind of flights of `gap_nulls`); effect, half, unknown, function (flights of the second truth). A set
counts as right where nothing, the effect itself as the first name, an unknown effect, or a shape and no name is the answer.
Beside the answers three numbers tell what a move does before any answer changes: the evidence of the first name (score over
threshold), how near the best name or nameless signal that is left comes to its threshold, and the sizes of effects that would
have been seen (geometric mean over those in both answers).
"""

import argparse
import json
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from docs.generated_pages import SENSITIVITY
from estimation.gap.criteria import AS_SET, Criteria, Criterion
from estimation.gap.workflow import Options, run_gap
from estimation.models.load import load_model
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import SUBJECTS, flights, requests
from tests.studies.gap_nulls import KINDS, Flown
from tests.studies.nameless_truth import FUNCTIONS

FACTORS = (0.7, 1.4)
SIZES = {"null": 0.0, "effect": 1.0, "half": 0.5, "unknown": 1.0, "function": 0.0}
SETS = (
    "null:fourth: attitude at 10 Hz, held:9402",
    "null:fourth: surfaces' noise three times:9404:longitudinal",
    "null:own simulator: gusty:9406:longitudinal",
    "half:aileron_delay:401004",
    "half:alpha_lag:401009:longitudinal",
    "unknown:stale_vane:401006",
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
    kind, label, _, _ = whole(case.flights)
    base, training, holdout = flown(case.flights)
    result = run_gap(base, training, holdout, options=Options(seed=1, nulls=nulls, criteria=criteria_with(case)))
    named = [s.effect for s in result.steps]
    first = next((s for s in result.steps if s.effect != "unknown"), None)
    left, limit = result.details["left"], result.details["left_threshold"]
    near = max(result.scores.values(), default=0.0) / result.threshold, left[0]["score"] / limit if left else 0.0
    return {
        "flights": case.flights,
        "criterion": case.criterion,
        "factor": case.factor,
        "nulls": nulls,
        "verdict": result.verdict.value,
        "named": named,
        "right": right(kind, label, named, result.verdict.value),
        "evidence": None if first is None else round(first.score / first.threshold, 4),
        "near": round(float(max(near)), 4),
        "seen": {n: float(f"{v:.4g}") for n, v in result.minimum_detectable.items() if v > 0.0},
    }


def whole(named: str) -> tuple[str, str, int, str]:
    """(kind, label, seed, model) of a set as the command line has it."""
    kind, rest = named.split(":", 1)
    rest, model = rest.rsplit(":", 1) if rest.rsplit(":", 1)[-1] in SUBJECTS else (rest, "lateral")
    label, seed = rest.rsplit(":", 1)
    return kind, label, int(seed), model


@cache
def flown(named: str) -> Flown:
    """The base, three flights to train on and one to hold out; flown once for all criteria."""
    kind, label, seed, model = whole(named)
    if kind == "null":
        return KINDS[label](model, seed)
    hidden = {label: SIZES[kind]} if SIZES[kind] else {}
    part = FUNCTIONS[label] if kind == "function" else None
    asked = requests(hidden, seed, 0.15, SUBJECTS[model][-1])
    four = flights(truth.fly([replace(one, hidden=part) for one in asked]))
    return load_model(model, "cdfp"), four[:3], four[3:]


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


def summed_up(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Criterion -> `sets` asked at both factors, and at each factor how many answers `changed`, how many right ones were `lost`,
    and by which share the deciding numbers `moved` at most."""
    as_set = {r["flights"]: r for r in rows if not r["criterion"]}
    found = {}
    for name in dict.fromkeys(r["criterion"] for r in rows if r["criterion"]):
        moves = [
            {r["flights"]: (r, as_set[r["flights"]]) for r in rows if (r["criterion"], r["factor"]) == (name, factor)}
            for factor in FACTORS
        ]
        both = [[move[f] for f in as_set if all(f in m for m in moves)] for move in moves]
        if both[0]:
            found[name] = {
                "sets": len(both[0]),
                "changed": [sum((r["verdict"], r["named"]) != (b["verdict"], b["named"]) for r, b in m) for m in both],
                "lost": [sum(b["right"] and not r["right"] for r, b in m) for m in both],
                "moved": [round(max(share for r, b in m for share in _moves(r, b)), 3) for m in both],
            }
    return found


def _moves(row: Mapping[str, Any], as_set: Mapping[str, Any]) -> Iterator[float]:
    """By which share evidence of the same first name, the nearest name or signal, and the sizes that would be seen moved."""
    seen, before = row["seen"], as_set["seen"]
    common = seen.keys() & before.keys()
    yield abs(math.exp(sum(math.log(seen[n] / before[n]) for n in common) / len(common)) - 1.0) if common else 0.0
    yield abs(row["near"] / as_set["near"] - 1.0) if as_set["near"] > 0.0 else 0.0
    if row["named"][:1] == as_set["named"][:1] and row["evidence"] and as_set["evidence"]:
        yield abs(row["evidence"] / as_set["evidence"] - 1.0)


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
    found = summed_up(rows_of(given.out))
    for name, counts in found.items():
        print(f"{name:30s} {counts}")
    if given.write:
        lines = (f' "{name}": {json.dumps(counts)}' for name, counts in found.items())
        SENSITIVITY.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
