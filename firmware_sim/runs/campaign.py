"""A campaign: several flights of one aircraft at different speeds, some to learn from and some to hold out.

All flights share the aircraft (its derivatives drawn once) and what is hidden; each has a plan, gusts and noise of its
own. Made for studies and for the benchmark of the gap workflow; the direct sensor model stands in for the bus.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from firmware_sim.world.scenario import Scenario, load_scenario

TRAINING_SPEEDS = (14.5, 16.5, 19.0)
HOLDOUT_SPEEDS = (17.0,)


@dataclass(frozen=True, slots=True)
class CampaignFlights:
    """What to fly: hidden effects as (name, size as a multiple of the typical one), gusts, plan, scatter and seed."""

    hidden: tuple[tuple[str, float], ...] = ()
    seed: int = 0
    gust_deg: float = 0.15
    manoeuvres: str = "rich"
    scatter: float = 0.15
    duration_s: float = 30.0
    training_speeds: Sequence[float] = TRAINING_SPEEDS
    holdout_speeds: Sequence[float] = HOLDOUT_SPEEDS

    def scenarios(self) -> list[tuple[Scenario, int]]:
        """Scenario and seed of each flight, training flights first."""
        base = load_scenario("quiet")
        speeds = [*self.training_speeds, *self.holdout_speeds]
        headings = np.random.default_rng([self.seed, 51]).uniform(0.0, 360.0, len(speeds))
        return [
            (
                base.altered(
                    title="campaign",
                    flight={
                        "speed_m_s": speed,
                        "heading_deg": float(heading),
                        "manoeuvres": self.manoeuvres,
                        "duration_s": self.duration_s,
                        "derivative_scatter": self.scatter,
                        "derivative_seed": self.seed,
                    },
                    wind={"gust_deg": self.gust_deg},
                    hidden=[{"name": name, "size": size} for name, size in self.hidden],
                ),
                1000 * self.seed + k,
            )
            for k, (speed, heading) in enumerate(zip(speeds, headings, strict=True))
        ]
