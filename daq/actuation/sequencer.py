"""The sequencer: a state machine that decides, frame by frame, whether the servos get its pulses, and which.

It maps a FrameObservation to a SequencerCommand, without devices and without a clock of its own. States, reasons and transitions
are in `daq.contract.sequencing`. In every state either the heartbeat is off, and the pilot's signals reach the servos by the
multiplexer alone, or the output is the pilot's signals, live or as they were at the start, plus limited increments.
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
"""Frames in a row in which the switch must show a new position (60 ms); leaving go counts at once."""
CAPTURE_FRAMES = 5
"""Frames whose median gives the pilot's signals at the start."""
FOLLOW_S = 0.15
"""Longest delay of a servo pulse read back: a cycle of the chip, one of the co-processor, two scans, and one to spare."""
FOLLOW_US = 25.0
"""Largest error of a servo pulse read back: two steps of 4.9 us, jitter of 10 us, and the co-processor's rounding."""
_FRAME_GAP = 1.6
"""Largest time between two frames, in periods: a lost frame makes it two, lateness within its limit less than 1.5."""


class SequencerRequest(Enum):
    """A request from the ground."""

    START = auto()
    STOP = auto()


@dataclass(frozen=True, slots=True)
class StateTransition:
    """A transition to make in this frame; detail: in words, for the report."""

    to: State
    reason: Reason = Reason.NONE
    detail: str = ""


class Sequencer:
    """Flies one manoeuvre on one aircraft. period_s: of the frames. proof: the trial that the output must pass first."""

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
        self._off_seen = False  # the switch has been at off since the last CHECKING
        self._request: SequencerRequest | None = None  # of the ground, for the next frame
        self._entered_ns = 0  # when the state was entered
        self._go_ns: int | None = None  # since when the switch has been at go, while armed
        self._last_ns: int | None = None
        self._positions: deque[Switch] = deque(maxlen=SWITCH_FRAMES)
        self._pilot_frames: deque[tuple[float, ...]] = deque(maxlen=CAPTURE_FRAMES)
        self._watched: tuple[float, ...] = ()  # the pilot's other channels at the start [us]
        self._captured: tuple[float, ...] = ()  # the pilot's signals at the start [us]
        self._last_pulses: tuple[float, ...] = ()
        self._increments = STILL
        self._ramp_start = STILL
        self._sets = 1  # flown or being flown, of the manoeuvre under way
        self._sent_pulses: deque[tuple[int, tuple[float, ...]]] = deque()
        self._matched_ns = 0
        self._handlers: Mapping[State, Callable[[FrameObservation], StateTransition | None]] = {
            State.IDLE: self._idle,
            State.CHECKING: self._checking,
            State.ARMED: self._armed,
            State.RUNNING: self._running,
            State.RAMPING: self._ramping,
            State.RELEASED: self._released,
        }

    # ---------------------------------------------------------------------------------------- requests from the ground

    def request_start(self, digest: int) -> str:
        """Request the start of the manoeuvre whose digest begins with these 24 bits. Returns why it is refused, or ""."""
        if self._config.start != "ground":
            return "this manoeuvre is started by the pilot's switch"
        if digest != int(self.plan.digest[:6], 16):
            return f"on board is another manoeuvre ({self.plan.digest[:6]})"
        if self.state is not State.ARMED:
            return f"sequencer is {self.state.words}, not armed"
        if self._go_ns is None:
            return "the pilot's switch is not at go"
        if self._proof.pending:
            return self._proof.pending
        if self._request is SequencerRequest.STOP:
            return "it is being stopped"
        self._request = SequencerRequest.START
        return ""

    def request_stop(self) -> str:
        """Request the end of the manoeuvre. Returns why it is refused, or ""."""
        if not self.state.beats:
            return f"sequencer is {self.state.words}: the pilot has the aircraft"
        self._request = SequencerRequest.STOP
        return ""

    def load_plan(self, plan: ServoManoeuvre) -> str:
        """Replace the manoeuvre. Returns why it is refused, or "": the pilot's switch must be at off, so that he cannot arm a
        manoeuvre that he has not been told of."""
        if self.state not in (State.IDLE, State.RELEASED):
            return f"sequencer is {self.state.words}"
        if self._positions and self._positions[-1] in (Switch.ARM, Switch.GO):
            return "the pilot's switch is not at off"
        self.plan = plan
        return ""

    # ---------------------------------------------------------------------------------------- a frame

    def decide_frame(self, seen: FrameObservation) -> SequencerCommand:
        """The command for a frame; called once per frame, in order."""
        self._note(seen)
        move = self._handlers[self.state](seen)
        words = "" if move is None else self._enter(move, seen)
        self._request = None
        frame = self._put(seen, words)
        self._last_ns = seen.now_ns
        return frame

    def _note(self, seen: FrameObservation) -> None:
        output = seen.output
        self._proof.note(seen)
        self._positions.append(output.switch)
        if output.pilot is not None:
            self._pilot_frames.append(output.pilot)
        elif not output.hidden:
            self._pilot_frames.clear()
        self._off_seen = self._off_seen or self._position_held(Switch.OFF)
        if output.switch is not Switch.GO:
            self._go_ns = None
        elif self._go_ns is None and self._position_held(Switch.GO):
            self._go_ns = seen.now_ns

    def _position_held(self, position: Switch) -> bool:
        return len(self._positions) == SWITCH_FRAMES and all(p is position for p in self._positions)

    def _enter(self, move: StateTransition, seen: FrameObservation) -> str:
        if move.to not in TRANSITIONS[self.state]:
            raise RuntimeError(f"no transition from {self.state.words} to {move.to.words}")
        self.state, self.reason, self._entered_ns = move.to, move.reason, seen.now_ns
        if move.to is State.CHECKING:
            self._off_seen = False
            self._proof.begin()
        if move.to is State.RUNNING:
            self._captured = self._last_pulses = tuple(median(c) for c in zip(*self._pilot_frames, strict=True))
            self._watched = seen.output.watched
            self._sets = 1
            self._sent_pulses.clear()
            self._matched_ns = seen.now_ns
        if move.to is State.RAMPING:
            self._ramp_start = self._increments
        reason = f": {move.reason.words}" if move.reason is not Reason.NONE else ""
        detail = f" ({move.detail})" if move.detail else ""
        return f"sequencer {move.to.words}{reason}{detail}"

    def _seconds(self, now_ns: int) -> float:
        return (now_ns - self._entered_ns) * 1e-9

    # ---------------------------------------------------------------------------------------- states

    def _idle(self, seen: FrameObservation) -> StateTransition | None:
        return StateTransition(State.CHECKING) if self._off_seen and self._position_held(Switch.ARM) else None

    def _checking(self, seen: FrameObservation) -> StateTransition | None:
        fault = self._ready_fault(seen)
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
        fault = self._ready_fault(seen)
        if fault is not None:
            return fault
        if self._go_ns is None:
            self._proof.at_arm()
            return None
        fault_move = self._timing_fault(seen) or self._limit_exceeded(seen)
        if fault_move is not None:
            return StateTransition(State.RELEASED, fault_move.reason, fault_move.detail)
        proven = self._proof.at_go(seen)
        if proven is None:
            return None
        if proven.reason is not Reason.NONE:
            return StateTransition(State.RELEASED, proven.reason, proven.detail)
        if self._config.start == "switch" or self._request is SequencerRequest.START:
            return self._start()
        waiting_s = (seen.now_ns - self._go_ns) * 1e-9
        if waiting_s <= self._config.wait_s:
            return None
        return StateTransition(State.RELEASED, Reason.WAITED, f"in {waiting_s:.0f} s")

    def _start(self) -> StateTransition:
        if len(self._pilot_frames) < CAPTURE_FRAMES:
            return StateTransition(State.RELEASED, Reason.PILOT_SIGNALS)
        for servo, signals in zip(self._servos, zip(*self._pilot_frames, strict=True), strict=True):
            if max(signals) - min(signals) > self._limits.stick_us / 2.0:
                return StateTransition(State.RELEASED, Reason.STICKS_NOT_STILL, servo.name)
            low, high = self.plan.reach(servo)
            centre = median(signals)
            if centre + low < servo.lowest_us or centre + high > servo.highest_us:
                extent = f"{centre + low:.0f} to {centre + high:.0f} us"
                return StateTransition(State.RELEASED, Reason.NO_ROOM, f"{servo.name} would go from {extent}")
        return StateTransition(State.RUNNING)

    def _running(self, seen: FrameObservation) -> StateTransition | None:
        interruption = self._interruption(seen) or self._limit_exceeded(seen)
        if interruption is not None:
            next_state = State.RAMPING if interruption.reason.exit is Exit.RAMP else State.RELEASED
            return StateTransition(next_state, interruption.reason, interruption.detail)
        return self._end_of_set(seen)

    def _end_of_set(self, seen: FrameObservation) -> StateTransition | None:
        """End the set early when its bound is reached; repeat it, within the limits, while the bound is known not to be."""
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
        return StateTransition(State.IDLE) if self._position_held(Switch.OFF) else None

    # ---------------------------------------------------------------------------------------- what ends a state

    def _ready_fault(self, seen: FrameObservation) -> StateTransition | None:
        """What ends CHECKING and ARMED, at arm as at go."""
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
        return StateTransition(State.RELEASED, Reason.GROUND) if self._request is SequencerRequest.STOP else None

    def _timing_fault(self, seen: FrameObservation) -> StateTransition | None:
        if seen.late_ns > self._limits.late_ms * 1e6:
            return StateTransition(State.RELEASED, Reason.LATE, f"{seen.late_ns * 1e-6:.0f} ms")
        gap = 0.0 if self._last_ns is None else (seen.now_ns - self._last_ns) * 1e-9
        missed = gap > _FRAME_GAP * self._period_s
        return StateTransition(State.RELEASED, Reason.MISSED, f"{gap * 1e3:.0f} ms") if missed else None

    def _interruption(self, seen: FrameObservation) -> StateTransition | None:
        """What ends a manoeuvre, the limits of motion and link apart: the pilot first, then faults, then recording and ground."""
        output = seen.output
        if output.pilot is None and not output.hidden:
            return StateTransition(State.RELEASED, Reason.PILOT_SIGNALS)
        if output.switch is not Switch.GO:
            return StateTransition(State.RELEASED, Reason.SWITCH)
        stick = self._stick_moved(output)
        if stick:
            return StateTransition(State.RELEASED, Reason.STICK, stick)
        if output.fault:
            return StateTransition(State.RELEASED, self._proof.fault, output.fault)
        failure = self._timing_fault(seen) or self._readback_fault(seen)
        if failure is not None:
            return failure
        if not seen.recording:
            return StateTransition(State.RAMPING, Reason.RECORDING)
        return StateTransition(State.RAMPING, Reason.GROUND) if self._request is SequencerRequest.STOP else None

    def _stick_moved(self, output: OutputObservation) -> str:
        """The first of the pilot's signals that has moved since the start by more than `stick_us`, in words; "" for none."""
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

    def _limit_exceeded(self, seen: FrameObservation) -> StateTransition | None:
        """The limit of motion or link that forbids a manoeuvre."""
        excess = self._envelope.judge(seen.motion)
        if excess is not None:
            return StateTransition(State.RAMPING, *excess)
        limit = self._limits.link_s
        if limit is not None and (seen.link_s is None or seen.link_s > limit):
            return StateTransition(State.RAMPING, Reason.LINK, f"silent for more than {limit:g} s")
        return None

    def _readback_fault(self, seen: FrameObservation) -> StateTransition | None:
        """A transition when the pulses read back have matched none of those recently sent for longer than FOLLOW_S."""
        recent = [pulses for time_ns, pulses in self._sent_pulses if (seen.now_ns - time_ns) * 1e-9 <= FOLLOW_S]
        if self._matches_readback(recent, seen.output.readback):
            self._matched_ns = seen.now_ns
        if (seen.now_ns - self._matched_ns) * 1e-9 <= FOLLOW_S:
            return None
        return StateTransition(State.RELEASED, Reason.NOT_FOLLOWED, self._proof.not_followed_hint)

    def _matches_readback(self, recent: list[tuple[float, ...]], readback: tuple[float | None, ...]) -> bool:
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
        self._increments = self._increments_at(elapsed)
        pulses, limited = self._limited_pulses(seen.now_ns)
        self._sent_pulses.append((seen.now_ns, pulses))
        while (seen.now_ns - self._sent_pulses[0][0]) * 1e-9 > FOLLOW_S:
            self._sent_pulses.popleft()
        return SequencerCommand(self.state, self.reason, elapsed, self._increments, pulses, limited, words)

    def _increments_at(self, elapsed_s: float) -> Increments:
        if self.state is State.RUNNING:
            return self.plan.at(elapsed_s - (self._sets - 1) * self.plan.duration_s)
        share = max(0.0, 1.0 - elapsed_s / self._config.ramp_s)
        return tuple(share * value for value in self._ramp_start)

    def _limited_pulses(self, now_ns: int) -> tuple[tuple[float, ...], bool]:
        """The pulses for the increments within slew and limits [us], and whether these changed any."""
        seconds = (
            self._period_s if self._last_ns is None else min((now_ns - self._last_ns) * 1e-9, 2.0 * self._period_s)
        )
        targets = [base + s.shift(self._increments) for s, base in zip(self._servos, self._captured, strict=True)]
        pulses = tuple(
            s.limited(w, last, seconds) for s, w, last in zip(self._servos, targets, self._last_pulses, strict=True)
        )
        self._last_pulses = pulses
        return pulses, any(abs(a - b) > 1e-6 for a, b in zip(targets, pulses, strict=True))
