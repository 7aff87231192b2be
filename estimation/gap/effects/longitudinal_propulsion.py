"""Candidate effects of the engine on lift, drag and pitching. Where the throttle never moves they leave nothing to see."""

from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.effects.forms import one_term, one_transform

TWO_ALPHA = "throttle steps at two angles of attack"
IDLE = "elevator doublets at idle and full power"

PROPULSION = (
    Effect(
        "thrust_z", "thrust line below or above the centre of gravity", Group.PROPULSION,
        "Thrust that does not pass through the centre of gravity pitches the aircraft in step with the throttle.",
        "M = ... + z T",
        "2 cm (1 m), drawing", "pitch rate follows the throttle",
        {"thrust_tilt": TWO_ALPHA, "propwash_CL": TWO_ALPHA, "propwash_elevator": IDLE}, TWO_ALPHA,
        one_term("thrust_z", "Cm", "thrust/(q_dyn*S*c)", 0.02, 1.0, "thrust line below the CG", "m", requires=("thrust", "q_dyn",
        "c")),
    ),
    Effect(
        "thrust_tilt", "thrust line tilted", Group.PROPULSION,
        "A propeller shaft that points up carries part of the weight.", "F_z = ... − T sin ε, F_x = T cos ε", "3° (10), drawing",
        "a_z follows the throttle", {"thrust_z": TWO_ALPHA, "propwash_CL": TWO_ALPHA, "imu_tilt": "level the board"}, TWO_ALPHA,
        (Form("thrust_tilt", (EffectParameter("thrust_tilt", "rad", 0.05, -0.3, 0.3, meaning="nose up"),),
              terms={"az": ("-thrust*sin(thrust_tilt)/m",), "ax": ("thrust*(cos(thrust_tilt) - 1)/m",)},
              requires=("thrust", "az", "ax", "CZ")),),
    ),
    Effect(
        "thrust_scale", "thrust off by a factor", Group.PROPULSION,
        "A bench curve of another day or propeller. Only thrust over mass is seen: mass_error is the same.", "T → (1 + k) T",
        "8 % (30), bench against flight", "a_x steps with the throttle",
        {"mass_error": "weigh the aircraft", "CD_alpha4": "glide against climb", "CD_CL": "glide against climb"},
        "glide against climb",
        one_term("thrust_scale", "ax", "thrust/m", 0.08, 0.6, "relative error", "1", requires=("thrust", "CX")),
        family="thrust over mass",
    ),
    Effect(
        "mass_error", "wrong mass", Group.INERTIAL,
        "All forces of the air scale with the derivatives that carry them; thrust has none to carry it: only thrust over mass is "
        "seen, "
        "as thrust_scale.", "m → m + Δm", "2 to 5 %, fuel or payload", "a_x steps with the throttle",
        {"thrust_scale": "weigh the aircraft"}, "weigh the aircraft",
        (Form("mass_error", (EffectParameter("m", "kg", 0.3, 1e-3, 1e5, none="m", meaning="mass"),), requires=("m", "thrust",
        "CX")),),
        family="thrust over mass",
    ),
    Effect(
        "thrust_lag", "thrust later than its measure", Group.PROPULSION,
        "Thrust computed from throttle or rpm leads the air it moves.", "τ Ṫ_eff = T − T_eff",
        "0.2 s (0.05 to 0.8), rotor inertia",
        "a_x wrong for a moment after each throttle step", {"thrust_scale": "slow throttle ramps"}, "sharp throttle steps",
        one_transform("thrust_lag", "lag", "thrust", "s", 0.2, 1.5, "time constant"),
    ),
    Effect(
        "propwash_elevator", "elevator in the propeller's stream", Group.PROPULSION,
        "A control in the accelerated stream gains effect with thrust.", "C_mδe, C_Lδe → (1 + k T/(q S)) of their value",
        "0.3 T/(q A) of the disc (1.5), momentum theory: 4 T/(q S) here", "elevator response depends on the throttle",
        {"thrust_z": IDLE, "elevator_compliance": "speed sweep with the throttle fixed", "Cm_alpha_de": IDLE}, IDLE,
        (Form("propwash_elevator", (EffectParameter("k_propwash_elevator", "1", 4.0, -25.0, 25.0,
        meaning="gain per thrust coefficient"),),
              terms={f"C{x}": (f"k_propwash_elevator*thrust/(q_dyn*S)*C{x}_de*delta_e",) for x in ("m", "L")},
              requires=("thrust", "q_dyn", "S", "delta_e", "Cm")),),
    ),
    Effect(
        "propwash_CL", "wing in the propeller's stream", Group.PROPULSION,
        "The part of the wing behind the propeller lifts more with thrust.", "C_Lα → (1 + k T/(q S)) C_Lα",
        "0.1 T/(q A) of the disc (1), momentum theory: 1.5 T/(q S) here", "a_z follows the throttle times angle of attack",
        {"thrust_tilt": TWO_ALPHA, "thrust_z": TWO_ALPHA, "wing_compliance": "speed sweep with the throttle fixed"}, TWO_ALPHA,
        one_term("k_propwash_CL", "CL", "thrust/(q_dyn*S)*CL_alpha*alpha", 1.5, 15.0, "gain per thrust coefficient", "1",
                 requires=("thrust", "q_dyn", "S", "CL_alpha", "alpha")),
    ),
)  # fmt: skip
