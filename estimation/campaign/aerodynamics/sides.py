"""Sides of a step in time: what a step moved has a curve before it and another from it on, for a mean of both was never flown.

A parameter that no step clearly moved keeps one curve over all flights; where a step is told by all parameters together and by
none clearly, all of them are taken apart.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.campaign import pooling
from estimation.campaign.aerodynamics.pooled import PooledCurves
from estimation.campaign.aerodynamics.steps import DateStep

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Side:
    """Flights between two steps that moved a parameter. since, until: dates of the first and the last of them, empty where
    nothing moved it; shifts: (effects,) of the curves there; flights: (flights,) of the group."""

    since: str
    until: str
    shifts: Array
    flights: Mask


def moved_by(steps: Sequence[DateStep], parameter: str) -> list[int]:
    """Numbers of the steps that moved a parameter, in order of time."""
    found = []
    for number, step in enumerate(steps):
        clearly = [m.parameter for m in step.moved if m.probability <= pooling.LEVEL]
        if parameter in (clearly or [m.parameter for m in step.moved]):
            found.append(number)
    return sorted(found, key=lambda n: steps[n].first)


def sides(curves: PooledCurves, steps: Sequence[DateStep], parameter: str) -> Iterator[Side]:
    """The stretches of time that have curves of their own, in order."""
    own = moved_by(steps, parameter)
    count = len(curves.of.flights)
    edges = [0, *(steps[n].first for n in own), count]
    place = np.arange(count)
    for first, end in zip(edges, edges[1:], strict=False):
        shifts = np.zeros(curves.shifts.shape[1])
        shifts[own] = curves.shifts[first, own]
        dates = (curves.of.dates[first], curves.of.dates[end - 1]) if own else ("", "")
        yield Side(*dates, shifts, (place >= first) & (place < end))


def starts_of(curves: PooledCurves, steps: Sequence[DateStep], parameter: str) -> list[tuple[str, str]]:
    """Date and name of the first flight after each step that moved a parameter."""
    return [(curves.of.dates[i], curves.of.flights[i]) for i in (steps[n].first for n in moved_by(steps, parameter))]
