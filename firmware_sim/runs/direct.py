"""The short way from truth to a flight: noise on the flight columns at 20 Hz, without bus, chips and calibration.

For studies of many flights. Levels are those of calibrated records of such an aircraft (1 sigma): ax ay 0.05, az 0.08
m/s2, p q 0.4, r 0.3 deg/s, phi theta 0.3, psi 0.6, alpha 0.3, beta 0.25 deg, V 0.15 m/s, surfaces 0.07 deg. What a
recording through the simulated bus shows is decided by the instruments instead.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.utilities.durable import write_text
from firmware_sim.world.scenario import Scenario
from firmware_sim.world.simulation import Wiring
from firmware_sim.world.world import simulate_many

Array = NDArray[np.float64]
_DEG = math.pi / 180.0
_NOISE_STREAM = 101


@dataclass(frozen=True, slots=True)
class DirectNoise:
    """White noise of the calibrated columns, 1 sigma, SI and radians; `scale` multiplies all of it."""

    ax: float = 0.05
    ay: float = 0.05
    az: float = 0.08
    p: float = 0.4 * _DEG
    q: float = 0.4 * _DEG
    r: float = 0.3 * _DEG
    phi: float = 0.3 * _DEG
    theta: float = 0.3 * _DEG
    psi: float = 0.6 * _DEG
    alpha: float = 0.3 * _DEG
    beta: float = 0.25 * _DEG
    V: float = 0.15
    surfaces: float = 0.07 * _DEG
    thrust: float = 0.15
    altitude: float = 0.5
    scale: float = 1.0


ORDINARY_NOISE = DirectNoise()

DIRECT_COLUMNS = tuple(
    (
        "time ax ay az p q r phi theta psi alpha beta V delta_e delta_a delta_r cmd_e cmd_a cmd_r thrust altitude rho"
    ).split()
)


def measured(truth: Mapping[str, Array], seed: int, noise: DirectNoise = ORDINARY_NOISE) -> dict[str, Array]:
    """Flight columns (samples,) as calibrated instruments would deliver them, from one flight of `simulate_many`."""
    rng = np.random.default_rng([seed, _NOISE_STREAM])
    samples = len(truth["time"])

    def noisy(values: Array, sigma: float) -> Array:
        return values + noise.scale * sigma * rng.standard_normal(samples)

    columns = {"time": truth["time"].copy()}
    for name in ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "V"):
        columns[name] = noisy(truth[f"sensed_{name}"], getattr(noise, name))
    left, right, rudder = (noisy(truth[f"sensed_arm_{arm}"], 0.0) for arm in ("left", "right", "r"))
    columns["delta_e"] = noisy(0.5 * (left + right), noise.surfaces)
    columns["delta_a"] = noisy(0.5 * (right - left), noise.surfaces)
    columns["delta_r"] = noisy(rudder, noise.surfaces)
    for name in ("cmd_e", "cmd_a", "cmd_r"):
        columns[name] = truth[name].copy()
    columns["thrust"] = noisy(truth["thrust"], noise.thrust)
    columns["altitude"] = noisy(truth["altitude"], noise.altitude)
    columns["rho"] = truth["rho"].copy()
    return columns


def direct_flights(
    scenarios: Sequence[Scenario],
    seeds: Sequence[int],
    noise: DirectNoise = ORDINARY_NOISE,
    rate_hz: float = 20.0,
    wiring: Wiring | None = None,
) -> list[dict[str, Array]]:
    """Fly many scenarios side by side and look at them through the direct sensor model; columns DIRECT_COLUMNS."""
    truths = simulate_many(scenarios, seeds, rate_hz, wiring=wiring)
    return [measured(truth, seed, noise) for truth, seed in zip(truths, seeds, strict=True)]


def write_csv(path: Path, columns: Mapping[str, Array]) -> None:
    """Write flight columns as CSV with nine significant digits."""
    names = list(columns)
    lines = [",".join(names)]
    lines += [",".join(f"{v:.9g}" for v in row) for row in np.column_stack([columns[n] for n in names])]
    write_text(path, "\n".join(lines) + "\n")
