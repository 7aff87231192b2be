"""A linear aircraft whose transfer functions are written down: designed inputs, exact responses, noise of any colour.

Inputs run on a grid twenty times finer than the samples; responses are scipy's for inputs straight between fine points.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from groundstation.flight import Flight

Array = NDArray[np.float64]
FINE = 20


@dataclass(frozen=True)
class Plant:
    """numerator / denominator exp(-delay s)."""

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    delay: float = 0.0

    def at(self, omega: Array) -> NDArray[np.complex128]:
        s = 1j * omega
        return np.asarray(np.polyval(self.numerator, s) / np.polyval(self.denominator, s) * np.exp(-s * self.delay))

    def answer(self, t: Array, u: Array) -> Array:
        late = np.interp(t - self.delay, t, u, left=float(u[0]))
        return np.asarray(signal.lsim((self.numerator, self.denominator), late, t)[1])


ROLL = Plant((8.0,), (1.0, 5.0), 0.1)
DUTCH_ROLL = Plant((4.0, 4.0), (1.0, 2 * 0.15 * 4.5, 4.5**2))


@dataclass(frozen=True)
class Case:
    """kind: multisine, chirp or doublets. noise: rms, of first-order colour (0: white)."""

    seconds: float = 60.0
    rate: float = 20.0
    kind: str = "multisine"
    noise: float = 0.01
    colour: float = 0.0


def times(case: Case) -> Array:
    count = round(case.seconds * case.rate)
    return np.arange(count * FINE + 1) / (case.rate * FINE)


def designed(case: Case, rng: np.random.Generator) -> Array:
    """An input on the fine grid [rad]."""
    t = times(case)
    if case.kind == "multisine":
        hertz = np.arange(4, int(4 * case.seconds)) / case.seconds
        phases = rng.uniform(0, 2 * np.pi, hertz.size)
        return sum(np.cos(2 * np.pi * f * t + a) for f, a in zip(hertz, phases, strict=True)) * 0.05 / hertz.size**0.5
    if case.kind == "chirp":
        return 0.05 * signal.chirp(t, 0.1, case.seconds, 4.0, method="logarithmic", phi=rng.uniform(0, 360))
    u = np.zeros_like(t)
    for k in range(int(case.seconds / 5)):
        begin, width, size = 1 + 5 * k + rng.uniform(0, 1), rng.uniform(0.3, 0.8), 0.05 * rng.choice([-1, 1])
        u += size * ((t >= begin) & (t < begin + width)) - size * ((t >= begin + width) & (t < begin + 2 * width))
    decay = np.exp(-1 / (case.rate * FINE * 0.04))
    return np.asarray(signal.lfilter([1 - decay], [1, -decay], u))


def noise(case: Case, rng: np.random.Generator) -> Array:
    white = rng.normal(size=round(case.seconds * case.rate) + 1)
    c = case.colour
    return case.noise * np.asarray(signal.lfilter([np.sqrt(1 - c * c)], [1, -c], white))


def fly(plants: Mapping[str, Plant], output: str, case: Case, rng: np.random.Generator, shared: float = 0.0) -> Flight:
    """A flight whose output is the sum of the answers to every input. shared: of the first input, in all others too."""
    t = times(case)
    inputs: dict[str, Array] = {}
    for name in plants:
        own = designed(case, rng)
        inputs[name] = own + shared * next(iter(inputs.values()), np.zeros_like(own))
    y = np.sum([plant.answer(t, inputs[name]) for name, plant in plants.items()], axis=0)
    columns = {name: u[::FINE] for name, u in inputs.items()}
    return Flight.build("linear", t[::FINE], {**columns, output: y[::FINE] + noise(case, rng)})
