"""Bytes of all ports in, sound frames out, and every byte into the telemetry log.

Each port and sender has a decoder of its own: one that is damaged, or hostile, costs nobody else a frame.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

from daq.transport.mavlink_codec import Frame, FrameDecoder, Junk
from daq.transport.ports import BytePort
from groundstation.receiver.faults import Faults
from groundstation.receiver.link import receive
from groundstation.receiver.tlog import TlogWriter

_MAX_DECODERS = 32
TELEMETRY_LOG = "telemetry log"


class Intake:
    """The receiving side of the ports. folder: where telemetry.tlog goes; None keeps nothing."""

    def __init__(self, ports: Mapping[str, BytePort], folder: Path | None, faults: Faults) -> None:
        self._ports = ports
        self._faults = faults
        self._decoders: dict[tuple[str, str], FrameDecoder] = {}
        self._retired = [0, 0, 0, 0]
        self._tlog = None if folder is None else TlogWriter(folder / "telemetry.tlog")

    def frames(self, utc_ns: int) -> Iterator[tuple[BytePort, Frame]]:
        """Everything that has arrived, with the port it came by."""
        for name, port in self._ports.items():
            for source, data in self._received(name, port):
                for found in self._decoder(name, source, utc_ns).feed(data):
                    self._log(found, utc_ns)
                    if isinstance(found, Frame):
                        yield port, found

    def _received(self, name: str, port: BytePort) -> list[tuple[str, bytes]]:
        try:
            found = receive(port)
        except OSError as error:
            self._faults.note(name, error)
            return []
        self._faults.clear(name)
        return found

    def _decoder(self, name: str, source: str, utc_ns: int) -> FrameDecoder:
        key = (name, source)
        if key not in self._decoders:
            if len(self._decoders) >= _MAX_DECODERS:
                self._retire(next(iter(self._decoders)), utc_ns)
            self._decoders[key] = FrameDecoder()
        return self._decoders[key]

    def _log(self, found: Frame | Junk, utc_ns: int) -> None:
        if self._tlog is not None:
            with self._faults.watch(TELEMETRY_LOG):
                self._tlog.write(found, utc_ns)

    def _retire(self, key: tuple[str, str], utc_ns: int) -> None:
        decoder = self._decoders.pop(key)
        for found in decoder.finish():
            self._log(found, utc_ns)
        self._retired = [a + b for a, b in zip(self._retired, _counts(decoder), strict=True)]

    def totals(self) -> list[int]:
        """Bytes received, frames, damaged frames, and bytes discarded."""
        return [sum(c) for c in zip(self._retired, *map(_counts, self._decoders.values()), strict=True)]

    def flush(self) -> None:
        """Hand the telemetry log to the operating system."""
        if self._tlog is not None:
            with self._faults.watch(TELEMETRY_LOG):
                self._tlog.flush()

    def close(self, utc_ns: int) -> None:
        """Log what is still undecided, close the log."""
        for key in list(self._decoders):
            self._retire(key, utc_ns)
        if self._tlog is not None:
            with self._faults.watch(TELEMETRY_LOG):
                self._tlog.close()


def _counts(decoder: FrameDecoder) -> list[int]:
    c = decoder.counts
    return [c.received_bytes, c.frames, c.damaged, c.discarded_bytes]
