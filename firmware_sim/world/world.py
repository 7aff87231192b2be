"""The world the instruments look at: one simulated flight from power-up to stillness, at any instant asked for.

`World` serves a logger in lockstep; `simulate_truth` and `simulate_many` fly ahead and return arrays.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.aircraft import Aircraft
from firmware_sim.physics.effects.base import Sensed
from firmware_sim.physics.motion import Motion
from firmware_sim.world.ground import ScriptedPath
from firmware_sim.world.scenario import GroundTable, Scenario
from firmware_sim.world.simulation import SENSED_NAMES, Wiring, WorldSimulation, derivatives_of, euler_angles
from firmware_sim.world.truth import TRUTH_COLUMNS, Truth, truth_of

Array = NDArray[np.float64]


class World:
    """One flight of a scenario. Time zero is where the recording starts.

    `advance(t)` moves to `t` and returns the Truth there; time never goes back. What happens does not depend on the
    instants asked for, unless the `wiring` between pilot and servos goes by another clock.
    """

    def __init__(self, scenario: Scenario, seed: int | None = None, wiring: Wiring | None = None) -> None:
        self.scenario = scenario
        self.seed = scenario.flight.seed if seed is None else seed
        self._simulation = WorldSimulation([scenario], [self.seed], many=False, wiring=wiring)
        self.aircraft: Aircraft = self._simulation.aircraft
        self.site = self._simulation.plant.site
        ground = scenario.ground
        self.takeoff_time = scenario.takeoff_s
        self.duration = scenario.total_s
        self._launch: ScriptedPath | None = None
        if ground.before_s > 0.0:
            self._launch = ScriptedPath(self._flying(0.0), ground.launch_s, self.site, launch=True)
        self._landing: ScriptedPath | None = None
        self.truth = self._truth_at(0.0)

    @property
    def time(self) -> float:
        """The instant of `truth` [s]."""
        return self.truth.time

    @property
    def derivatives(self) -> Mapping[str, float]:
        """The derivatives this aircraft flies with, as drawn for scenario and seed."""
        return derivatives_of(self.scenario, self.seed)

    def advance(self, to_time: float) -> Truth:
        """Move to `to_time` [s] and return the truth there; raises ValueError for a time already passed."""
        if to_time < self.truth.time:
            raise ValueError(f"time {to_time} s has passed; the world is at {self.truth.time} s")
        if to_time > self.truth.time:
            self.truth = self._truth_at(to_time)
        return self.truth

    def _truth_at(self, time: float) -> Truth:
        ground = self.scenario.ground
        airborne = time - self.takeoff_time
        if self._launch is not None and airborne < 0.0:
            return self._launch.at(time - ground.before_s, time)
        if ground.after_s > 0.0 and airborne >= self.scenario.flight.duration_s:
            if self._landing is None:
                joint = self._flying(self.scenario.flight.duration_s)
                self._landing = ScriptedPath(joint, ground.landing_s, self.site, launch=False)
            return self._landing.at(airborne - self.scenario.flight.duration_s, time)
        return self._flying(max(airborne, 0.0))

    def _flying(self, airborne: float) -> Truth:
        simulation = self._simulation
        simulation.advance(airborne)
        return _truth(simulation, *simulation.look(max(airborne - simulation.time, 0.0)), airborne + self.takeoff_time)


def _truth(simulation: WorldSimulation, m: Motion, x: object, time: float) -> Truth:
    undisturbed = euler_angles(m, simulation.xp)
    sensed: Sensed = simulation.sensed(m, x)
    plant = simulation.plant
    return truth_of(time, m, sensed, simulation.commands, simulation.pilot.event, plant.site, undisturbed)


def simulate_truth(
    scenario: Scenario, seed: int | None = None, rate_hz: float = 20.0, wiring: Wiring | None = None
) -> dict[str, Array]:
    """One flight, ground phases included: TRUTH_COLUMNS and `sensed_*`, each (samples,), at `rate_hz` from time zero."""
    world = World(scenario, seed, wiring)
    samples = math.floor(world.duration * rate_hz + 1e-9) + 1
    rows, sensed = [], []
    for k in range(samples):
        truth = world.advance(k / rate_hz)
        rows.append(list(truth.columns().values()))
        sensed.append([getattr(truth.sensed, name) for name in SENSED_NAMES])
    columns = dict(zip(TRUTH_COLUMNS, np.array(rows, float).T, strict=True))
    return columns | {f"sensed_{n}": v for n, v in zip(SENSED_NAMES, np.array(sensed, float).T, strict=True)}


def simulate_many(
    scenarios: Sequence[Scenario],
    seeds: Sequence[int],
    rate_hz: float = 20.0,
    batch: int = 256,
    crowd_from: int = 7,
    wiring: Wiring | None = None,
) -> list[dict[str, Array]]:
    """Many flights without ground phases, side by side where they can be; per flight as `simulate_truth`.

    Flights that share aircraft, site, duration and the names of what is hidden are flown together on arrays, up to
    `batch` at once; fewer than `crowd_from` are quicker one by one. The order of the result is the order asked for.
    wiring: between pilot and servos of every flight; it must keep nothing of one flight.
    """
    groups: dict[object, list[int]] = {}
    for i, s in enumerate(scenarios):
        hidden = tuple(h.name for h in s.hidden)
        key = (s.flight.aircraft, s.site, s.flight.integration_hz, s.flight.duration_s, hidden)
        groups.setdefault(key, []).append(i)
    flights: list[dict[str, Array]] = [{} for _ in scenarios]
    for members in groups.values():
        for first in range(0, len(members), batch):
            crowd = members[first : first + batch]
            if len(crowd) < crowd_from:
                for i in crowd:
                    airborne = scenarios[i].model_copy(update={"ground": GroundTable()})
                    flights[i] = simulate_truth(airborne, seeds[i], rate_hz, wiring)
                continue
            columns = _fly_together([scenarios[i] for i in crowd], [seeds[i] for i in crowd], rate_hz, wiring)
            for place, i in enumerate(crowd):
                flights[i] = {name: np.ascontiguousarray(values[:, place]) for name, values in columns.items()}
    return flights


def _fly_together(
    scenarios: Sequence[Scenario], seeds: Sequence[int], rate_hz: float, wiring: Wiring | None
) -> dict[str, Array]:
    simulation = WorldSimulation(scenarios, seeds, many=True, wiring=wiring)
    samples = math.floor(scenarios[0].flight.duration_s * rate_hz + 1e-9) + 1
    names = TRUTH_COLUMNS + tuple(f"sensed_{n}" for n in SENSED_NAMES)
    columns = {name: np.empty((samples, len(scenarios))) for name in names}
    for k in range(samples):
        time = k / rate_hz
        simulation.advance(time)
        truth = _truth(simulation, *simulation.look(max(time - simulation.time, 0.0)), time)
        for name, value in truth.columns().items():
            columns[name][k] = value
        for name in SENSED_NAMES:
            columns[f"sensed_{name}"][k] = getattr(truth.sensed, name)
    return columns
