"""Put the aircraft's end of the radio link together from its configuration."""

import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from daq.clock import Clock
from daq.contract.recordings.messages import EventMessage, SequencerFrame, Statistics
from daq.contract.recordings.recording import RecordingInfo
from daq.contract.scan import Scan
from daq.telemetry.backfill import BackfillServer, ScanStore
from daq.telemetry.config import DownlinkConfig
from daq.telemetry.downlink import Downlink, OnboardStatus
from daq.telemetry.log_server import LogServer
from daq.telemetry.uplink import TURN_NS, Uplink
from daq.transport.ports import BytePort, SerialPort, UdpPort
from daq.transport.reconnecting_port import open_lasting
from daq.transport.signing import Signer, load_key


def open_port(text: str) -> BytePort:
    """Open a port by its description, at once or when it comes; PortError says what is wrong with the description."""
    return open_lasting(text, _serial, wait=True)


def _serial(device: str, baud: int) -> SerialPort:
    import serial

    return SerialPort(serial.Serial(device, baud, timeout=0, exclusive=True))


def signer_for(config: DownlinkConfig, clock: Clock) -> Signer | None:
    """The signer of a configuration; None without a key. SigningError for a key that cannot be used."""
    if config.key_file is None:
        return None
    state = config.signing_state or config.key_file.with_name(config.key_file.name + ".state")
    return Signer(load_key(config.key_file), clock.utc_ns, link_id=1, state_path=state)


class RecordingLogger(Protocol):
    """What the link reports of the logger."""

    @property
    def recording(self) -> bool:
        """Whether a recording is under way."""
        ...

    def statistics(self) -> Statistics | None:
        """The books of the recording."""
        ...


def onboard_status(logger: RecordingLogger) -> OnboardStatus:
    """The logger's state as LOGGER_STATUS sends it."""
    books = logger.statistics()
    if books is None:
        return OnboardStatus(recording=logger.recording)
    return OnboardStatus(
        recording=logger.recording,
        slots=books.slots,
        written=books.written,
        dropped=books.dropped,
        lost=books.lost,
        missed=books.missed,
        queue=books.pending,
        free_bytes=books.extra.get("free_bytes"),
        lateness_p99_us=_percentile(books.edges_us, books.lateness, 0.99),
        write_errors=books.write_errors,
    )


def _percentile(edges_us: Sequence[int], counts: Sequence[int], share: float) -> int:
    """Upper edge of the histogram bin in which a percentile lies; the last bin has none and gives 65535."""
    below, total = 0, sum(counts)
    for edge, count in zip((*edges_us, 65535), counts, strict=False):
        below += count
        if total and below >= share * total:
            return edge
    return 0


class _NoLogger:
    """Stands for a logger that has ended: commands to it fail or do nothing."""

    recording = False
    weigh = None

    def start_recording(self) -> bool:
        return False

    def stop_recording(self) -> bool:
        return False

    def mark_event(self, text: str, origin: str) -> EventMessage:
        return EventMessage(0, 0, 0, origin, text)

    def ask_sequencer(self, digest: int | None) -> str:
        return "the logger has ended"


@dataclass
class RadioLink:
    """The link as the logger's loop uses it: this as its downlink, `uplink` as its uplink. Everything returns at once."""

    downlink: Downlink
    uplink: Uplink
    store: ScanStore
    backfill: BackfillServer
    port: BytePort

    def offer(self, scan: Scan) -> None:
        """Take a scan."""
        self.store.add(scan)
        self.downlink.offer(scan)

    def service(self, now_ns: int) -> None:
        """Send what is due."""
        self.downlink.service(now_ns)

    def event(self, event: EventMessage) -> None:
        """Tell the ground of an event."""
        self.backfill.event(event)
        self.downlink.event(event)

    def text(self, severity: int, words: str, /) -> None:
        """Send a sentence to the ground."""
        self.downlink.text(severity, words)

    def sequencer(self, frame: SequencerFrame) -> None:
        """Tell the ground what the sequencer is doing."""
        self.downlink.sequencer(frame)

    def idle(self, now_ns: int) -> None:
        """Both directions once, with no logger behind: backfill and downloads after the last scan."""
        self.uplink.service(now_ns, _NoLogger())
        self.downlink.service(now_ns)

    def report_on(self, logger: RecordingLogger) -> None:
        """Report this logger's state to the ground from now on."""
        self.downlink.status = lambda: onboard_status(logger)
        self.downlink.recording = lambda: logger.recording  # asked every second, the books only now and then

    def close(self) -> None:
        """Save what must outlive the process and give the port back."""
        self.uplink.close()
        self.port.close()


def radio_link(
    config: DownlinkConfig,
    port: BytePort,
    clock: Clock,
    *,
    status: Callable[[], OnboardStatus] = OnboardStatus,
    papers: Callable[[], RecordingInfo | None] = lambda: None,
    recordings: Sequence[Path] = (),
    boot: int | None = None,
    turn_ns: int = TURN_NS,
    facts: Callable[[], Mapping[str, str]] = dict,
) -> RadioLink:
    """The link of one logger. recordings: directories whose files can be downloaded. boot: given only in tests.

    papers: asked in a thread of its own. turn_ns: how long what arrives may occupy the scan loop at a time [ns].
    facts: run-time facts of the sensors (`static.nvm`), asked in the scan loop, at a low rate.
    """
    boot = boot or secrets.randbelow(255) + 1
    signer = signer_for(config, clock)
    downlink = Downlink(config, port, clock, boot=boot, signer=signer, status=status, facts=facts)
    store = ScanStore(round(config.backfill_memory_mb * 1e6))
    backfill = BackfillServer(store, downlink.boot, papers)
    uplink = Uplink(
        port,
        clock,
        downlink,
        signer=signer,
        backfill=backfill,
        logs=LogServer(recordings, clock.monotonic_ns),
        turn_ns=turn_ns,
        dropped=(lambda: port.dropped) if isinstance(port, UdpPort) else lambda: 0,
    )
    return RadioLink(downlink, uplink, store, backfill, port)
