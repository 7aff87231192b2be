"""Hidden effects that no list of ordinary suspects contains: a search should say it does not know them.

Each has real dynamics, memory or occasion of its own. Sizes are engineering estimates, chosen to be plainly there.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from daq.utilities.constants import GRAVITY
from firmware_sim.physics.effects.base import HiddenEffect, Sensed
from firmware_sim.physics.maths import State, Value

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion


class _Unlisted(HiddenEffect):
    group = "uncatalogued"
    catalogued = False


class SwingingLoad(_Unlisted):
    """A load hung below the CG swings sideways, pulling on the airframe: `size` is its share of the mass.

    Small-angle pendulum of 0.5 m in the lateral plane, driven by the side force the airframe feels, damping 0.05.
    """

    name, title, unit, typical = "swinging_load", "a hung load swings", "1", 0.12
    states = 2
    LENGTH, DROP, DAMPING = 0.5, 0.12, 0.05

    def forces(self, m: "Motion", x: State) -> None:
        self_weight = self.size * self.plant.mass * GRAVITY
        m.Y = m.Y + self_weight * x[self.at]

    def moments(self, m: "Motion", x: State) -> None:
        m.L = m.L - self.DROP * self.size * self.plant.mass * GRAVITY * x[self.at]

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        omega = math.sqrt(GRAVITY / self.LENGTH)
        angle, rate = x[self.at], x[self.at + 1]
        dx[self.at] = rate
        dx[self.at + 1] = -omega * omega * angle - 2.0 * self.DAMPING * omega * rate - m.ay / self.LENGTH - m.p_dot


class FlexibleFin(_Unlisted):
    """The fin bends and twists on its spar: a lightly damped second-order mode between rudder arm and fin angle.

    `size` is the share of fin angle that goes through the mode, with the elastic part also driven by sideslip.
    """

    name, title, unit, typical = "flexible_fin", "the fin swings on its spar", "1", 1.0
    states = 2
    FREQUENCY, DAMPING = 2.0 * math.pi * 1.5, 0.05

    def linkage(self, m: "Motion", x: State) -> None:
        m.surface_r = m.surface_r + self.size * x[self.at]

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        w = self.FREQUENCY
        push = 0.45 * (m.arm_r - m.beta)
        dx[self.at] = x[self.at + 1]
        dx[self.at + 1] = -w * w * (x[self.at] + push) - 2.0 * self.DAMPING * w * x[self.at + 1]


class FinStall(_Unlisted):
    """The fin stalls at once beyond a local angle and reattaches late: force, yaw and roll of the fin lost together.

    Local angle = rudder less sideslip. A lagged attached fraction with hysteresis; `size` scales the loss.
    """

    name, title, unit, typical = "fin_stall", "the fin stalls and reattaches late", "1", 1.0
    states = 1
    ANGLE, WIDTH, MEMORY, LAG = 0.085, 0.006, 0.02, 0.12

    def start(self, m: "Motion", x: State) -> None:
        x[self.at] = self.xp.full(1.0)

    def _static(self, m: "Motion", attached: Value) -> Value:
        xp = self.xp
        local = m.arm_r - m.beta
        threshold = self.ANGLE - self.MEMORY * (1.0 - attached)
        return 0.5 * (1.0 - xp.tanh((local * xp.sign(local) - threshold) / self.WIDTH))

    def coefficients(self, m: "Motion", x: State) -> None:
        loss = 0.7 * self.size * (1.0 - self.xp.clip(x[self.at], 0.0, 1.0)) * (m.surface_r - m.beta)
        d = self.plant.derivatives
        m.CY = m.CY - d["CY_dr"] * loss
        m.Cl = m.Cl - d["Cl_dr"] * loss
        m.Cn = m.Cn - d["Cn_dr"] * loss

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        dx[self.at] = (self._static(m, x[self.at]) - x[self.at]) / self.LAG


class VortexHysteresis(_Unlisted):
    """The leading-edge vortex of one side bursts and does not come back on the same path: hysteresis of Cl in sideslip.

    Two-state relay with a lag: the state flips when sideslip passes +-3 degrees and adds a rolling moment.
    """

    name, title, unit, typical = "vortex_hysteresis", "rolling moment with hysteresis in sideslip", "1", 0.0015
    states = 1
    EDGE, LAG = math.radians(3.0), 0.05

    def start(self, m: "Motion", x: State) -> None:
        self._side: Value = self.xp.full(1.0)
        x[self.at] = self.xp.full(1.0)

    def commit(self, m: "Motion", x: State) -> None:
        xp = self.xp
        self._side = xp.select(m.beta > self.EDGE, 1.0, xp.select(m.beta < -self.EDGE, -1.0, self._side))

    def coefficients(self, m: "Motion", x: State) -> None:
        m.Cl = m.Cl + self.size * x[self.at]

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        dx[self.at] = (getattr(self, "_side", 1.0) - x[self.at]) / self.LAG


class ShearBurst(_Unlisted):
    """One burst of cross wind, three seconds long, somewhere in the flight: `size` m/s."""

    name, title, unit, typical = "shear_burst", "three seconds of cross wind", "m/s", 1.2
    LENGTH = 3.0

    def start(self, m: "Motion", x: State) -> None:
        self._begin: Value = self.draw(lambda g: g.uniform(6.0, 24.0))
        self._side: Value = self.draw(lambda g: 1.0 if g.random() < 0.5 else -1.0)

    def wind(self, m: "Motion", x: State) -> None:
        phase = (m.t - getattr(self, "_begin", 1e9)) / self.LENGTH
        share = self.xp.clip(phase, 0.0, 1.0)
        sine = self.xp.sin(math.pi * share)
        m.gust_v = m.gust_v + self.size * getattr(self, "_side", 1.0) * sine * sine


class StaleVane(_Unlisted):
    """The vane's converter delivers a new value only now and then: `size` s between values on average."""

    name, title, unit, typical = "stale_vane", "sideslip samples repeated", "s", 0.30

    def start(self, m: "Motion", x: State) -> None:
        self._held: Value = m.beta
        self._due: Value = self.xp.full(m.t)

    def commit(self, m: "Motion", x: State) -> None:
        due = m.t >= self._due
        if not np.any(due):
            return
        wait = self.draw_where(due, lambda g: g.uniform(0.5, 1.5)) * self.size
        self._held = self.xp.select(due, m.beta, self._held)
        self._due = self.xp.select(due, m.t + wait, self._due)

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        s.beta = self._held


class VaneFriction(_Unlisted):
    """The vane sticks in its bearing until the wind is `size` rad off (half width of the dead band), then slips."""

    name, title, unit, typical = "vane_friction", "sideslip vane sticks", "rad", 0.020

    def start(self, m: "Motion", x: State) -> None:
        self._rests: Value = m.beta

    def commit(self, m: "Motion", x: State) -> None:
        # Once it slips it goes nearly the whole way: stiction above, little friction while moving.
        deviation = m.beta - self._rests
        slips = deviation * self.xp.sign(deviation) > self.size
        self._rests = self.xp.select(slips, m.beta - 0.15 * deviation, self._rests)

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        s.beta = self._rests


class AhrsTurnError(_Unlisted):
    """The attitude filter trusts the accelerometer as a plumb line: in a turn it levels itself to the apparent vertical.

    phi error e: e' = -(phi_hat - phi_apparent) / tau with phi_apparent = atan2(-ay, -az); `size` is 1 / tau.
    """

    name, title, unit, typical = "ahrs_turn_error", "attitude filter levels itself in turns", "1/s", 0.5
    states = 1

    def start(self, m: "Motion", x: State) -> None:
        x[self.at] = self.xp.full(0.0)

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        xp = self.xp
        phi = xp.atan2(m.c23, m.c33)
        apparent = xp.atan2(-m.ay, -m.az)
        dx[self.at] = -self.size * (phi + x[self.at] - apparent)

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        s.phi = s.phi + x[self.at]


class ThermalDrift(_Unlisted):
    """The inertial unit warms up: gyro and accelerometer biases creep in with a time constant of 12 s; `size` in rad/s."""

    name, title, unit, typical = "thermal_drift", "gyro and accelerometer drift while warming up", "rad/s", 0.025

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        warm = 1.0 - math.exp(-max(m.t, 0.0) / 12.0)
        s.p = s.p + self.size * warm
        s.r = s.r - 0.6 * self.size * warm
        s.ay = s.ay + 8.0 * self.size * warm


class SupplySag(_Unlisted):
    """Servos load the sensor supply: every ratiometric angle sags while surfaces move; `size` s of fraction per rad/s."""

    name, title, unit, typical = "supply_sag", "vane readings sag while servos move", "s", 0.06
    states = 1

    def start(self, m: "Motion", x: State) -> None:
        self._before: Value = self.xp.full(0.0)
        self._activity: Value = self.xp.full(0.0)
        x[self.at] = self.xp.full(0.0)

    def commit(self, m: "Motion", x: State) -> None:
        travel = m.arm_right - self._before
        self._before = m.arm_right
        self._activity = travel * self.xp.sign(travel) / self.plant.step_size

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        dx[self.at] = (getattr(self, "_activity", 0.0) - x[self.at]) / 0.15

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        # A sagging reference shifts a vane that reads from one end of its potentiometer (half span 1.5 rad).
        sag = self.size * x[self.at]
        s.beta = s.beta - 1.5 * sag
        s.alpha = s.alpha - 1.5 * sag
