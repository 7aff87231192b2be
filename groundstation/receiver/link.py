"""Open the ground station's ports."""

from daq.transport.ports import BytePort, SerialPort, TcpServerPort, UdpPort
from daq.transport.reconnecting_port import open_lasting


def open_port(text: str) -> BytePort:
    """Open a port by its description; PortError says what is wrong with the description or the port."""
    return open_lasting(text, _serial)


def _serial(device: str, baud: int) -> SerialPort:
    import serial

    return SerialPort(serial.Serial(device, baud, timeout=0, exclusive=True))


def receive(port: BytePort) -> list[tuple[str, bytes]]:
    """What has arrived at a port, by sender where the port knows senders apart."""
    if isinstance(port, UdpPort | TcpServerPort):
        return port.receive()
    data = port.read(65536)
    return [("", data)] if data else []
