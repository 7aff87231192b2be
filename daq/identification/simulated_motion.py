"""The motion that the believed aircraft makes of the measured surfaces: where the instruments of the regression come from.

A column made of measured motion holds the noise of its sensor, and so does the residual of the same row: least squares
then come out 13 to 18 % low in roll. A simulated column moves with the true one but knows nothing of that noise. Wrong
parameters make it a worse instrument, never a biased one.

Plain floats on purpose: with four states numpy would only add overhead.
"""

import math
from collections import deque
from typing import NamedTuple

from daq.contract.constants import GRAVITY
from daq.identification.airframe import DERIVATIVES, Airframe, Sample
from daq.identification.servo import Between

LONGEST_STEP = 0.026  # s; rolling decays with some 17 /s and a servo's edge takes 35 ms: Runge-Kutta is within 0.1 %
SETTLE = (
    8.0  # s in which the simulated bank follows the measured: the spiral mode is slow or unstable and would walk off
)
DELAY = (
    5  # scans by which that is late: a row holds the noise of four scans, so that none of it gets into the instruments
)
LIMITS = (0.6, 12.0, 6.0, 3.0)  # rad, rad/s, rad/s, rad of beta p r phi: beyond, the believed aircraft has departed


class LateralState(NamedTuple):
    """Sideslip [rad], roll and yaw rate [rad/s], bank [rad]; or their rates of change, or their integrals."""

    beta: float
    p: float
    r: float
    phi: float

    def moved(self, rate: "LateralState", dt: float) -> "LateralState":
        """Where this motion is after `dt` seconds at constant rates."""
        return LateralState(
            self.beta + dt * rate.beta, self.p + dt * rate.p, self.r + dt * rate.r, self.phi + dt * rate.phi
        )

    @property
    def departed(self) -> bool:
        """Whether no aircraft moves so, or nothing is a number any more."""
        return not all(abs(x) < limit for x, limit in zip(self, LIMITS, strict=True))


class MotionInputs(NamedTuple):
    """What drives the motion at one instant: pitch rate, attitude, angle of attack, airspeed, density, surfaces."""

    q: float
    theta: float
    alpha: float
    V: float
    rho: float
    delta_a: float
    delta_r: float


NOWHERE = LateralState(0.0, 0.0, 0.0, 0.0)


class SimulatedMotion:
    """Runs beside the flight, interval by interval. values: derivatives by name; may be replaced while it runs."""

    def __init__(self, airframe: Airframe) -> None:
        self._airframe = airframe
        self._inertia = airframe.Ixx * airframe.Izz - airframe.Ixz**2
        self._lag: deque[float] = deque(maxlen=DELAY)
        self.motion = NOWHERE
        self.values = {n: airframe.believed(n) for n in DERIVATIVES}

    def restart(self, sample: Sample) -> None:
        """Begin anew from measured motion."""
        self.motion = LateralState(sample.beta, sample.p, sample.r, sample.phi)
        self._lag.clear()

    def advance(self, first: Sample, last: Sample, aileron: Between, rudder: Between) -> LateralState:
        """Go from `first` to `last`: the integral of the motion over the interval. V, alpha, theta, q on straight lines."""
        interval = last.time - first.time
        steps = max(1, math.ceil(interval / LONGEST_STEP))
        points = [_between(first, last, k / (2 * steps), aileron, rudder) for k in range(2 * steps + 1)]
        integral = NOWHERE
        for k in range(0, 2 * steps, 2):
            integral = self._step(integral, interval / steps, points[k], points[k + 1], points[k + 2])
        if self.motion.departed:
            self.restart(last)
        else:
            self._follow_bank(last, interval)
        return integral

    def _follow_bank(self, sample: Sample, dt: float) -> None:
        self._lag.append(sample.phi - self.motion.phi)
        if len(self._lag) == DELAY:
            self.motion = self.motion._replace(phi=self.motion.phi + min(dt / SETTLE, 1.0) * self._lag[0])

    def _step(
        self, integral: LateralState, h: float, first: MotionInputs, middle: MotionInputs, last: MotionInputs
    ) -> LateralState:
        """One step of the classical Runge-Kutta method over `h` seconds, of the motion and of its integral."""
        x = self.motion
        k1 = self._rates(x, first)
        k2 = self._rates(x.moved(k1, h / 2), middle)
        k3 = self._rates(x.moved(k2, h / 2), middle)
        k4 = self._rates(x.moved(k3, h), last)
        sixth = h / 6
        self.motion = x.moved(k1, sixth).moved(k2, 2 * sixth).moved(k3, 2 * sixth).moved(k4, sixth)
        return integral.moved(x.moved(k1, sixth).moved(k2, sixth).moved(k3, sixth), h)

    def _rates(self, x: LateralState, u: MotionInputs) -> LateralState:
        """Equations of lateral motion without the rate of change of airspeed, which instruments can do without."""
        d, a = self.values, self._airframe
        q_s = 0.5 * u.rho * u.V * u.V * a.area
        p_hat, r_hat = x.p * a.span / (2 * u.V), x.r * a.span / (2 * u.V)
        CY = d["CY_0"] + d["CY_beta"] * x.beta + d["CY_p"] * p_hat + d["CY_r"] * r_hat + d["CY_dr"] * u.delta_r
        Cl = d["Cl_0"] + d["Cl_beta"] * x.beta + d["Cl_p"] * p_hat + d["Cl_r"] * r_hat + d["Cl_da"] * u.delta_a
        Cl += d["Cl_dr"] * u.delta_r
        Cn = d["Cn_0"] + d["Cn_beta"] * x.beta + d["Cn_p"] * p_hat + d["Cn_r"] * r_hat + d["Cn_dr"] * u.delta_r
        roll = q_s * a.span * Cl + a.Ixz * x.p * u.q - (a.Izz - a.Iyy) * u.q * x.r
        yaw = q_s * a.span * Cn - a.Ixz * u.q * x.r - (a.Iyy - a.Ixx) * x.p * u.q
        side = q_s * CY / a.mass + GRAVITY * math.cos(u.theta) * math.sin(x.phi)
        return LateralState(
            x.p * math.sin(u.alpha) - x.r * math.cos(u.alpha) + side / u.V,
            (a.Izz * roll + a.Ixz * yaw) / self._inertia,
            (a.Ixx * yaw + a.Ixz * roll) / self._inertia,
            x.p + math.tan(u.theta) * (u.q * math.sin(x.phi) + x.r * math.cos(x.phi)),
        )


def _between(a: Sample, b: Sample, part: float, aileron: Between, rudder: Between) -> MotionInputs:
    rest = 1.0 - part
    return MotionInputs(
        rest * a.q + part * b.q,
        rest * a.theta + part * b.theta,
        rest * a.alpha + part * b.alpha,
        rest * a.V + part * b.V,
        rest * a.rho + part * b.rho,
        aileron.at(part),
        rudder.at(part),
    )
