"""Conventions of an estimate: signs, units, axes, and the constants of the aircraft that it uses."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from estimation.models.library import BUILDERS
from estimation.report.tables import ReportTable
from estimation.session.stated_uncertainty import airspeed_share

if TYPE_CHECKING:
    from estimation.session.session import EstimationSession

AXES = "body axes through the CG: x forward, y right, z down; moments about the CG"
UNITS = (
    "derivatives per rad; rates as p b/2V, q c/2V, r b/2V; V m/s, forces by q_dyn S, moments by"
    " q_dyn S b (Cl, Cn) and q_dyn S c (Cm)"
)
SIGNS = (
    "+delta_e trailing edge down (nose down), +delta_a rolls left, +delta_r trailing edge to port (force to +y, nose left);"
    " +beta wind from the right, +ay specific force to the right"
)
DAMPERS = {"delta_r": ("r", "yaw", "Cn_r and CY_r"), "delta_e": ("q", "pitch", "Cm_q")}
"""Control -> the rate that its damper feeds back, the axis, and the derivatives that such a damper changes."""
OWN = "as the equations of the model have them (a model of one's own)"
CONSTANTS = {
    "S": "m2",
    "b": "m",
    "c": "m",
    "m": "kg",
    "Ixx": "kg m2",
    "Iyy": "kg m2",
    "Izz": "kg m2",
    "Ixz": "kg m2",
    "g": "m/s2",
}


def conventions(session: "EstimationSession") -> Iterator[tuple[str, str]]:
    """(subject, convention) of everything one has to know to use the numbers elsewhere."""
    built_in = session.model.name in BUILDERS
    yield "axes", AXES if built_in else OWN
    yield "units", UNITS if built_in else OWN
    yield "signs", SIGNS if built_in else OWN
    if built_in and (dampers := _dampers(session)):
        yield "controls", f"as recorded; {dampers}: where one runs, record the surface itself"
    constants = session.model.constants
    constant_texts = [
        f"{n} {constants[n]:.6g} {unit}"
        for n, unit in CONSTANTS.items()
        if n in constants and math.isfinite(constants[n])
    ]
    yield "constants", ", ".join(constant_texts) or "none"
    if stated := _stated(session):
        yield "corrected bounds", f"also count {stated}, which no residual shows"
    yield "CG", _centre(session)
    yield "aircraft", session.aircraft.title or session.aircraft.name
    yield "beliefs before", _sources(session)


def _stated(session: "EstimationSession") -> str:
    """The stated uncertainties that the corrected bounds include, in words; empty without any."""
    of_airspeed = max((airspeed_share(f.flight) for f in session.flights), default=0.0)
    counted = [f"the airspeed's calibration ({of_airspeed:.1%} of each derivative)"] if of_airspeed else []
    if session.aircraft.uncertainty:
        counted.append("what the aircraft file states of mass, inertia and geometry")
    return " and ".join(counted)


def _dampers(session: "EstimationSession") -> str:
    """A warning of dampers that the records of the controls do not show (docs/validation.md has the limits)."""
    known = {*session.model.input_names, *session.model.state_names}
    return "; ".join(
        f"a {axis} damper behind the record passes for {names} unless it is strong and washed out"
        for control, (rate, axis, names) in DAMPERS.items()
        if {control, rate} <= known
    )


def _centre(session: "EstimationSession") -> str:
    place = session.aircraft.cg_from_nose
    return (
        "not stated in the aircraft file" if place is None else f"{place:g} m aft of the nose, as in the aircraft file"
    )


def _sources(session: "EstimationSession") -> str:
    """Sources of the beliefs before flying, and which of them enter the fit."""
    parameters = session.model.parameters
    shown = [p for p in parameters if p.reference is not None and p.prior_std is None]
    sources = dict.fromkeys(p.reference_source for p in shown if p.reference_source)
    entered = [f"{name} {p['mean']:g} +- {p['std']:g}" for name, p in priors(session).items()]
    source_text = f"{', '.join(sources)} (beside the estimates; they do not enter)" if sources else "none"
    return source_text + (f"; entering the fit as priors: {', '.join(entered)}" if entered else "")


def priors(session: "EstimationSession") -> dict[str, dict[str, float]]:
    """Parameter -> mean and standard deviation of the prior that enters the fit, in its own unit."""
    return {
        p.name: {"mean": p.prior_mean or 0.0, "std": p.prior_std}
        for p in session.model.parameters
        if p.prior_std is not None and not p.fixed
    }


def conventions_table(session: "EstimationSession") -> ReportTable:
    """The conventions as a table."""
    return ReportTable(
        "conventions",
        "Conventions and constants of the estimates",
        ("what", "how"),
        tuple(conventions(session)),
        symbols=False,
        texts=(1,),
    )


def conventions_lines(session: "EstimationSession") -> Iterator[str]:
    """The conventions as printed lines."""
    for subject, meaning in conventions(session):
        if meaning != OWN or subject == "units":
            yield f"  {subject}: {meaning}"
