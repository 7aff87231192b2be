"""Random histories of switch, sticks, modes, line and timing for the sequencer through an ArduPlane; what must hold."""

from dataclasses import dataclass, field

from hypothesis import strategies as st

from daq.actuation.autopilot.proof import PROBE_US
from daq.contract.sequencing import State
from tests.unit.daq.autopilot_rig import AutopilotRig, autopilot_config
from tests.unit.daq.sequencer_histories import FLYING, Happening
from tests.unit.daq.sequencer_rig import ARM, GO, OFF, PERIOD_NS, Flying, short_manoeuvre

MS = 1_000_000
LOOK_NS = 5 * MS
OVERRIDE_NS = 100 * MS
AFTER_LAPSE_NS = 45 * MS
"""Until servos show that an override has lapsed: the receiver's next frame (22 ms) is read by a loop, the next loop (20 ms) sets
the servos, and one look. Measured: `tests.studies.autopilot_histories`."""
AFTER_SWITCH_NS = 200 * MS
"""Until servos are the pilot's after his switch has left go, the computer alive or dead, the line cut or not; and so much more as
overrides come late."""
LATEST_NS = 150 * MS
STICK_LAG_NS = 110 * MS
"""The pilot's own signals reach the servos after a frame of the receiver and two loops; and one look."""
RESTING = (1510, 1490, 1500)
FRAMES = 330
AFTERWARDS = 60

WHAT = (
    "switch off",
    "switch arm",
    "switch between",
    "stick",
    "throttle",
    "mode",
    "bank",
    "no attitude",
    "link",
    "recording",
    "out lost",
    "in lost",
    "line lost",
    "out late",
    "in late",
    "ignored",
    "stall",
    "late",
    "ground stop",
    "dead",
)
SWITCH = {"switch off": OFF, "switch arm": ARM, "switch between": 1700.0}

happenings = st.builds(
    Happening,
    what=st.sampled_from(WHAT),
    start=st.integers(60, 300),
    lasts=st.integers(1, 50),
    size=st.floats(0.0, 1.0),
)


@dataclass(frozen=True)
class AutopilotHistory:
    """arm, go: frames at which the pilot moves his switch, as he does when nothing else happens."""

    arm: int
    go: int
    start: str
    events: tuple[Happening, ...]


histories = st.builds(
    AutopilotHistory,
    arm=st.integers(75, 95),
    go=st.integers(120, 150),
    start=st.sampled_from(("switch", "switch", "ground")),
    events=st.lists(happenings, max_size=5).map(tuple),
)


@dataclass
class Worst:
    """The longest seen: servos not the pilot's after the last override came, and after his switch left go [ns]."""

    lapse: int = 0
    switch: int = 0


@dataclass
class Played:
    """One history played."""

    history: AutopilotHistory
    faults: list[str] = field(default_factory=list)
    worst: Worst = field(default_factory=Worst)
    running: int = 0

    def __post_init__(self) -> None:
        config = autopilot_config(start=self.history.start, wait_s=2.0, limits={"link_s": 1.0})
        self.rig = AutopilotRig(self._switch, config=config, manoeuvre=short_manoeuvre(1.0))
        self._sticks: list[tuple[int, tuple[int, int, int], int]] = []  # time, sticks, mode
        self._came_ns = -(10**12)  # when the last override was taken
        self._left_go_ns = 0
        self._looked_ns = 100 * MS  # by then the receiver has been read

    @property
    def late_ns(self) -> int:
        """How late overrides come at most in this history."""
        return max((round(LATEST_NS * e.size) for e in self.history.events if e.what == "out late"), default=0)

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

    def play(self) -> "Played":
        """Frame by frame to the end."""
        rig = self.rig
        for line, ways in ((rig.plane.inward, "out"), (rig.plane.outward, "in")):
            line.lost = lambda t, w=ways: bool(
                self._on(f"{w} lost", t // PERIOD_NS) or self._on("line lost", t // PERIOD_NS)
            )
            line.late_ns = lambda t, w=ways: (
                round(LATEST_NS * e.size) if (e := self._on(f"{w} late", t // PERIOD_NS)) else 0
            )
        taken = rig.plane.rc.override

        def override(values: tuple[int, ...], now_ns: int) -> None:
            if any(0 < v < 65535 for v in values):
                self._came_ns = now_ns
            self._within(values, now_ns)
            taken(values, now_ns)

        rig.plane.rc.override = override  # type: ignore[method-assign]
        while rig.number < FRAMES + AFTERWARDS:
            self._set(rig.number)
            stall = self._on("stall", rig.number)
            if stall:
                self._advance(rig.now + round(stall.size * 400 * MS))
                rig.number = max(rig.number, -(-rig.now // PERIOD_NS))
            late = self._on("late", rig.number)
            rig.frame(late_ns=round(late.size * 19 * MS) if late else 0)
            self.running += rig.state is State.RUNNING
            self._advance(rig.now)
        self._at_the_end()
        return self

    def _set(self, number: int) -> None:
        rig = self.rig
        rig.alive = rig.alive and self._on("dead", number) is None
        rig.flying = next((f for what, f in FLYING.items() if self._on(what, number)), Flying())
        stick = self._on("stick", number)
        rig.sticks = (1510 + round(300 * stick.size - 150), 1490, 1500) if stick else RESTING
        rig.throttle = 1700 if self._on("throttle", number) else 1600
        rig.plane.set_mode(5 if self._on("mode", number) else 0, rig.now)
        rig.plane.parameters["RC_OPTIONS"] = 34.0 if self._on("ignored", number) else 32.0
        rig.link_s = 3.0 if self._on("link", number) else 0.1
        rig.book.recording = self._on("recording", number) is None
        if rig.alive and self._on("ground stop", number):
            rig.actuation.request(None)
        if rig.alive and number % 10 == 0:
            rig.actuation.request(int(rig.plan.digest[:6], 16))

    # ------------------------------------------------------------------------------------------- what must hold

    def _advance(self, to_ns: int) -> None:
        rig = self.rig
        rig.clock.advance_to(max(to_ns, rig.now))
        while self._looked_ns + LOOK_NS <= rig.now:
            self._looked_ns += LOOK_NS
            self._look(self._looked_ns)

    def _look(self, time_ns: int) -> None:
        plane = self.rig.plane
        outputs = plane.outputs_us(time_ns)[:3]
        self._sticks.append((time_ns, self.rig.sticks, plane.mode))
        self._sticks = [s for s in self._sticks if time_ns - s[0] <= STICK_LAG_NS]
        if self._switch(time_ns) == GO:
            self._left_go_ns = time_ns
        sticks, modes = {s for _, s, _ in self._sticks}, {m for _, _, m in self._sticks}
        slack = 2 * PROBE_US if self._checking(time_ns) else 0  # an elevon gets the probes of two sticks
        if any(_near(outputs, mixed(s, m), slack) for s in sticks for m in modes):
            return
        lapse, off = time_ns - self._came_ns, time_ns - self._left_go_ns
        self.worst.lapse, self.worst.switch = max(self.worst.lapse, lapse), max(self.worst.switch, off - self.late_ns)
        if lapse > OVERRIDE_NS + AFTER_LAPSE_NS:
            self._wrong(time_ns, f"servos are not the pilot's {lapse / MS:.0f} ms after the last override")
        if off > AFTER_SWITCH_NS + self.late_ns:
            self._wrong(time_ns, f"servos are not the pilot's {off / MS:.0f} ms after his switch left go")
        self._accounted(time_ns)

    def _checking(self, time_ns: int) -> bool:
        """Whether it is, or just was, being tried that an override is refused at arm; where the gate is open it is taken."""
        recent = [f for f in self.rig.book.frames[-15:] if time_ns - f.time_monotonic_ns < 200 * MS + self.late_ns]
        return any(f.state == State.CHECKING for f in recent)

    def _accounted(self, time_ns: int) -> None:
        """An override is in the recording: sent so long before, at most, as it may have been late and lasts."""
        beaten = [f.time_monotonic_ns for f in self.rig.book.frames if f.beating]
        if not beaten or time_ns - beaten[-1] > OVERRIDE_NS + AFTER_LAPSE_NS + 30 * MS + self.late_ns:
            self._wrong(time_ns, "overridden without a frame in the recording")

    def _within(self, values: tuple[int, ...], now_ns: int) -> None:
        config = self.rig.config
        limits = {o.channel: (o.lowest_us, o.highest_us) for o in config.output.values()}
        for channel, value in enumerate(values, start=1):
            if channel not in limits and value != 65535:
                self._wrong(now_ns, f"channel {channel} is touched")
            elif channel in limits and value != 0 and not limits[channel][0] <= value <= limits[channel][1]:
                self._wrong(now_ns, f"channel {channel} at {value}, outside its limits")

    def _wrong(self, time_ns: int, what: str) -> None:
        self.faults.append(f"{time_ns / MS:.0f} ms: {what}")

    def _at_the_end(self) -> None:
        rig = self.rig
        if rig.alive and rig.state is not State.IDLE:
            self.faults.append(f"stuck in {rig.state.words} with the switch off")
        longest = rig.plan.duration_s + rig.config.ramp_s + 0.1
        start = None
        for f in rig.book.frames:
            moves = f.state in (State.RUNNING, State.RAMPING)
            start = (start or f.time_monotonic_ns) if moves else None
            if start and (f.time_monotonic_ns - start) * 1e-9 > longest:
                self.faults.append("ran for longer than file and ramp")
                break


def _near(outputs: tuple[int, ...], wanted: tuple[int, ...], slack: int) -> bool:
    return all(abs(a - b) <= slack for a, b in zip(outputs, wanted, strict=True))


def mixed(sticks: tuple[int, int, int], mode: int) -> tuple[int, int, int]:
    """Servo pulses of an ArduPlane with elevons for these sticks [us]; out of MANUAL its stand-in for a controller."""
    share = 1.0 if mode == 0 else 1.0 / 3.0
    roll, pitch, yaw = (share * (s - 1500) for s in sticks)
    return 1500 + round(pitch - roll), 1500 + round(pitch + roll), 1500 + round(yaw)


def played(history: AutopilotHistory) -> Played:
    """The history on a rig of its own."""
    return Played(history).play()
