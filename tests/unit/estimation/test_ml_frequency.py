"""Output error in the frequency domain against closed forms, the truth of made flights, and output error in time."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from estimation.engine.simulate import Simulator
from estimation.errors import DataError
from estimation.estimators.frequency_domain.estimate import FrequencyOptions, frequency_output_error
from estimation.estimators.frequency_domain.problem import FrequencyProblem
from estimation.estimators.frequency_domain.transformed import Band, SpectralSegment
from estimation.estimators.output_error import output_error
from estimation.models import load_model
from estimation.models.base import InputTransform, Model, Parameter, Signal, joint_model
from estimation.prepare.pipeline import prepare
from estimation.signals.curves import finite_transform
from groundstation.flight import Flight, read_flight
from sideslip.verbs.estimate import estimate
from tests.support.paths import RECORDINGS
from tests.unit.estimation.truth import STRONG, TRUE


def roll_only(**extra: object) -> Model:
    """p' = -p / T + L u, an output of p and one of its slope."""
    parts: dict[str, object] = {
        "name": "roll",
        "states": (Signal("p", "rad/s"),),
        "inputs": (Signal("delta_a", "rad", control=True),),
        "outputs": (Signal("p", "rad/s"), Signal("slope", "rad/s2")),
        "parameters": (Parameter("rate", start=-4.0), Parameter("gain", start=9.0)),
        "equations": ("p_dot = rate*p + gain*delta_a", "slope = rate*p + gain*delta_a"),
    }
    return Model(**{**parts, **extra})  # type: ignore[arg-type]


def rolled(delay: float = 0.0, p0: float = 0.3) -> Flight:
    """Smooth input (sin 2t + sin 5t) / 4 from rest of the input but not of p; closed form, no noise."""
    t = np.arange(0.0, 30.0, 0.05)
    rate, gain = -5.0, 8.0

    def answered(w: float) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
        phasor = 0.25 * gain / (1j * w - rate) * np.exp(1j * w * (t - delay))
        return phasor.imag, (1j * w * phasor).imag

    parts = [answered(w) for w in (2.0, 5.0)]
    decay = p0 * np.exp(rate * t)
    p, slope = sum(a for a, _ in parts) + decay, sum(b for _, b in parts) + rate * decay
    return Flight.build("rolled", t, {"delta_a": 0.25 * (np.sin(2 * t) + np.sin(5 * t)), "p": p, "slope": slope})


def test_a_transform_is_the_integral() -> None:
    """Of exp(-t): (1 - exp(-(1 + jw) T)) / (1 + jw)."""
    t = np.linspace(0.0, 5.0, 2001)
    omega = 1.0 + 0.5 * np.arange(12)
    found = finite_transform(np.exp(-t)[:, None], t[1], 1.0, 0.5, 12)[:, 0]
    np.testing.assert_allclose(found, (1 - np.exp(-(1 + 1j * omega) * 5)) / (1 + 1j * omega), rtol=1e-4)


def test_ends_and_leakage_do_not_bias() -> None:
    """A record that begins and ends anywhere, from a state of its own: exact numbers."""
    result = frequency_output_error(roll_only(), rolled(), FrequencyOptions(band=(0.1, 2.0)))
    assert result.converged
    assert result.parameters["rate"].estimate == pytest.approx(-5.0, rel=2e-3)
    assert result.parameters["gain"].estimate == pytest.approx(8.0, rel=2e-3)


def test_a_delay_of_the_input_and_of_an_output() -> None:
    late = Parameter("late", "s", start=0.05, lower=0.0, upper=0.3)
    by_input = roll_only(
        parameters=(*roll_only().parameters, late), transforms=(InputTransform("delay", "delta_a", ("late",)),)
    )
    flight = rolled(0.1, 0.0)
    result = frequency_output_error(by_input, flight, FrequencyOptions(band=(0.1, 2.0)))
    assert result.parameters["late"].estimate == pytest.approx(0.1, abs=2e-3)
    by_output = roll_only(parameters=(*roll_only().parameters, late), output_delays={"p": "late", "slope": "late"})
    result = frequency_output_error(by_output, flight, FrequencyOptions(band=(0.1, 2.0)))
    assert result.parameters["late"].estimate == pytest.approx(0.1, abs=5e-3)


@pytest.mark.parametrize("kind", ["plain", "late"])
def test_slopes_are_those_of_the_outputs(made_flights: list[Flight], kind: str) -> None:
    """Of every parameter and of the ends, against differences."""
    model = load_model("lateral", "cdfp")
    looked_at = model.free_names
    if kind == "late":
        late = [Parameter(n, "s", start=0.03) for n in ("late_a", "late_p")]
        model = model.plus(
            parameters=late, transforms=[InputTransform("lag", "delta_a", ("late_a",))], output_delays={"p": "late_p"}
        )
        looked_at = ("Cl_p", "late_a", "late_p")
    simulator = Simulator.build(model)
    data = prepare(model, made_flights[0])
    stretch = SpectralSegment(simulator, data, data.segments[0], Band(0.1, 2.0))
    values, ends = model.starts(), np.array([0.01, 0.1, -0.05, 0.02])
    at = stretch.response(values, ends)
    for name in looked_at:
        j = simulator.free.index(name)
        h = 1e-4 * max(abs(values[name]), 0.05)
        up = stretch.response({**values, name: values[name] + h}, ends).y
        down = stretch.response({**values, name: values[name] - h}, ends).y
        size = np.abs(at.by_parameter[:, :, j]).max()
        np.testing.assert_allclose(at.by_parameter[1:, :, j], ((up - down) / (2 * h))[1:], atol=2e-3 * size)
    moved = stretch.response(values, ends + np.array([0.0, 0.0, 1e-3, 0.0])).y
    np.testing.assert_allclose(
        at.by_ends[:, :, 2], (moved - at.y) / 1e-3, atol=1e-6 * np.abs(at.by_ends[:, :, 2]).max()
    )


def test_made_flights_come_out_within_their_bounds(made_flights: list[Flight]) -> None:
    model = load_model("lateral", "cdfp")
    scores = []
    for flight in made_flights[:2]:
        result = frequency_output_error(model, flight)
        assert result.converged
        scores += [(result.values[n] - TRUE[n]) / result.parameters[n].std_coloured for n in STRONG]
    assert np.all(np.abs(scores) < 3.5)
    assert 0.4 < np.sqrt(np.mean(np.square(scores))) < 1.6


@pytest.mark.parametrize("name", ["ordinary_0", "ordinary_2"])
def test_agrees_with_the_time_domain_on_flights_of_another_simulator(name: str) -> None:
    """Same data, same noise: what differs is the band and the weights, far less than a bound."""
    flight = read_flight(RECORDINGS / "foreign" / f"{name}.csv")
    model = load_model("lateral", "cdfp")
    there, here = output_error(model, flight), frequency_output_error(model, flight)
    truth = json.loads((RECORDINGS / "foreign" / "key.json").read_text())["ordinary"]["derivatives"]
    apart = []
    for n in STRONG:
        bound = max(there.parameters[n].std_coloured, here.parameters[n].std_coloured)
        apart.append((here.values[n] - there.values[n]) / bound)
        assert abs(here.values[n] - truth[n]) < 3.0 * bound
    assert np.max(np.abs(apart)) < 1.2
    assert np.sqrt(np.mean(np.square(apart))) < 0.7


def test_several_flights_with_constants_of_their_own(made_flights: list[Flight]) -> None:
    model = joint_model(load_model("lateral", "cdfp"))
    shifted = made_flights[1].with_columns(ay=made_flights[1]["ay"] + 0.3)
    both = frequency_output_error(model, [made_flights[0], shifted])
    assert both.converged
    alone = frequency_output_error(load_model("lateral", "cdfp"), made_flights[0])
    assert both.parameters["Cl_p"].std < 0.85 * alone.parameters["Cl_p"].std
    assert abs(both.values["CY_beta"] - TRUE["CY_beta"]) < 3.0 * both.parameters["CY_beta"].std_coloured
    local = [f.local["CY_0"].estimate for f in both.flights]
    assert local[1] - local[0] == pytest.approx(0.3 * 3.5 / (0.5 * 1.17 * 16.5**2 * 0.787), rel=0.1)


def test_gaps_and_missing_outputs(made_flights: list[Flight]) -> None:
    flight = made_flights[0]
    time = flight.time.copy()
    time[300:] += 7.0
    columns = {n: v.copy() for n, v in flight.columns.items()}
    columns["beta"][100:160] = np.nan
    model = load_model("lateral", "cdfp")
    result = frequency_output_error(model, Flight.build("cut", time, columns))
    assert result.converged
    assert abs(result.values["Cl_p"] - TRUE["Cl_p"]) < 3.5 * result.parameters["Cl_p"].std_coloured
    data = prepare(model, Flight.build("cut", time, columns))
    problem = FrequencyProblem([data], Simulator.build(model), Band(0.1, 2.0))
    assert [s.compared[1:, 0].any() for s in problem.stretches[0]] == [False, True]


def test_an_input_that_stands_still_is_named(made_flights: list[Flight]) -> None:
    still = made_flights[0].with_columns(delta_r=np.zeros(len(made_flights[0])))
    result = frequency_output_error(load_model("lateral", "cdfp"), still)
    assert "delta_r moved only" in result.parameters["Cn_dr"].why


def test_unusable_bands_and_stretches(made_flights: list[Flight]) -> None:
    model = load_model("lateral", "cdfp")
    for band in ((0.0, 1.0), (2.0, 1.0), (0.1, 30.0), (float("nan"), 1.0)):
        with pytest.raises(DataError, match="give two frequencies in order"):
            frequency_output_error(model, made_flights[0], FrequencyOptions(band=band))
    with pytest.raises(DataError, match="no stretch is long enough for method ml-frequency"):
        frequency_output_error(model, made_flights[0].part(slice(0, 12)))
    with pytest.raises(DataError, match="that cannot be settled"):
        frequency_output_error(model, made_flights[0], FrequencyOptions(band=(0.1, 0.2)))


def test_both_columns_through_the_command(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    flight = str(RECORDINGS / "foreign" / "ordinary_1.csv")
    words = [flight, "--aircraft", "cdfp", "--method", "ml,ml-frequency", "--json", str(path)]
    answer = CliRunner().invoke(estimate, words, standalone_mode=False)
    assert answer.exception is None, answer.output
    methods = json.loads(path.read_text())["flights"][0]["methods"]
    assert list(methods) == ["ml", "ml-frequency"]
    assert "frequencies from 0.1 to 3 Hz" in methods["ml-frequency"]["status"]
    assert set(methods["ml-frequency"]["parameters"]) == set(methods["ml"]["parameters"])
