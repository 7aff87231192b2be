"""Connects the simulated radio to a real port, for a ground station in another process or on another computer."""

from contextlib import suppress

from daq.transport.ports import BytePort
from firmware_sim.hardware.radio import RadioPort

_LARGEST_BACKLOG = 16_384  # bytes that wait for a slow line; older ones are dropped


class PortBridge:
    """A radio port and a real port of `daq.transport.ports`; bytes sent while the real port is absent are lost.

    Call `pump` regularly, for instance as `SimulatedFlightRun.each_scan`.
    """

    def __init__(self, radio: RadioPort, port: BytePort) -> None:
        self._radio = radio
        self._port = port
        self._waiting = b""

    def pump(self, now_ns: int) -> None:
        """Move bytes both ways."""
        with suppress(OSError):
            self._radio.write(self._port.read())
        self._waiting = (self._waiting + self._radio.read())[-_LARGEST_BACKLOG:]
        if self._waiting:
            try:
                self._waiting = self._waiting[self._port.write(self._waiting) :]
            except OSError:
                self._waiting = b""

    def close(self) -> None:
        """Close the real port."""
        self._port.close()
