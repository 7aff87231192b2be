"""Whether the training flights repeat each other: each by itself against all together, calibrated on the nulls."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimation.engine.kernel import Array
from estimation.estimators.normal_equations import solved
from estimation.gap.criteria import Criteria
from estimation.gap.tests_of_fit.calibration import Round


@dataclass(frozen=True)
class Repeatability:
    """How much better one flight is fitted by itself than together with the others. chi2: twice the log-likelihood; usual:
    its median on the nulls; limit: what 199 of 200 nulls stay below (over all flights)."""

    flight: str
    chi2: float
    usual: float
    limit: float

    @property
    def odd(self) -> bool:
        return self.chi2 > self.limit

    def to_json(self) -> dict[str, Any]:
        return {
            "flight": self.flight,
            "chi2": round(self.chi2, 1),
            "usual": round(self.usual, 1),
            "limit": round(self.limit, 1),
            "odd": self.odd,
        }


def repeatability(round_: Round, names: Sequence[str]) -> tuple[Repeatability, ...]:
    """Every training flight against the others, by linear theory about the joint fit; empty for one flight alone."""
    screen = round_.screen
    flights = sorted(set(screen.flights))
    if len(flights) < 2:
        return ()
    n, first = screen.n, screen.n + screen.k
    pooled = screen.total()
    together = solved(pooled[:n, :n], pooled[:n, first:])
    chi2 = []
    for flight in flights:
        G = screen.total([flight])  # with the priors, so that what one flight cannot tell stays where it is believed
        apart = solved(G[:n, :n], G[:n, first:]) - together
        chi2.append(np.sum(apart * (G[:n, :n] @ apart), axis=0))
    table = np.array(chi2)
    usual, limit = usual_and_limit(table[:, 1:], round_.criteria)
    rows = zip(flights, table[:, 0], usual, limit, strict=True)
    return tuple(Repeatability(names[f], float(chi), float(u), float(most)) for f, chi, u, most in rows)


def usual_and_limit(nulls: Array, criteria: Criteria) -> tuple[Array, Array]:
    """(flights,) median of the nulls' chi2 (flights, nulls), and what a flight of a repeating set stays below."""
    usual = np.median(nulls, axis=1)
    return usual, usual * np.quantile((nulls / usual[:, None]).max(axis=0), criteria.repeat_level)
