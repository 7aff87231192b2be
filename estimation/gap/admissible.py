"""Are the flights fit for the question? Stale, clipped and missing samples, and whether the flights repeat each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.baseline import Round
from groundstation.flight import Flight

STALE_SHARE = 0.2  # of the samples that repeat the one before exactly
CLIPPED_RUN = 4  # samples in a row at the very end of a range
GAP_SHARE = 0.02
ODD = 0.995  # quantile of the nulls beyond which a flight does not repeat the others


def sample_notes(flights: Sequence[Flight], columns: Sequence[str]) -> list[str]:
    """One sentence for each channel of each flight that is stale, clipped or has holes."""
    said = []
    for flight in flights:
        for name in columns:
            if not flight.measured(name):
                continue
            said += [f"{flight.name}: {words}" for words in _channel(name, flight.columns[name])]
    return said


def _channel(name: str, values: Array) -> list[str]:
    seen = values[np.isfinite(values)]
    said = []
    if seen.size < (1.0 - GAP_SHARE) * values.size:
        said.append(f"{name} is missing in {1 - seen.size / values.size:.0%} of the samples")
    if seen.size < 10 or float(np.ptp(seen)) == 0.0:
        return said
    ends = (float(seen.max()), float(seen.min()))
    stuck = (np.diff(seen) == 0.0) & (seen[1:] < ends[0]) & (seen[1:] > ends[1])
    if float(stuck.mean()) > STALE_SHARE:
        said.append(f"{name} repeats its last value in {stuck.mean():.0%} of the samples: stale or coarsely rounded")
        return said
    for end, word in zip(ends, ("upper", "lower"), strict=True):
        run = _longest((seen == end).astype(int))
        if run >= CLIPPED_RUN:
            said.append(f"{name} stands at its {word} end {end:.4g} for {run} samples in a row: clipped")
    return said


def _longest(flags: Array) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags, [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


@dataclass(frozen=True)
class Repeats:
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
        return {"flight": self.flight, "chi2": round(self.chi2, 1), "usual": round(self.usual, 1),
                "limit": round(self.limit, 1), "odd": self.odd}  # fmt: skip


def repeatability(round_: Round, names: Sequence[str]) -> tuple[Repeats, ...]:
    """Every training flight against the others, by linear theory about the joint fit; empty for one flight alone."""
    screen = round_.screen
    flights = sorted(set(screen.flights))
    if len(flights) < 2:
        return ()
    n, first = screen.n, screen.n + screen.k
    pooled = screen.total()
    together = np.linalg.pinv(pooled[:n, :n], hermitian=True, rcond=1e-12) @ pooled[:n, first:]
    chi2 = []
    for flight in flights:
        G = screen.total([flight])  # with the priors, so that what one flight cannot tell stays where it is believed
        alone = np.linalg.pinv(G[:n, :n], hermitian=True, rcond=1e-12) @ G[:n, first:]
        apart = alone - together
        chi2.append(np.sum(apart * (G[:n, :n] @ apart), axis=0))
    table = np.array(chi2)
    usual = np.median(table[:, 1:], axis=1)
    limit = np.quantile((table[:, 1:] / usual[:, None]).max(axis=0), ODD)
    return tuple(
        Repeats(names[f], float(row[0]), float(u), float(u * limit))
        for f, row, u in zip(flights, table, usual, strict=True)
    )
