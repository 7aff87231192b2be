"""Candidate effects of lift, drag and pitching moment.

Angles of attack count from 0.1 rad, near level flight: another reference only changes CL_0, CL_alpha, Cm_0 and Cm_alpha, which
are estimated anyway, but from far away these would have to move by more than is believed of them.
"""

from estimation.gap.effects.aerodynamic import NONLINEAR as LATERAL_NONLINEAR
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.effects.forms import one_term
from estimation.models.base import Signal

OVER = "(alpha - 0.1)"  # rad over level flight
# rate of angle of attack that the lift without its own part in it would give: solved, for lift changes the rate it depends on
STILL = (
    "(q - tan(beta)*(p*cos(alpha) + r*sin(alpha)) + (g*(cos(theta)*cos(phi)*cos(alpha) + sin(theta)*sin(alpha))"
    " - thrust/m*sin(alpha) - q_dyn*S/m*(CL_0 + CL_alpha*alpha + CL_q*q_hat + CL_de*delta_e))/(V*cos(beta)))"
)
HEIGHT = Signal("height", "m", "height of the wing above ground")
THREE_SPEEDS = "three trim speeds, slow decelerations between them"
# three times the distance [rad] between the angles of attack about which a cube may be, usual and most
SHIFT, FARTHEST = 0.1, 0.75
GLIDES = "power-off glides over the whole speed range"

UNSTEADY = (
    Effect(
        "CL_alphadot", "lift from the rate of angle of attack", Group.UNSTEADY,
        "The flow round wing and tail needs time to settle: to first order lift in proportion to α̇, on top of what pitch rate "
        "makes.",
        "C_L = ... + C_Lα̇ α̇ c/2V", "1.5 per rad (−3 to 8), DATCOM 1978",
        "a_z ahead of or behind the angle of attack while q fits",
        {"Cm_alphadot": "a_z against q at elevator edges", "alpha_lag": "bench step of the vane",
         "imu_x": "tape measure", "elevator_delay": "turns and pull-ups, where q is not α̇"},
        "turns and pull-ups, where q is not α̇",
        (Form("CL_alphadot", (EffectParameter("CL_alphadot", "1/rad", 1.5, -8.0, 8.0,
        meaning="lift per rate of angle of attack"),),
              terms={"CL": (f"CL_alphadot*c/(2*V)*{STILL}/(1 + CL_alphadot*rho*S*c/(4*m*cos(beta)))",)},
              requires=("CL", "CL_alpha", "CL_q", "CL_de", "thrust", "theta", "q_hat", "c", "V", "rho"),
              unless=(("CL", "CL_sim"),)),),  # the lift of a simulation is not the linear one that STILL has
        family="rate of angle of attack",
    ),
    Effect(
        "Cm_alphadot", "pitching moment from the rate of angle of attack", Group.UNSTEADY,
        "The tail meets the downwash that the wing made a moment ago, and vortices over a delta wing settle late: a damping that "
        "goes with α̇ instead of pitch rate.",
        "C_m = ... + C_mα̇ α̇ c/2V", "0.3 to 0.5 of C_mq with a tail, −0.4 per rad (−12 to 2) here; DATCOM 1978",
        "pitch damping differs between pitching on a straight path and turning or pulling up",
        {"downwash_lag": "a frequency sweep: a lag rolls off, a derivative grows",
        "CL_alphadot": "a_z against q at elevator edges",
         "elevator_lag": "slow elevator sines", "elevator_delay": "slow elevator sines"},
        "turns and pull-ups, where q is not α̇",
        (Form("Cm_alphadot", (EffectParameter("Cm_alphadot", "1/rad", 0.4, -12.0, 4.0,
        meaning="moment per rate of angle of attack"),),
              terms={"Cm": ("Cm_alphadot*alpha_dot*c/(2*V)",)}, requires=("Cm", "alpha_dot", "c", "V")),),
        family="rate of angle of attack",
    ),
    Effect(
        "downwash_lag", "downwash reaching the tail late", Group.UNSTEADY,
        "What the tail meets left the wing a time l/V ago. Asked only of models that state the constant `tail_arm` [m]: an "
        "aircraft "
        "without a tail has none.",
        "C_m = ... + k (α(t − l/V) − α)", "l/V of 0.03 to 0.1 s; k of 0.1 to 0.5 per rad",
        "as C_mα̇: report the set",
        {"Cm_alphadot": "a frequency sweep beyond V/l, which few servos reach"},
        "frequency sweep of the elevator",
        (Form("downwash_lag", (EffectParameter("downwash_moment", "1/rad", 0.2, -3.0, 3.0,
        meaning="moment of the downwash at the tail"),),
              states=(Signal("alpha_wake", "rad", "angle of attack whose downwash is at the tail", start="alpha"),),
              lines=("alpha_wake_dot = (alpha - alpha_wake)*V/tail_arm",),
              terms={"Cm": ("downwash_moment*(alpha_wake - alpha)",)}, requires=("tail_arm", "Cm", "alpha", "V")),),
        family="rate of angle of attack",
    ),
)  # fmt: skip


def _power(
    name: str, title: str, line: str, power: int, typical: float, reach: float, physics: str, source: str, twin: str
) -> Effect:
    word = {"CL": "a_z", "Cm": "pitch-rate"}[line]
    letter = line[1]
    return Effect(
        name, title, Group.NONLINEAR, physics, f"C_{letter} = ... + C_{letter}α{power} (α − 0.1)^{power}", source,
        f"{word} residual {'even' if power == 2 else 'odd'} in the distance from trim; estimates at different speeds disagree",
        {twin: "a_z against q: lift shows in a_z at once, a moment first in q",
         **({"Cm_alpha_de": "two flap or centre-of-gravity trims"} if line == "Cm" else {"V_scale": "GPS triangle"})},
        THREE_SPEEDS,
        (*one_term(name, line, f"{OVER}^{power}", typical, reach, f"{'lift' if line == 'CL' else 'moment'} per power of α",
                   f"1/rad{power}", requires=("alpha",)),
         *((_about_another_angle(name, line, typical, reach),) if power == 3 else ())),
        family=f"power {power} of angle of attack",
    )  # fmt: skip


def _about_another_angle(name: str, line: str, typical: float, reach: float) -> Form:
    """A cube about an angle of attack that the flights choose: that of the catalogue is one aircraft's. With a straight line in
    the base it is a cube and a square, here of a quarter of a radian at the most."""
    square = f"{name}_square"
    return Form(
        f"{name} (about another angle)",
        (
            EffectParameter(name, "1/rad3", typical, -reach, reach, meaning="coefficient per cube of α"),
            EffectParameter(
                square, "1/rad2", SHIFT * typical, -FARTHEST * reach, FARTHEST * reach, meaning="and per its square"
            ),
        ),
        terms={line: (f"({name}*{OVER} + {square})*{OVER}^2",)},
        requires=(line, "alpha"),
    )


_VORTEX = "Leading-edge vortices add lift beyond a straight line, separation takes it away: lift that bends with angle of attack."
_PITCH_UP = (
    "The centre of pressure moves with angle of attack: static stability is not the same at every speed (pitch-up)."
)

_LIFT_LOSS = "CL_alpha*alpha*((0.5 + 0.5*sqrt(max(1 - separation, 0.001)))^2 - 1)"


def _separation(at: float) -> Form:
    """Kirchhoff's lift loss beyond an angle of attack [rad]; the drag of the separated part is half the lift it lost."""
    return Form(
        f"lift, at {at * 57.29578:.0f} deg",
        (EffectParameter("k_separation", "1", 1.0, 0.0, 2.0, meaning="share of Kirchhoff's lift loss"),),
        states=(Signal("separation", "1", "separated share, 0 attached", start=0.0),),
        lines=(f"separation_dot = (0.5*(1 + tanh(25*(alpha - {at:g}))) - separation)/0.15",),
        terms={"CL": (f"k_separation*{_LIFT_LOSS}",), "CD": (f"-0.5*k_separation*{_LIFT_LOSS}",)},
        requires=("CL_alpha", "alpha", "CD"),
    )


_STALL = next(e for e in LATERAL_NONLINEAR if e.name == "stall_separation")

NONLINEAR = (
    _power("CL_alpha2", "lift bending with angle of attack", "CL", 2, 4.0, 15.0, _VORTEX,
           "−4 per rad² (−15 to 6), Polhamus 1966", "Cm_alpha2"),
    _power("CL_alpha3", "lift cubic in angle of attack", "CL", 3, 15.0, 80.0, _VORTEX,
           "−15 per rad³ (−80 to 40), Polhamus 1966", "Cm_alpha3"),
    _power("Cm_alpha2", "pitch-up", "Cm", 2, 0.4, 3.0, _PITCH_UP, "−0.4 per rad² (−3 to 3), engineering estimate", "CL_alpha2"),
    _power("Cm_alpha3", "pitching moment cubic in angle of attack", "Cm", 3, 2.0, 15.0, _PITCH_UP,
           "2 per rad³ (−15 to 15), engineering estimate", "CL_alpha3"),
    Effect(
        "stall_separation", "trailing-edge separation near the stall", Group.NONLINEAR,
        "Kirchhoff: as the separation point X moves forward beyond an angle of attack, lift falls to ((1+√X)/2)² of its "
        "attached value, drag grows, and with roll in the model roll damping collapses; X lags behind the motion.",
        "C_L = C_Lα ((1+√X)/2)² α; τ Ẋ + X = ½(1 − tanh a(α − α*))",
        "Goman and Khrabrov 1994, Fischenberg 1995; α* 12 to 25°, a 15 to 40, τ 5 to 30 chord lengths. Asked at two α*",
        "a_z, a_x and q at high angle of attack with a loop in C_L(α)",
        {"CL_alpha3": "slow and fast stall entries"},
        "slow (< 1°/s) and fast stall entries",
        (_separation(0.21), _separation(0.30), *(f for f in _STALL.forms if f.label == "roll damping")),
    ),
    Effect(
        "stall_hysteresis", "separation that returns later than it came", Group.NONLINEAR,
        "Flow that separated at α* attaches again only some degrees lower. Asked only of a model that has separation.",
        "X leaves at α*, returns at α* − h", "h of 1 to 5°, Goman and Khrabrov 1994",
        "different lift on the way up and on the way down, however slow",
        {"stall_separation": "two entry rates: the loop of a lag closes when it is slow, that of hysteresis does not"},
        "stall entries and recoveries at two rates",
        (Form("stall_hysteresis", (EffectParameter("stall_hysteresis", "rad", 0.05, 0.0, 0.2, meaning="return below the onset"),),
              terms={"separation_dot": ("0.5*(tanh(25*(alpha - 0.21 + stall_hysteresis*separation))"
                                        " - tanh(25*(alpha - 0.21)))/0.15",)},
              requires=("separation", "alpha")),),
    ),
    Effect(
        "CL_de3", "elevator losing lift at large deflection", Group.NONLINEAR,
        "Flow separates over a strongly deflected trailing edge; the loss of lift goes with that of moment and is rarely seen by "
        "itself.",
        "C_L = ... + C_Lδe³ δe³", "10 to 25 % lost at 15°, engineering estimate",
        "a_z residual at large elevator only",
        {"Cm_de3": "a_z against q at the edge"}, "elevator doublets of three amplitudes",
        one_term("CL_de3", "CL", "delta_e^3", 3.0, 25.0, "cubic lift of the elevator", "1/rad3", requires=("delta_e",)),
        family="power 3 of elevator",
    ),
    Effect(
        "Cm_de3", "elevator losing effectiveness at large deflection", Group.NONLINEAR,
        "Flow separates over a strongly deflected trailing edge: large inputs pitch less than in proportion.",
        "C_m = ... + C_mδe³ δe³", "10 to 25 % lost at 15°, engineering estimate",
        "pitch-rate residual at large elevator only",
        {"elevator_deadzone": "loss at the small end against the large end: three amplitudes",
        "CL_de3": "a_z against q at the edge"},
        "elevator doublets of three amplitudes",
        one_term("Cm_de3", "Cm", "delta_e^3", 1.0, 10.0, "cubic moment of the elevator", "1/rad3", requires=("delta_e",)),
        family="power 3 of elevator",
    ),
    Effect(
        "Cm_alpha_de", "elevator effectiveness that changes with angle of attack", Group.NONLINEAR,
        "Trailing edges that stand in thicker flow at high angle of attack turn less of it.",
        "C_m = ... + C_mαδe (α − 0.1) δe", "0.8 per rad² (−4 to 4), engineering estimate",
        "pitch-rate residual at the edges of the elevator, other sign at the other end of the speed range",
        {"Cm_alpha2": "two flap or centre-of-gravity trims", "elevator_compliance": "speed sweep at one angle of attack (load "
        "factor)",
         "propwash_elevator": "elevator doublets at idle and full power"},
        "elevator doublets at two flap or centre-of-gravity trims",
        one_term("Cm_alpha_de", "Cm", f"{OVER}*delta_e", 0.8, 4.0, "change of C_mδe with α", "1/rad2", requires=("alpha",
        "delta_e")),
    ),
)  # fmt: skip


def _drag(name: str, title: str, term: str, typical: float, lower: float, upper: float, unit: str, physics: str,
          equation: str, confusions: dict[str, str], separate_by: str, more: tuple[Form, ...] = ()) -> Effect:  # fmt: skip
    parameter = EffectParameter(
        name, unit, typical, lower, upper, meaning="drag per " + equation.rsplit("·", maxsplit=1)[-1].strip()
    )
    symbols = {"CL": "CL", "alpha^4": "alpha", "delta_e^2": "delta_e", "q_hat": "q_hat"}
    form = Form(name, (parameter,), terms={"CD": (f"{name}*{term}",)}, requires=("CD", symbols[term]))
    return Effect(name, title, Group.NONLINEAR, physics, equation, "engineering estimate; Hoerner 1965 for the orders of size",
                  "a_x and V, with nothing in q", confusions, separate_by, (form, *more), family="drag")  # fmt: skip


DRAG = (
    _drag("CD_CL", "least drag away from zero lift", "CL", 0.03, -0.15, 0.15, "1",
          "A cambered or twisted wing has its least drag at some lift: the polar is shifted. C_D0 and k carry nearly all of it "
          "(99.6 % over one decade of speed).", "C_D = ... + k · C_L",
          {"CD_alpha4": GLIDES, "imu_tilt": "level the board", "thrust_scale": "glide against climb"}, GLIDES),
    _drag("CD_alpha4", "drag rising steeply near the stall", "alpha^4", 8.0, -6.0, 60.0, "1/rad4",
          "Separation adds drag long before lift breaks.", "C_D = ... + k · α⁴",
          {"CD_CL": GLIDES, "thrust_scale": "glide against climb"}, "slow flight with the throttle fixed"),
    _drag("CD_de2", "drag of the deflected elevator", "delta_e^2", 0.5, -1.0, 3.0, "1/rad2",
          "Deflected trailing edges drag. About an elevator that is never near neutral a parabola is nearly a straight line.",
          "C_D = ... + k · δe²",
          {"CD_alpha4": "two centre-of-gravity trims", "thrust_scale": GLIDES, "imu_z": "tape measure"},
          "large elevator doublets in a glide",
          (Form("in proportion", (EffectParameter("CD_de", "1/rad", 0.05, -0.3, 0.3, meaning="drag per δe"),),
                terms={"CD": ("CD_de*delta_e",)}, requires=("CD", "delta_e"), equation="C_D = ... + k δe"),
           Form("by its size", (EffectParameter("CD_abs_de", "1/rad", 0.05, -0.3, 0.3, meaning="drag per |δe|"),),
                terms={"CD": ("CD_abs_de*abs(delta_e)",)}, requires=("CD", "delta_e"), equation="C_D = ... + k |δe|"),
           Form("by angle of attack",
                (EffectParameter("CD_alpha_de", "1/rad2", 0.7, -6.0, 6.0, meaning="drag per α δe, beside the polar's"),),
                terms={"CD": ("CD_alpha_de*alpha*delta_e",)}, requires=("CD", "alpha", "delta_e"),
                equation="C_D = ... + k α δe"))),
    _drag("CD_q", "drag from pitch rate", "q_hat", 0.2, -2.0, 2.0, "1/rad",
          "Pitching turns the lift of tail and tips backward.", "C_D = ... + k · q̂",
          {"imu_z": "tape measure", "imu_x": "tape measure"}, "pull-ups at one speed with the throttle fixed"),
    Effect(
        "ground_effect", "less induced drag near the ground", Group.NONLINEAR,
        "Within a span of the ground the downwash is hindered: induced drag falls to s/(1+s). Needs the height above ground as a "
        "column `height`.",
        "C_D = ... + k (s/(1+s) − 1) k_i C_L², s = (16 h/b)²", "McCormick 1979; k is 1 by theory",
        "a_x in low passes only", {"gust": "three heights"}, "level passes at three heights",
        (Form("ground_effect", (EffectParameter("k_ground", "1", 1.0, -1.0, 3.0, meaning="share of McCormick's reduction"),),
              inputs=(HEIGHT,), terms={"CD": ("-k_ground*CD_k*CL^2/(1 + (16*height/b)^2)",)}, requires=("CD_k", "CL", "b")),),
    ),
    Effect(
        "wing_compliance", "wing that gives way to the airstream", Group.NONLINEAR,
        "A wing that twists under load loses lift slope as dynamic pressure grows (or gains it, swept forward).",
        "C_Lα → C_Lα (1 − k (q/200 Pa − 1))", "0.15 (0.5), engineering estimate",
        "lift slopes at different speeds disagree", {"V_scale": "GPS triangle", "propwash_CL": "speed sweep with the throttle "
        "fixed",
                                                     "CL_alpha2": "pull-ups at one speed"},
        "pull-ups at three speeds with the throttle fixed",
        one_term("wing_compliance", "CL", "(1 - q_dyn/200)*CL_alpha*alpha", 0.15, 0.6, "loss", "1/(200 Pa)",
                 requires=("q_dyn", "CL_alpha", "alpha")),
    ),
)  # fmt: skip

TIED = (
    Effect(
        "rho_error", "wrong air density", Group.SENSOR,
        "Density off by a factor: all coefficients of force and moment carry it together, the induced drag by its inverse.",
        "ρ → (1 + e) ρ", "temperature sensor in the sun, 2 to 4 %", "none: exactly carried",
        {"V_scale": "GPS triangle"}, "a thermometer in the shade",
        (Form("rho_error", (EffectParameter("rho_factor", "1", 0.03, 0.7, 1.4, none=1.0, meaning="true over assumed density"),),
              terms={"q_dyn": ("(rho_factor - 1)*0.5*rho*V^2",)}, requires=("q_dyn", "rho", "CL_alpha")),),
        tied_to=("CL_*", "CD_0", "CD_k", "Cm_*"),
    ),
    Effect(
        "Iyy_error", "wrong moment of inertia in pitch", Group.INERTIAL,
        "A factor on the inertia is a factor on every pitching-moment derivative.", "I_yy → (1 + e) I_yy",
        "10 to 20 % without a swing test", "none with wings level: exactly carried", {}, "swing test",
        (Form("Iyy_error", (EffectParameter("Iyy", "kg m2", 0.03, 0.001, 1e4, none="Iyy", meaning="moment of inertia"),),
              requires=("Iyy", "Cm", "q_dot")),),
        tied_to=("Cm_*",),
    ),
    Effect(
        "cg_x", "centre of gravity ahead of its place", Group.INERTIAL,
        "Normal force gets an arm: with vane and accelerometer referred to the centre of gravity every C_m derivative takes dx/c "
        "of its C_Z.",
        "C_m = ... + dx/c C_Z", "1 to 2 cm, balance", "none: exactly carried but for the curvature of C_Z(α)", {},
        "balance the aircraft",
        (Form("cg_x", (EffectParameter("cg_x", "m", 0.01, -0.3, 0.3, meaning="ahead of the assumed place"),),
              terms={"Cm": ("cg_x/c*CZ",)}, requires=("Cm", "CZ", "c")),),
        tied_to=("Cm_*",),
    ),
)  # fmt: skip
