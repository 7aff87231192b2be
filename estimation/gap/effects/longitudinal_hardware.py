"""Candidate effects of the elevator's linkage and of the instruments that see pitching and airspeed."""

from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.effects.forms import one_reading, one_transform
from estimation.models.base import Signal

STEPS = "elevator steps of three sizes and slow ramps"
TAPE = "tape measure"

_TWIST = "(1 - q_dyn/200)"  # share of a loss that is nothing at 200 Pa, some 18 m/s

ACTUATOR = (
    Effect(
        "elevator_delay", "elevator acting late", Group.ACTUATOR,
        "The elevator acts some time after what is recorded: latency between recorded and true deflection, or clocks that "
        "disagree.",
        "δe(t) → δe(t − T)", "25 ms, servo data sheets", "residual like minus the rate of the elevator, doublet-shaped at its "
        "edges",
        {"elevator_lag": "steps show the shape: a lag rounds, a delay shifts", "Cm_alphadot": "slow elevator sines",
         "CL_alphadot": "slow elevator sines"}, STEPS,
        one_transform("elevator_delay", "delay", "delta_e", "s", 0.04, 0.3, "transport delay"),
    ),
    Effect(
        "elevator_lag", "elevator acting slowly", Group.ACTUATOR,
        "A linkage or servo behind the point of measurement with a first-order response.", "τ δ̇_eff = δe − δ_eff",
        "40 ms, servo data sheets", "as a delay, rounded",
        {"elevator_delay": "steps show the shape: a lag rounds, a delay shifts", "Cm_alphadot": "slow elevator sines"}, STEPS,
        one_transform("elevator_lag", "lag", "delta_e", "s", 0.05, 0.3, "time constant"),
    ),
    Effect(
        "elevator_deadzone", "elevator dead around neutral", Group.ACTUATOR,
        "Small deflections do nothing: flow inside a thick boundary layer, or a slotted linkage around neutral.",
        "δ_eff = 0 within ±h, δ ∓ h outside", "0.3° (0 to 2), measured on hobby linkages", "pitch rate flat at small elevator",
        {"Cm_de3": "loss at the small end against the large end: three amplitudes", "elevator_backlash": "slow ramps both ways"},
        STEPS,
        one_transform("elevator_deadzone", "deadzone", "delta_e", "rad", 0.0075, 0.05, "half width"),
    ),
    Effect(
        "elevator_backlash", "play in the elevator linkage", Group.ACTUATOR,
        "On every reversal the surface stays until the play is taken up.", "δ_eff follows δe within ±h/2, with memory",
        "0.6° (0 to 3), measured on hobby linkages", "elevator effect missing after each reversal",
        {"elevator_deadzone": "slow ramps both ways: play has a history, a dead zone has none",
         "elevator_delay": "slow ramp: play is independent of rate"}, "slow elevator ramps both ways, small amplitude",
        one_transform("elevator_backlash", "backlash", "delta_e", "rad", 0.012, 0.08, "whole width of the play"),
    ),
    Effect(
        "elevator_rate_limit", "elevator slower than its servo", Group.ACTUATOR,
        "A weak or loaded linkage turns no faster than so many degrees a second: small steps are untouched, large ones become "
        "ramps.",
        "|δ̇_eff| ≤ 1/k", "300°/s (k of 0.19 s/rad), servos under load 60°/s", "late at large elevator steps only",
        {"elevator_lag": "steps of three sizes: a lag is the same for all"}, "elevator steps of three sizes",
        one_transform("elevator_rate_limit", "rate_limit", "delta_e", "s/rad", 0.4, 4.0, "seconds a radian takes at the least"),
    ),
    Effect(
        "elevator_compliance", "elevator that gives way to the airstream", Group.ACTUATOR,
        "Linkage and surface twist under load: effectiveness falls with dynamic pressure.",
        "C_mδe, C_Lδe → (1 − k (q/200 Pa − 1)) of their value", "0.15 (0.5), engineering estimate",
        "elevator derivatives estimated at different speeds disagree",
        {"V_scale": "speed sweep with GPS", "propwash_elevator": "speed sweep with the throttle fixed",
         "Cm_alpha_de": "load factor at one speed"}, "elevator doublets at three speeds with the throttle fixed",
        (Form("elevator_compliance", (EffectParameter("elevator_compliance", "1/(200 Pa)", 0.15, -0.6, 0.6, meaning="loss"),),
              terms={f"C{x}": (f"elevator_compliance*{_TWIST}*C{x}_de*delta_e",) for x in ("m", "L")},
              requires=("q_dyn", "delta_e", "Cm")),),
    ),
)  # fmt: skip

SENSOR = (
    Effect(
        "alpha_scale", "angle-of-attack vane reading too much or too little", Group.SENSOR,
        "Upwash turns the air before a vane meets it: 1.05 to 1.2 times ahead of the nose, to 1.8 near a wing.",
        "α_m = (1 + k) α",
        "Lawford and Nippress 1983, Haering 1995", "α disagrees with a_z over V and with θ less the flight path, in proportion",
        {"alpha_bias": "five trim speeds", "V_scale": "GPS triangle"}, "flight-path reconstruction at five trim speeds",
        (one_reading("alpha_scale", {"alpha": "(1 + alpha_scale)*alpha"}, "1", 0.1, 0.8, "relative error"),),
    ),
    Effect(
        "alpha_bias", "angle-of-attack vane off zero", Group.SENSOR,
        "A vane mounted askew. Unlike sideslip it is seen: gravity and drag know where the nose points.", "α_m = α + b",
        "0.5° , Haering 1995", "α less θ disagrees with the flight path, a_x with drag",
        {"alpha_scale": "five trim speeds", "imu_tilt": "level the board"}, "flight-path reconstruction at five trim speeds",
        (one_reading("alpha_bias", {"alpha": "alpha + alpha_bias"}, "rad", 0.0087, 0.15, "reading at none"),),
    ),
    Effect(
        "alpha_position", "angle-of-attack vane away from the centre of gravity", Group.SENSOR,
        "A vane ahead of the centre of gravity sees the wind of pitching, one to the side that of rolling.",
        "α_m = α + (−x q + y p)/V",
        "0.4 m (2), tape measure", "α residual like q/V or p/V",
        {"alpha_lag": "bench step of the vane; slow rolls", "imu_x": TAPE}, TAPE,
        (one_reading("x_alpha_vane", {"alpha": "alpha - x_alpha_vane*q/V"}, "m", 0.4, 2.0, "ahead of the CG", ("q", "V"),
        "ahead"),
         one_reading("y_alpha_vane", {"alpha": "alpha + y_alpha_vane*p/V"}, "m", 0.4, 2.0, "right of the CG", ("p", "V"),
         "right")),
    ),
    Effect(
        "alpha_lag", "lagging angle-of-attack vane", Group.SENSOR, "A heavy or damped vane follows the wind late.",
        "τ α̇_m = α − α_m",
        "35 ms (150), hobby vanes", "α residual like −α̇ while q and a_z fit",
        {"alpha_position": "slow rolls; turns, where q is not α̇", "CL_alphadot": "bench step of the vane"},
        "bench step of the vane",
        (Form("alpha_lag", (EffectParameter("alpha_lag", "s", 0.05, 0.012, 0.4, meaning="time constant"),),
              states=(Signal("alpha_vane", "rad", "angle of attack the vane shows", column="alpha", start="alpha"),),
              lines=("alpha_vane_dot = (alpha - alpha_vane)/alpha_lag", "alpha_now = alpha"),
              outputs={"alpha": "alpha + alpha_vane - alpha_now"}),),
    ),
    Effect(
        "V_scale", "airspeed reading too high or too low", Group.SENSOR,
        "Position error of the pitot-static system. Here airspeed is an output: its kinematics (a_x, θ) tell it from density.",
        "V_m = (1 + k) V", "3 %, Gracey 1980", "V̇ and gravity's share of it disagree with a_x, in proportion",
        {"rho_error": "GPS triangle", "V_alpha": "GPS triangle at three speeds"}, "GPS triangle",
        (one_reading("V_scale", {"V": "(1 + V_scale)*V"}, "1", 0.03, 0.3, "relative error"),),
    ),
    Effect(
        "V_alpha", "airspeed error that grows with angle of attack", Group.SENSOR,
        "The static port's error changes with lift, the pitot's with the angle of the stream.", "V_m = (1 + k (α − 0.1)) V",
        "0.3 per rad, Gracey 1980", "airspeed residual in step with angle of attack",
        {"V_scale": "GPS triangle at three speeds", "alpha_scale": "GPS triangle at three speeds"},
        "GPS triangle at three speeds",
        (one_reading("V_alpha", {"V": "V + V_alpha*(alpha - 0.1)*V"}, "1/rad", 0.3, 4.0, "relative error per α", ("alpha",)),),
    ),
    Effect(
        "imu_x", "accelerometer ahead of the centre of gravity", Group.SENSOR,
        "Ahead of the centre of gravity the accelerometer feels angular acceleration in z.",
        "a_zm = a_z − x (q̇ − p r), a_xm = a_x − x (q² + r²)",
        "8 cm, tape measure", "a_z residual like q̇",
        {"CL_alphadot": TAPE, "CL_de3": TAPE, "elevator_lag": TAPE}, TAPE,
        (one_reading("imu_x", {"az": "az - imu_x*(q_dot - p*r)", "ax": "ax - imu_x*(q^2 + r^2)"}, "m", 0.08, 0.8,
        "ahead of the CG",
                     ("q_dot", "p", "r")),),
    ),
    Effect(
        "imu_z", "accelerometer below the centre of gravity", Group.SENSOR,
        "Below the centre of gravity the accelerometer feels pitching acceleration along x.",
        "a_xm = a_x + z (q̇ + p r), a_zm = a_z − z (p² + q²)",
        "8 cm, tape measure", "a_x residual like q̇", {"CD_q": TAPE, "CD_de2": TAPE}, TAPE,
        (one_reading("imu_z", {"ax": "ax + imu_z*(q_dot + p*r)", "az": "az - imu_z*(p^2 + q^2)"}, "m", 0.08, 0.8, "below the CG",
                     ("q_dot", "p", "r")),),
    ),
    Effect(
        "imu_tilt", "accelerometer turned about the pitch axis", Group.SENSOR,
        "A board that is not level shows part of the normal force as axial force.",
        "a_xm = a_x cos ε − a_z sin ε, a_zm = a_z cos ε + a_x sin ε", "1°, spirit level", "a_x residual in step with load factor",
        {"alpha_bias": "level the board", "CD_CL": "level the board", "thrust_tilt": "throttle steps"},
        "level the board; pull-ups",
        (one_reading("imu_tilt", {"ax": "ax*cos(imu_tilt) - az*sin(imu_tilt)", "az": "az*cos(imu_tilt) + ax*sin(imu_tilt)"},
        "rad", 0.0175, 0.2,
                     "nose up"),),
    ),
    Effect(
        "q_scale", "pitch gyro reading too much or too little", Group.SENSOR, "Wrong range setting, temperature or factory "
        "tolerance.",
        "q_m = (1 + k) q", "3 %, gyro data sheets", "θ from integrated q disagrees with measured θ, in proportion",
        {"theta_lag": "turn by hand through a known angle"}, "turn by hand through a known angle",
        (one_reading("q_scale", {"q": "(1 + q_scale)*q"}, "1", 0.03, 0.3, "relative error"),),
    ),
    Effect(
        "theta_lag", "lagging pitch attitude", Group.SENSOR, "The attitude filter (or its telegram) delivers an attitude of a "
        "moment ago.",
        "τ θ̇_m = θ − θ_m", "40 ms", "θ residual like −q", {"q_scale": "turn by hand on the bench"},
        "turn by hand on the bench, comparing gyro and attitude",
        (Form("theta_lag", (EffectParameter("theta_lag", "s", 0.05, 0.012, 0.6, meaning="time constant"),),
              states=(Signal("theta_shown", "rad", "pitch attitude the filter shows", column="theta", start="theta"),),
              lines=("theta_shown_dot = (theta - theta_shown)/theta_lag", "theta_now = theta"),
              outputs={"theta": "theta + theta_shown - theta_now"}),),
    ),
)  # fmt: skip
