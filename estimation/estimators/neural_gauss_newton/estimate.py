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

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray

from estimation.aircraft import Aircraft
from estimation.errors import EstimationError
from estimation.estimators.neural_gauss_newton.axes import axis_for
from estimation.estimators.neural_gauss_newton.campaign import usable_device
from estimation.estimators.neural_gauss_newton.formulation import Rows, Unknowns
from estimation.estimators.neural_gauss_newton.frozen import (
    Frozen,
    FrozenFit,
    Predict,
    fit_parameters,
    fit_with_instruments,
)
from estimation.estimators.neural_gauss_newton.network import Shape
from estimation.estimators.neural_gauss_newton.present import describe
from estimation.estimators.neural_gauss_newton.training import Trained, TrainingOptions, train
from estimation.estimators.result import Result
from estimation.models.base import Model
from groundstation.flight import Flight

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class NgnOptions:
    """improved: the interval form with a linear path; instruments: normal equations with instruments.

    hidden: neurons; ensemble: networks of different seeds whose estimates are averaged; bootstraps: networks of the
    block bootstrap (0: no honest spread, the Cramer-Rao bound stands alone); device: cpu, cuda or auto.
    """

    improved: bool = False
    instruments: bool = False
    hidden: int = 6
    training: TrainingOptions = field(default_factory=lambda: TrainingOptions(restarts=1))
    ensemble: int = 2
    bootstraps: int = 24
    bootstrap_iterations: int = 4
    seed: int = 0
    device: str = "cpu"


def default_options(improved: bool, axis: str = "lateral") -> NgnOptions:
    """What the study found best. The published form's networks differ more, so it takes more of them.

    Longitudinal: lift follows angle of attack so closely that instruments carry too little of what is left.
    """
    if improved and axis == "lateral":
        return NgnOptions(improved=True, instruments=True)
    steady = TrainingOptions(restarts=1, decay=1e-2)
    if improved:
        return NgnOptions(improved=True, hidden=4, training=steady)
    return NgnOptions(training=steady, ensemble=4)


@dataclass(frozen=True)
class Solution:
    """theta: (n,) estimates; bound, spread: (n, n) covariances, Cramer-Rao and bootstrap with ensemble."""

    theta: Array
    bound: Array
    spread: Array
    members: Array
    bootstrap: Array
    fits: tuple[FrozenFit, ...]
    trained: tuple[Trained, ...]


def estimate_ngn(
    aircraft: Aircraft,
    flights: Flight | Sequence[Flight],
    *,
    model: Model | None = None,
    improved: bool = False,
    options: NgnOptions | None = None,
    device: str | None = None,
) -> Result:
    """Estimates over one flight or several together, in the same form as every other method's.

    model: one of the built-in lateral or longitudinal ones (default: lateral), with parameters fixed or local as wished.
    options: decide over `improved` where given (default: `default_options`). device: cpu, cuda or auto, for torch.
    Raises EstimationError for another model, MissingColumnError and DataError for a flight that cannot be used.
    """
    from estimation.models import load_model

    many = [flights] if isinstance(flights, Flight) else list(flights)
    chosen = load_model("lateral", aircraft) if model is None else model
    axis = axis_for(chosen.name, aircraft)
    if axis is None:
        raise EstimationError(
            f"model {chosen.name}: Neural Gauss-Newton has a formulation for lateral, lateral-simple and longitudinal; "
            "use method ml"
        )
    opt = options or default_options(improved, axis.name)
    opt = replace(opt, device=usable_device(opt.device if device is None else device))
    unknowns = Unknowns.of(chosen, axis, len(many))
    rows = Rows.build(axis, many, "interval" if opt.improved else "point", opt.device)
    with one_thread(opt.device):
        solution = solve(rows, unknowns, opt)
    return describe(chosen, many, rows, unknowns, solution, _settings(rows, opt), opt.improved)


@contextmanager
def one_thread(device: str) -> Iterator[None]:
    """Sums in the same order on every machine, so that the same seed gives the same bits; as it was before afterwards."""
    before = torch.get_num_threads()
    if device == "cpu":
        torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def solve(rows: Rows, unknowns: Unknowns, options: NgnOptions) -> Solution:
    """Train, freeze, estimate; then again for the ensemble and the bootstrap."""
    shape = Shape(rows.u.shape[1], options.hidden, rows.z.shape[1], skip=options.improved)
    instruments = rows.instruments() if options.instruments else None
    trained, fitted = [], []
    for member in range(max(1, options.ensemble)):
        net = _trained(shape, rows, options, member)
        trained.append(net)
        fitted.append(_parameters(shape, rows, unknowns, net, instruments))
    members = np.stack([f.theta for f in fitted])
    drawn = _bootstrap(shape, rows, unknowns, options, instruments, trained, fitted)
    bound = np.mean([np.linalg.pinv(f.information, hermitian=True) for f in fitted], axis=0)
    spread = np.atleast_2d(np.cov(drawn, rowvar=False)) if len(drawn) > 1 else bound
    if len(members) > 1:
        spread = spread + np.atleast_2d(np.cov(members, rowvar=False)) / len(members)
    return Solution(members.mean(axis=0), bound, spread, members, drawn, tuple(fitted), tuple(trained))


def _trained(shape: Shape, rows: Rows, options: NgnOptions, member: int) -> Trained:
    """Chosen among restarts by the held-out blocks, then trained on with all rows."""
    generator = torch.Generator().manual_seed(1000 * options.seed + member)
    chosen = train(shape, rows.u, rows.z, rows.held_out, options.training, generator)
    everything = torch.zeros_like(rows.held_out)
    finished = train(shape, rows.u, rows.z, everything, options.training, generator, start=chosen.weights)
    return replace(
        finished, validation_error=chosen.validation_error, iterations=chosen.iterations + finished.iterations
    )


def _predict(frozen: Frozen, rows: Rows, unknowns: Unknowns, signals: Sequence[dict[str, Array] | None]) -> Predict:
    def predict(theta: Array) -> tuple[list[Array], list[Array]]:
        residuals, slopes = [], []
        for stretch, flight, own in zip(rows.stretches, rows.flight, signals, strict=True):
            r, s = frozen.residual_and_slope(stretch, unknowns.of_flight(flight, theta), own)
            residuals.append(r)
            slopes.append(unknowns.scatter(flight, s))
        return residuals, slopes

    return predict


def _parameters(
    shape: Shape,
    rows: Rows,
    unknowns: Unknowns,
    net: Trained,
    instruments: list[dict[str, Array]] | None,
    *,
    start: Array | None = None,
    drawn: Array | None = None,
    iterations: int = 40,
) -> FrozenFit:
    """Gauss-Newton with one frozen network; in the improved form from there to the root with instruments."""
    frozen = Frozen(rows.axis, shape, net.weights, rows.standard)
    counts = [len(s.u) for s in rows.stretches]
    smooth = _predict(frozen, rows, unknowns, [s.smooth for s in rows.stretches])
    multiplicity = None if drawn is None else rows.split(drawn)
    believed = unknowns.start if start is None else start
    if instruments is None:
        return fit_parameters(
            smooth, unknowns.size, counts, start=believed, multiplicity=multiplicity, iterations=iterations
        )
    if start is None:
        start = fit_parameters(smooth, unknowns.size, counts, start=believed, multiplicity=multiplicity).theta
    measured = _predict(frozen, rows, unknowns, [None] * len(counts))
    instrument = _predict(frozen, rows, unknowns, instruments)
    return fit_with_instruments(
        measured, instrument, counts, start, multiplicity=multiplicity, iterations=min(iterations, 20)
    )


def _bootstrap(
    shape: Shape,
    rows: Rows,
    unknowns: Unknowns,
    options: NgnOptions,
    instruments: list[dict[str, Array]] | None,
    trained: Sequence[Trained],
    fitted: Sequence[FrozenFit],
) -> Array:
    """(bootstraps, n) estimates with networks trained further, and parameters fitted again, on resampled blocks."""
    rng = np.random.default_rng([options.seed, 64])
    everything = torch.zeros_like(rows.held_out)
    short = replace(options.training, optimiser="lm", iterations=options.bootstrap_iterations)
    found = []
    for k in range(options.bootstraps):
        member = k % len(trained)
        drawn = rows.resampled(rng)
        weight = torch.as_tensor(drawn, device=rows.u.device)
        net = train(
            shape, rows.u, rows.z, everything, short, torch.Generator(), multiplicity=weight,
            start=trained[member].weights,
        )  # fmt: skip
        fit = _parameters(
            shape, rows, unknowns, net, instruments, start=fitted[member].theta, drawn=drawn, iterations=3
        )
        found.append(fit.theta - fitted[member].theta)
    return np.array(found).reshape(-1, unknowns.size)


def _settings(rows: Rows, options: NgnOptions) -> dict[str, object]:
    """What is needed to do it again."""
    from estimation.estimators.neural_gauss_newton import samples

    smoothing = (
        f"means over {samples.INTERVAL_S:g} s" if options.improved
        else f"piecewise polynomials, derivative on {samples.DERIVATIVE_POINTS} points"
    )  # fmt: skip
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
