"""Open the ground station's ports."""

from daq.transport.ports import BytePort, PortError, TcpServerPort, UdpPort, open_socket_port, parse_port
from daq.transport.reconnecting_port import open_lasting
from groundstation.receiver.ports.udp_listener import UdpListener
from groundstation.receiver.timeline import GroundClock, SystemClock


def open_port(text: str, clock: GroundClock | None = None) -> BytePort:
    """Open a port by its description; PortError says what is wrong with the description or the port.

    clock: by which a listener allows strangers so much a second; this machine's by default.
    """
    spec = parse_port(text)
    if spec.kind != "udpin":
        return open_lasting(text)
    open_socket_port(spec).close()  # says in words why it cannot be had
    try:
        return UdpListener((spec.address, spec.number), clock or SystemClock())
    except OSError as error:
        raise PortError(f"{text}: cannot be opened ({error.strerror}); is another program using it?") from error


def receive(port: BytePort) -> list[tuple[str, bytes]]:
    """What has arrived at a port, by sender where the port knows senders apart."""
    if isinstance(port, UdpPort | TcpServerPort):
        return port.receive()
    data = port.read(65536)
    return [("", data)] if data else []
