"""A model of all six coefficients, nonlinear as it may be: the model file's own lines, what it lacks from stated beliefs."""

import math
from pathlib import Path
from typing import Any

from estimation.aircraft import Aircraft, load_aircraft
from estimation.models.base import Model
from estimation.models.library import not_in_model, six_dof, stated_terms
from estimation.simulation.autopilot.gathering import (
    FIELDS,
    KEYS,
    MINOR,
    NEEDED,
    MissingPartsError,
    Stated,
    asked_for,
    body_of,
    lines_named,
    source_of,
)
from estimation.simulation.autopilot.linear import LINES
from estimation.simulation.autopilot.neutral import BuildUp
from estimation.simulation.oracle import SimulationError

BODY_AXES = ("CX", "CZ")


def whole_model(path: Path, stated: Stated) -> tuple[BuildUp, Aircraft, dict[str, Any]]:
    """Build-up, body, and what is to be told beside them. Raises MissingPartsError with the list of what nobody states."""
    source = source_of(path)
    beside = source if isinstance(source, Aircraft) else load_aircraft(stated.aircraft) if stated.aircraft else None
    model = None if isinstance(source, Aircraft) else source
    body = body_of(model, beside) if model is not None else source
    assert isinstance(body, Aircraft)
    has = lines_named(path, model) if model is not None else ()
    lacking = [c for c in LINES if c not in has]
    beliefs = beside.derivatives if beside is not None else {}
    missing = [key for key, field in zip(KEYS, FIELDS, strict=True) if math.isnan(getattr(body, field))]
    missing += [n for line in lacking for n in NEEDED[line] if n not in beliefs]
    if missing:
        raise MissingPartsError(asked_for(path, "a whole aircraft", missing, beside))
    stated_by = (beside or body).with_values(**_numbers(body))
    base = stated_terms(six_dof(stated_by), stated_by)
    zero = [n for line in lacking for n in MINOR[line] if n not in beliefs]
    more = {
        "throws": {n: list(t) for n, t in {**(beside.throws if beside else {}), **stated.throws}.items()},
        "thrust": _thrust(beside, stated),
        "sources": {n: beliefs[n].source for line in lacking for n in beliefs if n.split("_")[0] == line},
        "notes": _notes(zero, [n for n in not_in_model(base, stated_by) if n.partition("_")[0] in lacking]),
    }
    return _joined(body, model, base, has), body, more


def _notes(zero: list[str], strange: list[str]) -> list[str]:
    notes = [f"nobody states, so zero: {', '.join(zero)}"] if zero else []
    return [*notes, f"left out, for no form of them is known: {', '.join(strange)}"] if strange else notes


def _numbers(body: Aircraft) -> dict[str, float]:
    return {f: getattr(body, f) for f in FIELDS}


def _thrust(beside: Aircraft | None, stated: Stated) -> float | None:
    if stated.thrust is not None or beside is None or beside.engine is None:
        return stated.thrust
    return beside.engine.static_thrust


def _joined(body: Aircraft, model: Model | None, base: Model, has: tuple[str, ...]) -> BuildUp:
    """The model's own lines and, beside them, those of the base for what it has none of. Raises SimulationError where a name
    would mean two things."""
    wanted = [c for c in LINES if c not in has]
    turned = BODY_AXES if {"CL", "CD"} & set(wanted) else ()
    own = model.definitions if model is not None else {}
    more = {n: base.definitions[n] for n in (*wanted, *turned, *(("p_hat", "q_hat", "r_hat") if wanted else ()))}
    more |= {n: base.definitions[n] for n in BODY_AXES if n not in own}
    clash = [n for n in more if n in own and n not in turned and own[n] != more[n]]
    if clash:
        raise SimulationError(
            f"model {body.name}: its line {clash[0]} is not what the coefficients that it lacks mean by that name"
            f" ({more[clash[0]]}); call it otherwise"
        )
    numbers = {**base.constants, **base.starts()}
    parameters = base.parameters
    if model is not None:
        numbers |= {**model.constants, **model.starts()}
        parameters = (*parameters, *model.parameters)
    return BuildUp(body.name, body.title, {**own, **more}, numbers, {p.name: p.unit for p in parameters})
