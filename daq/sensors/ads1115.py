"""ADS1115: four-input 16-bit converter for vanes, potentiometers and supplies.

TI datasheet SBAS444E (May 2009, revised December 2024). Transfer function: volts = count * range / 32768 (section 7.3.3). Each
input is converted single-shot at up to 860 samples/s: 1.163 ms, up to 10 % longer by the clock's tolerance, plus
25 us to wake. The driver starts a conversion and hands control back, so several converters work at once and the scan
reads other chips meanwhile; the configuration register read before each result proves that the conversion is over and
that the chip still has its settings.

Self-test: the written configuration is read back. Plausibility: full-scale codes are clipped and out of range; more than
50 mV below ground cannot come from a potentiometer (broken ground).
"""

from collections.abc import Callable, Generator

from daq.bus import I2cBus
from daq.contract.channels import channels_of
from daq.contract.scan import RawValue, SensorState
from daq.sensors.base import SECOND, US, Driver, Reading, SelfTestError, Wait, signed
from daq.sensors.config import AnalogConfig

CONVERSION, CONFIG = 0x00, 0x01
START, SINGLE_SHOT, COMPARATOR_OFF = 0x8000, 0x0100, 0x0003
DONE = 0x8000
RANGES = (6.144, 4.096, 2.048, 1.024, 0.512, 0.256)
RATES = (8, 16, 32, 64, 128, 250, 475, 860)
CLOCK_TOLERANCE = 1.1
WAKE = 30 * US  # section 7.4.2.1: about 25 us from power-down to conversion
_POLLS = 8
_LOWEST_V = -0.05


def configuration(channel: int, range_v: float, rate: int) -> int:
    """Configuration word that starts one conversion of AIN0..AIN3 against ground."""
    return (
        START
        | (0b100 | channel) << 12
        | RANGES.index(range_v) << 9
        | SINGLE_SHOT
        | RATES.index(rate) << 5
        | COMPARATOR_OFF
    )


class Ads1115(Driver):
    """Four single-ended inputs of one group [counts]."""

    def __init__(self, config: AnalogConfig, group: str, bus: I2cBus, now_ns: Callable[[], int]) -> None:
        self.group = group
        self._bus = bus
        self._now = now_ns
        self._address = config.address
        self._range_v = config.range_v
        self._names = tuple(c.name for c in channels_of(group))[:4]
        self._words = [configuration(i, config.range_v, config.samples_per_second) for i in config.inputs]
        self._conversion = round(SECOND / config.samples_per_second)
        self._wait = round(self._conversion * CLOCK_TOLERANCE) + WAKE
        self._lowest = round(_LOWEST_V / config.range_v * 32768)
        self._latest_us: tuple[int, ...] = (0,) * len(self._names)
        self._kept_us: tuple[int, ...] | None = None
        self.max_rate_hz = SECOND / (len(self._names) * (self._wait + 300 * US))

    def initialise(self) -> Generator[Wait, None, None]:
        word = self._words[0]
        self._start(word)
        yield self._wait
        found = self._word(CONFIG)
        if (found | DONE) != word:
            raise SelfTestError(
                f"the chip at 0x{self._address:02x} answers with configuration 0x{found:04x} instead of 0x{word:04x};"
                " it is no ADS1115 or its wiring is disturbed"
            )
        yield from self.stages()

    def read(self) -> Reading:
        raise NotImplementedError("an ADS1115 is read in stages")

    def stages(self) -> Generator[Wait, None, Reading]:
        counts: list[int] = []
        middles: list[int] = []
        for word in self._words:
            self._start(word)
            middles.append(self._now() + self._conversion // 2)
            yield self._wait
            yield from self._finish(word)
            counts.append(signed(self._word(CONVERSION), 16))
        centre = sum(middles) // len(middles)
        self._latest_us = tuple((m - centre) // US for m in middles)
        return self._judge(dict(zip(self._names, counts, strict=True)), centre)

    def _finish(self, word: int) -> Generator[Wait, None, None]:
        """Wait until the conversion is over; raise SelfTestError when the chip has lost its settings or hangs."""
        for _ in range(_POLLS):
            found = self._word(CONFIG)
            if (found | DONE) != word:
                raise SelfTestError(f"ADS1115 at 0x{self._address:02x} was reset")
            if found & DONE:
                return
            yield self._conversion // 8
        raise SelfTestError(f"ADS1115 at 0x{self._address:02x} does not finish a conversion")

    def _judge(self, values: dict[str, RawValue], time_ns: int) -> Reading:
        for name, count in values.items():
            if count in (32767, -32768):
                return Reading(values, SensorState.OUT_OF_RANGE, f"{name} beyond the converter's range", time_ns)
            if count < self._lowest:
                return Reading(values, SensorState.OUT_OF_RANGE, f"{name} below ground", time_ns)
        return Reading(values, time_ns=time_ns)

    def _start(self, word: int) -> None:
        self._bus.write_i2c_block_data(self._address, CONFIG, [word >> 8, word & 0xFF])

    def _word(self, register: int) -> int:
        high, low = self._bus.read_i2c_block_data(self._address, register, 2)
        return high << 8 | low

    def keep_timing(self) -> None:
        self._kept_us = self._latest_us

    def metadata(self) -> dict[str, str]:
        """`NAME_after_s`: time of a channel's conversion after the group's offset, which is their mean."""
        after_us = self._kept_us or self._latest_us
        return {
            "chip": "ADS1115",
            "scale_v": repr(self._range_v / 32768),
            **{f"{n}_after_s": f"{d * 1e-6:.6f}" for n, d in zip(self._names, after_us, strict=True)},
        }
