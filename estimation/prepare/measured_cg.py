"""Centre of gravity as a history, as fuel leaves a forward tank or a load is dropped, where a flight has a column `cg_x` [m].

cg_x is the distance of the CG ahead of the aircraft file's. Derivatives stay about the file's CG; moments about the present CG
add arm times force, Cm + cg_x/c CZ and Cn - cg_x/b CY. Readings of vanes and accelerometers are transferred to the present CG,
while coefficients depend on the flow at the file's CG, which differs by the rotation. Inertia stays the file's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import CG as COLUMN
from daq.identification.airframe import FARTHEST_CG
from daq.identification.moved_cg import at_moved_cg
from estimation.errors import DataError
from estimation.models.base import Model, renamed
from estimation.models.expressions import names_in, without_addends_of
from estimation.models.parts import Signal
from groundstation.flight import Flight

ARMS: Mapping[str, tuple[str, str, str]] = {"Cm": ("+", "c", "CZ"), "Cn": ("-", "b", "CY")}
"""Moment -> sign, length and force of its arm."""
FLOW: Mapping[str, str] = {f"{c}_alpha": f" + {c}_alpha*cg_x*q/V" for c in ("CL", "Cm")} | {
    f"{c}_beta": f" - {c}_beta*cg_x*r/V" for c in ("CY", "Cl", "Cn")
}
"""Derivative by a flow angle -> its addend for the difference between the angle at the file's CG and at the present one."""


def cg_history(flight: Flight, span: float) -> NDArray[np.float64]:
    """(N,) distance [m] of the CG ahead of the aircraft file's, on straight lines between readings; zero without such a column.

    Raises DataError for one beyond FARTHEST_CG of the span.
    """
    if not flight.measured(COLUMN):
        return np.zeros(len(flight))
    values = np.asarray(flight[COLUMN], float)
    known = np.isfinite(values)
    farthest = float(np.abs(values[known]).max())
    if farthest >= FARTHEST_CG * span:
        raise DataError(
            f"{flight.name}: column {COLUMN} has {farthest:.4g} m; it counts from the aircraft file's CG, forward, in metres, and"
            f" more than {FARTHEST_CG * span:.3g} m, a tenth of the span, is none"
        )
    return np.interp(flight.time, flight.time[known], values[known])


def with_cg_history(model: Model, flights: Sequence[Flight]) -> tuple[Model, tuple[Flight, ...], tuple[str, ...]]:
    """The model with moments about the measured CG, the flights with their motion there, and a note; all unchanged where no
    flight has such a column, or the model has no line for such a moment and its force. Raises as `cg_history`."""
    moments = [m for m in ARMS if _has_moment_and_force(model, m)]
    if not any(f.measured(COLUMN) for f in flights):
        return model, tuple(flights), ()
    if not moments or "b" not in model.constants:
        return (
            model,
            tuple(flights),
            (f"column {COLUMN} is not taken: the model has no lines for moment and force about it",),
        )
    span = model.constants["b"]
    histories = [cg_history(f, span) for f in flights]
    lines = dict(model.definitions)
    for moment in moments:
        users = [n for n, text in lines.items() if moment in names_in(text)]
        lines |= {n: renamed(lines[n], moment, _about_cg(moment)) for n in users}
    new_lines = {
        _about_cg(m): f"{m} {sign} {COLUMN}/{length}*{force}" for m in moments for sign, length, force in [ARMS[m]]
    }
    symbols = {*model.state_names, *model.input_names, *lines}
    for derivative, addend in FLOW.items():
        line = derivative.partition("_")[0]
        rate_and_speed = names_in(addend[len(" + ") :]) - {COLUMN, derivative}
        if line in lines and derivative in names_in(lines[line]) and rate_and_speed <= symbols:
            lines[line] += addend
    signal = Signal(
        COLUMN, "m", "of the centre of gravity ahead of the aircraft file's, as it was in flight", computed=True
    )
    changed = replace(
        model,
        inputs=(*model.inputs, signal),
        equations=tuple(f"{name} = {text}" for name, text in {**lines, **new_lines}.items()),
    )
    at_present_cg = tuple(
        f.with_columns(**{COLUMN: h}, **at_moved_cg(f.columns, f.time, h))
        for f, h in zip(flights, histories, strict=True)
    )
    least, greatest = min(h.min() for h in histories), max(h.max() for h in histories) + 0.0  # no -0
    note = (
        f"centre of gravity as measured, {least:+.3g} to {greatest:+.3g} m ahead of the aircraft file's; derivatives are about"
        " the file's"
    )
    return changed, at_present_cg, (note,)


def at_stated_cg(model: Model) -> Model:
    """The model for other flights, about the aircraft file's CG."""
    if COLUMN not in model.input_names:
        return model
    lines = {n: text for n, text in model.definitions.items() if n not in map(_about_cg, ARMS)}
    lines = {n: without_addends_of(text, COLUMN) if COLUMN in names_in(text) else text for n, text in lines.items()}
    for moment in ARMS:
        lines = {n: renamed(text, _about_cg(moment), moment) for n, text in lines.items()}
    inputs = tuple(s for s in model.inputs if s.name != COLUMN)
    return replace(model, inputs=inputs, equations=tuple(f"{name} = {text}" for name, text in lines.items()))


def _has_moment_and_force(model: Model, moment: str) -> bool:
    _, length, force = ARMS[moment]
    return moment in model.definitions and force in model.definitions and length in model.constants


def _about_cg(moment: str) -> str:
    return f"{moment}_cg"
