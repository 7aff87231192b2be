"""Flights of a simulator of fixed Euler steps: its steps are found as times, and are no effect."""

import numpy as np
import pytest

from estimation.aircraft import load_aircraft
from estimation.gap.criteria import AS_SET
from estimation.gap.fit.baseline import Baseline, fit_baseline
from estimation.gap.fit.noise import channel_noise
from estimation.gap.records.candidate_model import with_nuisance
from estimation.gap.records.flight_records import prepare_flights, sample_interval
from estimation.models.load import load_model
from groundstation.flight import Flight

EVERY = 5  # steps a sample of 20 Hz
STEP = 0.01  # s
V, ALPHA, THETA, RHO, G = 17.0, 0.06, 0.05, 1.2, 9.80665
NOISE = {"beta": 0.001, "p": 0.002, "r": 0.002, "phi": 0.001, "ay": 0.02}
CY = {"beta": -0.4, "dr": 0.1}
CL = {"beta": -0.06, "p": -0.3, "r": 0.08, "da": 0.15, "dr": 0.01}
CN = {"beta": 0.08, "p": -0.02, "r": -0.12, "dr": -0.05}


def euler_flight(seed: int, refine: int) -> Flight:
    """25 s of lateral motion; all states step by what they were at the last step, of STEP/refine."""
    craft, rng, h = load_aircraft("cdfp"), np.random.default_rng(seed), STEP / refine
    aileron, rudder = ([(t, rng.choice((-0.1, 0.1))) for t in np.arange(s, 24.0, 1.7)] for s in (1.0, 1.6))
    x, surface, rows = np.zeros(4), np.zeros(2), []
    inertia = np.array([[craft.Ixx, -craft.Ixz], [-craft.Ixz, craft.Izz]])
    pressure = 0.5 * RHO * V**2 * craft.area
    for k in range(round(25.0 / h) + 1):
        p, r, beta, phi = x
        hats = {"beta": beta, "p": p * craft.span / (2 * V), "r": r * craft.span / (2 * V)}
        hats |= {"da": surface[0], "dr": surface[1]}
        side, roll, yaw = (sum(v * hats[n] for n, v in line.items()) for line in (CY, CL, CN))
        ay = pressure * side / craft.mass
        if k % (EVERY * refine) == 0:
            rows.append((k * h, beta, p, r, phi, ay, *surface))
        turning = np.linalg.solve(inertia, pressure * craft.span * np.array([roll, yaw]))
        slip = p * np.sin(ALPHA) - r * np.cos(ALPHA) + (ay + G * np.cos(THETA) * np.sin(phi)) / V / np.cos(beta)
        x = x + h * np.array([*turning, slip, p + np.tan(THETA) * r * np.cos(phi)])
        asked = [sum(a for t, a in moves if t <= k * h < t + 0.6) for moves in (aileron, rudder)]
        surface = surface + (np.array(asked) - 0.1 * np.array([phi, 0.0]) - surface) * h / 0.05
    time, *seen = np.array(rows).T
    names = ("beta", "p", "r", "phi", "ay", "delta_a", "delta_r")
    columns = {n: v + NOISE.get(n, 1e-4) * rng.standard_normal(v.size) for n, v in zip(names, seen, strict=True)}
    steady = {"V": V, "alpha": ALPHA, "theta": THETA, "rho": RHO, "q": 0.0, "V_dot": 0.0}
    return Flight.build(f"s{seed}", time, columns | {n: np.full(time.size, v) for n, v in steady.items()})


def fitted(refine: int) -> Baseline:
    model, flights = load_model("lateral", "cdfp"), [euler_flight(seed, refine) for seed in (71, 72)]
    prepared = prepare_flights(model, (), flights, (), AS_SET)
    scatter = channel_noise(prepared.records)
    noise = dict(zip(model.output_names, scatter, strict=True))
    clean = with_nuisance(model, noise, sample_interval(prepared.records), AS_SET)
    return fit_baseline(clean, clean, prepared, scatter)


@pytest.mark.parametrize("refine", [1, 4])
def test_gyros_half_a_step_early_and_moments_a_step_late_are_found_as_that(refine: int) -> None:
    """All states step by the last one, so every rate of change is half a step late: to attitude and sideslip the gyros are half
    a step early, and the moments reach them two halves late."""
    values = fitted(refine).fit.values
    assert values["timing_gyros"] == pytest.approx(0.5 * STEP / refine, abs=0.0012)
    assert values["timing_moments"] == pytest.approx(STEP / refine, abs=0.002)
