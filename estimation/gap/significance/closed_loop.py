"""Controls that follow the motion: by which gains, and how they answer gusts.

A pilot or an autopilot who holds an attitude moves the controls as gusts move the aircraft. Output error takes a recorded control
as given, independent of gusts. With feedback it is not: the response to it and the residual are correlated, which bends the
base, and every hypothesis that changes the response gains (L. Ljung, "System Identification: Theory for the User", 2nd ed.,
Prentice Hall 1999, section 13.4). With a wing leveller in gusts of 0.3 deg a lateral cg, a dead zone or a nameless term was found
in 7 of 10 sets with nothing hidden, and without the leveller in none.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import expm

from estimation.engine.kernel import Array
from estimation.gap.fit.spectra import Linear
from estimation.gap.records.flight_records import FlightRecord
from estimation.models.base import Model
from estimation.signals.controls import ControlStretch, feedback_gains

RUNAWAY = 1e3  # times the disturbed motion: a loop that grows so far is not the one that was flown


def feedback_of(records: Sequence[FlightRecord], base: Model) -> dict[str, Array]:
    """Control -> (2 states,) gains from the states of `base` at a sample, then at the sample before. Without controls that do not
    follow the motion by more than chance."""
    pieces = [(r, r.states) for r in records if r.states is not None]
    if not pieces:
        return {}
    count = len(base.states)
    known = [j for j in range(count) if all(np.isfinite(states[:, j]).all() for _, states in pieces)]
    feedback = {}
    for name in (s.name for s in base.inputs if s.control):
        noise = float(np.median([r.input_noise.get(name, 0.0) for r in records]))
        stretches = [ControlStretch(r.inputs[name], r.inputs[name], states[:, known]) for r, states in pieces]
        fitted = feedback_gains(stretches, noise) if known and noise > 0.0 else None
        if fitted is not None:
            gains = np.zeros((2, count))
            gains[:, known] = fitted.gains.reshape(2, len(known))
            feedback[name] = gains.ravel()
    return feedback


def answer(disturbance: Array, linear: Linear, feedback: Mapping[str, Array]) -> Array:
    """(N, controls) what the controls of `linear` add when they follow a motion that is disturbed by `disturbance` (N, states of
    the base), as it is with the controls as recorded; zero where the loop grows without limit."""
    count = disturbance.shape[1]
    gains = np.array([feedback.get(n, np.zeros(2 * count)) for n in linear.controls])
    size = len(linear.A)
    block = np.zeros((size + len(linear.controls),) * 2)
    block[:size, :size], block[:size, size:] = linear.A, linear.B
    step = expm(block * linear.dt)[:size]  # exact for controls held between samples
    answers, response = np.zeros((len(disturbance), len(linear.controls))), np.zeros(size)
    before = disturbance[0]
    limit = RUNAWAY * np.abs(gains).sum(axis=1) * np.abs(disturbance).max()
    for k, course in enumerate(disturbance):
        motion = course + response[:count]
        answers[k] = gains @ np.concatenate([motion, before])
        if not (np.abs(answers[k]) <= limit).all():
            return np.zeros_like(answers)
        response = step @ np.concatenate([response, answers[k]])
        before = motion
    return answers
