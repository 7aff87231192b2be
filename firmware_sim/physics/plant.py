"""Equations of motion of the whole simulated aircraft: rigid body, servos, engine, gusts and hidden effects.

Six degrees of freedom over a flat earth with constant gravity, attitude as a quaternion (NED to body), product of inertia
Ixz. Forces and moments: `aerodynamics`; what a hidden effect adds comes through the hooks of `effects.base.Effect`.
The same code flies one aircraft on floats or many on arrays (`maths`). Equations: Stevens, Lewis and Johnson, Aircraft
Control and Simulation, 3rd ed., table 2.5-1, written with the product of inertia kept on the moment side.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daq.utilities.constants import GRAVITY
from estimation.aircraft import Aircraft, Engine, Servos
from firmware_sim.physics.aerodynamics import Aerodynamics
from firmware_sim.physics.atmosphere import Site, air_at
from firmware_sim.physics.effects.base import HiddenEffect, overrides
from firmware_sim.physics.maths import Maths, State, Value
from firmware_sim.physics.motion import Motion
from firmware_sim.physics.wind import GUST_STATES, Gusts
from firmware_sim.tables import ScenarioError

# Layout of the state: u v w, p q r, quaternion, north east down, servo arms left right rudder, thrust, gusts, effects.
VELOCITY, RATES, ATTITUDE, POSITION, ARMS, THRUST, GUST = 0, 3, 6, 10, 13, 16, 17
RIGID_STATES = 13
EFFECTS = GUST + GUST_STATES


@dataclass(frozen=True, slots=True)
class Commands:
    """What the pilot's receiver sends: elevon and rudder angles [rad], throttle 0..1."""

    left: Value
    right: Value
    rudder: Value
    throttle: Value


def actuators_of(aircraft: Aircraft) -> tuple[Servos, Engine]:
    """Servos and engine of an aircraft. Raises ScenarioError where its file has none."""
    if aircraft.servos is None or aircraft.engine is None:
        missing = " and ".join(f"[{n}]" for n in ("servos", "engine") if getattr(aircraft, n) is None)
        raise ScenarioError(
            f"aircraft {aircraft.name!r} cannot be flown: its file has no {missing}; add it (docs/aircraft.md)"
        )
    return aircraft.servos, aircraft.engine


class Plant:
    """The vector field dx/dt of one or many flights, and its RK4 step."""

    def __init__(
        self,
        aircraft: Aircraft,
        derivatives: Mapping[str, Value],
        site: Site,
        xp: Maths,
        *,
        gusts: Gusts | None = None,
        wind_ned: tuple[Value, Value, Value] = (0.0, 0.0, 0.0),
        step_size: float = 0.005,
        effects: Sequence[HiddenEffect] = (),
        generators: Sequence[np.random.Generator] = (),
    ) -> None:
        self.aircraft = aircraft
        self.servos, self.engine = actuators_of(aircraft)
        self.xp = xp
        self.site = site
        self.step_size = step_size
        self.gusts = gusts
        self.wind_ned = wind_ned
        self.generators = generators
        self.derivatives: dict[str, Value] = dict(derivatives)
        self.mass: Value = aircraft.mass
        self.Ixx: Value = aircraft.Ixx
        self.Iyy: Value = aircraft.Iyy
        self.Izz: Value = aircraft.Izz
        self.Ixz: Value = aircraft.Ixz
        self.effects = tuple(effects)
        self.size = EFFECTS
        for effect in self.effects:
            effect.at = self.size
            self.size += effect.states
            effect.bind(self)
        self.aero = Aerodynamics(self.derivatives)
        self._wind_hooks = [e.wind for e in effects if overrides(e, "wind")]
        self._linkage_hooks = [e.linkage for e in effects if overrides(e, "linkage")]
        self._coefficient_hooks = [e.coefficients for e in effects if overrides(e, "coefficients")]
        self._force_hooks = [e.forces for e in effects if overrides(e, "forces")]
        self._moment_hooks = [e.moments for e in effects if overrides(e, "moments")]
        self._state_hooks = [e.derivatives for e in effects if overrides(e, "derivatives")]

    def evaluate(self, t: float, x: State, commands: Commands, noise: State, dx: State) -> Motion:
        """Fill `dx` with the rates of `x` at time `t` and return everything computed on the way."""
        xp = self.xp
        m = Motion()
        m.t = t
        self._unpack(m, x)
        self._air(m, x)
        for wind in self._wind_hooks:
            wind(m, x)
        self._flow(m)
        self._surfaces(m, x)
        for linkage in self._linkage_hooks:
            linkage(m, x)
        m.surface_e = 0.5 * (m.surface_left + m.surface_right)
        m.surface_a = 0.5 * (m.surface_right - m.surface_left)
        self.aero.coefficients(m)
        for coefficients in self._coefficient_hooks:
            coefficients(m, x)
        self._forces(m)
        for forces in self._force_hooks:
            forces(m, x)
        self._translation(m, dx)
        self._moments(m)
        for moments in self._moment_hooks:
            moments(m, x)
        self._rotation(m, dx)
        self._actuators(m, x, commands, dx)
        if self.gusts is not None:
            self.gusts.derivatives(x, GUST, noise, dx, xp)
        for derivatives in self._state_hooks:
            derivatives(m, x, dx)
        return m

    def step(self, t: float, x: State, commands: Commands, noise: State, h: float) -> State:
        """The state `h` seconds later, commands and gust noise held: classical fourth-order Runge-Kutta."""
        xp = self.xp
        k1, k2, k3, k4 = (xp.new_state(self.size) for _ in range(4))
        self.evaluate(t, x, commands, noise, k1)
        self.evaluate(t + 0.5 * h, xp.advance(x, 0.5 * h, k1), commands, noise, k2)
        self.evaluate(t + 0.5 * h, xp.advance(x, 0.5 * h, k2), commands, noise, k3)
        self.evaluate(t + h, xp.advance(x, h, k3), commands, noise, k4)
        w = h / 6.0
        if xp.flights is None:
            new = [a + w * (b + 2.0 * (c + d) + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)]
        else:
            new = x + w * (k1 + 2.0 * (k2 + k3) + k4)
        e0, e1, e2, e3 = new[ATTITUDE], new[ATTITUDE + 1], new[ATTITUDE + 2], new[ATTITUDE + 3]
        scale = 1.0 / xp.sqrt(e0 * e0 + e1 * e1 + e2 * e2 + e3 * e3)
        for i in range(ATTITUDE, ATTITUDE + 4):
            new[i] = new[i] * scale
        return new

    @staticmethod
    def _unpack(m: Motion, x: State) -> None:
        m.u, m.v, m.w, m.p, m.q, m.r = x[0], x[1], x[2], x[3], x[4], x[5]
        e0, e1, e2, e3 = x[6], x[7], x[8], x[9]
        m.e0, m.e1, m.e2, m.e3 = e0, e1, e2, e3
        m.north, m.east, m.down = x[10], x[11], x[12]
        e00, e11, e22, e33 = e0 * e0, e1 * e1, e2 * e2, e3 * e3
        m.c11 = e00 + e11 - e22 - e33
        m.c12 = 2.0 * (e1 * e2 + e0 * e3)
        m.c13 = 2.0 * (e1 * e3 - e0 * e2)
        m.c21 = 2.0 * (e1 * e2 - e0 * e3)
        m.c22 = e00 - e11 + e22 - e33
        m.c23 = 2.0 * (e2 * e3 + e0 * e1)
        m.c31 = 2.0 * (e1 * e3 + e0 * e2)
        m.c32 = 2.0 * (e2 * e3 - e0 * e1)
        m.c33 = e00 - e11 - e22 + e33

    def _air(self, m: Motion, x: State) -> None:
        air = air_at(self.site.elevation_m - m.down, self.site.temperature_offset_k)
        m.pressure, m.temperature, m.rho = air.pressure, air.temperature, air.density
        m.wind_north, m.wind_east, m.wind_down = self.wind_ned
        if self.gusts is None:
            m.gust_u = m.gust_v = m.gust_w = m.gust_p = 0.0
        else:
            m.gust_u, m.gust_v, m.gust_w, m.gust_p = x[GUST], x[GUST + 1], x[GUST + 3], x[GUST + 5]

    def _flow(self, m: Motion) -> None:
        xp, craft = self.xp, self.aircraft
        wn, we, wd = m.wind_north, m.wind_east, m.wind_down
        m.ua = m.u - (m.c11 * wn + m.c12 * we + m.c13 * wd) - m.gust_u
        m.va = m.v - (m.c21 * wn + m.c22 * we + m.c23 * wd) - m.gust_v
        m.wa = m.w - (m.c31 * wn + m.c32 * we + m.c33 * wd) - m.gust_w
        m.V = xp.sqrt(m.ua * m.ua + m.va * m.va + m.wa * m.wa + 1e-12)
        m.alpha = xp.atan2(m.wa, m.ua)
        m.beta = xp.asin(m.va / m.V)
        m.qbar = 0.5 * m.rho * m.V * m.V
        half_span, half_chord = 0.5 * craft.span / m.V, 0.5 * craft.chord / m.V
        m.p_hat = (m.p - m.gust_p) * half_span
        m.q_hat = m.q * half_chord
        m.r_hat = m.r * half_span

    @staticmethod
    def _surfaces(m: Motion, x: State) -> None:
        m.arm_left, m.arm_right, m.arm_r = x[ARMS], x[ARMS + 1], x[ARMS + 2]
        m.surface_left, m.surface_right, m.surface_r = m.arm_left, m.arm_right, m.arm_r
        m.thrust = x[THRUST]

    def _forces(self, m: Motion) -> None:
        force = m.qbar * self.aircraft.area
        ca, sa = self.xp.cos(m.alpha), self.xp.sin(m.alpha)
        m.X = force * (m.CL * sa - m.CD * ca) + m.thrust
        m.Y = force * m.CY
        m.Z = -force * (m.CL * ca + m.CD * sa)

    def _translation(self, m: Motion, dx: State) -> None:
        m.ax, m.ay, m.az = m.X / self.mass, m.Y / self.mass, m.Z / self.mass
        gx, gy, gz = GRAVITY * m.c13, GRAVITY * m.c23, GRAVITY * m.c33
        m.u_dot = dx[0] = m.ax + gx + m.r * m.v - m.q * m.w
        m.v_dot = dx[1] = m.ay + gy + m.p * m.w - m.r * m.u
        m.w_dot = dx[2] = m.az + gz + m.q * m.u - m.p * m.v
        # Rate of sideslip of the steady part of the air: a gust passing by is not counted.
        ua_dot = m.ax + gx + m.r * m.va - m.q * m.wa
        va_dot = m.ay + gy + m.p * m.wa - m.r * m.ua
        wa_dot = m.az + gz + m.q * m.ua - m.p * m.va
        plane = m.ua * m.ua + m.wa * m.wa + 1e-12
        m.beta_dot = (va_dot * plane - m.va * (m.ua * ua_dot + m.wa * wa_dot)) / (m.V * m.V * self.xp.sqrt(plane))
        dx[POSITION] = m.c11 * m.u + m.c21 * m.v + m.c31 * m.w
        dx[POSITION + 1] = m.c12 * m.u + m.c22 * m.v + m.c32 * m.w
        dx[POSITION + 2] = m.c13 * m.u + m.c23 * m.v + m.c33 * m.w

    def _moments(self, m: Motion) -> None:
        craft = self.aircraft
        force = m.qbar * craft.area
        m.L = force * craft.span * m.Cl
        m.M = force * craft.chord * m.Cm
        m.N = force * craft.span * m.Cn

    def _rotation(self, m: Motion, dx: State) -> None:
        Ixx, Iyy, Izz, Ixz = self.Ixx, self.Iyy, self.Izz, self.Ixz
        p, q, r = m.p, m.q, m.r
        roll = m.L + Ixz * p * q - (Izz - Iyy) * q * r
        yaw = m.N - Ixz * q * r - (Iyy - Ixx) * p * q
        determinant = Ixx * Izz - Ixz * Ixz
        m.p_dot = dx[3] = (Izz * roll + Ixz * yaw) / determinant
        m.q_dot = dx[4] = (m.M - (Ixx - Izz) * p * r - Ixz * (p * p - r * r)) / Iyy
        m.r_dot = dx[5] = (Ixx * yaw + Ixz * roll) / determinant
        e0, e1, e2, e3 = m.e0, m.e1, m.e2, m.e3
        dx[6] = 0.5 * (-e1 * p - e2 * q - e3 * r)
        dx[7] = 0.5 * (e0 * p + e2 * r - e3 * q)
        dx[8] = 0.5 * (e0 * q + e3 * p - e1 * r)
        dx[9] = 0.5 * (e0 * r + e1 * q - e2 * p)

    def _actuators(self, m: Motion, x: State, commands: Commands, dx: State) -> None:
        clip, lag, rate = self.xp.clip, self.servos.lag, self.servos.rate
        for i, target in enumerate((commands.left, commands.right, commands.rudder)):
            dx[ARMS + i] = clip((target - x[ARMS + i]) / lag, -rate, rate)
        dx[THRUST] = (commands.throttle * self.thrust_available(m.V) - x[THRUST]) / self.engine.lag

    def thrust_available(self, airspeed: Value) -> Value:
        """Thrust [N] at full throttle."""
        return self.engine.static_thrust - self.engine.thrust_fall * airspeed
