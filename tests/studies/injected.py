"""A designed manoeuvre flown without a sequencer."""

import math
from dataclasses import dataclass

from daq.contract.manoeuvre import Manoeuvre
from firmware_sim.physics.plant import Commands
from firmware_sim.world.simulation import Wiring


@dataclass(frozen=True, slots=True)
class Injected(Wiring):
    """A designed manoeuvre straight on the sticks, without sequencer: hands still from `start_s` to its end."""

    manoeuvre: Manoeuvre
    start_s: float

    def hands_still(self, time: float) -> bool:
        """While it is flown."""
        return self.start_s - 1e-9 <= time <= self.start_s + self.manoeuvre.duration_s

    def route(self, time: float, wanted: Commands) -> Commands:
        """The sticks plus the increments of this frame."""
        if not self.hands_still(time):
            return wanted
        index = math.floor((time - self.start_s) / self.manoeuvre.time_step + 1e-6)
        e, a, r = (self._increment(name, index) for name in ("delta_e", "delta_a", "delta_r"))
        return Commands(wanted.left + e - a, wanted.right + e + a, wanted.rudder + r, wanted.throttle)

    def _increment(self, name: str, index: int) -> float:
        values = self.manoeuvre.increments.get(name, ())
        return values[index] if index < len(values) else 0.0
