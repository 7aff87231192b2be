"""Hidden effects outside the catalogue, which a search should report as unknown.

Each has dynamics, a memory or an onset of its own. Sizes are engineering estimates, large enough to be detectable.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from daq.utilities.constants import GRAVITY
from firmware_sim.physics.effects.base import HiddenEffect, Sensed
from firmware_sim.physics.maths import State, Value

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion


class _Uncatalogued(HiddenEffect):
    group = "uncatalogued"
    catalogued = False


class SwingingLoad(_Uncatalogued):
    """A load below the CG that swings sideways and pulls on the airframe. size: its share of the mass.

    A pendulum of 0.5 m at small angles in the lateral plane, driven by the airframe's lateral acceleration; damping ratio 0.05.
    """

    name, title, unit, typical = "swinging_load", "a hung load swings", "1", 0.12
    states = 2
    LENGTH, DROP, DAMPING = 0.5, 0.12, 0.05

    def forces(self, m: "Motion", x: State) -> None:
        load_weight = self.size * self.plant.mass * GRAVITY
        m.Y = m.Y + load_weight * x[self.at]

    def moments(self, m: "Motion", x: State) -> None:
        m.L = m.L - self.DROP * self.size * self.plant.mass * GRAVITY * x[self.at]

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        omega = math.sqrt(GRAVITY / self.LENGTH)
        angle, rate = x[self.at], x[self.at + 1]
        dx[self.at] = rate
        dx[self.at + 1] = -omega * omega * angle - 2.0 * self.DAMPING * omega * rate - m.ay / self.LENGTH - m.p_dot


class FlexibleFin(_Uncatalogued):
    """A fin that bends and twists on its spar: a lightly damped second-order mode between rudder arm and fin angle.

    size: share of the fin angle that follows the mode, which sideslip drives too.
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


class FinStall(_Uncatalogued):
    """A fin that stalls abruptly beyond a local angle and reattaches late, losing side force, yaw and roll together.

    Local angle = rudder - sideslip. The attached fraction has a lag and hysteresis; size: scale of the loss.
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


class VortexHysteresis(_Uncatalogued):
    """A leading-edge vortex that bursts on one side: hysteresis of Cl in sideslip. size: rolling-moment coefficient.

    A relay with a lag, which flips when sideslip passes +-3 degrees.
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


class ShearBurst(_Uncatalogued):
    """One burst of cross wind, three seconds long, at a random time of the flight. size: its peak [m/s]."""

    name, title, unit, typical = "shear_burst", "three seconds of cross wind", "m/s", 1.2
    LENGTH = 3.0

    def start(self, m: "Motion", x: State) -> None:
        self._begin: Value = self.draw(lambda g: g.uniform(6.0, 24.0))
        self._side: Value = self.draw(lambda g: 1.0 if g.random() < 0.5 else -1.0)

    def wind(self, m: "Motion", x: State) -> None:
        phase = (m.t - getattr(self, "_begin", 1e9)) / self.LENGTH
        sine = self.xp.sin(math.pi * self.xp.clip(phase, 0.0, 1.0))
        m.gust_v = m.gust_v + self.size * getattr(self, "_side", 1.0) * sine * sine


class StaleVane(_Uncatalogued):
    """A vane whose converter delivers new values at random intervals. size: their mean [s]."""

    name, title, unit, typical = "stale_vane", "sideslip samples repeated", "s", 0.30

    def start(self, m: "Motion", x: State) -> None:
        self._sample: Value = m.beta
        self._due: Value = self.xp.full(m.t)

    def commit(self, m: "Motion", x: State) -> None:
        due = m.t >= self._due
        if not np.any(due):
            return
        interval = self.draw_where(due, lambda g: g.uniform(0.5, 1.5)) * self.size
        self._sample = self.xp.select(due, m.beta, self._sample)
        self._due = self.xp.select(due, m.t + interval, self._due)

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        s.beta = self._sample


class VaneFriction(_Uncatalogued):
    """A vane that sticks in its bearing until the flow is off by `size` [rad] (half width of the dead band), then slips."""

    name, title, unit, typical = "vane_friction", "sideslip vane sticks", "rad", 0.020

    def start(self, m: "Motion", x: State) -> None:
        self._angle: Value = m.beta

    def commit(self, m: "Motion", x: State) -> None:
        # a slipping vane covers nearly the whole deviation: stiction is high, sliding friction low
        deviation = m.beta - self._angle
        slips = deviation * self.xp.sign(deviation) > self.size
        self._angle = self.xp.select(slips, m.beta - 0.15 * deviation, self._angle)

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        s.beta = self._angle


class AhrsTurnError(_Uncatalogued):
    """An attitude filter that takes specific force for gravity, and therefore levels to the apparent vertical in a turn.

    Its bank error e follows e' = -(phi + e - phi_apparent) / tau with phi_apparent = atan2(-ay, -az). size: 1 / tau [1/s].
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


class ThermalDrift(_Uncatalogued):
    """An inertial unit that warms up: biases of gyros and accelerometers grow with a time constant of 12 s. size: of p
    [rad/s]."""

    name, title, unit, typical = "thermal_drift", "gyro and accelerometer drift while warming up", "rad/s", 0.025

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        drift = 1.0 - math.exp(-max(m.t, 0.0) / 12.0)
        s.p = s.p + self.size * drift
        s.r = s.r - 0.6 * self.size * drift
        s.ay = s.ay + 8.0 * self.size * drift


class SupplySag(_Uncatalogued):
    """Servos that load the sensor supply: ratiometric angles sag while surfaces move. size: fraction per rate [s/rad]."""

    name, title, unit, typical = "supply_sag", "vane readings sag while servos move", "s", 0.06
    states = 1

    def start(self, m: "Motion", x: State) -> None:
        self._last_arm: Value = self.xp.full(0.0)
        self._activity: Value = self.xp.full(0.0)
        x[self.at] = self.xp.full(0.0)

    def commit(self, m: "Motion", x: State) -> None:
        travel = m.arm_right - self._last_arm
        self._last_arm = m.arm_right
        self._activity = travel * self.xp.sign(travel) / self.plant.step_size

    def derivatives(self, m: "Motion", x: State, dx: State) -> None:
        dx[self.at] = (getattr(self, "_activity", 0.0) - x[self.at]) / 0.15

    def sense(self, s: Sensed, m: "Motion", x: State) -> None:
        # a lower reference shifts a vane whose angle is measured from one end of its potentiometer (half span 1.5 rad)
        sag = self.size * x[self.at]
        s.beta = s.beta - 1.5 * sag
        s.alpha = s.alpha - 1.5 * sag
