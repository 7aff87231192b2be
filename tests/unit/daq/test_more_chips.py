"""DLVR, MS5525, BMP581 and ICM-42688-P: drivers at their simulated chips on a bus, and both against published numbers."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from pydantic import ValidationError

from daq.contract.scan import SensorState
from daq.sensors.base import Driver, Reading, SelfTestError, WrongChipError
from daq.sensors.bmp390 import StaticConfig
from daq.sensors.bmp581 import Bmp581
from daq.sensors.config import SensorsConfig
from daq.sensors.dlvr import Dlvr
from daq.sensors.icm20948 import ImuConfig
from daq.sensors.icm42688 import Icm42688
from daq.sensors.ms4525do import PitotConfig, nominal_transfer
from daq.sensors.ms5525 import Ms5525, compensate, prom_crc
from daq.utilities.constants import GRAVITY
from firmware_sim.hardware.registers.bmp581 import Bmp581Chip
from firmware_sim.hardware.registers.chip import PoweredChip
from firmware_sim.hardware.registers.dlvr import DlvrChip
from firmware_sim.hardware.registers.icm42688 import Icm42688Chip
from firmware_sim.hardware.registers.ms5525 import UNIT_PROM, Ms5525Chip, crc4
from tests.unit.firmware_sim.hardware import CountingClock, on_bus, quiet_rng, steady

MS = 1_000_000


class Bench:
    """A driver and its chip on a bus, with a clock of their own."""

    def __init__(self, driver: type[Driver], section: object, chip: PoweredChip) -> None:
        self.clock = CountingClock(1_000 * MS)
        address = section.address  # type: ignore[attr-defined]
        self.driver = driver(section, on_bus(address, chip, self.clock), self.clock.monotonic_ns)

    def set_up(self) -> None:
        for wait in self.driver.initialise():
            self.clock.advance(wait)

    def read(self, after_ms: float = 50.0) -> Reading:
        self.clock.wait_ms(after_ms)
        stages = self.driver.stages()
        while True:
            try:
                self.clock.advance(next(stages))
            except StopIteration as end:
                return end.value  # type: ignore[no-any-return]


def pascal(bench: Bench, reading: Reading, section: PitotConfig) -> float:
    scale, offset = nominal_transfer(section)
    return reading.values["pitot_pressure"] * scale + offset


class TestDlvr:
    SECTION = PitotConfig(driver="dlvr", chip="l20d")

    @pytest.mark.parametrize("pressure", [-4100.0, 0.0, 7.0, 480.0])
    def test_pressure_and_temperature(self, pressure: float) -> None:
        bench = Bench(Dlvr, self.SECTION, DlvrChip(steady(pressure, 301.0), 4981.78))
        bench.set_up()
        reading = bench.read()
        assert reading.state is SensorState.OK
        assert pascal(bench, reading, self.SECTION) == pytest.approx(pressure, abs=0.4)
        assert reading.values["pitot_temperature"] * 200 / 2047 - 50 == pytest.approx(27.85, abs=0.06)

    def test_data_sheet_counts(self) -> None:
        scale, offset = nominal_transfer(self.SECTION)  # 1.25 (count - 8192) / 16384 times 40 inches of water
        assert scale * 8192 + offset == pytest.approx(0.0, abs=1e-9)
        assert scale == pytest.approx(1.25 * 40 * 249.0889 / 16384)

    def test_status_bits_and_range(self) -> None:
        inputs = [0.0, 290.0]
        chip = DlvrChip(lambda now_ns: np.array(inputs), 4981.78)
        bench = Bench(Dlvr, self.SECTION, chip)
        bench.set_up()
        chip.faulty = True
        assert bench.read().state is SensorState.FAULT
        with pytest.raises(SelfTestError, match="DLVR reports status 3"):
            bench.set_up()
        chip.faulty = False
        inputs[0] = 5300.0
        reading = bench.read()
        assert (reading.state, reading.detail) == (
            SensorState.OUT_OF_RANGE,
            "pitot pressure beyond the sensor's range",
        )

    def test_the_range_has_to_be_said(self) -> None:
        with pytest.raises(ValidationError, match="chip is missing; write one of l01d"):
            PitotConfig(driver="dlvr")
        with pytest.raises(ValidationError, match="'sdp31' is none of driver dlvr"):
            PitotConfig(driver="dlvr", chip="sdp31")

    def test_a_jump_is_the_same_pressure_for_every_pitot(self) -> None:
        steps = {}
        for driver, section in ((Dlvr, self.SECTION), (Ms5525, PitotConfig(driver="ms5525", address=0x76))):
            made = driver(section, on_bus(section.address, DlvrChip(steady(0.0, 290.0))))
            steps[driver.name] = made.max_step["pitot_pressure"] * nominal_transfer(section)[0]
        assert steps["dlvr"] == pytest.approx(steps["ms5525"]) == pytest.approx(1578.0)


class TestMs5525:
    SECTION = PitotConfig(driver="ms5525", address=0x77)

    def test_checksum_of_the_application_note(self) -> None:
        words = (0x3132, 0x3334, 0x3536, 0x3738, 0x3940, 0x4142, 0x4344, 0x4500)
        assert prom_crc(words) == 0xB
        assert crc4(UNIT_PROM) == prom_crc((*UNIT_PROM, 0x000F))

    def test_compensation_by_hand(self) -> None:
        # dT = 2000000 - 2^7 15000 = 80000; T = 20 + 80000 * 20000 / 2^21 / 100 = 27.63; by integers as in the data sheet
        words = (0, 36000, 39000, 40000, 29000, 15000, 20000, 0)
        offset = 39000 * 2**17 + 29000 * 80000 // 2**5
        slope = 36000 * 2**15 + 40000 * 80000 // 2**7
        expected = (9_000_000 * slope // 2**21 - offset) / 2**15 * 1e-4 * 6894.757
        p, kelvin = compensate(words, 9_000_000, 2_000_000)
        assert p == pytest.approx(expected, abs=1e-3)
        assert kelvin == pytest.approx(273.15 + 27.6294, abs=1e-4)

    @pytest.mark.parametrize("pressure", [-900.0, 0.0, 213.0, 5000.0])
    def test_pressure_temperature_and_its_instant(self, pressure: float) -> None:
        bench = Bench(Ms5525, self.SECTION, Ms5525Chip(steady(pressure, 286.0)))
        bench.set_up()
        began_ns = bench.clock.now_ns + 50 * MS
        reading = bench.read()
        assert reading.state is SensorState.OK
        assert pascal(bench, reading, self.SECTION) == pytest.approx(pressure, abs=0.2)
        assert reading.values["pitot_temperature"] * 200 / 2047 - 50 == pytest.approx(12.85, abs=0.06)
        assert reading.time_ns is not None
        assert reading.time_ns - began_ns == pytest.approx(2.3e6, abs=1e6)
        assert bytes.fromhex(bench.driver.metadata()["prom"])[2:4] == UNIT_PROM[1].to_bytes(2, "big")

    def test_faults(self) -> None:
        chip = Ms5525Chip(steady(0.0, 290.0))
        bench = Bench(Ms5525, self.SECTION, chip)
        bench.set_up()
        chip.set_power(False, bench.clock.now_ns)
        with pytest.raises(OSError, match=r"."):
            bench.read()
        chip.set_power(True, bench.clock.now_ns)
        chip.damaged = True
        bench.clock.wait_ms(5.0)
        with pytest.raises(SelfTestError, match="do not match their checksum"):
            bench.set_up()

    def test_end_of_range_and_result_too_early(self) -> None:
        chip = Ms5525Chip(steady(7200.0, 290.0))
        bench = Bench(Ms5525, self.SECTION, chip)
        bench.set_up()
        assert bench.read().state is SensorState.OUT_OF_RANGE
        began = bench.driver.stages()
        next(began)  # and nobody waits
        next(began)
        with pytest.raises(StopIteration) as end:
            next(began)
        assert end.value.value.state is SensorState.STALE

    def test_address(self) -> None:
        with pytest.raises(ValidationError, match="an MS5525 sits at 0x76 or 0x77, not at 0x28"):
            PitotConfig(driver="ms5525")


class TestBmp581:
    SECTION = StaticConfig(driver="bmp581", address=0x47, rate_hz=50)

    def bench(self, pressure: float = 94_321.5, kelvin: float = 262.0, **section: int) -> tuple[Bench, Bmp581Chip]:
        chip = Bmp581Chip(steady(pressure, kelvin), (0.0, 0.0), quiet_rng())
        config = self.SECTION.model_copy(update=section)
        return Bench(Bmp581, config, chip), chip

    @pytest.mark.parametrize(("pressure", "kelvin"), [(94_321.5, 262.0), (101_325.0, 303.0)])
    def test_pressure_and_temperature_below_freezing_too(self, pressure: float, kelvin: float) -> None:
        bench, _ = self.bench(pressure, kelvin)
        bench.set_up()
        reading, facts = bench.read(), bench.driver.metadata()
        assert reading.state is SensorState.OK
        assert reading.values["static_pressure"] * float(facts["scale_pa"]) == pytest.approx(pressure, abs=0.01)
        warmth = reading.values["static_temperature"] * float(facts["scale_k"]) + float(facts["offset_k"])
        assert warmth == pytest.approx(kelvin, abs=1e-4)

    def test_registers_of_bosch_driver(self) -> None:
        bench, chip = self.bench()
        bench.set_up()
        # OSR_CONFIG: pressure on, eightfold (3 << 3), temperature once; ODR_CONFIG: DEEP_DIS, 50 Hz (0x0F << 2), normal
        assert (chip.read_register(0x36, 0), chip.read_register(0x37, 0)) == (0x58, 0xBD)
        assert chip.read_register(0x15, 0) == 0x01

    def test_each_sample_once(self) -> None:
        bench, _ = self.bench()
        bench.set_up()
        bench.read()
        assert bench.read(1.0).state is SensorState.STALE
        assert bench.read(25.0).state is SensorState.OK

    def test_faults(self) -> None:
        bench, chip = self.bench()
        chip.memory_fault = True
        with pytest.raises(SelfTestError, match="not ready after its reset"):
            bench.set_up()
        chip.memory_fault = False
        bench.set_up()
        assert bench.driver.intact()
        chip.upset()
        assert not bench.driver.intact()
        bench.set_up()
        assert bench.driver.intact()
        chip.reset(bench.clock.now_ns)
        bench.clock.wait_ms(5.0)
        assert bench.read().state is SensorState.STALE  # 0x7F7F7F

    def test_rate_that_the_oversampling_does_not_allow(self) -> None:
        with pytest.raises(ValidationError, match="at most 46 samples a second"):
            StaticConfig(driver="bmp581", address=0x46, rate_hz=50, pressure_oversampling=32)
        bench, _ = self.bench(pressure_oversampling=32)
        with pytest.raises(SelfTestError, match="cannot keep this rate"):
            bench.set_up()

    def test_beyond_its_range_and_another_chip(self) -> None:
        bench, chip = self.bench(pressure=27_000.0)
        bench.set_up()
        assert bench.read().state is SensorState.OUT_OF_RANGE
        chip.read_register = lambda register, now_ns: 0x60  # type: ignore[method-assign]
        with pytest.raises(WrongChipError, match="BMP581"):
            bench.set_up()
        with pytest.raises(ValidationError, match="a BMP581 sits at 0x46 or 0x47"):
            StaticConfig(driver="bmp581")


FORCE, RATE = (0.4, -1.2, -9.7), (0.31, -0.62, 0.93)


class TestIcm42688:
    SECTION = ImuConfig(driver="icm42688", mounting=("+y", "-x", "+z"))

    def bench(
        self, inputs: Callable[[int], np.ndarray] | None = None, section: ImuConfig = SECTION
    ) -> tuple[Bench, Icm42688Chip]:
        chip = Icm42688Chip(inputs or steady(*FORCE, *RATE, 308.0), (0.0,) * 6, quiet_rng())
        return Bench(Icm42688, section, chip), chip

    @pytest.mark.parametrize(("accel", "gyro"), [(2, 250), (8, 500), (16, 2000)])
    def test_every_range_in_body_axes(self, accel: int, gyro: int) -> None:
        section = self.SECTION.model_copy(update={"accel_range_g": accel, "gyro_range_dps": gyro})
        bench, _ = self.bench(section=section)
        bench.set_up()
        reading, facts = bench.read(), bench.driver.metadata()
        assert reading.state is SensorState.OK
        per_force, per_rate = float(facts["accel_scale_m_s2"]), float(facts["gyro_scale_rad_s"])
        force = [reading.values[f"accel_{a}"] * per_force for a in "xyz"]
        rates = [reading.values[f"gyro_{a}"] * per_rate for a in "xyz"]
        assert force == pytest.approx([FORCE[1], -FORCE[0], FORCE[2]], abs=per_force)
        assert rates == pytest.approx([RATE[1], -RATE[0], RATE[2]], abs=per_rate)
        assert reading.values["imu_temperature"] / 333.87 + 21.0 == pytest.approx(308.0 - 273.15, abs=0.01)

    def test_registers_of_the_data_sheet(self) -> None:
        bench, chip = self.bench()
        bench.set_up()
        registers = {r: chip.read_register(r, 0) for r in range(0x4D, 0x54)}
        # AFSR off, both low noise, 500 deg/s and 8 g at 500 Hz, first order, both over 40
        assert registers[0x4D] & 0xC0 == 0x40
        assert (registers[0x4E], registers[0x4F], registers[0x50], registers[0x52]) == (0x0F, 0x4F, 0x2F, 0x77)
        assert registers[0x51] & 0x0C == 0
        assert registers[0x53] & 0x18 == 0
        chip.write_register(0x76, 1, 0)  # 213 Hz: DELT 5, DELTSQR 25, BITSHIFT 10; neither filter disabled
        assert [chip.read_register(r, 0) for r in range(0x0B, 0x0F)] == [0xA0, 5, 25, 0xA0]
        chip.write_register(0x76, 2, 0)
        assert [chip.read_register(r, 0) for r in (3, 4, 5)] == [10, 25, 0xA0]

    def test_delay_is_that_of_the_stated_bandwidth(self) -> None:
        bench, _ = self.bench(lambda now_ns: np.array((now_ns * 1e-9, 0, 0, now_ns * 1e-9 / 4, 0, 0, 300.0)))
        bench.clock.now_ns = 0
        bench.set_up()
        facts = bench.driver.metadata()
        for key, channel, scale, slope in (
            ("accel_delay_s", "accel_y", "accel_scale_m_s2", -1.0),
            ("gyro_delay_s", "gyro_y", "gyro_scale_rad_s", -0.25),
        ):
            reading = bench.read(400.0)
            late = bench.clock.now_ns * 1e-9 - reading.values[channel] * float(facts[scale]) / slope
            assert late == pytest.approx(float(facts[key]), abs=0.005)
        assert float(facts["gyro_delay_s"]) == pytest.approx(1 / (2 * math.pi * 12.5), abs=1e-6)

    def test_lost_and_changed_settings(self) -> None:
        bench, chip = self.bench()
        bench.set_up()
        for bank, register in ((0, 0x4F), (0, 0x52), (1, 0x0C), (2, 0x05)):
            assert bench.driver.intact()
            chip.upset(bank, register)
            assert not bench.driver.intact(), (bank, register)
            bench.set_up()
        assert bench.read().state is SensorState.OK
        chip.reset(bench.clock.now_ns)
        assert (bench.read().state, bench.read().detail) == (SensorState.FAULT, "IMU was reset")

    def test_stale_and_clipped(self) -> None:
        inputs = np.array((*FORCE, *RATE, 300.0))
        bench, _ = self.bench(lambda now_ns: inputs)
        bench.set_up()
        # 1 ms a read, a sample each 2 ms
        assert {bench.read(0.0).state for _ in range(6)} == {SensorState.OK, SensorState.STALE}
        inputs[2] = -9.0 * GRAVITY
        reading = bench.read(900.0)
        assert (reading.state, reading.detail) == (SensorState.OUT_OF_RANGE, "IMU beyond its range (accel)")

    def test_identity_filters_and_compass(self) -> None:
        bench, chip = self.bench()
        chip.read_register = lambda register, now_ns: 0xEA  # type: ignore[method-assign]
        with pytest.raises(WrongChipError, match="ICM-42688-P"):
            bench.set_up()
        with pytest.raises(ValidationError, match=r"accel_lowpass_hz must be one of 125, 100, 62\.5"):
            ImuConfig(driver="icm42688", accel_lowpass_hz=11.5)
        with pytest.raises(ValidationError, match="mag sits behind the imu, an ICM-20948"):
            SensorsConfig.model_validate({"imu": {"driver": "icm42688"}, "mag": {}})
