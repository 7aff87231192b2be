"""Candidate effects between the planes: what sideslip, ailerons and rolling do to lift, drag and pitching, and the other way.

Asked of models that move in all axes. The angle of attack counts from 0.1 rad, near level flight.
"""

from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.effects.forms import one_term

BOTH_WAYS = "sideslips to both sides"
BANK_TO_BANK = "bank to bank at two angles of attack"
_OVER = "(alpha - 0.1)"
_ALL = ("CY", "CL")  # lines of both planes


def _even(name: str, title: str, line: str, of: str, term: str, typical: float, reach: float, source: str, physics: str,
          confusions: dict[str, str], separate_by: str, more: tuple[Form, ...] = ()) -> Effect:  # fmt: skip
    return Effect(
        name,
        title,
        Group.NONLINEAR,
        physics,
        f"C_{line[1]} = ... + k {of}²",
        source,
        f"{'pitch-rate' if line == 'Cm' else 'a_x and V' if line == 'CD' else 'a_z'} residual even in {of}",
        confusions,
        separate_by,
        (*one_term(name, line, term, typical, reach, f"per {of}²", "1/rad2", requires=_ALL), *more),
        family=f"even in {of}",
    )


_SLIP = "Whichever way the aircraft slips, wing and body meet the air askew: an even change of the longitudinal coefficients."
_ROLL = "Elevons up on one side and down on the other do not cancel: what is left goes with the square of the aileron."

EVEN = (
    _even("Cm_beta2", "pitching moment from sideslip", "Cm", "β", "beta^2", 0.3, 2.0, "0.3 (2), engineering estimate", _SLIP,
          {"prop_gyroscopic": "even in the direction of the turn, H r is odd", "Cm_da2": BOTH_WAYS}, BOTH_WAYS),
    _even("CL_beta2", "lift lost in sideslip", "CL", "β", "beta^2", 1.0, 6.0, "−1 (6), engineering estimate", _SLIP,
          {"Cm_beta2": "a_z against q"}, BOTH_WAYS),
    _even("CD_beta2", "drag of sideslip", "CD", "β", "beta^2", 0.4, 3.0,
          "0.4 (3), cross-flow of body and fin; 0.13 to 0.18 |β| in files of JSBSim's aircraft", _SLIP,
          {"CD_da2": BOTH_WAYS, "thrust_scale": BOTH_WAYS}, BOTH_WAYS,
          (Form("in proportion", (EffectParameter("CD_abs_beta", "1/rad", 0.15, -0.3, 1.0, meaning="drag per |β|"),),
                terms={"CD": ("CD_abs_beta*abs(beta)",)}, requires=(*_ALL, "beta"), equation="C_D = ... + k |β|"),)),
    _even("CL_da2", "lift from aileron", "CL", "δa", "delta_a^2", 0.3, 3.0, "0.3 (3), engineering estimate", _ROLL,
          {"Cm_da2": "a_z against q"}, "ailerons at two elevator trims"),
    _even("CD_da2", "drag of the ailerons", "CD", "δa", "delta_a^2", 0.3, 3.0, "0.3 (3), engineering estimate", _ROLL,
          {"CD_beta2": BOTH_WAYS}, "large aileron doublets with the throttle fixed"),
    _even("Cm_da2", "pitching moment from aileron", "Cm", "δa", "delta_a^2", 0.3, 3.0, "0.3 (3), engineering estimate", _ROLL,
          {"Cm_beta2": BOTH_WAYS, "Cl_da_de": "ailerons at two elevator trims"}, "ailerons at two elevator trims"),
)  # fmt: skip


def _with_alpha(name: str, title: str, line: str, term: str, typical: float, reach: float, source: str, physics: str,
                confusions: dict[str, str], separate_by: str, unit: str = "1/rad2") -> Effect:  # fmt: skip
    return Effect(
        name,
        title,
        Group.DERIVATIVE,
        physics,
        f"C_{line[1]} = ... + k (α − 0.1) {term}",
        source,
        f"{'roll' if line == 'Cl' else 'yaw'}-rate residual that follows {term}, other sign at the other end of the speed range",
        confusions,
        separate_by,
        one_term(name, line, f"{_OVER}*{term}", typical, reach, "change with α", unit, requires=_ALL),
    )


_VORTEX = "The flow over the wing that the derivative lives of changes with lift: its value holds at one angle of attack only."

WITH_ALPHA = (
    _with_alpha("Cl_alpha_da", "aileron effectiveness that changes with angle of attack", "Cl", "delta_a", 0.2, 1.0,
                "0.2 (1), engineering estimate", _VORTEX, {"surface_compliance": "load factor at one speed",
                "Cl_da_de": BANK_TO_BANK},
                BANK_TO_BANK),
    _with_alpha("Cn_alpha_da", "adverse yaw that grows with angle of attack", "Cn", "delta_a", 0.1, 1.0,
                "0.1 (1): adverse yaw goes with lift, Roskam", _VORTEX, {"Cn_da": BANK_TO_BANK}, BANK_TO_BANK),
    _with_alpha("Cn_alpha_dr", "rudder in the wing's wake", "Cn", "delta_r", 0.2, 1.0, "0.2 (1), engineering estimate", _VORTEX,
                {"surface_compliance": "load factor at one speed", "slipstream_rudder": "throttle fixed"},
                "rudder doublets at two angles of attack"),
    _with_alpha("Cl_alpha_p", "roll damping that changes with angle of attack", "Cl", "p_hat", 1.0, 6.0,
                "1 (6), engineering estimate", _VORTEX, {"Cl_alpha_da": "rolling by rudder"}, "rolls at two speeds"),
    _with_alpha("Cn_alpha_p", "yaw from rolling that changes with angle of attack", "Cn", "p_hat", 0.3, 2.0,
                "0.3 (2): C_np goes with lift, Etkin", _VORTEX, {"Cn_alpha_da": "rolling by rudder"}, "rolls at two speeds"),
)  # fmt: skip

INERTIAL = (
    Effect(
        "pitch_inertial_coupling", "rolling and yawing that pitch the aircraft", Group.INERTIAL,
        "A body that is not a sphere: p r drives pitching through the differences of the moments of inertia. Asked of models "
        "without it.",
        "M = ... + k [(I_zz − I_xx) p r − I_xz (p² − r²)], k = 1 by mechanics", "Euler's equations of motion",
        "pitch-rate residual like p r", {"Cm_beta2": "p r and β² differ in phase",
        "prop_gyroscopic": "turns both ways: H r is odd"},
        "rolls into turns both ways",
        (Form("pitch_inertial_coupling", (EffectParameter("k_pitch_inertial", "1", 1.0, -2.0, 3.0, meaning="1 by mechanics"),),
              terms={"q_dot": ("k_pitch_inertial*((Izz - Ixx)*p*r - Ixz*(p^2 - r^2))/Iyy",)},
              requires=("q_dot", "p", "r", "Ixx", "Iyy", "Izz", "Ixz"), unless=(("q_dot", "p"),)),),
    ),
    Effect(
        "prop_gyroscopic", "gyroscopic moment of the propeller", Group.INERTIAL,
        "A spinning propeller answers pitch rate with yaw and yaw rate with pitch.", "N = ... + H q; M = ... − H r",
        "H of 0.1 to 0.2 kg m²/s for this propeller, engineering estimate", "yaw rate follows pitch rate and pitch rate yaw rate",
        {"Cm_beta2": "even in the direction of the turn, H r is odd", "p_factor": "pitch rate against angle of attack"},
        "pull-ups and turns both ways with power on and off",
        (Form("prop_gyroscopic", (EffectParameter("H_prop", "kg m2/s", 0.15, -1.0, 1.0, meaning="angular momentum"),),
              terms={"Cn": ("H_prop*q/(q_dyn*S*b)",), "Cm": ("-H_prop*r/(q_dyn*S*c)",)},
              requires=("q_dyn", "S", "b", "c", "Cn", "Cm")),),
    ),
)  # fmt: skip

CROSS_AXIS = (*EVEN, *WITH_ALPHA, *INERTIAL)
