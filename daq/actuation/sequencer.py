"""The sequencer: a pure state machine that decides, frame by frame, on the servo signals and on their release by the heartbeat.

It maps observations to actions, without devices and without a clock. States, reasons and transitions are in
`daq.contract.sequencing`. In every state either the heartbeat is off, and the pilot's signals reach the servos through the
multiplexer alone, or the output is the pilot's signals, live or as at the start, plus limited increments.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from statistics import median

from daq.actuation.config import SequencerConfig
from daq.actuation.motion import FlightEnvelope
from daq.actuation.output import FrameObservation, OutputObservation, OutputTrial, SequencerCommand
from daq.actuation.servos import STILL, ConfiguredServo, Increments, ServoManoeuvre
from daq.contract.sequencing import TRANSITIONS, Exit, Reason, State, Switch

SWITCH_FRAMES = 3
"""A new position counts when seen in so many frames (60 ms); leaving go counts at once."""
CAPTURE_FRAMES = 5
"""The pilot's signals at the start are the medians of so many frames."""
FOLLOW_S = 0.15
"""Servo pulses are read back up to so late: a cycle of the chip, one of the co-processor, two scans, and one to spare."""
FOLLOW_US = 25.0
"""They may differ by so much: two steps of 4.9 us, jitter of 10 us, and the co-processor's rounding."""


class SequencerRequest(Enum):
    """What the ground asks for."""

    START = auto()
    STOP = auto()


@dataclass(frozen=True, slots=True)
class StateTransition:
    """A transition that is due."""

    to: State
    reason: Reason = Reason.NONE
    detail: str = ""


class Sequencer:
    """One manoeuvre for one aircraft. period_s: of the frames. proof: what its output has to show first."""

    def __init__(
        self,
        config: SequencerConfig,
        plan: ServoManoeuvre,
        servos: tuple[ConfiguredServo, ...],
        period_s: float,
        proof: OutputTrial,
    ) -> None:
        self.state, self.reason = State.IDLE, Reason.NONE
        self._config, self._limits = config, config.limits
        self.plan, self._servos = plan, servos
        self._period_s, self._proof = period_s, proof
        self._envelope = FlightEnvelope(config.limits)
        self._off_seen = False
        self._wish: SequencerRequest | None = None  # of the ground, for the next frame
        self._since_ns = 0  # when the state was entered
        self._go_ns: int | None = None  # since when the switch has been at go, while armed
        self._last_ns: int | None = None
        self._positions: deque[Switch] = deque(maxlen=SWITCH_FRAMES)
        self._sticks: deque[tuple[float, ...]] = deque(maxlen=CAPTURE_FRAMES)
        self._watched: tuple[float, ...] = ()  # other channels of the pilot's, as they were at the start
        self._captured: tuple[float, ...] = ()
        self._last: tuple[float, ...] = ()
        self._increments = STILL
        self._fading = STILL
        self._sets = 1  # flown or being flown, of the manoeuvre under way
        self._put_out: deque[tuple[int, tuple[float, ...]]] = deque()
        self._followed_ns = 0
        self._handlers: Mapping[State, Callable[[FrameObservation], StateTransition | None]] = {
            State.IDLE: self._idle,
            State.CHECKING: self._checking,
            State.ARMED: self._armed,
            State.RUNNING: self._running,
            State.RAMPING: self._ramping,
            State.RELEASED: self._released,
        }

    # ---------------------------------------------------------------------------------------- the ground's wishes

    def ask_start(self, digest: int) -> str:
        """A signed wish to start the manoeuvre whose digest begins with these 24 bits; why not, empty when it is taken."""
        if self._config.start != "ground":
            return "this manoeuvre is started by the pilot's switch"
        if digest != int(self.plan.digest[:6], 16):
            return f"on board is another manoeuvre ({self.plan.digest[:6]})"
        if self.state is not State.ARMED:
            return f"sequencer is {self.state.words}, not armed"
        if self._go_ns is None:
            return "the pilot's switch is not at go"
        if self._proof.trying:
            return self._proof.trying
        if self._wish is SequencerRequest.STOP:
            return "it is being stopped"
        self._wish = SequencerRequest.START
        return ""

    def ask_stop(self) -> str:
        """A wish to end what is under way; why not, empty when it is taken."""
        if not self.state.beats:
            return f"sequencer is {self.state.words}: the pilot has the aircraft"
        self._wish = SequencerRequest.STOP
        return ""

    def load_plan(self, plan: ServoManoeuvre) -> str:
        """Another manoeuvre to fly; why not, empty when it is taken. The pilot arms what he has been told of, so his switch is at
        off meanwhile."""
        if self.state not in (State.IDLE, State.RELEASED):
            return f"sequencer is {self.state.words}"
        if self._positions and self._positions[-1] in (Switch.ARM, Switch.GO):
            return "the pilot's switch is not at off"
        self.plan = plan
        return ""

    # ---------------------------------------------------------------------------------------- a frame

    def decide_frame(self, seen: FrameObservation) -> SequencerCommand:
        """Decide one frame."""
        self._note(seen)
        move = self._handlers[self.state](seen)
        words = "" if move is None else self._enter(move, seen)
        self._wish = None
        frame = self._put(seen, words)
        self._last_ns = seen.now_ns
        return frame

    def _note(self, seen: FrameObservation) -> None:
        output = seen.output
        self._proof.note(seen)
        self._positions.append(output.switch)
        if output.pilot is not None:
            self._sticks.append(output.pilot)
        elif not output.hidden:
            self._sticks.clear()
        self._off_seen = self._off_seen or self._held(Switch.OFF)
        if output.switch is not Switch.GO:
            self._go_ns = None
        elif self._go_ns is None and self._held(Switch.GO):
            self._go_ns = seen.now_ns

    def _held(self, position: Switch) -> bool:
        return len(self._positions) == SWITCH_FRAMES and all(p is position for p in self._positions)

    def _enter(self, move: StateTransition, seen: FrameObservation) -> str:
        if move.to not in TRANSITIONS[self.state]:
            raise RuntimeError(f"no transition from {self.state.words} to {move.to.words}")
        self.state, self.reason, self._since_ns = move.to, move.reason, seen.now_ns
        if move.to is State.CHECKING:
            self._off_seen = False
            self._proof.begin()
        if move.to is State.RUNNING:
            self._captured = self._last = tuple(median(c) for c in zip(*self._sticks, strict=True))
            self._watched = seen.output.watched
            self._sets = 1
            self._put_out.clear()
            self._followed_ns = seen.now_ns
        if move.to is State.RAMPING:
            self._fading = self._increments
        reason = f": {move.reason.words}" if move.reason is not Reason.NONE else ""
        detail = f" ({move.detail})" if move.detail else ""
        return f"sequencer {move.to.words}{reason}{detail}"

    def _seconds(self, now_ns: int) -> float:
        return (now_ns - self._since_ns) * 1e-9

    # ---------------------------------------------------------------------------------------- states

    def _idle(self, seen: FrameObservation) -> StateTransition | None:
        return StateTransition(State.CHECKING) if self._off_seen and self._held(Switch.ARM) else None

    def _checking(self, seen: FrameObservation) -> StateTransition | None:
        fault = self._standing(seen)
        if fault is not None:
            return fault
        if seen.output.switch is Switch.GO:
            return StateTransition(State.RELEASED, Reason.TOO_EARLY)
        proven = self._proof.check(seen, self._seconds(seen.now_ns))
        if proven is None:
            return None
        if proven.reason is not Reason.NONE:
            return StateTransition(State.RELEASED, proven.reason, proven.detail)
        return StateTransition(
            State.ARMED, detail=f"{self.plan.digest[:6]}, {self.plan.duration_s:.1f} s; {proven.detail}"
        )

    def _armed(self, seen: FrameObservation) -> StateTransition | None:
        fault = self._standing(seen)
        if fault is not None:
            return fault
        if self._go_ns is None:
            self._proof.rest()
            return None
        fault_move = self._untimely(seen) or self._outside(seen)
        if fault_move is not None:
            return StateTransition(State.RELEASED, fault_move.reason, fault_move.detail)
        proven = self._proof.at_go(seen)
        if proven is None:
            return None
        if proven.reason is not Reason.NONE:
            return StateTransition(State.RELEASED, proven.reason, proven.detail)
        if self._config.start == "switch" or self._wish is SequencerRequest.START:
            return self._start()
        waiting_s = (seen.now_ns - self._go_ns) * 1e-9
        if waiting_s <= self._config.wait_s:
            return None
        return StateTransition(State.RELEASED, Reason.WAITED, f"in {waiting_s:.0f} s")

    def _start(self) -> StateTransition:
        if len(self._sticks) < CAPTURE_FRAMES:
            return StateTransition(State.RELEASED, Reason.PILOT_SIGNALS)
        for servo, signals in zip(self._servos, zip(*self._sticks, strict=True), strict=True):
            if max(signals) - min(signals) > self._limits.stick_us / 2.0:
                return StateTransition(State.RELEASED, Reason.STICKS_NOT_STILL, servo.name)
            low, high = self.plan.reach(servo)
            centre = median(signals)
            if centre + low < servo.lowest_us or centre + high > servo.highest_us:
                extent = f"{centre + low:.0f} to {centre + high:.0f} us"
                return StateTransition(State.RELEASED, Reason.NO_ROOM, f"{servo.name} would go from {extent}")
        return StateTransition(State.RUNNING)

    def _running(self, seen: FrameObservation) -> StateTransition | None:
        interruption = self._interruption(seen) or self._outside(seen)
        if interruption is not None:
            next_state = State.RAMPING if interruption.reason.exit is Exit.RAMP else State.RELEASED
            return StateTransition(next_state, interruption.reason, interruption.detail)
        return self._end_of_set(seen)

    def _end_of_set(self, seen: FrameObservation) -> StateTransition | None:
        """The set ends early when its bound is reached, and is flown again while that is known not to be, within the limits."""
        elapsed, length = self._seconds(seen.now_ns), self.plan.duration_s
        if seen.reached:
            return StateTransition(State.RAMPING, Reason.REACHED, f"{self._config.until} after {elapsed:.1f} s")
        if elapsed < self._sets * length:
            return None
        once_more = (self._sets + 1) * length <= self._config.longest_s and self._sets < self._config.most_sets
        if seen.reached is False and once_more:
            self._sets += 1
            return None
        sets = f"{self._sets} sets, " if self._sets > 1 else ""
        unreached = f", {self._config.until} not reached" if self._config.until else ""
        return StateTransition(State.RELEASED, Reason.COMPLETE, f"{sets}{elapsed:.1f} s{unreached}")

    def _ramping(self, seen: FrameObservation) -> StateTransition | None:
        interruption = self._interruption(seen)
        if interruption is not None and interruption.reason.exit is Exit.DROP:
            return StateTransition(State.RELEASED, interruption.reason, interruption.detail)
        if self._seconds(seen.now_ns) >= self._config.ramp_s:
            return StateTransition(State.RELEASED, self.reason)
        return None

    def _released(self, seen: FrameObservation) -> StateTransition | None:
        return StateTransition(State.IDLE) if self._held(Switch.OFF) else None

    # ---------------------------------------------------------------------------------------- what ends it

    def _standing(self, seen: FrameObservation) -> StateTransition | None:
        """What ends checking and being armed, in whichever position the switch is."""
        output = seen.output
        if output.pilot is None and not output.hidden:
            return StateTransition(State.RELEASED, Reason.PILOT_SIGNALS)
        if output.switch is Switch.OFF:
            return StateTransition(State.IDLE, Reason.SWITCH)
        if output.switch is Switch.UNKNOWN:
            return StateTransition(State.RELEASED, Reason.SWITCH, "between its positions")
        if output.fault:
            return StateTransition(State.RELEASED, self._proof.fault, output.fault)
        if not seen.recording:
            return StateTransition(State.RELEASED, Reason.RECORDING)
        return StateTransition(State.RELEASED, Reason.GROUND) if self._wish is SequencerRequest.STOP else None

    def _untimely(self, seen: FrameObservation) -> StateTransition | None:
        if seen.late_ns > self._limits.late_ms * 1e6:
            return StateTransition(State.RELEASED, Reason.LATE, f"{seen.late_ns * 1e-6:.0f} ms")
        gap = 0.0 if self._last_ns is None else (seen.now_ns - self._last_ns) * 1e-9
        # one frame lost makes a gap of two periods; lateness within its own limit makes less than one and a half
        return (
            StateTransition(State.RELEASED, Reason.MISSED, f"{gap * 1e3:.0f} ms")
            if gap > 1.6 * self._period_s
            else None
        )

    def _interruption(self, seen: FrameObservation) -> StateTransition | None:
        """What ends a manoeuvre other than the motion: hands first, then what can no longer be trusted, then the rest."""
        output = seen.output
        if output.pilot is None and not output.hidden:
            return StateTransition(State.RELEASED, Reason.PILOT_SIGNALS)
        if output.switch is not Switch.GO:
            return StateTransition(State.RELEASED, Reason.SWITCH)
        stick = self._moved(output)
        if stick:
            return StateTransition(State.RELEASED, Reason.STICK, stick)
        if output.fault:
            return StateTransition(State.RELEASED, self._proof.fault, output.fault)
        failure = self._untimely(seen) or self._not_followed(seen)
        if failure is not None:
            return failure
        if not seen.recording:
            return StateTransition(State.RAMPING, Reason.RECORDING)
        return StateTransition(State.RAMPING, Reason.GROUND) if self._wish is SequencerRequest.STOP else None

    def _moved(self, output: OutputObservation) -> str:
        """Which of the pilot's signals that can be seen has left where it was at the start, empty for none."""
        names = [servo.name for servo in self._servos] if output.pilot is not None else []
        present_us, start_us = (*(output.pilot or ()), *output.watched), (*self._captured[: len(names)], *self._watched)
        names += [f"watched channel {i + 1}" for i in range(len(output.watched))]
        return next(
            (
                f"{name} by {a - b:+.0f} us"
                for name, a, b in zip(names, present_us, start_us, strict=True)
                if abs(a - b) > self._limits.stick_us
            ),
            "",
        )

    def _outside(self, seen: FrameObservation) -> StateTransition | None:
        """What of motion and link forbids a manoeuvre."""
        excess = self._envelope.judge(seen.motion)
        if excess is not None:
            return StateTransition(State.RAMPING, *excess)
        limit = self._limits.link_s
        if limit is not None and (seen.link_s is None or seen.link_s > limit):
            return StateTransition(State.RAMPING, Reason.LINK, f"silent for more than {limit:g} s")
        return None

    def _not_followed(self, seen: FrameObservation) -> StateTransition | None:
        """Whether the servo pulses read back have, for longer than FOLLOW_S, been none of those put out lately."""
        recent = [pulses for time_ns, pulses in self._put_out if (seen.now_ns - time_ns) * 1e-9 <= FOLLOW_S]
        if self._follows(recent, seen.output.readback):
            self._followed_ns = seen.now_ns
        if (seen.now_ns - self._followed_ns) * 1e-9 <= FOLLOW_S:
            return None
        return StateTransition(State.RELEASED, Reason.NOT_FOLLOWED, self._proof.unlike)

    def _follows(self, recent: list[tuple[float, ...]], readback: tuple[float | None, ...]) -> bool:
        if not recent:
            return True
        for index, (servo, width) in enumerate(zip(self._servos, readback, strict=False)):
            widths = [pulses[index] for pulses in recent]
            if not servo.read_back:
                continue
            if width is None or not min(widths) - FOLLOW_US <= width <= max(widths) + FOLLOW_US:
                return False
        return True

    # ---------------------------------------------------------------------------------------- output

    def _put(self, seen: FrameObservation, words: str) -> SequencerCommand:
        elapsed = self._seconds(seen.now_ns)
        if self.state in (State.CHECKING, State.ARMED):
            return SequencerCommand(self.state, self.reason, elapsed, pulses=self._proof.pulses(seen), words=words)
        if self.state not in (State.RUNNING, State.RAMPING):
            self._increments = STILL
            return SequencerCommand(self.state, self.reason, elapsed, words=words)
        self._increments = self._wanted(elapsed)
        pulses, limited = self._limited(seen.now_ns)
        self._put_out.append((seen.now_ns, pulses))
        while (seen.now_ns - self._put_out[0][0]) * 1e-9 > FOLLOW_S:
            self._put_out.popleft()
        return SequencerCommand(self.state, self.reason, elapsed, self._increments, pulses, limited, words)

    def _wanted(self, elapsed_s: float) -> Increments:
        if self.state is State.RUNNING:
            return self.plan.at(elapsed_s - (self._sets - 1) * self.plan.duration_s)
        share = max(0.0, 1.0 - elapsed_s / self._config.ramp_s)
        return tuple(share * value for value in self._fading)

    def _limited(self, now_ns: int) -> tuple[tuple[float, ...], bool]:
        """The pulses for the increments, within slew and limits; whether any was held back."""
        seconds = (
            self._period_s if self._last_ns is None else min((now_ns - self._last_ns) * 1e-9, 2.0 * self._period_s)
        )
        targets = [base + s.shift(self._increments) for s, base in zip(self._servos, self._captured, strict=True)]
        pulses = tuple(
            s.limited(w, last, seconds) for s, w, last in zip(self._servos, targets, self._last, strict=True)
        )
        self._last = pulses
        return pulses, any(abs(a - b) > 1e-6 for a, b in zip(targets, pulses, strict=True))
