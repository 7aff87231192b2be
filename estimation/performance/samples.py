"""Lift and drag of the samples of a flight at which thrust is known.

Forces are specific force times mass less thrust, turned by the angle of attack: L = X sin a - Z cos a, D = -X cos a - Z sin a.
Thrust that was not measured is zero while the throttle is closed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.aircraft import Aircraft
from estimation.engine.kernel import Array
from estimation.errors import DataError
from estimation.prepare.columns import bridge_gaps, with_derived
from estimation.prepare.measured_mass import mass_history
from estimation.signals.denoise import denoise, noise_level
from groundstation.flight import Flight
from groundstation.flight.arrays import true_runs

NEEDED = ("V", "alpha", "ax", "az", "rho")
CLOSED = 0.02  # of the throttle's range: dead band of a stick and rounding of PWM
RUNS_OUT = 1.0  # s after closing in which a motor may still pull
LEAST = 40  # samples in a stretch, two seconds at 20 Hz: in a shorter one noise and motion are not separable
LEAST_NOISE = (1e-4, 1e-6)  # m/s2, rad: of recordings without noise


@dataclass(frozen=True)
class PolarSamples:
    """Consecutive samples, (N,) each. CL, CD: lift and drag coefficient; smooth_CL: de-noised, for a regressor; scatter: standard
    deviation of CD by noise; V [m/s]; rho [kg/m3]."""

    CL: Array
    CD: Array
    smooth_CL: Array
    scatter: Array
    V: Array
    rho: Array


@dataclass(frozen=True)
class Usable:
    """The usable stretches of a flight. samples: of the flight; thrust: how it is known, in words."""

    name: str
    samples: int
    stretches: tuple[PolarSamples, ...]
    thrust: str

    @property
    def used(self) -> int:
        """Samples of the stretches."""
        return sum(s.V.size for s in self.stretches)


def usable(flight: Flight, aircraft: Aircraft, *, throttle_off: bool) -> Usable:
    """Lift and drag where thrust is known. throttle_off: the user states that it was off throughout.

    Raises DataError where thrust is unknown and not off, or a column is missing.
    """
    flight = with_derived(flight, ["rho"])
    missing_columns = [n for n in NEEDED if not flight.measured(n)]
    if missing_columns:
        way = (
            "; 'sideslip reconstruct' makes angle of attack and airspeed from the others"
            if {"V", "alpha"} & set(missing_columns)
            else ""
        )
        raise DataError(f"{flight.name}: lift and drag need {', '.join(missing_columns)}, which it has not{way}")
    thrust, words = _thrust(flight, throttle_off)
    thrust_known = np.isfinite(thrust)
    for name in NEEDED:
        thrust_known &= np.isfinite(flight[name])
    thrust_known &= np.nan_to_num(flight["V"]) > 0.0
    pieces = [piece for s in flight.segments for piece in _runs(thrust_known, s.start, s.stop)]
    if not pieces:
        raise DataError(
            f"{flight.name}: no {LEAST} samples in a row have {words} and {', '.join(NEEDED)}; fly longer glides with the"
            " throttle off"
        )
    noise = (
        max(noise_level(bridge_gaps(flight["ax"])), LEAST_NOISE[0]),
        max(noise_level(bridge_gaps(flight["alpha"])), LEAST_NOISE[1]),
    )
    mass = mass_history(flight, aircraft.mass)
    stretches = tuple(_stretch(flight, p, thrust, aircraft.area, mass[p], noise) for p in pieces)
    return Usable(flight.name, len(flight), stretches, words)


def _thrust(flight: Flight, throttle_off: bool) -> tuple[Array, str]:
    """(N,) thrust [N], NaN where it is not known, and how it is known."""
    if throttle_off:
        return np.zeros(len(flight)), "throttle off, as stated"
    kind = flight.channels.get("thrust", {}).get("kind", "measured")
    if flight.measured("thrust") and kind != "assumed":  # an assumed thrust is not known
        return np.asarray(flight["thrust"], float), f"thrust {kind}"
    if flight.measured("throttle"):
        closed = _closed(flight.time, np.asarray(flight["throttle"], float))
        if closed.any():
            return np.where(closed, 0.0, np.nan), "throttle closed"
        raise DataError(
            f"{flight.name}: thrust is unknown, and the throttle is never closed (at least {np.nanmin(flight['throttle']):.3g}"
            " of 1); fly glides with the throttle off, or record thrust [N]; where the motor stood at that least, state"
            " --throttle-off with --segments of these stretches"
        )
    raise DataError(
        f"{flight.name}: thrust is unknown, and nothing says that the throttle was off; record thrust [N] or throttle, or state"
        " --throttle-off where it was"
    )


def _closed(time: Array, throttle: Array) -> NDArray[np.bool_]:
    """(N,) whether the throttle is closed and the motor has stopped."""
    closed = np.nan_to_num(throttle, nan=1.0) <= CLOSED
    open_at = np.where(closed, -np.inf, time)
    last_open = np.maximum.accumulate(open_at)
    return closed & (time - last_open > RUNS_OUT)


def _runs(usable: NDArray[np.bool_], start: int, stop: int) -> list[slice]:
    """Runs of at least LEAST usable samples between two rows."""
    return [slice(a, b) for a, b in true_runs(usable, [slice(start, stop)]) if b - a >= LEAST]


def _stretch(
    flight: Flight, piece: slice, thrust: Array, area: float, mass: Array, noise: tuple[float, float]
) -> PolarSamples:
    V = denoise(flight["V"][piece]).values
    rho, alpha = flight["rho"][piece], flight["alpha"][piece]
    pressure = 0.5 * rho * V**2 * area / mass
    ax, az = flight["ax"][piece] - thrust[piece] / mass, flight["az"][piece]
    CL, CD = _rotated(ax, az, alpha, pressure)
    smooth, _ = _rotated(denoise(ax).values, denoise(az).values, denoise(alpha).values, pressure)
    scatter = np.hypot(noise[0], az * noise[1]) / pressure
    return PolarSamples(CL, CD, smooth, scatter, V, np.asarray(rho, float))


def _rotated(ax: Array, az: Array, alpha: Array, pressure: Array) -> tuple[Array, Array]:
    """CL and CD from specific forces less thrust [m/s2]; pressure: dynamic pressure times area over mass [m/s2]."""
    sine, cosine = np.sin(alpha), np.cos(alpha)
    return (ax * sine - az * cosine) / pressure, (-ax * cosine - az * sine) / pressure


def all_stretches(flights: Sequence[Usable]) -> tuple[PolarSamples, ...]:
    """The stretches of all flights."""
    return tuple(s for f in flights for s in f.stretches)
