"""The gap monitor: its parts against closed forms and other implementations, and the whole on flights it has not seen."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import gumbel_r

from daq.identification.airframe import DERIVATIVES, Airframe, Sample
from daq.identification.monitor import threshold
from daq.identification.monitor.bank import LATERAL_PLANE, MonitoredEffect, bank
from daq.identification.monitor.evidence import PIECE_S, AirWhitening, MonitorEvidence, fit_whitening
from daq.identification.monitor.monitor import Alarm, GapMonitor
from daq.identification.monitor.motions import Inputs, LateralMotion, instants
from daq.identification.monitor.nulls import NullConditions, fly
from daq.identification.monitor.predictors import FlightsScan, PredictorBank
from daq.identification.monitor.surfaces import BLIND, GUESSED, SurfacesBetween
from daq.identification.monitor.threshold import Calibration, calibrated, exceeded
from daq.identification.simulated_motion import LateralState, MotionInputs, SimulatedMotion
from daq.identification.surfaces import ServoEdge, SurfaceCurves
from tests.studies.live_statistics import Case, airframe_for

Array = NDArray[np.float64]
QUIET = NullConditions(beta=0.0, p=0.0, r=0.0, phi=0.0, ay=0.0, surface=0.0, V=0.0, gust=0.0)


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    return airframe_for(Case("second", 0.1, False))


@pytest.fixture(scope="module")
def values(airframe: Airframe) -> dict[str, float]:
    return {n: airframe.believed(n) for n in DERIVATIVES}


@pytest.fixture(scope="module")
def effects(airframe: Airframe, values: dict[str, float]) -> tuple[MonitoredEffect, ...]:
    return bank(values, {})


@pytest.fixture(scope="module")
def calibration(airframe: Airframe, values: dict[str, float], effects: tuple[MonitoredEffect, ...]) -> Calibration:
    """From fewer flights than anybody would trust."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(threshold, "AT_ONCE", 24)
        patch.setattr(threshold, "FLIGHT_S", 40.0)
        return calibrated(airframe, values, effects, NullConditions(), rng=np.random.default_rng(4), hours=0.4)


def samples(scans: list[FlightsScan], flight: int) -> list[Sample]:
    """One flight of several, as the monitor takes it."""
    found = []
    for s in scans:
        beta, p, r, phi, ay = s.measured[:, flight]
        q, theta, alpha, V, rho, delta_a, delta_r = (float(v[flight]) for v in s.inputs[:-2])
        found.append(Sample(s.time + 1.0, beta, p, q, r, phi, theta, alpha, V, ay, delta_a, delta_r, rho))
    return found


def test_motion_of_many_is_that_of_one(airframe: Airframe, values: dict[str, float]) -> None:
    rng = np.random.default_rng(1)
    alone = SimulatedMotion(airframe)
    alone.values = values
    many = LateralMotion(airframe, {n: np.full((1, 1), v) for n, v in values.items()}, LATERAL_PLANE)
    for _ in range(20):
        x, u = rng.uniform(-0.2, 0.2, 4), rng.uniform(0.05, 0.2, 7)
        u[3:5] = 17.0, 1.2
        inputs = Inputs(*(np.array([[v]]) for v in u))
        one = np.array(alone.rates(LateralState(*x), MotionInputs(*u)))
        np.testing.assert_allclose(
            many.rates(x[:, None, None], many.conditions(inputs))[:, 0, 0], one, rtol=1e-12, atol=1e-12
        )


@pytest.mark.parametrize("name", ["Cn_da", "Cl_da", "Cl_p", "Cn_beta", "CY_beta", "Cl_0", "beta_bias"])
def test_an_effect_leaves_its_signature(
    name: str, airframe: Airframe, values: dict[str, float], effects: tuple[MonitoredEffect, ...]
) -> None:
    """Without noise, surfaces that move smoothly: what the model gets wrong of an aircraft with the effect is the signature."""
    k = [e.name for e in effects].index(name)
    truth = {n: np.array([[v]]) for n, v in values.items()} | {"Cn_da": np.zeros((1, 1))}
    if name in truth:
        truth[name] = truth[name] + effects[k].step
    motion = LateralMotion(airframe, truth, LATERAL_PLANE)
    x, u = np.zeros((4, 1, 1)), Inputs(*(np.array([v]) for v in (0.0, 0.08, 0.08, 16.0, 1.2, 0.0, 0.0)))
    predictors, wrong, signature = PredictorBank(airframe, values, effects), [], []
    bias = effects[k].step if name == "beta_bias" else 0.0
    for i in range(200):
        measured = np.concatenate([x[:, 0], motion.forces(x, u)[0]])
        measured[0] += bias
        found = predictors.innovation(FlightsScan(0.05 * i, measured, u))
        if found is not None:
            wrong.append(found.wrong)
            signature.append(found.signatures[:, k])
        x, u = motion.advance(x, _smooth(u, 0.05 * i, instants(0.05)), 0.05), _smooth(u, 0.05 * i, 1.0)
    assert np.abs(wrong).max() > 1e-4
    # begun at a measurement that is off by a drawn-in bias, the model needs a second to forget it
    np.testing.assert_allclose(np.array(wrong)[40:], np.array(signature)[40:], atol=1e-7 + 5e-3 * np.abs(wrong).max())


def _smooth(u: Inputs, since: float, part: np.ndarray | float) -> Inputs:
    """Surfaces 0.05 s times `part` after `since`."""
    t = np.atleast_1d(since + 0.05 * part)
    moved = u._replace(delta_a=0.1 * np.sin(0.9 * t) ** 3, delta_r=0.05 * (np.cos(1.3 * t) - 1.0))
    return Inputs(*np.broadcast_arrays(*moved))


def test_whitening_finds_the_autoregression_it_is_shown() -> None:
    """Innovations of three kinds, of which one is three times as large as another and one says nothing."""
    rng = np.random.default_rng(3)
    first, second = np.diag([0.6, 0.2, -0.3, 0.1, 0.0]), np.diag([-0.2, 0.1, 0.0, 0.3, 0.0])
    first[0, 1] = 0.3
    root = np.tril(rng.uniform(0.2, 1.0, (5, 5)))
    kind = rng.choice([0, 7, BLIND], p=[0.75, 0.23, 0.02], size=(4000, 4))
    size = np.select([kind == 0, kind == 7], [1.0, 3.0], 30.0)
    e = np.zeros((4000, 5, 4))
    for t in range(2, len(e)):
        before = [np.where(size[t - k] > 9.0, 0.0, e[t - k]) for k in (1, 2)]  # a blind one is not in what follows
        e[t] = first @ before[0] + second @ before[1] + size[t] * (root @ rng.standard_normal((5, 4)))
    known = kind.copy()
    for later in (1, 2):
        known[later:][kind[:-later] == BLIND] = BLIND
    found = fit_whitening([(e[:2000], known[:2000]), (e[2000:], known[2000:])])
    np.testing.assert_allclose(found.first, first, atol=0.15)
    np.testing.assert_allclose(found.second, second, atol=0.15)
    white = np.stack([found.applied(e[t], e[t - 1], e[t - 2], known[t]) for t in range(2, 4000)])
    for k, covariance in ((0, np.eye(5)), (7, np.eye(5)), (BLIND, np.zeros((5, 5)))):
        mine = white.transpose(0, 2, 1)[known[2:] == k]
        np.testing.assert_allclose(mine.T @ mine / len(mine), covariance, atol=0.1)


def around(values: Array, k: int) -> tuple[Any, Any, Any, Any]:
    """Four in a row, of which number k is the second."""
    return values[k - 1], values[k], values[k + 1], values[k + 2]


def test_surfaces_are_those_of_one_servo() -> None:
    """Against the one-flight curves: where both know of an edge, they agree on all of it."""
    rng = np.random.default_rng(14)
    lag, t = 0.035, np.cumsum(rng.choice([0.05, 0.1, 0.15], 400))
    wanted = np.radians(rng.uniform(-6.0, 6.0, 100))[:, None]
    edges, noise = np.cumsum(rng.uniform(0.3, 0.7, (100, 1)), axis=0), math.radians(0.03)
    servo = np.array([_servo(x, edges[:, 0], wanted[:, 0], lag) for x in t]) + noise * rng.standard_normal(t.size)
    alone, many, edge_found = SurfaceCurves(lag), SurfacesBetween(lag), 0
    for k in range(1, t.size - 2):
        one = alone.middle(around(t, k), around(servo, k))
        all_of = many.middle(around(t, k), around(servo[:, None], k))
        both = isinstance(one, ServoEdge) and all_of.edge is not None and alone.sure
        if both and all_of.level[0] < GUESSED and 0.0 < one.edge < 0.9 * one.h:
            edge_found += 1
            parts = np.linspace(0.0, 1.0, 7)
            drawn = np.array([all_of.at(float(part))[0] for part in parts])
            np.testing.assert_allclose(drawn, [one.at(float(part)) for part in parts], atol=math.radians(0.5))
            truth = np.array([_servo(t[k] + part * one.h, edges[:, 0], wanted[:, 0], lag) for part in parts])
            np.testing.assert_allclose(drawn, truth, atol=math.radians(0.7))
    assert edge_found > 20


def _servo(time: float, edges: Array, wanted: Array, lag: float) -> float:
    """Where a first-order servo is that is told `wanted` at `edges`."""
    at, target, since = 0.0, 0.0, -1e9
    for edge, to in zip(edges, wanted, strict=True):
        if edge > time:
            break
        at, target, since = target + (at - target) * math.exp(-(edge - since) / lag), float(to), float(edge)
    return target + (at - target) * math.exp(-(time - since) / lag)


def test_hands_that_begin_slowly_make_no_edge_before_the_edge() -> None:
    """0.6 deg of easing off in the interval before a step: taken for the step's beginning, the step came a tenth of a second
    too early."""
    surface = SurfacesBetween(0.035)
    t, seen = 0.1 * np.arange(6), np.radians([4.86, 4.86, 4.23, -1.77, -5.86, -5.54])
    drawn = [surface.middle(around(t, k), around(seen[:, None], k)) for k in (1, 2, 3)]
    assert math.degrees(drawn[0].at(0.5)[0]) == pytest.approx(4.55, abs=0.2)
    assert math.degrees(drawn[1].at(0.5)[0]) == pytest.approx(4.23, abs=0.5)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("lag", [1e-5, 1e-3, 5.0, None])
def test_any_servo_is_drawn(lag: float | None) -> None:
    """Quicker than any scan and slower than any: what is drawn is a number, and at the scans what was measured."""
    surface, seen = SurfacesBetween(lag), np.radians([0.0, 0.0, 5.0, 5.1, -3.0, -3.0, -3.1, 2.0])
    for k in range(1, seen.size - 2):
        curve = surface.middle(around(0.25 * np.arange(seen.size), k), around(seen[:, None], k))
        drawn = np.array([curve.at(part)[0] for part in (0.0, 0.3, 1.0)])
        assert np.isfinite(drawn).all()
        assert drawn[[0, 2]] == pytest.approx(seen[[k, k + 1]], abs=math.radians(0.6))


def test_a_surface_that_moved_unseen_makes_an_interval_blind(
    airframe: Airframe, values: dict[str, float], effects: tuple[MonitoredEffect, ...]
) -> None:
    """A rudder step somewhere in a quarter of a second without scans, in one of two flights: three scans of that one say nothing,
    and the predictor begins again at what is measured."""
    still = np.zeros(2)
    scans = []
    for time in np.concatenate([0.1 * np.arange(10), 1.15 + 0.1 * np.arange(10)]):
        rudder = np.array([0.0, math.radians(3.0)]) * (time > 1.0)
        measured = np.zeros((5, 2))
        measured[2] = 4.0 * rudder
        u = Inputs(still, still + 0.08, still + 0.08, still + 16.0, still + 1.2, still, rudder)
        scans.append(FlightsScan(float(time), measured, u))
    whole, fresh = PredictorBank(airframe, values, effects), PredictorBank(airframe, values, effects)
    found = [f for s in scans if (f := whole.innovation(s)) is not None]
    begun = [f for s in scans[10:] if (f := fresh.innovation(s)) is not None]
    blind = np.array([f.kind for f in found]) == BLIND
    assert not blind[:, 0].any()
    assert np.flatnonzero(blind[:, 1]).tolist() == [9, 10, 11]  # of the scans from the second on
    for late, new in zip(found[10:], begun, strict=True):
        assert late.time == new.time
        np.testing.assert_allclose(late.wrong[:, 1], new.wrong[:, 1], atol=1e-12)
        aircraft = [
            k for k, e in enumerate(effects) if e.equation != "actuator"
        ]  # a late surface is still that of before
        np.testing.assert_allclose(late.signatures[:, aircraft, 1], new.signatures[:, aircraft, 1], atol=1e-12)


def test_scores_are_those_of_a_regression_with_priors() -> None:
    """Against generalised least squares with covariance I + G P G', written out; after each piece of eleven scans innovations are
    whitened by what they were, each with the one before it."""
    rng = np.random.default_rng(5)
    effects = (
        MonitoredEffect("a", "", "Cl", 1.0, "1", 0.3),
        MonitoredEffect("b", "", "Cl", 2.0, "1", 0.5),
        MonitoredEffect("c", "", "Cn", 1.0, "1"),
    )
    evidence, W, G = MonitorEvidence(effects), [], []
    shape, products, seen = np.eye(10)[5:], np.zeros((10, 10)), 0.0
    two, two_of = np.zeros(10), np.zeros((10, 3))
    for k in range(40):
        white, signatures = rng.standard_normal((5, 1)), rng.standard_normal((5, 3, 1)) * 0.3
        complete = evidence.add(0.05 * k, white, signatures)
        two, two_of = np.append(two[5:], white), np.concatenate([two_of[5:], signatures[:, :, 0]])
        W.append(shape @ two)
        G.append(shape @ two_of)
        products, seen = products + np.outer(two, two), seen + 1.0
        if complete:
            products, seen = products * math.exp(-0.025), seen * math.exp(-0.025)
            usual = (products + 40.0 * np.eye(10)) / (seen + 40.0)
            from_before = usual[5:, :5] @ np.linalg.inv(usual[:5, :5])  # least squares
            rest = np.linalg.inv(np.linalg.cholesky(usual[5:, 5:] - from_before @ usual[:5, 5:]))
            shape = rest @ np.hstack([-from_before, np.eye(5)])
    kept = sum(p.scans for p in evidence._pieces)
    w, g = np.concatenate(W[:kept]), np.concatenate(G[:kept])
    prior = np.array([0.3, 0.25])
    score = evidence.score()
    scale = np.sqrt(max((w @ w - _explained(w, g, prior)) / w.size, 1.0))
    cov = np.eye(w.size) + g[:, :2] @ np.diag(prior**2) @ g[:, :2].T
    inverse = np.linalg.inv(cov)
    c = g[:, 2]
    assert score.z[0, -1, 2] * scale == pytest.approx(c @ inverse @ w / math.sqrt(c @ inverse @ c))
    for k in (0, 1):  # the posterior mean in units of its own spread, were the prior all there is
        mean = prior[k] ** 2 * g[:, k] @ inverse @ w
        spread = math.sqrt(prior[k] ** 4 * g[:, k] @ inverse @ g[:, k])
        assert score.z[0, -1, k] * scale == pytest.approx(mean / spread)


def test_innovations_of_stronger_gusts_are_white_as_well() -> None:
    """What moves three channels together, four times as strong as on average, and one of them a scan later, stands out of the
    noise no more, neither at once nor from scan to scan."""
    rng, gust = np.random.default_rng(6), np.array([3.0, 0.0, 2.0, 0.0, 1.5])[:, None]
    late = np.array([0.0, 0.0, 3.0, 0.0, 0.0])[:, None]
    air, found, last_gust = AirWhitening(5, 1, 2), [], np.zeros(2)
    for k in range(600):
        this_gust = rng.standard_normal(2)
        white = rng.standard_normal((5, 2)) + gust * this_gust + late * last_gust
        last_gust = this_gust
        if k % 7 == 0:
            white[:, 1] = 0.0  # nothing is learnt of a blind scan
        found.append(air.add(0.05 * k, white, np.zeros((5, 1, 2)))[0])
        if k % 10 == 9:
            air.update()
    last = np.array(found[300:])
    for flight in (0, 1):
        seen = last[last[:, :, flight].any(axis=1), :, flight]
        assert np.linalg.eigvalsh(seen.T @ seen / len(seen))[-1] < 1.5  # of 16 and more without
        together = last[1:, :, flight].T @ last[:-1, :, flight] / len(last)
        assert np.abs(together).max() < 0.25  # of 0.8 and more, were each scan made white alone


def test_of_fast_scans_those_of_the_last_twentieth_of_a_second_tell() -> None:
    """At 100 Hz one scan before is mostly noise of its own; a slow error shows in the mean of several."""
    rng = np.random.default_rng(8)
    left = {}
    for dt in (0.05, 0.01):
        air, slow, found = AirWhitening(1, 1, 1), 0.0, []
        for k in range(round(60.0 / dt)):
            slow += (rng.standard_normal() * 1.5 - slow) * dt / 0.2
            white = np.array([[slow + rng.standard_normal()]])
            found.append(float(air.add(dt * k, white, np.zeros((1, 1, 1)))[0][0, 0]))
            if k % round(0.5 / dt) == 0:
                air.update()
        w = np.array(found[len(found) // 2 :])
        left[dt] = float(np.mean(w[1:] * w[:-1]) / np.mean(w**2))
    assert abs(left[0.05]) < 0.1
    assert abs(left[0.01]) < 0.1


def test_the_air_of_simulated_flights_rolls(airframe: Airframe, values: dict[str, float]) -> None:
    """By MIL-F-8785C: 1.9 times the vertical gust over the root of its length and the span; the roll rate follows it."""
    gust, flights = math.radians(1.5), 40
    damped = {"Cl_p": values["Cl_p"]}  # so that sideslip does not roll it
    quiet, effects = NullConditions(gust=gust, gust_spread=(1.0, 1.0), p=0.0), bank(damped, {})
    scans = fly(airframe, damped, effects, quiet, np.random.default_rng(9), flights, 8.0)
    still = fly(airframe, damped, effects, replace(quiet, gust=0.0), np.random.default_rng(9), flights, 8.0)
    rolled = np.array([a.measured[1] - b.measured[1] for a, b in zip(scans, still, strict=True)])[40:]
    sideways = math.sqrt(np.mean([(a.measured[0] - b.measured[0]) ** 2 for a, b in zip(scans, still, strict=True)]))
    assert sideways > 0.5 * gust
    rolling = 1.9 * 0.7 * gust * 16.5 / math.sqrt(30.0 * airframe.span)
    assert 0.3 * rolling < float(np.sqrt(np.mean(rolled**2))) < 3.0 * rolling


def test_thresholds_of_a_link_come_from_several_batches(
    airframe: Airframe, values: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Scans that are lost are others in each batch, so that one may have half a second less."""
    monkeypatch.setattr(threshold, "AT_ONCE", 2)
    monkeypatch.setattr(threshold, "FLIGHT_S", 30.0)
    effects, link = bank(values, {})[:3], NullConditions(rate=11.5, loss=0.3)
    found = calibrated(airframe, values, effects, link, rng=np.random.default_rng(3), hours=3 * 2 * 30.0 / 3600.0)
    assert found.hours == pytest.approx(6 * 27.0 / 3600.0)


def _explained(w: Array, g: Array, prior: Array) -> float:
    C = g[:, :2].T @ g[:, :2] + np.diag(1.0 / prior**2)
    b = g[:, :2].T @ w
    usual = float(b @ np.linalg.solve(C, b))
    cov = np.linalg.inv(np.eye(w.size) + g[:, :2] @ np.diag(prior**2) @ g[:, :2].T)
    z = [g[:, 2] @ cov @ w / math.sqrt(g[:, 2] @ cov @ g[:, 2])]
    z += [g[:, k] @ cov @ w / math.sqrt(g[:, k] @ cov @ g[:, k]) for k in (0, 1)]
    return usual + max(v**2 for v in z)


def test_threshold_is_passed_as_seldom_as_asked() -> None:
    rng = np.random.default_rng(6)
    largest = gumbel_r.rvs(loc=3.0, scale=0.5, size=20000, random_state=rng)
    level = exceeded(largest, 90.0, 0.5)
    assert gumbel_r.sf(level, 3.0, 0.5) == pytest.approx(1.0 - math.exp(-0.5 * 90.0 / 3600.0), rel=0.1)


@pytest.mark.parametrize(
    ("name", "change", "channels"), [("Cn_da", -0.012, ("r", "beta")), ("Cn_dr", 0.014, ("r", "beta", "ay"))]
)
def test_right_effect_is_named_and_dated(
    name: str,
    change: float,
    channels: tuple[str, ...],
    airframe: Airframe,
    values: dict[str, float],
    effects: tuple[MonitoredEffect, ...],
    calibration: Calibration,
) -> None:
    """Sets in at 20 s: noticed in most of a few flights, after it began, by its name. In units of what is usual of each, a rudder
    that does less looked like less yaw damping."""
    done: list[bool] = []

    def set_in(time: float, truth: dict[str, Array]) -> None:
        if time >= 20.0 and not done:
            truth[name] = truth[name] + change
            done.append(True)

    calm = replace(NullConditions(), gust_spread=(1.0, 1.0))
    scans = fly(airframe, values, effects, calm, np.random.default_rng(8), 4, 42.0, set_in)
    found = []
    for flight in range(4):
        monitor = GapMonitor(airframe, values, effects, calibration)
        for sample in samples(scans, flight):
            monitor.add(sample)
        found += [a for a in monitor.alarms if a.time > 21.0][:1]
    assert len(found) >= 3
    named = [a for a in found if a.leading and a.leading[0].effect == name]
    assert len(named) >= 3
    assert all(a.equation == "Cn" and a.channels[0] in channels for a in named)
    assert all(10.0 < a.since <= a.time for a in named)
    assert np.median([a.leading[0].size for a in named]) == pytest.approx(change, rel=0.5)
    assert np.median([a.time for a in found]) < 31.0


def test_flights_with_nothing_wrong_are_quiet_and_gaps_are_not_watched(
    airframe: Airframe, values: dict[str, float], effects: tuple[MonitoredEffect, ...], calibration: Calibration
) -> None:
    calm = replace(NullConditions(), gust_spread=(1.0, 1.0))
    scans = fly(airframe, values, effects, calm, np.random.default_rng(9), 3, 50.0)
    alarms, watched = 0, []
    for flight in range(3):
        monitor = GapMonitor(airframe, values, effects, calibration)
        for sample in samples(scans, flight):
            if not 20.0 < sample.time < 30.0:
                monitor.add(sample)
        alarms += len(monitor.alarms)
        watched.append(monitor.watched)
    assert alarms == 0  # in two minutes
    np.testing.assert_allclose(watched, 40.0, atol=0.2)


def test_a_mass_that_is_measured_is_no_change_of_the_aircraft(
    airframe: Airframe, values: dict[str, float], effects: tuple[MonitoredEffect, ...], calibration: Calibration
) -> None:
    """Three quarters of the file's mass: quiet with it, and without it side forces are a third too large. A mass that this
    aircraft cannot have counts as none."""
    calm = replace(NullConditions(), gust_spread=(1.0, 1.0))
    lighter = 0.75 * airframe.mass
    scans = fly(replace(airframe, mass=lighter), values, effects, calm, np.random.default_rng(22), 1, 50.0)
    equations = []
    for mass in (lighter, math.nan, 10.0 * lighter):
        monitor = GapMonitor(airframe, values, effects, calibration)
        for sample in samples(scans, 0):
            monitor.add(sample._replace(mass=mass))
        equations.append({a.equation for a in monitor.alarms})
    assert equations == [set(), {"CY"}, {"CY"}]


def test_errors_that_grow_without_a_name_are_told_by_channel(
    airframe: Airframe, values: dict[str, float], effects: tuple[MonitoredEffect, ...], calibration: Calibration
) -> None:
    """The bank angle becomes four times as noisy: no effect of the bank does that."""
    calm = replace(NullConditions(), gust_spread=(1.0, 1.0))
    scans = fly(airframe, values, effects, calm, np.random.default_rng(10), 1, 60.0)
    rng = np.random.default_rng(11)
    monitor = GapMonitor(airframe, values, effects, calibration)
    for s in samples(scans, 0):
        worse = math.radians(1.2) * rng.standard_normal() if s.time > 30.0 else 0.0
        monitor.add(s._replace(phi=s.phi + worse))
    after = [a for a in monitor.alarms if a.time > 30.0]
    assert after
    assert after[0].time < 37.0
    assert "phi" in after[0].channels
    assert not after[0].leading
    assert after[0].named is None
    assert LATERAL_PLANE.channels.index("phi") == 3
    assert PIECE_S == 0.5


def test_an_alarm_of_grown_errors_gets_its_name_when_they_tell(
    airframe: Airframe, values: dict[str, float], effects: tuple[MonitoredEffect, ...], calibration: Calibration
) -> None:
    """The vane slips: its errors are large at once, and only the seconds after it tell that they stay on one side."""
    calm = replace(NullConditions(), gust_spread=(1.0, 1.0))
    scans = fly(airframe, values, effects, calm, np.random.default_rng(12), 1, 50.0)
    monitor, told = GapMonitor(airframe, values, effects, calibration), list[Alarm]()
    for s in samples(scans, 0):
        monitor.add(s._replace(beta=s.beta + (0.03 if s.time > 25.0 else 0.0)))
        told += [a for a in monitor.alarms[-1:] if not told or a != told[-1]]
    first, last = told[0], monitor.alarms[0]
    assert (first.leading, first.named) == ((), None)
    assert first.time == last.time < 30.0
    assert last.leading[0].effect == "beta_bias"
    assert last.leading[0].size == pytest.approx(0.03, rel=0.5)
    assert last.named is not None
    assert first.time < last.named < 36.0
    assert last.score > last.threshold
