"""Where telemetry usually comes in, for a ground station that was given no configuration."""

from collections.abc import Iterable
from typing import Protocol

LISTENER = "udpin:14550"  # MAVLink's port of ground stations; loopback, so that nobody else on the network is believed
BAUD = 57600  # SiK radios as delivered

RADIOS = frozenset({(0x0403, 0x6015), (0x0403, 0x6001), (0x10C4, 0xEA60)})
"""USB vendor and product of the serial chips on telemetry radios: FT230X and FT232R of FTDI (3DR, Holybro, mRo), CP2102 of
Silicon Labs (RFD900, its clones). Other serial devices are left alone: opening one can reset what hangs on it."""


class SerialDevice(Protocol):
    """What `serial.tools.list_ports` tells of a device. vid, pid: None where it is not on USB."""

    device: str
    vid: int | None
    pid: int | None


def usual_ports(devices: Iterable[SerialDevice] | None = None) -> tuple[str, ...]:
    """The UDP port, then every telemetry radio on USB, as `[link] ports` has them. devices: those of this computer by default."""
    if devices is None:
        from serial.tools.list_ports import comports

        devices = comports()
    radios = sorted(d.device for d in devices if (d.vid, d.pid) in RADIOS)
    return (LISTENER, *(f"serial:{device}:{BAUD}" for device in radios))
