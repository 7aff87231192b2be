"""ADS1115 four-channel 16-bit converter at register level (TI SBAS444E).

Inputs: volts at AIN0..AIN3 against ground. Conversions take their real time, off by this unit's clock error; a single-shot
result appears only when its conversion is over, and in continuous mode the first result after a change of channel
still belongs to the old one.
"""

from collections.abc import Callable

from firmware_sim.hardware.registers.chip import PoweredChip, to_counts

RANGE_V = (6.144, 4.096, 2.048, 1.024, 0.512, 0.256, 0.256, 0.256)
RATE_SPS = (8.0, 16.0, 32.0, 64.0, 128.0, 250.0, 475.0, 860.0)
RESET_CONFIG = 0x8583
WAKE_NS = 25_000  # from power-down to the start of a conversion
SOFTWARE_RESET = 0x06
_PAIRS = ((0, 1), (0, 3), (1, 3), (2, 3))
_OS, _SINGLE_SHOT = 0x8000, 0x0100

Volts = Callable[[int, int], float]
"""Volts at an input (0 to 3) averaged over a conversion around a time [ns]."""


class Ads1115Chip(PoweredChip):
    """An ADS1115; clock_error: relative error of its conversion time, up to +-0.1 by the datasheet."""

    def __init__(self, volts: Volts, clock_error: float = 0.0) -> None:
        super().__init__()
        self._volts = volts
        self._stretch = 1.0 + clock_error
        self.reset(0)

    def reset(self, now_ns: int) -> None:
        self._pointer = 0
        self._config = RESET_CONFIG
        self._thresholds = {2: 0x8000, 3: 0x7FFF}
        self._result = 0
        self._busy_until: int | None = None  # end of the conversion under way
        self._under_way = RESET_CONFIG  # configuration of the conversion under way

    def general_call(self, data: bytes, now_ns: int) -> None:
        if data[:1] == bytes([SOFTWARE_RESET]):
            self.reset(now_ns)

    def write(self, data: bytes, now_ns: int) -> None:
        if not data:
            return
        self._pointer = data[0] & 3
        if len(data) < 3:
            return
        value = int.from_bytes(data[1:3], "big")
        if self._pointer == 1:
            self._configure(value, now_ns)
        elif self._pointer > 1:
            self._thresholds[self._pointer] = value

    def read(self, count: int, now_ns: int) -> bytes:
        self._run(now_ns)
        if self._pointer == 0:
            word = self._result & 0xFFFF
        elif self._pointer == 1:
            idle = self._busy_until is None
            word = self._config & ~_OS | (_OS if idle else 0)
        else:
            word = self._thresholds[self._pointer]
        return (word.to_bytes(2, "big") * count)[:count]

    def _conversion_ns(self, config: int) -> int:
        return round(1e9 / RATE_SPS[config >> 5 & 7] * self._stretch)

    def _configure(self, value: int, now_ns: int) -> None:
        self._run(now_ns)
        continuous = not value & _SINGLE_SHOT
        start = value & _OS or continuous
        self._config = value & 0xFFFF
        if start and self._busy_until is None:
            self._under_way = self._config
            self._busy_until = now_ns + WAKE_NS + self._conversion_ns(value)

    def _run(self, now_ns: int) -> None:
        """Finish what is over by now; in continuous mode the next conversion starts with the newest configuration."""
        while self._busy_until is not None and now_ns >= self._busy_until:
            end_ns = self._busy_until
            duration = self._conversion_ns(self._under_way)
            if self._config & _SINGLE_SHOT:
                self._finish(end_ns - duration // 2)
                self._busy_until = None
                return
            missed = (now_ns - end_ns) // duration
            if missed and self._under_way == self._config:
                end_ns += missed * duration  # only the newest result can still be read
            self._finish(end_ns - duration // 2)
            self._under_way = self._config
            self._busy_until = end_ns + self._conversion_ns(self._config)

    def _finish(self, middle_ns: int) -> None:
        config = self._under_way
        selection = config >> 12 & 7
        if selection >= 4:
            volts = self._volts(selection - 4, middle_ns)
        else:
            plus, minus = _PAIRS[selection]
            volts = self._volts(plus, middle_ns) - self._volts(minus, middle_ns)
        self._result = to_counts(volts / RANGE_V[config >> 9 & 7] * 32768.0, -32768, 32767)
