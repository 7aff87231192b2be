"""Which terms a model over the envelope needs: likelihoods of flights held out, from the normal equations of every flight.

Near the joint optimum the log likelihood of flight i changes with the shared parameters by g_i d - d' M_i d / 2, its own initial
states and constants eliminated. So a term's estimate without some flights, and its gain in predicting them, take linear algebra
alone: every candidate is tried on every flight held out without another fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.engine.simulate import Simulator
from estimation.estimators.likelihood import OutputErrorProblem
from estimation.estimators.normal_equations import FlightBlocks
from estimation.estimators.result import Result
from estimation.models.base import Model
from estimation.prepare.flight_data import FlightData
from groundstation.flight import Array

ADVANTAGE = 1.5
"""Standard errors of the held-out gain that a term needs: one useless term in 2000 has them, so 5 % of searches among 80 take
one."""
EVEN = 2.0  # standard errors of the difference within which two terms gain the same
MOST_FOLDS = 50  # groups of flights held out together; with fewer flights each is a fold
LEAST_INFORMATION = 1e-9
"""Share of a candidate's information that is left beside the other terms: with less it is a combination of them."""
LEAST_SCALE = 1e-300  # in place of zero, for a parameter that no flight shows
RIDGE = 1e-12  # added to a diagonal of one: a parameter that no flight shows stays where it is


@dataclass(frozen=True)
class PooledInformation:
    """names: (n,) shared parameters; M: (flights, n, n) information and g: (flights, n) gradient of the log likelihood."""

    names: tuple[str, ...]
    M: Array
    g: Array


@dataclass(frozen=True)
class TermGain:
    """A chosen term. gain: in log likelihood over all flights, each predicted by the others; std: its standard error."""

    name: str
    gain: float
    std: float


def information(wide: Model, data: Sequence[FlightData], result: Result, simulator: Simulator) -> PooledInformation:
    """Normal equations of each flight about the shared parameters of `wide`, at the optimum of a model that it contains.

    result: of that model on these flights; its noise is taken as known. Flights are evaluated one at a time, to save memory.
    """
    values = {**wide.starts(), **{n: e.estimate for n, e in result.parameters.items()}}
    sigma = np.sqrt(np.diag(result.R))
    local = [n for n in simulator.free if wide.parameter(n).local]
    names = tuple(n for n in simulator.free if n not in local)
    shared_indices = np.array([simulator.free.index(n) for n in names], np.intp)
    local_indices = np.array([simulator.free.index(n) for n in local], np.intp)
    M, g = np.zeros((len(data), len(names), len(names))), np.zeros((len(data), len(names)))
    for i, flight in enumerate(data):
        problem = OutputErrorProblem(wide, [flight], simulator, sigma=sigma)
        local_values = {n: e.estimate for n, e in result.flights[i].local.items()}
        unknowns = problem.pack({**values, **local_values}, [list(result.flights[i].initial_states)])
        blocks = problem.flight_blocks(unknowns, problem.evaluate(unknowns, True), 0)
        split = FlightBlocks.split(blocks.ss, blocks.gs, shared_indices, local_indices)
        M[i], g[i] = split.reduced()
    return PooledInformation(names, M, g)


def terms_that_gain(
    pooled_information: PooledInformation, active: Sequence[str], candidates: Sequence[str], most: int
) -> list[TermGain]:
    """Terms taken one after the other, the one with the largest held-out gain first, while it is clear of chance.

    active: parameters that stand; candidates: candidates, of several that do as well the first is taken; most: terms at most.
    """
    M, g = _folds(pooled_information)
    place = {n: k for k, n in enumerate(pooled_information.names)}
    active_columns = [place[n] for n in active]
    open_columns = [place[n] for n in candidates]
    current_gains = _gains(M, g, active_columns)
    gains_in_order: list[TermGain] = []
    while len(gains_in_order) < most:
        gains = {
            k: _gains(M, g, [*active_columns, k]) - current_gains
            for k in open_columns
            if _separable(M.sum(axis=0), active_columns, k)
        }
        if not gains:
            break
        largest = gains[max(gains, key=lambda k: float(gains[k].sum()))]
        chosen_column = next(k for k in open_columns if k in gains and not _clear(largest - gains[k], EVEN))
        total, std = float(gains[chosen_column].sum()), float(gains[chosen_column].std(ddof=1) * np.sqrt(len(M)))
        if not _clear(gains[chosen_column], ADVANTAGE):
            break
        gains_in_order.append(TermGain(pooled_information.names[chosen_column], total, std))
        current_gains = current_gains + gains[chosen_column]
        active_columns.append(chosen_column)
        open_columns.remove(chosen_column)
    return gains_in_order


def superfluous_terms(
    pooled_information: PooledInformation, active: Sequence[str], estimates: Mapping[str, float]
) -> list[str]:
    """Terms without which flights held out are not clearly worse predicted, judged beside the other active terms.

    estimates: candidate for removal -> its estimate.
    """
    M, g = _folds(pooled_information)
    place = {n: k for k, n in enumerate(pooled_information.names)}
    active_columns, removed = [place[n] for n in active], []
    candidates, fixed_changes = list(estimates), np.zeros(len(pooled_information.names))
    while candidates:
        current_gains = _gains(M, g, active_columns, fixed_changes)
        losses = {}
        for n in candidates:
            changes_without = fixed_changes.copy()
            changes_without[place[n]] = -estimates[n]
            losses[n] = current_gains - _gains(M, g, [k for k in active_columns if k != place[n]], changes_without)
        weakest = min(candidates, key=lambda n: float(losses[n].sum()))
        if _clear(losses[weakest], ADVANTAGE):
            break
        removed.append(weakest)
        candidates.remove(weakest)
        fixed_changes[place[weakest]] = -estimates[weakest]
        active_columns.remove(place[weakest])
    return removed


def _clear(gains: Array, errors: float) -> bool:
    """Whether the sum of (folds,) gains is more than this many of its standard errors above zero."""
    return float(gains.sum()) > errors * float(gains.std(ddof=1)) * float(np.sqrt(len(gains)))


def _folds(pooled_information: PooledInformation) -> tuple[Array, Array]:
    """Information and gradient summed over each fold. Neighbours in the list of flights go to different folds."""
    count = min(len(pooled_information.M), MOST_FOLDS)
    M = np.stack([pooled_information.M[k::count].sum(axis=0) for k in range(count)])
    g = np.stack([pooled_information.g[k::count].sum(axis=0) for k in range(count)])
    return M, g


def _gains(M: Array, g: Array, columns: Sequence[int], fixed_changes: Array | None = None) -> Array:
    """(folds,) change of each fold's log likelihood with the parameters `columns` as estimated from the other folds.

    fixed_changes: (n,) changes of the other parameters, zero by default.
    """
    fixed_changes = np.zeros(g.shape[1]) if fixed_changes is None else fixed_changes
    fixed = g @ fixed_changes - 0.5 * np.einsum("i,kij,j->k", fixed_changes, M, fixed_changes)
    slope = (g - M @ fixed_changes)[:, columns]
    fold_information = M[np.ix_(range(len(M)), columns, columns)]
    scale = np.sqrt(np.maximum(np.einsum("kii->ki", fold_information).sum(axis=0), LEAST_SCALE))
    rest_information = (fold_information.sum(axis=0) - fold_information) / np.outer(scale, scale)
    ridge = RIDGE * np.eye(len(columns))
    d = np.linalg.solve(rest_information + ridge, ((slope.sum(axis=0) - slope) / scale)[:, :, None])[:, :, 0] / scale
    gains: Array = fixed + np.einsum("ki,ki->k", slope, d) - 0.5 * np.einsum("ki,kij,kj->k", d, fold_information, d)
    return gains


def _separable(M: Array, columns: Sequence[int], k: int) -> bool:
    """Whether the flights separate candidate k from the parameters `columns`. M: (n, n) information of all flights."""
    if M[k, k] <= 0.0:
        return False
    cross = M[np.ix_(columns, [k])][:, 0]
    rest = M[k, k] - cross @ np.linalg.lstsq(M[np.ix_(columns, columns)], cross, rcond=None)[0]
    return bool(rest > LEAST_INFORMATION * M[k, k])
