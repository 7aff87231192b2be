"""Frames from the bytes of all ports; all bytes go to the telemetry log.

Each port and sender has its own decoder, so that damaged or hostile bytes cost no other sender a frame. On network ports, senders
that are not known as aircraft have an allowance of bytes; further ones are counted and dropped.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from daq.transport.mavlink_codec import FrameDecoder, Junk, MavlinkFrame
from daq.transport.ports import BytePort, TcpServerPort, UdpPort
from groundstation.receiver.findings import Faults
from groundstation.receiver.ports import READ_BYTES, STRANGERS_AT_ONCE, STRANGERS_PER_S, UdpListener
from groundstation.receiver.storage.lasting_log import LastingLog
from groundstation.receiver.timeline import Allowance
from groundstation.receiver.tlog import TlogWriter

_MAX_DECODERS = 32  # so that strangers cannot fill the memory
TELEMETRY_LOG = "telemetry log"


class Sender(NamedTuple):
    """Origin of frames: name of a port of the configuration, and address of the sender, empty for a serial port."""

    port: str
    source: str

    @property
    def name(self) -> str:
        """Address and port as text for reports."""
        return f"{self.source} on {self.port}" if self.source else self.port


class FrameInput:
    """Receives from ports, by name. folder: of telemetry.tlog; None for no log. faults: takes the errors of ports and log."""

    def __init__(self, ports: Mapping[str, BytePort], folder: Path | None, faults: Faults) -> None:
        self._ports = ports
        self._faults = faults
        self._decoders: dict[Sender, FrameDecoder] = {}
        self._aircraft: set[Sender] = set()
        self._strangers = {n: Allowance(STRANGERS_AT_ONCE, STRANGERS_PER_S) for n in ports}
        self._refused_bytes = 0
        self._retired = [0, 0, 0, 0]  # counts of decoders that were given up
        self._tlog = None if folder is None else TlogWriter(folder / "telemetry.tlog")

    def frames(self, now_ns: int, utc_ns: int) -> Iterator[tuple[Sender, MavlinkFrame]]:
        """All valid frames that have arrived, with their senders. now_ns, utc_ns: the ground's monotonic and UTC clocks."""
        for name, port in self._ports.items():
            for source, data in self._received(name, port):
                sender = Sender(name, source)
                if not self._within_allowance(port, sender, len(data), now_ns):
                    self._refused_bytes += len(data)
                    continue
                for item in self._decoder(sender, utc_ns).feed(data):
                    self._log(item, utc_ns)
                    if isinstance(item, MavlinkFrame):
                        yield sender, item

    def _within_allowance(self, port: BytePort, sender: Sender, size: int, now_ns: int) -> bool:
        """Whether `size` bytes of a sender are within its allowance; a UDP listener limits its senders itself."""
        unlimited = not isinstance(port, TcpServerPort) or sender in self._aircraft
        return unlimited or self._strangers[sender.port].spend(size, now_ns)

    def favour(self, sender: Sender) -> None:
        """Mark a sender as an aircraft, which has no allowance."""
        if sender not in self._aircraft:
            self._aircraft.add(sender)
            port = self._ports[sender.port]
            if isinstance(port, UdpListener):
                port.favour(sender.source)

    def forget(self, sender: Sender) -> None:
        """Undo `favour`, since the sender is no aircraft any more."""
        self._aircraft.discard(sender)
        port = self._ports[sender.port]
        if isinstance(port, UdpListener):
            port.forget(sender.source)

    def _received(self, name: str, port: BytePort) -> list[tuple[str, bytes]]:
        """(Sender's address, bytes) that have arrived; an error of the port becomes a fault."""
        try:
            if isinstance(port, UdpPort | TcpServerPort):  # ports that distinguish senders
                datagrams = port.receive()
            else:
                data = port.read(READ_BYTES)
                datagrams = [("", data)] if data else []
        except OSError as error:
            self._faults.note(name, error)
            return []
        self._faults.clear(name)
        return datagrams

    def _decoder(self, sender: Sender, utc_ns: int) -> FrameDecoder:
        """The decoder of a sender; of too many, the least recently used one is retired, of strangers first."""
        decoder = self._decoders.pop(sender, None)
        if decoder is None:
            if len(self._decoders) >= _MAX_DECODERS:
                strangers = (s for s in self._decoders if s not in self._aircraft)
                self._retire(next(strangers, next(iter(self._decoders))), utc_ns)
            decoder = FrameDecoder()
        self._decoders[sender] = decoder  # in order of use
        return decoder

    def _log(self, item: MavlinkFrame | Junk, utc_ns: int) -> None:
        if self._tlog is not None:
            try:
                self._tlog.write(item, utc_ns)
            except OSError as error:  # `flush` clears the fault when the disk works again
                self._faults.note(TELEMETRY_LOG, error)

    def _retire(self, sender: Sender, utc_ns: int) -> None:
        decoder = self._decoders.pop(sender)
        for item in decoder.finish():
            self._log(item, utc_ns)
        self._retired = [a + b for a, b in zip(self._retired, _counts(decoder), strict=True)]

    def totals(self) -> list[int]:
        """Bytes received, frames, damaged frames, and bytes discarded, of all senders."""
        return [sum(c) for c in zip(self._retired, *map(_counts, self._decoders.values()), strict=True)]

    @property
    def refused_bytes(self) -> int:
        """Bytes of strangers beyond their allowance, which were neither decoded nor logged."""
        listeners = (p for p in self._ports.values() if isinstance(p, UdpListener))
        return self._refused_bytes + sum(p.refused_bytes for p in listeners)

    @property
    def datagrams_dropped(self) -> int:
        """Datagrams that the kernel dropped before they could be read."""
        return sum(p.dropped for p in self._ports.values() if isinstance(p, UdpListener))

    def flush(self) -> None:
        """Write the telemetry log to the operating system."""
        if self._tlog is not None:
            with self._faults.watch(TELEMETRY_LOG):
                self._tlog.look_after()

    @property
    def logs(self) -> list[LastingLog]:
        return [] if self._tlog is None else [self._tlog.file]

    def close(self, utc_ns: int) -> None:
        """Log the bytes that decoders still hold, and close the log."""
        for sender in list(self._decoders):
            self._retire(sender, utc_ns)
        if self._tlog is not None:
            with self._faults.watch(TELEMETRY_LOG):
                self._tlog.close()


def _counts(decoder: FrameDecoder) -> list[int]:
    c = decoder.counts
    return [c.received_bytes, c.frames, c.damaged, c.discarded_bytes]
