"""Listen to a SiK radio: it reports its signal once it has seen a heartbeat pass.

Signal in dBm is RSSI / 1.9 - 127 (SiK firmware, Si4463 scale).
"""

from contextlib import suppress

from daq.clock import NS, Clock
from daq.service.preflight import RadioReport
from daq.transport.mavlink_codec import RADIO_STATUS_ID, FrameDecoder, FrameEncoder, MavlinkFrame
from daq.transport.ports import BytePort

_STEP_NS = NS // 20
_READ_BYTES = 4096  # a step: more than fourteen times what a radio at 57600 baud brings
_FIXED_WING, _STANDBY, _MAVLINK_2 = 1, 3, 3


def listen(
    port: BytePort, clock: Clock, *, seconds: float = 3.0, system_id: int = 1, component_id: int = 191
) -> RadioReport | None:
    """Send heartbeats and wait for the radio's report; None when there is none within `seconds`, or no port."""
    decoder = FrameDecoder()
    encoder = FrameEncoder(system_id, component_id)
    start = now_ns = clock.monotonic_ns()
    next_heartbeat = start
    while now_ns - start < seconds * NS:
        with suppress(OSError):  # a port that is away at present
            if now_ns >= next_heartbeat:
                next_heartbeat += NS
                port.write(
                    encoder.message("HEARTBEAT", type=_FIXED_WING, system_status=_STANDBY, mavlink_version=_MAVLINK_2)
                )
            for item in decoder.feed(port.read(_READ_BYTES)):
                if isinstance(item, MavlinkFrame) and item.msg_id == RADIO_STATUS_ID:
                    return _report(item)
        clock.sleep_until(now_ns + _STEP_NS)
        now_ns = clock.monotonic_ns()
    return None


def _report(frame: MavlinkFrame) -> RadioReport:
    fields = frame.fields()
    dbm = {name: _dbm(fields[name]) for name in ("rssi", "noise", "remrssi", "remnoise")}
    return RadioReport(dbm["rssi"], dbm["noise"], dbm["remrssi"], dbm["remnoise"], int(str(fields["txbuf"])))


def _dbm(count: object) -> float:
    return int(str(count)) / 1.9 - 127
