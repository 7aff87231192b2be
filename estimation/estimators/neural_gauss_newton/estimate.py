"""Neural Gauss-Newton estimates of a flight, or of several together: `ngn` as published, and `ngn-improved`.

Published form: S. Das, R. A. Kuttieri, M. Sinha and R. Jategaonkar, Journal of Guidance, Control and Dynamics 33(1),
2010, and The Aeronautical Journal (2018), pp 889-912. A network learns the motion one step ahead from motion and
measured coefficients; then it is frozen, the coefficients come from the aerodynamic model, and Gauss-Newton finds the
parameters that let it predict best. No equation of motion is solved.

Improved form: coefficients are means over an interval (`samples`), a linear path goes round the hidden layer, and the
normal equations are formed with instruments (`instruments`), so that neither the derivative of a rate nor noise in the
regressors makes the parameters small. An ensemble of networks is averaged.

The Cramer-Rao bound of a frozen network takes the network for truth and its inputs for exact, and is far too small. The
honest spread is from a block bootstrap (networks trained again on resampled blocks) together with the ensemble's.
"""

from collections.abc import Sequence
from dataclasses import asdict, replace

from estimation.aircraft import Aircraft
from estimation.errors import EstimationError
from estimation.estimators.neural_gauss_newton.axes import Axis, axis_for
from estimation.estimators.neural_gauss_newton.device import one_thread, usable_device
from estimation.estimators.neural_gauss_newton.formulated import refusal
from estimation.estimators.neural_gauss_newton.formulation import FlightUnknowns, TrainingRows
from estimation.estimators.neural_gauss_newton.options import NgnOptions, default_options
from estimation.estimators.neural_gauss_newton.present import describe
from estimation.estimators.neural_gauss_newton.solve import NeuralProblem, solve
from estimation.estimators.result import Result
from estimation.models.base import Model
from estimation.prepare.columns import with_derived
from groundstation.flight import Flight


def estimate_ngn(
    aircraft: Aircraft,
    flights: Flight | Sequence[Flight],
    *,
    model: Model | None = None,
    improved: bool = False,
    options: NgnOptions | None = None,
    device: str | None = None,
    bootstraps: int | None = None,
    seed: int | None = None,
) -> Result:
    """Estimates over one flight or several together, in the same form as every other method's.

    model: one of the built-in lateral or longitudinal ones (default: lateral), with parameters fixed or local as wished.
    options: decide over `improved` where given (default: `default_options`), device (cpu, cuda or auto),
    bootstraps and seed over what the options say; bootstraps asked for are in the result's `bootstrap`.
    Raises EstimationError for another model, MissingColumnError and DataError for a flight that cannot be used.
    """
    many = [flights] if isinstance(flights, Flight) else list(flights)
    return _estimate(aircraft, [many], model, improved, options, device, bootstraps, seed)[0]


def estimate_campaign(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    *,
    model: Model | None = None,
    improved: bool = False,
    options: NgnOptions | None = None,
    device: str | None = None,
    bootstraps: int | None = None,
    seed: int | None = None,
) -> list[Result]:
    """As `estimate_ngn` for each flight by itself, with the networks of all flights trained side by side.

    Results are those of one flight after the other, within rounding.
    """
    return _estimate(aircraft, [[f] for f in flights], model, improved, options, device, bootstraps, seed)


def _estimate(
    aircraft: Aircraft,
    sets: Sequence[Sequence[Flight]],
    model: Model | None,
    improved: bool,
    options: NgnOptions | None,
    device: str | None,
    bootstraps: int | None,
    seed: int | None,
) -> list[Result]:
    from estimation.models import load_model

    chosen = load_model("lateral", aircraft) if model is None else model
    axis = axis_for(chosen.name, aircraft)
    if axis is None:
        raise EstimationError(refusal(chosen.name))
    opt = options or default_options(improved, axis.name)
    opt = replace(
        opt,
        device=usable_device(opt.device if device is None else device),
        bootstraps=opt.bootstraps if bootstraps is None else bootstraps,
        seed=opt.seed if seed is None else seed,
    )
    with one_thread():
        problems = [_problem(axis, chosen, flights, opt) for flights in sets]
        solutions = solve(problems, opt)
    return [
        describe(chosen, flights, p, s, _settings(p.rows, opt), bootstraps is not None)
        for flights, p, s in zip(sets, problems, solutions, strict=True)
    ]


def _problem(axis: Axis, model: Model, flights: Sequence[Flight], options: NgnOptions) -> NeuralProblem:
    unknowns = FlightUnknowns.of(model, axis, len(flights))
    complete = [with_derived(f, axis.columns) for f in flights]
    return NeuralProblem(
        TrainingRows.build(axis, complete, "interval" if options.improved else "point"), unknowns, options
    )


def _settings(rows: TrainingRows, options: NgnOptions) -> dict[str, object]:
    """What is needed to do it again."""
    from estimation.estimators.neural_gauss_newton import samples

    smoothing = (
        f"means over {samples.INTERVAL_S:g} s"
        if options.improved
        else "piecewise polynomials, derivatives of cubic splines"
    )
    return {
        "form": "interval" if options.improved else "point",
        "inputs": [*rows.motion, *rows.axis.coefficients],
        "outputs": [*rows.motion, *rows.axis.accelerations],
        "hidden": options.hidden,
        "smoothing": smoothing,
        "training": asdict(options.training),
        "seed": options.seed,
        "instruments": options.instruments,
        "ensemble": options.ensemble,
        "bootstraps": options.bootstraps,
        "rows": int(rows.u.shape[0]),
        "device": options.device,
    }
