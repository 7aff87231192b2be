"""False answers of the gap workflow by kind of flight: what is named where nothing is hidden, and what is found beside it.

Run: python -m tests.studies.gap_nulls [--model lateral|longitudinal|six-dof] [--kinds NAME ...] [--seeds N] [--start N]
    [--hidden EFFECT ... --size S] [--nulls N] [--out FILE] [--table]
Each set is three flights and one held out of an aircraft of its own. Results are appended to a JSON-lines file as they come;
`--table` prints it by kind. With `--hidden` the same flights of the fourth simulator have that effect.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from estimation.errors import GapError
from estimation.gap.effects import catalogue
from estimation.gap.workflow import Options, run_gap
from estimation.models.base import Model
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import fourth_simulator as fourth
from tests.studies import jsbsim_flights as jsb
from tests.studies import second_truth
from tests.studies.gap_benchmark import SPEEDS, SUBJECTS, flights, outcome, read_rows, requests, same_class, wilson
from tests.studies.gap_through_chain import SUBJECTS as OWN
from tests.studies.gap_through_chain import direct
from tests.studies.own_simulation import SPEEDS as JSBSIM_SPEEDS

Flown = tuple[Model, Sequence[Flight], Sequence[Flight]]
SURFACES, VANES = ("delta_e", "delta_a", "delta_r"), ("alpha", "beta")
RATES = ("p", "q", "r", "ax", "ay", "az")
GUST = 0.3 * fourth.DEG


def _times(names: Sequence[str], factor: float) -> tuple[tuple[str, float], ...]:
    return tuple((n, factor) for n in names)


FOURTH: Mapping[str, fourth.Kind] = {
    "usual": fourth.Kind(),
    "gusty": fourth.Kind(gust=GUST),
    "gusts three times": fourth.Kind(gust=3.0 * GUST),
    "no feedback": fourth.Kind(hold=(0.0, 0.0), level=(0.0, 0.0)),
    "feedback twice": fourth.Kind(hold=(0.5, 0.1), level=(0.2, 0.04)),
    "surfaces' noise a tenth": fourth.Kind(noise=_times(SURFACES, 0.1)),
    "surfaces' noise three times": fourth.Kind(noise=_times(SURFACES, 3.0)),
    "vanes' noise a tenth": fourth.Kind(noise=_times(VANES, 0.1)),
    "vanes' noise three times": fourth.Kind(noise=_times(VANES, 3.0)),
    "rates' noise a tenth": fourth.Kind(noise=_times(RATES, 0.1)),
    "rates' noise three times": fourth.Kind(noise=_times(RATES, 3.0)),
    "quantised": fourth.Kind(quantised=True),
    "slow servo": fourth.Kind(fastest=0.35),
    "50 Hz": fourth.Kind(rate=50),
    "50 Hz, gusty": fourth.Kind(rate=50, gust=GUST),
    "100 Hz": fourth.Kind(rate=100),
    "attitude at 10 Hz, held": fourth.Kind(attitude="held"),
    "attitude at 10 Hz, lines": fourth.Kind(attitude="lines"),
    "attitude at 10 Hz, gusty": fourth.Kind(attitude="held", gust=GUST),
    "attitude at 10 Hz of 50": fourth.Kind(rate=50, attitude="held"),
    "multisine": fourth.Kind(course="multisine"),
    "multisine, surfaces without noise": fourth.Kind(course="multisine", noise=_times(SURFACES, 0.0)),
    "sweep": fourth.Kind(course="sweep"),
    "random steps": fourth.Kind(course="random steps"),
    "random steps off the clock": fourth.Kind(course="steps off the clock"),
    "spikes": fourth.Kind(spikes=3),
    "heavy tails": fourth.Kind(tails=0.7),
    "surfaces in steps of 0.35 deg": fourth.Kind(pots=0.35 * fourth.DEG),
    "surfaces in steps of 0.57 deg": fourth.Kind(pots=0.57 * fourth.DEG),
    "surfaces in steps of 0.35 deg, 50 Hz": fourth.Kind(rate=50, pots=0.35 * fourth.DEG),
    "10 Hz": fourth.Kind(rate=10),
    "flights of 15 s": fourth.Kind(duration=15.0),
    "flights of 60 s": fourth.Kind(duration=60.0),
}


def _fourth(kind: fourth.Kind) -> Callable[[str, int], Flown]:
    def fly(model: str, seed: int) -> Flown:
        flown = fourth.fly(seed, replace(kind, axes=model), SPEEDS)
        return load_model(model, "cdfp"), flown[:3], flown[3:]

    return fly


def _second(gust: float) -> Callable[[str, int], Flown]:
    def fly(model: str, seed: int) -> Flown:
        flown = flights(second_truth.fly(requests({}, seed, gust, SUBJECTS[model][-1])))
        return load_model(model, "cdfp"), flown[:3], flown[3:]

    return fly


def _own(gust: float) -> Callable[[str, int], Flown]:
    def fly(model: str, seed: int) -> Flown:
        flown = direct((), seed, gust, OWN[model][1])
        return load_model(model, "cdfp"), flown[:3], flown[3:]

    return fly


def _jsbsim(integrator: int | None) -> Callable[[str, int], Flown]:
    def fly(model: str, seed: int) -> Flown:
        from estimation.simulation.attach import attach

        with tempfile.TemporaryDirectory() as folder:
            file = jsb.changed(Path(folder), "c172p", str)
            asked = [
                jsb.Flown(file, 100 * seed + i, speed, integrator=integrator) for i, speed in enumerate(JSBSIM_SPEEDS)
            ]
            flown = [jsb.flight(f, f"f{i}") for i, f in enumerate(asked)]
        attached = attach("jsbsim:c172p", model, flown)
        return attached.model, attached.training(3), attached.holdout(3)

    return fly


KINDS: Mapping[str, Callable[[str, int], Flown]] = {
    **{f"fourth: {name}": _fourth(kind) for name, kind in FOURTH.items()},
    "second truth": _second(0.0),
    "second truth: gusty": _second(0.15),
    "own simulator": _own(0.0),
    "own simulator: gusty": _own(0.15),
    "JSBSim: as it is set": _jsbsim(None),
    "JSBSim: Euler": _jsbsim(1),
    "JSBSim: trapezoid": _jsbsim(2),
    "JSBSim: Adams-Bashforth": _jsbsim(3),
}
"""Kind of flights -> flown for a model and a seed."""


def ask(kind: str, model: str, seed: int, nulls: int, hidden: str = "", size: float = 0.0) -> dict[str, Any]:
    """One set flown and asked; what is kept of the answer."""
    if hidden:
        flown = _fourth(replace(FOURTH[kind.removeprefix("fourth: ")], hidden=((hidden, size),)))
    else:
        flown = KINDS[kind]
    base, training, holdout = flown(model, seed)
    begun = time.process_time()
    row = {"source": kind, "model": model, "seed": seed, "hidden": hidden, "size": size}
    try:
        result = run_gap(base, training, holdout, catalogue(model=base), Options(seed=1, nulls=nulls))
    except GapError as error:
        return {**row, "verdict": "error", "steps": [], "why": str(error)}
    return {**row, "seconds": round(time.process_time() - begun, 1), **outcome(result)}


def one_line(row: Mapping[str, Any]) -> str:
    """A row as a line of the log."""
    steps = [f"{s['effect']} {s['score']}/{s['threshold']} held {s['held']}" for s in row["steps"]]
    rest = row.get("why") or f"{row['left']} {row['left_what'][:1]}"
    label = f"{row['hidden']}*{row['size']:g}" if row["hidden"] else ""
    said = ", ".join(steps)
    return f"{row['source']:32s} {row['model']} {row['seed']} {label} {row['verdict']} {said} | {rest} {row.get('seconds')}s"


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Nothing hidden: false answers by kind and model; something hidden: found, exact and in class by size."""
    models = [m for m in SUBJECTS if any(r["model"] == m and not r["hidden"] for r in rows)]
    lines = [f"| nothing hidden | {' | '.join(models)} |", "|---" * (len(models) + 1) + "|"]
    for kind in dict.fromkeys(r["source"] for r in rows if not r["hidden"]):
        cells = [_false([r for r in rows if (r["source"], r["model"], r["hidden"]) == (kind, m, "")]) for m in models]
        lines.append(f"| {kind} | {' | '.join(cells)} |")
    totals = [[r for r in rows if r["model"] == m and not r["hidden"]] for m in models]
    lines.append(f"| all | {' | '.join(wilson(sum(map(_is_false, t)), len(t)) for t in totals)} |")
    for size in sorted({r["size"] for r in rows if r["hidden"]}, reverse=True):
        part = [r for r in rows if r["hidden"] and r["size"] == size]
        first = [(r["hidden"], r["steps"][0]["effect"] if r["steps"] else "") for r in part]
        lines += [
            "", f"size {size:g}: detected {wilson(sum(bool(n) for _, n in first), len(part))},"
            f" exact {wilson(sum(n == h for h, n in first), len(part))},"
            f" class {wilson(sum(same_class(n, h) for h, n in first), len(part))},"
            f" more than one name {wilson(sum(len(r['steps']) > 1 for r in part), len(part))}",
        ]  # fmt: skip
    return "\n".join(lines)


def _is_false(row: Mapping[str, Any]) -> bool:
    return bool(row["steps"]) or row["verdict"] not in ("no_gap", "cannot_tell")


def _false(rows: Sequence[Mapping[str, Any]]) -> str:
    named = [s["effect"] for r in rows for s in r["steps"]]
    named += [r["verdict"] for r in rows if _is_false(r) and not r["steps"]]
    return f"{sum(map(_is_false, rows))} of {len(rows)}" + (f" ({', '.join(named)})" if named else "") if rows else ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="longitudinal", choices=SUBJECTS)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--start", type=int, default=1)
    parser.add_argument("--hidden", nargs="*", default=[""])
    parser.add_argument("--size", type=float, default=1.0)
    parser.add_argument("--nulls", type=int, default=60)
    parser.add_argument("--out", type=Path, default=Path("build/gap_nulls.jsonl"))
    parser.add_argument("--table", action="store_true")
    given = parser.parse_args()
    given.out.parent.mkdir(parents=True, exist_ok=True)
    for seed in range(given.start, given.start + given.seeds) if not given.table else ():
        for kind in given.kinds:
            for hidden in given.hidden:
                row = ask(kind, given.model, seed, given.nulls, hidden, given.size if hidden else 0.0)
                with given.out.open("a", encoding="utf-8") as handle:
                    handle.write(json.dumps(row) + "\n")
                print(one_line(row), flush=True)
    print(table(read_rows(given.out)))


if __name__ == "__main__":
    main()
