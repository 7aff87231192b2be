"""One model of the whole envelope, fitted by maximum likelihood to the flights themselves.

Derivatives are polynomials of angle of attack, airspeed, elevator, sideslip and their own control. All flights are fitted
together; each keeps its constants and initial states. Terms are chosen by their gain on flights held out (`evidence`), then all
is fitted again, until no further term gains.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.campaign.aerodynamics.evidence import TermGain, information, superfluous_terms, terms_that_gain
from estimation.campaign.aerodynamics.terms import (
    CENTRED,
    POWERS,
    ConditionTerm,
    candidates,
    derivatives_of,
    row_of,
    with_terms,
)
from estimation.campaign.pooling import LEVEL, t_quantile
from estimation.campaign.tasks import CampaignError
from estimation.engine.simulate import Simulator
from estimation.estimators.output_error import STANDARD, OutputErrorOptions, output_error
from estimation.estimators.result import Result
from estimation.models.base import Model, joint_model
from estimation.prepare.flight_data import AS_USUAL, FlightData, Preparation, without_absent_outputs
from estimation.prepare.pipeline import prepare_all
from estimation.prepare.stretches import unique_names
from estimation.session.proof_of_match import flown_ranges
from groundstation.flight import Array, Flight

FEWEST = 4  # flights: with fewer, those that are not held out cannot choose terms
FLIGHTS_A_TERM = 2  # at least: more terms would fit single flights
AS_MEASURED = OutputErrorOptions(preparation=Preparation(denoise=False))
"""Options of the last fit: inputs with their noise. De-noising flattens the dip of airspeed in each large sideslip. That error is
the same in every flight of the same manoeuvre, so it does not average out: it looks like a cubic in sideslip and a part of
Cn_beta. The noise does average out: it multiplies simulated states and enters the estimates only by its square. Terms are chosen
with de-noised inputs: among noisy ones airspeed, which is measured better, would take the place of the angle of attack."""
ROUNDS = 3  # of choosing and fitting: the second hardly ever adds a term


@dataclass(frozen=True)
class GlobalModel:
    """result: of the joint fit; its terms are in `result.model`; gains: of the terms, in the order of choice; flown: variable ->
    range; why: reason where the search for terms ended early, else empty."""

    result: Result
    gains: tuple[TermGain, ...]
    flown: Mapping[str, tuple[float, float]]
    why: str = ""

    @property
    def model(self) -> Model:
        """The model with the estimates as values, mean constants of the flights and the ranges flown, for `sideslip match`."""
        return replace(self.result.fitted_model, flown=self.flown)

    @property
    def text(self) -> str:
        """A sentence on the terms."""
        if self.why:
            return self.why
        if not self.gains:
            return "no term over the envelope gains enough: the derivatives are constants on these flights"
        gain_list = ", ".join(f"{g.name} ({g.gain:.0f} +- {g.std:.0f})" for g in self.gains)
        return f"terms by what they gain in log likelihood on flights held out: {gain_list}"

    def at(self, derivative: str, conditions: Sequence[Mapping[str, float]]) -> tuple[Array, Array]:
        """(points,) a derivative and its corrected bound at values of alpha [rad], V [m/s], beta [rad], delta_e [rad] ..."""
        return curve(
            self.result.model,
            self.result.names,
            self.result.values,
            self.result.covariance_coloured,
            derivative,
            conditions,
        )


def half_band(std: Array, flights: int) -> Array:
    """Half width of the 95 % band: Student's t with flights - 1 degrees of freedom, because the covariance is estimated from the
    residuals of the flights."""
    half: Array = t_quantile(1.0 - LEVEL / 2.0, flights - 1) * std
    return half


def curve(
    model: Model,
    names: Sequence[str],
    values: Mapping[str, float],
    covariance: Array,
    derivative: str,
    conditions: Sequence[Mapping[str, float]],
) -> tuple[Array, Array]:
    """(points,) a derivative and its bound at conditions. names: in the order of covariance."""
    rows = np.array([row_of(model, derivative, names, point) for point in conditions])
    std: Array = np.sqrt(np.maximum(np.einsum("pi,ij,pj->p", rows, covariance, rows), 0.0))
    return rows @ np.array([values[n] for n in names]), std


def global_model(
    model: Model, flights: Sequence[Flight], tell: Callable[[str], None] = lambda text: None
) -> GlobalModel:
    """Choose terms and fit. model: of one condition; its constants become local to each flight. Raises CampaignError for too few
    flights, DataError for flights without the data that the model needs."""
    if len(flights) < FEWEST:
        raise CampaignError(f"a model over the envelope needs {FEWEST} flights to hold some out; {len(flights)} given")
    base = joint_model(model)
    flights = unique_names(flights)
    reference = references(flights)
    term_candidates = candidates(base, [v for v in POWERS if _in_all(flights, v)])
    wide = with_terms(base, term_candidates, reference)
    tell(f"{len(flights)} flights together, {len(term_candidates)} terms to choose from")
    slim, data = without_absent_outputs(wide, prepare_all(wide, flights, AS_USUAL))
    fit = _Fit(base, flights, data, slim, Simulator.build(slim), term_candidates, reference)
    result, gains = output_error(base, flights), tuple[TermGain, ...]()
    for wave in ([t for t in term_candidates if t.first], term_candidates):
        for _ in range(ROUNDS):
            if problem := fit.unusable(result):
                return GlobalModel(result, gains, flown_ranges(result.model, flights), problem)
            new_gains = fit.new_terms(result, wave, len(flights) // FLIGHTS_A_TERM - len(gains))
            if not new_gains:
                break
            gains = (*gains, *new_gains)
            tell(f"{len(gains)} terms over the envelope; fitting again")
            result = fit.again(result, gains)
    if not fit.unusable(result):
        gains = fit.needed(result, gains) if gains else gains
        tell(f"{len(gains)} terms are enough; fitting again with inputs as measured")
        result = fit.again(result, gains, AS_MEASURED)
    return GlobalModel(result, gains, flown_ranges(result.model, flights), fit.unusable(result))


@dataclass(frozen=True)
class _Fit:
    """The common data of all fits of a search. wide, data, simulator: with all candidate terms, for the evidence."""

    base: Model
    flights: Sequence[Flight]
    data: Sequence[FlightData]
    wide: Model
    simulator: Simulator
    tried: Sequence[ConditionTerm]
    reference: Mapping[str, float]

    def new_terms(self, result: Result, wave: Sequence[ConditionTerm], most: int) -> list[TermGain]:
        """At most `most` terms of `wave` that gain on flights held out, beside those of the result."""
        pooled_information = information(self.wide, self.data, result, self.simulator)
        active = [n for n in pooled_information.names if n in result.parameters]
        return terms_that_gain(pooled_information, active, [t.name for t in wave if t.name not in active], most)

    def needed(self, result: Result, gains: tuple[TermGain, ...]) -> tuple[TermGain, ...]:
        """The terms that still gain beside all the others."""
        pooled_information = information(self.wide, self.data, result, self.simulator)
        active = [n for n in pooled_information.names if n in result.parameters]
        removed = superfluous_terms(pooled_information, active, {g.name: result.values[g.name] for g in gains})
        return tuple(g for g in gains if g.name not in removed)

    def again(self, earlier: Result, gains: Sequence[TermGain], options: OutputErrorOptions = STANDARD) -> Result:
        """The joint fit with the chosen terms, started from the derivatives of the fit before."""
        names = {g.name for g in gains}
        extended_model = with_terms(self.base, [t for t in self.tried if t.name in names], self.reference)
        start = {n: earlier.values[n] for n in derivatives_of(self.base)}
        return output_error(extended_model, self.flights, start, options)

    def unusable(self, result: Result) -> str:
        """Why terms cannot be chosen from a result; empty where they can."""
        complete = all(len(f.initial_states) == len(d.segments) for f, d in zip(result.flights, self.data, strict=True))
        return "" if result.converged and complete else f"no further terms were tried: {result.text}"


def references(flights: Sequence[Flight]) -> dict[str, float]:
    """Means over the flights, `alpha_ref` ..., of the variables in CENTRED that all of them measured."""
    return {f"{v}_ref": float(np.mean([np.nanmean(f[v]) for f in flights])) for v in CENTRED if _in_all(flights, v)}


def _in_all(flights: Sequence[Flight], column: str) -> bool:
    return all(f.measured(column) for f in flights)
