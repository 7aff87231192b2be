"""Contradictions of air data: pressures, airspeeds, density and altitude with each other and with the ground velocity.

Each function takes time (N,) [s] and the measured columns (N,), SI, and yields nothing where a column that it compares is
missing."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from daq.utilities.constants import (
    FLYING_GROUND_SPEED,
    LEAST_PITOT_PRESSURE,
    LEAST_PITOT_SHARE,
    SEA_LEVEL_DENSITY,
    SEA_LEVEL_TEMPERATURE,
)
from groundstation.flight.atmosphere import (
    DENSITY_WAYS,
    GUESSED_DENSITY,
    density_at_altitude,
    density_at_pressure,
)
from groundstation.flight.contradictions.contradiction import Contradiction
from groundstation.flight.contradictions.fits import Array, Columns, FitWithError, ratio_of, scale_by_ground

PRESSURE_TOLERANCE = 0.08  # of 2 p/(rho V^2): a guessed temperature makes 5 % of density, the pitot 3 %
SCALE_TOLERANCE = 0.08  # of V by ground velocity: 3 % error of a pitot, some 3 % by sideslip and delay of the fix
DENSITY_TOLERANCE = 0.08  # between two densities: 25 K of temperature, or a day of unusual pressure and 10 K
SIGMAS = 4.0  # by chance once in 16000 comparisons
LEAST_CHI_SQUARE = 9.0  # difference by which the ground velocity favours one scale of V over another: three sigmas
CREDIBLE_SCALE = 0.1  # a scale further than this, and 2 sigma, from that of the ground velocity is not favoured
LEAST_FAST = 0.1  # share of fast samples: fewer may be a taxi run, or errors of the fix
DENSITY_LAPSE = 0.1  # relative fall of the density in 1000 m
PRESSURE_ALTITUDE = 600.0  # [m] between pressure altitude and height by GNSS: 70 hPa, which no weather makes


@dataclass(frozen=True)
class AirDensity:
    """values: (N,) density [kg/m3]; source: columns it is calculated from; guesses: whether its temperature is a guess."""

    values: Array
    source: str
    guesses: bool = False


def air_density(c: Columns) -> AirDensity | None:
    """Density of a flight's air: rho, else `independent_density`; None without either."""
    return AirDensity(c["rho"], "rho") if "rho" in c else independent_density(c)


def independent_density(c: Columns) -> AirDensity | None:
    """Density by pressure or altitude with a credible temperature (`atmosphere.DENSITY_WAYS`), without use of a column rho."""
    available = (w for w in DENSITY_WAYS if all(n in c for n in w.needs))
    way = next((w for w in available if w.credible(*(c[n] for n in w.needs))), None)
    if way is None:
        return None
    return AirDensity(way.build(*(c[n] for n in way.needs)), " and ".join(way.needs), way.guesses)


def speed_and_pressure(time: Array, c: Columns) -> Iterator[Contradiction]:
    """V (or V_cas) against dynamic pressure and density: p_dynamic = rho V^2 / 2."""
    name = "V" if "V" in c else "V_cas"
    if name not in c or "p_dynamic" not in c:
        return
    at_sea = AirDensity(np.full_like(c[name], SEA_LEVEL_DENSITY), "sea-level density")
    dense = air_density(c) if name == "V" else at_sea
    if dense is None:
        return
    air, source = dense.values, dense.source
    ratio = ratio_of(0.5 * air * c[name] ** 2, np.where(c["p_dynamic"] > 0.0, c["p_dynamic"], np.nan))
    if ratio is None or not ratio.differs_from(1.0, PRESSURE_TOLERANCE, SIGMAS):
        return
    favoured, evidence = _favoured(scale_by_ground(time, c) if name == "V" else None, name, ratio.value)
    implied = _median(2.0 * np.where(c["p_dynamic"] > 0, c["p_dynamic"], np.nan) / c[name] ** 2)
    text = (
        f"{name} and p_dynamic contradict each other: the dynamic pressure of {name} is {ratio.value:.3g} times p_dynamic "
        f"(density from both would be {implied:.3g} against {_median(air):.3g} kg/m3 by {source}{_weather(dense, implied)}); "
        f"{evidence}"
    )
    moves = f"every derivative by {abs(ratio.value - 1):.0%}, if p_dynamic is right"
    if favoured == name:
        moves = f"none with {name} and {source}; every one by {abs(ratio.value - 1):.0%} if p_dynamic were taken"
    yield _by_ratio((name, "p_dynamic"), text, ratio, favoured, moves, stops=favoured != name)


def _favoured(scale: tuple[FitWithError, FitWithError] | None, name: str, ratio: float) -> tuple[str, str]:
    """The side that the ground velocity favours, empty where neither, and the evidence as text. scale: from `scale_by_ground`.
    ratio: dynamic pressure of V over the one measured."""
    if scale is None:
        return "", "nothing else in the flight tells which is right: check the pitot's ratio and the density"
    fit = scale[0]
    evidence = f"ground velocity on several headings makes V {fit.value:.2f} +- {fit.std:.2f} times what it is"
    scales = {name: 1.0, "p_dynamic": ratio**-0.5}
    sigmas = {side: (fit.value - factor) / max(fit.std, 1e-6) for side, factor in scales.items()}
    closest, further = sorted(sigmas, key=lambda side: abs(sigmas[side]))
    chi_square = sigmas[further] ** 2 - sigmas[closest] ** 2
    tolerance = max(CREDIBLE_SCALE * scales[closest], 2.0 * fit.std)
    if chi_square < LEAST_CHI_SQUARE or abs(fit.value - scales[closest]) > tolerance:
        return "", f"{evidence}, which does not tell which is right: check the pitot's ratio and the density"
    return closest, f"{evidence}, which favours {closest}"


def scale_against_ground(time: Array, c: Columns) -> Iterator[Contradiction]:
    """V against ground velocity; several headings separate a scale of V from the wind."""
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
    """Dynamic pressure at a ground speed of flight: negative with swapped tubes, almost zero under a cover."""
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


def _by_ratio(
    between: tuple[str, ...], text: str, ratio: FitWithError, favoured: str, moves: str, *, stops: bool
) -> Contradiction:
    return Contradiction(between, text, ratio.value, std=ratio.std, favoured=favoured, moves=moves, stops=stops)


def _median(values: Array) -> float:
    return float(np.nanmedian(values))


def _looks_equivalent(c: Columns, fit: FitWithError) -> str:
    """A hint that V is equivalent airspeed, where it is too small by the root of the density ratio; else empty."""
    dense = air_density(c)
    if dense is None:
        return ""
    density = _median(dense.values)
    factor = float(np.sqrt(SEA_LEVEL_DENSITY / density))
    agrees = abs(fit.value / factor - 1.0) < 0.5 * SCALE_TOLERANCE + 2.0 * fit.std
    if factor < 1.0 + 0.5 * SCALE_TOLERANCE or not agrees:
        return ""
    return f"; it looks like equivalent airspeed, which at {density:.3g} kg/m3 is {1 / factor:.2f} of the true one"


def density_twice(time: Array, c: Columns) -> Iterator[Contradiction]:
    """A column rho against the density by static pressure or altitude, with temperature."""
    independent = independent_density({n: v for n, v in c.items() if n != "altitude"}) if "rho" in c else None
    if independent is None:
        return
    air, source = independent.values, independent.source
    ratio = ratio_of(c["rho"], air)
    if ratio is None or not ratio.differs_from(1.0, DENSITY_TOLERANCE, SIGMAS):
        return
    if independent.guesses and GUESSED_DENSITY[0] < ratio.value < GUESSED_DENSITY[1]:
        return  # a warm or a cold day
    text = f"rho is {ratio.value:.3g} times the density that {source} gives ({_median(air):.3g} kg/m3)"
    moves = f"every derivative by {abs(ratio.value - 1):.0%}"
    yield _by_ratio(("rho", *source.split(" and ")), text, ratio, source, moves, stops=True)


def pressure_and_height(time: Array, c: Columns) -> Iterator[Contradiction]:
    """Static pressure, or the pressure altitude, against the height above mean sea level by GNSS."""
    side = next((n for n in ("p_static", "altitude") if n in c), "")
    if not side or "altitude_gnss" not in c:
        return
    by_pressure = density_at_pressure(c[side]) if side == "p_static" else density_at_altitude(c[side])
    ratio = ratio_of(by_pressure, density_at_altitude(c["altitude_gnss"]))
    if ratio is None or not ratio.differs_from(1.0, DENSITY_LAPSE * PRESSURE_ALTITUDE / 1000.0, SIGMAS):
        return
    cure = "the static port" if side == "p_static" else "whether it is above the field"
    text = (
        f"{side} belongs to air {ratio.value:.3g} times as dense as at the height by GNSS "
        f"({_median(c['altitude_gnss']):.0f} m); check the unit of either, and {cure}"
    )
    moves = f"every derivative by {abs(ratio.value - 1):.0%}, if density is taken from {side} and it is wrong"
    yield _by_ratio((side, "altitude_gnss"), text, ratio, "", moves, stops="rho" not in c)


def _weather(dense: AirDensity, implied: float) -> str:
    """The air temperature that would make pitot and V agree, where the temperature is a guess and weather can be the cause; else
    empty. implied: density by pitot and V [kg/m3]."""
    share = implied / _median(dense.values)
    if not dense.guesses or not GUESSED_DENSITY[0] < share < GUESSED_DENSITY[1]:
        return ""
    warming = SEA_LEVEL_TEMPERATURE * (1.0 / share - 1.0)
    return (
        f" with the standard temperature, a guess: air some {abs(warming):.0f} K {'warmer' if warming > 0 else 'colder'} would "
        "make them agree, so add its temperature"
    )
