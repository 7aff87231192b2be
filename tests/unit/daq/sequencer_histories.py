"""Random histories of switch, sticks, link, sensors, bus and timing for the onboard sequencer, and what must always hold."""

import math
from dataclasses import dataclass, field, replace

from hypothesis import strategies as st

from daq.contract.sequencing import State
from firmware_sim.hardware.bus import Disturbance
from tests.unit.daq.sequencer_rig import (
    ARM,
    GO,
    OFF,
    PERIOD_NS,
    US_PER_RAD,
    Flying,
    Rig,
    sequencer_config,
    short_manoeuvre,
)

MS = 1_000_000
STEP_US = 5.0
"""One step of the 12-bit driver at 50 Hz is 4.9 us."""
TAKEOVER_NS = 100 * MS
LOOK_NS = 5 * MS

WHAT = (
    "switch off",
    "switch arm",
    "switch go",
    "switch between",
    "switch silent",
    "stick",
    "bank",
    "airspeed",
    "height",
    "alpha",
    "load factor",
    "no attitude",
    "no pitot",
    "no capture",
    "link",
    "recording",
    "receiver",
    "chip power",
    "bus held",
    "bus refuses",
    "bus slow",
    "heartbeat",
    "stall",
    "late",
    "ground stop",
    "ground start",
    "dead",
)
SWITCH = {"switch off": OFF, "switch arm": ARM, "switch go": GO, "switch between": 1700.0, "switch silent": 0.0}
FLYING = {
    "bank": Flying(bank_deg=80.0),
    "airspeed": Flying(airspeed=9.0),
    "height": Flying(height=5.0),
    "alpha": Flying(alpha_deg=25.0),
    "load factor": Flying(load_factor=4.0),
    "no attitude": Flying(absent=frozenset({"attitude"})),
    "no pitot": Flying(absent=frozenset({"pitot"})),
    "no capture": Flying(absent=frozenset({"capture"})),
}


@dataclass(frozen=True)
class Happening:
    """Something that is so from `start` for `lasts` frames. size: 0 to 1, as far as it has one."""

    what: str
    start: int
    lasts: int
    size: float

    def now(self, frame: int) -> bool:
        return self.start <= frame < self.start + self.lasts


happenings = st.builds(
    Happening,
    what=st.sampled_from(WHAT),
    start=st.integers(0, 170),
    lasts=st.integers(1, 40),
    size=st.floats(0.0, 1.0),
)


@dataclass(frozen=True)
class History:
    """arm, go: frames at which the pilot moves his switch, as he does when nothing else happens."""

    arm: int
    go: int
    start: str
    oscillator_error: float
    events: tuple[Happening, ...]


histories = st.builds(
    History,
    arm=st.integers(5, 20),
    go=st.integers(55, 80),
    start=st.sampled_from(("switch", "switch", "ground")),
    oscillator_error=st.sampled_from((0.0, 0.004, -0.015, 0.018, 0.06)),
    events=st.lists(happenings, max_size=5).map(tuple),
)
FRAMES = 200
AFTERWARDS = 40
"""Frames with the switch off at the end: by then everything has to be idle."""


@dataclass
class Watch:
    """What was put out, as the servos saw it, on a grid of 5 ms."""

    faults: list[str] = field(default_factory=list)
    running: int = 0

    def wrong(self, time_ns: int, what: str) -> None:
        self.faults.append(f"{time_ns / MS:.0f} ms: {what}")


class Played:
    """One history played on a rig."""

    def __init__(self, history: History) -> None:
        self.history = history
        self.watch = Watch()
        config = sequencer_config(start=history.start, wait_s=1.0, limits={"link_s": 1.0})
        self.rig = Rig(
            self._switch,
            config=config,
            manoeuvre=short_manoeuvre(1.0),
            oscillator_error=history.oscillator_error,
            disturb=self._disturb,
        )
        self._reach = [self.rig.plan.reach(s) for s in self.rig.actuation.sequencer._servos]

    def _on(self, what: str, frame: int) -> Happening | None:
        return next((e for e in self.history.events if e.what == what and e.now(frame)), None)

    def _switch(self, time_ns: int) -> float:
        frame = time_ns // PERIOD_NS
        if frame >= FRAMES:
            return OFF
        for what, width in SWITCH.items():
            if self._on(what, frame):
                return width
        return GO if frame >= self.history.go else ARM if frame >= self.history.arm else OFF

    def _disturb(self, address: int, now_ns: int) -> Disturbance | None:
        frame = now_ns // PERIOD_NS
        if self._on("bus held", frame):
            return Disturbance(held=True)
        if self._on("bus refuses", frame):
            return Disturbance(refused=True)
        slow = self._on("bus slow", frame)
        return Disturbance(stretch=1.0 + 20.0 * slow.size) if slow else None

    def play(self) -> "Played":
        """Frame by frame to the end."""
        rig = self.rig
        rig.monostable.broken = lambda time_ns: self._on("heartbeat", time_ns // PERIOD_NS) is not None
        while rig.number < FRAMES + AFTERWARDS:
            frame = rig.number
            self._set(frame)
            before = rig.now
            stall = self._on("stall", frame)
            if stall:
                rig.clock.advance(round(stall.size * 400 * MS))
                rig.number = -(-rig.now // PERIOD_NS)
            late = self._on("late", frame)
            rig.frame(late_ns=round(late.size * 19 * MS) if late else 0)
            self.watch.running += rig.state is State.RUNNING
            self._look(before, rig.now)
        return self

    def _set(self, frame: int) -> None:
        rig = self.rig
        rig.alive = rig.alive and self._on("dead", frame) is None
        rig.flying = next((f for what, f in FLYING.items() if self._on(what, frame)), Flying())
        stick = self._on("stick", frame)
        rig.sticks = (math.radians(20.0 * stick.size - 10.0), 0.02, 0.0) if stick else (0.01, 0.02, 0.0)
        rig.link_s = 3.0 if self._on("link", frame) else 0.1
        rig.book.recording = self._on("recording", frame) is None
        rig.receiver.set_power(self._on("receiver", frame) is None, rig.now)
        rig.cabin.chip.set_power(self._on("chip power", frame) is None, rig.now)
        if rig.alive and self._on("ground stop", frame):
            rig.actuation.request(None)
        if rig.alive and (self._on("ground start", frame) or frame % 10 == 0):
            rig.actuation.request(int(rig.plan.digest[:6], 16))

    # ------------------------------------------------------------------------------------------- what must hold

    def _look(self, from_ns: int, to_ns: int) -> None:
        time_ns = (from_ns // LOOK_NS + 1) * LOOK_NS
        while time_ns <= to_ns:
            if self.rig.cabin.multiplexer.selects_second(time_ns):
                self._by_the_pilot(time_ns)
                self._alive(time_ns)
                self._accounted(time_ns)
                self._within(time_ns)
            time_ns += LOOK_NS

    def _by_the_pilot(self, time_ns: int) -> None:
        """Within one output period of the switch leaving go, the multiplexer passes the pilot."""
        if all(0.0 < self._switch(time_ns - k * LOOK_NS) < 1700.0 for k in range(5)):
            self.watch.wrong(time_ns, "not the pilot's one period after the switch went off")

    def _alive(self, time_ns: int) -> None:
        last = self.rig.monostable.last_edge_ns
        if last is None or time_ns - last >= TAKEOVER_NS:
            self.watch.wrong(time_ns, "not the pilot's 0.1 s after the last beat")

    def _accounted(self, time_ns: int) -> None:
        last = self.rig.book.frames[-1] if self.rig.book.frames else None
        if last is None or time_ns - last.time_monotonic_ns > TAKEOVER_NS:
            self.watch.wrong(time_ns, "output without a frame in the recording")

    def _within(self, time_ns: int) -> None:
        """Each pulse is the pilot's, live, or the signals at the start plus no more than the manoeuvre, and in its limits."""
        config, chip = self.rig.config, self.rig.cabin.chip
        for index, (output, reach) in enumerate(zip(config.output.values(), self._reach, strict=True)):
            width = chip.width_us(output.channel, time_ns)
            if width == 0.0:
                continue
            mine = [1500.0 + US_PER_RAD * s[index] for s in self._recent_sticks(time_ns)]
            slack = STEP_US + 0.02 * width if self.history.oscillator_error else STEP_US
            low, high = min(mine) + reach[0] - slack, max(mine) + reach[1] + slack
            if not low <= width <= high:
                self.watch.wrong(time_ns, f"{width:.0f} us outside {low:.0f} to {high:.0f}")
            if not output.lowest_us - slack <= width <= output.highest_us + slack:
                self.watch.wrong(time_ns, f"{width:.0f} us outside the output's limits")

    def _recent_sticks(self, time_ns: int) -> list[tuple[float, float, float]]:
        """The sticks as they are, as they rest, and as a happening of the last 0.2 s had them."""
        frame = time_ns // PERIOD_NS
        moved = [e for e in self.history.events if e.what == "stick" and e.start <= frame < e.start + e.lasts + 10]
        return [self.rig.sticks, (0.01, 0.02, 0.0), *((math.radians(20.0 * e.size - 10.0), 0.02, 0.0) for e in moved)]

    def faults(self) -> list[str]:
        """Everything that did not hold, the end included."""
        rig = self.rig
        found = list(self.watch.faults)
        if rig.alive and rig.state is not State.IDLE:
            found.append(f"stuck in {rig.state.words} with the switch off")
        if rig.cabin.multiplexer.selects_second(rig.now):
            found.append("the pilot does not have the aircraft at the end")
        found += self._too_long() + self._too_fast()
        return found

    def _too_long(self) -> list[str]:
        """A run, its ramp included, lasts no longer than file and ramp, whatever happens."""
        longest = self.rig.plan.duration_s + self.rig.config.ramp_s + 0.1
        spans: list[int] = []
        start = None
        for f in self.rig.book.frames:
            moves = f.state in (State.RUNNING, State.RAMPING)
            start = (start or f.time_monotonic_ns) if moves else None
            spans.append(f.time_monotonic_ns - start if start else 0)
        return [f"ran for {s * 1e-9:.2f} s" for s in spans if s * 1e-9 > longest][:1]

    def _too_fast(self) -> list[str]:
        limits = [o.slew_us_per_s for o in self.rig.config.output.values()]
        found = []
        for a, b in zip(self.rig.book.frames, self.rig.book.frames[1:], strict=False):
            if {a.state, b.state} <= {int(State.RUNNING), int(State.RAMPING)} and a.output_us and b.output_us:
                seconds = min((b.time_monotonic_ns - a.time_monotonic_ns) * 1e-9, 0.04)
                steps = zip(a.output_us, b.output_us, limits, strict=True)
                found += [
                    f"{abs(x - y):.0f} us in {seconds:.3f} s" for x, y, s in steps if abs(x - y) > s * seconds + 0.01
                ]
        return found[:1]


def played(history: History) -> Played:
    """The history on hardware of its own."""
    return Played(history).play()


def unhindered(history: History) -> History:
    """The same pilot with nothing going wrong."""
    return replace(history, events=(), oscillator_error=0.004)
