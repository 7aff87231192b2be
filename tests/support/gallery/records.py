"""Flights of the gallery: hand-flown lateral manoeuvres in a glide, gusts, and what awkward instruments make of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from estimation.aircraft import Aircraft
from groundstation.flight import Flight
from tests.support.gallery.aircraft import (
    FOOT,
    POUND,
    RATE,
    SLUG,
    Array,
    Kind,
    executive,
    glide,
    lateral_derivatives,
    properties,
    put_surfaces,
)

DEG = np.pi / 180
SERVO = 0.04  # s
NOISE: Mapping[str, float] = {
    "p": 0.15 * DEG, "q": 0.15 * DEG, "r": 0.1 * DEG, "phi": 0.1 * DEG, "theta": 0.1 * DEG, "psi": 0.2 * DEG, "alpha": 0.15 * DEG,
    "beta": 0.15 * DEG, "V": 0.2, "ax": 0.03, "ay": 0.03, "az": 0.05,
    "delta_e": 0.04 * DEG, "delta_a": 0.04 * DEG, "delta_r": 0.04 * DEG,
}  # fmt: skip
BOOM, AHEAD = 0.5, 0.08
"""Vanes and accelerometer ahead of the CG, in spans."""
FULL_SCALE: Mapping[str, float] = {
    "p": 2.0, "q": 2.0, "r": 2.0, "phi": np.pi, "theta": np.pi / 2, "alpha": 0.5, "beta": 0.5, "V": 256.0, "ax": 20.0, "ay": 20.0,
    "az": 40.0, "delta_e": 0.6, "delta_a": 0.6, "delta_r": 0.6,
}  # fmt: skip


@dataclass(frozen=True)
class Flown:
    """One flight: the exact columns at the centre of gravity, the aircraft as a person would write it down, true derivatives.
    deflections: what the surfaces did, where something else is recorded for it."""

    kind: Kind
    columns: Mapping[str, Array]
    craft: Aircraft
    truth: Mapping[str, float]
    deflections: Mapping[str, Array] = field(default_factory=dict)


def fly(
    kind: Kind,
    folder: Path,
    seed: int,
    *,
    rate: int,
    gust: float = 0.0,
    duration: float = 30.0,
    rest: bool = False,
    pitching: float = 0.0,
    all_axes: bool = False,
    commands: bool = False,
) -> Flown:
    """Columns at `rate` [Hz], without noise. gust: rms [m/s] of side and vertical gusts; rest: the rudder never moves; pitching:
    peaks of the elevator [rad], in place of aileron and rudder, or with all_axes between theirs; commands: what servos are told
    is recorded for what they do."""
    rng = np.random.default_rng([seed, 20261123])
    fdm, steps = executive(kind.name, folder), round(duration * RATE) + 1
    trim = glide(fdm, kind.speed)
    surfaces, level = trim[3:].copy(), float(trim[1])
    added = _pilot(kind, rng, steps, rest, pitching, all_axes)
    air = _gusts(gust, kind.speed, rng, steps)
    rows, moved = [], []
    for k in range(steps):
        phi, theta = fdm["attitude/phi-rad"], fdm["attitude/theta-rad"]
        p, q = fdm["velocities/p-rad_sec"], fdm["velocities/q-rad_sec"]
        hold = np.array([0.15 * (theta - level) + 0.1 * q, 0.15 * phi + 0.02 * p, 0.0])
        wanted = trim[3:] + added[:, k] + hold
        if k % (RATE // rate) == 0:
            rows.append(_seen(fdm, k, wanted if commands else surfaces))
            moved.append(surfaces)
        surfaces = surfaces + (wanted - surfaces) / (SERVO * RATE)
        if rest:
            surfaces[2] = trim[5]
        put_surfaces(fdm, *surfaces)
        _blow(fdm, air[:, k])
        fdm.run()
    columns = {n: v.copy() for n, v in zip(SEEN, np.array(rows).T, strict=True)}
    shape = properties(fdm)
    truth = lateral_derivatives(fdm, columns, np.linspace(0, len(rows) - 1, 7).astype(np.int64))
    deflections = dict(zip(("delta_e", "delta_a", "delta_r"), np.array(moved).T, strict=True))
    return Flown(kind, columns, Aircraft(kind.name.lower(), **shape), truth, deflections)


def _pilot(
    kind: Kind, rng: np.random.Generator, steps: int, rest: bool, pitching: float = 0.0, all_axes: bool = False
) -> Array:
    """(3, steps) added elevator, aileron, rudder: doublets and 3-2-1-1 of the aircraft's own pace, no two alike."""
    u, t = np.zeros((3, steps)), np.arange(steps) / RATE
    at = 1.5
    patterns = [
        (1, (1, 1)),
        (2, (1.2, 1.2)),
        (1, (1.5, 1, 0.5, 0.5)),
        (2, (1.8, 1.2, 0.6, 0.6)),
        (1, (0.7, 0.7)),
        (2, (0.8, 0.8)),
    ]
    if all_axes:  # an elevator input after each of the others
        patterns = [p for row, widths in patterns for p in ((row, widths), (0, widths))]
    for row, widths in patterns * 3:
        peak = (kind.aileron if row == 1 else kind.rudder) * rng.uniform(0.7, 1.0)
        if row == 0 or (pitching > 0.0 and not all_axes):
            row, peak = 0, pitching * rng.uniform(0.5, 1.0)
        sign, scale = rng.choice((-1.0, 1.0)), kind.pace * rng.uniform(0.9, 1.1)
        for width in widths:
            if not (rest and row == 2):
                u[row, (t >= at) & (t < at + width * scale)] += sign * peak
            at, sign = at + width * scale, -sign
        at += 2.0 * kind.pace
    return u


def _gusts(rms: float, speed: float, rng: np.random.Generator, steps: int) -> Array:
    """(2, steps) side and vertical gust [m/s]: first-order Markov, 150 m of air long."""
    out, keep = np.zeros((2, steps)), float(np.exp(-speed / (150.0 * RATE)))
    for k in range(1, steps):
        out[:, k] = keep * out[:, k - 1] + rms * np.sqrt(1.0 - keep**2) * rng.standard_normal(2)
    return out


def _blow(fdm: Any, gust: Array) -> None:
    psi = fdm["attitude/psi-rad"]
    fdm["atmosphere/gust-north-fps"] = -np.sin(psi) * gust[0] / FOOT
    fdm["atmosphere/gust-east-fps"] = np.cos(psi) * gust[0] / FOOT
    fdm["atmosphere/gust-down-fps"] = gust[1] / FOOT


SEEN = ("time", "V", "alpha", "beta", "p", "q", "r", "phi", "theta", "psi", "ax", "ay", "az", "p_dot", "q_dot", "r_dot",
        "delta_e", "delta_a", "delta_r", "rho")  # fmt: skip


def _seen(fdm: Any, k: int, surfaces: Array) -> list[float]:
    mass = fdm["inertia/mass-slugs"] * SLUG
    return [
        k / RATE,
        fdm["velocities/vt-fps"] * FOOT,
        fdm["aero/alpha-rad"],
        fdm["aero/beta-rad"],
        *(fdm[f"velocities/{n}-rad_sec"] for n in "pqr"),
        *(fdm[f"attitude/{n}-rad"] for n in ("phi", "theta", "psi")),
        *(fdm[f"forces/fb{n}-total-lbs"] * POUND / mass for n in "xyz"),
        *(fdm[f"accelerations/{n}dot-rad_sec2"] for n in "pqr"),
        *surfaces,
        fdm["atmosphere/rho-slugs_ft3"] * SLUG / FOOT**3,
    ]


Columns = dict[str, Array]


def recorded(flown: Flown, seed: int, change: Callable[[Columns, Flown], Columns] | None = None) -> Flight:
    """The flight as its instruments recorded it: noise, and what `change` does behind it."""
    rng = np.random.default_rng([seed, 7])
    exact = dict(flown.columns)
    if change is on_a_boom:
        exact = on_a_boom(exact, flown)
    noisy = {n: v + NOISE.get(n, 0.0) * rng.standard_normal(v.size) for n, v in exact.items() if not n.endswith("_dot")}
    if change is not None and change is not on_a_boom:
        noisy = change(noisy, flown)
    time = noisy.pop("time")
    step = float(np.median(np.diff(time)))
    segment = np.concatenate([[0], np.cumsum(np.diff(time) > 2.0 * step)]).astype(float)
    flight = Flight.build(f"{flown.kind.name}_{seed}", time, noisy, segment=segment if segment[-1] else None)
    return replace(flight, provenance=replace(flight.provenance, aircraft=flown.craft.name))


def quantised(columns: Columns, flown: Flown) -> Columns:
    """Twelve bits over each instrument's range."""
    steps = {n: 2.0 * FULL_SCALE[n] / 4096.0 for n in columns if n in FULL_SCALE}
    return {n: np.round(v / steps[n]) * steps[n] if n in steps else v for n, v in columns.items()}


def slow(columns: Columns, flown: Flown) -> Columns:
    """Attitude, heading and airspeed at 5 Hz, repeated until the next value."""
    step = round(0.2 / float(columns["time"][1] - columns["time"][0]))
    held = np.arange(columns["time"].size) // step * step
    return {n: v[held] if n in ("phi", "theta", "psi", "V") else v for n, v in columns.items()}


def with_a_gap(columns: Columns, flown: Flown) -> Columns:
    """Six seconds in the middle were not recorded, and thirty more passed."""
    time = columns["time"]
    kept = (time < 0.4 * time[-1]) | (time > 0.4 * time[-1] + 6.0)
    out = {n: v[kept] for n, v in columns.items()}
    out["time"] = np.where(out["time"] > 0.4 * time[-1], out["time"] + 30.0, out["time"])
    return out


def on_a_boom(columns: Columns, flown: Flown) -> Columns:
    """Vanes on a boom half a span ahead of the CG, accelerometer 8 % of a span ahead of it."""
    vane, imu = BOOM * flown.craft.span, AHEAD * flown.craft.span
    c = columns
    body = c["V"] * np.array(
        [np.cos(c["alpha"]) * np.cos(c["beta"]), np.sin(c["beta"]), np.sin(c["alpha"]) * np.cos(c["beta"])]
    )
    u, v, w = body[0], body[1] + c["r"] * vane, body[2] - c["q"] * vane
    return {
        **c,
        "alpha": np.arctan2(w, u),
        "beta": np.arctan2(v, np.hypot(u, w)),
        "ax": c["ax"] - (c["q"] ** 2 + c["r"] ** 2) * imu,
        "ay": c["ay"] + (c["r_dot"] + c["p"] * c["q"]) * imu,
        "az": c["az"] + (c["p"] * c["r"] - c["q_dot"]) * imu,
    }


def all_at_once(columns: Columns, flown: Flown) -> Columns:
    """Quantised and slow, with a gap."""
    return with_a_gap(slow(quantised(columns, flown), flown), flown)
