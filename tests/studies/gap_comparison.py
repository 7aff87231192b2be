"""Stepwise regression and sparse regression (PySINDy's STLSQ) on the flights of the gap benchmark.

Run: python -m tests.studies.gap_comparison [--kind effects|nulls|unknown] [--start N] [--count N] [--size S] [--nulls N]
Sum up: python -m tests.studies.gap_comparison --summary [--workflow ROWS_OF_GAP_BENCHMARK ...]

Both see the three training flights of each set, pooled, and a library with every form of every effect of the catalogue
(`gap_regression.library`) in five equations of equation error (`gap_regression.equations`). Each answers by its own rule
and with every coefficient standardised on simulated nulls of these very flights, with a family-wise 95 % threshold.
Which way of differentiating, form of the library, ridge and threshold is best is chosen afterwards, with the answers
known: no user could, and the figures are the highest the method reaches here.
"""

import argparse
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import f as f_law

from estimation.aircraft import load_aircraft
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import cases, flights, read_rows, requests, same_class, wilson
from tests.studies.gap_regression.equations import Way, evidence
from tests.studies.gap_regression.fake_flights import fake_flights, signals
from tests.studies.gap_regression.selection import Regression, stepwise, stepwise_on_nulls, stlsq, stlsq_on_nulls

WAYS = (Way("savgol", 9), Way("weak", 9), Way("weak", 15), Way("weak", 25))
SLOW = (
    ("weak 15", "apart"),
    ("weak 15", "joint"),
)  # what STLSQ on nulls is tried with: it takes as long as everything else
NULL_RIDGES = (0.05, 2.0)
F_LIMIT = float(f_law.isf(0.01, 1, 9000))  # partial F at 1 %, some 1800 samples in each of five equations
ALARMS = 0.05  # share of flights with nothing hidden that a calm variant may give a name


def answers(training: Sequence[Flight], nulls: int) -> dict[str, list[Any]]:
    """`way|form|rule` -> effect and margin: named where the margin is 1 or more."""
    constants = load_model("lateral", load_aircraft("cdfp")).constants
    sets = [[signals(f, constants) for f in training], *fake_flights(training, constants, nulls, seed=1)]
    found = [evidence(s, WAYS) for s in sets]
    samples = sum(f.time.size for f in training)
    named: dict[str, list[Any]] = {}
    for way in WAYS:
        grams = np.stack([e[way.name] for e in found])
        for form, regression in (
            ("joint", Regression.joint(grams, samples)),
            ("apart", Regression.apart(grams, samples)),
        ):
            head = f"{way.name}|{form}"
            first = stepwise(regression)
            named[f"{head}|stepwise"] = [first.effect, first.margin / F_LIMIT]
            for rule, effect in stlsq(regression).items():
                named[f"{head}|STLSQ, {rule}"] = [effect, 1.0 if effect else 0.0]
            for rule, answer in stepwise_on_nulls(regression).items():
                named[f"{head}|stepwise on nulls, largest {rule}"] = [answer.effect, answer.margin]
            for ridge in NULL_RIDGES if (way.name, form) in SLOW else ():
                answer = stlsq_on_nulls(regression, ridge)
                named[f"{head}|STLSQ on nulls, ridge {ridge:g}"] = [answer.effect, answer.margin]
    return named


def run(kind: str, size: float, start: int, count: int, gust: float, nulls: int, out: Path) -> None:
    """Fly and analyse all cases that `out` does not have yet; one JSON line each."""
    out.parent.mkdir(parents=True, exist_ok=True)
    done = {(r["label"], r["seed"], r["size"]) for r in read_rows(out)} if out.exists() else set()
    for label, effects, seed in cases(kind, size, start, count):
        if (label, seed, size) in done:
            continue
        three = flights(truth.fly(requests(effects, seed, gust, "rich")))[:3]
        row = {"kind": kind, "label": label, "truth": list(effects), "seed": seed, "size": size, "gust": gust,
               "nulls": nulls, "named": answers(three, nulls)}  # fmt: skip
        with out.open("a", encoding="utf-8") as handle:
            handle.write(json.dumps(row) + "\n")
        print(label, seed, row["named"]["weak 15|joint|stepwise on nulls, largest partial F"], flush=True)


@dataclass(frozen=True)
class Variant:
    """A method as it is scored: where its answers are, and from which margin on they count."""

    key: str
    limit: float = 1.0

    def named(self, row: Mapping[str, Any]) -> str:
        effect, margin = row["named"][self.key]
        return str(effect) if margin >= self.limit else ""


@dataclass(frozen=True)
class Score:
    """Hits of: exact, in class (of flights with one effect); given a name (of those with none; of those with one the
    catalogue does not hold)."""

    exact: int
    close: int
    hidden: int
    alarms: int
    calm: int
    misnamed: int
    unknown: int

    def cells(self) -> str:
        pairs = (
            (self.exact, self.hidden),
            (self.close, self.hidden),
            (self.alarms, self.calm),
            (self.misnamed, self.unknown),
        )
        return " | ".join(wilson(*pair) for pair in pairs)


def score(rows: Iterable[Mapping[str, Any]], named: Mapping[int, str]) -> Score:
    """named: what a method says, by position of the row."""
    parts: dict[str, list[tuple[str, str]]] = {"effects": [], "nulls": [], "unknown": []}
    for i, row in enumerate(rows):
        parts[row["kind"]].append((named[i], row["label"]))
    one, none, other = parts["effects"], parts["nulls"], parts["unknown"]
    return Score(
        sum(n == t for n, t in one),
        sum(bool(n) and same_class(n, t) for n, t in one),
        len(one),
        sum(bool(n) for n, _ in none),
        len(none),
        sum(bool(n) for n, _ in other),
        len(other),
    )


def scored(rows: Sequence[Mapping[str, Any]], variant: Variant) -> Score:
    return score(rows, {i: variant.named(r) for i, r in enumerate(rows)})


def best(rows: Sequence[Mapping[str, Any]], variants: Iterable[Variant], calm: bool = False) -> Variant | None:
    """The one that names most effects exactly, then in class, then with fewest alarms. calm: of those without too many."""
    found = [(v, scored(rows, v)) for v in variants]
    found = [(v, s) for v, s in found if not calm or s.alarms <= ALARMS * s.calm]

    def merit(pair: tuple[Variant, Score]) -> tuple[int, int, int, int]:
        return pair[1].exact, pair[1].close, -pair[1].alarms, -pair[1].misnamed

    return max(found, key=merit)[0] if found else None


def quiet_limit(rows: Sequence[Mapping[str, Any]], key: str) -> float:
    """The margin above which at most the allowed share of flights with nothing hidden gets a name."""
    margins = sorted((r["named"][key][1] for r in rows if r["kind"] == "nulls"), reverse=True)
    allowed = int(ALARMS * len(margins))
    return float(np.nextafter(margins[allowed], np.inf)) if len(margins) > allowed else 1.0


METHODS = {  # words -> how its rules begin
    "stepwise, partial F at 1 %": "stepwise",
    "STLSQ": "STLSQ, ",
    "stepwise, standardised on nulls": "stepwise on nulls, ",
    "STLSQ, standardised on nulls": "STLSQ on nulls, ",
}


def table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Lines of the comparison: each method at its best with either form of the library, and with few false alarms."""
    lines = []
    for method, start in METHODS.items():
        own = [k for k in rows[0]["named"] if _rule(k) == start or (start != "stepwise" and _rule(k).startswith(start))]
        for words, variant in (
            ("a coefficient for each equation", best(rows, [Variant(k) for k in own if "|apart|" in k])),
            ("one coefficient", best(rows, [Variant(k) for k in own if "|joint|" in k])),
            ("with few false alarms", best(rows, _quiet(rows, own), calm=True)),
        ):
            if variant is not None:
                way, form, rule = variant.key.split("|")
                limit = "" if variant.limit == 1.0 else f", limit x {variant.limit:.2f}"
                lines.append(f"| {method}, {words} ({way}, {form}, {rule}{limit}) | {scored(rows, variant).cells()} |")
    return lines


def _rule(key: str) -> str:
    return key.split("|")[2]


def _quiet(rows: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> list[Variant]:
    return [Variant(k, max(1.0, quiet_limit(rows, k))) for k in keys]


def workflow_line(rows: Sequence[Mapping[str, Any]], paths: Sequence[Path]) -> str:
    """The gap workflow on those of the same flights that it has answered for. paths: rows of `gap_benchmark`."""
    told = {}
    for path in paths:
        told |= {(r["label"], r["seed"], r["size"]): r for r in read_rows(path)}
    same = [r for r in rows if (r["label"], r["seed"], r["size"]) in told]
    named = {}
    for i, r in enumerate(same):
        steps = [s["effect"] for s in told[(r["label"], r["seed"], r["size"])]["steps"]]
        if r["kind"] == "unknown":
            steps = [s for s in steps if s != "unknown"]
        named[i] = steps[0] if steps else ""
    return f"| this workflow | {score(same, named).cells()} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--kind", default="effects")
    parser.add_argument("--size", type=float, default=1.0)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--gust", type=float, default=0.15)
    parser.add_argument("--nulls", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path("build/gap_comparison.jsonl"))
    parser.add_argument("--summary", action="store_true")
    parser.add_argument(
        "--workflow", type=Path, nargs="*", default=[], help="rows of gap_benchmark on the same flights"
    )
    a = parser.parse_args()
    if not a.summary:
        if find_spec("pysindy") is None:
            sys.exit("this study needs PySINDy: pip install -c constraints.txt '.[study]'")
        run(a.kind, a.size, a.start, a.count, a.gust, a.nulls, a.out)
    rows = read_rows(a.out)
    lines = [
        "| method | exact | in class | false alarms | unknown effect given a name |",
        "|---|---|---|---|---|",
        *table(rows),
    ]
    print("\n".join([*lines, *([workflow_line(rows, a.workflow)] if a.workflow else [])]))


if __name__ == "__main__":
    main()
