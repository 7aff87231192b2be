"""Controls that only answer the motion: of these no flight tells when they move, nor whether they have play.

A pilot or an autopilot who holds an attitude moves the elevator as the gusts move the aircraft. What the record then shows of the
control is the motion again, and gusts, which no model knows, with it: put late by a quarter of a second such an elevator explains
some of the gusts, the same in every flight. No null shows that, for nobody steers a null. Steps and slower moves of its own say
when a control moves; without any the question is not asked.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect
from estimation.gap.records.flight_records import FlightRecord
from estimation.models.base import Model

LATE = (0.0, 0.05, 0.1, 0.15, 0.2)  # s: a hand, or an autopilot with its servo, is late by these and what lies between
ENOUGH = 4  # samples for each of its regressors: a record with fewer says nothing


def only_following(records: Sequence[FlightRecord], model: Model, criteria: Criteria) -> tuple[str, ...]:
    """Controls of `model` that follow the measured motion on every record, but for less than a share of their noise."""
    controls = [s.name for s in model.inputs if s.control]
    return tuple(n for n in controls if all(_follows(r, n, criteria) for r in records))


def words_on(control: str) -> str:
    """What a person has to know of such a control."""
    return f"{control} rests or only follows the motion: whether it is late or has play is not asked; move it by itself, in steps"


def _follows(record: FlightRecord, control: str, criteria: Criteria) -> bool:
    noise = record.input_noise.get(control, 0.0)
    motion = motion_regressors(record)
    if noise <= 0.0 or len(record) < ENOUGH * motion.shape[1]:
        return False
    return own_motion(record.inputs[control], motion) < criteria.own_motion * noise


def own_motion(values: Array, motion: Array) -> float:
    """Rms of what a control (N,) does besides regressors (N, k)."""
    scale = np.abs(motion).max(axis=0)
    columns = motion[:, scale > 0.0] / scale[scale > 0.0]
    residual = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    return float(np.sqrt(residual @ residual / (len(values) - columns.shape[1])))


def motion_regressors(record: FlightRecord) -> Array:
    """(N, k) what a control may follow: a straight line, the measured states now and a little before, and their integrals."""
    count = len(record)
    line = np.vander(np.linspace(-1.0, 1.0, count), 2)
    if record.states is None:
        return line
    states = record.states[:, np.isfinite(record.states).all(axis=0)]
    step = float(np.median(np.diff(record.time)))
    delays = sorted({round(t / step) for t in LATE})
    delayed = [np.concatenate([states[:1].repeat(k, 0), states[: count - k]]) for k in delays]
    return np.column_stack([line, *delayed, np.cumsum(states - states.mean(axis=0), axis=0)])


def without_hardware_of(
    effects: Sequence[Effect], controls: Collection[str]
) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
    """(effects less the forms that say how these controls move, effects that have no form left)."""
    applicable, removed = [], []
    for effect in effects:
        forms = tuple(f for f in effect.forms if not f.transforms or any(t.input not in controls for t in f.transforms))
        if len(forms) == len(effect.forms):
            applicable.append(effect)
        elif forms:
            applicable.append(replace(effect, forms=forms))
        else:
            removed.append(effect)
    return tuple(applicable), tuple(removed)
