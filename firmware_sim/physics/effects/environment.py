"""Hidden air: movement the aircraft flies through and the model does not know of."""

import math
from typing import TYPE_CHECKING

from firmware_sim.physics.effects.base import HiddenEffect
from firmware_sim.physics.maths import State, Value

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion


class RoughAir(HiddenEffect):
    """Lateral and vertical turbulence beyond the scenario's gusts: `size` rad of sideslip (1 sigma) at 17 m/s.

    A sum of incommensurate waves frozen in the air mass, with random phases per flight; amplitudes follow the -5/3 law
    between wavelengths of 8 and 120 m. Another generator than the scenario's gusts on purpose.
    """

    name, title, group, unit, typical = "gust", "rough air", "environment", "rad", math.radians(0.8)
    WAVES = 14

    def start(self, m: "Motion", x: State) -> None:
        numbers = [2.0 * math.pi / (8.0 * 15.0 ** (k / (self.WAVES - 1))) for k in range(self.WAVES)]
        powers = [n ** (-5.0 / 3.0) * n for n in numbers]
        total = sum(powers)
        self._waves = [
            (
                n,
                math.sqrt(2.0 * w / total),
                self.draw(lambda g: g.uniform(0.0, 2.0 * math.pi)),
                self.draw(lambda g: g.uniform(0.0, 2.0 * math.pi)),
            )
            for n, w in zip(numbers, powers, strict=True)
        ]

    def wind(self, m: "Motion", x: State) -> None:
        sin = self.xp.sin
        along = 17.0 * m.t
        lateral: Value = 0.0
        vertical: Value = 0.0
        for number, amplitude, phase_v, phase_w in getattr(self, "_waves", ()):
            lateral = lateral + amplitude * sin(number * along + phase_v)
            vertical = vertical + amplitude * sin(number * along + phase_w)
        m.gust_v = m.gust_v + 17.0 * self.size * lateral
        m.gust_w = m.gust_w + 0.5 * 17.0 * self.size * vertical


class WindShear(HiddenEffect):
    """Wind from the north that grows with height: `size` 1/s about the starting height."""

    name, title, group, unit, typical = "wind_shear", "wind changes with height", "environment", "1/s", 0.15

    def start(self, m: "Motion", x: State) -> None:
        self._down = m.down

    def wind(self, m: "Motion", x: State) -> None:
        m.wind_north = m.wind_north - self.size * (getattr(self, "_down", m.down) - m.down)
