"""Candidate effects of the aerodynamics: omitted derivatives, nonlinearity, unsteadiness."""

from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.models.base import Signal

ALPHA = Signal("alpha", "rad", "angle of attack")
ELEVATOR = Signal("delta_e", "rad", "elevator (mean elevon)", control=True)


def _one(name: str, line: str, term: str, typical: float, reach: float, meaning: str, unit: str = "1/rad",
         inputs: tuple[Signal, ...] = (), requires: tuple[str, ...] = ()) -> tuple[Form, ...]:  # fmt: skip
    """A form of one coefficient times a regressor, in one line."""
    parameter = EffectParameter(name, unit, typical, -reach, reach, meaning=meaning)
    return (Form(name, (parameter,), terms={line: (f"{name}*{term}",)}, inputs=inputs, requires=(line, *requires)),)


DERIVATIVES = (
    Effect(
        "CY_da", "side force from aileron", Group.DERIVATIVE,
        "Deflected elevons on a swept trailing edge push air sideways and load the fin: a side force in step with the "
        "aileron, which a side-force equation of sideslip, rates and rudder has no place for.",
        "C_Y = ... + C_Yδa δa", "engineering estimate, 0.02 to 0.06 per rad for a cropped delta",
        "a_y follows aileron edges at once, before any sideslip has built up; rolling moment unaffected",
        {"imu_lever_arm": "measure the lever arm on the bench; rudder-driven roll moves the lever arm but not C_Yδa"},
        "aileron doublet and rudder doublet of equal roll acceleration",
        _one("CY_da", "CY", "delta_a", 0.04, 0.25, "side force per aileron", requires=("delta_a",)),
    ),
    Effect(
        "Cn_da", "adverse yaw from aileron", Group.DERIVATIVE,
        "The down-going elevon carries more induced drag than the up-going one: rolling one way yaws the nose the other "
        "way (or, on some planforms, the same way).",
        "C_n = ... + C_nδa δa", "5 to 15 % of C_lδa, Roskam; engineering estimate for this planform",
        "yaw rate and then sideslip follow the low-passed aileron",
        {"Ixz_error": "symmetric pull-up with aileron 3-2-1-1 (p q and q r make the product of inertia visible), or swing test",
         "p_sin_alpha": "bank-to-bank rolls at two angles of attack"},
        "symmetric pull-up with aileron 3-2-1-1",
        _one("Cn_da", "Cn", "delta_a", 0.010, 0.06, "yawing moment per aileron", requires=("delta_a",)),
    ),
    Effect(
        "CY_p_r", "side force from roll and yaw rate", Group.DERIVATIVE,
        "Rolling and yawing change the local sideslip along span and at the fin: side force in proportion to the rates.",
        "C_Y = ... + C_Yp p̂ + C_Yr r̂", "published estimates for this aircraft: C_Yp -0.05, C_Yr +0.12",
        "a_y follows roll and yaw rate",
        {"imu_lever_arm": "bench measurement of the lever arm", "vane_position": "tape measure"},
        "aileron doublets at two speeds with the lever arm measured",
        (Form("CY_p_r",
              (EffectParameter("CY_p", "1/rad", 0.05, -0.6, 0.6, meaning="side force per roll rate"),
               EffectParameter("CY_r", "1/rad", 0.12, -1.2, 1.2, meaning="side force per yaw rate")),
              terms={"CY": ("CY_p*p_hat", "CY_r*r_hat")}, requires=("CY", "p_hat", "r_hat")),),
    ),
    Effect(
        "Cl_alpha_beta", "dihedral effect that changes with angle of attack", Group.DERIVATIVE,
        "On a swept or cropped-delta wing the rolling moment due to sideslip grows with lift: a constant C_lβ is right at "
        "one angle of attack only.",
        "C_l = ... + C_lαβ α β", "-0.5 to -1 per rad², slender-wing theory",
        "roll-rate residual like α β; C_lβ estimated at different speeds disagrees",
        {"airspeed_scale": "rudder doublet at three speeds with the pitot checked against GPS"},
        "the same rudder doublet at three speeds",
        _one("Cl_alpha_beta", "Cl", "alpha*beta", 0.75, 6.0, "change of C_lβ with α", "1/rad2", (ALPHA,), ("beta",)),
    ),
    Effect(
        "Cn_alpha_beta", "directional stability that changes with angle of attack", Group.DERIVATIVE,
        "Leading-edge vortices and the wing's wake over the fin change C_nβ with angle of attack.",
        "C_n = ... + C_nαβ α β", "±0.2 per rad², engineering estimate",
        "yaw-rate residual like α β; Dutch-roll frequency does not scale with speed",
        {"Cn_beta3": "two-amplitude Dutch rolls at one speed", "airspeed_scale": "GPS triangle"},
        "rudder doublet at three speeds, wind-up turn",
        _one("Cn_alpha_beta", "Cn", "alpha*beta", 0.25, 2.5, "change of C_nβ with α", "1/rad2", (ALPHA,), ("beta",)),
    ),
    Effect(
        "Cl_da_de", "aileron effectiveness that changes with elevator", Group.DERIVATIVE,
        "Elevons do both jobs: a trailing edge already deflected for trim is less (or more) effective in roll.",
        "C_l = ... + C_lδaδe δa δe", "5 to 15 % of C_lδa at 10° of elevator, engineering estimate",
        "roll-rate residual like δa δe",
        {"Cl_da3": "aileron doublets of equal size at two elevator trims"},
        "aileron doublet at two elevator trims",
        _one("Cl_da_de", "Cl", "delta_a*delta_e", 0.5, 4.0, "change of C_lδa with δe", "1/rad2", (ELEVATOR,), ("delta_a",)),
    ),
)  # fmt: skip

_CUBIC = "staircase of steady-heading sideslips to ±12°"

NONLINEAR = (
    Effect(
        "Cl_beta3", "rolling moment nonlinear in sideslip", Group.NONLINEAR,
        "Beyond some 5° of sideslip the windward wing's flow separates or its vortex strengthens; the rolling moment bends "
        "away from the tunnel's linear part. Fits as β³ or β|β| alike.",
        "C_l = ... + C_lβ³ β³", "wind tunnel: linear within ±5° only",
        "roll-rate residual odd in β, growing beyond 5°",
        {"Cl_p_abs_p": "steady sideslips have no roll rate", "Cl_alpha_beta": "same sideslips at two speeds"},
        _CUBIC,
        _one("Cl_beta3", "Cl", "beta^3", 2.0, 15.0, "cubic rolling moment", "1/rad3", requires=("beta",)),
        family="odd in beta",
    ),
    Effect(
        "Cn_beta3", "yawing moment nonlinear in sideslip", Group.NONLINEAR,
        "Fin stall or vortex interference: directional stiffness changes with the amplitude of sideslip.",
        "C_n = ... + C_nβ³ β³", "0.1 to 0.4 in C_n β|β| terms; wind tunnel: linear within ±5° only",
        "Dutch-roll frequency changes with amplitude",
        {"Cn_dr3": "sideslip with the rudder held", "Cn_alpha_beta": "two-amplitude Dutch rolls at one speed"},
        "two-amplitude Dutch rolls",
        _one("Cn_beta3", "Cn", "beta^3", 1.0, 8.0, "cubic yawing moment", "1/rad3", requires=("beta",)),
        family="odd in beta",
    ),
    Effect(
        "CY_beta3", "side force nonlinear in sideslip", Group.NONLINEAR,
        "Cross-flow drag of a flat-plate fuselage and fin: the side force grows faster than sideslip.",
        "C_Y = ... + C_Yβ³ β³", "0.1 to 0.4 in C_Y β|β|, cross-flow theory",
        "a_y residual odd in β",
        {"Cl_beta3": "they enter different equations: a_y against roll rate"},
        "steady sideslips",
        _one("CY_beta3", "CY", "beta^3", 4.0, 30.0, "cubic side force", "1/rad3", requires=("beta",)),
        family="odd in beta",
    ),
    Effect(
        "Cl_da3", "aileron losing effectiveness at large deflection", Group.NONLINEAR,
        "Flow separates over a strongly deflected trailing edge: large inputs roll less than in proportion.",
        "C_l = ... + C_lδa³ δa³", "10 to 25 % loss at 15°, engineering estimate",
        "roll-rate residual at large aileron only",
        {"aileron_deadzone": "loss at the large end against the small end: three doublet amplitudes",
         "Cl_p_abs_p": "same roll rate by rudder and sideslip"},
        "aileron doublets of three amplitudes",
        _one("Cl_da3", "Cl", "delta_a^3", 2.0, 15.0, "cubic aileron effectiveness", "1/rad3", requires=("delta_a",)),
    ),
    Effect(
        "Cn_dr3", "fin stall at large rudder", Group.NONLINEAR,
        "An all-moving fin at large incidence stalls: yawing moment no longer grows with rudder.",
        "C_n = ... + C_nδr³ δr³", "10 to 30 % loss at 12°, engineering estimate",
        "yaw-rate residual at large rudder only",
        {"Cn_beta3": "full-rudder steps, where rudder leads sideslip"},
        "full-rudder steps",
        _one("Cn_dr3", "Cn", "delta_r^3", 2.0, 15.0, "cubic rudder effectiveness", "1/rad3", requires=("delta_r",)),
    ),
    Effect(
        "Cl_p_abs_p", "roll damping nonlinear in roll rate", Group.NONLINEAR,
        "At high roll rate the tips see large changes of angle of attack; damping grows or falls with |p|.",
        "C_l = ... + C_lp|p| p̂|p̂|", "5 to 15 % of the damping at p̂ = 0.07",
        "roll-rate residual at high roll rate, odd in p",
        {"Cl_da3": "same roll rate with different aileron", "aileron_deadzone": "small inputs"},
        "rolls of equal rate with and without sideslip",
        _one("Cl_p_abs_p", "Cl", "p_hat*abs(p_hat)", 1.5, 12.0, "damping per |p̂|", "1/rad2", requires=("p_hat",)),
    ),
    Effect(
        "stall_separation", "trailing-edge separation near the stall", Group.NONLINEAR,
        "Kirchhoff: as the separation point X moves forward beyond an angle of attack, lift falls to ((1+√X)/2)² of its "
        "attached value and roll damping collapses; X lags behind the motion.",
        "τ Ẋ + X = ½(1 − tanh a(α − α*)); C_L = C_Lα ((1+√X)/2)² α; C_lp → X C_lp",
        "Goman and Khrabrov 1994; Singh and Jategaonkar; α* 14 to 25°, a 15 to 40, τ 0.05 to 0.5 s",
        "a_z, a_x and q at high angle of attack with a loop in C_L(α); weak roll damping there",
        {"Cl_p_abs_p": "rolls at low angle of attack"},
        "slow (< 1°/s) and fast stall entries",
        (
            Form("roll damping",
                 (EffectParameter("k_separation", "1", 1.0, 0.0, 2.0, meaning="share of roll damping lost when separated"),),
                 states=(Signal("separation", "1", "separated share, 0 attached", start=0.0),), inputs=(ALPHA,),
                 lines=("separation_dot = (0.5*(1 + tanh(25*(alpha - 0.21))) - separation)/0.15",),
                 terms={"Cl": ("-k_separation*separation*Cl_p*p_hat",)}, requires=("Cl_p", "p_hat")),
            Form("lift",
                 (EffectParameter("k_separation", "1", 1.0, 0.0, 2.0, meaning="share of Kirchhoff's lift loss"),),
                 states=(Signal("separation", "1", "separated share, 0 attached", start=0.0),),
                 lines=("separation_dot = (0.5*(1 + tanh(25*(alpha - 0.21))) - separation)/0.15",
                        "attached = max(1 - separation, 0.001)"),
                 terms={"CL": ("k_separation*CL_alpha*alpha*((0.5 + 0.5*sqrt(attached))^2 - 1)",)},
                 requires=("CL_alpha", "alpha")),
        ),
    ),
)  # fmt: skip

UNSTEADY = (
    Effect(
        "Cl_betadot", "rolling moment from the rate of sideslip", Group.UNSTEADY,
        "Sidewash and vortex position need time to follow sideslip; to first order a rolling moment in proportion to β̇.",
        "C_l = ... + C_lβ̇ β̇ b/2V", "0.05 to 0.15, Greenwell 1998 for delta wings",
        "roll-rate residual like β̇",
        {"aileron_delay": "rudder-driven sideslip with the aileron still", "indicial_lag": "multi-frequency sweep"},
        "flat-yaw rudder oscillation against turning flight (where r ≠ −β̇)",
        _one("Cl_betadot", "Cl", "beta_dot*b/(2*V)", 0.10, 0.8, "rolling moment per β̇", requires=("beta", "b", "V")),
    ),
    Effect(
        "Cn_betadot", "yawing moment from the rate of sideslip", Group.UNSTEADY,
        "The fin feels the wing's sidewash of a moment ago: yaw damping that depends on β̇ rather than on yaw rate.",
        "C_n = ... + C_nβ̇ β̇ b/2V", "±0.01 to 0.05, Greenwell 1998",
        "yaw damping differs between flat yaw and turning flight",
        {"indicial_lag": "multi-frequency sweep"},
        "flat-yaw rudder oscillation against turning flight (where r ≠ −β̇)",
        _one("Cn_betadot", "Cn", "beta_dot*b/(2*V)", 0.03, 0.3, "yawing moment per β̇", requires=("beta", "b", "V")),
    ),
    Effect(
        "indicial_lag", "sideslip moments that lag behind sideslip", Group.UNSTEADY,
        "Vortices and separated flow settle over a few chord lengths: the static moments follow a lagged sideslip.",
        "τ η̇ = β − η; C_l, C_n take η for β", "τ of 2 to 5 chord lengths of travel, 0.07 to 0.18 s",
        "moments lag sideslip; Dutch-roll damping lower than the rate derivatives say",
        {"Cn_betadot": "multi-frequency sweep: a lag rolls off, a derivative grows", "beta_lag": "bench step of the vane"},
        "multi-frequency rudder sweep",
        (Form("indicial_lag", (EffectParameter("indicial_lag", "s", 0.12, 0.01, 0.6, meaning="time constant"),),
              states=(Signal("beta_wake", "rad", "lagged sideslip that the moments follow", start="beta"),),
              lines=("beta_wake_dot = (beta - beta_wake)/indicial_lag",),
              terms={"Cl": ("Cl_beta*(beta_wake - beta)",), "Cn": ("Cn_beta*(beta_wake - beta)",)},
              requires=("beta",)),),
    ),
)  # fmt: skip
