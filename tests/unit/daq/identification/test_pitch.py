"""The pitching plane of the recursive estimator against flights of a simulator that shares no code with it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from daq.identification.airframe import PITCH_SIGNALS, SIGNALS, Airframe, Belief, Sample
from daq.identification.estimates import LiveEstimates
from daq.identification.live import JointEstimator, LiveEstimator
from daq.identification.next_manoeuvre import (
    PITCH_LIBRARY,
    linear_pitch,
    next_manoeuvre,
    predicted_pitch_columns,
)
from daq.identification.regression import LATERAL, LONGITUDINAL, PlaneRegression
from daq.identification.rows import RowMaker
from daq.identification.simulated_motion import PitchInputs, PitchState, SimulatedPitch, SteadiedVane
from estimation.aircraft.library import load_aircraft
from firmware_sim.runs.direct import DirectNoise, measured
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.simulation import derivatives_of
from firmware_sim.world.world import simulate_many

Array = NDArray[np.float64]
SEEDS = (7, 8)
TOLD_WELL = ("CL_alpha", "CD_0", "CD_k", "Cm_alpha", "Cm_q", "Cm_de")
LEVEL = Sample(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.09, 0.09, 16.5, 0.0, 0.0, 0.0, 1.2, 0.9, -9.77, 0.0, 5.2)


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    craft = load_aircraft("cdfp")
    beliefs = {
        n: Belief(p.value, p.std or 0.0)
        for n in (*LATERAL.derivatives, *LONGITUDINAL.derivatives)
        if (p := craft.prior(n)) is not None
    }
    a = craft
    lag = None if a.servos is None else a.servos.lag
    return Airframe(a.span, a.area, a.mass, a.Ixx, a.Iyy, a.Izz, a.Ixz, beliefs, lag, a.chord)


Flown = tuple[list[dict[str, Array]], list[dict[str, Array]], list[Mapping[str, float]]]


@pytest.fixture(scope="module")
def flown() -> Flown:
    """At 100 Hz: as exact instruments show two flights, as usual ones do, and the derivatives they were flown with."""
    scenario = load_scenario("longitudinal").altered(wind={"gust_deg": 0.0})
    flights = simulate_many([scenario] * len(SEEDS), SEEDS, 100.0)
    exact = [measured(t, s, DirectNoise(scale=0.0)) for t, s in zip(flights, SEEDS, strict=True)]
    noisy = [measured(t, s) for t, s in zip(flights, SEEDS, strict=True)]
    return exact, noisy, [derivatives_of(scenario, s) for s in SEEDS]


def samples(columns: Mapping[str, Array], every: int = 5) -> list[Sample]:
    table = np.stack([columns[n] for n in ("time", *SIGNALS, *PITCH_SIGNALS)], axis=1)[::every]
    return [Sample(*row) for row in table.tolist()]


def estimated(airframe: Airframe, scans: Sequence[Sample], regression: PlaneRegression = LONGITUDINAL) -> LiveEstimates:
    estimator = LiveEstimator(airframe, regression)
    for sample in scans:
        estimator.add(sample)
    return estimator.estimates()


@pytest.mark.parametrize("every", [2, 5])
def test_exact_instruments_give_the_derivatives(airframe: Airframe, flown: Flown, every: int) -> None:
    """At 50 and 20 Hz."""
    exact, _, truths = flown
    for columns, truth in zip(exact, truths, strict=True):
        found = estimated(airframe, samples(columns, every)).derivatives
        for name in TOLD_WELL:
            assert found[name].estimate == pytest.approx(truth[name], rel=0.02), name
        assert found["CL_de"].estimate == pytest.approx(truth["CL_de"], rel=0.05)


def test_usual_instruments_give_them_within_their_bounds(airframe: Airframe, flown: Flown) -> None:
    _, noisy, truths = flown
    for columns, truth in zip(noisy, truths, strict=True):
        found = estimated(airframe, samples(columns)).derivatives
        for name in TOLD_WELL:
            assert found[name].told
            assert abs(found[name].estimate - truth[name]) < 3.5 * found[name].std < 0.35 * abs(truth[name])


def test_mass_of_a_sample_is_that_of_the_equations(airframe: Airframe, flown: Flown) -> None:
    """An aircraft of which each sample says 4/5 of the file's mass is one whose file says so."""
    scans, lighter = samples(flown[1][0])[:400], replace(airframe, mass=0.8 * airframe.mass)
    known = estimated(airframe, [s._replace(mass=lighter.mass) for s in scans]).derivatives
    stated = estimated(lighter, scans).derivatives
    assert stated["CL_alpha"].told
    for name in (n for n in LONGITUDINAL.derivatives if stated[n].told):
        assert known[name].estimate == pytest.approx(stated[name].estimate, rel=1e-9), name
        assert known[name].std == pytest.approx(stated[name].std, rel=1e-9)


def test_a_resting_elevator_is_named(airframe: Airframe, flown: Flown) -> None:
    scans = [s._replace(delta_e=-0.02) for s in samples(flown[0][0])[:200]]
    found = estimated(airframe, scans)
    assert found.still == ("delta_e",)
    assert "delta_e has not moved" in found.derivatives["Cm_de"].why
    assert not any(d.told for d in found.derivatives.values())


def test_a_scan_without_thrust_makes_no_row(airframe: Airframe, flown: Flown) -> None:
    scans = [s._replace(thrust=math.nan) for s in samples(flown[0][0])]
    estimator = LiveEstimator(airframe, LONGITUDINAL)
    for sample in scans:
        estimator.add(sample)
    assert estimator.skipped == estimator.scans


def test_both_planes_at_once_are_each_by_itself(airframe: Airframe, flown: Flown) -> None:
    scans = samples(flown[1][0])[:300]
    both = JointEstimator(airframe, (LATERAL, LONGITUDINAL))
    for sample in scans:
        both.add(sample)
    found = both.estimates()
    for regression in (LATERAL, LONGITUDINAL):
        for name, d in estimated(airframe, scans, regression).derivatives.items():
            assert repr(found.derivatives[name]) == repr(d)


def test_the_simulated_motion_is_that_of_the_truth(airframe: Airframe, flown: Flown) -> None:
    """With the derivatives flown, over each interval of exact scans, begun anew at each of them."""
    columns, truth = flown[0][0], flown[2][0]
    simulated = SimulatedPitch(airframe)
    simulated.values = {n: truth[n] for n in LONGITUDINAL.derivatives}
    scans = samples(columns, every=1)[50:1500]
    wrong = []
    for first, last in zip(scans, scans[1:], strict=False):
        simulated.restart(first)
        simulated.advance(first, last, _Line(first.delta_e, last.delta_e))
        wrong.append((simulated.motion.alpha - last.alpha, simulated.motion.q - last.q))
    rms = np.sqrt(np.mean(np.square(wrong), axis=0))
    assert rms[0] < 2e-4  # rad in 10 ms; angles move by up to 5e-3
    assert rms[1] < 5e-3  # rad/s; edges of the elevator in an interval


class _Line:
    """A surface on a straight line."""

    def __init__(self, first: float, last: float) -> None:
        self._first, self._last = first, last
        self.integral = math.nan

    def at(self, part: float) -> float:
        return self._first + part * (self._last - self._first)


def steadied_samples(airframe: Airframe, scans: Sequence[Sample]) -> list[Sample]:
    """All of them, those that still waited at the end behind."""
    vane = SteadiedVane(airframe, SimulatedPitch(airframe).values)
    settled = [s for sample in scans for s in vane.add(sample)]
    return [*settled, *vane.restart()]


def test_a_steadied_vane_has_less_noise_and_no_lag(airframe: Airframe, flown: Flown) -> None:
    exact, noisy, _ = flown
    truth = {s.time: s.alpha for s in samples(exact[0])}
    steadied = steadied_samples(airframe, samples(noisy[0]))
    assert [s.time for s in steadied] == list(truth)
    error = np.array([s.alpha - truth[s.time] for s in steadied[20:]])
    raw = np.array([s.alpha - truth[s.time] for s in samples(noisy[0])[20:]])
    assert np.std(error) < 0.3 * np.std(raw)
    slope = np.gradient([truth[s.time] for s in steadied[20:]], 0.05)
    assert abs(np.polyfit(slope, error, 1)[0]) < 0.01  # s of lag


def test_a_steadied_vane_follows_an_elevator_between_slow_scans(airframe: Airframe, flown: Flown) -> None:
    """At 10 Hz an edge of the elevator lies anywhere between two scans: the cubic alone is 0.035 deg rms off."""
    for columns in flown[0]:
        scans = samples(columns, 10)
        error = np.array([s.alpha - raw.alpha for s, raw in zip(steadied_samples(airframe, scans), scans, strict=True)])
        assert np.sqrt(np.mean(error**2)) < math.radians(0.025)


def test_rows_of_fast_scans_are_joined(airframe: Airframe, flown: Flown) -> None:
    """At 100 Hz each row covers 50 ms, and all of them what the rows of single intervals do."""
    scans = samples(flown[0][0], every=1)[:120]

    def rows(shortest: float) -> list[Array]:
        regression = replace(LONGITUDINAL, shortest_row=shortest)
        maker, found = RowMaker(airframe, SimulatedPitch(airframe), regression), []
        for s in scans:
            row = maker.add(s, (s.delta_e,))
            if row is not None:
                found.append(np.append(row.measured, row.span))
        return found

    joined, single = rows(0.045), rows(0.0)
    assert {round(r[-1], 6) for r in joined} == {0.05}
    count = 5 * len(joined)
    np.testing.assert_allclose(np.sum(joined, axis=0), np.sum(single[:count], axis=0), rtol=1e-9, atol=1e-9)


def test_linear_pitch_is_the_slope_of_the_simulated_one(airframe: Airframe) -> None:
    """Speed and the curvature of the polar aside: within two in a hundred of the largest entry."""
    values = {n: airframe.believed(n) for n in LONGITUDINAL.derivatives}
    A, B = linear_pitch(airframe, values, LEVEL)
    motion = SimulatedPitch(airframe)

    def rates(x: Array) -> Array:
        return np.array(motion.rates(PitchState(LEVEL.alpha + x[0], x[1]), PitchInputs(LEVEL, float(x[2]))))

    step = 1e-5
    slopes = np.column_stack([(rates(x) - rates(-x)) / (2 * step) for x in step * np.eye(3)])
    expected = np.column_stack([A, B])
    scale = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(slopes / scale, expected / scale, atol=0.03)


def test_advice_flies_the_elevator_within_its_limit(airframe: Airframe, flown: Flown) -> None:
    values = {n: airframe.believed(n) for n in LONGITUDINAL.derivatives}
    estimator = LiveEstimator(airframe, LONGITUDINAL)
    for sample in samples(flown[1][0])[:400]:
        estimator.add(sample)
    wanted = {n: 0.001 * abs(v) for n, v in values.items() if not n.endswith("_0")}
    advice = next_manoeuvre(airframe, values, estimator.information(), wanted, LEVEL, LONGITUDINAL)
    assert advice is not None
    assert advice.manoeuvre.startswith("elevator")
    assert advice.then < advice.now
    _, share = predicted_pitch_columns(airframe, {**values, "Cm_de": -5.0}, PITCH_LIBRARY[0], LEVEL)
    assert share < 0.5
