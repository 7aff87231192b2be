"""One flight, or many side by side, stepped on a fixed grid.

The trajectory is decided by scenario and seed alone. Looking at it between grid points takes a partial step that is not
kept, so the flight does not depend on who looks and when. Each flight has random streams of its own (scatter, plan, hand,
gusts, effects), so it is the same flight alone or in a crowd.
"""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from estimation.aircraft import Aircraft, load_aircraft
from firmware_sim.physics.aerodynamics import LATERAL, true_derivatives
from firmware_sim.physics.atmosphere import Site
from firmware_sim.physics.effects.base import HiddenEffect, Sensed, overrides
from firmware_sim.physics.effects.registry import make_effects
from firmware_sim.physics.maths import FLOATS, Maths, State, Value, array_maths
from firmware_sim.physics.motion import Motion
from firmware_sim.physics.plant import (
    ARMS,
    ATTITUDE,
    GUST,
    POSITION,
    THRUST,
    Commands,
    Plant,
)
from firmware_sim.physics.trim import Trim, level_trim
from firmware_sim.physics.wind import GUST_STATES, NOISE_CHANNELS, gusts_for, stationary_start
from firmware_sim.pilot.manoeuvres import StickInput, flown_set
from firmware_sim.pilot.pilot import FRAME, Pilot, StickPlan, join_plans, plan_sticks
from firmware_sim.tables import ScenarioError
from firmware_sim.world.scenario import Scenario

SETTLE = 5.0  # s flown before time zero, so that gusts, trim levers and lags are in their stride
_NOISE_CHUNK = 1024  # steps
_SCATTER, _PLAN, _HAND, _GUST, _GUST_START, _EFFECT = range(1, 7)


def _stream(seed: int, which: int) -> np.random.Generator:
    return np.random.default_rng([seed, which])


def site_of(scenario: Scenario) -> Site:
    """The flying field of a scenario."""
    s = scenario.site
    return Site(s.latitude_deg, s.longitude_deg, s.elevation_m, s.temperature_offset_k)


def euler_angles(m: Motion, xp: Maths) -> tuple[Value, Value, Value]:
    """phi, theta, psi of the aircraft itself [rad]."""
    return xp.atan2(m.c23, m.c33), xp.asin(xp.clip(-m.c13, -1.0, 1.0)), xp.atan2(m.c12, m.c11)


def derivatives_of(scenario: Scenario, seed: int | None = None) -> dict[str, float]:
    """The true derivatives of a scenario's aircraft: its file's, overrides, then scatter on the lateral ones."""
    flight = scenario.flight
    values = true_derivatives(load_aircraft(flight.aircraft), scenario.derivatives)
    if flight.derivative_scatter > 0.0:
        scatter_seed = flight.derivative_seed
        rng = _stream(scatter_seed if scatter_seed is not None else (flight.seed if seed is None else seed), _SCATTER)
        for name in LATERAL:
            factor = 1.0 + flight.derivative_scatter * rng.uniform(-1.0, 1.0)
            if not name.endswith("_0"):
                values[name] *= factor
    return values


def manoeuvres_of(scenario: Scenario, seed: int) -> list[StickInput]:
    """The stick inputs of one flight, in seconds from the start of free flight."""
    if scenario.manoeuvre:
        return [table.manoeuvre() for table in scenario.manoeuvre]
    flight = scenario.flight
    return flown_set(flight.manoeuvres, _stream(seed, _PLAN), flight.repeat_every_s, flight.duration_s)


def _plan(scenario: Scenario, seed: int) -> StickPlan:
    flight = scenario.flight
    return plan_sticks(manoeuvres_of(scenario, seed), flight.duration_s, flight.hand_deg, _stream(seed, _HAND))


class Wiring:
    """What stands between the pilot's hands and the servos: by itself nothing. Times are seconds of free flight, negative while
    settling."""

    def hands_still(self, time: float, /) -> bool:
        """Whether the pilot leaves his sticks where they are."""
        return False

    def route(self, time: float, wanted: Commands, /) -> Commands:
        """What the servos get in the frame that begins now."""
        return wanted


class _Noise:
    """Unit white noise per step and flight, variance 1 / step, drawn in chunks."""

    def __init__(self, seeds: Sequence[int], step: float, xp: Maths) -> None:
        self._generators = [_stream(seed, _GUST) for seed in seeds]
        self._scale = step**-0.5
        self._floats = xp.flights is None
        self._left: list[State] = []

    def next(self) -> State:
        if not self._left:
            draws = [g.standard_normal((_NOISE_CHUNK, NOISE_CHANNELS)) * self._scale for g in self._generators]
            self._left = draws[0].tolist() if self._floats else list(np.stack(draws, axis=-1))
            self._left.reverse()
        return self._left.pop()


class WorldSimulation:
    """Flights in the air from time zero, after settling; `many` runs on arrays, otherwise exactly one flight on floats.

    All scenarios must share aircraft, site, integration rate and the names of what is hidden.
    """

    def __init__(
        self, scenarios: Sequence[Scenario], seeds: Sequence[int], *, many: bool, wiring: Wiring | None = None
    ) -> None:
        first = scenarios[0]
        self.wiring = wiring or Wiring()
        self._check_alike(scenarios, many)
        self.xp = xp = array_maths(len(scenarios)) if many else FLOATS
        self.aircraft: Aircraft = load_aircraft(first.flight.aircraft)
        self.h = 1.0 / first.flight.integration_hz
        self._per_frame = round(FRAME / self.h)
        per_flight = [derivatives_of(s, seed) for s, seed in zip(scenarios, seeds, strict=True)]
        derivatives = {name: self._gather([d[name] for d in per_flight]) for name in per_flight[0]}
        hidden = [
            (item.name, self._gather([s.hidden[i].size for s in scenarios])) for i, item in enumerate(first.hidden)
        ]
        self.effects: tuple[HiddenEffect, ...] = make_effects(hidden)
        speed = self._gather([s.flight.speed_m_s for s in scenarios])
        level = self._gather([np.radians(s.wind.gust_deg) for s in scenarios])
        gusty = any(s.wind.gust_deg > 0.0 for s in scenarios)
        directions = [np.radians(s.wind.from_deg + 180.0) for s in scenarios]
        strength = [s.wind.speed_m_s for s in scenarios]
        self.plant = Plant(
            self.aircraft,
            derivatives,
            site_of(first),
            xp,
            gusts=gusts_for(level, speed, self.aircraft.span, xp) if gusty else None,
            wind_ned=(
                self._gather([v * np.cos(a) for v, a in zip(strength, directions, strict=True)]),
                self._gather([v * np.sin(a) for v, a in zip(strength, directions, strict=True)]),
                0.0,
            ),
            step_size=self.h,
            effects=self.effects,
            generators=[_stream(seed, _EFFECT) for seed in seeds],
        )
        self.trim: Trim = level_trim(self.plant, speed, self._gather([s.flight.height_m for s in scenarios]))
        throttle = self.trim.thrust / self.plant.thrust_available(speed)
        plans = [_plan(s, seed) for s, seed in zip(scenarios, seeds, strict=True)]
        self.pilot = Pilot(self.trim, join_plans(plans) if many else plans[0], throttle, xp, self.plant.servos)
        self.commands = self._wanted = Commands(self.trim.elevator, self.trim.elevator, xp.full(0.0), throttle)
        self._noise = _Noise(seeds, self.h, xp)
        self._held_noise = self._noise.next()
        self._dx = xp.new_state(self.plant.size)
        self._committers = [e for e in self.effects if overrides(e, "commit")]
        self._sensors = [e.sense for e in self.effects if overrides(e, "sense")]
        self.k = -round(SETTLE / self.h)
        headings = self._gather([np.radians(s.flight.heading_deg) for s in scenarios])
        self.x = self._start(headings, seeds)
        motion, _ = self.look(0.0)
        for effect in self.effects:
            effect.start(motion, self.x)
        while self.k < 0:
            self.step()

    @staticmethod
    def _check_alike(scenarios: Sequence[Scenario], many: bool) -> None:
        if not many and len(scenarios) != 1:
            raise ValueError("one flight at a time on floats")
        keys = {
            (s.flight.aircraft, s.site, s.flight.integration_hz, tuple(h.name for h in s.hidden)) for s in scenarios
        }
        if len(keys) != 1:
            raise ScenarioError("flights side by side must share aircraft, site, integration rate and hidden effects")

    def _gather(self, values: Sequence[float]) -> Value:
        return float(values[0]) if self.xp.flights is None else np.array(values, float)

    def _start(self, heading: Value, seeds: Sequence[int]) -> State:
        xp, trim = self.xp, self.trim
        x = xp.new_state(self.plant.size)
        x[0], x[2] = trim.speed * xp.cos(trim.alpha), trim.speed * xp.sin(trim.alpha)
        ch, sh = xp.cos(0.5 * heading), xp.sin(0.5 * heading)
        ct, st = xp.cos(0.5 * trim.alpha), xp.sin(0.5 * trim.alpha)
        x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2], x[ATTITUDE + 3] = ch * ct, -sh * st, ch * st, sh * ct
        x[POSITION + 2] = -trim.height
        wn, we, _ = self.plant.wind_ned
        # The ground velocity in body axes is the air velocity plus the wind, wings level.
        tailwind, across = wn * xp.cos(heading) + we * xp.sin(heading), we * xp.cos(heading) - wn * xp.sin(heading)
        x[0] = x[0] + tailwind * xp.cos(trim.alpha)
        x[1] = x[1] + across
        x[2] = x[2] + tailwind * xp.sin(trim.alpha)
        x[ARMS], x[ARMS + 1] = trim.elevator, trim.elevator
        x[THRUST] = trim.thrust
        if self.plant.gusts is not None:
            draws = np.stack([_stream(seed, _GUST_START).standard_normal(6) for seed in seeds], axis=-1)
            start = stationary_start(self.plant.gusts, draws if xp.flights is not None else draws[:, 0])
            for i in range(GUST_STATES):
                x[GUST + i] = start[i] if xp.flights is not None else float(start[i])
        return x

    @property
    def time(self) -> float:
        """Time of the last grid point [s]."""
        return self.k * self.h

    def step(self) -> None:
        """Advance by one grid step."""
        if self.k % self._per_frame == 0:
            motion = self.plant.evaluate(self.time, self.x, self.commands, self._held_noise, self._dx)
            if not self.wiring.hands_still(self.time):
                self._wanted = self.pilot.act(self.k // self._per_frame, motion)
            self.commands = self.wiring.route(self.time, self._wanted)
        self.x = self.plant.step(self.time, self.x, self.commands, self._held_noise, self.h)
        self.k += 1
        self._held_noise = self._noise.next()
        if self._committers:
            motion = self.plant.evaluate(self.time, self.x, self.commands, self._held_noise, self._dx)
            for effect in self._committers:
                effect.commit(motion, self.x)

    def advance(self, time: float) -> None:
        """Advance to the last grid point not after `time`."""
        target = int(np.floor(time / self.h + 1e-9))
        if target < self.k:
            raise ValueError(f"time {time} s lies before the simulation's {self.time} s")
        while self.k < target:
            self.step()

    def look(self, dt: float) -> tuple[Motion, State]:
        """Motion and state `dt` seconds after the last grid point (0 <= dt <= step), without moving on."""
        x = self.x
        if dt > 0.0:
            x = self.plant.step(self.time, x, self.commands, self._held_noise, dt)
        return self.plant.evaluate(self.time + dt, x, self.commands, self._held_noise, self._dx), x

    def sensed(self, m: Motion, x: State) -> Sensed:
        """What flawless instruments at the CG are shown in this motion."""
        angles = euler_angles(m, self.xp)
        flow, arms = (m.alpha, m.beta, m.V), (m.arm_left, m.arm_right, m.arm_r)
        s = Sensed(m.ax, m.ay, m.az, m.p, m.q, m.r, *angles, *flow, *arms)
        for sense in self._sensors:
            sense(s, m, x)
        return s


SENSED_NAMES = tuple(f.name for f in fields(Sensed))
