"""Kalman filter and smoother for the wind and for the slow errors of the inertial motion and the airspeed.

The nominal velocity is the integral of the specific forces; the filter estimates its errors and the wind. States, NED unless
stated otherwise: error of the nominal velocity (3) [m/s], error of the attitude (3, rotation vector) [rad], accelerometer
biases (3, body axes) [m/s2], wind (3) [m/s], gust (3) [m/s], scale error of the airspeed [1], sideslip in trim [rad], age of the
satellite velocity [s], age of the airspeed [s]. Airspeed is not linear in them: filter and smoother are run again, linearised
about the smoothed states.

Source: Jategaonkar, Flight Vehicle System Identification (2015), ch. 10 (flight-path reconstruction with wind states);
Rauch, Tung, Striebel (1965) for the smoother.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.errors import DataError

Array = NDArray[np.float64]

VELOCITY, ATTITUDE, BIAS, WIND, GUST = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), slice(12, 15)
SCALE, TRIM, AGE, AIRSPEED_AGE = 15, 16, 17, 18
STATES = 19

INTERVAL = 0.2
"""Time between nodes [s]: several within a gust of 50 m, and within the time in which an attitude error changes."""

UPDRAUGHT_S = 60.0
"""[s] over which an updraught lasts, at most: a kilometre for a small aircraft, the width of a thermal and its sink."""

PASSES = 3
"""Runs, each linearised about the one before; a fourth moves the air velocity by less than 1 mm/s (simulated flights)."""

FIRST_VELOCITY = 30.0
"""Error of the nominal velocity before the first fix [m/s], 1 sigma: as good as unknown."""

VERTICAL_DRIFT = 0.01
"""Variance of the drift of the vertical wind over that of the horizontal wind."""


@dataclass(frozen=True, slots=True)
class Assumptions:
    """Prior standard deviations, and the scales of time and length of what varies.

    trim_sideslip [rad]: mean sideslip of a symmetric aircraft whose pilot or autopilot coordinates (propeller, rigging);
    it matters where the heading hardly changes, for there crosswind and sideslip look alike. manoeuvre_sideslip [rad] over
    manoeuvre_s: sideslip about it. vertical_wind [m/s]: mean updraught over UPDRAUGHT_S; over a longer flight it averages out by
    the root of the time. wind [m/s]: either way, about the first guess. wind_drift [m/s per root second]: 1 m/s in 20 minutes.
    airspeed_scale: position error and calibration factor of the pitot (PX4 and ArduPilot start from 1 and estimate a few per
    cent). bias [m/s2]: accelerometer of an autopilot after its calibration. fix [m/s]: horizontal, vertical noise of a GNSS
    velocity. fix_age [s]: of that velocity when logged. airspeed_age [s]: of an airspeed (tubes, and the mean of a few samples
    that autopilots log); not estimated, it would look like a vertical wind of g times the age, because a descending aircraft
    gains speed. attitude [rad]: least slow error of an attitude (mounting, alignment); attitude_s: how long it lasts. gust_length
    [m]: at heights at which small aircraft fly (MIL-F-8785C).
    """

    trim_sideslip: float = 0.03
    manoeuvre_sideslip: float = 0.1
    manoeuvre_s: float = 2.0
    vertical_wind: float = 0.3
    wind: float = 10.0
    wind_drift: float = 0.03
    airspeed_scale: float = 0.03
    bias: float = 0.1
    fix: tuple[float, float] = (0.2, 0.35)
    fix_age: float = 0.15
    airspeed_age: float = 0.15
    attitude: float = 0.003
    attitude_s: float = 60.0
    gust_length: float = 50.0


@dataclass(frozen=True)
class Nodes:
    """One stretch of a flight without a gap, as K nodes INTERVAL apart.

    time (K,) [s]; velocity (K, 3): nominal, at the node; mean_velocity (K, 3): over the node's samples; axes (K, 3, 3): body
    axes as columns, NED; force, turn: integrals from the node before of the specific force (K, 3) and of `axes` (K, 3, 3);
    acceleration, speed_acceleration (K, 3): over the ground, at the fixes and at the airspeeds, NaN where there is none;
    fix (K, 3): GNSS velocity less the nominal one, NaN where there is none, and fixes (K,) how many are in it;
    airspeed (K,): mean, NaN where not measured.
    """

    time: Array
    velocity: Array
    mean_velocity: Array
    axes: Array
    force: Array
    turn: Array
    acceleration: Array
    speed_acceleration: Array
    fix: Array
    fixes: Array
    airspeed: Array


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of a flight: accelerometers [m/s2 per root Hz], airspeed at a node [m/s], slow errors of phi/theta and psi [rad]."""

    force: float
    airspeed: float
    level: float
    heading: float


@dataclass(frozen=True)
class Smoothed:
    """States (K, 19) and their covariances (K, 19, 19) given the whole flight; likelihood: logarithm, of the innovations;
    scatter: rms innovation in sigmas, by kind of measurement."""

    states: Array
    covariances: Array
    likelihood: float
    scatter: dict[str, float]


def skew(v: Array) -> Array:
    """(3, 3) matrix of the cross product v x."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def smooth_states(
    stretches: Sequence[Nodes], noise: Noise, gust: float, assumed: Assumptions, first_wind: Array, passes: int = PASSES
) -> Smoothed:
    """Filter and smoother over all stretches of a flight, wind and instruments carried on from one to the next.

    gust: standard deviation of a gust component [m/s]; first_wind: (3,) NED [m/s], about which airspeed is linearised first.
    """
    chain = _Chain(stretches, noise, gust, assumed, first_wind)
    smoothed = chain.run(chain.first_guess())
    for _ in range(passes - 1):
        smoothed = chain.run(chain.still_air(smoothed.states))
    return smoothed


def gust_likelihoods(
    stretches: Sequence[Nodes], noise: Noise, gusts: Sequence[float], assumed: Assumptions, first_wind: Array
) -> dict[float, float]:
    """Log-likelihood of the innovations by level of the gusts [m/s]; filter only, all linearised about the same air velocity."""
    middle = gusts[len(gusts) // 2]
    chain = _Chain(stretches, noise, middle, assumed, first_wind)
    still_air = chain.still_air(chain.run(chain.first_guess()).states)
    chains = {gust: _Chain(stretches, noise, gust, assumed, first_wind) for gust in gusts}
    return {gust: chain.forward(still_air).tally.likelihood for gust, chain in chains.items()}


@dataclass(frozen=True)
class _Forward:
    """States and covariances before and after the measurements of each node; statistics of the innovations."""

    before_x: Array
    before_P: Array
    after_x: Array
    after_P: Array
    tally: "_Tally"


class _Chain:
    """The stretches one after the other as one linear system."""

    def __init__(
        self, stretches: Sequence[Nodes], noise: Noise, gust: float, assumed: Assumptions, first_wind: Array
    ) -> None:
        self._noise, self._gust, self._assumed, self._first_wind = noise, gust, assumed, first_wind
        self._velocity = np.concatenate([s.velocity for s in stretches])
        self._mean_velocity = np.concatenate([s.mean_velocity for s in stretches])
        self._axes = np.concatenate([s.axes for s in stretches])
        self._acceleration = np.concatenate([s.acceleration for s in stretches])
        self._speed_acceleration = np.concatenate([s.speed_acceleration for s in stretches])
        self._fix = np.concatenate([s.fix for s in stretches])
        self._fixes = np.concatenate([s.fixes for s in stretches])
        self._airspeed = np.concatenate([s.airspeed for s in stretches])
        speed = np.nanmedian(self._airspeed)
        self._seconds = max(INTERVAL, sum(float(s.time[-1] - s.time[0]) for s in stretches))
        self._gust_s = assumed.gust_length / float(speed)
        self._phi, self._q = self._steps(stretches)

    def still_air(self, states: Array) -> Array:
        """(K, 3) velocity through the air without its gusts, NED [m/s].

        Airspeed is not linearised about the gusts: they are estimated from the airspeed itself, so that its scale would follow
        them. A gust of 0.6 m/s then looks like a scale error of 4 % (simulated flights).
        """
        return np.asarray(self._velocity + states[:, VELOCITY] - states[:, WIND])

    def first_guess(self) -> Array:
        """(K, 3) velocity through the air by the nominal velocity and the first wind, NED [m/s]."""
        return np.asarray(self._velocity - self._first_wind)

    def run(self, still_air: Array) -> Smoothed:
        """Filter and smoother, with airspeed and sideslip linearised about the air velocity `still_air` (K, 3)."""
        f = self.forward(still_air)
        states, covariances = _smoothed(self._phi, f)
        if not np.isfinite(states).all():
            raise DataError(
                "the reconstruction of the air data runs away; check units and signs of velocities and airspeed"
            )
        return Smoothed(states, covariances, f.tally.likelihood, f.tally.scatter())

    def forward(self, still_air: Array) -> _Forward:
        """The filter."""
        x, P = self._start()
        count = len(self._velocity)
        before_x, after_x = np.empty((2, count, STATES))
        before_P, after_P = np.empty((2, count, STATES, STATES))
        tally = _Tally()
        for k in range(count):
            if k:
                x, P = self._phi[k] @ x, self._phi[k] @ P @ self._phi[k].T + self._q[k]
            before_x[k], before_P[k] = x, P
            for kind, residual, row, variance in self._measurements(k, still_air[k]):
                x, P = _updated(x, P, residual, row, variance, kind, tally)
            P = 0.5 * (P + P.T)  # asymmetry from rounding would grow
            after_x[k], after_P[k] = x, P
        return _Forward(before_x, before_P, after_x, after_P, tally)

    def _start(self) -> tuple[Array, Array]:
        a, n = self._assumed, self._noise
        sigma = np.empty(STATES)
        sigma[VELOCITY] = FIRST_VELOCITY
        sigma[ATTITUDE] = n.level, n.level, n.heading
        sigma[BIAS] = a.bias
        sigma[WIND] = a.wind, a.wind, a.vertical_wind * min(1.0, np.sqrt(UPDRAUGHT_S / self._seconds))
        sigma[GUST] = self._gust
        sigma[[SCALE, TRIM, AGE, AIRSPEED_AGE]] = a.airspeed_scale, a.trim_sideslip, a.fix_age, a.airspeed_age
        x = np.zeros(STATES)
        x[WIND] = self._first_wind[0], self._first_wind[1], 0.0
        return x, np.diag(sigma**2)

    def _steps(self, stretches: Sequence[Nodes]) -> tuple[Array, Array]:
        """Transition matrix (K, 19, 19) to each node, and covariance (K, 19, 19) of its process noise."""
        phi, q = [], []
        last = stretches[0].time[0]
        for stretch in stretches:
            for k, time in enumerate(stretch.time):
                dt = float(time - last)
                last = time
                step = self._decay(dt)
                if k == 0:  # the velocity is integrated anew
                    step[0][VELOCITY] = 0.0
                    step[1][VELOCITY, VELOCITY] = np.eye(3) * FIRST_VELOCITY**2
                else:
                    step[0][VELOCITY, VELOCITY] = np.eye(3)
                    step[0][VELOCITY, ATTITUDE] = -skew(stretch.force[k])
                    step[0][VELOCITY, BIAS] = -stretch.turn[k]
                    step[1][VELOCITY, VELOCITY] = np.eye(3) * self._noise.force**2 * dt
                phi.append(step[0])
                q.append(step[1])
        return np.array(phi), np.array(q)

    def _decay(self, dt: float) -> tuple[Array, Array]:
        """Transition matrix and process noise of all states but the velocity over dt [s]."""
        a, n = self._assumed, self._noise
        phi, q = np.eye(STATES), np.zeros((STATES, STATES))
        slow, gust = np.exp(-dt / a.attitude_s), np.exp(-dt / self._gust_s)
        phi[ATTITUDE, ATTITUDE] *= slow
        q[ATTITUDE, ATTITUDE] = np.diag(np.array([n.level, n.level, n.heading]) ** 2) * (1 - slow**2)
        phi[GUST, GUST] *= gust
        q[GUST, GUST] = np.eye(3) * self._gust**2 * (1 - gust**2)
        q[WIND, WIND] = np.diag([1.0, 1.0, VERTICAL_DRIFT]) * a.wind_drift**2 * dt
        return phi, q

    def _measurements(self, k: int, still_air: Array) -> list[tuple[str, float, Array, float]]:
        """Measurements at a node: kind, measured value less the one predicted at zero state, row of derivatives, variance."""
        a = self._assumed
        measurements: list[tuple[str, float, Array, float]] = []
        if self._fixes[k]:
            for axis in range(3):
                row = np.zeros(STATES)
                row[axis] = 1.0
                row[AGE] = -self._acceleration[k, axis]
                sigma = a.fix[axis // 2]
                measurements.append(("velocity", float(self._fix[k, axis]), row, sigma**2))
        speed = float(np.linalg.norm(still_air))
        direction = still_air / speed
        if np.isfinite(self._airspeed[k]):
            row = np.zeros(STATES)
            row[VELOCITY], row[WIND], row[GUST], row[SCALE] = direction, -direction, -direction, speed
            row[AIRSPEED_AGE] = -float(direction @ self._speed_acceleration[k])
            # |v| linearised: direction . v; the part of the nominal velocity does not depend on the state
            nominal = float(direction @ self._mean_velocity[k])
            measurements.append(("airspeed", float(self._airspeed[k]) - nominal, row, self._noise.airspeed**2))
        row = np.zeros(STATES)
        right = self._axes[k, :, 1]
        row[VELOCITY], row[WIND], row[GUST] = right / speed, -right / speed, -right / speed
        row[ATTITUDE] = np.cross(right, still_air) / speed
        row[TRIM] = -1.0
        # as white noise that averages out as slowly as a sideslip that lasts manoeuvre_s
        variance = a.manoeuvre_sideslip**2 * 2 * a.manoeuvre_s / INTERVAL
        measurements.append(("sideslip", -float(right @ self._velocity[k]) / speed, row, variance))
        return measurements


class _Tally:
    """Log-likelihood of the innovations and their scatter, kind by kind."""

    def __init__(self) -> None:
        self.likelihood = 0.0
        self._squares: dict[str, list[float]] = {}

    def add(self, kind: str, innovation: float, variance: float) -> None:
        """Count one innovation."""
        ratio = innovation**2 / variance
        self._squares.setdefault(kind, []).append(ratio)
        if kind != "sideslip":  # an assumption, not a measurement
            self.likelihood -= 0.5 * (ratio + float(np.log(2 * np.pi * variance)))

    def scatter(self) -> dict[str, float]:
        """Root-mean-square innovation in sigmas, 1 where the noises are as assumed."""
        return {kind: float(np.sqrt(np.mean(values))) for kind, values in self._squares.items()}


def _updated(
    x: Array, P: Array, measured: float, row: Array, variance: float, kind: str, tally: _Tally
) -> tuple[Array, Array]:
    reach = P @ row
    total = float(row @ reach) + variance
    innovation = measured - float(row @ x)
    tally.add(kind, innovation, total)
    gain = reach / total
    return x + gain * innovation, P - gain[:, None] * reach


def _smoothed(phi: Array, forward: _Forward) -> tuple[Array, Array]:
    """Rauch-Tung-Striebel: from the last node back."""
    x, P = forward.after_x.copy(), forward.after_P.copy()
    for k in range(len(x) - 2, -1, -1):
        gain = np.linalg.solve(forward.before_P[k + 1], phi[k + 1] @ forward.after_P[k]).T
        x[k] += gain @ (x[k + 1] - forward.before_x[k + 1])
        P[k] += gain @ (P[k + 1] - forward.before_P[k + 1]) @ gain.T
    return x, P
