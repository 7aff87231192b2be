"""HDC2080 at register level (TI SNAS678C), in air that gets drier with height."""

from collections.abc import Callable

from firmware_sim.hardware.registers.chip import RegisterChip, to_counts
from firmware_sim.hardware.sensing.instruments import Instruments

IDENTITY = {0xFC: 0x49, 0xFD: 0x54, 0xFE: 0xD0, 0xFF: 0x07}
PERIODS_S = (0.0, 120.0, 60.0, 10.0, 5.0, 1.0, 0.5, 0.2)  # by bits 6 to 4 of register 0x0E


class SimulatedHdc2080(RegisterChip):
    """An HDC2080; humidity: relative humidity at a time [ns]."""

    def __init__(self, humidity: Callable[[int], float]) -> None:
        super().__init__()
        self._humidity = humidity
        self.reset(0)

    def reset(self, now_ns: int) -> None:
        self._settings = {0x0E: 0, 0x0F: 0}
        self._count, self._ready, self._next_ns = 0, False, now_ns

    def latch(self, now_ns: int) -> None:
        period_s = PERIODS_S[self._settings[0x0E] >> 4 & 7]
        if period_s and self._settings[0x0F] & 1 and now_ns >= self._next_ns:
            self._count = to_counts(self._humidity(now_ns) * 65536, 0, 65535)
            self._ready, self._next_ns = True, now_ns + round(period_s * 1e9)

    def read_register(self, register: int, now_ns: int) -> int:
        if register == 0x04:
            return 0x80 if self._ready else 0x00
        if register in (0x02, 0x03):
            self._ready = False
            return self._count >> 8 * (register - 2) & 0xFF
        return IDENTITY.get(register, self._settings.get(register, 0))

    def write_register(self, register: int, value: int, now_ns: int) -> None:
        self._settings[register] = value


def make(instruments: Instruments) -> SimulatedHdc2080:
    """60 % at sea level, 0.2 % less a metre; noise 0.2 %."""
    altitude, rng = instruments.inputs("altitude"), instruments.generator("humidity")
    return SimulatedHdc2080(lambda time_ns: 0.60 - 0.002 * float(altitude(time_ns)[0]) + 0.002 * rng.standard_normal())
