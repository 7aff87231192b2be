"""SDP31, SDP32, SDP33: differential pressure of the pitot tube by the heat that a flow through the sensor carries away.

Sensirion datasheet SDP3x-Digital version 0.8: command 0x3615 measures continuously, differential pressure, averaged until read; a
read returns pressure, temperature (200 counts a kelvin) and scale (60, 240 or 20 counts a pascal), each with a CRC-8 (polynomial
0x31, initial value 0xFF), as in the drivers of ArduPilot and PX4. The signed count plus 32768 is recorded.
The sensor measures mass flow: at an ambient pressure p it shows p / 966 hPa of the true difference (section "Altitude
correction"), which the ground corrects by the static pressure (`calibrated_pa`). Hoses longer than a metre reduce it further.

Self-test: CRCs, scale of the configured chip. Plausibility: CRC of each read, counts at the ends of the range; a chip that lost
power does not acknowledge a read until it gets the command to measure.
"""

import errno
from collections.abc import Callable, Generator

import fastcrc

from daq.contract.scan import SensorState
from daq.sensors.base import MS, Driver, Reading, SelfTestError, Wait, signed
from daq.sensors.bus import read_raw, write_raw
from daq.sensors.ms4525do import JUMP_PA, SDP_COUNTS_PER_PA, PitotConfig, nominal_transfer, temperature_count
from daq.utilities.constants import ZERO_CELSIUS

MEASURE, STOP = b"\x36\x15", b"\x3f\xf9"
CALIBRATED_PA = 96_600.0
MIDDLE, COUNTS_PER_KELVIN = 32768, 200.0
_ENDS = (-32768, 32767)

crc8: Callable[[bytes], int] = fastcrc.crc8.nrsc_5
"""CRC-8 with polynomial 0x31 and initial value 0xFF."""


def words_of(data: bytes) -> list[int]:
    """The 16-bit words of a read, in which each is followed by its checksum. Raises OSError for a wrong checksum."""
    for i in range(0, len(data), 3):
        if crc8(data[i : i + 2]) != data[i + 2]:
            raise OSError(errno.EBADMSG, "SDP3x: checksum of a word is wrong")
    return [int.from_bytes(data[i : i + 2], "big") for i in range(0, len(data), 3)]


class Sdp3x(Driver):
    """Differential pressure [counts from the middle of 16 bits] and temperature [counts of the channel table]."""

    name, groups, precedence = "sdp3x", ("pitot",), 2
    _config: PitotConfig

    def _derive_settings(self) -> None:
        self.max_step = {"pitot_pressure": JUMP_PA * SDP_COUNTS_PER_PA[self._config.part]}

    def initialise(self) -> Generator[Wait, None, None]:
        write_raw(self._bus, self._address, STOP)
        yield MS  # 0.5 ms until the next command
        write_raw(self._bus, self._address, MEASURE)
        yield 20 * MS  # first result after 8 ms
        scale = words_of(read_raw(self._bus, self._address, 9))[2]
        if scale != SDP_COUNTS_PER_PA[self._config.part]:
            chips = {counts: chip for chip, counts in SDP_COUNTS_PER_PA.items()}
            raise SelfTestError(
                f"pitot sensor has {scale} counts a pascal: a {chips.get(scale, 'chip that is no SDP3x').upper()}, not an"
                f" {self._config.part.upper()}; correct sensors.pitot.chip"
            )

    def read(self) -> Reading:
        raw, temperature = (signed(w, 16) for w in words_of(read_raw(self._bus, self._address, 6)))
        kelvin = temperature / COUNTS_PER_KELVIN + ZERO_CELSIUS
        values = {"pitot_pressure": raw + MIDDLE, "pitot_temperature": temperature_count(kelvin)}
        if raw in _ENDS:
            return Reading(values, SensorState.OUT_OF_RANGE, "pitot pressure at the end of the sensor's range")
        return Reading(values)

    def metadata(self) -> dict[str, str]:
        scale, offset = nominal_transfer(self._config)
        facts = {"chip": self._config.part.upper(), "calibrated_pa": repr(CALIBRATED_PA), "filter_delay_s": "0.0005"}
        return {**facts, "scale_pa": repr(scale), "offset_pa": repr(offset)}
