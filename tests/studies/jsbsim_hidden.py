"""Effects hidden in aircraft of JSBSim, in either plane and in all axes: what the gap workflow names.

    python -m tests.studies.jsbsim_hidden [--model lateral|longitudinal|six-dof] [--kinds NAME ...] [--hidden NAME ...] [--seed N]
        [--base simulation|plain] [--nulls N] [--out FILE]

Three flights and one held out of each aircraft, at four speeds, engine off, 20 Hz. A force or moment is written into the
aircraft's file; a lag or delay stands between a surface as it is recorded and as JSBSim is given it, at 200 Hz; an instrument
changes what JSBSim shows at 200 Hz. `--base simulation` gives `jsbsim:NAME`, unchanged; `plain` mass, inertia and shape alone.
Sizes are those of full-scale aircraft, lengths in spans. The results are kept in docs/validation/gap.md.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from daq.utilities.errors import UserError
from estimation.aircraft import Aircraft
from estimation.answers.gaps import gap
from groundstation.flight import Flight, Provenance
from tests.studies.gap_benchmark import outcome, same_class
from tests.support.gallery.aircraft import RATE, Array, Kind, executive, glide, properties, put_surfaces
from tests.support.gallery.records import NOISE, SEEN, SERVO, _pilot, _seen

Columns = dict[str, Array]
DEG, SAMPLE, DURATION = np.pi / 180, 20, 30.0  # rad, Hz, s
SPEEDS = (1.0, 0.94, 1.08, 1.03)
KINDS = (
    Kind("c172p", 50.0, 0.6, 4 * DEG, 5 * DEG),
    Kind("T37", 110.0, 0.5, 3 * DEG, 4 * DEG),
    Kind("J3Cub", 28.0, 0.7, 4 * DEG, 6 * DEG),
    Kind("L17", 50.0, 0.7, 4 * DEG, 4 * DEG),
    Kind("p51d", 100.0, 0.6, 3 * DEG, 3 * DEG),
    Kind("A4", 130.0, 0.5, 3 * DEG, 4 * DEG),
    Kind("C130", 100.0, 1.2, 5 * DEG, 4 * DEG),
    Kind("sgs126", 25.0, 0.7, 5 * DEG, 6 * DEG),
    Kind("pa28", 50.0, 0.6, 4 * DEG, 5 * DEG),
    Kind("t6texan2", 90.0, 0.6, 4 * DEG, 4 * DEG),
    Kind("c310", 70.0, 0.6, 4 * DEG, 5 * DEG),
    Kind("c182", 50.0, 0.6, 4 * DEG, 5 * DEG),
    Kind("OV10", 80.0, 0.6, 4 * DEG, 4 * DEG),
    Kind("f15", 150.0, 0.6, 3 * DEG, 3 * DEG),
    Kind("DHC6", 60.0, 0.7, 4 * DEG, 4 * DEG),
    Kind("global5000", 130.0, 1.0, 4 * DEG, 4 * DEG),
)
ELEVATOR = {k.name: 1.5 * DEG if k.name == "p51d" else 2.0 * DEG for k in KINDS}
"""Peaks of the elevator."""
LENGTH = {"LIFT": (), "DRAG": (), "PITCH": ("metrics/cbarw-ft",), "ROLL": ("metrics/bw-ft",), "YAW": ("metrics/bw-ft",)}
ALPHA = "aero/alpha-rad", 0.1
"""A factor of the catalogue's powers of the angle of attack: alpha less 0.1 rad."""


@dataclass(frozen=True)
class Hidden:
    """What is hidden. axis, factors: a coefficient in the aircraft's file, a product of properties, differences and numbers;
    lag, delay [s]: of a surface (elevator, aileron, rudder) behind what is recorded of it; sensors: of columns at 200 Hz and the
    span [m]; mass: times. parts: other names that the catalogue has for a part of it."""

    axis: str = ""
    factors: tuple[Any, ...] = ()
    lag: float = 0.0
    delay: float = 0.0
    surface: int = 0
    sensors: Callable[[Columns, float], Columns] | None = None
    mass: float = 1.0
    name: str = ""
    parts: tuple[str, ...] = ()


def _late(name: str, tau: float) -> Callable[[Columns, float], Columns]:
    def change(columns: Columns, span: float) -> Columns:
        course = columns[name].copy()
        for k in range(1, course.size):
            course[k] = course[k - 1] + (columns[name][k] - course[k - 1]) * (1.0 - np.exp(-1.0 / (RATE * tau)))
        return {**columns, name: course}

    return change


def _scaled(name: str, by: float) -> Callable[[Columns, float], Columns]:
    return lambda columns, span: {**columns, name: columns[name] * by}


def _ahead(columns: Columns, span: float) -> Columns:
    """Accelerometers 5 % of a span ahead of the centre of gravity."""
    c, x = columns, 0.05 * span
    return {
        **c,
        "ax": c["ax"] - (c["q"] ** 2 + c["r"] ** 2) * x,
        "ay": c["ay"] + (c["r_dot"] + c["p"] * c["q"]) * x,
        "az": c["az"] + (c["p"] * c["r"] - c["q_dot"]) * x,
    }


HIDDEN: Mapping[str, Hidden] = {
    "nothing": Hidden(),
    "Cm_alphadot": Hidden("PITCH", ("aero/alphadot-rad_sec", "aero/ci2vel", -4.0)),
    "Cm_alpha2": Hidden("PITCH", (ALPHA, ALPHA, -1.2)),
    "CL_alpha2": Hidden("LIFT", (ALPHA, ALPHA, -6.0)),
    "elevator_lag": Hidden(lag=0.05),
    "elevator_delay": Hidden(delay=0.04),
    "alpha_lag": Hidden(sensors=_late("alpha", 0.06)),
    "alpha_scale": Hidden(sensors=_scaled("alpha", 1.1)),
    "V_scale": Hidden(sensors=_scaled("V", 1.05)),
    "imu_x": Hidden(sensors=_ahead, parts=("imu_lever_arm",)),
    "mass": Hidden(mass=1.1, name="mass_error"),
    "Cm_beta2": Hidden("PITCH", ("aero/beta-rad", "aero/beta-rad", 1.0)),
    "Cn_da": Hidden("YAW", ("fcs/left-aileron-pos-rad", 0.02)),
    "beta_lag": Hidden(sensors=_late("beta", 0.08)),
    "Cn_beta3": Hidden("YAW", ("aero/beta-rad", "aero/beta-rad", "aero/beta-rad", 2.0)),
    "Cl_alpha_beta": Hidden("ROLL", (ALPHA, "aero/beta-rad", 0.75), parts=("Cl_beta",)),
    "aileron_lag": Hidden(lag=0.06, surface=1),
    "rudder_delay": Hidden(delay=0.06, surface=2),
    "beta_scale": Hidden(sensors=_scaled("beta", 1.15)),
}
PITCHING_ONLY = frozenset(
    ("Cm_alphadot", "Cm_alpha2", "CL_alpha2", "elevator_lag", "elevator_delay", "alpha_lag", "alpha_scale", "Cm_beta2")
)
LATERAL_ONLY = frozenset(
    ("Cn_da", "beta_lag", "Cn_beta3", "Cl_alpha_beta", "aileron_lag", "rudder_delay", "beta_scale")
)
"""What shows in one plane alone."""
LATERAL_NAMES = {"V_scale": "airspeed_scale", "imu_x": "imu_lever_arm"}


def change_file(file: Path, hidden: Hidden) -> None:
    """Writes what is hidden into an aircraft's file."""
    tree = ET.parse(file)
    if hidden.mass != 1.0:
        for weight in tree.getroot().iter("emptywt"):
            weight.text = str(hidden.mass * float(weight.text or "nan"))
    if hidden.axis:
        axis = next(a for a in tree.getroot().find("aerodynamics") or () if a.get("name") == hidden.axis)
        product = ET.SubElement(ET.SubElement(axis, "function", {"name": f"aero/hidden/{hidden.axis}"}), "product")
        for factor in ("aero/qbar-psf", "metrics/Sw-sqft", *LENGTH[hidden.axis], *hidden.factors):
            _factor(product, factor)
    tree.write(file)


def _factor(product: ET.Element, factor: Any) -> None:
    if isinstance(factor, tuple):
        product = ET.SubElement(product, "difference")
        ET.SubElement(product, "property").text, ET.SubElement(product, "value").text = factor[0], str(factor[1])
        return
    ET.SubElement(product, "property" if isinstance(factor, str) else "value").text = str(factor)


def flown(
    kind: Kind, hidden: Hidden, speed: float, seed: int, folder: Path, all_axes: bool
) -> tuple[Columns, Aircraft]:
    """One flight at 20 Hz without the noise of its instruments, and the aircraft as it is (its mass as weighed)."""
    rng = np.random.default_rng([seed, 20261128])
    fdm, steps = executive(kind.name, folder), round(DURATION * RATE) + 1
    trim = glide(fdm, speed)
    added = _pilot(kind, rng, steps, False, ELEVATOR[kind.name], all_axes)
    surfaces, acting, level, rows = trim[3:].copy(), trim[3:].copy(), float(trim[1]), []
    past = [trim[3:].copy()] * (round(hidden.delay * RATE) + 1)
    for k in range(steps):
        hold = np.array(
            [
                0.15 * (fdm["attitude/theta-rad"] - level) + 0.1 * fdm["velocities/q-rad_sec"],
                0.15 * fdm["attitude/phi-rad"] + 0.02 * fdm["velocities/p-rad_sec"],
                0.0,
            ]
        )
        rows.append(_seen(fdm, k, surfaces))
        surfaces = surfaces + (trim[3:] + added[:, k] + hold - surfaces) / (SERVO * RATE)
        past = [*past[1:], surfaces]
        behind = hidden.surface
        share = 1.0 - np.exp(-1.0 / (RATE * hidden.lag)) if hidden.lag else 1.0
        acting[behind] += (past[0][behind] - acting[behind]) * share
        put_surfaces(fdm, *(acting[i] if i == behind else surfaces[i] for i in range(3)))
        fdm.run()
    columns = dict(zip(SEEN, np.array(rows).T, strict=True))
    shape = properties(fdm)
    if hidden.sensors is not None:
        columns = hidden.sensors(columns, shape["span"])
    shape["mass"] /= hidden.mass
    return {n: v[:: RATE // SAMPLE] for n, v in columns.items()}, Aircraft(kind.name.lower(), **shape)


def flights_of(kind: Kind, hidden: Hidden, seed: int, all_axes: bool) -> tuple[list[Flight], Aircraft]:
    """Three flights and one to hold out, with noise."""
    four = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        executive(kind.name, folder)
        change_file(folder / kind.name / f"{kind.name}.xml", hidden)
        for i, share in enumerate(SPEEDS):
            columns, craft = flown(kind, hidden, share * kind.speed, 10 * seed + i, folder, all_axes)
            rng = np.random.default_rng([10 * seed + i, 7])
            noisy = {
                n: v + NOISE.get(n, 0.0) * rng.standard_normal(v.size) for n, v in columns.items() if "_dot" not in n
            }
            noisy["thrust"] = np.zeros_like(noisy["time"])
            four.append(Flight.build(f"f{i}", noisy.pop("time"), noisy, provenance=Provenance()))
    return four, craft


def ask(kind: Kind, label: str, model: str, base: str, seed: int, nulls: int) -> dict[str, Any]:
    """One set and its answer."""
    four, craft = flights_of(kind, HIDDEN[label], seed, model != "longitudinal")
    row: dict[str, Any] = {"kind": kind.name, "hidden": label, "model": model, "base": base, "seed": seed}
    begun = time.process_time()
    try:
        simulation = f"jsbsim:{kind.name}" if base == "simulation" else None
        aircraft = craft if simulation is None else None
        result = gap(model, four[:3], four[3:], aircraft=aircraft, simulation=simulation, nulls=nulls).result
    except UserError as error:
        return {**row, "verdict": "error", "steps": [], "why": str(error)}
    return {**row, **outcome(result), "seconds": round(time.process_time() - begun, 1)}


def judged(row: Mapping[str, Any]) -> str:
    """right (first and alone, but for its parts), right+ (first, others beside it), class (of which a part alone), wrong, unknown
    or missed; of nothing: right or false."""
    hidden = HIDDEN[row["hidden"]].name or row["hidden"]
    hidden = LATERAL_NAMES.get(hidden, hidden) if row["model"] == "lateral" else hidden
    parts = set(HIDDEN[row["hidden"]].parts) - {hidden}
    names = [s["effect"] for s in row["steps"]]
    if names and set(names) <= parts:
        return "class"
    if hidden in names:
        names = [n for n in names if n == hidden or n not in parts]
    if hidden == "nothing":
        return "right" if not names and row["verdict"] in ("no_gap", "cannot_tell") else "false"
    if not names or names[0] == "unknown":
        return "missed" if row["verdict"] in ("no_gap", "cannot_tell") else "unknown"
    if names[0] == hidden:
        return "right" if len(names) == 1 and all(len(s["set"]) <= 1 for s in row["steps"]) else "right+"
    return "class" if same_class(names[0], hidden) or hidden in row["steps"][0]["set"] else "wrong"


def one_line(row: Mapping[str, Any]) -> str:
    """A row as a line of the log."""
    rest = row.get("why") or f"{row['left']} {row['left_what'][:1]} {row['rejected'][:3]} cannot {row['cannot']}"
    where = f"{row['kind']:6s} {row['model'][:4]} {row['base'][:3]} {row['hidden']:14s} {row['seed']}"
    steps = "; ".join(map(_named, row["steps"]))
    return f"{judged(row):7s} {where} {row['verdict']} [{steps}] {rest} {row.get('seconds')}s"


def _named(step: Mapping[str, Any]) -> str:
    sizes = ", ".join(f"{v:.3g}+-{step['bounds'][n]:.1g}" for n, v in step["estimates"].items())
    return f"{step['effect']} {sizes} {step['score']}/{step['threshold']} {step['set']} held {step['held']}"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="longitudinal", choices=("lateral", "longitudinal", "six-dof"))
    parser.add_argument("--base", default="simulation", choices=("simulation", "plain"))
    parser.add_argument("--kinds", nargs="*", default=[k.name for k in KINDS])
    parser.add_argument("--hidden", nargs="*", default=list(HIDDEN))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--nulls", type=int, default=30)
    parser.add_argument("--out", type=Path, default=Path("build/jsbsim_hidden.jsonl"))
    given = parser.parse_args(arguments)
    given.out.parent.mkdir(parents=True, exist_ok=True)
    for kind in (k for k in KINDS if k.name in given.kinds):
        for number, label in enumerate(HIDDEN):
            elsewhere = {"lateral": PITCHING_ONLY, "longitudinal": LATERAL_ONLY | {"Cm_beta2"}}.get(given.model, ())
            if label in given.hidden and label not in elsewhere:
                row = ask(kind, label, given.model, given.base, 1000 * given.seed + number, given.nulls)
                with given.out.open("a", encoding="utf-8") as handle:
                    handle.write(json.dumps(row) + "\n")
                print(one_line(row), flush=True)


if __name__ == "__main__":
    main()
