"""Plausible derivatives of an aeroplane: signs, sizes, static margin, fin arm, yaw by aileron. Signs as in this project.

Ranges are the widest in the tables of J. Roskam, Airplane Flight Dynamics and Automatic Flight Controls I (appendix B and C:
ten aeroplanes from Cessna 182 to F-4 and 747), R. C. Nelson, Flight Stability and Automatic Control (appendix B), B. W.
McCormick, Aerodynamics, Aeronautics and Flight Mechanics (chapter 9-10) and USAF Stability and Control Datcom, widened by half.
Signs are reversed where the project counts a control the other way (+delta_a rolls left, +delta_r yaws left). Aeroplanes may be
unstable: stiffnesses may have either sign, dampings in roll, pitch and yaw may not.
"""

import math
from collections.abc import Iterator, Mapping

from estimation.estimators.result import Estimate, Result
from estimation.models.library import BUILDERS

SURE = 3.0  # bounds by which a value must lie outside its range
SLENDER = 3.0  # aspect ratio below which lift slope and roll damping are those of slender wings (Datcom 4.1.3.2)

RANGES: Mapping[str, tuple[float, float]] = {
    "CY_beta": (-3.0, 0.0), "CY_p": (-1.5, 1.5), "CY_r": (-1.0, 2.5), "CY_da": (-0.3, 0.3), "CY_dr": (0.0, 1.0),
    "Cl_beta": (-0.6, 0.2), "Cl_p": (-1.0, 0.0), "Cl_r": (-0.2, 0.9), "Cl_da": (-0.8, 0.0), "Cl_dr": (-0.15, 0.2),
    "Cn_beta": (-0.3, 0.9), "Cn_p": (-0.6, 0.4), "Cn_r": (-1.5, 0.0), "Cn_da": (-0.15, 0.15), "Cn_dr": (-0.6, 0.0),
    "CL_alpha": (1.5, 8.5), "CL_q": (-15.0, 40.0), "CL_de": (-1.0, 3.0), "CD_0": (0.0, 0.3), "CD_k": (0.0, 0.8),
    "Cm_alpha": (-8.0, 3.0), "Cm_q": (-80.0, 0.0), "Cm_de": (-6.0, 0.0),
}  # fmt: skip
"""Derivative -> least and greatest of any aeroplane, per rad; rates as p b / 2V, q c / 2V, r b / 2V."""

SLENDER_RANGES: Mapping[str, tuple[float, float]] = {"CL_alpha": (0.8, 5.0), "Cl_p": (-0.8, 0.0)}
"""Ranges of slender wings where they differ."""

STATIC_MARGIN = (-0.4, 1.5)  # of the chord: from canards with relaxed stability to tails far aft

FIN_ARM = 0.6
"""Longest arm of a fin over the span. The fin makes CY_r = 2 l_v/b a_v (Roskam, Airplane Design VI, 10.2.8), where a_v is at most
the size of CY_beta. The tables above and 47 aircraft of JSBSim have 0.44 at most."""
WING_CY_R = 0.1  # contribution of wing and body to CY_r

YAW_BY_AILERON = 0.4
"""Most yaw by aileron over roll by aileron. Of 47 aircraft of JSBSim 42 have 0.34 (a sailplane) and less, triplanes and wings
with elevons 0.42 to 0.73; another product of inertia passes for it, so that there the flights alone do not tell."""

CONTROLS = {"da": "delta_a", "dr": "delta_r", "de": "delta_e"}


def implausible_derivatives(result: Result, aspect: float = math.nan) -> Iterator[str]:
    """Sentences on derivatives of a built-in model that no aeroplane has. aspect: the wing's aspect ratio, NaN where unknown."""
    if result.model.name not in BUILDERS:
        return
    ranges = {**RANGES, **(SLENDER_RANGES if aspect < SLENDER else {})}
    for name, e in result.parameters.items():
        if name in ranges and e.identifiable and (text := _beyond(e, *ranges[name])):
            yield f"{text}{_hint(name, e)}"
    yield from _static_margin(result)
    yield from _fin_arm(result)
    yield from _yaw_by_aileron(result)


def _beyond(e: Estimate, low: float, high: float) -> str:
    """A sentence where an estimate lies outside a range by more than SURE bounds; else empty."""
    margin = SURE * e.std_coloured
    if low - margin <= e.estimate <= high + margin:
        return ""
    return f"{e.name} = {e.estimate:.3g} +- {e.std_coloured:.2g} is no aeroplane's ({low:g} to {high:g})"


def _hint(name: str, e: Estimate) -> str:
    """End of the sentence: what to check."""
    control = CONTROLS.get(name.partition("_")[2])
    if control is not None and (RANGES[name][0] == 0.0 or RANGES[name][1] == 0.0):
        return f": is the sign of {control} turned, or its unit another?"
    return ": a column, a constant of the aircraft or what moves the controls is not what it is taken for"


def _static_margin(result: Result) -> Iterator[str]:
    lift, pitch = result.parameters.get("CL_alpha"), result.parameters.get("Cm_alpha")
    if lift is None or pitch is None or not (lift.identifiable and pitch.identifiable) or lift.estimate <= 0.0:
        return
    margin = -pitch.estimate / lift.estimate
    uncertainty = SURE * pitch.std_coloured / lift.estimate
    low, high = STATIC_MARGIN
    if not low - uncertainty <= margin <= high + uncertainty:
        yield f"static margin {margin:.2g} of the chord is no aeroplane's ({low:g} to {high:g})"


def _fin_arm(result: Result) -> Iterator[str]:
    """A yaw damper that is not in the rudder's record makes the fin appear farther aft than any aeroplane's."""
    side, by_rate = result.parameters.get("CY_beta"), result.parameters.get("CY_r")
    if side is None or by_rate is None or not (side.identifiable and by_rate.identifiable):
        return
    most = 2.0 * FIN_ARM * (abs(side.estimate) + SURE * side.std_coloured) + WING_CY_R
    if abs(by_rate.estimate) - SURE * by_rate.std_coloured > most:
        yield (
            f"CY_r = {by_rate.estimate:.3g} +- {by_rate.std_coloured:.2g} is no fin's beside CY_beta = {side.estimate:.3g}"
            f" ({most:.2g} at most): does something move the rudder behind its record, such as a yaw damper?"
        )


def _yaw_by_aileron(result: Result) -> Iterator[str]:
    """A wrong product of inertia turns part of every rolling moment into yaw, and flights near level show nothing else of it."""
    roll, yaw = result.parameters.get("Cl_da"), result.parameters.get("Cn_da")
    if roll is None or yaw is None or not (roll.identifiable and yaw.identifiable):
        return
    if abs(yaw.estimate) - SURE * yaw.std_coloured <= YAW_BY_AILERON * (abs(roll.estimate) + SURE * roll.std_coloured):
        return
    Ixx, Izz, Ixz = (result.model.constants[n] for n in ("Ixx", "Izz", "Ixz"))
    # the product of inertia with which the same accelerations need no yawing moment
    without = Izz * (Ixx * yaw.estimate + Ixz * roll.estimate) / (Izz * roll.estimate + Ixz * yaw.estimate)
    yield (
        f"Cn_da = {yaw.estimate:.3g} +- {yaw.std_coloured:.2g} is {abs(yaw.estimate / roll.estimate):.2g} of Cl_da, and few "
        f"ailerons yaw by more than {YAW_BY_AILERON:g}: is Ixz = {Ixz:.2g} kg m2 right? With {without:.2g} they would not yaw"
    )
