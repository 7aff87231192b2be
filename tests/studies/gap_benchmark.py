"""Scores of the gap workflow on flights of the second truth, with hidden effects it is not told of.

Run: python -m tests.studies.gap_benchmark [--kind nulls|effects|unknown|pairs|all] [--start N] [--count N] [--size S]
    [--gust DEG] [--nulls N] [--model lateral|longitudinal|six-dof]
Results are appended to a JSON-lines file as they come, so that a study can be stopped, continued and summed up
(`--summary`, `--confusion PICTURE`).
Scores: detected, exact (first name), in class, truth in the reported set, mean set size, false alarms,
unknown recall, pairs complete, held-out gap closed, calibration of the stated confidence; Wilson intervals.
"""

import argparse
import json
import math
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from daq.utilities.errors import UserError
from estimation.gap.answer.result import GapResult
from estimation.gap.criteria import AS_SET
from estimation.gap.effects.catalogue import plane
from estimation.gap.significance.screen import one_sided
from estimation.gap.workflow import Options, run_gap
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import second_truth as truth

SPEEDS = (14.5, 16.5, 19.0, 17.0)
# effects that share a signature in these flights (|cos| > 0.9) or a family in the catalogue
CLASSES: tuple[frozenset[str], ...] = (
    frozenset({"Cn_da", "Ixz_error"}),
    frozenset({"CY_da", "imu_lever_arm"}),
    frozenset({"beta_lag", "time_skew", "vane_position"}),
    frozenset({"attitude_lag", "time_skew"}),
    frozenset(
        {"airspeed_scale", "V_scale"}
    ),  # one error under two names: V is an input of `lateral`, an output of `six-dof`
    frozenset({"aileron_delay", "aileron_lag", "Cl_betadot"}),
    frozenset({"rudder_delay", "rudder_lag"}),
    frozenset({"servo_delay", "servo_lag", "time_skew"}),
    frozenset({"Cl_da3", "aileron_deadzone", "Cl_p_abs_p", "aileron_backlash"}),
    frozenset({"surface_compliance", "Cl_da_de"}),
    frozenset({"motor_torque", "p_factor", "lateral_cg"}),
    frozenset({"Cl_beta3", "Cn_beta3", "CY_beta3"}),
    # the pitching plane
    frozenset({"thrust_z", "thrust_tilt", "propwash_CL"}),
    frozenset({"thrust_scale", "mass_error"}),
    frozenset({"CL_alphadot", "Cm_alphadot", "downwash_lag"}),
    frozenset({"CL_alpha2", "Cm_alpha2"}),
    frozenset({"CL_alpha3", "Cm_alpha3"}),
    frozenset({"Cm_alpha2", "Cm_alpha_de"}),
    frozenset({"CL_de3", "Cm_de3"}),
    frozenset({"elevator_delay", "elevator_lag"}),
    frozenset({"alpha_scale", "alpha_bias"}),
)
PAIRS = (
    ("Cn_da", "beta_lag"), ("Cl_beta3", "aileron_delay"), ("beta_scale", "CY_da"), ("Cn_da", "Cl_beta3"),
    ("rudder_delay", "imu_lever_arm"), ("attitude_lag", "Cn_beta3"), ("beta_lag", "aileron_lag"), ("gyro_scale", "Cn_da"),
    ("vane_position", "Cl_da3"), ("Ixz_error", "CY_beta3"), ("Cl_alpha_beta", "rudder_lag"), ("prop_gyroscopic", "beta_scale"),
)  # fmt: skip
PITCH_PAIRS = (
    ("Cm_alphadot", "alpha_scale"),
    ("thrust_scale", "elevator_delay"),
    ("propwash_elevator", "imu_x"),
    ("CL_alpha2", "V_scale"),
)
CROSS_PAIRS = (("Cm_beta2", "Cn_da"), ("alpha_scale", "beta_lag"))
INVISIBLE = ("stall_separation",)  # these flights do not come near the stall
SUBJECTS: dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[tuple[str, str], ...], str]] = {
    "lateral": (tuple(n for n in truth.TYPICAL if n not in INVISIBLE), truth.UNKNOWN, PAIRS, "rich"),
    "longitudinal": (tuple(truth.pitch.PITCH), truth.pitch.PITCH_UNKNOWN, PITCH_PAIRS, "longitudinal"),
    "six-dof": (
        tuple(n for n in truth.EVERY if n not in INVISIBLE),
        (*truth.UNKNOWN, *truth.pitch.PITCH_UNKNOWN),
        (*CROSS_PAIRS, *PITCH_PAIRS, *PAIRS),
        "all",
    ),
}
"""Model -> effects, effects outside the catalogue, pairs, manoeuvres."""
ONE_SIDED = frozenset(
    e.name
    for e in (*plane("lateral"), *plane("longitudinal"), *plane("across_axes"))
    if e.forms
    and all(not isinstance(p.none, str) and one_sided(p, p.none, AS_SET) for f in e.forms for p in f.parameters)
)
"""Effects that nature makes of one sign only."""


def requests(effects: dict[str, float], seed: int, gust: float, manoeuvres: str) -> list[truth.Request]:
    """Three training flights and one to hold out, of one aircraft with derivatives off by up to 15 %."""
    derivatives = truth.perturbed_derivatives(np.random.default_rng([seed, 7]))
    return [
        truth.Request(seed * 10 + i, SPEEDS[i], effects, gust * truth.DEG, manoeuvres, derivatives) for i in range(4)
    ]


def cases(
    kind: str, size: float, start: int, count: int, model: str = "lateral"
) -> list[tuple[str, dict[str, float], int]]:
    """(label, hidden effects as multiples of their typical size, seed)."""
    effects, unknown, pairs, _ = SUBJECTS[model]
    made: list[tuple[str, dict[str, float], int]] = []
    for k in range(start, start + count):
        if kind == "nulls":
            made.append(("none", {}, 9000 + k))
        elif kind == "effects":
            for i, name in enumerate(effects):
                if size > 0.0 or name not in ONE_SIDED:
                    made.append((name, {name: size}, 1000 * (k + 1) + i))
        elif kind == "unknown":
            made += [(n, {n: size}, 100000 + 1000 * k + i) for i, n in enumerate(unknown)]
        elif kind == "pairs":
            made += [("+".join(p), dict.fromkeys(p, size), 200000 + 1000 * k + i) for i, p in enumerate(pairs)]
    return made


def flights(columns: Iterable[dict[str, Any]]) -> list[Flight]:
    """Flight objects of simulated columns."""
    return [
        Flight.build(f"f{i}", c["time"], {k: v for k, v in c.items() if k != "time"}) for i, c in enumerate(columns)
    ]


def run(kind: str, size: float, start: int, count: int, gust: float, manoeuvres: str, nulls: int, out: Path,
        only: Sequence[str] = (), base: str = "lateral") -> None:  # fmt: skip
    """Fly and analyse all cases; one JSON line each."""
    chosen = [c for c in cases(kind, size, start, count, base) if not only or c[0] in only]
    model = load_model(base, "cdfp")
    out.parent.mkdir(parents=True, exist_ok=True)
    for at in range(0, len(chosen), 12):
        block = chosen[at : at + 12]
        flown = truth.fly([r for _, effects, seed in block for r in requests(effects, seed, gust, manoeuvres)])
        for i, (label, effects, seed) in enumerate(block):
            four = flights(flown[4 * i : 4 * i + 4])
            began = time.perf_counter()
            try:
                answer = outcome(run_gap(model, four[:3], four[3:], options=Options(seed=1, nulls=nulls)))
            except UserError as error:  # such as of an aircraft that departs with an effect this large
                answer = {**REFUSED, "rejected": [["", str(error)]]}
            seconds = round(time.perf_counter() - began, 1)
            row = {
                "kind": kind,
                "model": base,
                "label": label,
                "truth": list(effects),
                "size": size,
                "gust": gust,
                "manoeuvres": manoeuvres,
                "seed": seed,
                "seconds": seconds,
                **answer,
            }
            with out.open("a", encoding="utf-8") as handle:
                handle.write(json.dumps(row) + "\n")
            print(one_line(row), flush=True)


NOTHING: Mapping[str, Any] = {n: [] for n in ("steps", "left", "left_what", "rejected")}
REFUSED: Mapping[str, Any] = {**NOTHING, "verdict": "refused", "scores": {}, "cannot": 0}


def outcome(result: GapResult) -> dict[str, Any]:
    """What is kept of a result."""
    steps = [
        {
            "effect": s.effect,
            "form": s.form,
            "set": {m.effect: round(m.weight, 3) for m in s.members},
            "score": round(s.score, 2),
            "threshold": round(s.threshold, 2),
            "estimates": {n: v for n, (v, _) in s.estimates.items()},
            "bounds": {n: b for n, (_, b) in s.estimates.items()},
            "closed": s.gap.closed,
            "held": None if s.holdout is None else s.holdout.counted,
        }
        for s in result.steps
    ]
    left = result.details["left"]
    return {
        "verdict": result.verdict.value,
        "steps": steps,
        "scores": dict(list(result.scores.items())[:5]),
        "left": [x["score"] for x in left[:1]] + [result.details["left_threshold"]],
        "left_what": [f"{x['kind']} {x['place']}: {x['what']}" for x in left[:2]],
        "rejected": [[r.effect, r.why] for r in result.rejected if "too small" not in r.why][:8],
        "cannot": len(result.details["cannot_tell"]),
    }


def one_line(row: dict[str, Any]) -> str:
    """A row as a line of the log."""
    named = [s["effect"] for s in row["steps"]]
    mark = "ok " if good(row) else "-- "
    sets = " | ".join(
        ",".join(f"{k}:{v:.2f}" for k, v in s["set"].items()) + f" s{s['score']}/{s['threshold']} c{s['closed']:.2f}"
        for s in row["steps"]
    )
    rest = f"left {row['left']} {row['left_what'][:1]} {row['rejected'][:3]} cannot {row['cannot']} {row['seconds']}s"
    return f"{mark}{row['label']:22s} {row['verdict']:14s} {named} {sets} {rest}"


def good(row: dict[str, Any]) -> bool:
    named = [s["effect"] for s in row["steps"]]
    if row["kind"] == "nulls":
        return not named
    if row["kind"] == "unknown":
        return row["verdict"] == "unknown_effect"
    if row["kind"] == "pairs":
        return all(any(same_class(t, n) for n in named) for t in row["truth"])
    return bool(named) and named[0] == row["truth"][0]


def same_class(a: str, b: str) -> bool:
    """Whether two effects are one class."""
    return a == b or any(a in c and b in c for c in CLASSES)


def wilson(hits: int, count: int) -> str:
    """Share with its 95 % Wilson interval."""
    if count == 0:
        return "-"
    z, p = 1.96, hits / count
    centre = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = z * math.sqrt(p * (1 - p) / count + z * z / (4 * count * count)) / (1 + z * z / count)
    return f"{p:.2f} ({max(centre - half, 0):.2f}-{min(centre + half, 1):.2f}, n={count})"


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Results as they were kept, one JSON line each."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def summary(path: Path) -> str:
    """The table of scores as Markdown."""
    rows = read_rows(path)
    lines = ["| flights | score | value |", "|---|---|---|"]
    groups = sorted({(r["kind"], r["size"], r["gust"], r["manoeuvres"]) for r in rows})
    for kind, size, gust, manoeuvres in groups:
        part = [r for r in rows if (r["kind"], r["size"], r["gust"], r["manoeuvres"]) == (kind, size, gust, manoeuvres)]
        head = f"{kind}, size {size:g}, gusts {gust:g} deg, {manoeuvres}"
        for name, value in _scores(kind, part):
            lines.append(f"| {head} | {name} | {value} |")
    return "\n".join(lines)


def _scores(kind: str, part: Sequence[dict[str, Any]]) -> list[tuple[str, str]]:
    n = len(part)
    if kind == "nulls":
        return [("false alarms", wilson(sum(bool(r["steps"]) for r in part), n))]
    if kind == "unknown":
        return [("unknown recall", wilson(sum(r["verdict"] == "unknown_effect" for r in part), n))]
    if kind == "pairs":
        both = sum(all(any(t in s["set"] for s in r["steps"]) for t in r["truth"]) for r in part)
        return [("both named in class", wilson(sum(good(r) for r in part), n)), ("both in sets", wilson(both, n))]
    first = [r["steps"][0] if r["steps"] else None for r in part]
    sets = [len(s["set"]) for s in first if s and s["set"]]
    held = [s["held"] for s in first if s and s["held"] is not None]
    return [
        ("detected", wilson(sum(s is not None for s in first), n)),
        (
            "exact",
            wilson(sum(s is not None and s["effect"] == r["truth"][0] for s, r in zip(first, part, strict=True)), n),
        ),
        (
            "in class",
            wilson(
                sum(s is not None and same_class(s["effect"], r["truth"][0]) for s, r in zip(first, part, strict=True)),
                n,
            ),
        ),
        (
            "truth in set",
            wilson(sum(s is not None and r["truth"][0] in s["set"] for s, r in zip(first, part, strict=True)), n),
        ),
        ("mean set size", f"{np.mean(sets):.2f}" if sets else "-"),
        ("extra effects", wilson(sum(len(r["steps"]) > 1 for r in part), n)),
        ("held-out gap closed, median", f"{np.median(held):.2f}" if held else "-"),
    ]


def calibration(rows: Sequence[dict[str, Any]], edges: Sequence[float] = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.01)) -> str:
    """Stated weight of every member of every first set against how often that member was the truth, as Markdown."""
    pairs = [
        (weight, name == r["truth"][0])
        for r in rows
        if r["kind"] == "effects" and r["steps"]
        for name, weight in r["steps"][0]["set"].items()
    ]
    lines = ["| stated weight | members | mean stated | was the truth |", "|---|---|---|---|"]
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        inside = [(w, hit) for w, hit in pairs if low <= w < high]
        if inside:
            mean = np.mean([w for w, _ in inside])
            hits = wilson(sum(hit for _, hit in inside), len(inside))
            lines.append(f"| {low:g} to {min(high, 1):g} | {len(inside)} | {mean:.2f} | {hits} |")
    return "\n".join(lines)


def confusion(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Picture: weight given to each name (columns) by what was hidden (rows), mean over all flights with one effect."""
    from matplotlib.figure import Figure

    single = [r for r in rows if r["kind"] == "effects"]
    hidden = [n for n in truth.EVERY if any(r["label"] == n for r in single)]
    named = [*hidden, *sorted({n for r in single for s in r["steps"][:1] for n in s["set"]} - set(hidden)), "nothing"]
    table = np.zeros((len(hidden), len(named)))
    for k, name in enumerate(hidden):
        mine = [r for r in single if r["label"] == name]
        for r in mine:
            given = r["steps"][0]["set"] if r["steps"] else {}
            given = given or ({r["steps"][0]["effect"]: 1.0} if r["steps"] else {"nothing": 1.0})
            for other, weight in given.items():
                table[k, named.index(other) if other in named else -1] += weight / len(mine)
    figure = Figure(figsize=(11, 9.5), layout="constrained")
    axis = figure.subplots()
    picture = axis.imshow(table, cmap="Blues", vmin=0.0, vmax=1.0)
    axis.set_xticks(range(len(named)), named, rotation=90, fontsize=7)
    axis.set_yticks(range(len(hidden)), hidden, fontsize=7)
    axis.set_xlabel("weight given to")
    axis.set_ylabel("hidden")
    figure.colorbar(picture, ax=axis, shrink=0.6)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--kind", default="all", choices=("nulls", "effects", "unknown", "pairs", "all"))
    parser.add_argument("--size", type=float, default=1.0)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--gust", type=float, default=0.15)
    parser.add_argument("--model", default="lateral", choices=SUBJECTS)
    parser.add_argument(
        "--manoeuvres",
        help="rich, aileron_only, longitudinal or all, these two also with -advised; default: by the model",
    )
    parser.add_argument("--nulls", type=int, default=100)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--out", type=Path, default=Path("build/gap_benchmark.jsonl"))
    parser.add_argument("--summary", action="store_true")
    parser.add_argument("--confusion", type=Path, help="write the confusion picture here")
    a = parser.parse_args()
    if not a.summary:
        kinds = ("nulls", "effects", "unknown", "pairs") if a.kind == "all" else (a.kind,)
        for kind in kinds:
            count = 10 * a.count if kind == "nulls" and a.kind == "all" else a.count
            flown = a.manoeuvres or SUBJECTS[a.model][-1]
            run(kind, a.size, a.start, count, a.gust, flown, a.nulls, a.out, a.only, a.model)
    print(summary(a.out))
    rows = read_rows(a.out)
    print(calibration(rows))
    if a.confusion:
        confusion(rows, a.confusion)


if __name__ == "__main__":
    main()
