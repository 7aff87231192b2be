"""What the sequencer drives and goes by."""

from dataclasses import dataclass
from typing import Protocol

from daq.actuation.pwm.heartbeat import HeartbeatLine
from daq.clock import Clock
from daq.sensors.bus import I2cBus


class AutopilotPort(Protocol):
    """A port to an autopilot that never waits: `daq.transport.ports`, or a simulated one."""

    def read(self, limit: int, /) -> bytes:
        """Bytes that have arrived, at most `limit`."""
        ...

    def write(self, data: bytes, /) -> int | None:
        """Send; how many bytes were taken."""
        ...


@dataclass(frozen=True, slots=True)
class Devices:
    """bus and heartbeat for a servo driver behind a multiplexer, autopilot for one in between; None where not opened."""

    bus: I2cBus | None
    heartbeat: HeartbeatLine | None
    clock: Clock
    autopilot: AutopilotPort | None = None
