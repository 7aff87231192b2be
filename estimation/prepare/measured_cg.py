"""Centre of gravity as a history: fuel out of a tank ahead, a load that is dropped, where a flight has a column `cg_x` [m].

It says how far the CG lies ahead of the aircraft file's. Derivatives stay about the file's; moments about the CG of the moment
are those and the arm times the force, Cm + cg_x/c CZ and Cn - cg_x/b CY, and what vanes and accelerometers show is carried
there; coefficients go by the flow at the file's, where it turns with the aircraft. Inertia stays the file's.
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
"""Derivative by an angle -> what it makes of the angle at the file's CG beyond that at the CG of the moment."""


def cg_history(flight: Flight, span: float) -> NDArray[np.float64]:
    """(N,) [m] ahead of the aircraft file's CG, zero for a flight without such a column; between readings by lines.

    Raises DataError for one further off than a tenth of the span.
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
    """The model with moments about the flights' own CG, the flights with their motion there, and a note that says so; all as they
    were where no flight has a column for it, or the model no line for such a moment and its force. Raises as `cg_history`."""
    moments = [m for m in ARMS if _has_arm(model, m)]
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
        turning = names_in(addend[3:]) - {COLUMN, derivative}
        if line in lines and derivative in names_in(lines[line]) and turning <= symbols:
            lines[line] += addend
    signal = Signal(
        COLUMN, "m", "of the centre of gravity ahead of the aircraft file's, as it was in flight", computed=True
    )
    changed = replace(
        model,
        inputs=(*model.inputs, signal),
        equations=tuple(f"{name} = {text}" for name, text in {**lines, **new_lines}.items()),
    )
    moved = tuple(
        f.with_columns(**{COLUMN: h}, **at_moved_cg(f.columns, f.time, h))
        for f, h in zip(flights, histories, strict=True)
    )
    least, greatest = min(h.min() for h in histories), max(h.max() for h in histories) + 0.0  # no -0
    note = (
        f"centre of gravity as measured, {least:+.3g} to {greatest:+.3g} m ahead of the aircraft file's; derivatives are about"
        " the file's"
    )
    return changed, moved, (note,)


def at_stated_cg(model: Model) -> Model:
    """The model for flights to come, about the aircraft file's CG; a history has its place again where such a flight is given."""
    if COLUMN not in model.input_names:
        return model
    lines = {n: text for n, text in model.definitions.items() if n not in map(_about_cg, ARMS)}
    lines = {n: without_addends_of(text, COLUMN) if COLUMN in names_in(text) else text for n, text in lines.items()}
    for moment in ARMS:
        lines = {n: renamed(text, _about_cg(moment), moment) for n, text in lines.items()}
    inputs = tuple(s for s in model.inputs if s.name != COLUMN)
    return replace(model, inputs=inputs, equations=tuple(f"{name} = {text}" for name, text in lines.items()))


def _has_arm(model: Model, moment: str) -> bool:
    _, length, force = ARMS[moment]
    return moment in model.definitions and force in model.definitions and length in model.constants


def _about_cg(moment: str) -> str:
    return f"{moment}_cg"
