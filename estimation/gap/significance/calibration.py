"""A screen of all hypotheses about a fitted baseline, its scores calibrated on simulated nulls: one round of the search."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.errors import GapError
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect
from estimation.gap.fit.baseline import Baseline
from estimation.gap.records.flight_records import FlightRecords
from estimation.gap.significance.nulls import InputErrors, NullFlyer, fly_nulls
from estimation.gap.significance.screen import Screen, Signatures, hypotheses_for, linear_gains
from estimation.gap.significance.tangent import Tangent

FIRST_NULLS = 50  # flown before it is known whether more are needed: they give a threshold to 5 %
CLEAR, QUIET = 2.0, 0.75  # thresholds of the first nulls: what is so far above or below one is so for that of all


@dataclass(frozen=True)
class Round:
    """A baseline with its screen and its nulls.

    gains: (hypotheses,) twice the log-likelihood by linear theory.
    inflation: (hypotheses,) variance of the score on the nulls, at least 1. threshold: family-wise quantile of the
    largest standardised score on the nulls, with a margin. tangent: linearised records for further tests of the fit. more:
    gives the same round with all nulls; None where it has them.
    """

    baseline: Baseline
    screen: Screen
    gains: Array
    inflation: Array
    threshold: float
    tangent: Tangent
    more: "Callable[[], Round] | None" = None

    @property
    def criteria(self) -> Criteria:
        return self.baseline.criteria

    @property
    def null_residuals(self) -> tuple[tuple[Array, ...], ...]:
        """Residuals (N, ny) of every null per record."""
        return self.tangent.nulls

    def standardised(self) -> Array:
        """(hypotheses,) scores of the data in units of their scatter on the nulls."""
        return np.sqrt(self.gains / self.inflation)

    @property
    def clear(self) -> bool:
        """Whether a score by linear theory is so far above the threshold that more nulls would change nothing."""
        return bool(self.standardised().max(initial=0.0) > CLEAR * self.threshold)

    @property
    def has_enough_nulls(self) -> bool:
        """Whether it has all nulls, or a score that stands so clearly out that these would change nothing."""
        return self.more is None or self.clear

    @property
    def with_enough_nulls(self) -> "Round":
        """The same round with all nulls where it has not enough."""
        return self.more() if self.more is not None and not self.has_enough_nulls else self


def beyond_doubt(score: float, threshold: float) -> bool:
    """Whether a score is so far from a threshold of the first nulls that all of them would decide the same."""
    return score > CLEAR * threshold or score < QUIET * threshold


def inflation_by_hypothesis(round_: Round) -> dict[tuple[str, str], float]:
    """Hypothesis -> its inflation on the nulls, by linear theory."""
    return {h.key: float(v) for h, v in zip(round_.screen.hypotheses, round_.inflation, strict=True)}


def screen_round(
    baseline: Baseline,
    prepared: FlightRecords,
    effects: Sequence[Effect],
    errors: Sequence[InputErrors],
    nulls: int,
    seed: int,
    tell: Callable[[int], None] = lambda done: None,
) -> Round:
    """Screen every applicable hypothesis and calibrate the scores on simulated nulls: on the first of up to `nulls`, with `more`
    of them for when they are needed. tell: called with the number of nulls so far. Raises GapError where most run away."""
    flyer = NullFlyer.build(baseline.problem, baseline.fit, baseline.noise, errors)
    hypotheses = hypotheses_for(baseline.clean, effects, prepared.available)
    signatures = Signatures.of(baseline.problem, baseline.fit, hypotheses)
    source, flown = fly_nulls(flyer, nulls, seed), list[tuple[Array, ...]]()

    def with_nulls(count: int) -> Round:
        while len(flown) < count and (null := next(source, None)) is not None:
            flown.append(null)
            tell(len(flown))
        if len(flown) < min(count, baseline.criteria.negligible * nulls):
            raise GapError(
                f"only {len(flown)} of {nulls} simulated nulls stay finite: the fitted baseline is barely stable"
            )
        return _calibrated(baseline, signatures, flown)

    if nulls <= FIRST_NULLS:
        return with_nulls(nulls)
    first = with_nulls(FIRST_NULLS)
    some_ran_away = len(first.null_residuals) < FIRST_NULLS
    return with_nulls(nulls) if some_ran_away else replace(first, more=lambda: with_nulls(nulls))


def _calibrated(baseline: Baseline, signatures: Signatures, flown: Sequence[tuple[Array, ...]]) -> Round:
    """The round with these nulls, without those that are not comparable with the flights."""
    problem, tangent = baseline.problem, Tangent(baseline.problem, baseline.fit, tuple(flown))
    screen = signatures.screened(tangent)
    comparable = like_the_flights(screen.projected().energy, baseline.criteria)
    if not comparable.all():
        screen, tangent = screen.with_nulls(comparable), tangent.of(comparable)
    nulls = len(tangent.nulls)
    gains = linear_gains(screen, problem, 0)
    null_gains = linear_gains(screen, problem, slice(1, 1 + nulls))
    inflation = null_inflation(screen, nulls)
    largest = np.sqrt(null_gains / inflation).max(axis=1) if screen.hypotheses else np.zeros(nulls)
    limit = significant_above(largest, baseline.criteria)
    return Round(baseline, screen, gains, inflation, limit, tangent)


def like_the_flights(energy: Array, criteria: Criteria) -> NDArray[np.bool_]:
    """(nulls,) which nulls are comparable with the flights. energy: (1 + nulls,) of the whitened residuals of the flights and of
    every null, with the base projected out.

    Where the fitted motion diverges slowly, like a spiral that a pilot controlled by sight, gusts carry a null away, because no
    pilot flies it: with such a base two nulls in three had 1.2 to 400 times the energy of the flights, all others 0.93 to 1.03.
    All count where too few comparable nulls remain for a threshold, which is then too high.
    """
    comparable = energy[1:] < criteria.null_energy * energy[0]
    sufficient = np.count_nonzero(comparable) >= max(criteria.negligible * comparable.size, 1.0)
    return comparable if sufficient else np.ones(comparable.size, dtype=bool)


def significant_above(largest: Array, criteria: Criteria) -> float:
    """Threshold from the largest score of every null, (nulls,): for a name, a shape, an instrument's error, and a flight that
    does not repeat the others."""
    return criteria.null_margin * upper_quantile(largest, criteria.null_level)


def unknown_above(largest: Array, criteria: Criteria) -> float:
    """Threshold for a nameless rest or an event in time, from the largest score of every null, (nulls,)."""
    return criteria.unknown_margin * upper_quantile(largest, criteria.nameless_level)


def null_inflation(screen: Screen, nulls: int) -> Array:
    """(hypotheses,) variance of the signed scores on the nulls, at least 1."""
    power = screen.projected().scores()[:, 1 : 1 + nulls] ** 2
    return np.array([max(1.0, float(np.mean(power[screen.span(h)]))) for h in range(len(screen.hypotheses))])


def upper_quantile(values: Array, level: float) -> float:
    """Upper quantile of the largest of many scores: by a Gumbel law fitted to the moments or from the sample, whichever is
    larger. Two hundred nulls alone give a 95 % point only to some 3 %."""
    scale = float(np.std(values)) * np.sqrt(6.0) / np.pi  # of a Gumbel law with the same deviation
    law = float(np.mean(values)) - scale * (np.euler_gamma + np.log(-np.log(level)))
    return max(law if scale > 0.0 else 0.0, float(np.quantile(values, level)))
