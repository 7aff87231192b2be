"""Effects that no catalogue holds, hidden in the second truth: does a shape close the gap, and does none get a physical name?

Run: python -m tests.studies.nameless_truth [-n SETS] [--start SEED] [--only NAME ...] [--kinds KIND ...] [--nulls N] [--out FILE]
One JSON line a case; `--summary FILE` prints the table. Ten functions of the motion, three with memory, three faults of one
stretch of flight, nothing, and each function beside an effect that the catalogue holds.
"""

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from estimation.gap.answer.shape import Happened, HeldInstrument, LaggedTerm, ShapeCurve, SwingingTerm
from estimation.gap.workflow import Options, run_gap
from estimation.models.load import load_model
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import SPEEDS, flights

D = truth.DEG
Signals = Mapping[str, truth.Array]


def hidden(line: str, variable: str, of: Any, memory: float = 0.0) -> truth.Hidden:
    return truth.Hidden(line, lambda s: of(s[variable]), memory)


FUNCTIONS: Mapping[str, truth.Hidden] = {
    "Cl even in beta": hidden("Cl", "beta", lambda x: 0.3 * x**2),
    "Cn bump in beta": hidden("Cn", "beta", lambda x: 0.0015 * ca.exp(-(((x - 3 * D) / (1.5 * D)) ** 2))),
    "CY dead band in beta": hidden("CY", "beta", lambda x: -0.25 * ca.sign(x) * ca.fmax(ca.fabs(x) - 3 * D, 0.0)),
    "Cn even in p": hidden("Cn", "p_hat", lambda x: 0.3 * x**2),
    "Cn one-sided in p": hidden("Cn", "p_hat", lambda x: 0.03 * ca.fmax(x, 0.0)),
    "Cl absolute r": hidden("Cl", "r_hat", lambda x: 0.06 * ca.fabs(x)),
    "Cn absolute aileron": hidden("Cn", "delta_a", lambda x: 0.006 * ca.fabs(x)),
    "Cl even in rudder": hidden("Cl", "delta_r", lambda x: 0.6 * x**2),
    "CY bent in rudder": hidden("CY", "delta_r", lambda x: 0.03 * ca.tanh(x / (1.0 * D))),
    "Cl even in aileron": hidden("Cl", "delta_a", lambda x: 0.25 * x**2),
}
MEMORY: Mapping[str, truth.Hidden] = {
    "Cl late after rudder": hidden("Cl", "delta_r", lambda x: 0.03 * x, 0.3),
    "Cn late after p": hidden("Cn", "p_hat", lambda x: 0.03 * x, 0.4),
    "CY late after beta": hidden("CY", "beta", lambda x: 0.15 * x, 0.5),
}
MIXED: tuple[tuple[str, str], ...] = (
    ("Cl even in beta", "Cn_da"), ("Cn absolute aileron", "beta_lag"), ("Cn even in p", "Cl_alpha_beta"),
    ("Cl even in rudder", "aileron_delay"), ("Cn bump in beta", "gyro_scale"), ("CY dead band in beta", "Cn_da"),
    ("CY bent in rudder", "Cl_beta3"), ("Cl absolute r", "rudder_lag"), ("Cl even in aileron", "beta_scale"),
    ("Cn one-sided in p", "lateral_cg"),
)  # fmt: skip
"""A function that no catalogue holds, and beside it an effect of usual size that one does."""
KINDS = ("function", "memory", "local", "nothing", "mixed")


def cases() -> list[tuple[str, str, truth.Hidden | None, dict[str, float]]]:
    """(kind, label, hidden part, effects of the truth)."""
    made: list[tuple[str, str, truth.Hidden | None, dict[str, float]]] = []
    made += [("function", n, h, {}) for n, h in FUNCTIONS.items()]
    made += [("local", n, None, {n: 1.0}) for n in truth.LOCAL]
    made += [("nothing", f"nothing {k}", None, {}) for k in range(1, 4)]
    made += [("memory", n, h, {}) for n, h in MEMORY.items()]
    made += [("mixed", f"{n} + {e}", FUNCTIONS[n], {e: 1.0}) for n, e in MIXED]
    return made


def one(
    kind: str, label: str, part: truth.Hidden | None, effects: dict[str, float], seed: int, nulls: int
) -> dict[str, Any]:
    """Fly three training flights and one to hold out, analyse them, and keep what was said."""
    derivatives = truth.perturbed_derivatives(np.random.default_rng([seed, 7]))
    four = flights(
        truth.fly(
            [
                truth.Request(seed * 10 + i, SPEEDS[i], effects, 0.15 * D, derivatives=derivatives, hidden=part)
                for i in range(4)
            ]
        )
    )
    began = time.process_time()
    result = run_gap(load_model("lateral", "cdfp"), four[:3], four[3:], options=Options(seed=1, nulls=nulls))
    last = result.steps[-1] if result.steps else None
    shape = last.shape if last is not None else None
    return {
        "kind": kind,
        "label": label,
        "seed": seed,
        "verdict": result.verdict.value,
        "seconds": round(time.process_time() - began),
        "named": [s.effect for s in result.steps if s.effect != "unknown"],
        "unknown": any(s.effect == "unknown" for s in result.steps),
        "form": said(shape),
        "closed": round(shape.closed, 3) if isinstance(shape, ShapeCurve) else None,
        "before": None if last is None or last.holdout is None else round(last.holdout.before, 3),
        "after": None if last is None or last.holdout is None else round(last.holdout.after, 3),
        "held": None if last is None or last.holdout is None else round(last.holdout.closed, 3),
    }


def said(shape: ShapeCurve | LaggedTerm | SwingingTerm | Happened | HeldInstrument | None) -> str:
    """A shape in few words."""
    if isinstance(shape, ShapeCurve):
        return f"{shape.output} by {' times '.join(shape.variables)}" + (
            f"; {shape.analytic}" if shape.analytic else ""
        )
    if isinstance(shape, LaggedTerm):
        return f"{shape.line} late after {shape.variable} ({shape.time:g} s)"
    if isinstance(shape, SwingingTerm):
        return f"{shape.line} swings at {shape.frequency:.2g} rad/s"
    if isinstance(shape, Happened):
        return "; ".join(dict.fromkeys(f"{e.what} {e.channel} {e.start:.1f} s" for e in shape.events))
    if isinstance(shape, HeldInstrument):
        return f"{shape.channel} held for {shape.every:.2g} s"
    return ""


def summary(rows: Sequence[Mapping[str, Any]]) -> str:
    """The table as Markdown."""
    lines = ["| hidden | verdict | form | held-out gap before, after | closed | names |", "|---|---|---|---|---|---|"]
    for r in sorted(rows, key=lambda r: KINDS.index(r["kind"])):
        gap = "" if r["before"] is None else f"{r['before']:.2f}, {r['after']:.2f}"
        closed = "" if r["closed"] is None else f"{r['closed']:.2f}"
        names = ", ".join(r["named"]) or "none"
        lines.append(f"| {r['label']} | `{r['verdict']}` | {r['form']} | {gap} | {closed} | {names} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=1, help="sets of flights of every case")
    parser.add_argument("--start", type=int, default=4000, help="first seed")
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=list(KINDS))
    parser.add_argument("--nulls", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path("out/nameless.jsonl"))
    parser.add_argument("--summary", type=Path)
    given = parser.parse_args()
    if given.summary:
        print(summary([json.loads(line) for line in given.summary.read_text(encoding="utf-8").splitlines()]))
        return
    given.out.parent.mkdir(parents=True, exist_ok=True)
    for turn in range(given.n):
        for k, (kind, label, part, effects) in enumerate(cases()):
            if kind not in given.kinds or (given.only and label not in given.only):
                continue
            row = one(kind, label, part, effects, given.start + 100 * turn + k, given.nulls)
            with given.out.open("a", encoding="utf-8") as handle:
                handle.write(json.dumps(row) + "\n")
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
