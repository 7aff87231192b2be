"""Events of the receiver, in the order they happened. Times `received_ns` are on the ground's monotonic clock."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from daq.contract.scan import Scan


@dataclass(frozen=True, slots=True)
class Session:
    """One run of one aircraft's logger. boot: its id by the logger; turn: number of restarts that the ground has seen before."""

    system: int
    boot: int
    turn: int

    @property
    def name(self) -> str:
        """Name of the session's files."""
        return f"aircraft{self.system}_{self.turn:02d}_{self.boot:02x}"


class ScanReceived(NamedTuple):
    """A scan came down the link. late: older than an earlier received one (reordered), or completed afterwards."""

    session: Session
    scan: Scan
    received_ns: int  # ground monotonic
    received_utc_ns: int
    latency_s: float | None  # from the scan to its reception; None before the first time sync
    late: bool = False


@dataclass(frozen=True, slots=True)
class ScanFetched:
    """A scan came by backfill. data: as the aircraft encoded it (`daq.contract.scan.decode_scan`)."""

    session: Session
    data: bytes
    received_ns: int


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """An aircraft, ground station or radio is alive."""

    system: int
    component: int
    state: int  # MAV_STATE: 3 standby, 4 active
    received_ns: int


@dataclass(frozen=True, slots=True)
class StatusText:
    """A sentence from the aircraft; severity as in syslog."""

    system: int
    severity: int
    text: str
    received_ns: int


@dataclass(frozen=True, slots=True)
class LoggerStatus:
    """State of the logger: counts of slots and scans, 99th percentile of its lateness, and free bytes (None: not known)."""

    session: Session
    recording: bool
    in_flight: bool
    slots: int
    written: int
    dropped: int
    lost: int
    missed: int
    queue: int
    lateness_p99_us: int
    write_errors: int
    free_bytes: int | None
    received_ns: int


@dataclass(frozen=True, slots=True)
class AircraftStatistics:
    """The aircraft's own counts of what it has sent and rejected."""

    session: Session
    first_number: int
    last_number: int
    scans_offered: int
    scans_sent: int
    scans_dropped: int
    frames_sent: int
    rate_hz: float
    rejected_frames: int
    rejected_commands: int
    received_ns: int


@dataclass(frozen=True, slots=True)
class EventMarked:
    """The logger recorded an event."""

    session: Session
    time_monotonic_ns: int
    number: int
    origin: str
    text: str
    received_ns: int


@dataclass(frozen=True, slots=True)
class SequencerStatus:
    """State of the onboard sequencer. increments: elevator, aileron, rudder [rad]; elapsed_s: since the state began.

    state, reason, switch: numbers as in docs/sequencer.md. beating: whether pulses go to the servo driver; limited: whether slew
    or limits changed a pulse.
    """

    session: Session
    time_monotonic_ns: int
    number: int
    state: int
    reason: int
    switch: int
    elapsed_s: float
    increments: tuple[float, ...]
    beating: bool
    limited: bool
    received_ns: int


@dataclass(frozen=True, slots=True)
class LinkStatistics:
    """Quality of the link to one aircraft, about once a second; None: not known."""

    session: Session
    received_ns: int
    loss: float  # share of frames lost since the last report
    frames_received: int
    frames_lost: int
    scan_rate_hz: float
    latency_s: float | None
    round_trip_s: float | None
    clock_offset_s: float | None  # aircraft clock minus ground clock
    rssi_dbm: float | None = None  # at the ground
    remote_rssi_dbm: float | None = None  # at the aircraft
    noise_dbm: float | None = None
    remote_noise_dbm: float | None = None
    txbuf_percent: int | None = None


@dataclass(frozen=True, slots=True)
class Restarted:
    """The aircraft's logger has restarted: scan numbers begin again."""

    session: Session
    previous: Session | None
    received_ns: int


@dataclass(frozen=True, slots=True)
class CommandResult:
    """The end of a command sent from here."""

    system: int
    command: int
    words: str  # accepted, denied, ..., or 'no answer'
    accepted: bool
    received_ns: int


@dataclass(frozen=True, slots=True)
class ManoeuvreSent:
    """The result of a manoeuvre's transmission. taken: the sequencer flies it when it is armed next."""

    system: int
    digest: str
    words: str
    taken: bool
    received_ns: int


class ReceptionFindingKind(StrEnum):
    """Why received data are not used or not trusted (`groundstation.receiver.findings`)."""

    REFUSED = "refused"
    DOUBTED = "doubted"
    QUARANTINED = "quarantined"
    CONTESTED = "contested"


@dataclass(frozen=True, slots=True)
class ReceptionFinding:
    """Received data that are not used or not trusted. system 0: of no aircraft in particular.

    subject: the refused message, the doubted or quarantined data, or the second sender. detail: the reason, or the first sender.
    count: since the last report. used: whether the second sender's frames are used, since it came by another port. first: whether
    this is the first report of the subject.
    """

    kind: ReceptionFindingKind
    system: int
    subject: str
    detail: str
    count: int
    received_ns: int
    used: bool = False
    first: bool = True

    @property
    def text(self) -> str:
        """The finding as a sentence."""
        match self.kind:
            case ReceptionFindingKind.REFUSED:
                return f"refused {self.count} x {self.subject}: {self.detail}"
            case ReceptionFindingKind.DOUBTED:
                return f"not believed: {self.count} {self.subject}"
            case ReceptionFindingKind.QUARANTINED:
                return f"{self.subject} not used: {self.detail}"
        use = "both are used" if self.used else f"{self.count} frames not used"
        return (
            f"second sender: {self.subject} speaks for aircraft {self.system}, which is heard from {self.detail}; "
            f"{use} (a key on both ends shows which is genuine)"
        )


@dataclass(frozen=True, slots=True)
class Trouble:
    """A port or a file of the ground station (`what`) fails. words: the system's message; None where it works again."""

    what: str
    words: str | None
    received_ns: int


@dataclass(frozen=True, slots=True)
class BackfillProgress:
    """Progress of backfill. held: complete scans here; wanted: all there are; agreed: count and hash equal the aircraft's."""

    session: Session
    held: int
    wanted: int
    agreed: bool
    received_ns: int


@dataclass(frozen=True, slots=True)
class Accounting:
    """Fate of a session's scans, from the first to the last one known; inclusive ranges of scan numbers.

    sent = received + lost, whatever backfill fetched later. sent: by the aircraft's reports; unknown: not reported (yet) as sent
    or not; absent: numbers whose scan the downlink never got; missing: the part of `lost` that backfill has not fetched;
    backfilled: number of all complete scans.
    """

    session: Session
    first: int
    last: int
    received: int
    sent: int
    lost: list[tuple[int, int]] = field(default_factory=list)
    never_sent: int = 0
    absent: list[tuple[int, int]] = field(default_factory=list)
    unknown: list[tuple[int, int]] = field(default_factory=list)
    missing: list[tuple[int, int]] = field(default_factory=list)
    backfilled: int = 0

    @property
    def lost_count(self) -> int:
        return sum(b - a + 1 for a, b in self.lost)


Event = (
    ScanReceived
    | ScanFetched
    | Heartbeat
    | StatusText
    | LoggerStatus
    | AircraftStatistics
    | EventMarked
    | SequencerStatus
    | LinkStatistics
    | Restarted
    | CommandResult
    | ManoeuvreSent
    | ReceptionFinding
    | Trouble
    | BackfillProgress
)
