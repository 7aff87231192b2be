"""Flights whose bank angle is an onboard filter's: recognised, its noise described alike in whitener and nulls."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.engine.transforms import apply_transforms
from estimation.gap.criteria import AS_SET
from estimation.gap.fit.linear_motion import Linear
from estimation.gap.fit.noise import (
    NoiseModel,
    NoisePart,
    NoiseSource,
    bank_error,
    estimate_noise,
    filtered_attitudes,
    shapes_of,
    slow_error,
    whitener,
)
from estimation.gap.records.candidate_model import with_nuisance
from estimation.gap.records.flight_records import FlightRecord
from estimation.gap.significance.nulls import NullFlyer
from estimation.models.base import InputTransform, ParameterRole
from estimation.models.load import load_model

OUTPUTS = ("beta", "p", "r", "phi", "ay")
STEP = 0.05


def record(filtered: bool, seed: int = 1, count: int = 600) -> FlightRecord:
    """Gyro noise alone; the bank angle integrates it, or is measured afresh."""
    rng = np.random.default_rng(seed)
    p = 0.007 * rng.standard_normal(count)
    bank = np.cumsum(p) * STEP if filtered else 0.002 * rng.standard_normal(count)
    still = 0.004 * rng.standard_normal(count)
    z = np.column_stack([still, p, still, bank, 10 * still])
    return FlightRecord(0, 0, STEP * np.arange(count), {}, z, np.zeros(4), {})


@pytest.mark.parametrize("filtered", [True, False])
def test_filter_is_told_from_a_measurement(filtered: bool) -> None:
    white = np.array([0.004, 0.007, 0.004, 1e-4 if filtered else 0.002, 0.05])
    assert filtered_attitudes([record(filtered)], OUTPUTS, white, AS_SET) == (("phi",) if filtered else ())


def test_rate_may_be_an_input() -> None:
    one = replace(record(True), input_noise={"p": 0.007})
    assert filtered_attitudes([one], ("beta", "phi"), np.array([0.004, 1e-4]), AS_SET) == ("phi",)
    assert filtered_attitudes([one], ("beta", "phi"), np.array([0.004, 2e-3]), AS_SET) == ()


def wandering(across: bool, lost: float = 0.0) -> tuple[FlightRecord, tuple[str, ...], Array]:
    """A turning aircraft whose bank angle is a filter's and wanders; (record, outputs, noise). across: pitch is an output too."""
    rng, time = np.random.default_rng(2), STEP * np.arange(600)
    bank_rate = 0.2 * np.sin(0.6 * time)
    q, r = np.full(600, 0.1), np.full(600, 0.15)
    true = np.concatenate([[0.0], np.cumsum(0.5 * STEP * (bank_rate[1:] + bank_rate[:-1]))])
    theta = np.full(600, 0.2)
    p = bank_rate - np.tan(theta) * (q * np.sin(true) + r * np.cos(true))
    noise = dict.fromkeys(("p", "r", "q"), 0.005)
    seen = {
        n: v + noise.get(n, 0.0) * rng.standard_normal(600) for n, v in {"p": p, "r": r, "q": q, "theta": theta}.items()
    }
    seen |= {"phi": true + 0.004 * np.sin(2.0 * np.pi * time / 12.0), "beta": 0.0 * time, "ay": 0.0 * time}
    outputs = (*OUTPUTS, "q", "theta") if across else OUTPUTS
    z = np.column_stack([seen[n] for n in outputs])
    z[rng.random(600) < lost] = np.nan
    inputs = {} if across else {n: seen[n] for n in ("q", "theta")}
    white = np.array([{"phi": 1e-4, "theta": 1e-4, "beta": 1e-3, "ay": 1e-2}.get(n, 0.005) for n in outputs])
    return FlightRecord(0, 0, time, inputs, z, np.zeros(4), {}), outputs, white


@pytest.mark.parametrize("across", [False, True])
@pytest.mark.parametrize("lost", [0.0, 0.1, 0.3])
def test_how_far_a_filter_wanders_is_known_in_every_model_and_with_rows_lost(across: bool, lost: float) -> None:
    one, outputs, white = wandering(across, lost)
    assert "phi" in filtered_attitudes([one], outputs, white, AS_SET)
    wider = bank_error([one], outputs, white, AS_SET)
    at = outputs.index("phi")
    assert wider[at] == pytest.approx(0.004 / np.sqrt(2.0), rel=0.35)  # a sine, and what gyro noise adds up to
    assert np.array_equal(np.delete(wider, at), np.delete(white, at))


def test_a_slow_error_that_hardly_any_step_shows_is_not_known() -> None:
    time = STEP * np.arange(600)
    every_third = np.where(np.arange(600) % 3 == 0, 0.0, np.nan)
    assert slow_error(time, every_third, np.zeros(600)) is None
    assert slow_error(time, np.zeros(600), np.zeros(600)) == pytest.approx(0.0, abs=1e-12)
    one, outputs, white = wandering(False)
    assert np.array_equal(
        bank_error([replace(one, inputs={})], outputs, white, AS_SET), white
    )  # nothing is known of its pitch


def linear() -> Linear:
    """An aircraft that hardly moves: what is seen is the instruments' own."""
    return Linear(
        A=-np.eye(4), B=np.zeros((4, 0)), C=np.zeros((5, 4)), D=np.zeros((5, 0)), inputs=(), dt=STEP, scale=np.ones(5)
    )


class _Outputs:
    """As much of a problem as the drawing of instrument noise asks for."""

    model = load_model("lateral", "cdfp")
    criteria = AS_SET


def drawn(noise: NoiseModel, count: int, seed: int) -> Array:
    flyer = NullFlyer(_Outputs(), None, noise, (), (), {}, (), (), (), ())  # type: ignore[arg-type]
    rng = np.random.default_rng(seed)
    made = np.sqrt(noise.measurement) * rng.standard_normal((count, 5))
    flyer._wander(made, STEP, rng)
    return made


NOISE = NoiseModel(
    np.array([0.004, 0.003, 0.005, 5e-4, 0.05]) ** 2,
    {NoisePart(NoiseSource.GYRO, "phi"): 0.006**2, NoisePart(NoiseSource.WANDERING, "phi"): 0.004**2},
)


def test_nulls_are_drawn_with_the_spectrum_that_the_whitener_takes_out() -> None:
    """White, of unit variance, in all channels and in all bands of frequency."""
    shapes = shapes_of(_Outputs.model, linear(), 1200, AS_SET, ("p",))
    quiet = replace(shapes, parts={n: shapes.parts[n] for n in NOISE.process})
    power = []
    for seed in range(12):
        white = whitener(NOISE, quiet).series(drawn(NOISE, 1200, seed))
        power.append(np.abs(np.fft.rfft(white, axis=0)) ** 2 / 1200)
    bands = np.mean(power, axis=0)[1:].reshape(-1, 100, 5).mean(axis=1)
    assert bands == pytest.approx(np.ones_like(bands), abs=0.12)


def test_strengths_are_found_again() -> None:
    shapes = shapes_of(_Outputs.model, linear(), 1200, AS_SET, ())
    names = {n: shapes.parts[n] for n in NOISE.process}
    records = [drawn(NOISE, 1200, 100 + seed) for seed in range(4)]
    known = {n: 0.3 * v for n, v in NOISE.process.items()}
    found = estimate_noise(
        records, [replace(shapes, parts=names)] * 4, 2.0 * NOISE.measurement, 0.01 * NOISE.measurement, known=known
    )
    assert np.sqrt(found.measurement) == pytest.approx(np.sqrt(NOISE.measurement), rel=0.15)
    assert found.process[NoisePart(NoiseSource.GYRO, "phi")] ** 0.5 == pytest.approx(0.006, rel=0.15)
    assert found.process[NoisePart(NoiseSource.WANDERING, "phi")] ** 0.5 == pytest.approx(0.004, rel=0.3)


def test_only_a_filtered_attitude_gets_timing_rounding_and_plumb_line() -> None:
    noise = dict.fromkeys(OUTPUTS, 0.01)
    plain, filtered = (
        with_nuisance(load_model("lateral", "cdfp"), noise, STEP, AS_SET, names) for names in ((), ("phi",))
    )
    more = set(filtered.parameter_names) - set(plain.parameter_names)
    assert more == {"timing_phi", "rounding_phi", "plumb_phi"}
    assert all(filtered.parameter(n).role is ParameterRole.NUISANCE for n in more)
    assert filtered.parameter("rounding_phi").prior_std == pytest.approx(STEP**2 / 12)


def test_opposite_delays_of_a_surface_cancel_exactly() -> None:
    """Done one after the other they would blur its edges, and a delay would be found where there is none."""
    time = STEP * np.arange(40)
    u = np.where(time > 1.0, 0.2, 0.0)[:, None]
    both = (InputTransform("delay", "delta_r", ("a",)), InputTransform("delay", "delta_r", ("b",)))
    assert apply_transforms(both, ("delta_r",), time, u, {"a": 0.02, "b": -0.02}) == pytest.approx(u)
    late = apply_transforms(both, ("delta_r",), time, u, {"a": 0.02, "b": 0.03})
    assert late[1:] == pytest.approx(u[:-1])
