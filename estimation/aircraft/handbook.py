"""Prior derivatives from the shape of a conventional aircraft, good to a third at best: better starts than zeros.

Wing lift slope: DATCOM 4.1.3.2 for low speed (Raymer, Aircraft Design, eq 12.6). Tail, fin and damping terms: Etkin and
Reid, Dynamics of Flight, 3rd ed., sections 2.2 to 3.11. Wing in roll: Prandtl's lifting line, solved by Fourier series
(Glauert, Elements of Aerofoil and Airscrew Theory, chapter 11), scaled to the lift slope above; terms that depend on lift, by
strips. Control effectiveness: Glauert's thin-aerofoil flap. Neglected: fuselage, slipstream, wing-fin interference,
compressibility; hence the standard deviations: STD_MAIN for a term of one surface, STD_CROSS for sums of parts and terms that
depend on lift.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from daq.utilities.constants import GRAVITY, SEA_LEVEL_DENSITY

if TYPE_CHECKING:
    from estimation.aircraft.aircraft import Aircraft, PriorDerivative

Array = NDArray[np.float64]

STD_MAIN = 0.3
"""Of damping, stiffness and control power: scatter of handbook methods about flight of light aircraft."""

STD_CROSS = 0.6
"""Of cross derivatives (rolling moment due to yaw and the like), and of terms to which the neglected fuselage adds as much."""

STD_FLOOR = 0.01
"""Smallest standard deviation of a belief: some derivatives are near zero by cancellation [1/rad]."""

STD_WING_HEIGHT = 0.03
"""Of Cl_beta: a wing above or below the fuselage acts like five degrees of dihedral (Etkin and Reid, section 3.9)."""

ASPECT_UNKNOWN = 3.0  # of a tail or fin whose span is not stated
WING_DAMPING = 0.1  # of Cm_q, over the lift slope of the wing
POINTS = 60
"""Collocation points of the lifting line: rolling moments are then within 3 % of those with ten times as many."""

OSWALD = 0.8  # span efficiency; 0.7 to 0.9 of light aircraft (Raymer, section 12.6)
CD_0 = 0.03  # clean light aircraft 0.02 to 0.04 (Raymer, table 12.3)
TAIL_PRESSURE = 0.9  # dynamic pressure at the tail over that of the wing (Etkin and Reid, section 2.3)


class HandbookShape(BaseModel):
    """`[shape]`: the input of the handbook methods besides span, area and chord [m, m2, rad].

    wing_ac: aerodynamic centre of the wing from the CG, + forward. Tail and fin arms: CG to their quarter chord, + aft;
    fin_height: its centre of pressure above the CG. *_flap: chord of the control over that of its surface. aileron: inner
    and outer end as fractions of the half span. speed: of level flight, for terms that depend on lift [m/s].
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    speed: float = Field(gt=0)
    wing_ac: float = 0.0
    taper: float = Field(default=1.0, ge=0, le=1.5)
    sweep: float = Field(default=0.0, gt=-1.2, lt=1.2)
    dihedral: float = Field(default=0.0, gt=-0.8, lt=0.8)
    tail_area: float = Field(default=0.0, ge=0)
    tail_span: float = Field(default=0.0, ge=0)
    tail_arm: float = Field(default=0.0, ge=0)
    elevator_flap: float = Field(default=0.4, gt=0, le=1)
    fin_area: float = Field(default=0.0, ge=0)
    fin_span: float = Field(default=0.0, ge=0)
    fin_arm: float = 0.0
    fin_height: float = 0.0
    rudder_flap: float = Field(default=0.4, gt=0, le=1)
    aileron: tuple[float, float] = (0.6, 0.95)
    aileron_flap: float = Field(default=0.25, gt=0, le=1)


def lift_slope(aspect: float, sweep: float = 0.0) -> float:
    """Lift slope of a wing of this aspect ratio and half-chord sweep [1/rad], section slope 2 pi: DATCOM 4.1.3.2."""
    return 2.0 * math.pi * aspect / (2.0 + math.sqrt(aspect**2 * (1.0 + math.tan(sweep) ** 2) + 4.0))


def flap_effectiveness(chord_ratio: float) -> float:
    """Change of zero-lift angle per flap deflection, thin-aerofoil theory (Glauert): 1 - (theta - sin theta)/pi."""
    theta = math.acos(2.0 * chord_ratio - 1.0)
    return 1.0 - (theta - math.sin(theta)) / math.pi


def _surface(area: float, span: float) -> float:
    """Lift slope of a tail or fin [1/rad]."""
    return lift_slope(span**2 / area if span and area else ASPECT_UNKNOWN)


def beliefs(aircraft: "Aircraft", shape: HandbookShape) -> "dict[str, PriorDerivative]":
    """Derivatives [1/rad] with standard deviations, source "handbook". Raises AircraftError without span, area, chord and mass.

    Derivatives of a missing surface (an elevator without a tail) are left out.
    """
    from estimation.aircraft.aircraft import PriorDerivative

    aircraft.need(("S", "b", "c", "m"), "[shape]")
    values = {**_longitudinal(aircraft, shape), **_lateral(aircraft, shape)}
    return {name: PriorDerivative(value, _std(name, value), "handbook") for name, value in values.items()}


_CROSS = frozenset("Cl_r Cn_p CY_p CY_r CY_beta Cl_dr Cl_beta CL_0 Cm_0 CD_0 CL_q".split())


def _std(name: str, value: float) -> float:
    floor = STD_WING_HEIGHT if name == "Cl_beta" else STD_FLOOR
    return max(abs(value) * (STD_CROSS if name in _CROSS else STD_MAIN), floor)


def _longitudinal(aircraft: "Aircraft", s: HandbookShape) -> dict[str, float]:
    """Wing and tail: Etkin and Reid eqs 2.2,14 (lift), 2.2,15 (stiffness), 2.4,4 (elevator), 3.2 (pitch damping)."""
    aspect = aircraft.span**2 / aircraft.area
    wing, tail = lift_slope(aspect, s.sweep), TAIL_PRESSURE * _surface(s.tail_area, s.tail_span)
    downwash = 2.0 * wing / (math.pi * aspect)
    share, volume = s.tail_area / aircraft.area, s.tail_area * s.tail_arm / (aircraft.area * aircraft.chord)
    derivatives = {
        "CL_0": 0.0,
        "CL_alpha": wing + tail * share * (1.0 - downwash),
        "CL_q": 2.0 * tail * volume,
        "CD_0": CD_0,
        "CD_k": 1.0 / (math.pi * aspect * OSWALD),
        "Cm_0": 0.0,
        "Cm_alpha": wing * s.wing_ac / aircraft.chord - tail * volume * (1.0 - downwash),
        "Cm_q": -2.0 * tail * volume * s.tail_arm / aircraft.chord - WING_DAMPING * wing,
    }
    if s.tail_area:
        power = tail * flap_effectiveness(s.elevator_flap)
        derivatives |= {"CL_de": power * share, "Cm_de": -power * volume}
    return derivatives


def _lateral(aircraft: "Aircraft", s: HandbookShape) -> dict[str, float]:
    """Fin: Etkin and Reid sections 3.8 to 3.11. Wing: lifting line, and strips for terms that depend on lift."""
    aspect = aircraft.span**2 / aircraft.area
    wing, fin = lift_slope(aspect, s.sweep), TAIL_PRESSURE * _surface(s.fin_area, s.fin_span)
    lift = aircraft.mass * GRAVITY / (0.5 * SEA_LEVEL_DENSITY * s.speed**2 * aircraft.area)
    share, arm, height = s.fin_area / aircraft.area, s.fin_arm / aircraft.span, s.fin_height / aircraft.span
    middle = (1.0 + 2.0 * s.taper) / (6.0 * (1.0 + s.taper))  # mean of |y|/b over the wing's area
    outer = (1.0 + 3.0 * s.taper) / (12.0 * (1.0 + s.taper))  # mean of 2 (y/b)^2 over it
    derivatives = {
        "CY_0": 0.0,
        "CY_beta": -fin * share,
        "CY_p": -2.0 * fin * share * height,
        "CY_r": 2.0 * fin * share * arm,
        "Cl_0": 0.0,
        "Cl_beta": -s.dihedral * wing_moment(aspect, s.taper, wing, _sideslipping)
        - lift * math.tan(s.sweep) * middle
        - fin * share * height,
        "Cl_p": -wing_moment(aspect, s.taper, wing, _rolling) - 2.0 * fin * share * height**2,
        "Cl_r": 2.0 * lift * outer + 2.0 * fin * share * arm * height,
        "Cl_da": -flap_effectiveness(s.aileron_flap) * wing_moment(aspect, s.taper, wing, partial(_aileron, s.aileron)),
        "Cn_0": 0.0,
        "Cn_beta": fin * share * arm,
        "Cn_p": -lift * outer + 2.0 * fin * share * arm * height,
        "Cn_r": -2.0 * fin * share * arm**2 - 2.0 * CD_0 * outer,
    }
    if s.fin_area:
        power = fin * flap_effectiveness(s.rudder_flap) * share
        derivatives |= {"CY_dr": power, "Cl_dr": power * height, "Cn_dr": -power * arm}
    return derivatives


def wing_moment(aspect: float, taper: float, slope: float, angle: Callable[[Array], Array]) -> float:
    """Rolling moment coefficient of a straight-tapered wing by the lifting line, + towards the side where `angle` is negative.

    angle: angle of attack [rad] as a function of y over the half span (-1 .. 1), odd in it. The series is scaled from the
    line's own lift slope to `slope`, which is right for small aspect ratios and sweep too.
    """
    n = np.arange(1, POINTS + 1)
    theta = (n - 0.5) * math.pi / POINTS
    y = np.cos(theta)
    chord = 2.0 * (1.0 - (1.0 - taper) * np.abs(y)) / ((1.0 + taper) * aspect)  # over the span
    mu = 2.0 * math.pi * chord / 4.0
    system = np.sin(np.outer(theta, n)) * (np.outer(mu, n) + np.sin(theta)[:, None])
    twisted, straight = np.linalg.solve(
        system, np.stack([angle(y), np.ones(POINTS)], 1) * (mu * np.sin(theta))[:, None]
    ).T
    return float(0.25 * math.pi * aspect * twisted[1] * slope / (math.pi * aspect * straight[0]))


def _rolling(y: Array) -> Array:
    """Angle of attack of a rolling wing: p y / V is p_hat times y over the half span."""
    return y


def _sideslipping(y: Array) -> Array:
    """Angle of attack of a wing with dihedral in sideslip."""
    return np.sign(y)


def _aileron(ends: tuple[float, float], y: Array) -> Array:
    """Angle of attack of a wing with ailerons deflected between `ends` of the half span."""
    return np.where((np.abs(y) > ends[0]) & (np.abs(y) < ends[1]), np.sign(y), 0.0)
