"""One model of the whole envelope, fitted by maximum likelihood to the flights themselves.

Derivatives are polynomials of angle of attack, airspeed, elevator, sideslip and their own control. All flights are fitted
together; each keeps its constants and initial states. Terms are taken by what they gain on flights held out (`evidence`), then
everything is fitted again, until no further term is asked for.
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

FEWEST = 4  # flights: fewer cannot be held out and leave a choice
FLIGHTS_A_TERM = 2  # at least: more terms than that follow flights, not the aircraft
AS_MEASURED = OutputErrorOptions(preparation=Preparation(denoise=False))
"""Of the last fit: inputs with their noise. What takes it off shaves the dip of airspeed in each large sideslip, which is the
same in every flight that flies the same manoeuvre: it does not average away, and passes for a cubic in sideslip and a part of
Cn_beta. Noise itself does: it multiplies states that are simulated, not measured, and enters the estimates by its square only.
Terms are chosen with the noise taken off: with it airspeed is measured better than angle of attack, and takes its place."""
ROUNDS = 3  # of choosing and fitting: the second hardly ever finds another term


@dataclass(frozen=True)
class GlobalModel:
    """result: of the joint fit with its terms, in `result.model`; gains: of the terms, in the order in which they were taken;
    flown: variable -> range; why: where none could be looked for."""

    result: Result
    gains: tuple[TermGain, ...]
    flown: Mapping[str, tuple[float, float]]
    why: str = ""

    @property
    def model(self) -> Model:
        """With the estimates as its values, constants of the mean flight, and what was flown: for `sideslip match` and others."""
        return replace(self.result.fitted_model, flown=self.flown)

    @property
    def text(self) -> str:
        """A sentence on the terms."""
        if self.why:
            return self.why
        if not self.gains:
            return "no term over the envelope is asked for: the derivatives are constants on these flights"
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
    """Half of the 95 % band: Student's, with a flight less than there are, for what the residuals of so many flights tell of
    their own covariance."""
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
    """Choose and fit. model: of one condition; its constants become each flight's own. Raises CampaignError for too few flights,
    DataError for flights that cannot feed the model."""
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
            new_gains = fit.asked_for(result, wave, len(flights) // FLIGHTS_A_TERM - len(gains))
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
    """What every fit of a search shares. wide, data, simulator: with all terms, for the evidence."""

    base: Model
    flights: Sequence[Flight]
    data: Sequence[FlightData]
    wide: Model
    simulator: Simulator
    tried: Sequence[ConditionTerm]
    reference: Mapping[str, float]

    def asked_for(self, result: Result, wave: Sequence[ConditionTerm], most: int) -> list[TermGain]:
        """Terms of `wave` that flights held out want beside those of the result."""
        pooled_information = information(self.wide, self.data, result, self.simulator)
        active = [n for n in pooled_information.names if n in result.parameters]
        return terms_that_gain(pooled_information, active, [t.name for t in wave if t.name not in active], most)

    def needed(self, result: Result, gains: tuple[TermGain, ...]) -> tuple[TermGain, ...]:
        """Those that are still wanted beside all the others."""
        pooled_information = information(self.wide, self.data, result, self.simulator)
        active = [n for n in pooled_information.names if n in result.parameters]
        removed = superfluous_terms(pooled_information, active, {g.name: result.values[g.name] for g in gains})
        return tuple(g for g in gains if g.name not in removed)

    def again(self, earlier: Result, gains: Sequence[TermGain], options: OutputErrorOptions = STANDARD) -> Result:
        """The joint fit with the terms that were taken, from where the last one ended."""
        names = {g.name for g in gains}
        extended_model = with_terms(self.base, [t for t in self.tried if t.name in names], self.reference)
        start = {n: earlier.values[n] for n in derivatives_of(self.base)}
        return output_error(extended_model, self.flights, start, options)

    def unusable(self, result: Result) -> str:
        """Why no terms can be looked for from a result, empty where they can."""
        complete = all(len(f.initial_states) == len(d.segments) for f, d in zip(result.flights, self.data, strict=True))
        return "" if result.converged and complete else f"no further terms were looked for: {result.text}"


def references(flights: Sequence[Flight]) -> dict[str, float]:
    """`alpha_ref` ...: means over the flights of what terms are centred on, for the variables that all of them measure."""
    return {f"{v}_ref": float(np.mean([np.nanmean(f[v]) for f in flights])) for v in CENTRED if _in_all(flights, v)}


def _in_all(flights: Sequence[Flight], column: str) -> bool:
    return all(f.measured(column) for f in flights)
