"""Derivatives for other ground stations: NAMED_VALUE_FLOAT in the aircraft's name, to whatever ports are configured."""

from collections.abc import Callable, Sequence

from daq.transport.mavlink_codec import FrameEncoder, message_by_name
from daq.transport.ports import BytePort
from groundstation.identification.session import LiveState
from groundstation.receiver.ports.link import open_port

COMPONENT = 192  # MAV_COMP_ID_ONBOARD_COMPUTER2: a computer of that aircraft, but not the one that flies or logs
STD = ".s"  # ends the name of a bound: ten bytes are all there is
_MILLISECONDS = 2**32  # what time_boot_ms holds


class NamedValues:
    """Forwards to each port. say: told once about a port that fails, and again only after it has worked."""

    def __init__(self, ports: Sequence[str], say: Callable[[str], None]) -> None:
        self._ports: dict[str, BytePort] = {text: open_port(text) for text in ports}
        self._encoders: dict[int, FrameEncoder] = {}
        self._failing: set[str] = set()
        self._say = say

    def send(self, system: int, state: LiveState) -> None:
        """Each derivative that is told, and its bound as `<name>.s`."""
        if not self._ports:
            return
        encoder = self._encoders.setdefault(system, FrameEncoder(system, COMPONENT))
        message = message_by_name()["NAMED_VALUE_FLOAT"]
        boot_ms = int(state.time * 1e3) % _MILLISECONDS
        for name in state.aircraft.shown:
            d = state.estimates.derivatives[name]
            if d.told:
                for key, value in ((name, d.estimate), (name + STD, d.std)):
                    payload = message.pack({"time_boot_ms": boot_ms, "name": key, "value": value})
                    self._write(encoder.frame(message.msg_id, payload))

    def _write(self, frame: bytes) -> None:
        for text, port in self._ports.items():
            try:
                port.read()  # what others say is not for here, and must not fill the system's buffer
                port.write(frame)
                self._failing.discard(text)
            except OSError as error:
                if text not in self._failing:
                    self._failing.add(text)
                    self._say(f"values cannot be forwarded to {text} ({error.strerror or error})")

    def close(self) -> None:
        """Close the ports."""
        for port in self._ports.values():
            port.close()
