"""The stick inputs of the simulated pilot: doublets, multi-steps, 3-2-1-1s, multisines and steps, and sets of them.

A manoeuvre is added to the trimmed stick on one axis; angles are surface angles in degrees with the signs of the flight
columns. Sets vary amplitude, timing and direction a little from seed to seed, as two flights of one plan would.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Axis = Literal["aileron", "rudder", "elevator", "throttle"]
Shape = Literal["step", "doublet", "multistep", "3211", "multisine", "ramp", "staircase"]
AXES: tuple[Axis, ...] = ("aileron", "rudder", "elevator", "throttle")
SHAPES: tuple[Shape, ...] = ("step", "doublet", "multistep", "3211", "multisine", "ramp", "staircase")

# Sign of each unit-width step.
_STEPS: Mapping[str, Sequence[float]] = {
    "step": (1,),
    "doublet": (1, -1),
    "multistep": (1, -1, -1, 1, -1),
    "3211": (1, 1, 1, -1, -1, 1, -1),
    "staircase": (1 / 3, 2 / 3, 1, 0, -1 / 3, -2 / 3, -1),
}


@dataclass(frozen=True, slots=True)
class StickInput:
    """One stick input: axis, shape, start [s], amplitude [deg; throttle 0..1] and width [s] of one step.

    A multisine lasts `width` seconds and sums `harmonics` sines with phases that keep its peak low (Schroeder); its
    amplitude is its root mean square.
    `harmonics` gives the multiples of 1 / width used, so two axes can be excited at once without sharing a frequency.
    """

    axis: Axis
    shape: Shape
    start: float
    amplitude: float
    width: float
    harmonics: tuple[int, ...] = ()

    @property
    def length(self) -> float:
        """How long it lasts [s]."""
        if self.shape in ("multisine", "ramp"):
            return self.width
        return self.width * len(_STEPS[self.shape])

    def values(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Stick at each time [deg], zero outside the manoeuvre."""
        elapsed = time - self.start
        active = (elapsed >= 0.0) & (elapsed < self.length)
        if self.shape == "multisine":
            return np.where(active, self._multisine(elapsed), 0.0)
        if self.shape == "ramp":
            return np.where(active, self.amplitude * (1.0 - np.abs(2.0 * elapsed / self.width - 1.0)), 0.0)
        steps = np.asarray(_STEPS[self.shape], float)
        index = np.clip((elapsed / self.width).astype(int), 0, len(steps) - 1)
        return np.where(active, self.amplitude * steps[index], 0.0)

    def _multisine(self, elapsed: NDArray[np.float64]) -> NDArray[np.float64]:
        n = len(self.harmonics)
        phases = [-math.pi * k * k / n for k in range(n)]
        waves = sum(
            np.sin(2.0 * math.pi * h * elapsed / self.width + p) for h, p in zip(self.harmonics, phases, strict=True)
        )
        # it fades in over a quarter of a second
        return self.amplitude * math.sqrt(2.0 / n) * np.asarray(waves) * np.minimum(1.0, 4.0 * elapsed.clip(0.0))


def _varied(plan: Sequence[StickInput], rng: np.random.Generator) -> list[StickInput]:
    """The plan with random changes: amplitude within 12 %, start within 0.2 s, width within 8 %, either direction.

    Inputs with the same start and width, on several axes, get the same changes.
    """
    variations: dict[tuple[float, float], tuple[float, float, float]] = {}
    inputs = []
    for m in plan:
        if (m.start, m.width) not in variations:
            side = 1.0 if rng.random() < 0.5 else -1.0
            variations[m.start, m.width] = (
                rng.uniform(-0.2, 0.2),
                side * rng.uniform(0.88, 1.12),
                rng.uniform(0.92, 1.08),
            )
        delay, amplitude_factor, width_factor = variations[m.start, m.width]
        width = m.width if m.shape == "multisine" else m.width * width_factor
        inputs.append(StickInput(m.axis, m.shape, m.start + delay, m.amplitude * amplitude_factor, width, m.harmonics))
    return inputs


MANOEUVRE_SETS: Mapping[str, tuple[StickInput, ...]] = {
    "none": (),
    "rich": (
        StickInput("aileron", "doublet", 1.6, 5.0, 0.7),
        StickInput("rudder", "doublet", 5.6, 2.0, 0.85),
        StickInput("aileron", "3211", 11.6, 4.2, 0.40),
        StickInput("rudder", "3211", 16.4, 3.0, 0.36),
        StickInput("aileron", "multistep", 21.4, 2.8, 0.42),
        StickInput("rudder", "multistep", 25.0, 2.4, 0.42),
    ),
    "aileron_only": (
        StickInput("aileron", "doublet", 2.0, 5.0, 0.7),
        StickInput("aileron", "3211", 7.5, 4.0, 0.40),
        StickInput("aileron", "multistep", 14.0, 3.0, 0.45),
        StickInput("aileron", "doublet", 20.0, 3.5, 0.5),
        StickInput("aileron", "3211", 25.0, 3.0, 0.30),
    ),
    "hand_flown": (
        StickInput("aileron", "doublet", 2.5, 5.5, 0.8),
        StickInput("aileron", "multistep", 8.0, 4.5, 0.55),
        StickInput("aileron", "doublet", 14.5, 6.0, 0.6),
        StickInput("aileron", "multistep", 19.5, 4.0, 0.45),
        StickInput("aileron", "doublet", 25.5, 5.0, 0.9),
    ),
    "multisine": (
        StickInput("aileron", "multisine", 2.0, 1.6, 20.0, tuple(range(5, 40, 4))),
        StickInput("rudder", "multisine", 2.0, 1.2, 20.0, tuple(range(3, 40, 4))),
    ),
    "longitudinal": (
        StickInput("elevator", "doublet", 2.0, 2.0, 0.5),
        StickInput("elevator", "3211", 8.0, 1.8, 0.30),
        StickInput("throttle", "step", 14.0, 0.2, 3.0),
        StickInput("elevator", "multistep", 20.0, 1.5, 0.4),
        StickInput("elevator", "doublet", 25.5, 2.5, 0.35),
    ),
    "sideslip_staircase": (
        StickInput("rudder", "staircase", 2.0, 7.0, 2.0),
        StickInput("aileron", "staircase", 2.0, -9.5, 2.0),  # wings held level against the dihedral effect
        StickInput("aileron", "doublet", 18.5, 4.0, 0.6),
        StickInput("rudder", "3211", 23.0, 4.0, 0.4),
    ),
    "speed_sweep": (
        StickInput("throttle", "step", 0.5, 0.22, 14.0),
        StickInput("aileron", "doublet", 2.0, 4.5, 0.6),
        StickInput("rudder", "3211", 6.0, 2.5, 0.36),
        StickInput("aileron", "3211", 11.0, 3.5, 0.35),
        StickInput("throttle", "step", 14.6, -0.15, 14.0),
        StickInput("rudder", "doublet", 17.0, 2.5, 0.8),
        StickInput("aileron", "3211", 21.5, 4.0, 0.4),
        StickInput("rudder", "multistep", 25.5, 2.4, 0.42),
    ),
    "all_axes": (
        StickInput("aileron", "doublet", 1.6, 5.0, 0.7),
        StickInput("elevator", "doublet", 5.0, 2.0, 0.4),
        StickInput("rudder", "3211", 8.5, 2.8, 0.36),
        StickInput("elevator", "3211", 13.0, 1.5, 0.3),
        StickInput("aileron", "3211", 13.2, 4.0, 0.40),
        StickInput("rudder", "doublet", 18.5, 2.4, 0.8),
        StickInput("elevator", "step", 22.0, -1.5, 2.4),
        StickInput("aileron", "3211", 22.2, 3.2, 0.36),
        StickInput("rudder", "multistep", 26.0, 2.4, 0.42),
    ),
}


def flown_set(name: str, rng: np.random.Generator, repeat_every: float, duration: float) -> list[StickInput]:
    """The stick inputs of a set of MANOEUVRE_SETS with random variations, repeated every `repeat_every` [s] for `duration`
    [s]."""
    inputs: list[StickInput] = []
    start = 0.0
    while start < duration:
        repetition = _varied(MANOEUVRE_SETS[name], rng)
        inputs += [
            StickInput(m.axis, m.shape, m.start + start, m.amplitude, m.width, m.harmonics)
            for m in repetition
            if m.start + start + m.length <= duration - 0.2
        ]
        start += repeat_every
    return inputs
