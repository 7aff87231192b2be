"""MS5525DSO-PP001DS: differential pressure of the pitot tube, +-1 psi, 24 bits.

TE Connectivity data sheet MS5525DSO (2017) as ArduPilot's and PX4's drivers have it: reset 0x1E; conversion of pressure 0x40, of
temperature 0x50, plus twice the step of oversampling (256 to 4096 in 0.6, 1.2, 2.3, 4.6, 9.1 ms); result at 0x00, zero where
there is none; eight words of PROM from 0xA0, checksum of four bits in the last (application note AN520). With coefficients C:
dT = D2 - 2^7 C5; T = 20 + dT C6 / 2^21 / 100 degC; p = (D1 (2^15 C1 + dT C3 / 2^7) / 2^21 - 2^17 C2 - dT C4 / 2^5) / 2^15 in
1e-4 psi. Done on board, because pressure without its temperature means nothing; recorded as 16 bits over `range_pa`
(0.2 Pa a count at +-1 psi, a tenth of what a tube makes), with the PROM as `pitot.prom`.

Self-test: PROM as its checksum says, and a conversion. Plausibility: no result, temperature, ends of range.
"""

from collections.abc import Generator, Sequence

from daq.contract.scan import SensorState
from daq.sensors.base import MS, US, Driver, Reading, SelfTestError, Wait
from daq.sensors.bus import write_raw
from daq.sensors.ms4525do import JUMP_PA, PitotConfig, nominal_transfer, temperature_count
from daq.utilities.constants import PSI, ZERO_CELSIUS

RESET, ADC, PROM = 0x1E, 0x00, 0xA0
PRESSURE_2048, TEMPERATURE_1024 = 0x46, 0x54
PRESSURE_TIME = 4_540 * US  # at most; of temperature 2.28 ms
PRESSURE_WAIT, TEMPERATURE_WAIT = 5_200 * US, 2_900 * US  # from before the command goes out, which takes a part of it
COLDEST, WARMEST = ZERO_CELSIUS - 40.0, ZERO_CELSIUS + 125.0
_ENDS = (0, 0xFFFF)


def prom_crc(words: Sequence[int]) -> int:
    """Checksum of eight words of PROM, the place of the checksum left out: polynomial 0x3000, highest four bits (AN520)."""
    remainder = 0
    for byte in b"".join(w.to_bytes(2, "big") for w in (*words[:7], words[7] & 0xFF00)):
        remainder ^= byte
        for _ in range(8):
            remainder = (remainder << 1 ^ (0x3000 if remainder & 0x8000 else 0)) & 0xFFFF
    return remainder >> 12


def compensate(words: Sequence[int], pressure: int, temperature: int) -> tuple[float, float]:
    """Pressure [Pa] and temperature [K] of two results of the converter, by the words of the PROM."""
    _, c1, c2, c3, c4, c5, c6, _ = words
    warmth = temperature - c5 * 2**7
    kelvin = ZERO_CELSIUS + 20.0 + warmth * c6 / 2**21 / 100
    offset, slope = c2 * 2**17 + c4 * warmth / 2**5, c1 * 2**15 + c3 * warmth / 2**7
    return (pressure * slope / 2**21 - offset) / 2**15 * 1e-4 * PSI, kelvin


class Ms5525(Driver):
    """Differential pressure [16 bits over the range] and temperature [counts of the channel table]."""

    name, groups, precedence, starts_first = "ms5525", ("pitot",), 2, True
    max_rate_hz = 100.0
    _config: PitotConfig

    def _derive_settings(self) -> None:
        self._scale, self._offset = nominal_transfer(self._config)
        self.max_step = {"pitot_pressure": JUMP_PA / self._scale}
        self._prom: tuple[int, ...] = ()

    def initialise(self) -> Generator[Wait, None, None]:
        write_raw(self._bus, self._address, bytes([RESET]))
        yield 5 * MS  # reload of the PROM: 2.8 ms
        read = self._bus.read_i2c_block_data
        words = tuple(int.from_bytes(bytes(read(self._address, PROM + 2 * i, 2)), "big") for i in range(8))
        if not any(words) or prom_crc(words) != words[7] & 0xF:
            raise SelfTestError(
                f"MS5525 coefficients do not match their checksum (0x{prom_crc(words):x}, stored 0x{words[7] & 0xF:x}):"
                " read wrongly, or the chip is damaged; check supply and wiring"
            )
        self._prom = words
        reading = yield from self.stages()
        if reading.state is SensorState.STALE:
            raise SelfTestError("MS5525 converts nothing; check its supply")

    def read(self) -> Reading:
        raise NotImplementedError("an MS5525 is read in stages")

    def stages(self) -> Generator[Wait, None, Reading]:
        begun_ns = self._now()
        pressure = yield from self._convert(PRESSURE_2048, PRESSURE_WAIT)
        temperature = yield from self._convert(TEMPERATURE_1024, TEMPERATURE_WAIT)
        if not pressure or not temperature:
            return Reading(state=SensorState.STALE, detail="pitot sensor has no result")
        pascal, kelvin = compensate(self._prom, pressure, temperature)
        if not COLDEST <= kelvin <= WARMEST:
            return Reading(state=SensorState.FAULT, detail=f"pitot sensor at {kelvin - ZERO_CELSIUS:.0f} degC")
        count = min(max(round((pascal - self._offset) / self._scale), _ENDS[0]), _ENDS[1])
        values = {"pitot_pressure": count, "pitot_temperature": temperature_count(kelvin)}
        middle_ns = begun_ns + PRESSURE_TIME // 2
        if count in _ENDS:
            return Reading(
                values, SensorState.OUT_OF_RANGE, "pitot pressure at the end of the sensor's range", middle_ns
            )
        return Reading(values, time_ns=middle_ns)

    def _convert(self, command: int, takes: Wait) -> Generator[Wait, None, int]:
        """The converter's result; 0 where it has none."""
        write_raw(self._bus, self._address, bytes([command]))
        yield takes
        return int.from_bytes(bytes(self._bus.read_i2c_block_data(self._address, ADC, 3)), "big")

    def metadata(self) -> dict[str, str]:
        prom = b"".join(w.to_bytes(2, "big") for w in self._prom).hex()
        return {"chip": "MS5525DSO", "scale_pa": repr(self._scale), "offset_pa": repr(self._offset), "prom": prom}
