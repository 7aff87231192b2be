"""The motion that the believed aircraft makes of the measured surfaces: where the instruments of the regression come from.

A column made of measured motion holds the noise of its sensor, and so does the residual of the same row: least squares
then come out 13 to 18 % low in roll. A simulated column moves with the true one but knows nothing of that noise. Wrong
parameters make it a worse instrument, never a biased one.

Plain floats on purpose: with four states numpy would only add overhead.
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar

from daq.identification.airframe import Airframe, Sample
from daq.identification.regression import LATERAL, LONGITUDINAL, PlaneRegression
from daq.identification.surfaces import Between, SurfaceCurves, cubic_weights
from daq.utilities.constants import GRAVITY

LONGEST_STEP = 0.026  # s; rolling decays with some 17 /s and a servo's edge takes 35 ms: Runge-Kutta is within 0.1 %
SETTLE = (
    8.0  # s in which the simulated bank follows the measured: the spiral mode is slow or unstable and would walk off
)
DELAY = (
    5  # scans by which that is late: a row holds the noise of four scans, so that none of it gets into the instruments
)
LIMITS = (0.6, 12.0, 6.0, 3.0)  # rad, rad/s, rad/s, rad of beta p r phi: beyond, the believed aircraft has departed
VANE_S = 0.4  # s in which a steadied angle follows the vane: where its noise and gusts of usual size are worth the same
AFTERWARDS_S = 1.0  # s for which later scans correct an earlier angle: what comes after is worth less than a tenth
DENSE = 0.06  # s between scans up to which it is known well enough how surfaces move from one to the next
PITCH_LIMITS = (0.8, 8.0)  # rad, rad/s of alpha q


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


class PitchState(NamedTuple):
    """Angle of attack [rad], pitch rate [rad/s]; or their rates of change, or their integrals."""

    alpha: float
    q: float

    def moved(self, rate: "PitchState", dt: float) -> "PitchState":
        """Where this motion is after `dt` seconds at constant rates."""
        return PitchState(self.alpha + dt * rate.alpha, self.q + dt * rate.q)

    @property
    def departed(self) -> bool:
        """Whether no aircraft moves so, or nothing is a number any more."""
        return not all(abs(x) < limit for x, limit in zip(self, PITCH_LIMITS, strict=True))


MotionState = LateralState | PitchState
State = TypeVar("State", LateralState, PitchState)


class MotionInputs(NamedTuple):
    """What drives the lateral motion at one instant: pitch rate, attitude, angle of attack, airspeed, density, surfaces,
    mass, and how far the CG is ahead of the airframe's [m]."""

    q: float
    theta: float
    alpha: float
    V: float
    rho: float
    delta_a: float
    delta_r: float
    mass_ratio: float = 1.0
    cg_ahead: float = 0.0


NOWHERE = LateralState(0.0, 0.0, 0.0, 0.0)
Inputs = TypeVar("Inputs")


class _Simulation(Generic[State, Inputs]):
    """Runs beside the flight, interval by interval. values: derivatives by name; may be replaced while it runs."""

    nowhere: State

    def __init__(self, airframe: Airframe, regression: PlaneRegression) -> None:
        self._airframe = airframe
        self.values = {n: airframe.believed(n) for n in regression.derivatives}
        self.motion: State = self.nowhere

    def restart(self, sample: Sample) -> None:
        """Begin anew from measured motion."""
        raise NotImplementedError

    def advance(self, first: Sample, last: Sample, *surfaces: Between) -> State:
        """Go from `first` to `last`: the integral of the motion over the interval. What is measured, on straight lines."""
        interval = last.time - first.time
        steps = max(1, math.ceil(interval / LONGEST_STEP))
        points = [self._between(first, last, k / (2 * steps), surfaces) for k in range(2 * steps + 1)]
        integral = self.nowhere
        for k in range(0, 2 * steps, 2):
            integral = self._step(integral, interval / steps, points[k], points[k + 1], points[k + 2])
        if self.motion.departed:
            self.restart(last)
        else:
            self._follow(last, interval)
        return integral

    def _step(self, integral: State, h: float, first: Inputs, middle: Inputs, last: Inputs) -> State:
        """One step of the classical Runge-Kutta method over `h` seconds, of the motion and of its integral."""
        x = self.motion
        k1 = self.rates(x, first)
        k2 = self.rates(x.moved(k1, h / 2), middle)
        k3 = self.rates(x.moved(k2, h / 2), middle)
        k4 = self.rates(x.moved(k3, h), last)
        sixth = h / 6
        self.motion = x.moved(k1, sixth).moved(k2, 2 * sixth).moved(k3, 2 * sixth).moved(k4, sixth)
        return integral.moved(x.moved(k1, sixth).moved(k2, sixth).moved(k3, sixth), h)

    def _follow(self, sample: Sample, dt: float) -> None:
        """What of the motion is drawn towards the measured one: nothing, if no mode walks off."""

    def _between(self, first: Sample, last: Sample, part: float, surfaces: Sequence[Between]) -> Inputs:
        """What drives the motion where `part` of the interval has passed."""
        raise NotImplementedError

    def rates(self, x: State, u: Inputs) -> State:
        raise NotImplementedError


class SimulatedMotion(_Simulation[LateralState, MotionInputs]):
    """Lateral motion; V, alpha, theta, q are measured."""

    nowhere = NOWHERE

    def __init__(self, airframe: Airframe) -> None:
        super().__init__(airframe, LATERAL)
        self._inertia = airframe.Ixx * airframe.Izz - airframe.Ixz**2
        self._lag: deque[float] = deque(maxlen=DELAY)

    def restart(self, sample: Sample) -> None:
        """Begin anew from measured motion."""
        self.motion = LateralState(sample.beta, sample.p, sample.r, sample.phi)
        self._lag.clear()

    def _follow(self, sample: Sample, dt: float) -> None:
        self._lag.append(sample.phi - self.motion.phi)
        if len(self._lag) == DELAY:
            self.motion = self.motion._replace(phi=self.motion.phi + min(dt / SETTLE, 1.0) * self._lag[0])

    def _between(self, first: Sample, last: Sample, part: float, surfaces: Sequence[Between]) -> MotionInputs:
        a, b, rest = first, last, 1.0 - part
        aileron, rudder = surfaces
        return MotionInputs(
            rest * a.q + part * b.q,
            rest * a.theta + part * b.theta,
            rest * a.alpha + part * b.alpha,
            rest * a.V + part * b.V,
            rest * a.rho + part * b.rho,
            aileron.at(part),
            rudder.at(part),
            rest * self._airframe.mass_ratio(a.mass) + part * self._airframe.mass_ratio(b.mass),
            rest * self._airframe.cg_ahead(a.cg_x) + part * self._airframe.cg_ahead(b.cg_x),
        )

    def rates(self, x: LateralState, u: MotionInputs) -> LateralState:
        """Equations of lateral motion without the rate of change of airspeed, which instruments can do without."""
        d, a = self.values, self._airframe
        q_s = 0.5 * u.rho * u.V * u.V * a.area
        p_hat, r_hat = x.p * a.span / (2 * u.V), x.r * a.span / (2 * u.V)
        CY = d["CY_0"] + d["CY_beta"] * x.beta + d["CY_p"] * p_hat + d["CY_r"] * r_hat + d["CY_dr"] * u.delta_r
        Cl = d["Cl_0"] + d["Cl_beta"] * x.beta + d["Cl_p"] * p_hat + d["Cl_r"] * r_hat + d["Cl_da"] * u.delta_a
        Cl += d["Cl_dr"] * u.delta_r
        Cn = d["Cn_0"] + d["Cn_beta"] * x.beta + d["Cn_p"] * p_hat + d["Cn_r"] * r_hat + d["Cn_dr"] * u.delta_r
        roll = q_s * a.span * Cl + a.Ixz * x.p * u.q - (a.Izz - a.Iyy) * u.q * x.r
        yaw = q_s * (a.span * Cn - u.cg_ahead * CY) - a.Ixz * u.q * x.r - (a.Iyy - a.Ixx) * x.p * u.q
        side = q_s * CY / (a.mass * u.mass_ratio) + GRAVITY * math.cos(u.theta) * math.sin(x.phi)
        return LateralState(
            x.p * math.sin(u.alpha) - x.r * math.cos(u.alpha) + side / u.V,
            (a.Izz * roll + a.Ixz * yaw) / self._inertia,
            (a.Ixx * yaw + a.Ixz * roll) / self._inertia,
            x.p + math.tan(u.theta) * (u.q * math.sin(x.phi) + x.r * math.cos(x.phi)),
        )


class PitchInputs(NamedTuple):
    """What drives the pitching motion at one instant: everything measured, and the elevator [rad]."""

    sample: Sample
    elevator: float


class SimulatedPitch(_Simulation[PitchState, PitchInputs]):
    """Angle of attack and pitch rate; V, attitude and the lateral motion are measured."""

    nowhere = PitchState(0.0, 0.0)

    def __init__(self, airframe: Airframe) -> None:
        super().__init__(airframe, LONGITUDINAL)

    def restart(self, sample: Sample) -> None:
        """Begin anew from measured motion."""
        self.motion = PitchState(sample.alpha, sample.q)

    def lift_coefficient(self, x: PitchState, V: float, elevator: float) -> float:
        """CL of a motion at an airspeed [m/s] with the elevator at an angle [rad]."""
        d = self.values
        return (
            d["CL_0"]
            + d["CL_alpha"] * x.alpha
            + d["CL_q"] * x.q * self._airframe.chord / (2 * V)
            + d["CL_de"] * elevator
        )

    def _between(self, first: Sample, last: Sample, part: float, surfaces: Sequence[Between]) -> PitchInputs:
        if 0.0 < part < 1.0:
            first = Sample._make([a + part * (b - a) for a, b in zip(first, last, strict=True)])
        return PitchInputs(last if part == 1.0 else first, surfaces[0].at(part))

    def rates(self, x: PitchState, inputs: PitchInputs) -> PitchState:
        """Equations of the pitching motion at measured airspeed and attitude."""
        d, a, (u, elevator) = self.values, self._airframe, inputs
        q_s = 0.5 * u.rho * u.V * u.V * a.area
        CL = self.lift_coefficient(x, u.V, elevator)
        CD = d["CD_0"] + d["CD_k"] * CL * CL
        Cm = d["Cm_0"] + d["Cm_alpha"] * x.alpha + d["Cm_q"] * x.q * a.chord / (2 * u.V) + d["Cm_de"] * elevator
        sin, cos = math.sin(x.alpha), math.cos(x.alpha)
        mass = a.mass_as(u.mass)
        gx = (q_s * (CL * sin - CD * cos) + u.thrust) / mass - GRAVITY * math.sin(u.theta)
        gz = q_s * (-CL * cos - CD * sin) / mass + GRAVITY * math.cos(u.theta) * math.cos(u.phi)
        alpha_rate = x.q - math.tan(u.beta) * (u.p * cos + u.r * sin) + (gz * cos - gx * sin) / (u.V * math.cos(u.beta))
        by_cg = -a.cg_ahead(u.cg_x) * (CL * cos + CD * sin)
        moment = q_s * (a.chord * Cm + by_cg) + (a.Izz - a.Ixx) * u.p * u.r - a.Ixz * (u.p * u.p - u.r * u.r)
        return PitchState(alpha_rate, moment / a.Iyy)


class VaneScan(NamedTuple):
    """A scan with the rate of change of its angle of attack [rad/s], measured and simulated."""

    sample: Sample
    measured: float
    simulated: float


class SteadiedVane:
    """Angle of attack with the noise of the vane mostly off: gyro and accelerometer carry it on, the vane draws it.

    What they say of an interval is integrated by the cubic through the four nearest scans; what that misses where the elevator
    moves between slow scans is taken from a simulated motion, as in the rows of the regression. So it is known two scans late.
    By how much the vane then draws it corrects the scans before as well, the less the longer ago (smoothing by Rauch, Tung and
    Striebel with a constant gain), for `AFTERWARDS_S`: at 20 Hz a fifth of the vane's noise is left, half of the filter's. That,
    and gusts faster than `VANE_S`, are an error of the columns; it has nothing to do with the instruments, so it makes no bias.

    values: of the derivatives that the motion is simulated with; may change.
    """

    def __init__(self, airframe: Airframe, values: dict[str, float]) -> None:
        self._simulated = SimulatedPitch(airframe)
        self._simulated.values = values
        self._elevator = SurfaceCurves(airframe.servo_lag)
        self._scans: deque[VaneScan] = deque(maxlen=5)
        self._filtered: deque[Sample] = deque()
        self._corrections: deque[float] = deque()  # of each of them, by the scans since [rad]
        self._alpha = self._rise = math.nan
        self._time, self._intervals = 0.0, 0  # between scans that belong together

    def restart(self) -> list[Sample]:
        """Scans are missing: those that waited, as far as they are corrected."""
        waiting = [self._corrected() for _ in range(len(self._filtered))]
        waiting += [scan.sample for scan in list(self._scans)[-2:]]
        self._scans.clear()
        self._elevator.restart()
        return waiting

    def add(self, sample: Sample) -> list[Sample]:
        """Samples before this one, with the steadied angle, that later ones hardly correct any more."""
        if self._scans:
            self._time += sample.time - self._scans[-1].sample.time
            self._intervals += 1
        if len(self._scans) < 2 or not self._slow:
            self._simulated.restart(sample)
        self._scans.append(
            VaneScan(sample, alpha_rate(sample, sample.beta), self._simulated_rate(sample) if self._slow else 0.0)
        )
        if len(self._scans) < 3:
            return []
        rise = self._simulate() if len(self._scans) > 3 and self._slow else math.nan
        latest, drawn = self._scans[-3].sample, 0.0
        if len(self._scans) < 5:
            self._alpha = latest.alpha
        else:
            predicted = self._alpha + self._increment()
            drawn = (1.0 - math.exp((self._scans[1].sample.time - latest.time) / VANE_S)) * (latest.alpha - predicted)
            self._alpha = predicted + drawn
        self._rise = rise
        for k, earlier in enumerate(self._filtered):
            self._corrections[k] += drawn * math.exp((earlier.time - latest.time) / VANE_S)
        self._filtered.append(latest._replace(alpha=self._alpha))
        self._corrections.append(0.0)
        settled = []
        while latest.time - self._filtered[0].time > AFTERWARDS_S:
            settled.append(self._corrected())
        return settled

    @property
    def _slow(self) -> bool:
        """Whether the elevator may do between scans what the cubic misses."""
        return self._time > DENSE * self._intervals

    def _simulate(self) -> float:
        """Carry the simulated motion to the last scan but one: by how much its angle rises there [rad]."""
        four = [s.sample for s in list(self._scans)[-4:]]
        times, elevator = zip(*((s.time, s.delta_e) for s in four), strict=True)
        before = self._simulated.motion.alpha
        self._simulated.advance(four[1], four[2], self._elevator.middle(times, elevator))
        self._scans[-2] = self._scans[-2]._replace(simulated=self._simulated_rate(four[2]))
        after = self._simulated.motion
        return math.nan if after == (four[2].alpha, four[2].q) else after.alpha - before  # departed, and restarted

    def _increment(self) -> float:
        """Of the angle in the middle of the last scans but one [rad]."""
        four = list(self._scans)[:4]
        weights = cubic_weights(*(s.sample.time for s in four))
        measured, simulated = (float(weights @ rates) for rates in zip(*(s[1:] for s in four), strict=True))
        missed = self._rise - simulated
        return measured + (missed if math.isfinite(missed) else 0.0)

    def _simulated_rate(self, sample: Sample) -> float:
        return self._simulated.rates(self._simulated.motion, PitchInputs(sample, sample.delta_e)).alpha

    def _corrected(self) -> Sample:
        sample = self._filtered.popleft()
        return sample._replace(alpha=sample.alpha + self._corrections.popleft())


def alpha_rate(s: Sample, beta: float) -> float:
    """Rate of change of the angle of attack in still air [rad/s], by gyros, accelerometers and attitude (Stevens and Lewis,
    Aircraft Control and Simulation, 2.5).

    beta: sideslip [rad]: the vane's; 0 neglects its terms, for where no vane measures sideslip, or where its noise and gusts
    must not enter.
    """
    sin, cos = math.sin(s.alpha), math.cos(s.alpha)
    gx = s.ax - GRAVITY * math.sin(s.theta)
    gz = s.az + GRAVITY * math.cos(s.theta) * math.cos(s.phi)
    sideways = math.tan(beta) * (s.p * cos + s.r * sin)
    return s.q - sideways + (gz * cos - gx * sin) / (s.V * math.cos(beta))


def beta_rate(s: Sample) -> float:
    """Rate of change of the sideslip in still air [rad/s], for small sideslip; source as of `alpha_rate`."""
    side = s.ay + GRAVITY * math.cos(s.theta) * math.sin(s.phi)
    return side / s.V + s.p * math.sin(s.alpha) - s.r * math.cos(s.alpha)


Simulation = SimulatedMotion | SimulatedPitch


def simulation_of(regression: PlaneRegression, airframe: Airframe) -> Simulation:
    """The simulated motion that a regression's instruments come from."""
    return SimulatedPitch(airframe) if "alpha" in regression.states else SimulatedMotion(airframe)
