"""Before and after free flight: still on the ground, and scripted ways between ground and air.

Launch and landing are paths, not dynamics: position follows a quintic with matching position and velocity and no
acceleration at either end, attitude and surfaces turn smoothly. Kinematics are consistent (specific force is the path's
acceleration less gravity), so a recording holds no jump, but nothing aerodynamic can be learned from these seconds.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.utilities.constants import GRAVITY
from firmware_sim.physics.atmosphere import Site, air_at, geodetic
from firmware_sim.physics.effects.base import Sensed
from firmware_sim.world.truth import Truth, supply_voltage

SITTING_PITCH = 0.10  # rad, nose up on its skid
SITTING_HEIGHT = 0.15  # m of the CG above the field
VANE_SPEED = 4.0  # m/s below which a vane no longer finds the wind

Triple = tuple[float, float, float]
Vector = NDArray[np.float64]


@dataclass(frozen=True)
class _Departure:
    """From rest to a point with a velocity in `duration` seconds: first along the field, then up.

    Along the field speed is gained over the first 60 %; height over the last 70 %. Quintics at rest in acceleration at
    both ends. In plain numbers: it is asked ten times for every look at an instrument.
    """

    end: Triple
    end_velocity: Triple
    duration: float

    def at(self, time: float) -> tuple[Triple, Triple, Triple]:
        """Position, velocity, acceleration; before zero at rest, after the end not used."""
        gain = 0.6 * self.duration
        rise = 0.7 * self.duration
        coasted = max(time - gain, 0.0)
        horizontal = []
        for end, end_velocity in zip(self.end[:2], self.end_velocity[:2], strict=True):
            run = end_velocity * 0.5 * gain
            start = end - end_velocity * (self.duration - gain) - run
            x, v, a = _quintic(start, start + run, end_velocity, gain, min(time, gain))
            horizontal.append((x + end_velocity * coasted, v, a))
        vertical = _quintic(-SITTING_HEIGHT, self.end[2], self.end_velocity[2], rise, time - (self.duration - rise))
        (xn, vn, an), (xe, ve, ae), (xd, vd, ad) = *horizontal, vertical
        return (xn, xe, xd), (vn, ve, vd), (an, ae, ad)


def _quintic(start: float, end: float, end_velocity: float, duration: float, time: float) -> tuple[float, float, float]:
    s = min(max(time / duration, 0.0), 1.0)
    v1, delta = end_velocity * duration, end - start
    a3, a4, a5 = 10.0 * delta - 4.0 * v1, -15.0 * delta + 7.0 * v1, 6.0 * delta - 3.0 * v1
    velocity = (3 * a3 * s**2 + 4 * a4 * s**3 + 5 * a5 * s**4) / duration
    acceleration = (6 * a3 * s + 12 * a4 * s**2 + 20 * a5 * s**3) / duration**2
    return start + a3 * s**3 + a4 * s**4 + a5 * s**5, velocity, acceleration


def _smooth(s: float) -> float:
    """Step from 0 to 1 over 0 < s < 1, smooth to the second derivative."""
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10 - 15 * s + 6 * s * s)


class ScriptedPath:
    """Ground to air (`launch`) or air to ground, joined to free flight at the truth `joint`."""

    def __init__(self, joint: Truth, duration: float, site: Site, *, launch: bool) -> None:
        self.joint, self.duration, self.site, self.launch = joint, duration, site, launch
        velocity = joint.velocity_ned if launch else _reversed(joint.velocity_ned)
        self._departure = _Departure(joint.position_ned, velocity, duration)

    def _path(self, since: float) -> tuple[Triple, Triple, Triple]:
        """Position, velocity, acceleration, NED; a landing is a departure seen backwards in time."""
        if self.launch:
            return self._departure.at(since)
        position, velocity, acceleration = self._departure.at(self.duration - since)
        return position, _reversed(velocity), acceleration

    def _share(self, since: float) -> float:
        """How far it is in the air: 0 on the ground, 1 at the joint."""
        share = _smooth(since / self.duration)
        return share if self.launch else 1.0 - share

    def _attitude(self, since: float) -> tuple[float, float]:
        """Bank and pitch: on the ground the sitting pitch, soon the path angle plus the joint's angle of attack."""
        velocity = self._path(since)[1]
        forward = float(np.hypot(velocity[0], velocity[1]))
        climb_angle = math.atan2(-velocity[2], forward + 1.0)
        vn, ve, vd = self.joint.velocity_ned
        level = self.joint.theta - math.atan2(-vd, math.hypot(vn, ve) + 1.0)
        share = self._share(since)
        lift = _smooth(2.5 * share)
        return share * self.joint.phi, (1.0 - lift) * SITTING_PITCH + lift * (climb_angle + level)

    def _turning(self, since: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Body rates and their rates, heading held, by central differences of the attitude."""
        d = 2e-3
        (phi_0, theta_0), (phi_1, theta_1), (phi_2, theta_2) = (self._attitude(since + k * d) for k in (-1, 0, 1))
        phi_dot, theta_dot = (phi_2 - phi_0) / (2 * d), (theta_2 - theta_0) / (2 * d)
        phi_ddot, theta_ddot = (phi_2 - 2 * phi_1 + phi_0) / d**2, (theta_2 - 2 * theta_1 + theta_0) / d**2
        sin_phi, cos_phi = math.sin(phi_1), math.cos(phi_1)
        rates = (phi_dot, theta_dot * cos_phi, -theta_dot * sin_phi)
        return rates, (
            phi_ddot,
            theta_ddot * cos_phi - theta_dot * phi_dot * sin_phi,
            -theta_ddot * sin_phi - theta_dot * phi_dot * cos_phi,
        )

    def at(self, since: float, time: float) -> Truth:
        """Truth `since` seconds into the path (before or after it: still on the ground), stamped `time`."""
        underway = 0.0 < since < self.duration
        position, velocity, acceleration = self._path(since)
        joint = self.joint
        share = self._share(since)
        phi, theta = self._attitude(since)
        turn = direction_cosines(phi, theta, joint.psi)
        force = turn @ np.array([acceleration[0], acceleration[1], acceleration[2] - GRAVITY])
        rates, rate_derivatives = self._turning(since)
        air = turn @ (np.array(velocity) - np.array(joint.wind_ned))
        speed = float(np.linalg.norm(air))
        hold = speed**4 / (speed**4 + VANE_SPEED**4)
        alpha = hold * math.atan2(air[2], max(air[0], 1.0))
        beta = hold * math.asin(air[1] / max(speed, 1e-9))
        state = air_at(self.site.elevation_m - position[2], self.site.temperature_offset_k)
        latitude, longitude = geodetic(self.site, position[0], position[1])
        thrust = share * joint.thrust
        left, right, rudder = share * joint.left_elevon, share * joint.right_elevon, share * joint.rudder
        force_x, force_y, force_z = _triple(force)
        p, q, r = rates
        sensed = Sensed(
            force_x, force_y, force_z, p, q, r, phi, theta, joint.psi, alpha, beta, speed, left, right, rudder
        )
        return replace(
            joint,
            time=time,
            specific_force=(force_x, force_y, force_z),
            rates=rates,
            rate_derivatives=rate_derivatives,
            phi=phi,
            theta=theta,
            alpha=alpha,
            beta=beta,
            V=speed,
            velocity_ned=velocity,
            position_ned=position,
            latitude=latitude,
            longitude=longitude,
            altitude=self.site.elevation_m - position[2],
            left_elevon=left,
            right_elevon=right,
            rudder=rudder,
            surface_e=0.5 * (left + right),
            surface_a=0.5 * (right - left),
            surface_r=rudder,
            cmd_left=share * joint.cmd_left,
            cmd_right=share * joint.cmd_right,
            cmd_rudder=share * joint.cmd_rudder,
            throttle=share * joint.throttle,
            thrust=thrust,
            p_static=float(state.pressure),
            p_dynamic=0.5 * float(state.density) * speed**2,
            temperature=float(state.temperature),
            rho=float(state.density),
            magnetic=_triple(turn @ np.array(self.site.magnetic_ned_t)),
            digital=(0.0, 0.0 if underway else 1.0, 0.0, 0.0, 0.0),
            supply_voltage=supply_voltage(time, thrust),
            sensed=sensed,
        )


def _reversed(vector: Triple) -> Triple:
    x, y, z = vector
    return -x, -y, -z


def _triple(vector: Vector) -> Triple:
    x, y, z = (float(component) for component in vector)
    return x, y, z


def direction_cosines(phi: float, theta: float, psi: float) -> Vector:
    """Matrix (3, 3) that turns NED components into body components."""
    sp, cp = math.sin(phi), math.cos(phi)
    st, ct = math.sin(theta), math.cos(theta)
    ss, cs = math.sin(psi), math.cos(psi)
    return np.array(
        [
            [ct * cs, ct * ss, -st],
            [sp * st * cs - cp * ss, sp * st * ss + cp * cs, sp * ct],
            [cp * st * cs + sp * ss, cp * st * ss - sp * cs, cp * ct],
        ]
    )
