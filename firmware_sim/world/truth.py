"""The truth of one instant, for the instruments to look at, and as flight columns for studies."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from firmware_sim.physics.atmosphere import Site, geodetic, pressure_altitude
from firmware_sim.physics.effects.base import Sensed
from firmware_sim.physics.motion import Motion
from firmware_sim.physics.plant import Commands

Triple = tuple[Any, Any, Any]

PULSE_CENTRE_US = 1500.0
PULSE_PER_RAD_US = 500.0 / math.radians(25.0)  # +-25 deg make 1000..2000 us
THROTTLE_PULSE_US = (1000.0, 1000.0)  # idle, and span to full

# Flight columns that `Truth.columns` delivers, in the order of the file.
TRUTH_COLUMNS = tuple(
    (
        "time ax ay az p q r phi theta psi alpha beta V delta_e delta_a delta_r "
        "cmd_e cmd_a cmd_r throttle thrust rho p_static p_dynamic temperature latitude longitude "
        "altitude altitude_gnss vn ve vd mx my mz digital_1 supply_voltage "
        # beyond the flight columns: what studies of the truth want
        "p_dot q_dot r_dot surface_e surface_a surface_r"
    ).split()
)


@dataclass(frozen=True, slots=True)
class Truth:
    """Everything an instrument can look at, at one instant. SI, radians, body axes x forward, y right, z down.

    specific_force: at the CG [m/s2]. rates, rate_derivatives: p q r [rad/s] and their rates. velocity_ned: over the ground.
    latitude, longitude [deg], altitude: geometric, above the sea [m]. left_elevon, right_elevon (+ trailing edge down), rudder
    (+ trailing edge to port): servo arms, where the potentiometers sit. surface_*: what the air feels. pulses_us: six
    servo pulses: left elevon, right elevon, rudder, throttle, two spares. magnetic: body axes [T]. sensed: the CG
    quantities as hidden sensor effects bend them; equal to the truth without such effects. An instrument measures
    sensed quantities plus what its own place on the airframe adds.
    """

    time: float
    specific_force: Triple
    rates: Triple
    rate_derivatives: Triple
    phi: Any
    theta: Any
    psi: Any
    alpha: Any
    beta: Any
    V: Any
    wind_ned: Triple
    velocity_ned: Triple
    position_ned: Triple
    latitude: Any
    longitude: Any
    altitude: Any
    left_elevon: Any
    right_elevon: Any
    rudder: Any
    surface_e: Any
    surface_a: Any
    surface_r: Any
    cmd_left: Any
    cmd_right: Any
    cmd_rudder: Any
    throttle: Any
    thrust: Any
    p_static: Any
    p_dynamic: Any
    temperature: Any
    rho: Any
    magnetic: Triple
    digital: tuple[Any, Any, Any, Any, Any]
    supply_voltage: Any
    sensed: Sensed

    @property
    def pulses_us(self) -> tuple[Any, Any, Any, Any, Any, Any]:
        """Widths of the six servo pulses [us]."""
        idle, span = THROTTLE_PULSE_US
        return (
            PULSE_CENTRE_US + PULSE_PER_RAD_US * self.cmd_left,
            PULSE_CENTRE_US + PULSE_PER_RAD_US * self.cmd_right,
            PULSE_CENTRE_US + PULSE_PER_RAD_US * self.cmd_rudder,
            idle + span * self.throttle,
            PULSE_CENTRE_US,
            PULSE_CENTRE_US,
        )

    def columns(self) -> Mapping[str, Any]:
        """The flight columns of TRUTH_COLUMNS, without any sensor error."""
        ax, ay, az = self.specific_force
        p, q, r = self.rates
        p_dot, q_dot, r_dot = self.rate_derivatives
        vn, ve, vd = self.velocity_ned
        mx, my, mz = self.magnetic
        return {
            "time": self.time, "ax": ax, "ay": ay, "az": az, "p": p, "q": q, "r": r,
            "phi": self.phi, "theta": self.theta, "psi": self.psi, "alpha": self.alpha, "beta": self.beta, "V": self.V,
            "delta_e": 0.5 * (self.left_elevon + self.right_elevon),
            "delta_a": 0.5 * (self.right_elevon - self.left_elevon), "delta_r": self.rudder,
            "cmd_e": 0.5 * (self.cmd_left + self.cmd_right), "cmd_a": 0.5 * (self.cmd_right - self.cmd_left),
            "cmd_r": self.cmd_rudder, "throttle": self.throttle, "thrust": self.thrust, "rho": self.rho,
            "p_static": self.p_static, "p_dynamic": self.p_dynamic, "temperature": self.temperature,
            "latitude": self.latitude, "longitude": self.longitude, "altitude": pressure_altitude(self.p_static),
            "altitude_gnss": self.altitude, "vn": vn, "ve": ve, "vd": vd, "mx": mx, "my": my, "mz": mz,
            "digital_1": self.digital[0], "supply_voltage": self.supply_voltage,
            "p_dot": p_dot, "q_dot": q_dot, "r_dot": r_dot,
            "surface_e": self.surface_e, "surface_a": self.surface_a, "surface_r": self.surface_r,
        }  # fmt: skip


def supply_voltage(time: float, thrust: Any) -> Any:
    """A 3-cell battery [V]: slow discharge and sag with thrust; engineering estimate."""
    return 12.4 - 0.0005 * time - 0.09 * thrust


def truth_of(
    time: float, m: Motion, sensed: Sensed, commands: Commands, event: Any, site: Site, undisturbed: Any
) -> Truth:
    """Truth of free flight from the working quantities of the equations of motion.

    `undisturbed`: phi, theta, psi of the aircraft itself, before any sensor effect.
    """
    phi, theta, psi = undisturbed
    latitude, longitude = geodetic(site, m.north, m.east)
    bn, be, bd = site.magnetic_ned_t
    return Truth(
        time=time,
        specific_force=(m.ax, m.ay, m.az),
        rates=(m.p, m.q, m.r),
        rate_derivatives=(m.p_dot, m.q_dot, m.r_dot),
        phi=phi,
        theta=theta,
        psi=psi,
        alpha=m.alpha,
        beta=m.beta,
        V=m.V,
        wind_ned=(m.wind_north, m.wind_east, m.wind_down),
        velocity_ned=(
            m.c11 * m.u + m.c21 * m.v + m.c31 * m.w,
            m.c12 * m.u + m.c22 * m.v + m.c32 * m.w,
            m.c13 * m.u + m.c23 * m.v + m.c33 * m.w,
        ),
        position_ned=(m.north, m.east, m.down),
        latitude=latitude,
        longitude=longitude,
        altitude=site.elevation_m - m.down,
        left_elevon=m.arm_left,
        right_elevon=m.arm_right,
        rudder=m.arm_r,
        surface_e=m.surface_e,
        surface_a=m.surface_a,
        surface_r=m.surface_r,
        cmd_left=commands.left,
        cmd_right=commands.right,
        cmd_rudder=commands.rudder,
        throttle=commands.throttle,
        thrust=m.thrust,
        p_static=m.pressure,
        p_dynamic=m.qbar,
        temperature=m.temperature,
        rho=m.rho,
        magnetic=(
            m.c11 * bn + m.c12 * be + m.c13 * bd,
            m.c21 * bn + m.c22 * be + m.c23 * bd,
            m.c31 * bn + m.c32 * be + m.c33 * bd,
        ),
        digital=(event, 0.0, 0.0, 0.0, 0.0),
        supply_voltage=supply_voltage(time, m.thrust),
        sensed=sensed,
    )
