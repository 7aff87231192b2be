"""One coefficient of an aircraft is another than in its simulator's file: is it what `gap --simulation` names?

`python -m tests.studies.simulator_coefficients [--to ardupilot|gazebo] [--factors 0.7 1.35] [--seed 0] [--model lateral]
[--changed flights|file] [KEY ...]`: the second truth's aircraft is exported, and flights (three, one held out) of one with a
derivative multiplied are asked; or the number of the file is multiplied, which in a file for SITL is an acceleration, of
another derivative as well where there is a product of inertia. The last result is kept in docs/validation/gap.md.
"""

import argparse
import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from daq.utilities.errors import UserError
from estimation.gap.search.state import Options
from estimation.gap.workflow import run_gap
from estimation.simulation.attach import attach
from groundstation.flight import Flight
from sideslip.cli import cli
from tests.studies import second_truth as truth

KEYS: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "ardupilot": {
        "lateral": {
            "c_y_b": "CY_beta", "c_y_deltar": "CY_dr", "c_l_b": "Cl_beta", "c_l_p": "Cl_p", "c_l_r": "Cl_r",
            "c_l_deltaa": "Cl_da", "c_l_deltar": "Cl_dr", "c_n_b": "Cn_beta", "c_n_p": "Cn_p", "c_n_r": "Cn_r",
            "c_n_deltar": "Cn_dr",
        },
        "longitudinal": {
            "c_lift_a": "CL_alpha", "c_lift_deltae": "CL_de", "c_drag_p": "CD_0", "c_m_a": "Cm_alpha", "c_m_q": "Cm_q",
            "c_m_deltae": "Cm_de",
        },
    },
    "gazebo": {
        "lateral": {
            "CYb": "CY_beta", "Cellb": "Cl_beta", "Cellp": "Cl_p", "Cellr": "Cl_r", "Cenb": "Cn_beta", "Cenp": "Cn_p",
            "Cenr": "Cn_r",
        },
        "longitudinal": {"CLa": "CL_alpha", "CD0": "CD_0", "Cema": "Cm_alpha", "Cemq": "Cm_q"},
    },
}  # fmt: skip
"""Key of the file -> what it is by name; one that is zero in the file stays so."""
FLIGHTS = {"lateral": "rich", "longitudinal": "longitudinal-advised"}


def exported(to: str, folder: Path) -> Path:
    """The second truth's aircraft as the simulator's file."""
    derivatives = "".join(f"{n} = {v}\n" for n, v in truth.TRUE_DERIVATIVES.items())
    inertia = "".join(f"{n} = {v}\n" for n, v in truth.INERTIA.items())
    geometry = f"span = {truth.SPAN}\narea = {truth.AREA}\nchord = {truth.CHORD}\n"
    (folder / "own.toml").write_text(
        f'name = "own"\n[geometry]\n{geometry}[mass]\nmass = {truth.MASS}\n{inertia}'
        f"[throws]\ndelta_e = 0.4\ndelta_a = 0.3\ndelta_r = 0.5\n[derivatives]\n{derivatives}"
    )
    out = folder / ("own.json" if to == "ardupilot" else "own")
    words = ["export", str(folder / "own.toml"), "--to", to, "-o", str(out), "--thrust", "20"]
    if to == "ardupilot":
        words = words[:-2]
    done = CliRunner().invoke(cli, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return out if to == "ardupilot" else out / "model.sdf"


def multiplied(text: str, key: str, factor: float) -> str:
    """The file with one number multiplied."""
    pattern = rf'("{key}"\s*:\s*|<{key}>)([-+0-9.eE]+)'
    changed, count = re.subn(pattern, lambda m: f"{m[1]}{factor * float(m[2])!r}", text, count=1)
    assert count, f"no {key} in the file"
    return changed


def flights(model: str, seed: int, count: int, derivatives: Mapping[str, float]) -> list[Flight]:
    """Flights of the aircraft with some derivatives other than they are."""
    requests = [
        truth.Request(6000 + 10 * seed + i, 14.5 + 1.2 * i, manoeuvres=FLIGHTS[model], derivatives=derivatives)
        for i in range(count)
    ]
    flown = truth.fly(requests)
    return [Flight.build(f"f{i}", c.pop("time"), c) for i, c in enumerate(flown)]


def asked(spec: str, model: str, flown: Sequence[Flight], nulls: int) -> Any:
    attached, training = attach(spec, model, flown), len(flown) - 1
    options = replace(Options(), nulls=nulls)
    return run_gap(attached.model, attached.training(training), attached.holdout(training), options=options)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("keys", nargs="*")
    parser.add_argument("--to", choices=tuple(KEYS), default="ardupilot")
    parser.add_argument("--model", choices=("lateral", "longitudinal"), default="lateral")
    parser.add_argument("--factors", type=float, nargs="+", default=[0.7, 1.35])
    parser.add_argument("--changed", choices=("flights", "file"), default="flights")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--flights", type=int, default=4, help="one of them held out")
    parser.add_argument("--nulls", type=int, default=100)
    given = parser.parse_args(arguments)
    print("| key | is | times | verdict | named, score |\n|---|---|---|---|---|", flush=True)
    flown = flights(given.model, given.seed, given.flights, {})
    with tempfile.TemporaryDirectory() as folder:
        path = exported(given.to, Path(folder))
        text = path.read_text()
        for key, name in KEYS[given.to][given.model].items():
            if given.keys and key not in given.keys:
                continue
            for factor in given.factors:
                if given.changed == "file":
                    path.write_text(multiplied(text, key, factor))
                else:
                    other = {name: factor * truth.TRUE_DERIVATIVES[name]}
                    flown = flights(given.model, given.seed, given.flights, other)
                try:
                    answer = asked(f"{given.to}:{path}", given.model, flown, given.nulls).to_json()
                except UserError as error:
                    print(f"| {key} | {name} | {factor:g} | refused | {error} |", flush=True)
                    continue
                steps = ", ".join(f"{s['effect']} {s['score']:.1f}" for s in answer["steps"])
                print(f"| {key} | {name} | {factor:g} | {answer['verdict']} | {steps} |", flush=True)


if __name__ == "__main__":
    main()
