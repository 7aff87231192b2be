"""Controls that only follow the motion: such flights cannot show when the control moves, or whether it has play.

A pilot or an autopilot that holds an attitude moves the elevator as the gusts move the aircraft. The recorded elevator then holds
the motion again, and with it the gusts, which no model knows: delayed by a quarter of a second such an elevator explains some of
the gusts, the same in every flight. No simulated null shows this, for nobody steers a null. Only steps and slow moves that are
not an answer to the motion show when a control moves. Without them, delays and play of the control are no hypotheses.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect
from estimation.gap.records.flight_records import FlightRecord
from estimation.models.base import Model

LATE = (0.0, 0.05, 0.1, 0.15, 0.2)  # s: delays of a hand, or of an autopilot with its servo
ENOUGH = 4  # samples per regressor: a shorter record shows nothing


def only_following(records: Sequence[FlightRecord], model: Model, criteria: Criteria) -> tuple[str, ...]:
    """Controls of `model` that follow the measured motion on every record, to less than `criteria.own_motion` of their noise."""
    controls = [s.name for s in model.inputs if s.control]
    return tuple(n for n in controls if all(_follows(r, n, criteria) for r in records))


def words_on(control: str) -> str:
    """The note on such a control."""
    return (
        f"{control} rests or only follows the motion: its delay and play are not searched; move it by itself, in steps"
    )


def _follows(record: FlightRecord, control: str, criteria: Criteria) -> bool:
    noise = record.input_noise.get(control, 0.0)
    motion = motion_regressors(record)
    if noise <= 0.0 or len(record) < ENOUGH * motion.shape[1]:
        return False
    return own_motion(record.inputs[control], motion) < criteria.own_motion * noise


def own_motion(values: Array, motion: Array) -> float:
    """Rms of the part of a control (N,) that regressors (N, k) do not explain."""
    scale = np.abs(motion).max(axis=0)
    columns = motion[:, scale > 0.0] / scale[scale > 0.0]
    residual = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    return float(np.sqrt(residual @ residual / (len(values) - columns.shape[1])))


def motion_regressors(record: FlightRecord) -> Array:
    """(N, k) what a control may follow: a straight line, the measured states now and shortly before, their integrals."""
    count = len(record)
    line = np.vander(np.linspace(-1.0, 1.0, count), 2)
    if record.states is None:
        return line
    states = record.states[:, np.isfinite(record.states).all(axis=0)]
    step = record.interval
    delays = sorted({round(t / step) for t in LATE})
    delayed = [np.concatenate([states[:1].repeat(k, 0), states[: count - k]]) for k in delays]
    return np.column_stack([line, *delayed, np.cumsum(states - states.mean(axis=0), axis=0)])


def without_hardware_of(
    effects: Sequence[Effect], controls: Collection[str]
) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
    """(effects without the forms that delay or bend only these controls, effects that have no form left)."""
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
