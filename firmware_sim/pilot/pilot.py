"""The pilot: flies the planned manoeuvres, levels the wings between them and keeps height and speed.

Acts at the 50 Hz frame of the servo pulses on what he sees: bank, pitch, rates, height and speed. He never fights a
manoeuvre on the axis it is flown on. Hands are not a machine: with `hand` set, steps are rounded and the stick wavers.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.aircraft import Servos
from firmware_sim.physics.maths import Maths, Value
from firmware_sim.physics.motion import Motion
from firmware_sim.physics.plant import Commands
from firmware_sim.physics.trim import Trim
from firmware_sim.pilot.manoeuvres import AXES, StickInput

FRAME = 0.02  # s between servo pulses

BANK_GAIN, ROLL_DAMPING = 0.10, 0.012  # rad of aileron per rad of bank and per rad/s
ROLL_TRIM_RATE = 0.015  # rad of aileron per rad of bank and second: the slow trim lever
PITCH_GAIN, PITCH_DAMPING = 0.18, 0.02  # rad of elevator per rad and per rad/s
HEIGHT_GAIN, CLIMB_GAIN = 0.010, 0.02  # rad of pitch attitude per m and per m/s
PITCH_RANGE = math.radians(6.0)
SPEED_GAIN = 0.05  # throttle per m/s
REACTION = 0.15  # s, lag of his hands


@dataclass(frozen=True, slots=True)
class StickPlan:
    """Open-loop stick per 50 Hz frame: inputs (frames, axes[, flights]) in rad or throttle; busy: same shape, 0 or 1."""

    inputs: NDArray[np.float64]
    busy: NDArray[np.float64]

    def at(self, frame: int) -> tuple[list[Value], list[Value]]:
        """Inputs and busy flags of one frame, by axis; beyond the plan nothing is flown."""
        if frame < 0 or frame >= len(self.inputs):
            zero = self.inputs[0] * 0.0
            return _by_axis(zero), _by_axis(zero)
        return _by_axis(self.inputs[frame]), _by_axis(self.busy[frame])


def _by_axis(row: NDArray[np.float64]) -> list[Value]:
    """One Value an axis; of a single flight Python's floats, for a numpy scalar makes numpy scalars of all that it meets."""
    return row.tolist() if row.ndim == 1 else list(row)


def plan_sticks(manoeuvres: Sequence[StickInput], duration: float, hand: float, rng: np.random.Generator) -> StickPlan:
    """Lay manoeuvres out on frames. `hand` > 0 [deg]: wavering of that standard deviation, and rounded steps."""
    frames = round(duration / FRAME)
    time: NDArray[np.float64] = np.arange(frames, dtype=np.float64) * FRAME
    inputs = np.zeros((frames, len(AXES)))
    busy = np.zeros((frames, len(AXES)))
    for m in manoeuvres:
        axis = AXES.index(m.axis)
        scale = 1.0 if m.axis == "throttle" else math.radians(1.0)
        inputs[:, axis] += scale * m.values(np.add(time, 1e-9))
        if m.shape != "staircase":  # in a long steady sideslip the pilot keeps levelling the wings
            busy[(time >= m.start - 1e-9) & (time < m.start + m.length), axis] = 1.0
    if hand > 0.0:
        kernel = np.hanning(11)[1:-1]
        kernel /= kernel.sum()
        for axis in range(3):
            inputs[:, axis] = np.convolve(inputs[:, axis], kernel, mode="same")
        inputs[:, :3] += _waver(frames, math.radians(hand), rng)
    return StickPlan(inputs, busy)


def _waver(frames: int, sigma: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Slow unsteadiness of three axes: first-order Markov with 0.5 s correlation."""
    keep = math.exp(-FRAME / 0.5)
    noise = rng.standard_normal((frames, 3)) * sigma * math.sqrt(1.0 - keep * keep)
    value = rng.standard_normal(3) * sigma
    deflection = np.empty((frames, 3))
    for k in range(frames):
        value = keep * value + noise[k]
        deflection[k] = value
    return deflection


def join_plans(plans: Sequence[StickPlan]) -> StickPlan:
    """Plans of several flights side by side, flights last."""
    return StickPlan(
        np.stack([p.inputs for p in plans], axis=-1),
        np.stack([p.busy for p in plans], axis=-1),
    )


class Pilot:
    """Turns plan and view into commands, once a frame."""

    def __init__(self, trim: Trim, plan: StickPlan, throttle: Value, xp: Maths, servos: Servos) -> None:
        self.trim = trim
        self.plan = plan
        self.throttle = throttle
        self.xp = xp
        self._elevon_limit, self._rudder_limit = servos.elevon_limit, servos.rudder_limit
        self._aileron = xp.full(0.0)
        self._roll_trim = xp.full(0.0)
        self._speed = xp.full(trim.speed)
        self.event: Value = xp.full(0.0)

    def act(self, frame: int, m: Motion) -> Commands:
        """Commands for the frame that begins now; `frame` counts from the start of the plan, negative while settling."""
        xp = self.xp
        (aileron_in, rudder_in, elevator_in, throttle_in), busy = self.plan.at(frame)
        phi = xp.atan2(m.c23, m.c33)
        theta = xp.asin(xp.clip(-m.c13, -1.0, 1.0))
        climb = -(m.c13 * m.u + m.c23 * m.v + m.c33 * m.w)
        free = 1.0 - busy[0]

        target = BANK_GAIN * phi + ROLL_DAMPING * m.p
        self._aileron = self._aileron + (FRAME / REACTION) * (free * target - self._aileron)
        hands_off = free * (1.0 - busy[1])
        # A quick trim while settling before the plan, a slow one afterwards.
        rate = ROLL_TRIM_RATE * (8.0 if frame < 0 else 1.0)
        self._roll_trim = self._roll_trim + FRAME * rate * hands_off * phi

        height = -m.down
        pitch = self.trim.alpha + xp.clip(
            HEIGHT_GAIN * (self.trim.height - height) - CLIMB_GAIN * climb, -PITCH_RANGE, PITCH_RANGE
        )
        elevator = self.trim.elevator + PITCH_GAIN * (theta - pitch) + PITCH_DAMPING * m.q
        elevator = elevator + busy[2] * (self.trim.elevator - elevator) * 0.7
        self._speed = self._speed + (FRAME / 0.4) * (m.V - self._speed)
        hold = 1.0 - busy[3]
        throttle = self.throttle + hold * SPEED_GAIN * (self.trim.speed - self._speed) + throttle_in

        de = elevator + elevator_in
        da = self._aileron + self._roll_trim + aileron_in
        self.event = xp.clip(busy[0] + busy[1] + busy[2] + busy[3], 0.0, 1.0)
        return Commands(
            left=xp.clip(de - da, -self._elevon_limit, self._elevon_limit),
            right=xp.clip(de + da, -self._elevon_limit, self._elevon_limit),
            rudder=xp.clip(rudder_in, -self._rudder_limit, self._rudder_limit),
            throttle=xp.clip(throttle, 0.0, 1.0),
        )
