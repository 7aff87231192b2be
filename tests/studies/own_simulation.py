"""JSBSim flies aircraft with something hidden; the unchanged one is given as simulation; what is found is written back and flown.

`python -m tests.studies.own_simulation [-n SEEDS] [--nulls N] [--rate HZ]`. Each case: three flights and one held out of a c172p
in which one thing is changed (in its XML, or behind a surface), noise added; `gap --simulation jsbsim:c172p`, or a function
that asks it; the model exported; then the exported and the truly changed aircraft fly the held-out pilot's inputs in JSBSim,
without noise. `floor` is what the exported aircraft's flight would have for a gap over the noise: sqrt(1 + mean square of the
difference over the noise of each output), 1.00 where it is the true one.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from estimation.gap.answer.result import GapResult
from estimation.gap.effects import catalogue
from estimation.gap.search.state import Options
from estimation.gap.workflow import run_gap
from estimation.models.load import write_model
from estimation.simulation.attach import attach, simulation_of
from estimation.simulation.conversion import ProvedExport, export_to_jsbsim
from estimation.simulation.oracle import States
from tests.studies.jsbsim_flights import NOISE, Array, Flown, changed, columns_of, flight, with_own_channel_only

SPEEDS = (45.0, 50.0, 55.0, 48.0)
OUTPUTS = {"lateral": ("beta", "p", "r", "phi", "ay"), "longitudinal": ("V", "alpha", "theta", "q", "ax", "az")}
OUTPUTS["six-dof"] = (*OUTPUTS["lateral"], *OUTPUTS["longitudinal"])
YAW = """<function name="aero/hidden/Cnda"><product><property>aero/qbar-psf</property><property>metrics/Sw-sqft</property>
<property>metrics/bw-ft</property><property>fcs/left-aileron-pos-rad</property><value>0.012</value></product></function>"""


def _replaced(old: str, new: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        if text.count(old) != 1:
            raise RuntimeError(f"{old!r} stands {text.count(old)} times in the aircraft")
        return text.replace(old, new)

    return change


@dataclass(frozen=True)
class Case:
    """What is hidden, and the name it should be given (nothing for a null)."""

    title: str
    effect: str
    change: Callable[[str], str] = str
    lag: Mapping[str, float] = field(default_factory=dict)
    model: str = "lateral"
    simulation: str = "jsbsim:c172p"


BASE = simulation_of("jsbsim:c172p")
AIRCRAFT = BASE.aircraft


def function(
    V: Array, alpha: Array, beta: Array, p: Array, q: Array, r: Array, surfaces: Mapping[str, Array],
    thrust: Array, rho: Array, alpha_dot: Array,
) -> tuple[Array, ...]:  # fmt: skip
    """The unchanged c172p as somebody's Python function."""
    motion = {"V": V, "alpha": alpha, "beta": beta, "p": p, "q": q, "r": r, "thrust": thrust, **surfaces}
    states = States({n: np.atleast_1d(v) for n, v in motion.items()}, np.atleast_1d(rho), np.atleast_1d(alpha_dot))
    return tuple(BASE.oracle.coefficients(states).T)


FUNCTION = f"{__name__ if __name__ != '__main__' else 'tests.studies.own_simulation'}:function"
CASES = (
    Case(
        "yaw by aileron, a function",
        "Cn_da",
        _replaced('<function name="aero/coefficient/Cndr">', YAW + '<function name="aero/coefficient/Cndr">'),
    ),
    Case("roll damping times 1.2", "Cl_p", _replaced("<value>-0.4840</value>", "<value>-0.5808</value>")),
    Case("rudder 60 ms slow", "rudder_lag", lag={"delta_r": 0.06}),
    Case(
        "pitch damping times 1.3",
        "Cm_q",
        _replaced("<value>-12.4000</value>", "<value>-16.1200</value>"),
        model="longitudinal",
    ),
    Case(
        "roll damping times 1.2", "Cl_p", _replaced("<value>-0.4840</value>", "<value>-0.5808</value>"), model="six-dof"
    ),
    Case(
        "pitch damping times 1.3",
        "Cm_q",
        _replaced("<value>-12.4000</value>", "<value>-16.1200</value>"),
        model="six-dof",
    ),
    Case(
        "pitch damping times 1.3",
        "Cm_q",
        _replaced("<value>-12.4000</value>", "<value>-16.1200</value>"),
        model="six-dof",
        simulation=FUNCTION,
    ),
    Case("nothing", ""),
    Case("nothing", "", model="longitudinal"),
    Case("nothing", "", model="six-dof"),
)


@dataclass(frozen=True)
class Outcome:
    result: GapResult
    exported: ProvedExport | None
    floor: float
    seconds: float


def run(case: Case, seed: int, nulls: int, rate: float, folder: Path) -> Outcome:
    """One case: flights, gap, export, and the two aircraft side by side."""
    hidden = changed(folder, "c172p", case.change)
    asked = [Flown(hidden, 100 * seed + i, speed, lag=case.lag) for i, speed in enumerate(SPEEDS)]
    begin = time.process_time()
    told = attach(case.simulation, case.model, [flight(f, f"f{i}") for i, f in enumerate(asked)])
    options = Options(seed=seed, nulls=nulls)
    result = run_gap(told.model, told.training(3), told.holdout(3), catalogue(model=told.model), options)
    if not result.steps or result.steps[0].effect == "unknown":
        return Outcome(result, None, np.nan, time.process_time() - begin)
    write_model(result.model_after, folder / "child.toml")
    exported = export_to_jsbsim(folder / "child.toml", "jsbsim:c172p", folder / "out", rate)
    seconds = time.process_time() - begin
    own = with_own_channel_only(exported.exported.file, folder / "flown")
    true = columns_of(asked[3])
    again = columns_of(replace(asked[3], file=own, trimmed=hidden, lag={}))
    off = [(again[n] - true[n]) / NOISE[n] for n in OUTPUTS[case.model]]
    return Outcome(result, exported, float(np.sqrt(1.0 + np.mean(np.square(off)))), seconds)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("-n", type=int, default=2, help="seeds of each case")
    parser.add_argument("--nulls", type=int, default=60)
    parser.add_argument("--first", type=int, default=1, help="number of the case to begin with")
    parser.add_argument("--rate", type=float, default=60.0, help="of JSBSim's steps in the proof of the export")
    parser.add_argument("--seed", type=int, default=1, help="the first of the seeds")
    asked = parser.parse_args()
    print(
        "| hidden | model, simulation | found | estimate | held out closed | proof, worst share of allowed"
        " | floor of the exported | s |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for case in CASES[asked.first - 1 :]:
        for seed in range(asked.seed, asked.seed + asked.n):
            with tempfile.TemporaryDirectory() as folder:
                done = run(case, seed, asked.nulls, asked.rate, Path(folder))
            steps = done.result.steps
            found = ", ".join(s.effect for s in steps) or done.result.verdict.value
            values = "; ".join(f"{v:.4g} +- {b:.1g}" for s in steps for v, b in s.estimates.values())
            held = ", ".join(f"{s.holdout.closed:.2f}" for s in steps if s.holdout is not None)
            proof = done.exported.proof if done.exported is not None else None
            worst = "" if proof is None else f"{max(proof.rms[n] / proof.allowed[n] for n in proof.rms):.2f}"
            floor = "" if proof is None else f"{done.floor:.3f}"
            where = f"{case.model}, {case.simulation.rpartition(':')[2]}"
            row = (case.title, where, found, values, held, worst, floor, f"{done.seconds:.0f}")
            print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
