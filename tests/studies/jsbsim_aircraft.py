"""JSBSim's aircraft identified blind: what it flies, what `estimate` makes of it, and its own derivatives beside.

    python -m tests.studies.jsbsim_aircraft [--seeds N] [NAME...]

Each aircraft glides with its engine off at a lift coefficient of 0.4. Its motion is linearised by central differences of JSBSim's
own accelerations, and manoeuvres are made for that: pulses of the pace of the mode that they excite, as large as a few degrees of
flow angles allow. One flight is of aileron and rudder, one of the elevator, sampled with the noise of flight-test instruments.
`estimate --structure auto` is given the flight, mass, inertia and geometry, and nothing else.

Truth: slopes of JSBSim's forces and moments at fifteen places of the flight, by central differences of states that it has stepped
on by 20 microseconds, so that what goes with the rate of the angle of attack is in them as it is in a flight: the models here
have no such term. A slope of a curve is a range: it reaches from the least to the greatest of these and of the straight line
through the coefficients of the flight without noise. What mean slopes leave of those says how linear the aircraft is.
The table is kept in docs/validation/jsbsim.csv, its sums in jsbsim.md.
"""

import argparse
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import StateSpace, lsim

from estimation.aircraft import Aircraft
from estimation.models import load_model
from estimation.session import runner
from estimation.session.structured import StructureWish
from groundstation.flight import Flight
from tests.support.gallery.aircraft import (
    FOOT,
    OWN,
    POUND,
    RATE,
    SLUG,
    Array,
    executive,
    glide,
    properties,
    put_surfaces,
    set_state,
)  # fmt: skip
from tests.support.gallery.records import DEG, NOISE, SEEN, SERVO, _seen

LIFT, GRAVITY = 0.4, 9.80665
PLACES = 15
LINEAR = 0.02
"""Rms of what slopes leave of a coefficient over its own, up to which a plane of an aircraft counts as linear."""
STRAY = 0.15
"""Share of the speed of the glide within which a flight has to stay."""
INSIDE = 1.96
"""Bounds, of 95 %."""
PEAKS = {"beta": 4 * DEG, "phi": 20 * DEG, "alpha": 2 * DEG, "theta": 8 * DEG}
TRAVEL = 10 * DEG
"""Largest motion and deflection of a manoeuvre: small enough for derivatives, many times the instruments' noise."""


@dataclass(frozen=True)
class Plane:
    """States and surfaces that a model is about, its coefficients with the length of their rates, and what they are slopes of."""

    model: str
    states: tuple[str, ...]
    surfaces: tuple[str, ...]
    coefficients: Mapping[str, str]
    regressors: Mapping[str, str]


LATERAL = Plane(
    "lateral",
    ("beta", "p", "r", "phi"),
    ("delta_a", "delta_r"),
    {"CY": "b", "Cl": "b", "Cn": "b"},
    {"beta": "beta", "p": "p", "r": "r", "da": "delta_a", "dr": "delta_r"},
)
PITCHING = Plane(
    "longitudinal",
    ("alpha", "q", "theta"),
    ("delta_e",),
    {"CL": "c", "Cm": "c"},
    {"alpha": "alpha", "q": "q", "de": "delta_e"},
)
PLANES = (LATERAL, PITCHING)
STEP = {"V": 0.5, "alpha": 0.005, "beta": 0.005, "phi": 0.01, "theta": 0.01, "p": 0.02, "q": 0.02, "r": 0.02,
        "delta_e": 0.005, "delta_a": 0.005, "delta_r": 0.005}  # fmt: skip
SURFACES = ("delta_e", "delta_a", "delta_r")
RATES = ("p", "q", "r")
SHORT = 1e-5  # s, of the two steps after which a force knows the rate of the angle of attack


def put(fdm: Any, state: Mapping[str, float]) -> None:
    """JSBSim in a state, with the rates of change that belong to it."""
    rates = np.array([state[n] for n in RATES])
    surfaces = np.array([state[n] for n in SURFACES])
    set_state(fdm, state["V"], state["alpha"], state["beta"], state["theta"], state["phi"], rates, surfaces)
    fdm.set_dt(SHORT)
    fdm.run()
    fdm.run()
    fdm.set_dt(1.0 / RATE)


def coefficients(fdm: Any, shape: Mapping[str, float]) -> dict[str, float]:
    """CL CY Cl Cm Cn of all forces but weight, body axes but for lift."""
    speed, alpha = fdm["velocities/vt-fps"] * FOOT, fdm["aero/alpha-rad"]
    pressure = 0.5 * fdm["atmosphere/rho-slugs_ft3"] * SLUG / FOOT**3 * speed**2 * shape["area"]
    x, y, z = (fdm[f"forces/fb{n}-total-lbs"] * POUND / pressure for n in "xyz")
    roll, pitch, yaw = (fdm[f"moments/{n}-total-lbsft"] * POUND * FOOT / pressure for n in "lmn")
    return {
        "CL": x * np.sin(alpha) - z * np.cos(alpha), "CY": y,
        "Cl": roll / shape["span"], "Cm": pitch / shape["chord"], "Cn": yaw / shape["span"],
    }  # fmt: skip


def lengths(plane: Plane, shape: Mapping[str, float], speed: float) -> dict[str, float]:
    """State -> what makes it non-dimensional."""
    length = shape["chord"] if plane is PITCHING else shape["span"]
    return {n: length / (2.0 * speed) if n in RATES else 1.0 for n in plane.regressors.values()}


def slopes(fdm: Any, plane: Plane, state: Mapping[str, float], shape: Mapping[str, float]) -> dict[str, float]:
    """Derivatives at a state."""
    by, unit = {}, lengths(plane, shape, state["V"])
    for ending, name in plane.regressors.items():
        sides = []
        for sign in (1.0, -1.0):
            put(fdm, {**state, name: state[name] + sign * STEP[name]})
            sides.append(coefficients(fdm, shape))
        for c in plane.coefficients:
            by[f"{c}_{ending}"] = (sides[0][c] - sides[1][c]) / (2.0 * STEP[name] * unit[name])
    return by


def linearised(fdm: Any, plane: Plane, trim: Mapping[str, float]) -> tuple[Array, Array]:
    """A, B of the plane's states and surfaces about the trim, by JSBSim's own rates of change."""

    def change(state: Mapping[str, float]) -> Array:
        put(fdm, state)
        u, w, v = (fdm[f"velocities/{n}-fps"] * FOOT for n in "uwv")
        ud, wd, vd = (fdm[f"accelerations/{n}dot-ft_sec2"] * FOOT for n in "uwv")
        flow = {
            "alpha": (u * wd - w * ud) / (u * u + w * w),
            "beta": vd / state["V"] - v * (u * ud + v * vd + w * wd) / state["V"] ** 3,
        }
        turn = {n: fdm[f"accelerations/{n}dot-rad_sec2"] for n in RATES}
        attitude = {"phi": state["p"] + np.tan(state["theta"]) * state["r"], "theta": state["q"]}
        rates = {**flow, **turn, **attitude}
        return np.array([rates[n] for n in plane.states])

    columns = []
    for name in (*plane.states, *plane.surfaces):
        high, low = ({**trim, name: trim[name] + s * STEP[name]} for s in (1.0, -1.0))
        columns.append((change(high) - change(low)) / (2.0 * STEP[name]))
    both = np.column_stack(columns)
    return both[:, : len(plane.states)], both[:, len(plane.states) :]


@dataclass(frozen=True)
class Manoeuvre:
    """What is flown. added: (3, steps) deflections beside trim and feedback; gain: (surfaces, states) of the pilot."""

    added: Array
    gain: Array
    duration: float
    rate: int


def manoeuvre(plane: Plane, a: Array, b: Array, rng: np.random.Generator) -> Manoeuvre:
    """Doublets and 3-2-1-1 of the pace of the oscillation, scaled on the linear motion."""
    gain = pilot(plane, a, b)
    closed = a - b @ gain
    poles = np.linalg.eigvals(a)
    frequency = max(np.abs(poles[np.abs(poles.imag) > 0.1]), default=0.5 * np.abs(poles).max())
    pace = float(np.clip(1.3 / frequency, 0.3, 1.6))
    duration = float(np.clip(45.0 * pace, 24.0, 64.0))
    rate = 50 if np.abs(poles).max() > 5.0 or pace < 0.5 else 25
    steps = round(duration * RATE) + 1
    time, unit = np.arange(steps) / RATE, np.zeros((len(plane.surfaces), steps))
    start = 1.0
    patterns = ((1, 1), (1.5, 1, 0.5, 0.5), (0.6, 0.6), (1.2, 1.2))
    k = 0
    while start < duration - 5 * pace:
        row, widths = k % len(unit), patterns[(k // len(unit)) % len(patterns)]
        sign, scale, size = rng.choice((-1.0, 1.0)), pace * rng.uniform(0.9, 1.1), rng.uniform(0.7, 1.0)
        for width in widths:
            unit[row, (time >= start) & (time < start + width * scale)] += sign * size
            start, sign = start + width * scale, -sign
        start, k = start + 2.0 * pace, k + 1
    added = np.zeros((3, steps))
    for row, surface in enumerate(plane.surfaces):
        alone = np.zeros_like(unit)
        alone[row] = unit[row]
        motion = np.asarray(lsim(StateSpace(closed, b, np.eye(len(a)), np.zeros_like(b)), alone.T, time)[1])
        reached = {n: np.abs(motion[:, i]).max() for i, n in enumerate(plane.states) if n in PEAKS}
        added[SURFACES.index(surface)] = min(TRAVEL, *(PEAKS[n] / v for n, v in reached.items() if v > 0)) * unit[row]
    return Manoeuvre(added, gain, duration, rate)


SLOW = 0.15
"""1/s: what grows more slowly, a pilot leaves alone for the seconds of a manoeuvre."""


def pilot(plane: Plane, a: Array, b: Array) -> Array:
    """(surfaces, states) of a pilot who keeps wings and nose where they were with as little as that takes: the regulator of
    least deflection, held where the airframe by itself is stable."""
    from scipy.linalg import solve_continuous_are

    shifted = a + SLOW * np.eye(len(a))
    weight = np.diag([0.02 if n in ("phi", "theta") else 0.0 for n in plane.states]) + 1e-6 * np.eye(len(a))
    riccati = solve_continuous_are(shifted, b, weight, np.eye(b.shape[1]))
    return np.asarray(b.T @ riccati)


@dataclass(frozen=True)
class Flown:
    """A flight without noise, the aircraft as a person would write it down, and its derivatives along the flight (places,).
    secants: of the straight line through the flight; nonlinear: the largest share of a coefficient that mean slopes leave."""

    columns: Mapping[str, Array]
    craft: Aircraft
    along: Mapping[str, Array]
    secants: Mapping[str, float]
    nonlinear: float

    def error(self, name: str, estimate: float) -> float:
        """Distance of an estimate from the range of a derivative."""
        values = np.append(self.along[name], self.secants[name])
        return estimate - float(np.clip(estimate, values.min(), values.max()))

    def error_of_mean(self, name: str, estimate: float) -> float:
        """Distance of an estimate from the mean slope."""
        return estimate - float(np.mean(self.along[name]))


def fly(name: str, plane: Plane, folder: Path, seed: int) -> Flown:
    """One flight of one plane."""
    rng = np.random.default_rng([seed, 20261127])
    fdm = executive(name, folder)
    fdm.run_ic()  # inertia is zero before
    shape = properties(fdm)
    speed = float(np.sqrt(2.0 * shape["mass"] * GRAVITY / (1.03 * shape["area"] * LIFT)))
    x = glide(fdm, speed)
    trim = {"V": speed, "alpha": x[0], "beta": 0.0, "theta": x[1], "phi": x[2], "p": 0.0, "q": 0.0, "r": 0.0,
            "delta_e": x[3], "delta_a": x[4], "delta_r": x[5]}  # fmt: skip
    plan = manoeuvre(plane, *linearised(fdm, plane, trim), rng)
    set_state(fdm, speed, x[0], 0.0, x[1], x[2], np.zeros(3), x[3:])
    rows = np.array(list(_steps(fdm, plane, plan, trim)))
    columns = dict(zip((*SEEN, *plane.coefficients), rows.T, strict=True))
    strays = np.abs(columns["V"] / speed - 1.0).max() > STRAY
    if not np.isfinite(rows).all() or strays or max(np.abs(columns[n]).max() for n in ("phi", "theta")) > 1.0:
        raise RuntimeError(f"{name} does not stay near its glide")
    places = np.linspace(0, len(rows) - 1, PLACES).astype(int)
    each = [slopes(fdm, plane, {n: columns[n][k] for n in trim}, shape) for k in places]
    along = {n: np.array([s[n] for s in each]) for n in each[0]}
    craft = Aircraft(name.lower(), **shape)
    return Flown(columns, craft, along, *_along_the_flight(plane, columns, along, shape))


def _steps(fdm: Any, plane: Plane, plan: Manoeuvre, trim: Mapping[str, float]) -> Iterator[list[float]]:
    """Rows of the flight at its rate, with the plane's coefficients behind them."""
    shape = properties(fdm)
    neutral = np.array([trim[n] for n in SURFACES])
    rows = [SURFACES.index(n) for n in plane.surfaces]
    words = {"alpha": "aero/alpha-rad", "beta": "aero/beta-rad", "phi": "attitude/phi-rad", "theta": "attitude/theta-rad",
             **{n: f"velocities/{n}-rad_sec" for n in RATES}}  # fmt: skip
    surfaces = neutral.copy()
    for k in range(plan.added.shape[1]):
        off = np.array([fdm[words[n]] - trim[n] for n in plane.states])
        wanted = neutral + plan.added[:, k]
        wanted[rows] -= plan.gain @ off
        if k % (RATE // plan.rate) == 0:
            yield [*_seen(fdm, k, surfaces), *(coefficients(fdm, shape)[c] for c in plane.coefficients)]
        surfaces = surfaces + (wanted - surfaces) / (SERVO * RATE)
        put_surfaces(fdm, *surfaces)
        fdm.run()


def _along_the_flight(
    plane: Plane, columns: Mapping[str, Array], along: Mapping[str, Array], shape: Mapping[str, float]
) -> tuple[dict[str, float], float]:
    """Slopes of the straight line through the flight, and the largest share of a coefficient's motion that mean slopes leave."""
    unit = lengths(plane, shape, float(np.mean(columns["V"])))
    motion = np.column_stack([columns[n] * unit[n] for n in plane.regressors.values()])
    motion -= motion.mean(axis=0)
    secants: dict[str, float] = {}
    worst = 0.0
    for c in plane.coefficients:
        names = [f"{c}_{ending}" for ending in plane.regressors]
        line = np.linalg.lstsq(motion, columns[c] - columns[c].mean(), rcond=None)[0]
        secants |= dict(zip(names, line.tolist(), strict=True))
        rest = columns[c] - motion @ np.array([np.mean(along[n]) for n in names])
        worst = max(worst, float(np.std(rest) / np.std(columns[c])))
    return secants, worst


def recorded(flown: Flown, name: str, seed: int) -> Flight:
    """The flight as flight-test instruments recorded it."""
    rng = np.random.default_rng([seed, 7])
    names = [n for n in SEEN if not n.endswith("_dot")]
    noisy = {n: flown.columns[n] + NOISE.get(n, 0.0) * rng.standard_normal(flown.columns[n].size) for n in names}
    time = noisy.pop("time")
    noisy["thrust"] = np.zeros_like(time)
    return Flight.build(f"{name}_{seed}", time, noisy)


@dataclass(frozen=True)
class Outcome:
    """What `estimate` made of a flight. errors, strict: derivative that is told -> bounds from its range, from its mean slope;
    untold: those it cannot tell; added: to the model, as the flight asked; recommended: method; lacks: what it says the model
    lacks, or what else is wrong, where nothing is recommended."""

    name: str
    plane: str
    flown: Flown
    errors: Mapping[str, float]
    strict: Mapping[str, float]
    untold: tuple[str, ...]
    added: tuple[str, ...]
    recommended: str
    lacks: str

    @property
    def linear(self) -> bool:
        return self.flown.nonlinear <= LINEAR

    @property
    def line(self) -> str:
        """A row of the table."""
        inside = sum(abs(e) <= INSIDE for e in self.errors.values())
        worst = max(self.errors.items(), key=lambda item: abs(item[1]), default=("-", 0.0))
        craft, speed = self.flown.craft, float(np.mean(self.flown.columns["V"]))
        return (
            f"| {self.name} | {craft.mass:.0f} | {speed:.0f} | {self.plane} | {100 * self.flown.nonlinear:.1f} | "
            f"{len(self.errors)} | {len(self.untold)} | {inside} | {worst[0]} {worst[1]:+.1f} "
            f"| {', '.join(self.added)} | {self.recommended or 'none'} | {self.lacks} |"
        )


HEAD = (
    "| aircraft | kg | m/s | model | curved, % | told | not told | inside 95 % | farthest, bounds "
    "| added | recommended | because |\n|---|---|---|---|---|---|---|---|---|---|---|---|"
)


def identified(name: str, plane: Plane, folder: Path, seed: int) -> Outcome:
    """Fly it and hand it to `estimate --structure auto`."""
    flown = fly(name, plane, folder, seed)
    model, flight = load_model(plane.model, flown.craft), recorded(flown, name, seed)
    session = runner.estimate(model, [flight], flown.craft, ("ml",), structure=StructureWish.AUTO)
    one = session.flights[0]
    assert one.verdict is not None
    assert one.structure is not None
    result, recommendation = one.results["ml"], one.verdict.recommended
    estimates = {n: e for n, e in result.parameters.items() if n in flown.along}
    told = {n: e for n, e in estimates.items() if e.identifiable and result.converged}
    by_range = {n: flown.error(n, e.estimate) / e.std_coloured for n, e in told.items()}
    by_mean = {n: flown.error_of_mean(n, e.estimate) / e.std_coloured for n, e in told.items()}
    recommended = recommendation.method != "none"
    because = "" if recommended else ", ".join(recommendation.lacks) or reason_of(recommendation.why)
    return Outcome(
        name, plane.model, flown, by_range, by_mean, tuple(sorted(set(estimates) - set(told))),
        one.structure.added, recommendation.method if recommended else "", because,
    )  # fmt: skip


def reason_of(why: str) -> str:
    """The first reason of a sentence, without the method and the aircraft's name before it."""
    return re.sub(r"^(\w+: )?(aircraft [^:]*: )?", "", why).split(" (")[0].split(";")[0]


def shares(title: str, outcomes: Sequence[Outcome]) -> str:
    """One line of the summary."""
    errors, strict = ([abs(e) for o in outcomes for e in getattr(o, kind).values()] for kind in ("errors", "strict"))
    untold = sum(len(o.untold) for o in outcomes)
    craft = len({o.name for o in outcomes})
    if not errors:
        return f"| {title} | {craft} | {len(outcomes)} | 0 | {untold} | - | - |"
    inside, of_mean = (f"{100 * np.mean(np.array(e) <= INSIDE):.0f} %" for e in (errors, strict))
    return f"| {title} | {craft} | {len(outcomes)} | {len(errors)} | {untold} | {inside} | {of_mean} |"


def summary(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """How many derivatives are inside, by what the aircraft are and what was recommended."""
    yield "| flights | aircraft | flights | told | not told | inside 95 % | of mean slopes |\n|---|---|---|---|---|---|---|"
    straight, curved = ([o for o in outcomes if o.linear is linear] for linear in (True, False))
    for kind, members in (("linear", straight), ("curved", curved)):
        for plane in PLANES:
            of_plane = [o for o in members if o.plane == plane.model]
            yield shares(f"{kind}, {plane.model}, recommended", [o for o in of_plane if o.recommended])
            yield shares(f"{kind}, {plane.model}, nothing recommended", [o for o in of_plane if not o.recommended])
    yield shares("linear, all", straight)
    yield shares("linear, recommended", [o for o in straight if o.recommended])


def names_of_aircraft() -> list[str]:
    """All that come with JSBSim."""
    return sorted((p.name for p in (OWN / "aircraft").iterdir() if (p / f"{p.name}.xml").exists()), key=str.lower)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="aircraft (all)")
    parser.add_argument("--seeds", type=int, default=1, help="flights of each")
    options = parser.parse_args()
    outcomes: list[Outcome] = []
    refused: list[str] = []
    print(HEAD, flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for name in options.names or names_of_aircraft():
            for plane in PLANES:
                for seed in range(1, options.seeds + 1):
                    try:
                        outcomes.append(identified(name, plane, Path(folder), seed))
                    except (RuntimeError, np.linalg.LinAlgError) as reason:
                        refused.append(f"{name}, {plane.model}: {reason}")
                        continue
                    print(outcomes[-1].line, flush=True)
    print("", *summary(outcomes), "", "Not flown:", *(f"- {r}" for r in refused), sep="\n")


if __name__ == "__main__":
    main()
