"""Awkward flights of JSBSim's aircraft, with and without something hidden in them: what the gap workflow says of each.

    python -m tests.studies.gap_gallery [--rows N...] [--hidden NAME...] [--kinds NAME...] [--nulls N] [--seed S] [--out JSONL]

Three flights and one held out of every aircraft, at four speeds, as `tests.studies.gallery` flies and records them. The base is
what a stranger would take: `lateral` with the aircraft's mass and shape, no beliefs. These aircraft have tables and terms of
their own that `lateral` lacks; `present` tells which: an effect is in an aircraft if JSBSim's own coefficients along the flights,
without noise, are explained clearly better with its term than without.
"""

import argparse
import json
import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from daq.utilities.errors import UserError
from estimation.gap.search.state import Options
from estimation.gap.workflow import run_gap
from estimation.models import load_model
from groundstation.flight import Flight
from tests.studies.gallery import KINDS, RATES
from tests.studies.gap_benchmark import same_class
from tests.support.gallery import records
from tests.support.gallery.aircraft import Kind, executive
from tests.support.gallery.records import Columns, Flown, fly, recorded

SPEEDS = (1.0, 0.94, 1.08, 1.03)
"""Of the aircraft's own speed: three flights to train on, one held out."""
Change = Callable[[Columns, Flown], Columns]


@dataclass(frozen=True)
class Row:
    """One kind of awkwardness. change: what the instruments do; flight: how it is flown; names: what is then rightly named."""

    title: str
    change: Change | None = None
    flight: Mapping[str, Any] = field(default_factory=dict)
    names: tuple[str, ...] = ()


LATE = ("attitude_lag", "time_skew", "theta_lag")
AHEAD = ("vane_position", "imu_lever_arm", "beta_lag", "time_skew", "alpha_position", "imu_x", "imu_z")
ROWS = (
    Row("plain"),
    Row("12 bits", records.quantised),
    Row("attitude and airspeed at 5 Hz, repeated", records.slow, names=LATE),
    Row("vanes half a span ahead, IMU off the CG", records.on_a_boom, names=AHEAD),
    Row("a gap", records.with_a_gap),
    Row("gusts of 0.3 m/s", flight={"gust": 0.3}),
    Row("gusts of 1 m/s", flight={"gust": 1.0}),
    Row("gusts of 1 m/s, 12 bits, 5 Hz, a gap", records.all_at_once, flight={"gust": 1.0}, names=LATE),
)  # fmt: skip


def term(axis: str, *factors: str | float) -> Callable[[Path], None]:
    """Adds a moment coefficient to an aircraft: the product of properties and numbers."""

    def change(file: Path) -> None:
        tree = ET.parse(file)
        where = next(a for a in tree.getroot().find("aerodynamics") or () if a.tag == "axis" and a.get("name") == axis)
        product = ET.SubElement(ET.SubElement(where, "function", {"name": f"aero/hidden/{axis}"}), "product")
        for factor in ("aero/qbar-psf", "metrics/Sw-sqft", "metrics/bw-ft", *factors):
            ET.SubElement(product, "property" if isinstance(factor, str) else "value").text = str(factor)
        tree.write(file)

    return change


def late(name: str, tau: float) -> Change:
    """A column that follows by a first-order lag."""

    def change(columns: Columns, flown: Flown) -> Columns:
        step = float(columns["time"][1] - columns["time"][0])
        fine, seen = 20, columns[name]
        course = np.interp(np.arange((seen.size - 1) * fine + 1) / fine, np.arange(seen.size), seen)
        keep, value, out = math.exp(-step / fine / tau), course[0], np.empty_like(course)
        for k, now in enumerate(course):
            value = keep * value + (1.0 - keep) * now
            out[k] = value
        return {**columns, name: out[::fine]}

    return change


def scaled(name: str, by: float) -> Change:
    return lambda columns, flown: {**columns, name: columns[name] * by}


@dataclass(frozen=True)
class Hidden:
    """Something to find. names: what it may be called; flight: how it is flown; columns: what the instruments show."""

    names: tuple[str, ...] = ()
    flight: Mapping[str, Any] = field(default_factory=dict)
    aircraft: Callable[[Path], None] | None = None
    columns: Change | None = None
    plane: str = "lateral"


HIDDEN: Mapping[str, Hidden] = {
    "nothing": Hidden(),
    "Cn_da": Hidden(("Cn_da", "Ixz_error"), aircraft=term("YAW", "fcs/left-aileron-pos-rad", 0.02)),
    "Cl_beta3": Hidden(("Cl_beta3",), aircraft=term("ROLL", "aero/beta-rad", "aero/beta-rad", "aero/beta-rad", 4.0)),
    "beta_lag": Hidden(("beta_lag", "time_skew", "vane_position"), columns=late("beta", 0.12)),
    "beta_scale": Hidden(("beta_scale",), columns=scaled("beta", 1.2)),
    "gyro_scale": Hidden(("gyro_scale",), columns=scaled("r", 1.08)),
    "commands": Hidden(("servo_lag", "servo_delay"), {"commands": True}),
    "nothing in pitch": Hidden(plane="longitudinal"),
    "alpha_lag": Hidden(("alpha_lag",), columns=late("alpha", 0.12), plane="longitudinal"),
    "alpha_scale": Hidden(("alpha_scale",), columns=scaled("alpha", 1.2), plane="longitudinal"),
    "V_scale": Hidden(("V_scale",), columns=scaled("V", 1.06), plane="longitudinal"),
    "nothing in all axes": Hidden(plane="six-dof"),
    "Cm_beta2": Hidden(("Cm_beta2",), aircraft=term("PITCH", "aero/beta-rad", "aero/beta-rad", 0.3), plane="six-dof"),
    "q_scale": Hidden(("q_scale",), columns=scaled("q", 1.08), plane="six-dof"),
    "elevator commands": Hidden(("elevator_lag", "elevator_delay"), {"commands": True}, plane="longitudinal"),
}


TERMS: Mapping[str, str] = {
    "CY_da": "CY da", "Cn_da": "Cn da", "Cl_alpha_beta": "Cl alpha beta", "Cn_alpha_beta": "Cn alpha beta",
    "Cl_da_de": "Cl da de", "Cl_beta3": "Cl beta beta beta", "Cn_beta3": "Cn beta beta beta",
    "CY_beta3": "CY beta beta beta", "Cl_da3": "Cl da da da",
    "Cn_dr3": "Cn dr dr dr", "Cl_p_abs_p": "Cl ph size_ph", "surface_compliance": "Cl da V V", "Cl_betadot": "Cl bdot",
    "Cn_betadot": "Cn bdot", "stall_separation": "Cl ph alpha",
}  # fmt: skip
TERMS_OF_BOTH: Mapping[str, str] = {
    "Cm_beta2": "Cm beta beta", "CL_beta2": "CL beta beta", "CD_beta2": "CD beta beta, CD size_beta",
    "CL_da2": "CL da da", "CD_da2": "CD da da", "Cm_da2": "Cm da da",
    "Cl_alpha_da": "Cl alpha da", "Cn_alpha_da": "Cn alpha da", "Cn_alpha_dr": "Cn alpha dr",
    "Cl_alpha_p": "Cl alpha ph", "Cn_alpha_p": "Cn alpha ph", "CY_p_r": "CY ph, CY rh",
}  # fmt: skip
TERMS_IN_PITCH: Mapping[str, str] = {
    "CL_alphadot": "CL adot", "Cm_alphadot": "Cm adot", "CL_alpha2": "CL alpha alpha", "Cm_alpha2": "Cm alpha alpha",
    "CL_alpha3": "CL alpha alpha alpha", "Cm_alpha3": "Cm alpha alpha alpha", "CL_de3": "CL de de de", "Cm_de3": "Cm de de de",
    "Cm_alpha_de": "Cm alpha de", "CD_CL": "CD CL", "CD_alpha4": "CD alpha alpha alpha alpha",
    "CD_de2": "CD de de, CD de, CD alpha de",
    "CD_q": "CD qh", "wing_compliance": "CL alpha V V", "elevator_compliance": "Cm de V V",
    "stall_separation": "CL alpha alpha alpha",
}  # fmt: skip
PLANES: Mapping[str, Mapping[str, str]] = {
    "lateral": TERMS, "longitudinal": TERMS_IN_PITCH, "six-dof": {**TERMS, **TERMS_IN_PITCH, **TERMS_OF_BOTH},
}  # fmt: skip
"""Plane -> name of an effect -> the coefficient and the product of signals that it adds to it; one for each of its forms."""
BASE: Mapping[str, str] = {
    "CY": "1,beta,ph,rh,dr", "Cl": "1,beta,ph,rh,da,dr", "Cn": "1,beta,ph,rh,dr",
    "CL": "1,alpha,qh,de", "CD": "1,CL CL", "Cm": "1,alpha,qh,de",
}  # fmt: skip
PRESENT = 0.1  # of what the linear coefficient leaves


def present(flown: Sequence[Flown], terms: Mapping[str, str]) -> dict[str, float]:
    """Names of terms that are in the aircraft: the share that a term explains of what the coefficient leaves, in the motion
    without noise, where it is more than a little: of the linear coefficient, then of it with the best term, and so on."""
    found: dict[str, float] = {}
    for line in BASE:
        forms = [(n, of.split(maxsplit=1)) for n, every in terms.items() for of in every.split(", ")]
        own = {product: n for n, (coefficient, product) in forms if coefficient == line}
        chosen: list[str] = []
        while len(chosen) < len(own):
            shares = {t: _explained(flown, line, chosen, t) for t in own if t not in chosen}
            for product, share in shares.items():
                if share > max(PRESENT, found.get(own[product], 0.0)):
                    found[own[product]] = round(share, 2)
            best = max(shares, key=lambda t: shares[t])
            if shares[best] < PRESENT:
                break
            chosen.append(best)
    return found


def _explained(flown: Sequence[Flown], line: str, known: Sequence[str], more: str) -> float:
    columns, wanted = [], []
    for one in flown:
        c, a = one.columns, one.craft
        pressure = 0.5 * c["rho"] * c["V"] ** 2 * a.area
        roll = a.Ixx * c["p_dot"] - a.Ixz * (c["r_dot"] + c["p"] * c["q"]) + (a.Izz - a.Iyy) * c["q"] * c["r"]
        yaw = a.Izz * c["r_dot"] - a.Ixz * (c["p_dot"] - c["q"] * c["r"]) + (a.Iyy - a.Ixx) * c["p"] * c["q"]
        made = {"CY": a.mass * c["ay"] / pressure, "Cl": roll / (pressure * a.span), "Cn": yaw / (pressure * a.span)}
        sin, cos = np.sin(c["alpha"]), np.cos(c["alpha"])
        made["CL"] = a.mass * (c["ax"] * sin - c["az"] * cos) / pressure
        made["CD"] = -a.mass * (c["ax"] * cos + c["az"] * sin) / pressure
        made["Cm"] = a.Iyy * c["q_dot"] / (pressure * a.chord)
        signals = {
            "beta": c["beta"], "alpha": c["alpha"], "V": c["V"] / 100.0,
            "da": c["delta_a"], "dr": c["delta_r"], "de": c["delta_e"],
            "ph": c["p"] * a.span / (2 * c["V"]), "rh": c["r"] * a.span / (2 * c["V"]),
            "bdot": np.gradient(c["beta"], c["time"]) * a.span / (2 * c["V"]), "1": np.ones_like(c["V"]), "CL": made["CL"],
            "qh": c["q"] * a.chord / (2 * c["V"]), "adot": np.gradient(c["alpha"], c["time"]) * a.chord / (2 * c["V"]),
        }  # fmt: skip
        signals |= {"size_ph": np.abs(signals["ph"]), "size_beta": np.abs(signals["beta"])}
        terms = [np.prod([signals[f] for f in t.split()], axis=0) for t in (*BASE[line].split(","), *known, more)]
        columns.append(np.column_stack(terms))
        wanted.append(made[line])
    A, y = np.concatenate(columns), np.concatenate(wanted)
    left = [float(np.sum((y - B @ np.linalg.lstsq(B, y, rcond=None)[0]) ** 2)) for B in (A[:, :-1], A)]
    return 1.0 - left[1] / left[0] if left[0] > 1e-20 else 0.0


def judged(r: Mapping[str, Any]) -> str:
    """right, honest, missed or wrong: by the names that are given."""
    hidden, row = HIDDEN[r["hidden"]], next(x for x in ROWS if x.title == r["row"])
    names = [s["effect"] for s in r["steps"] if s["effect"] != "unknown"]
    may = {*hidden.names, *row.names, *r["present"]}
    if any(not any(same_class(n, m) for m in may) for n in names):
        return "wrong"
    if hidden.names and not any(same_class(n, h) for n in names for h in hidden.names):
        blind = any(h in r["cannot"] for h in hidden.names)
        return "honest" if blind or r["verdict"] in ("unknown_effect", "cannot_tell") else "missed"
    return "right"


def flights_of(kind: Kind, row: Row, hidden: Hidden, seed: int, folder: Path) -> tuple[list[Flight], list[Flown]]:
    """Three flights and one to hold out."""
    executive(kind.name, folder)
    if hidden.aircraft is not None:
        hidden.aircraft(folder / kind.name / f"{kind.name}.xml")
    four, flown = [], []
    for i, share in enumerate(SPEEDS):
        one = fly(
            replace(kind, speed=share * kind.speed), folder, 10 * seed + i, rate=RATES[kind.name],
            duration=60.0 if kind.pace > 1.0 else 30.0, pitching=0.5 * kind.aileron if hidden.plane != "lateral" else 0.0,
            all_axes=hidden.plane == "six-dof",
            **row.flight, **hidden.flight,
        )  # fmt: skip
        one = replace(one, columns={**one.columns, "thrust": np.zeros_like(one.columns["time"])})
        flown.append(replace(one, columns={**one.columns, **one.deflections}))
        if hidden.columns is not None:
            one = replace(one, columns=hidden.columns(dict(one.columns), one))
        four.append(replace(recorded(one, 10 * seed + i, row.change), name=f"f{i}"))
    return four, flown


def outcome(kind: Kind, row: Row, label: str, seed: int, nulls: int) -> dict[str, Any]:
    hidden = HIDDEN[label]
    with tempfile.TemporaryDirectory() as folder:
        four, flown = flights_of(kind, row, hidden, seed, Path(folder))
    began = time.perf_counter()
    made: dict[str, Any] = {
        "kind": kind.name,
        "row": row.title,
        "hidden": label,
        "seed": seed,
        "present": present(flown, PLANES[hidden.plane]),
    }
    try:
        result = run_gap(
            load_model(hidden.plane, flown[0].craft), four[:3], four[3:], options=Options(seed=1, nulls=nulls)
        )
    except UserError as error:
        return {
            **made,
            "verdict": "error",
            "steps": [],
            "cannot": [],
            "text": str(error),
            "s": round(time.perf_counter() - began, 1),
        }
    return {
        **made,
        "verdict": result.verdict.value,
        "steps": [
            {
                "effect": s.effect,
                "set": {m.effect: round(m.weight, 2) for m in s.members},
                "score": round(s.score, 1),
                "threshold": round(s.threshold, 2),
                "estimates": {n: [float(f"{x:.3g}") for x in v] for n, v in s.estimates.items()},
                "held": None if s.holdout is None else round(s.holdout.closed, 2),
                "form": s.form,
            }
            for s in result.steps
        ],
        "rejected": [[r.effect, r.why] for r in result.rejected if "too small" not in r.why][:6],
        "cannot": [e["effect"] for e in result.details["cannot_tell"]],
        "text": result.text,
        "s": round(time.perf_counter() - began, 1),
    }


def one_line(r: Mapping[str, Any]) -> str:
    steps = " ".join(f"{s['effect']}({s['score']}/{s['threshold']} {s['held']})" for s in r["steps"])
    return f"{judged(r):7s} {r['kind']:7s} {r['row'][:36]:36s} {r['hidden']:10s} {r['verdict']:14s} {steps} {r['s']}s"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", nargs="*", type=int, default=list(range(len(ROWS))))
    parser.add_argument("--hidden", nargs="*", default=list(HIDDEN))
    parser.add_argument("--kinds", nargs="*", default=[k.name for k in KINDS])
    parser.add_argument("--nulls", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("build/gap_gallery.jsonl"))
    a = parser.parse_args()
    a.out.parent.mkdir(parents=True, exist_ok=True)
    for label in a.hidden:
        for n in a.rows:
            for kind in KINDS:
                if kind.name in a.kinds:
                    row = outcome(kind, ROWS[n], label, a.seed, a.nulls)
                    with a.out.open("a", encoding="utf-8") as handle:
                        handle.write(json.dumps(row) + "\n")
                    print(one_line(row), flush=True)


if __name__ == "__main__":
    main()
