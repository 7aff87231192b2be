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
from typing import Annotated, Literal, TypeVar

from pydantic import field_validator

from daq.contract.channels import channels_of
from daq.contract.scan import RawValue, SensorState
from daq.sensors.base import SECOND, US, Address, Driver, Reading, SelfTestError, SensorSection, Wait, one_of
from daq.sensors.bus import NACK_ERRNOS, read_words

CONVERSION, CONFIG = 0x00, 0x01
START, SINGLE_SHOT, COMPARATOR_OFF = 0x8000, 0x0100, 0x0003
DONE = 0x8000
RANGES = (6.144, 4.096, 2.048, 1.024, 0.512, 0.256)
RATES = (8, 16, 32, 64, 128, 250, 475, 860)
CLOCK_TOLERANCE = 1.1
T = TypeVar("T")
WAKE = 30 * US  # section 7.4.2.1: about 25 us from power-down to conversion
_POLLS = 8
_REPETITIONS = 2
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


class AnalogConfig(SensorSection):
    """`[sensors.analog_a]` and so on: one ADS1115. inputs: the chip input of each channel of the group, in order."""

    driver: str = "ads1115"
    address: Address
    range_v: Annotated[float, one_of(*RANGES)] = 4.096
    samples_per_second: Literal[8, 16, 32, 64, 128, 250, 475, 860] = 860
    inputs: tuple[int, int, int, int] = (0, 1, 2, 3)

    @field_validator("inputs")
    @classmethod
    def _each_once(cls, inputs: tuple[int, ...]) -> tuple[int, ...]:
        if sorted(inputs) != [0, 1, 2, 3]:
            raise ValueError("inputs must name each of 0, 1, 2 and 3 once")
        return inputs


class Ads1115(Driver):
    """Four single-ended inputs of one group [counts]."""

    name = "ads1115"
    groups = ("analog_a", "analog_b", "analog_c")
    precedence = 0  # it works while the others are read
    starts_first = True
    stuck_s = {  # noqa: RUF012
        **dict.fromkeys(("alpha_vane", "beta_vane"), 2.0),
        **dict.fromkeys(("elevon_left_pot", "elevon_right_pot", "rudder_pot"), 10.0),
    }
    max_step = dict.fromkeys(("alpha_vane", "beta_vane"), 12000.0)
    _config: AnalogConfig

    def _derive_settings(self) -> None:
        config = self._config
        self._names = tuple(c.name for c in channels_of(self.group))[:4]
        words = [configuration(i, config.range_v, config.samples_per_second) for i in config.inputs]
        self._inputs = tuple(zip(self._names, words, strict=True))
        self._conversion = round(SECOND / config.samples_per_second)
        self._wait = round(self._conversion * CLOCK_TOLERANCE) + WAKE
        self._lowest = round(_LOWEST_V / config.range_v * 32768)
        self._middles: list[int] = [0] * len(self._names)  # of the latest conversions [ns]
        self._kept: list[int] | None = None
        self.max_rate_hz = SECOND / (len(self._names) * (self._wait + 300 * US))

    def initialise(self) -> Generator[Wait, None, None]:
        _, word = self._inputs[0]
        self._start(word)
        yield self._wait
        answer = self._word(CONFIG)
        if (answer | DONE) != word:
            raise SelfTestError(
                f"the chip at 0x{self._address:02x} answers with configuration 0x{answer:04x} instead of 0x{word:04x};"
                " it is no ADS1115 or its wiring is disturbed"
            )
        yield from self.stages()

    def read(self) -> Reading:
        raise NotImplementedError("an ADS1115 is read in stages")

    def stages(self) -> Generator[Wait, None, Reading]:
        values: dict[str, RawValue] = {}
        middles: list[int] = []
        for name, word in self._inputs:
            self._start(word)
            middles.append(self._now() + self._conversion // 2)
            yield self._wait
            answer, count = self._result()
            if answer != word:  # done and nothing changed reads as it was written
                yield from self._finish(word, answer)
                count = self._word(CONVERSION)
            values[name] = count - 0x10000 if count & 0x8000 else count
        self._middles = middles
        return self._judge(values, sum(middles) // len(middles))

    def _finish(self, word: int, found: int) -> Generator[Wait, None, None]:
        """Wait until the conversion is over; raise SelfTestError when the chip has lost its settings or hangs."""
        for _ in range(_POLLS):
            if (found | DONE) != word:
                raise SelfTestError(f"ADS1115 at 0x{self._address:02x} was reset")
            if found & DONE:
                return
            yield self._conversion // 8
            found = self._word(CONFIG)
        raise SelfTestError(f"ADS1115 at 0x{self._address:02x} does not finish a conversion")

    def _judge(self, values: dict[str, RawValue], time_ns: int) -> Reading:
        if self._lowest <= min(values.values()) and max(values.values()) < 32767:
            return Reading(values, time_ns=time_ns)
        for name, count in values.items():
            if count in (32767, -32768):
                return Reading(values, SensorState.OUT_OF_RANGE, f"{name} beyond the converter's range", time_ns)
            if count < self._lowest:
                return Reading(values, SensorState.OUT_OF_RANGE, f"{name} below ground", time_ns)
        return Reading(values, time_ns=time_ns)

    def _start(self, word: int) -> None:
        data = [word >> 8, word & 0xFF]
        try:
            self._bus.write_i2c_block_data(self._address, CONFIG, data)
        except OSError as error:
            self._repeat(error, lambda: self._bus.write_i2c_block_data(self._address, CONFIG, data))

    def _word(self, register: int) -> int:
        try:
            high, low = self._bus.read_i2c_block_data(self._address, register, 2)
        except OSError as error:
            high, low = self._repeat(error, lambda: self._bus.read_i2c_block_data(self._address, register, 2))
        return high << 8 | low

    def _result(self) -> tuple[int, int]:
        """Configuration and conversion, in one transaction: the one proves the other."""
        try:
            return read_words(self._bus, self._address, CONFIG, CONVERSION)
        except OSError as error:
            if error.errno not in NACK_ERRNOS:
                raise
            self.repeated += 1
            return self._word(CONFIG), self._word(CONVERSION)

    def _repeat(self, error: OSError, transfer: Callable[[], T]) -> T:
        """A refused transfer once more, or twice; raises the last error. Time-outs are not for a driver to repeat.

        A sample takes twelve transfers: at one refusal in five hardly any would come through whole.
        """
        for _ in range(_REPETITIONS):
            if error.errno not in NACK_ERRNOS:
                break
            self.repeated += 1
            try:
                return transfer()
            except OSError as again:
                error = again
        raise error

    def store_timing(self) -> None:
        self._kept = self._middles

    def metadata(self) -> dict[str, str]:
        """`NAME_after_s`: time of a channel's conversion after the group's offset, which is their mean."""
        middles = self._kept or self._middles
        centre = sum(middles) // len(middles)
        return {
            "chip": "ADS1115",
            "scale_v": repr(self._config.range_v / 32768),
            **{f"{n}_after_s": f"{(m - centre) * 1e-9:.6f}" for n, m in zip(self._names, middles, strict=True)},
        }
