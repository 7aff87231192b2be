"""What a derivative of an aeroplane can be, by its class: signs, sizes, static margin. In the conventions of this house.

Ranges are the widest of the tables of J. Roskam, Airplane Flight Dynamics and Automatic Flight Controls I (appendix B and C:
ten aeroplanes from Cessna 182 to F-4 and 747), R. C. Nelson, Flight Stability and Automatic Control (appendix B), B. W.
McCormick, Aerodynamics, Aeronautics and Flight Mechanics (chapter 9-10) and USAF Stability and Control Datcom, half as much
again added; signs are theirs, turned where the house counts a control the other way (+delta_a rolls left, +delta_r yaws
left). An unstable aeroplane is one still: stiffnesses may have either sign, dampings in roll, pitch and yaw may not.
"""

import math
from collections.abc import Iterator, Mapping

from estimation.estimators.result import Estimate, Result
from estimation.models.library import BUILDERS

SURE = 3.0  # bounds by which a value must lie beyond what can be
SLENDER = 3.0  # aspect ratio below which lift slope and roll damping are those of slender wings (Datcom 4.1.3.2)

RANGES: Mapping[str, tuple[float, float]] = {
    "CY_beta": (-3.0, 0.0), "CY_p": (-1.5, 1.5), "CY_r": (-1.0, 2.5), "CY_da": (-0.3, 0.3), "CY_dr": (0.0, 1.0),
    "Cl_beta": (-0.6, 0.2), "Cl_p": (-1.0, 0.0), "Cl_r": (-0.2, 0.9), "Cl_da": (-0.8, 0.0), "Cl_dr": (-0.15, 0.2),
    "Cn_beta": (-0.3, 0.9), "Cn_p": (-0.6, 0.4), "Cn_r": (-1.5, 0.0), "Cn_da": (-0.15, 0.15), "Cn_dr": (-0.6, 0.0),
    "CL_alpha": (1.5, 8.5), "CL_q": (-15.0, 40.0), "CL_de": (-1.0, 3.0), "CD_0": (0.0, 0.3), "CD_k": (0.0, 0.8),
    "Cm_alpha": (-8.0, 3.0), "Cm_q": (-80.0, 0.0), "Cm_de": (-6.0, 0.0),
}  # fmt: skip
"""Derivative -> least and greatest of any aeroplane, per rad and of rates as p b / 2V, q c / 2V, r b / 2V."""

OF_SLENDER: Mapping[str, tuple[float, float]] = {"CL_alpha": (0.8, 5.0), "Cl_p": (-0.8, 0.0)}
"""The same of wings of small aspect ratio, where they differ."""

MARGIN = (-0.4, 1.5)  # of the chord: static margin of canards and relaxed stability, of tails far aft

FIN_ARM = 0.6
"""Of the span, the longest arm of a fin: side force by yaw rate is that of a fin which sideslip pushes with CY_beta at most
(Roskam, Airplane Design VI, 10.2.8: CY_r = 2 l_v/b a_v). The tables above and 47 aircraft of JSBSim have 0.44 at most."""
WING = 0.1  # of CY_r, what wing and body may add

CONTROLS = {"da": "delta_a", "dr": "delta_r", "de": "delta_e"}


def implausible_derivatives(result: Result, aspect: float = math.nan) -> Iterator[str]:
    """Sentences on derivatives of a built-in model that no aeroplane has; aspect: ratio of the wing."""
    if result.model.name not in BUILDERS:
        return
    ranges = {**RANGES, **(OF_SLENDER if aspect < SLENDER else {})}
    for name, e in result.parameters.items():
        if name in ranges and e.identifiable and (text := _beyond(e, *ranges[name])):
            yield f"{text}{_hint(name, e)}"
    yield from _static_margin(result)
    yield from _fin_arm(result)


def _beyond(e: Estimate, low: float, high: float) -> str:
    room = SURE * e.std_coloured
    if low - room <= e.estimate <= high + room:
        return ""
    return f"{e.name} = {e.estimate:.3g} +- {e.std_coloured:.2g} is no aeroplane's ({low:g} to {high:g})"


def _hint(name: str, e: Estimate) -> str:
    """What to look at."""
    control = CONTROLS.get(name.partition("_")[2])
    if control is not None and (RANGES[name][0] == 0.0 or RANGES[name][1] == 0.0):
        return f": is the sign of {control} turned, or its unit another?"
    return ": a column, a constant of the aircraft or what moves the controls is not what it is taken for"


def _static_margin(result: Result) -> Iterator[str]:
    lift, pitch = result.parameters.get("CL_alpha"), result.parameters.get("Cm_alpha")
    if lift is None or pitch is None or not (lift.identifiable and pitch.identifiable) or lift.estimate <= 0.0:
        return
    margin = -pitch.estimate / lift.estimate
    room = SURE * pitch.std_coloured / lift.estimate
    if not MARGIN[0] - room <= margin <= MARGIN[1] + room:
        yield f"static margin {margin:.2g} of the chord is no aeroplane's ({MARGIN[0]:g} to {MARGIN[1]:g})"


def _fin_arm(result: Result) -> Iterator[str]:
    """A damper that moves the rudder behind its record makes of the aeroplane one whose fin is farther aft than any."""
    side, by_rate = result.parameters.get("CY_beta"), result.parameters.get("CY_r")
    if side is None or by_rate is None or not (side.identifiable and by_rate.identifiable):
        return
    most = 2.0 * FIN_ARM * (abs(side.estimate) + SURE * side.std_coloured) + WING
    if abs(by_rate.estimate) - SURE * by_rate.std_coloured > most:
        yield (
            f"CY_r = {by_rate.estimate:.3g} +- {by_rate.std_coloured:.2g} is no fin's beside CY_beta = {side.estimate:.3g}"
            f" ({most:.2g} at most): does something move the rudder behind its record, such as a yaw damper?"
        )
