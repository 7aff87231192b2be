"""Hidden effects that take hold in one place: a row each, with what it adds or shows there.

A row is name, title, group, unit, size at scale 1, the physics, and the hook. Angles in rad, rates non-dimensional; sizes are
engineering estimates for this aircraft at 17 m/s. All lift pays for itself: what a row adds to CL adds its induced drag.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from daq.utilities.constants import GRAVITY
from firmware_sim.physics.effects.base import HiddenEffect, Host, Sensed
from firmware_sim.physics.maths import State, Value

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion

Hook = tuple[str, Callable[..., None]]
Amount = Callable[[Any, "Motion"], Value]
REFERENCE_ALPHA = 0.086  # rad, level flight at 17 m/s: angles of attack count from here
REFERENCE_PRESSURE = 200.0  # Pa, dynamic: at it a surface that gives way has its nominal effect
DISC_AREA = 0.0507  # m2 of a 10 inch propeller


def adds(hook: str, **amounts: Amount) -> Hook:
    """Adds to quantities of the motion in one hook, all worked out before any is changed."""

    def act(effect: HiddenEffect, m: "Motion", x: State) -> None:
        additions = {quantity: amount(effect, m) for quantity, amount in amounts.items()}
        if "CL" in additions:
            m.CD = m.CD + effect.plant.derivatives["CD_k"] * additions["CL"] * (2.0 * m.CL + additions["CL"])
        for quantity, value in additions.items():
            setattr(m, quantity, getattr(m, quantity) + value)

    return hook, act


def coefficients(**amounts: Amount) -> Hook:
    """Adds to aerodynamic coefficients."""
    return adds("coefficients", **amounts)


def moments(**amounts: Amount) -> Hook:
    """Adds to the moments L M N [N m] about the CG."""
    return adds("moments", **amounts)


def shows(**values: Callable[[Any, Sensed, "Motion"], Value]) -> Hook:
    """What instruments are shown instead, all worked out before any is changed."""

    def act(effect: HiddenEffect, s: Sensed, m: "Motion", x: State) -> None:
        readings = {channel: value(effect, s, m) for channel, value in values.items()}
        for channel, value in readings.items():
            setattr(s, channel, value)

    return "sense", act


def properties(**values: Callable[[Any, Host], Value]) -> Hook:
    """What the plant weighs instead of what its file says."""

    def act(effect: HiddenEffect, plant: Host) -> None:
        HiddenEffect.bind(effect, plant)
        for name, value in values.items():
            setattr(plant, name, value(effect, plant))

    return "bind", act


def row(name: str, title: str, group: str, unit: str, typical: float, physics: str, *hooks: Hook) -> type[HiddenEffect]:
    """One effect of the table."""
    attributes = {"name": name, "title": title, "group": group, "unit": unit, "typical": typical, "__doc__": physics}
    return type(name, (HiddenEffect,), {**attributes, **dict(hooks), "catalogued": group != UNLISTED})


def _over(m: "Motion") -> Value:
    return m.alpha - REFERENCE_ALPHA


def _cube(value: Value) -> Value:
    return value * value * value


def _slipstream(e: HiddenEffect, m: "Motion", angle: Value) -> Value:
    """Share of the rise T/A of dynamic pressure in the slipstream (momentum theory), times an angle."""
    return e.size * m.thrust / (m.qbar * DISC_AREA) * angle


def alpha_rate(m: "Motion", ax: Value, az: Value) -> Value:
    """Rate of angle of attack in still air for specific forces ax, az [m/s2]; a gust passing by is not counted."""
    ua_dot = ax + GRAVITY * m.c13 + m.r * m.va - m.q * m.wa
    wa_dot = az + GRAVITY * m.c33 + m.q * m.ua - m.p * m.va
    return (m.ua * wa_dot - m.wa * ua_dot) / (m.ua * m.ua + m.wa * m.wa)


def _near_ground(e: HiddenEffect, m: "Motion") -> Value:
    ratio = 16.0 * m.down / e.plant.aircraft.span
    return e.size * (-e.plant.derivatives["CD_k"] * m.CL * m.CL / (1.0 + ratio * ratio))


def _by_alpha_rate(e: HiddenEffect, m: "Motion") -> Value:
    craft = e.plant.aircraft
    return m.qbar * craft.area * craft.chord * e.size * alpha_rate(m, m.ax, m.az) * 0.5 * craft.chord / m.V


def _by_beta_rate(e: HiddenEffect, m: "Motion") -> Value:
    craft = e.plant.aircraft
    return m.qbar * craft.area * craft.span * e.size * m.beta_dot * (0.5 * craft.span / m.V)


OMITTED, NONLINEAR, UNSTEADY, INERTIAL = (
    "omitted derivatives",
    "aerodynamic nonlinearity",
    "unsteady",
    "kinematic, inertial",
)
ABSORBED, PROPULSION, SENSOR, PITCH = "exactly absorbed", "propulsion", "sensor", "longitudinal"
ACROSS, UNLISTED = "across axes", "uncatalogued"

# fmt: off
ROWS = (
    row("Cn_da", "adverse yaw from aileron", OMITTED, "1/rad", -0.010,
        "The down-going elevon drags more: yaw towards the rising wing.",
        coefficients(Cn=lambda e, m: e.size * m.surface_a)),
    row("CY_da", "side force from aileron", OMITTED, "1/rad", 0.04,
        "Elevon pressure acts on the fin: side force with aileron.",
        coefficients(CY=lambda e, m: e.size * m.surface_a)),
    row("CY_p_r", "side force from roll and yaw rate", OMITTED, "1/rad", 0.08,
        "More side force from rolling and yawing than the aircraft's own derivatives: `size` in CY_r, minus half in CY_p.",
        coefficients(CY=lambda e, m: e.size * (m.r_hat - 0.5 * m.p_hat))),
    row("Cl_alpha_beta", "dihedral effect changes with angle of attack", OMITTED, "1/rad2", -0.75,
        "Leading-edge sweep: rolling moment due to sideslip grows with angle of attack.",
        coefficients(Cl=lambda e, m: e.size * _over(m) * m.beta)),
    row("Cn_alpha_beta", "directional stability changes with angle of attack", OMITTED, "1/rad2", -0.15,
        "The fin meets the wing's wake: directional stability changes with angle of attack.",
        coefficients(Cn=lambda e, m: e.size * _over(m) * m.beta)),
    row("Cl_da_de", "aileron effectiveness changes with elevator", OMITTED, "1/rad2", 0.30,
        "Elevons already deflected for pitch have less left to give in roll: Cl_da changes with elevator.",
        coefficients(Cl=lambda e, m: e.size * m.surface_a * m.surface_e)),
    row("Cl_beta3", "rolling moment cubic in sideslip", NONLINEAR, "1/rad3", 0.5,
        "Vortices over a cropped delta: rolling moment bends away from its line beyond some five degrees of sideslip.",
        coefficients(Cl=lambda e, m: e.size * m.beta * m.beta * m.beta)),
    row("Cn_beta3", "yawing moment cubic in sideslip", NONLINEAR, "1/rad3", 0.25,
        "Directional stability changes with the amplitude of sideslip.",
        coefficients(Cn=lambda e, m: e.size * m.beta * m.beta * m.beta)),
    row("CY_beta3", "side force cubic in sideslip", NONLINEAR, "1/rad3", -1.5,
        "Cross-flow drag of body and fin.",
        coefficients(CY=lambda e, m: e.size * m.beta * m.beta * m.beta)),
    row("Cl_da3", "aileron loses effectiveness at large angles", NONLINEAR, "1/rad2", 2.6,
        "Flow separates from the hinge: effectiveness lost in proportion to deflection squared; 18 % at 15 degrees.",
        coefficients(Cl=lambda e, m: -e.plant.derivatives["Cl_da"] * e.size * m.surface_a * m.surface_a * m.surface_a)),
    row("Cn_dr3", "fin stalls: yawing moment cubic in rudder", NONLINEAR, "1/rad2", 4.5,
        "The all-moving fin nears its stall: yawing moment lost with the cube of its local angle; 20 % at 12 degrees.",
        coefficients(Cn=lambda e, m: -e.plant.derivatives["Cn_dr"] * e.size * m.surface_r * m.surface_r * m.surface_r)),
    row("Cl_p_abs_p", "roll damping grows with roll rate", NONLINEAR, "1", 1.43,
        "Tips approach stall in fast rolls: damping that grows with rate; 10 % at p b / 2V = 0.07.",
        coefficients(Cl=lambda e, m: e.plant.derivatives["Cl_p"] * e.size * m.p_hat * e.xp.sign(m.p_hat) * m.p_hat)),

    row("Cl_betadot", "rolling moment from rate of sideslip", UNSTEADY, "1/rad", 0.10,
        "Lift of the two halves follows a change of sideslip late: rolling moment with beta_dot.", moments(L=_by_beta_rate)),
    row("Cn_betadot", "yawing moment from rate of sideslip", UNSTEADY, "1/rad", 0.03,
        "Sidewash reaches the fin late: yawing moment with beta_dot.", moments(N=_by_beta_rate)),

    row("Ixz_error", "product of inertia wrong", INERTIAL, "kg m2", 0.015,
        "The product of inertia is larger than the aircraft file says.",
        properties(Ixz=lambda e, plant: plant.Ixz + e.size)),
    row("lateral_cg", "CG off the plane of symmetry", INERTIAL, "m", 0.008,
        "The CG sits to the right of the plane of symmetry: lift acts left of it. Force at y = -size: L = y Z, N = -y X.",
        moments(L=lambda e, m: -e.size * m.Z, N=lambda e, m: e.size * m.X)),
    row("Ixx_scale", "roll inertia wrong by a factor", ABSORBED, "1", 0.10,
        "Roll inertia larger than the file says, by a fraction: tied to every rolling derivative.",
        properties(Ixx=lambda e, plant: plant.Ixx * (1.0 + e.size))),
    row("mass_scale", "mass wrong by a factor", ABSORBED, "1", 0.08,
        "Mass larger than the file says, by a fraction: tied to every force derivative.",
        properties(mass=lambda e, plant: plant.mass * (1.0 + e.size))),

    row("motor_torque", "motor torque rolls the aircraft", PROPULSION, "m", 0.03,
        "The propeller's drag torque turns the aircraft the other way, in proportion to thrust; `size` in N m per N.",
        moments(L=lambda e, m: -e.size * m.thrust)),
    row("slipstream_rudder", "slipstream over the fin", PROPULSION, "1", 0.5,
        "The fin stands in the slipstream: its effectiveness grows with thrust. `size` of the rise reaches the fin.",
        coefficients(CY=lambda e, m: e.plant.derivatives["CY_dr"] * _slipstream(e, m, m.surface_r),
                     Cl=lambda e, m: e.plant.derivatives["Cl_dr"] * _slipstream(e, m, m.surface_r),
                     Cn=lambda e, m: e.plant.derivatives["Cn_dr"] * _slipstream(e, m, m.surface_r))),
    row("p_factor", "thrust moves off its axis with angle of attack", PROPULSION, "m/rad", 0.25,
        "The down-going blade pulls harder at an angle of attack: thrust acts off the axis, `size` m per rad.",
        moments(N=lambda e, m: -e.size * m.thrust * m.alpha, M=lambda e, m: -e.size * m.thrust * m.beta)),

    row("CL_alpha2", "lift bends with angle of attack", PITCH, "1/rad2", -4.0,
        "Lift bends away from its line: vortex lift or early separation.",
        coefficients(CL=lambda e, m: e.size * _over(m) ** 2)),
    row("CL_alpha3", "lift cubic in angle of attack", PITCH, "1/rad3", -15.0,
        "Lift slope grows or falls on both sides of trim.", coefficients(CL=lambda e, m: e.size * _over(m) ** 3)),
    row("Cm_alpha2", "pitch-up", PITCH, "1/rad2", -0.4,
        "Static stability changes with angle of attack.", coefficients(Cm=lambda e, m: e.size * _over(m) ** 2)),
    row("Cm_alpha3", "pitching moment cubic in angle of attack", PITCH, "1/rad3", 2.0,
        "Static stability changes on both sides of trim.", coefficients(Cm=lambda e, m: e.size * _over(m) ** 3)),
    row("CL_de3", "elevator loses lift at large angles", PITCH, "1/rad3", -3.0,
        "Flow leaves the strongly deflected trailing edge: lift is lost.",
        coefficients(CL=lambda e, m: e.size * _cube(m.surface_e))),
    row("Cm_de3", "elevator loses effectiveness at large angles", PITCH, "1/rad3", 1.0,
        "Flow leaves the strongly deflected trailing edge: moment is lost.",
        coefficients(Cm=lambda e, m: e.size * _cube(m.surface_e))),
    row("Cm_alpha_de", "elevator effectiveness changes with angle of attack", PITCH, "1/rad2", 0.8,
        "Thick flow over the trailing edge at high angle of attack takes effect from the elevator.",
        coefficients(Cm=lambda e, m: e.size * (_over(m) * m.surface_e))),
    row("CD_CL", "least drag away from zero lift", PITCH, "1", -0.03,
        "A cambered wing has its least drag at some lift.", coefficients(CD=lambda e, m: e.size * m.CL)),
    row("CD_alpha4", "drag rises steeply near the stall", PITCH, "1/rad4", 8.0,
        "Separation drags before lift breaks.", coefficients(CD=lambda e, m: e.size * (_cube(m.alpha) * m.alpha))),
    row("CD_de2", "drag of the elevator", PITCH, "1/rad2", 0.5,
        "Deflected trailing edges drag.", coefficients(CD=lambda e, m: e.size * (m.surface_e * m.surface_e))),
    row("CD_q", "drag from pitch rate", PITCH, "1/rad", 0.2,
        "Pitching turns lift backward.", coefficients(CD=lambda e, m: e.size * m.q_hat)),
    row("ground_effect", "less induced drag near the ground", PITCH, "1", 1.0,
        "The ground hinders the downwash: induced drag times s / (1 + s), s = (16 h / b)^2 (McCormick 1979).",
        coefficients(CD=_near_ground)),
    row("wing_compliance", "wing gives way with dynamic pressure", PITCH, "1", 0.15,
        "The wing twists under load: `size` of its lift slope is lost from 200 to 400 Pa.",
        coefficients(CL=lambda e, m: e.size * (
            -(m.qbar / REFERENCE_PRESSURE - 1.0) * e.plant.derivatives["CL_alpha"] * m.alpha))),
    row("propwash_CL", "slipstream over the wing", PITCH, "1", 0.1,
        "Part of the wing stands in the slipstream, whose dynamic pressure is raised by T / A: `size` of it counts.",
        coefficients(CL=lambda e, m: e.size * (
            m.thrust / (m.qbar * DISC_AREA) * e.plant.derivatives["CL_alpha"] * m.alpha))),
    row("propwash_elevator", "slipstream over the elevator", PITCH, "1", 0.3,
        "The elevator stands in the slipstream: `size` of the rise of its dynamic pressure counts.",
        coefficients(CL=lambda e, m: e.plant.derivatives["CL_de"] * _slipstream(e, m, m.surface_e),
                     Cm=lambda e, m: e.plant.derivatives["Cm_de"] * _slipstream(e, m, m.surface_e))),
    row("Cm_alphadot", "pitching moment from rate of angle of attack", PITCH, "1/rad", -0.4,
        "Downwash and vortices come late: pitching moment with the rate of angle of attack.", moments(M=_by_alpha_rate)),
    row("thrust_z", "thrust line below the CG", PITCH, "m", 0.02,
        "The thrust line passes `size` m below the CG: thrust pitches the nose up.",
        moments(M=lambda e, m: e.size * m.thrust)),
    row("thrust_tilt", "thrust line tilted up", PITCH, "rad", 0.052,
        "The shaft points up by `size` rad through the CG.",
        adds("forces", X=lambda e, m: m.thrust * (e.xp.cos(e.size) - 1.0), Z=lambda e, m: -m.thrust * e.xp.sin(e.size))),
    row("thrust_scale", "thrust wrong by a factor", PITCH, "1", 0.08,
        "The propeller pulls more by a fraction than its bench curve, which is recorded.",
        adds("forces", X=lambda e, m: e.size * m.thrust)),

    row("Cm_beta2", "pitching moment from sideslip", ACROSS, "1/rad2", 0.3,
        "Slipping either way pitches the nose.", coefficients(Cm=lambda e, m: e.size * m.beta * m.beta)),
    row("CL_beta2", "lift lost in sideslip", ACROSS, "1/rad2", -1.0,
        "Slipping either way costs lift.", coefficients(CL=lambda e, m: e.size * m.beta * m.beta)),
    row("CD_beta2", "drag of sideslip", ACROSS, "1/rad2", 0.4,
        "Slipping either way drags.", coefficients(CD=lambda e, m: e.size * m.beta * m.beta)),
    row("CL_da2", "lift from aileron", ACROSS, "1/rad2", 0.3,
        "One elevon up and one down do not cancel in lift.",
        coefficients(CL=lambda e, m: e.size * m.surface_a * m.surface_a)),
    row("CD_da2", "drag of the ailerons", ACROSS, "1/rad2", 0.3,
        "One elevon up and one down drag.", coefficients(CD=lambda e, m: e.size * m.surface_a * m.surface_a)),
    row("Cm_da2", "pitching moment from aileron", ACROSS, "1/rad2", 0.3,
        "One elevon up and one down do not cancel in pitching moment.",
        coefficients(Cm=lambda e, m: e.size * m.surface_a * m.surface_a)),
    row("Cl_alpha_da", "aileron effectiveness with angle of attack", ACROSS, "1/rad2", 0.2,
        "Ailerons lose effect as the flow thickens.", coefficients(Cl=lambda e, m: e.size * _over(m) * m.surface_a)),
    row("Cn_alpha_da", "adverse yaw with angle of attack", ACROSS, "1/rad2", 0.1,
        "Adverse yaw grows with lift.", coefficients(Cn=lambda e, m: e.size * _over(m) * m.surface_a)),
    row("Cn_alpha_dr", "rudder effectiveness with angle of attack", ACROSS, "1/rad2", 0.2,
        "The rudder meets the wing's wake.", coefficients(Cn=lambda e, m: e.size * _over(m) * m.surface_r)),
    row("Cl_alpha_p", "roll damping with angle of attack", ACROSS, "1/rad2", 1.0,
        "Roll damping follows the slope of lift.", coefficients(Cl=lambda e, m: e.size * _over(m) * m.p_hat)),
    row("Cn_alpha_p", "yaw from roll with angle of attack", ACROSS, "1/rad2", 0.3,
        "Yaw from rolling goes with lift.", coefficients(Cn=lambda e, m: e.size * _over(m) * m.p_hat)),

    row("beta_scale", "sideslip vane scale", SENSOR, "1", 0.08,
        "The sideslip vane reads too much by a fraction, the linkage's or the sidewash's.",
        shows(beta=lambda e, s, m: s.beta * (1.0 + e.size))),
    row("beta_bias", "sideslip vane bias", ABSORBED, "rad", 0.006,
        "The sideslip vane is turned on its mount.", shows(beta=lambda e, s, m: s.beta + e.size)),
    row("vane_position", "vanes ahead of their place", SENSOR, "m", 0.35,
        "The vanes stand `size` m ahead of where they are believed to be: yaw and pitch rates add to the local flow.",
        shows(beta=lambda e, s, m: s.beta + e.size * m.r / m.V, alpha=lambda e, s, m: s.alpha - e.size * m.q / m.V)),
    row("imu_lever_arm", "accelerometer away from the CG", SENSOR, "m", 0.08,
        "The accelerometer sits `size` m below the CG (+z), uncorrected: it feels rolling and pitching accelerations.",
        shows(ax=lambda e, s, m: s.ax + (m.p * m.r + m.q_dot) * e.size,
              ay=lambda e, s, m: s.ay + (m.q * m.r - m.p_dot) * e.size,
              az=lambda e, s, m: s.az - (m.p * m.p + m.q * m.q) * e.size)),
    row("gyro_misalignment", "gyro turned in its mount", SENSOR, "rad", 0.03,
        "The gyro is turned about the pitch axis by `size` rad: it mixes roll and yaw rate.",
        shows(p=lambda e, s, m: e.xp.cos(e.size) * s.p - e.xp.sin(e.size) * s.r,
              r=lambda e, s, m: e.xp.cos(e.size) * s.r + e.xp.sin(e.size) * s.p)),
    row("gyro_scale", "roll gyro scale", SENSOR, "1", 0.03,
        "The roll gyro reads too much by a fraction.", shows(p=lambda e, s, m: s.p * (1.0 + e.size))),
    row("airspeed_scale", "airspeed scale", SENSOR, "1", 0.05,
        "The pitot tube stands in disturbed air: speed too high by a fraction.",
        shows(V=lambda e, s, m: s.V * (1.0 + e.size))),
    row("alpha_scale", "angle-of-attack vane scale", SENSOR, "1", 0.1,
        "Upwash turns the air before the vane meets it: angle of attack too large by a fraction.",
        shows(alpha=lambda e, s, m: s.alpha * (1.0 + e.size))),
    row("alpha_bias", "angle-of-attack vane bias", SENSOR, "rad", 0.0087,
        "The angle-of-attack vane is turned on its mount.", shows(alpha=lambda e, s, m: s.alpha + e.size)),
    row("alpha_position", "angle-of-attack vane ahead of its place", SENSOR, "m", 0.4,
        "The angle-of-attack vane stands `size` m ahead of where it is believed to be: it sees the wind of pitching.",
        shows(alpha=lambda e, s, m: s.alpha - e.size * m.q / m.V)),
    row("V_scale", "airspeed scale", SENSOR, "1", 0.03,
        "Airspeed too high by a fraction, in a model that flies it.", shows(V=lambda e, s, m: s.V * (1.0 + e.size))),
    row("V_alpha", "airspeed error grows with angle of attack", SENSOR, "1/rad", 0.3,
        "The static port's error grows with angle of attack.", shows(V=lambda e, s, m: s.V * (1.0 + e.size * _over(m)))),
    row("imu_x", "accelerometer ahead of the CG", SENSOR, "m", 0.08,
        "The accelerometer sits `size` m ahead of the CG, uncorrected.",
        shows(ax=lambda e, s, m: s.ax - (m.q * m.q + m.r * m.r) * e.size,
              ay=lambda e, s, m: s.ay + (m.r_dot + m.p * m.q) * e.size,
              az=lambda e, s, m: s.az + (m.r * m.p - m.q_dot) * e.size)),
    row("imu_z", "accelerometer below the CG", SENSOR, "m", 0.08,
        "The accelerometer sits `size` m below the CG, uncorrected in the plane of symmetry.",
        shows(ax=lambda e, s, m: s.ax + (m.p * m.r + m.q_dot) * e.size,
              az=lambda e, s, m: s.az - (m.p * m.p + m.q * m.q) * e.size)),
    row("imu_tilt", "accelerometer turned about the pitch axis", SENSOR, "rad", 0.0175,
        "The accelerometer's board points up by `size` rad.",
        shows(ax=lambda e, s, m: e.xp.cos(e.size) * s.ax - e.xp.sin(e.size) * s.az,
              az=lambda e, s, m: e.xp.cos(e.size) * s.az + e.xp.sin(e.size) * s.ax)),
    row("q_scale", "pitch gyro scale", SENSOR, "1", 0.03,
        "The pitch gyro reads too much by a fraction.", shows(q=lambda e, s, m: s.q * (1.0 + e.size))),

    row("gyro_clipping", "gyro cut off at its range", UNLISTED, "rad/s", 0.22,
        "The gyro's range is set too small: rates beyond `size` rad/s are cut off (a smaller size cuts more).",
        shows(p=lambda e, s, m: e.xp.clip(s.p, -e.size, e.size), q=lambda e, s, m: e.xp.clip(s.q, -e.size, e.size),
              r=lambda e, s, m: e.xp.clip(s.r, -e.size, e.size))),
    row("bank_accelerometer", "lateral accelerometer depends on bank", UNLISTED, "1", 0.45,
        "The accelerometer's mount twists under load: lateral reading picks up an even function of bank and load.",
        shows(ay=lambda e, s, m: s.ay + e.size * GRAVITY * m.c23 * m.c23)),
)
# fmt: on
