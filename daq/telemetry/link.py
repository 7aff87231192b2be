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
    """Open a port by its description, at once or when it comes; PortError says what is wrong with the description."""
    return open_lasting(text, wait=True)


def signer_for(config: DownlinkConfig, clock: Clock) -> Signer | None:
    """The signer of a configuration; None without a key. SigningError for a key that cannot be used."""
    if config.key_file is None:
        return None
    state = config.signing_state or config.key_file.with_name(config.key_file.name + ".state")
    return Signer(load_key(config.key_file), clock.utc_ns, link_id=1, state_path=state)


@dataclass
class RadioLink:
    """The link as the logger's loop uses it: this as its downlink, `uplink` as its uplink. Everything returns at once."""

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

    def text(self, severity: int, words: str, /) -> None:
        self.downlink.text(severity, words)

    def sequencer(self, frame: SequencerFrame) -> None:
        self.downlink.sequencer(frame)

    def idle(self, now_ns: int) -> None:
        """Both directions once, with no logger behind: backfill and downloads after the last scan."""
        self.uplink.service(now_ns, NoLogger())
        self.downlink.service(now_ns)

    def report_on(self, logger: Control) -> None:
        """Report this logger's state to the ground from now on."""
        self.downlink.logger = logger

    def close(self) -> None:
        """Save what must outlive the process and give the port back."""
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
    """The link of one logger. recordings: directories whose files can be downloaded. boot: given only in tests.

    papers: asked in a thread of its own. turn_ns: how long what arrives may occupy the scan loop at a time [ns].
    facts: run-time facts of the sensors (`static.nvm`), asked in the scan loop, at a low rate.
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
