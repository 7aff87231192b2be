"""Airspeed, angle of attack, sideslip and wind of an aircraft without vanes, from GNSS velocity, IMU, attitude and pitot.

Specific force is integrated from fix to fix; wind, gusts and the slow errors of the instruments are states of a Kalman filter and
smoother (`air_filter`). The level of the gusts comes from the likelihood: the pitot measures those along the path, and across
the path, where no instrument measures them, they are assumed as strong. So an uncertainty is that of the true angle, gusts
included.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.utilities.constants import RADIAN, SEA_LEVEL_DENSITY
from estimation.compatibility.air_filter import (
    AGE,
    ATTITUDE,
    GUST,
    INTERVAL,
    STATES,
    VELOCITY,
    WIND,
    Assumptions,
    Noise,
    Smoothed,
    gust_likelihoods,
    smooth_states,
)
from estimation.compatibility.air_nodes import FIX, INERTIAL, AirStretch, fresh_values, measured_noise, stretches_of
from estimation.compatibility.records import attitude_errors
from estimation.errors import DataError
from estimation.prepare.columns import with_derived
from groundstation.flight import RECONSTRUCTED, Array, Flight
from groundstation.flight.airspeed import calibration_error
from groundstation.flight.findings import Finding, FindingKind

AIR = ("alpha", "beta", "V")

MOST_AGE = 1.0  # [s] of a velocity fix: an older one is of another flight condition

GUSTS = (0.1, 0.14, 0.2, 0.28, 0.4, 0.57, 0.8, 1.13, 1.6)
"""Levels of gusts [m/s] that the likelihood weighs, in steps of sqrt(2): from a calm morning near the ground to moderate
turbulence at low height (MIL-F-8785C)."""

LEAST_AIRSPEED_NOISE = 0.1
"""Of an airspeed [m/s], 1 sigma: pneumatics, and gusts shorter than in the filter; a quantised airspeed may show no noise."""
LEAST_FORCE_NOISE = 0.02
"""Of a specific force [m/s2 per root Hz]: vibration and scale errors, which a sensor at rest does not show."""
FAST_ATTITUDE = 0.35
"""Part of an attitude's slow error that comes and goes within a second; see docs/compatibility.md."""


@dataclass(frozen=True)
class AirData:
    """Air data over a flight's samples; NaN outside the stretches that could be reconstructed.

    values, std: alpha, beta [rad], V [m/s] -> (N,); std: 1 sigma of the difference to an ideal vane or pitot. wind, wind_std:
    (3,) mean over the flight, NED [m/s]. gust: level [m/s]. scatter: rms innovation in sigmas, by kind of measurement. airspeed:
    the columns that it comes from.
    """

    values: Mapping[str, Array]
    std: Mapping[str, Array]
    wind: Array
    wind_std: Array
    gust: float
    scatter: Mapping[str, float]
    airspeed: str
    notes: tuple[str, ...]

    def typical(self, name: str) -> float:
        """Root-mean-square uncertainty of alpha, beta [rad] or V [m/s]."""
        return float(np.sqrt(np.nanmean(self.std[name] ** 2)))


WORTH_SAYING = 1.5
"""Scatter of innovations that a note reports: the assumed noises are right to about a factor of two."""

GUSTS_UNSEEN = (
    "gusts across the path are not in reconstructed angles: estimate with ml; ls and fem take the angles as exact"
)

USUAL = Assumptions()


def reconstruct_air(flight: Flight, assumed: Assumptions = USUAL) -> AirData:
    """Air data of a flight with ax..az, p..r, phi, theta, psi, vn, ve, vd and an airspeed or dynamic pressure.

    Vanes are not used. Raises MissingColumnError naming what is missing, DataError where nothing can be reconstructed.
    """
    flight.require((*INERTIAL, *FIX), "the reconstruction of air data")
    airspeed, origin = airspeed_of(flight)
    assumed = replace(
        assumed, airspeed_scale=calibration_error(flight.provenance.detail, airspeed) or assumed.airspeed_scale
    )
    stretches, notes = stretches_of(flight, airspeed)
    noise = _noise(flight, airspeed, assumed)
    nodes = [s.nodes for s in stretches]
    wind = _first_wind(stretches)
    gust = _expected_gust(gust_likelihoods(nodes, noise, GUSTS, assumed, wind))
    smoothed = smooth_states(nodes, noise, gust, assumed, wind)
    # an old fix belongs to the motion at that time, which the linear state AGE does not describe in a roll of 2 rad/s
    age = float(np.clip(smoothed.states[-1, AGE], -MOST_AGE, MOST_AGE))
    stretches, _ = stretches_of(flight, airspeed, age)
    nodes = [s.nodes for s in stretches]
    gust = _expected_gust(gust_likelihoods(nodes, noise, GUSTS, assumed, wind))
    smoothed = smooth_states(nodes, noise, gust, assumed, wind)
    values, std = _air(flight, stretches, smoothed, noise)
    widened = max(1.0, *(v for kind, v in smoothed.scatter.items() if kind != "sideslip"))
    if widened > WORTH_SAYING:
        notes.append(
            f"velocity fixes and airspeed disagree by {widened:.1f} times what their noise explains: all uncertainties are "
            "that much wider; check times of arrival, units and the IMU's mounting"
        )
    states, covariance = smoothed.states[:, WIND], smoothed.covariances[:, WIND, WIND]
    return AirData(
        values,
        {n: s * widened for n, s in std.items()},
        states.mean(axis=0),
        widened * np.sqrt(np.diagonal(covariance, axis1=1, axis2=2).mean(axis=0)),
        gust,
        smoothed.scatter,
        origin,
        tuple(notes),
    )


def airspeed_of(flight: Flight) -> tuple[Array, str]:
    """(N,) true airspeed [m/s] and its columns: V, else dynamic pressure or calibrated airspeed with the density.

    Raises DataError where there is none.
    """
    if flight.measured("V"):
        return flight["V"], "V"
    with_density = with_derived(flight, ["rho"])
    rho, source = (
        (with_density["rho"], "rho")
        if with_density.measured("rho")
        else (np.full(len(flight), SEA_LEVEL_DENSITY), "sea-level density")
    )
    if flight.measured("p_dynamic"):
        return np.sqrt(2.0 * np.maximum(flight["p_dynamic"], 0.0) / rho), f"p_dynamic and {source}"
    if flight.measured("V_cas"):
        return flight["V_cas"] * np.sqrt(SEA_LEVEL_DENSITY / rho), f"V_cas and {source}"
    raise DataError(
        f"{flight.name}: no airspeed (V, p_dynamic or V_cas); without a pitot wind and airspeed cannot be told apart here"
    )


def with_air(flight: Flight, air: AirData) -> Flight:
    """The flight with the reconstructed V, and with the reconstructed alpha and beta where no vane measured them.

    Adds columns alpha_std, beta_std, V_std (1 sigma) and wind_n, wind_e, wind_d [m/s]; a measured V becomes `V_measured`.
    """
    filled = [n for n in AIR if n == "V" or not flight.measured(n)]
    columns = {n: air.values[n] for n in filled} | {f"{n}_std": air.std[n] for n in filled}
    if flight.measured("V"):
        columns["V_measured"] = flight["V"]
    for axis, value in zip("ned", air.wind, strict=True):
        columns[f"wind_{axis}"] = np.where(np.isfinite(air.values["V"]), value, np.nan)
    detail = dict(flight.provenance.detail)
    typical = {n: air.typical(n) for n in filled}
    detail[RECONSTRUCTED] = {
        "columns": filled,
        "std": typical,
        "wind": air.wind.tolist(),
        "wind_std": air.wind_std.tolist(),
        "gust": air.gust,
        "from": [*INERTIAL, *FIX, air.airspeed],
    }
    uncertainty = detail.get("uncertainty")
    detail["uncertainty"] = {**(uncertainty if isinstance(uncertainty, dict) else {}), **typical}
    names = ", ".join(filled)
    note = Finding(
        FindingKind.DERIVED,
        f"{names} reconstructed from velocity fixes, IMU and {air.airspeed}: {air_data_sentence(air, filled)}",
    )
    share = 2.0 * typical["V"] / float(np.nanmedian(air.values["V"]))
    common = f"V off by its uncertainty moves every derivative by {share:.1%}, which the corrected bounds of an estimate count"
    notes: list[Finding | str] = [note, common, *([GUSTS_UNSEEN] if len(filled) > 1 else []), *air.notes]
    provenance = replace(flight.provenance, detail=detail)
    return replace(flight.with_columns(**columns).with_notes(*notes), provenance=provenance)


def air_data_sentence(air: AirData, names: Sequence[str] = AIR) -> str:
    """The uncertainties of a reconstruction, in words."""
    size = {"alpha": (RADIAN, "deg"), "beta": (RADIAN, "deg"), "V": (1.0, "m/s")}
    parts = [f"{n} +- {air.typical(n) * size[n][0]:.2g} {size[n][1]}" for n in names]
    return f"{', '.join(parts)} (1 sigma, gusts of {air.gust:.2g} m/s included)"


def _noise(flight: Flight, airspeed: Array, assumed: Assumptions) -> Noise:
    dt = flight.sample_interval
    rows = np.ones(len(flight), bool)
    force = max(measured_noise(flight, c, rows) for c in ("ax", "ay", "az")) * np.sqrt(dt)
    speeds = fresh_values(flight, "V", airspeed)
    white = measured_noise(flight.with_columns(V=airspeed), "V", speeds)
    interval = float(np.median(np.diff(flight.time[speeds]))) if speeds.sum() > 1 else INTERVAL
    slow = attitude_errors(flight)
    level = max(slow["phi"], slow["theta"], assumed.attitude)
    return Noise(
        float(np.hypot(force, LEAST_FORCE_NOISE)),
        float(np.hypot(white / np.sqrt(max(1.0, INTERVAL / interval)), LEAST_AIRSPEED_NOISE)),
        level,
        max(slow["psi"], assumed.attitude),
    )


def _first_wind(stretches: Sequence[AirStretch]) -> Array:
    """(3,) NED [m/s]: mean ground velocity less airspeed along the nose; vertical wind zero."""
    ground = np.concatenate([s.nodes.velocity + np.nan_to_num(s.nodes.fix) for s in stretches])
    nose = np.concatenate([s.nodes.axes[:, :, 0] for s in stretches])
    speed = np.concatenate([s.nodes.airspeed for s in stretches])
    fixed = np.concatenate([s.nodes.fixes for s in stretches]) > 0
    wind = (ground - nose * speed[:, None])[fixed & np.isfinite(speed)]
    if not len(wind):
        raise DataError("no velocity fix and airspeed at the same time; nothing to tell the wind from")
    return np.array([wind[:, 0].mean(), wind[:, 1].mean(), 0.0])


def _expected_gust(likelihood: Mapping[float, float]) -> float:
    """Root mean square of the level of gusts [m/s] given the flight; a priori all levels are equally likely.

    The mean, not the likeliest level: for a short flight in light turbulence the likeliest may be the least, which would give too
    small uncertainties.
    """
    levels = np.array(sorted(likelihood))
    logs = np.array([likelihood[level] for level in levels])
    weight = np.exp(logs - logs.max())
    return float(np.sqrt(np.sum(weight * levels**2) / weight.sum()))


def _air(
    flight: Flight, stretches: Sequence[AirStretch], smoothed: Smoothed, noise: Noise
) -> tuple[dict[str, Array], dict[str, Array]]:
    """alpha, beta, V and their uncertainties (N,) from the smoothed states."""
    values = {n: np.full(len(flight), np.nan) for n in AIR}
    std = {n: np.full(len(flight), np.nan) for n in AIR}
    first = 0
    for stretch in stretches:
        nodes = slice(first, first + len(stretch.nodes.time))
        first = nodes.stop
        time = flight.time[stretch.rows]
        middle = stretch.nodes.time

        def at_samples(x: Array, middle: Array = middle, time: Array = time) -> Array:
            return np.column_stack([np.interp(time, middle, c) for c in x.T])

        x = at_samples(smoothed.states[nodes])
        velocity = stretch.velocity + x[:, VELOCITY] - x[:, WIND] - x[:, GUST]
        axes = stretch.axes + np.cross(x[:, None, ATTITUDE], stretch.axes.transpose(0, 2, 1)).transpose(0, 2, 1)
        flow, slopes = _flow(velocity, axes)
        P = at_samples(smoothed.covariances[nodes].reshape(-1, STATES**2)).reshape(-1, STATES, STATES)
        fast = FAST_ATTITUDE * np.array([noise.level, noise.level, 0.0])
        for i, name in enumerate(AIR):
            values[name][stretch.rows] = flow[i]
            row = slopes[i]
            variance = np.einsum("ni,nij,nj->n", row, P, row)
            variance = variance + float(np.max(fast)) ** 2 * np.sum(row[:, ATTITUDE] ** 2, axis=1)
            std[name][stretch.rows] = np.sqrt(np.maximum(variance, 0.0))
    return values, std


def _flow(velocity: Array, axes: Array) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
    """alpha, beta, V (n,) of an air velocity (n, 3) NED, and their slopes by the states (n, 19)."""
    u, v, w = np.einsum("ni,nij->jn", velocity, axes)
    speed = np.linalg.norm(velocity, axis=1)
    plane = u**2 + w**2
    by_body = (
        np.column_stack([-w / plane, np.zeros_like(u), u / plane]),
        np.column_stack([-u * v, plane, -w * v]) / (speed**2 * np.sqrt(plane))[:, None],
        np.column_stack([u, v, w]) / speed[:, None],
    )
    slopes = []
    # a component is axis . velocity; turning the axes by e changes it by e . (axis x velocity)
    lever = np.cross(axes.transpose(0, 2, 1), velocity[:, None, :])
    for body in by_body:
        row = np.zeros((len(u), STATES))
        ned = np.einsum("nij,nj->ni", axes, body)
        row[:, VELOCITY], row[:, WIND], row[:, GUST] = ned, -ned, -ned
        row[:, ATTITUDE] = np.einsum("nj,nji->ni", body, lever)
        slopes.append(row)
    alpha, beta = np.arctan2(w, u), np.arcsin(np.clip(v / speed, -1.0, 1.0))
    return (alpha, beta, speed), (slopes[0], slopes[1], slopes[2])
