"""Each simulated chip against its datasheet: worked examples, closed forms and timing, without any driver."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from smbus2 import i2c_msg

from firmware_sim.hardware.bus import SimulatedBus
from firmware_sim.hardware.registers import ads1115, bmp390, capture, icm20948, ublox
from firmware_sim.hardware.registers.ads1115 import Ads1115Chip
from firmware_sim.hardware.registers.ak09916 import Ak09916Chip
from firmware_sim.hardware.registers.bmp390 import Bmp390Chip, Trimming, calibration_bytes
from firmware_sim.hardware.registers.capture import CaptureChip, crc8
from firmware_sim.hardware.registers.chip import Inputs
from firmware_sim.hardware.registers.icm20948 import Icm20948Chip
from firmware_sim.hardware.registers.ms4525do import Ms4525doChip
from firmware_sim.hardware.registers.nau7802 import Nau7802Chip
from tests.unit.firmware_sim.hardware import CountingClock, on_bus, quiet_rng, steady

AT_REST = (0.0, 0.0, 9.80665, 0.0, 0.0, 0.0, 294.15)


def woken_imu(
    clock: CountingClock, inputs: Inputs | None = None, noise: tuple[float, ...] = (0.0,) * 6
) -> SimulatedBus:
    """An ICM-20948 woken up, in bank 0, gyro and accelerometer at +-500 deg/s and +-8 g with their filters off."""
    bus = on_bus(0x68, Icm20948Chip(inputs or steady(*AT_REST), noise, np.random.default_rng(1)), clock)
    clock.wait_ms(20)
    bus.write_byte_data(0x68, 0x06, 0x01)
    bus.write_byte_data(0x68, 0x7F, 0x20)
    bus.write_byte_data(0x68, 0x01, 0x02)
    bus.write_byte_data(0x68, 0x14, 0x04)
    bus.write_byte_data(0x68, 0x7F, 0x00)
    clock.wait_ms(60)
    return bus


def imu_counts(bus: SimulatedBus) -> tuple[int, ...]:
    return struct.unpack(">7h", bytes(bus.read_i2c_block_data(0x68, 0x2D, 14)))


class TestIcm20948:
    def test_identity_and_sleep_after_power_up(self) -> None:
        bus = on_bus(0x68, Icm20948Chip(steady(*AT_REST), (0.0,) * 6, quiet_rng()))
        assert bus.read_byte_data(0x68, 0x00) == 0xEA
        assert bus.read_byte_data(0x68, 0x06) == 0x41
        assert imu_counts(bus) == (0,) * 7

    def test_scales_of_the_datasheet(self) -> None:
        rate = math.radians(100.0)
        clock = CountingClock()
        bus = woken_imu(clock, steady(9.80665, -9.80665, 4.903325, rate, -rate, 0.0, 294.15 + 10.0))
        assert imu_counts(bus) == (4096, -4096, 2048, 6550, -6550, 0, 3339)

    def test_clips_at_the_end_of_its_range(self) -> None:
        bus = woken_imu(CountingClock(), steady(500.0, -500.0, 0.0, 100.0, -100.0, 0.0, 294.15))
        assert imu_counts(bus)[:5] == (32767, -32768, 0, 32767, -32768)

    def test_filter_has_the_response_and_delay_of_its_bandwidth(self) -> None:
        """First order: gain 1/sqrt(2) at the 3 dB frequency; a slow ramp lags by 1 / (2 pi f)."""
        clock = CountingClock()
        frequency = 11.6

        def ramp(time_ns: int) -> np.ndarray:
            return np.array((0.0, 0.0, 0.0, time_ns * 1e-9, 0.0, 0.0, 294.15))

        bus = woken_imu(clock, ramp)
        bus.write_byte_data(0x68, 0x7F, 0x20)
        bus.write_byte_data(0x68, 0x01, 5 << 3 | 0x02 | 0x01)
        bus.write_byte_data(0x68, 0x7F, 0x00)
        for _ in range(40):
            clock.wait_ms(20)
            rate = imu_counts(bus)[3] / 65.5 * math.pi / 180.0
        lag = clock.now_ns * 1e-9 - rate
        assert lag == pytest.approx(1.0 / (2.0 * math.pi * frequency), abs=1.2e-3)  # a sample is up to 0.9 ms old

    def test_noise_is_what_it_is_told(self) -> None:
        clock = CountingClock()
        bus = woken_imu(clock, noise=(0.5, 0.5, 0.5, 0.02, 0.02, 0.02))
        rows = []
        for _ in range(600):
            clock.wait_ms(5)
            rows.append(imu_counts(bus)[:6])
        spread = np.std(np.array(rows), axis=0)
        expected = np.array([0.5 / 9.80665 * 4096] * 3 + [math.degrees(0.02) * 65.5] * 3)
        assert spread == pytest.approx(expected, rel=0.12)

    def test_data_ready_once_for_each_sample(self) -> None:
        clock = CountingClock()
        bus = woken_imu(clock)
        bus.write_byte_data(0x68, 0x7F, 0x20)
        bus.write_byte_data(0x68, 0x01, 0x03)  # filter on: 1125 Hz
        bus.write_byte_data(0x68, 0x00, 224)  # 1125 / 225 = 5 Hz
        bus.write_byte_data(0x68, 0x7F, 0x00)
        clock.wait_ms(250)
        assert [bus.read_byte_data(0x68, 0x1A) & 1 for _ in range(3)] == [1, 0, 0]

    def test_self_test_shifts_by_the_factory_response(self) -> None:
        clock = CountingClock()
        bus = woken_imu(clock)
        before = np.array(imu_counts(bus))
        bus.write_byte_data(0x68, 0x7F, 0x10)
        codes = np.array(bus.read_i2c_block_data(0x68, 0x02, 3))
        bus.write_byte_data(0x68, 0x7F, 0x20)
        bus.write_byte_data(0x68, 0x02, 0x38)
        bus.write_byte_data(0x68, 0x7F, 0x00)
        clock.wait_ms(20)
        shift = (np.array(imu_counts(bus)) - before)[3:6]
        assert shift == pytest.approx(2620.0 / 2.0 * 1.01 ** (codes - 1.0), abs=1.0)

    def test_loss_of_power_brings_reset_values_back(self) -> None:
        clock = CountingClock()
        chip = Icm20948Chip(steady(*AT_REST), (0.0,) * 6, quiet_rng())
        bus = on_bus(0x68, chip, clock)
        clock.wait_ms(20)
        bus.write_byte_data(0x68, 0x06, 0x01)
        bus.set_power(False)
        with pytest.raises(OSError, match="Remote I/O"):
            bus.read_byte_data(0x68, 0x00)
        bus.set_power(True)
        assert bus.read_byte_data(0x68, 0x06) & 0x40


class TestAk09916:
    def on_bus(self, clock: CountingClock, *field: float) -> SimulatedBus:
        host = Icm20948Chip(steady(*AT_REST), (0.0,) * 6, quiet_rng())
        mag = Ak09916Chip(host, steady(*field), 0.0, quiet_rng())
        bus = SimulatedBus(clock, {0x68: host, 0x0C: mag})
        clock.wait_ms(20)
        return bus

    def test_only_through_the_bypass(self) -> None:
        bus = self.on_bus(CountingClock(), 0.0, 0.0, 0.0)
        with pytest.raises(OSError, match="Remote I/O"):
            bus.read_byte_data(0x0C, 0x01)
        bus.write_byte_data(0x68, 0x0F, 0x02)
        assert bus.read_i2c_block_data(0x0C, 0x00, 2) == [0x48, 0x09]

    def test_counts_and_the_lock_until_st2(self) -> None:
        clock = CountingClock()
        bus = self.on_bus(clock, 30e-6, -15e-6, 0.15e-6)
        bus.write_byte_data(0x68, 0x0F, 0x02)
        bus.write_byte_data(0x0C, 0x31, 0x08)
        clock.wait_ms(15)
        data = bytes(bus.read_i2c_block_data(0x0C, 0x10, 9))
        assert data[0] & 1
        assert struct.unpack("<3h", data[1:7]) == (200, -100, 1)
        bus.read_i2c_block_data(0x0C, 0x11, 6)  # data without ST2
        clock.wait_ms(35)
        assert bus.read_byte_data(0x0C, 0x10) == 0x02  # nothing new, samples skipped
        bus.read_byte_data(0x0C, 0x18)
        clock.wait_ms(15)
        assert bus.read_byte_data(0x0C, 0x10) & 1

    def test_overflow(self) -> None:
        clock = CountingClock()
        bus = self.on_bus(clock, 3000e-6, 2000e-6, 0.0)
        bus.write_byte_data(0x68, 0x0F, 0x02)
        bus.write_byte_data(0x0C, 0x31, 0x08)
        clock.wait_ms(15)
        assert bus.read_i2c_block_data(0x0C, 0x10, 9)[8] & 0x08


class TestAds1115:
    def convert(self, bus: SimulatedBus, config: int) -> None:
        bus.write_i2c_block_data(0x48, 0x01, list(config.to_bytes(2, "big")))

    def result(self, bus: SimulatedBus) -> int:
        return int.from_bytes(bytes(bus.read_i2c_block_data(0x48, 0x00, 2)), "big", signed=True)

    def test_reset_configuration(self) -> None:
        bus = on_bus(0x48, Ads1115Chip(lambda channel, time_ns: 0.0))
        assert bus.read_i2c_block_data(0x48, 0x01, 2) == [0x85, 0x83]

    def test_single_shot_takes_its_time(self) -> None:
        clock = CountingClock()
        bus = on_bus(0x48, Ads1115Chip(lambda channel, time_ns: 1.024 * (channel + 1)), clock, overhead_us=0.0)
        self.convert(bus, 0xC3E3)  # AIN0, 4.096 V, single shot, 860 SPS
        started = clock.now_ns
        while not bus.read_i2c_block_data(0x48, 0x01, 2)[0] & 0x80:
            assert self.result(bus) == 0  # still the old value
        assert (clock.now_ns - started) * 1e-6 == pytest.approx(1e3 / 860.0 + 0.025, abs=0.35)  # found by polling
        assert self.result(bus) == 8192

    def test_result_belongs_to_the_middle_of_the_conversion(self) -> None:
        clock = CountingClock()
        bus = on_bus(0x48, Ads1115Chip(lambda channel, time_ns: time_ns * 1e-9 * 20.0), clock, overhead_us=0.0)
        clock.wait_ms(100)
        self.convert(bus, 0xC303)  # 8 SPS: 125 ms
        started = clock.now_ns
        clock.wait_ms(127)
        middle = started + 25_000 + 62_500_000
        assert self.result(bus) * 4.096 / 32768 == pytest.approx(middle * 1e-9 * 20.0, abs=2e-4)

    def test_slow_clock(self) -> None:
        clock = CountingClock()
        bus = on_bus(0x48, Ads1115Chip(lambda channel, time_ns: 1.0, clock_error=0.1), clock, overhead_us=0.0)
        self.convert(bus, 0xC3E3)
        clock.wait_ms(1.163 + 0.025)
        assert not bus.read_i2c_block_data(0x48, 0x01, 2)[0] & 0x80
        clock.wait_ms(0.12)
        assert bus.read_i2c_block_data(0x48, 0x01, 2)[0] & 0x80

    @given(st.floats(-8.0, 8.0), st.integers(0, 5))
    def test_every_range_scales_and_clips(self, volts: float, gain: int) -> None:
        clock = CountingClock()
        bus = on_bus(0x48, Ads1115Chip(lambda channel, time_ns: volts), clock)
        self.convert(bus, 0x8000 | 0x4000 | gain << 9 | 0x0100 | 0x00E3)
        clock.wait_ms(2)
        exact = volts / ads1115.RANGE_V[gain] * 32768.0
        assert self.result(bus) == pytest.approx(min(max(exact, -32768.0), 32767.0), abs=0.51)

    def test_continuous_mode_gives_one_stale_result_after_a_change_of_input(self) -> None:
        clock = CountingClock()
        bus = on_bus(0x48, Ads1115Chip(lambda channel, time_ns: float(channel)), clock)
        self.convert(bus, 0x42E3)  # AIN0 continuous
        clock.wait_ms(5)
        self.convert(bus, 0x52E3)  # AIN1
        clock.wait_ms(1.1)
        assert self.result(bus) == 0
        clock.wait_ms(1.5)
        assert self.result(bus) == 8000

    def test_general_call_resets(self) -> None:
        clock = CountingClock()
        bus = on_bus(0x48, Ads1115Chip(lambda channel, time_ns: 0.0), clock)
        self.convert(bus, 0x42E3)
        bus.i2c_rdwr(i2c_msg.write(0x00, [0x06]))
        assert bus.read_i2c_block_data(0x48, 0x01, 2) == [0x85, 0x83]


class TestMs4525do:
    @pytest.mark.parametrize(("psi", "count"), [(-1.0, 1638), (0.0, 8192), (1.0, 14745), (1.25, 16383), (-1.25, 0)])
    def test_transfer_function(self, psi: float, count: int) -> None:
        bus = on_bus(0x28, Ms4525doChip(steady(psi * 6894.757293, 298.15)), CountingClock(10**9))
        message = i2c_msg.read(0x28, 4)
        bus.i2c_rdwr(message)
        data = bytes(message)
        assert abs(((data[0] & 0x3F) << 8 | data[1]) - count) <= 1
        assert (data[2] << 3 | data[3] >> 5) == round(75.0 / 200.0 * 2047.0)
        assert data[0] >> 6 == 0

    def test_second_read_is_stale(self) -> None:
        bus = on_bus(0x28, Ms4525doChip(steady(0.0, 298.15)), CountingClock(10**9), overhead_us=0.0)
        first, second = i2c_msg.read(0x28, 4), i2c_msg.read(0x28, 4)
        bus.i2c_rdwr(first)
        bus.i2c_rdwr(second)
        assert [bytes(m)[0] >> 6 for m in (first, second)] == [0, 2]

    def test_fault_bit(self) -> None:
        chip = Ms4525doChip(steady(0.0, 298.15))
        chip.faulty = True
        message = i2c_msg.read(0x28, 2)
        on_bus(0x28, chip, CountingClock(10**9)).i2c_rdwr(message)
        assert bytes(message)[0] >> 6 == 3


def compensate(nvm: bytes, raw_p: int, raw_t: int) -> tuple[float, float]:
    """Pressure [Pa] and temperature [degC] exactly as BST-BMP390-DS002 appendix 8.5 and 8.6 print it, term by term."""
    t1, t2, t3, p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11 = struct.unpack("<HHbhhbbHHbbhbb", nvm)
    partial1 = raw_t - t1 / 2.0**-8
    t = partial1 * (t2 / 2.0**30) + partial1 * partial1 * (t3 / 2.0**48)
    out1 = p5 / 2.0**-3 + p6 / 2.0**6 * t + p7 / 2.0**8 * t**2 + p8 / 2.0**15 * t**3
    slope = (p1 - 2**14) / 2.0**20 + (p2 - 2**14) / 2.0**29 * t + p3 / 2.0**32 * t**2 + p4 / 2.0**37 * t**3
    square = raw_p**2 * (p9 / 2.0**48 + p10 / 2.0**48 * t)
    return out1 + raw_p * slope + square + raw_p**3 * (p11 / 2.0**65), t


class TestBmp390:
    def running(self, clock: CountingClock, pascal: float, kelvin: float, osr: int = 5 | 5 << 3) -> SimulatedBus:
        bus = on_bus(0x77, Bmp390Chip(steady(pascal, kelvin), (0.0, 0.0), quiet_rng()), clock)
        bus.write_byte_data(0x77, 0x1C, osr)
        bus.write_byte_data(0x77, 0x1D, 5)
        bus.write_byte_data(0x77, 0x1B, 0x33)
        clock.wait_ms(400)
        return bus

    @given(st.floats(30_000.0, 110_000.0), st.floats(-30.0, 60.0))
    def test_datasheet_polynomial_gives_the_pressure_back(self, pascal: float, celsius: float) -> None:
        trim = Trimming()
        raw_t = round(trim.raw_temperature(celsius))
        raw_p = round(trim.raw_pressure(pascal, celsius))
        assert 0 < raw_p < 2**24
        assert 0 < raw_t < 2**24
        pressure, temperature = compensate(calibration_bytes(), raw_p, raw_t)
        assert temperature == pytest.approx(celsius, abs=1e-4)
        assert pressure == pytest.approx(pascal, abs=0.1)

    def test_over_the_bus(self) -> None:
        bus = self.running(CountingClock(), 95_000.0, 280.0)
        assert bus.read_byte_data(0x77, 0x00) == 0x60
        nvm = bytes(bus.read_i2c_block_data(0x77, 0x31, 21))
        data = bytes(bus.read_i2c_block_data(0x77, 0x04, 6))
        raw_p, raw_t = int.from_bytes(data[:3], "little"), int.from_bytes(data[3:], "little")
        pressure, temperature = compensate(nvm, raw_p, raw_t)
        assert pressure == pytest.approx(95_000.0, abs=0.1)
        assert temperature == pytest.approx(6.85, abs=0.01)

    def test_flags_come_with_data_and_go_with_reading(self) -> None:
        clock = CountingClock()
        bus = self.running(clock, 95_000.0, 280.0)
        assert bus.read_byte_data(0x77, 0x03) & 0x60 == 0x60
        bus.read_i2c_block_data(0x77, 0x04, 6)
        assert bus.read_byte_data(0x77, 0x03) & 0x60 == 0
        clock.wait_ms(170)
        assert bus.read_byte_data(0x77, 0x03) & 0x60 == 0x60

    def test_skipped_value_before_the_first_measurement(self) -> None:
        bus = on_bus(0x77, Bmp390Chip(steady(95_000.0, 280.0), (0.0, 0.0), quiet_rng()))
        assert bus.read_i2c_block_data(0x77, 0x04, 6) == [0, 0, 0x80, 0, 0, 0x80]

    def test_impossible_rate_is_a_configuration_error(self) -> None:
        clock = CountingClock()
        bus = on_bus(0x77, Bmp390Chip(steady(95_000.0, 280.0), (0.0, 0.0), quiet_rng()), clock)
        bus.write_byte_data(0x77, 0x1C, 5)
        bus.write_byte_data(0x77, 0x1B, 0x33)  # 32-fold oversampling at 200 Hz
        assert bus.read_byte_data(0x77, 0x02) & 0x04

    def test_resolution_of_coarse_oversampling(self) -> None:
        """One step of 16 bits is 2.64 Pa, of 21 bits 0.085 Pa, about (datasheet table 6)."""
        trim = Trimming()
        for osr, step in ((0, 2.64), (5, 0.085)):
            _, c1, c2, c3 = trim.pressure_polynomial(25.0)
            raw = trim.raw_pressure(100_000.0, 25.0)
            slope = abs(c1 + raw * (2.0 * c2 + raw * 3.0 * c3))
            assert slope * 2 ** (8 - osr) == pytest.approx(step, rel=0.5)
        assert bmp390._quantised(8_388_700.0, 16) % 256 == 0

    def test_soft_reset(self) -> None:
        clock = CountingClock()
        bus = self.running(clock, 95_000.0, 280.0)
        bus.write_byte_data(0x77, 0x7E, 0xB6)
        clock.wait_ms(3)
        assert bus.read_byte_data(0x77, 0x1B) == 0


class TestNau7802:
    def started(self, clock: CountingClock, bridge: float) -> SimulatedBus:
        bus = on_bus(0x2A, Nau7802Chip(steady(bridge)), clock)
        bus.write_byte_data(0x2A, 0x00, 0x01)
        bus.write_byte_data(0x2A, 0x00, 0x06)
        clock.wait_ms(1)
        assert bus.read_byte_data(0x2A, 0x00) & 0x08
        bus.write_byte_data(0x2A, 0x01, 0x07)  # gain 128
        bus.write_byte_data(0x2A, 0x02, 0x30)  # 80 SPS
        bus.write_byte_data(0x2A, 0x00, 0x16)
        return bus

    def test_counts_of_a_bridge(self) -> None:
        clock = CountingClock()
        bus = self.started(clock, 1e-3)
        clock.wait_ms(80)
        assert bus.read_byte_data(0x2A, 0x00) & 0x20
        count = int.from_bytes(bytes(bus.read_i2c_block_data(0x2A, 0x12, 3)), "big", signed=True)
        assert count == round(1e-3 * 128 / 0.5 * 2**23)
        assert not bus.read_byte_data(0x2A, 0x00) & 0x20

    def test_first_conversions_are_settling(self) -> None:
        clock = CountingClock()
        bus = self.started(clock, 1e-3)
        clock.wait_ms(13)
        count = int.from_bytes(bytes(bus.read_i2c_block_data(0x2A, 0x12, 3)), "big", signed=True)
        assert abs(count) < 0.5 * 1e-3 * 128 / 0.5 * 2**23

    def test_revision(self) -> None:
        assert on_bus(0x2A, Nau7802Chip(steady(0.0))).read_byte_data(0x2A, 0x1F) & 0x0F == 0x0F


class TestCapture:
    def snapshot(self, bus: SimulatedBus) -> tuple[int, ...]:
        data = bytes(bus.read_i2c_block_data(0x40, 0x10, 28))
        assert crc8(data) == 0  # a CRC over data and CRC leaves nothing
        return struct.unpack(capture.SNAPSHOT_FORMAT, data[:-1])

    def test_check_value_of_the_crc(self) -> None:
        assert crc8(b"123456789") == 0xF4

    def test_widths_levels_and_reset_flag(self) -> None:
        clock = CountingClock()
        bus = on_bus(0x40, CaptureChip(steady(1.5e-3, 1.0e-3, 2.0e-3, 0.0, 3.0e-3, 1.2345e-3, 0, 1, 0, 0, 1)), clock)
        clock.wait_ms(100)
        assert bus.read_i2c_block_data(0x40, 0x00, 2) == [0x5C, 1]
        sequence, *rest = self.snapshot(bus)
        assert rest[:6] == [15000, 10000, 20000, 0, 30000, 12345]
        assert rest[6] == 0b100111  # channel 4 is silent, channel 5 too long
        assert all(age <= 20 for i, age in enumerate(rest[7:13]) if i != 3)
        assert rest[10] == 255
        assert rest[13] == rest[14] == 0b10010
        assert rest[17] == 0x01
        bus.write_byte_data(0x40, 0x04, 0x01)
        clock.wait_ms(10)
        later, *rest = self.snapshot(bus)
        assert rest[17] == 0x00
        assert 9 <= later - sequence <= 12

    def test_switch_edges_are_debounced_counted_and_latched(self) -> None:
        presses_ms = ((100, 140), (200, 203), (300, 360))  # the second one is shorter than the debounce time

        def inputs(time_ns: int) -> tuple[float, ...]:
            pressed = any(a <= time_ns / 1e6 < b for a, b in presses_ms)
            return (1.5e-3,) * 6 + (float(pressed),) + (0.0,) * 4

        clock = CountingClock()
        bus = on_bus(0x40, CaptureChip(inputs), clock)
        clock.wait_ms(60)
        self.snapshot(bus)
        for _ in range(8):
            clock.wait_ms(50)
            values = self.snapshot(bus)
        assert values[16] == 2
        clock.wait_ms(0)
        assert values[17] == pytest.approx(clock.now_ns / 1e6 - 310, abs=5)


class TestUblox:
    FIX = ublox.ReceiverFix(
        utc_ns=1_790_000_000_300_000_000, fix_type=3, satellites=12, latitude_deg=26.5, longitude_deg=80.25,
        height_msl_m=61.0, velocity_ned=(10.0, -2.0, 0.5), time_accuracy_s=25e-9, horizontal_accuracy_m=1.0,
        vertical_accuracy_m=2.0, speed_accuracy_m_s=0.1,
    )  # fmt: skip

    def test_agrees_with_another_parser(self) -> None:
        """Fields read with struct at the offsets of UBX-13003221 section 32.17.15, not with the packing format."""
        message = ublox.nav_pvt(self.FIX)
        assert len(message) == 100
        assert message[:6] == b"\xb5\x62\x01\x07\x5c\x00"
        body = message[6:98]
        assert struct.unpack_from("<i", body, 28)[0] == 265_000_000
        assert struct.unpack_from("<i", body, 24)[0] == 802_500_000
        assert struct.unpack_from("<i", body, 36)[0] == 61_000
        assert struct.unpack_from("<3i", body, 48) == (10_000, -2_000, 500)
        assert struct.unpack_from("<i", body, 16)[0] == 300_000_000
        assert body[20] == 3
        assert body[23] == 12
        assert struct.unpack_from("<i", body, 60)[0] == round(math.hypot(10, 2) * 1e3)
        a = b = 0
        for byte in message[2:98]:
            a = (a + byte) % 256
            b = (b + a) % 256
        assert message[98:] == bytes([a, b])

    def test_fraction_beyond_half_a_second_is_negative(self) -> None:
        fix = ublox.ReceiverFix(
            **{**{f: getattr(self.FIX, f) for f in self.FIX.__dataclass_fields__}, "utc_ns": 1_790_000_000_900_000_000}
        )
        body = ublox.nav_pvt(fix)[6:98]
        assert struct.unpack_from("<i", body, 16)[0] == -100_000_000

    def test_time_of_week(self) -> None:
        """2023-11-14 22:13:20 UTC is GPS Tuesday 22:13:38."""
        fix = ublox.ReceiverFix(
            **{**{f: getattr(self.FIX, f) for f in self.FIX.__dataclass_fields__}, "utc_ns": 1_700_000_000_000_000_000}
        )
        assert struct.unpack_from("<I", ublox.nav_pvt(fix), 6)[0] == ((2 * 24 + 22) * 3600 + 13 * 60 + 38) * 1000

    def test_comes_up_silent_and_obeys_both_generations(self) -> None:
        for message in (
            ublox.frame((0x06, 0x01), bytes((0x01, 0x07, 1))),
            ublox.frame((0x06, 0x8A), bytes((0, 1, 0, 0)) + (0x20910007).to_bytes(4, "little") + b"\x01"),
        ):
            receiver = ublox.UbloxReceiver()
            assert receiver.report(self.FIX) == b""
            assert receiver.command(message) == ublox.frame((0x05, 0x01), message[2:4])
            assert len(receiver.report(self.FIX)) == 100

    def test_ignores_damaged_commands_and_finds_the_next(self) -> None:
        good = ublox.frame((0x06, 0x08), (200).to_bytes(2, "little") + bytes(4))
        bad = bytearray(good)
        bad[7] ^= 0x10
        receiver = ublox.UbloxReceiver()
        assert receiver.command(bytes(bad) + b"noise" + good) == ublox.frame((0x05, 0x01), b"\x06\x08")
        assert receiver.period_ms == 200


def test_icm_bandwidth_tables_fall() -> None:
    assert list(icm20948.GYRO_BANDWIDTH_HZ[:7]) == sorted(icm20948.GYRO_BANDWIDTH_HZ[:7], reverse=True)
