"""Flights on which nothing is hidden: the fitted baseline flown again, seen through instruments as noisy as the real ones.

The same baseline, gusts, surface freedom and noise as in the workflow's own nulls; but where the workflow needs residuals,
a regression needs whole flights, so the recorded inputs get fresh noise too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.gap.criteria import AS_SET
from estimation.gap.effects import catalogue
from estimation.gap.fit.baseline import Baseline, fit_baseline
from estimation.gap.fit.noise import bank_error, channel_noise, filtered_attitudes
from estimation.gap.fit.problem import Local
from estimation.gap.records.candidate_model import with_dormant, with_nuisance
from estimation.gap.records.flight_records import FlightRecords, prepare_flights
from estimation.gap.significance.nulls import InputErrors, NullFlyer
from estimation.models.dependence import force_states
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies.gap_regression.equations import CONSTANTS, COURSES, with_airspeed_rate
from tests.studies.gap_regression.library import Array, Signals


def signals(flight: Flight, constants: Mapping[str, float]) -> Signals:
    """Measured signals of a flight with what is known of the aircraft."""
    step = float(np.median(np.diff(flight.time)))
    known = {**{n: constants[n] for n in CONSTANTS}, **{n: flight[n] for n in COURSES}, "step": step}
    return with_airspeed_rate(known)


def fake_flights(
    training: Sequence[Flight], constants: Mapping[str, float], count: int, seed: int
) -> list[list[Signals]]:
    """`count` sets of flights like `training` without any effect.

    The baseline carries timing offsets and instrument biases, and a hidden effect moves them: a surface that acts late the
    one, a centre of gravity to one side the other. Nulls that flew with them would hide such effects from a regression,
    which has no such unknowns. So timing is kept within the tenth of a sample that its prior allows, and biases are zero.
    """
    baseline, prepared = fitted_baseline(training)
    problem, names = baseline.problem, baseline.model.output_names
    values = {n: _clipped(n, v, sample_interval(training)) for n, v in baseline.fit.values.items()}
    fit = replace(baseline.fit, values=values, locals=tuple(_unbiased(local) for local in baseline.fit.locals))
    exact = [InputErrors({})] * len(prepared.records)  # outputs exactly of the inputs; these get their noise below
    flyer = NullFlyer.build(problem, fit, baseline.noise, exact)
    without = [problem.residual(i, values, local) for i, local in enumerate(fit.locals)]
    made: list[list[Signals]] = []
    for number in range(2 * count):
        rng = np.random.default_rng([seed, 15485863, number])
        flown = [flyer.fly(i, rng) for i in range(len(prepared.records))]
        fakes = []
        for flight, record, coarse, left, residual in zip(
            training, prepared.records, problem.coarse, without, flown, strict=True
        ):
            if len(record) != flight.time.size:
                raise ValueError(f"{flight.name}: only unbroken flights can be compared")
            if residual is None or left is None:
                break
            shown = coarse.z - left + residual
            fake = dict(signals(flight, constants))
            fake |= {n: shown[:, i] for i, n in enumerate(names) if n in COURSES}
            fake |= {
                n: _noisy(x, record.input_noise.get(n, 0.0), rng) for n, x in record.inputs.items() if n in COURSES
            }
            fakes.append(with_airspeed_rate(fake))
        if len(fakes) == len(training):
            made.append(fakes)
        if len(made) == count:
            break
    return made


def fitted_baseline(training: Sequence[Flight]) -> tuple[Baseline, FlightRecords]:
    """The workflow's own baseline of these flights."""
    model, effects = load_model("lateral", "cdfp"), catalogue()
    prepared = prepare_flights(model, effects, training, (), AS_SET)
    white = channel_noise(prepared.records)
    scatter = bank_error(prepared.records, model.output_names, white, AS_SET)
    filtered = filtered_attitudes(prepared.records, model.output_names, white, AS_SET)
    step = sample_interval(training)
    clean = with_nuisance(model, dict(zip(model.output_names, scatter, strict=True)), step, AS_SET, filtered)
    working = with_dormant(clean, effects, prepared.available, force_states(model))
    return fit_baseline(working, clean, prepared, scatter), prepared


def sample_interval(training: Sequence[Flight]) -> float:
    return float(np.median(np.diff(training[0].time)))


def _unbiased(local: Local) -> Local:
    return replace(local, parameters={n: 0.0 if n.startswith("bias_") else v for n, v in local.parameters.items()})


def _clipped(name: str, value: float, step: float) -> float:
    limit = AS_SET.timing_share * step
    return min(max(value, -limit), limit) if name.startswith("timing_") else value


def _noisy(x: Array, sigma: float, rng: np.random.Generator) -> Array:
    return np.asarray(x + sigma * rng.standard_normal(x.size))
