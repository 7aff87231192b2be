"""Open the ground station's ports."""

from daq.contract.ports import BytePort, PortError, SerialPort, TcpServerPort, UdpPort, open_socket_port, parse_port


def open_port(text: str) -> BytePort:
    """Open a port by its description; PortError says what is wrong with the description or the port."""
    spec = parse_port(text)
    if spec.kind != "serial":
        return open_socket_port(spec)
    import serial

    try:
        return SerialPort(serial.Serial(spec.address, spec.number, timeout=0, exclusive=True))
    except (OSError, ValueError) as error:
        raise PortError(
            f"serial port {spec.address} cannot be opened ({error}); check the name, or who uses it"
        ) from error


def receive(port: BytePort) -> list[tuple[str, bytes]]:
    """What has arrived at a port, by sender where the port knows senders apart."""
    if isinstance(port, UdpPort | TcpServerPort):
        return port.receive()
    data = port.read(65536)
    return [("", data)] if data else []
