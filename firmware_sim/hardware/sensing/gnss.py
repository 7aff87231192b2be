"""The GPS receiver of the simulated aircraft: fixes with errors, sent as UBX messages over a serial line.

Position errors vary slowly (first-order Gauss-Markov), as a real receiver's; velocity errors are white. Fixes are at whole
multiples of the navigation period in UTC and arrive some tens of milliseconds later, byte after byte at the speed of the line.
"""

import math
from collections.abc import Callable

from daq.utilities.constants import ROUND_EARTH_RADIUS
from firmware_sim.hardware.registers.ublox import ReceiverFix, UbloxReceiver
from firmware_sim.hardware.sensing.instruments import Instruments

BAUD = 115_200
_SECOND_NS = 1_000_000_000
_RESTART_NS = 2_000_000_000  # hot start after a loss of power


class GnssReceiver:
    """A `Talker` for the serial port of the GPS.

    start_utc_ns: true UTC at the instruments' origin [ns]. corrupt: (bytes, time [ns]) -> the bytes of a message as they arrive.
    """

    def __init__(
        self,
        instruments: Instruments,
        start_utc_ns: int,
        corrupt: Callable[[bytes, int], bytes] = lambda data, now_ns: data,
    ) -> None:
        self._instruments = instruments
        self._model = instruments.models.gnss
        self._start_utc_ns = start_utc_ns
        self._corrupt = corrupt
        self._ublox = UbloxReceiver(round(1000.0 / self._model.rate_hz) if self._model.configured else None)
        self._rng = instruments.generator("gnss")
        self._pulse_rng = instruments.generator("gnss pulse")
        self._pulse: tuple[int, int] | None = None  # last edge, and its stamp [ns]
        self._wander = self._rng.standard_normal(3)  # Gauss-Markov state of the position errors, unit variance
        self._epoch_ns = start_utc_ns  # UTC of the newest fix sent
        self._on_line: list[tuple[int, bytes]] = []  # time at which the first byte leaves [ns], rest of the message
        self._silent_until = instruments.origin_ns + round(self._model.first_fix_s * 1e9)
        self._powered = True

    def set_power(self, on: bool, now_ns: int) -> None:
        """Switch the power on or off; after switching on the receiver needs seconds for its first fix."""
        if on and not self._powered:
            self._silent_until = now_ns + _RESTART_NS
            self._ublox.restart()
        self._powered = on

    def receive(self, data: bytes, now_ns: int) -> None:
        if self._powered:
            answer = self._ublox.command(data)
            if answer:
                self._on_line.append((now_ns + 2_000_000, answer))

    def bytes_until(self, now_ns: int) -> bytes:
        self._navigate(now_ns)
        arrived = b""
        pending = []
        for start_ns, data in self._on_line:
            count = max(0, min(len(data), int((now_ns - start_ns) * 1e-9 * BAUD / 10.0)))
            arrived += data[:count]
            if count < len(data):
                pending.append((start_ns + round(count * 10.0 / BAUD * 1e9), data[count:]))
        self._on_line = pending
        return arrived

    def newest_pulse(self, now_ns: int) -> int | None:
        """Monotonic time of the last edge of the pulse-per-second line [ns], as the kernel stamps it; None without one.

        Edges come at whole UTC seconds while there is a fix; the stamp is late by a few microseconds of interrupt latency.
        """
        elapsed = now_ns - self._instruments.origin_ns
        utc_ns = self._start_utc_ns + elapsed + round(elapsed * self._model.clock_drift_ppm * 1e-6)
        edge_ns = self._monotonic_ns(utc_ns // _SECOND_NS * _SECOND_NS)
        if not self._powered or edge_ns < max(self._silent_until, self._instruments.origin_ns):
            return None
        if self._pulse is None or self._pulse[0] != edge_ns:
            self._pulse = (edge_ns, edge_ns + round(2000.0 + 1500.0 * abs(self._pulse_rng.standard_normal())))
        return self._pulse[1] if self._pulse[1] <= now_ns else None

    def _monotonic_ns(self, utc_ns: int) -> int:
        elapsed_ns = utc_ns - self._start_utc_ns
        return self._instruments.origin_ns + elapsed_ns - round(elapsed_ns * self._model.clock_drift_ppm * 1e-6)

    def _navigate(self, now_ns: int) -> None:
        """Compute the fixes of all epochs whose message begins to leave by now."""
        period_ns = self._ublox.period_ms * 1_000_000
        latency_ns = round(self._model.latency_ms * 1e6)
        while True:
            epoch_ns = (self._epoch_ns // period_ns + 1) * period_ns
            at_ns = self._monotonic_ns(epoch_ns)
            if at_ns + latency_ns > now_ns:
                return
            self._epoch_ns = epoch_ns
            if not self._powered or now_ns - at_ns > 1_000_000_000:
                continue
            message = self._ublox.report(self._fix(epoch_ns, at_ns, period_ns))
            self._on_line.append((at_ns + latency_ns, self._corrupt(message, at_ns)))

    def _fix(self, epoch_ns: int, at_ns: int, period_ns: int) -> ReceiverFix:
        m = self._model
        if at_ns < self._silent_until:
            return ReceiverFix(
                epoch_ns, 0, 0, 0.0, 0.0, 0.0, (0.0, 0.0, 0.0), 1.0, 4294967.0, 4294967.0, 20.0, resolved=False
            )
        memory = math.exp(-period_ns * 1e-9 / m.drift_time_s)
        self._wander = memory * self._wander + math.sqrt(1.0 - memory**2) * self._rng.standard_normal(3)
        north, east, up = self._wander * (m.horizontal_m, m.horizontal_m, m.vertical_m)
        latitude, longitude, altitude, vn, ve, vd = self._instruments.inputs(
            "latitude", "longitude", "altitude", "velocity_north", "velocity_east", "velocity_down"
        )(at_ns)
        metres_per_degree = math.pi / 180.0 * ROUND_EARTH_RADIUS
        noise = m.velocity_m_s * self._rng.standard_normal(3)
        return ReceiverFix(
            utc_ns=epoch_ns,
            fix_type=3,
            satellites=14,
            latitude_deg=latitude + north / metres_per_degree,
            longitude_deg=longitude + east / (metres_per_degree * math.cos(math.radians(latitude))),
            height_msl_m=altitude + up,
            velocity_ned=(vn + noise[0], ve + noise[1], vd + noise[2]),
            time_accuracy_s=m.time_accuracy_s,
            horizontal_accuracy_m=1.5 * m.horizontal_m,
            vertical_accuracy_m=1.5 * m.vertical_m,
            speed_accuracy_m_s=2.0 * m.velocity_m_s,
        )
