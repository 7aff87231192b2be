"""Inputs in error: their responses, how large they are found to be, and what the corrected bound makes of them."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.engine.simulate import Compile, Hold, Simulator
from estimation.estimators import input_error
from estimation.estimators.output_error import OutputErrorOptions, output_error
from estimation.models import load_model
from estimation.prepare.flight_data import FlightData
from estimation.prepare.pipeline import prepare, prepare_all
from estimation.signals.denoise import denoise_many
from groundstation.flight import Flight
from tests.unit.estimation.truth import NOISE, STRONG, TRUE, Case, fly

LATERAL = load_model("lateral", "cdfp")


@pytest.fixture(scope="module")
def noisy() -> list[Flight]:
    return fly(Case(noise=NOISE, servo=None), np.random.default_rng(31), 10)[0]


def test_draws_are_as_wrong_as_the_denoised_signal() -> None:
    flights, clean = fly(Case(noise=NOISE), np.random.default_rng(32), 6)
    for name, order in (("V", 2), ("alpha", 2), ("delta_a", 1), ("delta_r", 1)):
        done = denoise_many([f[name] for f in flights], order=order, draws=30, rng=np.random.default_rng(1))
        error = np.array([d.values for d in done]) - clean[name]
        drawn = np.array([d.errors for d in done])
        assert 0.6 < np.sqrt(np.mean(error**2) / np.mean(drawn**2)) < 1.4
        assert np.abs(drawn.mean(axis=1)).max() < 1.5 * NOISE[name]
        # slow errors are what matters: noise passes there as it came
        slow = [np.mean(np.abs(np.fft.rfft(v, axis=-1)[..., 1:4]) ** 2) for v in (error, drawn)]
        assert 0.4 < slow[0] / slow[1] < 2.5


def test_same_flight_same_draws(noisy: list[Flight]) -> None:
    first, second = (prepare(LATERAL, noisy[0]) for _ in range(2))
    assert first.errors is not None
    assert np.array_equal(first.errors, np.asarray(second.errors))
    at = LATERAL.input_names.index("rho")  # a constant has no noise
    assert not first.errors[:, at].any()


@pytest.mark.parametrize("compile_", ["auto", "never"])
@pytest.mark.parametrize("hold", ["smooth", "linear"])
def test_response_is_the_derivative_of_the_simulation(noisy: list[Flight], compile_: Compile, hold: Hold) -> None:
    """Against simulations with inputs changed a little; the middles of a straight line follow its ends."""
    data = prepare(LATERAL, noisy[0])
    segment = data.segments[0].part(0, 200, data.segments[0].x0)
    simulator = Simulator.build(LATERAL, compile_=compile_, hold=hold)
    du = 1e-3 * np.random.default_rng(2).normal(size=(200, segment.u.shape[1], 2)).cumsum(axis=0)
    if hold == "smooth":  # the middles of the cubic, by central differences of the drive itself
        ends = [
            [simulator.drive(replace(segment, u=segment.u + s * du[:, :, k]), TRUE, False).u_mid for s in (1e-3, -1e-3)]
            for k in range(2)
        ]
        middle = np.stack([(up - down) / 2e-3 for up, down in ends], axis=2)
    else:
        middle = np.concatenate([0.5 * (du[1:] + du[:-1]), du[-1:]])
    found = simulator.response(segment, TRUE, segment.x0, du, middle)
    for k in range(2):
        up, down = (
            simulator.run(replace(segment, u=segment.u + s * du[:, :, k]), TRUE, segment.x0).y for s in (1e-2, -1e-2)
        )
        slope = (up - down) / 2e-2
        assert np.abs(found[:, :, k] - slope).max() < 2e-3 * np.abs(slope).max()


def test_corrected_bounds_hold_where_inputs_are_noisy(noisy: list[Flight]) -> None:
    """Still air: the residuals hardly show it, and Cramer-Rao bounds are half as large as the errors."""
    plain, corrected, blind = [], [], []
    for data in prepare_all(LATERAL, noisy):
        e = output_error(LATERAL, data).parameters
        plain.append([(e[n].estimate - TRUE[n]) / e[n].std for n in STRONG])
        corrected.append([(e[n].estimate - TRUE[n]) / e[n].std_coloured for n in STRONG])
        e = output_error(LATERAL, replace(data, errors=None)).parameters
        blind.append([e[n].std_coloured for n in ("CY_beta", "Cn_beta")])
    assert np.sqrt(np.mean(np.square(plain))) > 1.4
    assert 0.55 < np.sqrt(np.mean(np.square(corrected))) < 1.25
    assert np.isfinite(blind).all()


def _sizes(monkeypatch: pytest.MonkeyPatch, flights: list[FlightData]) -> np.ndarray:
    """What is found of common errors, (fits, common)."""
    found = []
    inner = input_error.common_error

    def spy(told: list[input_error.InputErrorEvidence], edges: float) -> np.ndarray:
        result = inner(told, edges)
        found.append(result)
        return result

    monkeypatch.setattr("estimation.estimators.uncertainty.common_error", spy)
    output_error(LATERAL.with_local("CY_0", "Cl_0", "Cn_0"), flights, options=OutputErrorOptions(paths=False))
    return found[0]


def test_a_late_aileron_is_noticed(monkeypatch: pytest.MonkeyPatch, noisy: list[Flight]) -> None:
    """Shifted by 3 ms, which is 1.7 times the size expected; the rudder is on time."""
    on_time = _sizes(monkeypatch, prepare_all(LATERAL, noisy[:4]))
    late = [f.with_columns(delta_a=np.interp(f.time + 0.003, f.time, f["delta_a"])) for f in noisy[:4]]
    shown = _sizes(monkeypatch, prepare_all(LATERAL, late))
    assert on_time[0, 0] < 0.5
    assert 1.0 < shown[0, 0] < 5.0
    assert shown[2, 2] < 0.7


def test_no_control_no_common_error(noisy: list[Flight]) -> None:
    still = noisy[0].with_columns(delta_a=np.zeros(601), delta_r=np.zeros(601))
    result = output_error(LATERAL.fixed(Cl_da=-0.095, Cl_dr=0.02, Cn_dr=-0.033, CY_dr=0.42), still)
    assert all(np.isfinite(e.std_coloured) or not e.identifiable for e in result.parameters.values())
