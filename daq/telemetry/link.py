"""Put the aircraft's end of the radio link together from its configuration."""

import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from daq.clock import Clock
from daq.contract.recordings.messages import EventMessage, SequencerFrame
from daq.contract.recordings.recording import RecordingInfo
from daq.contract.scan import Scan
from daq.telemetry.backfill import BackfillServer, ScanStore
from daq.telemetry.config import DownlinkConfig
from daq.telemetry.control import Control, NoLogger
from daq.telemetry.downlink import Downlink
from daq.telemetry.log_server import LogServer
from daq.telemetry.uplink import TURN_NS, Uplink
from daq.transport.ports import BytePort, UdpPort
from daq.transport.reconnecting_port import open_lasting
from daq.transport.signing import Signer, load_key


def open_port(text: str) -> BytePort:
    """Open a port by its description, now or, if its device is missing, as soon as it appears. Raises PortError for a faulty
    description."""
    return open_lasting(text, wait=True)


def signer_for(config: DownlinkConfig, clock: Clock) -> Signer | None:
    """The signer of a configuration, None without a key. Raises SigningError for a key that cannot be used."""
    if config.key_file is None:
        return None
    state = config.signing_state or config.key_file.with_name(config.key_file.name + ".state")
    return Signer(load_key(config.key_file), clock.utc_ns, link_id=1, state_path=state)


@dataclass
class RadioLink:
    """The aircraft's end of the radio link. The logger uses this object as its downlink and `uplink` for commands; no call
    blocks."""

    downlink: Downlink
    uplink: Uplink
    store: ScanStore
    backfill: BackfillServer
    port: BytePort

    def offer(self, scan: Scan) -> None:
        self.store.add(scan)
        self.downlink.offer(scan)

    def service(self, now_ns: int) -> None:
        self.downlink.service(now_ns)

    def event(self, event: EventMessage) -> None:
        self.backfill.event(event)
        self.downlink.event(event)

    def text(self, severity: int, text: str, /) -> None:
        self.downlink.text(severity, text)

    def sequencer(self, frame: SequencerFrame) -> None:
        self.downlink.sequencer(frame)

    def idle(self, now_ns: int) -> None:
        """Serve both directions once after the logger has ended: backfill and downloads."""
        self.uplink.service(now_ns, NoLogger())
        self.downlink.service(now_ns)

    def report_on(self, logger: Control) -> None:
        """Report this logger's state to the ground from now on."""
        self.downlink.logger = logger

    def close(self) -> None:
        """Save the signing timestamps and close the port."""
        self.uplink.close()
        self.port.close()


def radio_link(
    config: DownlinkConfig,
    port: BytePort,
    clock: Clock,
    *,
    papers: Callable[[], RecordingInfo | None] = lambda: None,
    recordings: Sequence[Path] = (),
    boot: int | None = None,
    turn_ns: int = TURN_NS,
    facts: Callable[[], Mapping[str, str]] = dict,
) -> RadioLink:
    """The link of one logger.

    papers: returns identity and attachments of the recording, None while there is none; called in a thread of its own.
    recordings: directories whose files can be downloaded. boot: number of this start, 1 to 255; random unless a test sets it.
    turn_ns: longest time that received messages may take of the scan loop at a time [ns]. facts: returns run-time facts of the
    sensors (`static.nvm`); called in the scan loop, at a low rate.
    """
    boot = boot or secrets.randbelow(255) + 1
    signer = signer_for(config, clock)
    downlink = Downlink(config, port, clock, boot=boot, signer=signer, facts=facts)
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
