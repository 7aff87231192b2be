"""Candidate effects of actuators, sensors and the air itself."""

from estimation.gap.effects.aerodynamic import ALPHA
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.effects.motion import PITCH, PITCH_RATE
from estimation.models.base import InputTransform, Signal

HEADING = Signal("psi", "rad", "heading")


def _transform(
    name: str, kind: str, surface: str, unit: str, typical: float, upper: float, meaning: str
) -> tuple[Form, ...]:
    parameter = EffectParameter(name, unit, typical, 0.0, upper, meaning=meaning)
    return (Form(name, (parameter,), transforms=(InputTransform(kind, surface, (name,)),), requires=(surface,)),)


def _late(name: str, title: str, kind: str, surface: str, word: str, other: str) -> Effect:
    delay = kind == "delay"
    return Effect(
        name, title, Group.ACTUATOR,
        f"The {word} acts {'some time after' if delay else 'more slowly than'} what is recorded: "
        + ("latency between recorded and true deflection, or clocks that disagree."
           if delay else "a servo or linkage behind the point of measurement with a first-order response."),
        "δ(t) → δ(t − T)" if delay else "τ δ̇_eff = δ − δ_eff", "0.02 to 0.1 s, servo data sheets",
        f"residual like minus the rate of the {word}, doublet-shaped at its edges",
        {other: "steps show the shape: a lag rounds, a delay shifts",
         **({"Cl_betadot": "rudder-driven sideslip with the aileron still"} if surface == "delta_a" else {})},
        f"sharp {word} steps and a multisine; compare pulse width, potentiometer and gyro",
        _transform(name, kind, surface, "s", 0.06, 0.3, "transport delay" if delay else "time constant"),
    )  # fmt: skip


def _slack(name: str, title: str, surface: str, word: str) -> Effect:
    return Effect(
        name,
        title,
        Group.ACTUATOR,
        f"Play in the {word}'s linkage behind the point of measurement: on every reversal the surface stays until the play is "
        "taken up.",
        "δ_eff follows δ within ±h/2, with memory",
        "0.3 to 1.5°, measured on hobby linkages",
        f"{word} effect missing after each reversal; the loop does not depend on speed",
        {
            "aileron_deadzone": "slow ramp in both directions: play has a history, a dead zone has none",
            f"{word}_delay": "slow ramp: play is independent of rate",
        },
        f"slow {word} ramp in both directions, small amplitude",
        _transform(name, "backlash", surface, "rad", 0.017, 0.09, "whole width of the play"),
    )


def _all_late(name: str, kind: str) -> Effect:
    delay = kind == "delay"
    other = "servo_lag" if delay else "servo_delay"
    transforms = tuple(InputTransform(kind, s, (name,)) for s in ("delta_a", "delta_r", "delta_e"))
    parameter = EffectParameter(name, "s", 0.06, 0.0, 0.3, meaning="transport delay" if delay else "time constant")
    return Effect(
        name,
        f"all controls acting {'late' if delay else 'slowly'}",
        Group.ACTUATOR,
        "What is recorded is what the servos are told and not where they are, or one clock stamps all surfaces early: every "
        + (
            "surface acts the same time after its record."
            if delay
            else "surface follows its record with the lag of one kind of servo."
        ),
        "δ(t) → δ(t − T)" if delay else "τ δ̇_eff = δ − δ_eff",
        "0.02 to 0.1 s, servo data sheets",
        "residuals like minus the rates of all controls; the fit moves all of them in time",
        {
            other: "steps show the shape: a lag rounds, a delay shifts",
            "time_skew": "compare pulse width, potentiometer and gyro",
            **{n: f"{n.partition('_')[0]} steps with the others still" for n in ("aileron_lag", "rudder_lag")},
        },
        "potentiometers on the surfaces, or a servo's step filmed on the bench",
        (Form(name, (parameter,), transforms=transforms, requires=("delta_a", "delta_r")),),
    )


_SOFT = "-compliance*q_dyn/200*{0}"

ACTUATOR = (
    _late("aileron_delay", "aileron acting late", "delay", "delta_a", "aileron", "aileron_lag"),
    _late("rudder_delay", "rudder acting late", "delay", "delta_r", "rudder", "rudder_lag"),
    _late("aileron_lag", "aileron acting slowly", "lag", "delta_a", "aileron", "aileron_delay"),
    _late("rudder_lag", "rudder acting slowly", "lag", "delta_r", "rudder", "rudder_delay"),
    _all_late("servo_delay", "delay"),
    _all_late("servo_lag", "lag"),
    Effect(
        "aileron_deadzone", "aileron dead around neutral", Group.ACTUATOR,
        "Small deflections do nothing: flow inside a thick boundary layer, or a slotted linkage around neutral.",
        "δ_eff = 0 within ±h, δ ∓ h outside", "0.3 to 1.5°",
        "roll rate flat at small aileron",
        {"Cl_da3": "loss at the small end against the large end: three doublet amplitudes",
         "aileron_backlash": "slow ramp in both directions"},
        "aileron doublets of three amplitudes, small ones included",
        _transform("aileron_deadzone", "deadzone", "delta_a", "rad", 0.014, 0.07, "half width"),
    ),
    _slack("aileron_backlash", "play in the aileron linkage", "delta_a", "aileron"),
    _slack("rudder_backlash", "play in the rudder linkage", "delta_r", "rudder"),
    Effect(
        "surface_compliance", "control surfaces that give way to the airstream", Group.ACTUATOR,
        "Linkage and surface twist under load: effectiveness falls with dynamic pressure. A coefficient that falls with Mach "
        "number looks the same in flights at one height.",
        "δ → δ (1 − k q/200 Pa)", "5 to 20 % at 20 m/s",
        "control derivatives estimated at different speeds disagree",
        {"airspeed_scale": "speed sweep with GPS", "slipstream_rudder": "throttle against speed"},
        "doublets at three speeds, and at one speed at two heights",
        (Form("all surfaces", (EffectParameter("compliance", "1/(200 Pa)", 0.2, -0.9, 0.9, meaning="loss"),),
              terms={f"C{x}": tuple(_SOFT.format(f"C{x}_{d}*delta_{d[1]}") for d in ("da", "dr")) for x in "Yln"},
              requires=("q_dyn",)),
         Form("aileron", (EffectParameter("compliance_a", "1/(200 Pa)", 0.2, -0.9, 0.9, meaning="loss"),),
              terms={"Cl": ("-compliance_a*q_dyn/200*Cl_da*delta_a",)}, requires=("q_dyn", "Cl_da"))),
    ),
)  # fmt: skip

SENSOR = (
    Effect(
        "beta_scale", "sideslip vane reading too much or too little", Group.SENSOR,
        "A vane off the plane of symmetry sees sidewash, and a potentiometer's slope may be wrong: β is shown K times.",
        "β_m = (1 + k) β", "K_β of 0.92 to 1.10 in the published data compatibility checks",
        "sideslip disagrees with the integral of the kinematics, in proportion",
        {"vane_position": "steady sideslips have no rates", "airspeed_scale": "GPS triangle"},
        "steady-heading sideslips, or a bench calibration of the vane",
        (Form("beta_scale", (EffectParameter("beta_scale", "1", 0.10, -0.5, 0.5, meaning="relative error"),),
              outputs={"beta": "(1 + beta_scale)*beta"}),),
    ),
    Effect(
        "beta_bias", "sideslip vane off zero", Group.SENSOR,
        "A vane mounted askew. In a linear model it cannot be told from C_Y0, C_l0 and C_n0: all three shift together.",
        "β_m = β + b", "0.1 to 0.3° in the published data compatibility checks",
        "none: exactly carried by the constant terms",
        {"lateral_cg": "sideslips to both sides"},
        "wings-level sideslips to both sides, or an alignment jig",
        (Form("beta_bias", (EffectParameter("beta_bias", "rad", 0.005, -0.1, 0.1, meaning="reading at no sideslip"),),
              outputs={"beta": "beta + beta_bias"}),),
        tied_to=("CY_0", "Cl_0", "Cn_0"),
    ),
    Effect(
        "beta_lag", "lagging sideslip vane", Group.SENSOR,
        "A heavy or damped vane (or a filter behind it) follows the wind with a delay.",
        "τ β̇_m = β − β_m", "0.02 to 0.1 s for hobby vanes",
        "sideslip residual like −β̇ while rates and side acceleration fit",
        {"vane_position": "sideslip with r decoupled from β̇ (turning flight); bench step of the vane",
         "time_skew": "bench step of the vane"},
        "bench step of the vane; turning flight where r ≠ −β̇",
        (Form("beta_lag", (EffectParameter("beta_lag", "s", 0.07, 0.015, 0.5, meaning="time constant"),),
              states=(Signal("beta_vane", "rad", "sideslip the vane shows", column="beta", start="beta"),),
              lines=("beta_vane_dot = (beta - beta_vane)/beta_lag", "beta_now = beta"),
              outputs={"beta": "beta + beta_vane - beta_now"}),),
    ),
    Effect(
        "vane_position", "sideslip vane away from the centre of gravity", Group.SENSOR,
        "A vane ahead of the centre of gravity sees the side wind of yawing, one above it that of rolling.",
        "β_m = β + (x r − z p)/V", "0.2 to 0.5 m, tape measure",
        "sideslip residual like r/V or p/V",
        {"beta_lag": "bench step of the vane", "imu_lever_arm": "tape measure", "CY_p_r": "tape measure"},
        "measure the vane's position with a tape",
        (Form("ahead", (EffectParameter("x_vane", "m", 0.35, -2.0, 2.0, meaning="ahead of the CG"),),
              outputs={"beta": "beta + x_vane*r/V"}, requires=("r", "V")),
         Form("below", (EffectParameter("z_vane", "m", 0.25, -1.5, 1.5, meaning="below the CG"),),
              outputs={"beta": "beta - z_vane*p/V"}, requires=("p", "V"))),
    ),
    Effect(
        "imu_lever_arm", "accelerometer away from the centre of gravity", Group.SENSOR,
        "An accelerometer off the centre of gravity also feels angular accelerations.",
        "a_ym = a_y + x ṙ − z ṗ", "3 to 10 cm",
        "a_y residual like ṗ or ṙ",
        {"CY_da": "measure the lever arm; rudder-driven roll", "vane_position": "tape measure"},
        "measure the position of the IMU",
        (Form("below", (EffectParameter("z_imu", "m", 0.06, -0.5, 0.5, meaning="below the CG"),),
              outputs={"ay": "ay - z_imu*p_dot"}, requires=("p_dot",)),
         Form("ahead", (EffectParameter("x_imu", "m", 0.10, -0.8, 0.8, meaning="ahead of the CG"),),
              outputs={"ay": "ay + x_imu*r_dot"}, requires=("r_dot",))),
    ),
    Effect(
        "gyro_misalignment", "gyro axes turned against the body", Group.SENSOR,
        "A board mounted a degree or two askew shows part of the roll rate as yaw rate.",
        "r_m = r + ε p, p_m = p − ε r", "1 to 2°",
        "yaw-rate residual in step with roll rate; kinematics of bank disagree",
        {"Ixz_error": "kinematic check: bank against integrated rates", "roll_kinematics": "two pitch attitudes"},
        "rate-table or turn-by-hand calibration; full rolls",
        (Form("about y", (EffectParameter("epsilon_y", "rad", 0.026, -0.3, 0.3, meaning="rotation about body y"),),
              outputs={"p": "p - epsilon_y*r", "r": "r + epsilon_y*p"}),
         Form("about x", (EffectParameter("epsilon_x", "rad", 0.026, -0.3, 0.3, meaning="rotation about body x"),),
              inputs=(PITCH_RATE,), outputs={"r": "r - epsilon_x*q", "q": "q + epsilon_x*r"}, optional=("q",))),
    ),
    Effect(
        "gyro_scale", "gyro reading too much or too little", Group.SENSOR,
        "Wrong range setting, temperature or factory tolerance: rates are shown a few per cent off.",
        "ω_m = (1 + k) ω", "1 to 3 %",
        "bank from integrated rates disagrees with measured bank in proportion",
        {"beta_scale": "kinematics of bank", "Cl_p_abs_p": "kinematics of bank"},
        "turn-by-hand through a known angle",
        (Form("all axes", (EffectParameter("gyro_scale", "1", 0.03, -0.3, 0.3, meaning="relative error"),),
              outputs={"p": "(1 + gyro_scale)*p", "r": "(1 + gyro_scale)*r", "q": "(1 + gyro_scale)*q"},
              optional=("q",)),
         Form("roll", (EffectParameter("gyro_scale_p", "1", 0.03, -0.3, 0.3, meaning="relative error, p"),),
              outputs={"p": "(1 + gyro_scale_p)*p"}),
         Form("yaw", (EffectParameter("gyro_scale_r", "1", 0.03, -0.3, 0.3, meaning="relative error, r"),),
              outputs={"r": "(1 + gyro_scale_r)*r"})),
    ),
    Effect(
        "attitude_lag", "lagging attitude", Group.SENSOR,
        "The attitude filter (or its telegram) delivers an attitude of a moment ago.",
        "τ φ̇_m = φ − φ_m", "0.05 to 0.2 s",
        "bank residual like −φ̇",
        {"time_skew": "bench turn by hand", "gyro_scale": "sustained bank"},
        "turn by hand on the bench, comparing gyro and attitude",
        (Form("bank and pitch", (EffectParameter("attitude_lag", "s", 0.10, 0.015, 0.6, meaning="time constant"),),
              states=(Signal("phi_shown", "rad", "bank the attitude filter shows", column="phi", start="phi"),
                      Signal("theta_shown", "rad", "pitch attitude the filter shows", column="theta", start="theta")),
              lines=("phi_shown_dot = (phi - phi_shown)/attitude_lag", "phi_now = phi",
                     "theta_shown_dot = (theta - theta_shown)/attitude_lag", "theta_now = theta"),
              outputs={"phi": "phi + phi_shown - phi_now", "theta": "theta + theta_shown - theta_now"}),
         Form("attitude_lag", (EffectParameter("attitude_lag", "s", 0.10, 0.015, 0.6, meaning="time constant"),),
              states=(Signal("phi_shown", "rad", "bank the attitude filter shows", column="phi", start="phi"),),
              lines=("phi_shown_dot = (phi - phi_shown)/attitude_lag", "phi_now = phi"),
              outputs={"phi": "phi + phi_shown - phi_now"}),),
    ),
    Effect(
        "airspeed_scale", "airspeed reading too high or too low", Group.SENSOR,
        "Position error of the pitot-static system: every coefficient scales with 1/V²; only the kinematics can tell.",
        "V_m = (1 + k) V", "3 to 8 %",
        "coefficients off by a common factor; β̇ from g sin φ/V and a_y/V disagrees",
        {"surface_compliance": "GPS triangle", "beta_scale": "GPS triangle"},
        "GPS triangle or reciprocal runs",
        (Form("airspeed_scale",
              (EffectParameter("airspeed_factor", "1", 0.06, 0.6, 1.6, none=1.0, meaning="true over shown airspeed"),),
              transforms=(InputTransform("scale", "V", ("airspeed_factor",)),
                          InputTransform("scale", "V_dot", ("airspeed_factor",)))),),
    ),
    Effect(
        "time_skew", "channels that disagree on time", Group.SENSOR,
        "One device delivers its samples later than the others (a queue, a filter, another clock).",
        "y_m(t) = y(t − T) for the channels of one device", "1 to 2 samples, 0.05 to 0.1 s",
        "residuals of one device's channels like minus their rates",
        {"aileron_delay": "compare pulse width, potentiometer and gyro", "attitude_lag": "turn by hand",
         "beta_lag": "bench step of the vane"},
        "shake the whole aircraft: every sensor must see it at one time",
        (Form("inertial unit", (EffectParameter("time_skew", "s", 0.07, -0.3, 0.3, meaning="inertial channels late"),),
              output_delays=dict.fromkeys(("p", "r", "ay", "q", "ax", "az"), "time_skew"), optional=("q", "ax", "az")),
         Form("attitude", (EffectParameter("time_skew_attitude", "s", 0.07, -0.3, 0.3, meaning="attitude late"),),
              output_delays=dict.fromkeys(("phi", "theta"), "time_skew_attitude"), optional=("theta",)),
         Form("air data", (EffectParameter("time_skew_air_data", "s", 0.07, -0.3, 0.3, meaning="vane late"),),
              output_delays=dict.fromkeys(("beta", "alpha", "V"), "time_skew_air_data"), optional=("alpha", "V"))),
    ),
)  # fmt: skip

ENVIRONMENT = (
    Effect(
        "gust", "gusts", Group.ENVIRONMENT,
        "Turbulence moves the aircraft and the vane; it is not repeatable and has nothing to do with the controls. It is "
        "modelled as process noise whose strength is estimated from the flights, and named where it is strong.",
        "β_air = β + w, w coloured noise", "0.15 to 1.5° of sideslip",
        "coloured residual in β, r and p, uncorrelated with the controls, different in each flight",
        {"beta_lag": "repeat the manoeuvre"},
        "repeat in calm air, or estimate with the filter-error method",
        (),
    ),
    Effect(
        "wind_shear", "wind that changes with height", Group.ENVIRONMENT,
        "Climbing through a wind gradient the air mass accelerates sideways under the aircraft.",
        "β̇ = ... − (dW/dh) (ḣ/V) across the flight path", "0.05 to 0.2 1/s near the ground",
        "sideslip residual in step with climb rate, turning with heading",
        {"lateral_cg": "climbs on reciprocal headings", "p_factor": "climbs on reciprocal headings"},
        "climbs on reciprocal headings",
        (Form("east wind", (EffectParameter("shear_east", "1/s", 0.15, -1.5, 1.5, meaning="east wind gained per height"),),
              inputs=(PITCH, ALPHA, HEADING), requires=("beta_dot",),
              terms={"beta_dot": ("-shear_east*cos(psi)*sin(theta - alpha)",)}),
         Form("north wind", (EffectParameter("shear_north", "1/s", 0.15, -1.5, 1.5, meaning="north wind gained per height"),),
              inputs=(PITCH, ALPHA, HEADING), requires=("beta_dot",),
              terms={"beta_dot": ("shear_north*sin(psi)*sin(theta - alpha)",)})),
    ),
)  # fmt: skip
