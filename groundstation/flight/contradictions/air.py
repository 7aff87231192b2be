"""Contradictions of air data: pressures, airspeeds, density, altitude, and what the motion says of the scale of V."""

from collections.abc import Iterator

import numpy as np

from daq.utilities.constants import (
    FLYING_GROUND_SPEED,
    LEAST_PITOT_PRESSURE,
    LEAST_PITOT_SHARE,
    SEA_LEVEL_DENSITY,
)
from groundstation.flight.atmosphere import (
    density,
    density_at_altitude,
    density_at_pressure,
    is_of_the_air,
)
from groundstation.flight.contradictions.contradiction import Contradiction
from groundstation.flight.contradictions.fits import Array, Columns, FitWithError, ratio_of, scale_by_ground
from groundstation.flight.flight import Flight

PRESSURE_TOLERANCE = 0.08  # of 2 p/(rho V^2): density of a guessed temperature is 5 % off, a pitot of its own 3 %
SCALE_TOLERANCE = 0.08  # of V by motion: a pitot reads 3 % wrong, slips and lags of the fix make up some 3 %
DENSITY_TOLERANCE = 0.08  # between two densities: 25 K of temperature, or a day of strange pressure and 10 K
SIGMAS = 4.0
TELLS_APART = 9.0  # difference of chi-square by which the motion favours one scale of V over another: three sigmas
CREDIBLE_SCALE = 0.1  # A scale of V further than this from the motion's (and its 2 sigma) is not the one it favours
LEAST_FAST = 0.1  # of a flight: fewer fast samples may be a taxi run, or errors of the fix
PRESSURE_ALTITUDE = 600.0  # [m] between pressure altitude and height by GNSS: 70 hPa, which no weather makes


def air_density(c: Columns) -> tuple[Array, str] | None:
    """(N,) density [kg/m3] and what it is from: rho, else `independent_density`; None where nothing tells."""
    if "rho" in c:
        return c["rho"], "rho"
    return independent_density(c)


def independent_density(c: Columns) -> tuple[Array, str] | None:
    """The density that a flight's pressure (with a credible temperature) or altitude give, whatever its column rho says."""
    if "p_static" in c:
        p = c["p_static"]
        if "temperature" in c and is_of_the_air(p, c["temperature"]):
            return density(p, c["temperature"]), "p_static and temperature"
        return density_at_pressure(p), "p_static"
    for name in ("altitude_gnss", "altitude"):
        if name in c:
            return density_at_altitude(c[name]), name
    return None


def speed_and_pressure(time: Array, c: Columns) -> Iterator[Contradiction]:
    """V (or V_cas) against dynamic pressure and density: p_dynamic = rho V^2 / 2."""
    name = "V" if "V" in c else "V_cas"
    if name not in c or "p_dynamic" not in c:
        return
    dense = air_density(c) if name == "V" else (np.full_like(c[name], SEA_LEVEL_DENSITY), "sea-level density")
    if dense is None:
        return
    air, source = dense
    ratio = ratio_of(0.5 * air * c[name] ** 2, np.where(c["p_dynamic"] > 0.0, c["p_dynamic"], np.nan))
    if ratio is None or not ratio.differs_from(1.0, PRESSURE_TOLERANCE, SIGMAS):
        return
    favoured, evidence = _favoured(scale_by_ground(time, c) if name == "V" else None, name, ratio.value)
    implied = _median(2.0 * np.where(c["p_dynamic"] > 0, c["p_dynamic"], np.nan) / c[name] ** 2)
    text = (
        f"{name} and p_dynamic contradict each other: the dynamic pressure of {name} is {ratio.value:.3g} times p_dynamic "
        f"(density from both would be {implied:.3g} against {_median(air):.3g} kg/m3 by {source}); {evidence}"
    )
    moves = f"every derivative by {abs(ratio.value - 1):.0%}, if p_dynamic is right"
    if favoured == name:
        moves = f"none with {name} and {source}; every one by {abs(ratio.value - 1):.0%} if p_dynamic were taken"
    yield _by_ratio((name, "p_dynamic"), text, ratio, favoured, moves, stops=favoured != name)


def _favoured(scale: tuple[FitWithError, FitWithError] | None, name: str, ratio: float) -> tuple[str, str]:
    """The side that the motion favours, and why. ratio: dynamic pressure of V over the one measured."""
    if scale is None:
        return "", "nothing else in the flight tells which is right: check the pitot's ratio and the density"
    fit = scale[0]
    evidence = f"ground velocity on several headings makes V {fit.value:.2f} +- {fit.std:.2f} times what it is"
    scales = {name: 1.0, "p_dynamic": ratio**-0.5}
    sigmas = {side: (fit.value - factor) / max(fit.std, 1e-6) for side, factor in scales.items()}
    closest, further = sorted(sigmas, key=lambda side: abs(sigmas[side]))
    chi_square = sigmas[further] ** 2 - sigmas[closest] ** 2
    tolerance = max(CREDIBLE_SCALE * scales[closest], 2.0 * fit.std)
    if chi_square < TELLS_APART or abs(fit.value - scales[closest]) > tolerance:
        return "", f"{evidence}, which does not tell which is right: check the pitot's ratio and the density"
    return closest, f"{evidence}, which favours {closest}"


def scale_against_ground(time: Array, c: Columns) -> Iterator[Contradiction]:
    """V against ground velocity on several headings, which tells its scale from the wind."""
    scale = scale_by_ground(time, c)
    if scale is None or not scale[0].differs_from(1.0, SCALE_TOLERANCE, SIGMAS):
        return
    fit = scale[0]
    text = (
        f"V and ground velocity contradict each other: on several headings the true airspeed is {fit.value:.3g} +- "
        f"{fit.std:.2g} times V{_looks_equivalent(c, fit)}"
    )
    moves = f"every derivative by up to {abs(fit.value**2 - 1.0):.0%}"
    yield _by_ratio(("V", "vn", "ve"), text, fit, "vn, ve", moves, stops=True)


def pitot_against_ground(time: Array, c: Columns) -> Iterator[Contradiction]:
    """Dynamic pressure where the ground speed is that of flight: negative from swapped tubes, next to none under a cover."""
    if not {"p_dynamic", "vn", "ve"} <= c.keys():
        return
    speed = np.hypot(c["vn"], c["ve"])
    fast = (speed > FLYING_GROUND_SPEED) & np.isfinite(c["p_dynamic"])
    if np.mean(fast) < LEAST_FAST:
        return
    pressure, ground = _median(c["p_dynamic"][fast]), _median(speed[fast])
    readings = f"p_dynamic is {pressure:.0f} Pa at a ground speed of {ground:.0f} m/s"
    if pressure < LEAST_PITOT_PRESSURE:
        cure = "the tubes of the pitot are swapped: calibrate again with the slope in pitot.toml negative"
    elif pressure < LEAST_PITOT_SHARE * 0.5 * SEA_LEVEL_DENSITY * ground**2:
        cure = "the pitot was covered or blocked: reconstruct V from GPS and attitude (sideslip reconstruct)"
    else:
        return
    moves = "every derivative: V and the dynamic pressure are not those of the flight"
    yield Contradiction(("p_dynamic", "vn", "ve"), f"{readings}; {cure}", favoured="vn, ve", moves=moves, stops=True)


def no_airspeed(flight: Flight) -> str:
    """Why a flight's V is none, for the end of a sentence; empty where its ground speed does not tell."""
    contradiction = next(pitot_against_ground(flight.time, flight.columns), None)
    return "" if contradiction is None else f"; {contradiction.text}"


def _by_ratio(
    between: tuple[str, ...], text: str, ratio: FitWithError, favoured: str, moves: str, *, stops: bool
) -> Contradiction:
    return Contradiction(between, text, ratio.value, std=ratio.std, favoured=favoured, moves=moves, stops=stops)


def _median(values: Array) -> float:
    return float(np.nanmedian(values))


def _looks_equivalent(c: Columns, fit: FitWithError) -> str:
    """A hint that an airspeed which is too small by the root of the density is equivalent, not true."""
    dense = air_density(c)
    if dense is None:
        return ""
    middle = _median(dense[0])
    factor = float(np.sqrt(SEA_LEVEL_DENSITY / middle))
    agrees = abs(fit.value / factor - 1.0) < 0.5 * SCALE_TOLERANCE + 2.0 * fit.std
    if factor < 1.0 + 0.5 * SCALE_TOLERANCE or not agrees:
        return ""
    return f"; it looks like equivalent airspeed, which at {middle:.3g} kg/m3 is {1 / factor:.2f} of the true one"


def density_twice(time: Array, c: Columns) -> Iterator[Contradiction]:
    """A column rho against static pressure with temperature, or altitude."""
    independent = independent_density({n: v for n, v in c.items() if n != "altitude"}) if "rho" in c else None
    if independent is None:
        return
    air, source = independent
    ratio = ratio_of(c["rho"], air)
    if ratio is None or not ratio.differs_from(1.0, DENSITY_TOLERANCE, SIGMAS):
        return
    text = f"rho is {ratio.value:.3g} times the density that {source} gives ({_median(air):.3g} kg/m3)"
    moves = f"every derivative by {abs(ratio.value - 1):.0%}"
    yield _by_ratio(("rho", *source.split(" and ")), text, ratio, source, moves, stops=True)


def pressure_and_height(time: Array, c: Columns) -> Iterator[Contradiction]:
    """Static pressure against the height above the sea by GNSS."""
    if "p_static" not in c or "altitude_gnss" not in c:
        return
    ratio = ratio_of(density_at_pressure(c["p_static"]), density_at_altitude(c["altitude_gnss"]))
    if ratio is None or not ratio.differs_from(1.0, 0.1 * PRESSURE_ALTITUDE / 1000.0, SIGMAS):
        return
    text = (
        f"p_static belongs to air {ratio.value:.3g} times as dense as at the height by GNSS "
        f"({_median(c['altitude_gnss']):.0f} m); check the unit of either, and the static port"
    )
    moves = f"every derivative by {abs(ratio.value - 1):.0%}, if density is taken from p_static and it is wrong"
    yield _by_ratio(("p_static", "altitude_gnss"), text, ratio, "", moves, stops="rho" not in c)
