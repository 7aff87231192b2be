"""The gap monitor in the pitching plane: its motion against the estimator's, and the whole on flights it has not seen."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from daq.identification.airframe import Airframe, Sample
from daq.identification.monitor import threshold
from daq.identification.monitor.bank import LATERAL_PLANE, PITCH_PLANE, MonitoredEffect, bank
from daq.identification.monitor.monitor import Alarm, GapMonitor, GapMonitors, MonitorState, Name
from daq.identification.monitor.motions import ElevatorInputs, PitchMotion, between, instants
from daq.identification.monitor.nulls import NullConditions, fly
from daq.identification.monitor.predictors import FlightsScan, PredictorBank
from daq.identification.monitor.threshold import Calibration, calibrated
from daq.identification.regression import LONGITUDINAL, lift_and_drag
from daq.identification.simulated_motion import PitchInputs, PitchState, SimulatedPitch
from estimation.aircraft.library import load_aircraft
from sideslip.live_aircraft import airframe_of_file

Array = NDArray[np.float64]
CALM = replace(NullConditions(), gust_spread=(1.0, 1.0))


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    return airframe_of_file(load_aircraft("cdfp"), (LONGITUDINAL,))


@pytest.fixture(scope="module")
def values(airframe: Airframe) -> dict[str, float]:
    return {n: airframe.believed(n) for n in LONGITUDINAL.derivatives} | {"CL_0": 0.12}


@pytest.fixture(scope="module")
def effects(values: dict[str, float]) -> tuple[MonitoredEffect, ...]:
    return bank(values, {}, PITCH_PLANE)


@pytest.fixture(scope="module")
def calibration(airframe: Airframe, values: dict[str, float], effects: tuple[MonitoredEffect, ...]) -> Calibration:
    """From fewer flights than anybody would trust."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(threshold, "AT_ONCE", 40)
        patch.setattr(threshold, "FLIGHT_S", 40.0)
        rng = np.random.default_rng(14)
        return calibrated(airframe, values, effects, NullConditions(), rng=rng, hours=0.4, plane=PITCH_PLANE)


def samples(scans: Sequence[FlightsScan], flight: int) -> list[Sample]:
    """One flight of several, as the monitor takes it."""
    return [
        Sample(
            time=s.time + 1.0,
            ay=0.0,
            delta_a=0.0,
            delta_r=0.0,
            **{n: float(v) for n, v in zip(PITCH_PLANE.channels, s.measured[:, flight], strict=True)},
            **{n: float(getattr(s.inputs, n)[flight]) for n in ElevatorInputs._fields[:-2]},
        )
        for s in scans
    ]


def test_effects_have_the_unit_that_they_are_told_in(effects: tuple[MonitoredEffect, ...]) -> None:
    units = {e.name: e.unit for e in effects}
    assert {units[n] for n in ("CL_0", "CD_0", "CD_k", "Cm_0", "mass")} == {"1"}
    assert {units[n] for n in ("CL_alpha", "Cm_q", "Cm_de")} == {"1/rad"}
    trim = Name("Cm_0", "pitching trim", 0.011, "1", 6.5)
    assert Alarm(46.9, 34.6, "Cm", ("theta",), 6.5, 5.5, (trim,)).text.endswith("leading: Cm_0 (pitching trim) 0.011")


def test_motion_of_many_is_that_of_one(airframe: Airframe, values: dict[str, float]) -> None:
    """Rates against the estimator's simulation; forces against the lift and drag that the regression takes out of them."""
    rng = np.random.default_rng(2)
    alone = SimulatedPitch(airframe)
    alone.values = values
    many = PitchMotion(airframe, {n: np.full((1, 1), v) for n, v in values.items()}, PITCH_PLANE)
    for _ in range(20):
        alpha, q, theta, beta, p, r, phi, elevator = rng.uniform(-0.2, 0.2, 8)
        s = Sample(0, beta, p, q, r, phi, theta, alpha, 17.0, 0, 0, 0, 1.2, thrust=4.0, delta_e=elevator)
        u = ElevatorInputs(*(np.array([[getattr(s, n)]]) for n in ElevatorInputs._fields[:-2]))
        x = np.array([alpha, q, theta])[:, None, None]
        one = np.array(alone.rates(PitchState(alpha, q), PitchInputs(s, elevator)))
        np.testing.assert_allclose(many.rates(x, many.conditions(u))[:2, 0, 0], one, rtol=1e-12, atol=1e-12)
        ax, az = many.forces(x, u)[:, 0, 0]
        lift, drag = lift_and_drag(airframe, s._replace(ax=ax, az=az))
        CL, pressure = alone.lift_coefficient(PitchState(alpha, q), 17.0, elevator), 0.5 * 1.2 * 17.0**2
        assert lift == pytest.approx(pressure * CL)
        assert drag == pytest.approx(pressure * (values["CD_0"] + values["CD_k"] * CL**2))


@pytest.mark.parametrize("name", ["Cm_de", "Cm_alpha", "CL_alpha", "CD_0", "alpha_bias"])
def test_an_effect_leaves_its_signature(
    name: str, airframe: Airframe, values: dict[str, float], effects: tuple[MonitoredEffect, ...]
) -> None:
    """Without noise, a smooth elevator: what the model gets wrong of an aircraft with the effect is the signature."""
    k = [e.name for e in effects].index(name)
    truth = {n: np.array([[v]]) for n, v in values.items()}
    bias = effects[k].step if name == "alpha_bias" else 0.0
    if name in truth:
        truth[name] = truth[name] + effects[k].step
    motion, x = PitchMotion(airframe, truth, PITCH_PLANE), np.array([0.1, 0.0, 0.1])[:, None, None]
    u = ElevatorInputs(*(np.array([v]) for v in (0.0, 0.0, 0.0, 0.0, 16.0, 1.2, 4.0, 0.0)))
    predictors, wrong, signature = PredictorBank(airframe, values, effects, PITCH_PLANE), [], []
    for i in range(160):
        measured = np.concatenate([x[:, 0], motion.forces(x, u)[:, 0]])
        measured[0] += bias
        innovation = predictors.innovation(FlightsScan(0.05 * i, measured, u))
        if innovation is not None:
            wrong.append(innovation.wrong)
            signature.append(innovation.signatures[:, k])
        following = u._replace(delta_e=np.array([0.03 * np.sin(0.06 * (i + 1)) ** 3]))
        x, u = motion.advance(x, between(u, following, instants(0.05)), 0.05), following
    assert np.abs(wrong).max() > 1e-4
    np.testing.assert_allclose(np.array(wrong)[40:], np.array(signature)[40:], atol=2e-2 * np.abs(wrong).max())


@pytest.mark.parametrize(("name", "share"), [("Cm_de", -0.25), ("CL_alpha", -0.12), ("Cm_alpha", -0.3), ("", 0.0)])
def test_a_change_in_pitch_is_named_and_its_absence_is_quiet(
    name: str,
    share: float,
    airframe: Airframe,
    values: dict[str, float],
    effects: tuple[MonitoredEffect, ...],
    calibration: Calibration,
) -> None:
    """Sets in at 20 s: noticed within five seconds in the middle, by its name."""
    done: list[bool] = []

    def set_in(time: float, truth: dict[str, Array]) -> None:
        if name and time >= 20.0 and not done:
            truth[name] = truth[name] * (1.0 + share)
            done.append(True)

    scans = fly(airframe, values, effects, CALM, np.random.default_rng(18), 4, 34.0, set_in, PITCH_PLANE)
    first: list[Alarm] = []
    for flight in range(4):
        monitor = GapMonitor(airframe, values, effects, calibration, PITCH_PLANE)
        for sample in samples(scans, flight):
            monitor.add(sample)
        first += monitor.alarms[:1]
    if not name:
        assert first == []
        return
    assert len(first) == 4
    assert all(a.time > 21.0 for a in first)
    assert np.median([a.time for a in first]) < 26.0
    assert sum(bool(a.leading) and a.leading[0].effect == name for a in first) >= 3


def test_a_silent_channel_of_one_plane_does_not_stop_the_other(
    airframe: Airframe, values: dict[str, float], effects: tuple[MonitoredEffect, ...]
) -> None:
    """Two planes beside one another, told as one: alarms in order of time, the larger score."""

    class Scripted(GapMonitor):
        """Says what it is given to say at each sample."""

        def __init__(self, states: Sequence[MonitorState | None], alarms: list[Alarm], watched: float) -> None:
            self._states, self.alarms, self.watched = list(states), alarms, watched

        def add(self, sample: Sample) -> MonitorState | None:
            return self._states.pop(0)

    early, late = (Alarm(t, t, "Cm", ("q",), 9.0, 4.0, ()) for t in (3.0, 5.0))
    one = Scripted([MonitorState(1.0, 1.0, 0.4, None), None], [late], 8.0)
    other = Scripted([None, MonitorState(2.0, 2.0, 1.2, early)], [early], 9.0)
    both, sample = GapMonitors([one, other]), Sample(*[0.0] * 13)
    states = [both.add(sample), both.add(sample)]
    assert [s.score for s in states if s is not None] == [0.4, 1.2]
    assert both.alarms == (early, late)
    assert both.watched == 9.0


def test_what_a_model_has_of_its_own_is_not_missing() -> None:
    missing = {e.name for e in bank({"Cn_da": -0.003}, {"Cn_da": 0.001}, LATERAL_PLANE) if e.prior == 0.0}
    assert "Cn_da" not in missing
    assert {"CY_da", "beta_bias"} <= missing
