"""Candidate effects of kinematics, inertia and propulsion."""

from estimation.gap.effects.aerodynamic import ALPHA
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.models.base import Signal

PITCH_RATE = Signal("q", "rad/s", "pitch rate")
PITCH = Signal("theta", "rad", "pitch attitude")
THRUST = Signal("thrust", "N", "thrust along x")
AX = Signal("ax", "m/s2", "specific force at the CG, x")
AZ = Signal("az", "m/s2", "specific force at the CG, z")


def _whole(name: str, meaning: str) -> EffectParameter:
    """A factor that is 1 where the effect is exactly the term of mechanics."""
    return EffectParameter(name, "1", 1.0, -2.0, 3.0, meaning=meaning)


INERTIAL = (
    Effect(
        "p_sin_alpha", "roll rate turning angle of attack into sideslip", Group.INERTIAL,
        "Rolling about the body axis at an angle of attack swings the nose sideways against the wind: β̇ contains "
        "p sin α. The simplified equations drop it.",
        "β̇ = ... + k p sin α, k = 1 by kinematics", "exact kinematics (any flight mechanics text)",
        "sideslip residual in step with roll rate, larger at low speed",
        {"CY_p_r": "no-aerodynamics (kinematic) reconstruction", "Cn_da": "bank-to-bank rolls at two angles of attack",
         "vane_position": "bank-to-bank rolls at two angles of attack"},
        "bank-to-bank rolls at two angles of attack",
        (Form("p_sin_alpha", (_whole("k_p_sin_alpha", "1 by kinematics"),), inputs=(ALPHA,),
              terms={"beta_dot": ("k_p_sin_alpha*p*sin(alpha)",)}, requires=("p", "beta_dot"),
              unless=(("beta_dot", "alpha"),)),),
    ),
    Effect(
        "roll_kinematics", "bank angle driven by yaw and pitch rate", Group.INERTIAL,
        "Euler's kinematics: φ̇ = p + tan θ (q sin φ + r cos φ). At 7° of pitch attitude an eighth of the yaw rate turns "
        "into bank.",
        "φ̇ = ... + k tan θ (q sin φ + r cos φ), k = 1 by kinematics", "exact kinematics",
        "bank residual like the integral of yaw rate times tan θ",
        {"gyro_misalignment": "compare at two pitch attitudes"},
        "sustained turns and flat yaws at two pitch attitudes",
        (Form("roll_kinematics", (_whole("k_roll_kinematics", "1 by kinematics"),), inputs=(PITCH, PITCH_RATE),
              terms={"phi_dot": ("k_roll_kinematics*tan(theta)*(q*sin(phi) + r*cos(phi))",)},
              requires=("phi_dot", "r", "phi"), unless=(("phi_dot", "theta"),)),),
    ),
    Effect(
        "inertial_coupling", "inertial coupling of the rates", Group.INERTIAL,
        "A body that is not a sphere: p q and q r drive yaw and roll through the differences of the moments of inertia.",
        "L = ... + k [I_xz p q − (I_zz − I_yy) q r]; N = ... − k [I_xz q r + (I_yy − I_xx) p q], k = 1 by mechanics",
        "Euler's equations of motion",
        "roll and yaw residuals like q r and p q: only where the pilot pitches and rolls together",
        {"Ixz_error": "steady turns both ways with a pull-up", "prop_gyroscopic": "power on against power off"},
        "pull-up in a turn, both ways",
        (Form("inertial_coupling", (_whole("k_inertial", "1 by mechanics"),), inputs=(PITCH_RATE,),
              terms={"p_dot": ("k_inertial*(Ixz*p*q - (Izz - Iyy)*q*r)/Ixx",),
                     "r_dot": ("-k_inertial*(Ixz*q*r + (Iyy - Ixx)*p*q)/Izz",)},
              requires=("Ixx", "Iyy", "Izz", "Ixz", "p", "r"), unless=(("p_dot", "q"),)),),
    ),
    Effect(
        "Ixz_error", "wrong product of inertia", Group.INERTIAL,
        "The principal axis is tilted against what the model assumes: roll acceleration leaks into yaw and back.",
        "I_xz → I_xz + ΔI_xz", "±0.005 to 0.03 kg m², engineering estimate; a swing test gives it",
        "yaw-rate residual like roll acceleration",
        {"Cn_da": "symmetric pull-up with aileron 3-2-1-1, or swing test of the aircraft"},
        "swing test, or symmetric pull-up with aileron 3-2-1-1",
        (Form("Ixz_error", (EffectParameter("Ixz", "kg m2", 0.02, -0.12, 0.12, none="Ixz", meaning="product of inertia"),),
              requires=("Ixz", "Ixx", "Izz", "r_dot")),),
    ),
    Effect(
        "lateral_cg", "centre of gravity to one side", Group.INERTIAL,
        "Lift no longer passes through the centre of gravity: a rolling moment that grows with load factor, and a yawing "
        "moment with thrust and drag.",
        "L = ... − y_cg m a_z; N = ... + y_cg m a_x", "5 mm is 0.17 N m, engineering estimate",
        "roll trim changes with load factor; constant part is hidden in C_l0",
        {"motor_torque": "idle against full throttle", "beta_bias": "load-factor variation"},
        "pull-ups and push-overs with level wings",
        (Form("lateral_cg", (EffectParameter("y_cg", "m", 0.010, -0.08, 0.08, meaning="to the right"),), inputs=(AX, AZ),
              terms={"Cl": ("-y_cg*m*az/(q_dyn*S*b)",), "Cn": ("y_cg*m*ax/(q_dyn*S*b)",)},
              requires=("m", "S", "b", "q_dyn", "Cl")),),
    ),
    Effect(
        "prop_gyroscopic", "gyroscopic moment of the propeller", Group.INERTIAL,
        "A spinning propeller answers pitch rate with yaw and yaw rate with pitch.",
        "N = ... + H q", "H of 0.1 to 0.2 kg m²/s for this propeller, engineering estimate",
        "yaw-rate residual like pitch rate, scaling with rpm",
        {"inertial_coupling": "pull-ups with level wings", "p_factor": "pitch rate against angle of attack"},
        "pull-ups with power on and off",
        (Form("prop_gyroscopic", (EffectParameter("H_prop", "kg m2/s", 0.15, -1.0, 1.0, meaning="angular momentum"),),
              inputs=(PITCH_RATE,), terms={"Cn": ("H_prop*q/(q_dyn*S*b)",)}, requires=("q_dyn", "S", "b")),),
    ),
)  # fmt: skip

PROPULSION = (
    Effect(
        "motor_torque", "rolling moment of the motor's torque", Group.PROPULSION,
        "The airframe takes up the propeller's torque: a roll bias that steps with the throttle.",
        "L = ... + k_Q T", "0.1 to 0.25 N m at cruise thrust",
        "roll bias that steps with the throttle",
        {"lateral_cg": "throttle step at constant load factor"},
        "throttle steps with level wings",
        (Form("motor_torque", (EffectParameter("k_torque", "m", 0.04, -0.3, 0.3, meaning="torque per thrust"),),
              inputs=(THRUST,), terms={"Cl": ("k_torque*thrust/(q_dyn*S*b)",)}, requires=("q_dyn", "S", "b")),),
    ),
    Effect(
        "slipstream_rudder", "rudder in the propeller's slipstream", Group.PROPULSION,
        "The fin stands in the accelerated stream of the propeller: the rudder gains effect with thrust.",
        "C_nδr, C_Yδr, C_lδr → (1 + k T/(q S)) of their value", "10 to 50 % between idle and full throttle",
        "rudder response depends on throttle",
        {"airspeed_scale": "rudder doublets at idle and full throttle at one speed",
         "surface_compliance": "throttle against speed"},
        "rudder doublets at idle and full throttle",
        (Form("slipstream_rudder", (EffectParameter("k_slipstream", "1", 4.0, -25.0, 25.0, meaning="gain per thrust coeff."),),
              inputs=(THRUST,),
              terms={f"C{x}": (f"k_slipstream*thrust/(q_dyn*S)*C{x}_dr*delta_r",) for x in "Yln"},
              requires=("q_dyn", "S", "delta_r")),),
    ),
    Effect(
        "p_factor", "yawing moment of the inclined propeller", Group.PROPULSION,
        "At an angle of attack the down-going blade pulls more than the up-going one: yaw in proportion to thrust times α.",
        "N = ... + k T α", "arm of 1 to 3 cm at 10°, propeller theory",
        "yaw bias with throttle and angle of attack",
        {"motor_torque": "yaw against roll", "lateral_cg": "throttle step at two angles of attack"},
        "throttle steps at two angles of attack",
        (Form("p_factor", (EffectParameter("k_p_factor", "m/rad", 0.15, -1.2, 1.2, meaning="moment per thrust and α"),),
              inputs=(THRUST, ALPHA), terms={"Cn": ("k_p_factor*thrust*alpha/(q_dyn*S*b)",)},
              requires=("q_dyn", "S", "b")),),
    ),
)  # fmt: skip
