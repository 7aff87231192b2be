"""Each driver against bytes worked out by hand from its datasheet."""

import struct
from collections.abc import Generator

import pytest

from daq.contract.scan import SensorState
from daq.sensors import sdp3x
from daq.sensors.ads1115 import Ads1115, AnalogConfig
from daq.sensors.ak09916 import Ak09916, MagConfig
from daq.sensors.as5600 import As5600, EncoderConfig
from daq.sensors.base import Driver, Reading, SelfTestError, WrongChipError
from daq.sensors.bmp390 import Bmp390, StaticConfig
from daq.sensors.capture import Capture, CaptureConfig, ChecksumError, crc8
from daq.sensors.icm20948 import Icm20948, ImuConfig
from daq.sensors.ms4525do import Ms4525do, PitotConfig, nominal_transfer, split
from daq.sensors.nau7802 import Nau7802, ThrustConfig
from daq.sensors.sdp3x import Sdp3x, words_of
from tests.unit.daq.fakes import FakeBus, FakeChip, WordChip


def set_up(driver: Driver) -> int:
    """Run a set-up to its end; returns the time it asked for [ns]."""
    return sum(driver.initialise())


def finish(stages: Generator[int, None, Reading]) -> tuple[Reading, list[int]]:
    """Run a staged reading to its end; returns it and the waits [ns]."""
    waits = []
    while True:
        try:
            waits.append(next(stages))
        except StopIteration as end:
            return end.value, waits


class TestIcm20948:
    def chip(self) -> FakeChip:
        chip = FakeChip({0x00: 0xEA, 0x06: 0x41})
        bank = [0]
        banks: dict[int, dict[int, int]] = {2: {0x01: 0x01, 0x14: 0x01}}

        def after_write(register: int, value: int) -> None:
            if register == 0x7F:
                bank[0] = value >> 4
                chip.registers[0x00] = 0xEA if bank[0] == 0 else 0
            elif bank[0] == 2:
                banks[2][register] = value

        chip.after_write = after_write
        chip.banks = banks  # type: ignore[attr-defined]
        return chip

    def burst(self, accel: tuple[int, int, int], gyro: tuple[int, int, int], temperature: int = 0) -> bytes:
        return struct.pack(">7h", *accel, *gyro, temperature)

    def test_set_up_writes_datasheet_values(self) -> None:
        chip = self.chip()
        chip.put(0x2D, self.burst((0, 0, 4096), (1, 2, 3)))
        waited = set_up(Icm20948(ImuConfig(), FakeBus({0x68: chip})))
        assert chip.banks[2][0x01] == 0b00_101_01_1  # type: ignore[attr-defined]  # 11.6 Hz, 500 deg/s, filter on
        assert chip.banks[2][0x14] == 0b00_101_10_1  # type: ignore[attr-defined]  # 11.5 Hz, 8 g, filter on
        assert (0x06, 0x80) in chip.written
        assert chip.written.index((0x06, 0x01)) > chip.written.index((0x06, 0x80))
        assert (0x0F, 0x02) in chip.written  # bypass to the magnetometer
        assert 100_000_000 < waited < 300_000_000

    def test_wrong_identity_is_named(self) -> None:
        chip = FakeChip({0x00: 0x68})  # an MPU-6050
        with pytest.raises(WrongChipError, match="0x68 with identity 0xea but read 0x68"):
            set_up(Icm20948(ImuConfig(), FakeBus({0x68: chip})))

    def test_data_are_big_endian_and_turned_into_body_axes(self) -> None:
        chip = self.chip()
        chip.registers[0x1A] = 1
        chip.put(0x2D, bytes.fromhex("0102 FF00 1000 0005 FFFB 7FFE 0D0B"))
        bus = FakeBus({0x68: chip})
        upright = Icm20948(ImuConfig(), bus).read()
        assert upright.state is SensorState.OK
        assert [upright.values[f"accel_{a}"] for a in "xyz"] == [0x0102, -256, 4096]
        assert [upright.values[f"gyro_{a}"] for a in "xyz"] == [5, -5, 32766]
        assert upright.values["imu_temperature"] == 0x0D0B  # 3339 counts: 31 degC
        turned = Icm20948(ImuConfig(mounting=("+y", "+x", "-z")), bus).read()
        assert [turned.values[f"accel_{a}"] for a in "xyz"] == [-256, 0x0102, -4096]

    def test_clipped_stale_and_reset_are_told_apart(self) -> None:
        chip = self.chip()
        driver = Icm20948(ImuConfig(), FakeBus({0x68: chip}))
        chip.registers[0x1A] = 1
        chip.put(0x2D, self.burst((32767, 0, 4096), (0, 0, 1)))
        clipped = driver.read()
        assert clipped.state is SensorState.OUT_OF_RANGE
        assert clipped.values["accel_x"] == 32767
        chip.registers[0x1A] = 0
        chip.put(0x2D, self.burst((1, 0, 4096), (0, 0, 1)))
        assert driver.read().state is SensorState.STALE
        chip.put(0x2D, bytes(14))
        chip.registers[0x06] = 0x41
        reset = driver.read()
        assert (reset.state, reset.detail) == (SensorState.FAULT, "IMU was reset")

    def test_dead_sensor_fails_its_self_test(self) -> None:
        with pytest.raises(SelfTestError, match="only zeros"):
            set_up(Icm20948(ImuConfig(), FakeBus({0x68: self.chip()})))

    def test_filter_delay_is_that_of_a_first_order_filter(self) -> None:
        facts = Icm20948(ImuConfig(gyro_lowpass_hz=51.2), FakeBus({})).metadata()
        assert float(facts["gyro_delay_s"]) == pytest.approx(0.003108, abs=1e-6)
        assert float(facts["accel_scale_m_s2"]) == pytest.approx(0.0023942, abs=1e-7)


class TestAk09916:
    def driver(self, chip: FakeChip, mounting: tuple[str, str, str] = ("+x", "+y", "+z")) -> Ak09916:
        imu = ImuConfig(mounting=mounting)  # type: ignore[arg-type]
        return Ak09916(MagConfig(), imu, FakeBus({0x0C: chip, 0x68: FakeChip()}))

    def test_set_up_opens_the_bypass_then_measures_at_100_hz(self) -> None:
        chip, imu = FakeChip({0x00: 0x48, 0x01: 0x09}), FakeChip()
        set_up(Ak09916(MagConfig(), ImuConfig(), FakeBus({0x0C: chip, 0x68: imu})))
        assert imu.written == [(0x03, 0x00), (0x0F, 0x02)]
        assert chip.written == [(0x32, 0x01), (0x31, 0x08)]

    def test_little_endian_data_with_y_and_z_reversed(self) -> None:
        chip = FakeChip()
        chip.put(0x10, bytes.fromhex("01 3412 FEFF 0A00 00 00"))  # ST1, x 0x1234, y -2, z 10, dummy, ST2
        reading = self.driver(chip).read()
        assert reading.state is SensorState.OK
        assert [reading.values[f"mag_{a}"] for a in "xyz"] == [0x1234, 2, -10]

    def test_status_2_is_part_of_the_read(self) -> None:
        chip = FakeChip()
        lengths: list[int] = []
        bus = FakeBus({0x0C: chip})
        original = bus.read_i2c_block_data

        def spy(address: int, register: int, length: int) -> list[int]:
            lengths.append(register + length - 1)
            return original(address, register, length)

        bus.read_i2c_block_data = spy  # type: ignore[method-assign, assignment]
        Ak09916(MagConfig(), ImuConfig(), bus).read()
        assert lengths == [0x18]

    def test_overflow_and_no_new_sample(self) -> None:
        chip = FakeChip({0x10: 0x01, 0x18: 0x08})
        assert self.driver(chip).read().state is SensorState.OUT_OF_RANGE
        chip.registers[0x10] = 0x00
        assert self.driver(chip).read().state is SensorState.STALE

    def test_turns_with_the_imu(self) -> None:
        chip = FakeChip()
        chip.put(0x10, struct.pack("<B3hBB", 1, 100, 200, 300, 0, 0))
        values = self.driver(chip, ("+x", "-y", "-z")).read().values
        assert [values[f"mag_{a}"] for a in "xyz"] == [100, 200, 300]


class TestAds1115:
    def driver(self, chip: FakeChip, now: list[int] | None = None) -> Ads1115:
        clock = now or [0]
        return Ads1115(AnalogConfig(address=0x48), FakeBus({0x48: chip}), lambda: clock[0], "analog_a")

    def test_configuration_word_of_the_datasheet_example(self) -> None:
        chip = WordChip(lambda word: 0)
        reading, _ = finish(self.driver(chip).stages())
        assert [word for _, word in chip.written] == [0xC3E3, 0xD3E3, 0xE3E3, 0xF3E3]
        assert list(reading.values) == ["alpha_vane", "beta_vane", "elevon_left_pot", "elevon_right_pot"]

    def test_waits_for_the_slowest_clock_the_datasheet_allows(self) -> None:
        _, waits = finish(self.driver(WordChip(lambda word: 0)).stages())
        assert len(waits) == 4
        assert min(waits) >= 1.1 * 1e9 / 860 + 25e3

    def test_busy_chip_is_waited_for_and_a_hanging_one_given_up(self) -> None:
        chip = WordChip(lambda word: 1000)
        chip.busy_polls = 3
        reading, waits = finish(self.driver(chip).stages())
        assert reading.values["alpha_vane"] == 1000
        assert len(waits) == 7
        chip.busy_polls = 1000
        with pytest.raises(SelfTestError, match="does not finish"):
            finish(self.driver(chip).stages())

    def test_negative_counts_clipping_and_broken_ground(self) -> None:
        slightly = finish(self.driver(WordChip(lambda word: 0xFFF0)).stages())[0]
        assert (slightly.values["alpha_vane"], slightly.state) == (-16, SensorState.OK)
        clipped = finish(self.driver(WordChip(lambda word: 0x7FFF)).stages())[0]
        assert clipped.state is SensorState.OUT_OF_RANGE
        below = finish(self.driver(WordChip(lambda word: -1000)).stages())[0]
        assert (below.state, below.detail) == (SensorState.OUT_OF_RANGE, "alpha_vane below ground")

    def test_reset_in_mid_scan_is_noticed(self) -> None:
        chip = WordChip(lambda word: 5)
        stages = self.driver(chip).stages()
        next(stages)
        chip.word = 0x8583
        with pytest.raises(SelfTestError, match="was reset"):
            next(stages)

    def test_time_of_the_group_is_the_mean_of_its_conversions(self) -> None:
        now = [0]
        stages = self.driver(WordChip(lambda word: 5), now).stages()
        starts = []
        reading = None
        while reading is None:
            starts.append(now[0])
            try:
                now[0] += next(stages) + 100_000
            except StopIteration as end:
                reading = end.value
        expected = sum(s + round(1e9 / 860) // 2 for s in starts[:4]) / 4
        assert reading.time_ns == pytest.approx(expected, abs=2)


class TestMs4525do:
    def driver(self, answer: bytes) -> Ms4525do:
        chip = FakeChip()
        chip.plain = answer
        return Ms4525do(PitotConfig(), FakeBus({0x28: chip}))

    def test_four_bytes_split_as_in_the_interface_note(self) -> None:
        assert split(bytes.fromhex("2000 6400")) == (0, 0x2000, 0x320)
        assert split(bytes.fromhex("FFFF FFE0")) == (3, 0x3FFF, 0x7FF)

    def test_normal_reading(self) -> None:
        reading = self.driver(bytes.fromhex("2001 6400")).read()
        assert reading.state is SensorState.OK
        assert reading.values == {"pitot_pressure": 0x2001, "pitot_temperature": 0x320}

    @pytest.mark.parametrize(
        ("answer", "state"),
        [
            ("A000 6400", SensorState.STALE),
            ("E000 6400", SensorState.FAULT),
            ("6000 6400", SensorState.FAULT),
            ("0000 6400", SensorState.OUT_OF_RANGE),
            ("3FFF 6400", SensorState.OUT_OF_RANGE),
            ("2000 FFE0", SensorState.OUT_OF_RANGE),
        ],
    )
    def test_status_and_plausibility(self, answer: str, state: SensorState) -> None:
        assert self.driver(bytes.fromhex(answer)).read().state is state

    def test_two_reads_that_disagree_are_not_believed(self) -> None:
        chip = FakeChip()
        answers = [bytes.fromhex("2000 6400"), bytes.fromhex("A200 6400")]  # the second stale, 0x200 counts off
        bus = FakeBus({0x28: chip})

        def next_answer() -> None:
            chip.plain = answers.pop(0)

        bus.on_transfer = next_answer
        reading = Ms4525do(PitotConfig(), bus).read()
        assert reading.state is SensorState.OUT_OF_RANGE
        assert reading.values["pitot_pressure"] == 0x2000

    def test_transfer_function_in_the_recording(self) -> None:
        facts = self.driver(b"").metadata()
        scale, offset = float(facts["scale_pa"]), float(facts["offset_pa"])
        assert scale == pytest.approx(1.0521, abs=1e-4)
        assert 0.5 * 16383 * scale + offset == pytest.approx(0.0, abs=1e-6)
        assert 0.9 * 16383 * scale + offset == pytest.approx(6894.757, abs=1e-3)


class TestBmp390:
    NVM = bytes(range(1, 22))

    def checksum(self) -> int:
        """Remainder of 21 bytes with the first inverted, divided by x^8 + x^4 + x^3 + x^2 + 1, inverted."""
        value = (int.from_bytes(self.NVM, "big") ^ 0xFF << 160) << 8
        for place in range(175, 7, -1):
            value ^= (0x11D << place - 8) * (value >> place & 1)
        return value ^ 0xFF

    def chip(self) -> FakeChip:
        chip = FakeChip({0x00: 0x60, 0x30: self.checksum()})
        chip.put(0x31, self.NVM)
        return chip

    def test_set_up_and_coefficients(self) -> None:
        chip = self.chip()
        driver = Bmp390(StaticConfig(), FakeBus({0x77: chip}))
        waited = set_up(driver)
        assert dict(chip.written) == {0x7E: 0xB6, 0x1C: 0x03, 0x1D: 0x02, 0x1F: 0x00, 0x1B: 0x33}
        assert driver.metadata()["nvm"] == self.NVM.hex()
        assert waited > 20_000_000

    def test_blank_coefficients_and_error_flags_are_refused(self) -> None:
        blank = FakeChip({0x00: 0x60})
        with pytest.raises(SelfTestError, match="trimming bytes are all 0x00"):
            set_up(Bmp390(StaticConfig(), FakeBus({0x77: blank})))
        failing = self.chip()
        failing.registers[0x02] = 0x04
        with pytest.raises(SelfTestError, match="error flags 0x04"):
            set_up(Bmp390(StaticConfig(), FakeBus({0x77: failing})))

    @pytest.mark.parametrize("bit", [0, 50, 97, 167])
    def test_a_flipped_bit_of_the_trimming_is_refused(self, bit: int) -> None:
        chip = self.chip()
        chip.registers[0x31 + bit // 8] ^= 1 << bit % 8
        with pytest.raises(SelfTestError, match="do not match their checksum"):
            set_up(Bmp390(StaticConfig(), FakeBus({0x77: chip})))

    @pytest.mark.parametrize("register", [0x1B, 0x1C, 0x1D, 0x1F])
    def test_each_setting_is_read_back(self, register: int) -> None:
        chip = self.chip()
        driver = Bmp390(StaticConfig(), FakeBus({0x77: chip}))
        set_up(driver)
        assert driver.intact()
        chip.registers[register] ^= 0x02
        assert not driver.intact()

    def test_bmp388_at_its_place_is_named(self) -> None:
        with pytest.raises(WrongChipError, match=r"expected a BMP390 .* 0x60 but read 0x50"):
            set_up(Bmp390(StaticConfig(), FakeBus({0x77: FakeChip({0x00: 0x50})})))

    def test_little_endian_counts(self) -> None:
        chip = self.chip()
        chip.put(0x03, bytes.fromhex("70 010203 0A0B0C"))
        reading = Bmp390(StaticConfig(), FakeBus({0x77: chip})).read()
        assert reading.values == {"static_pressure": 0x030201, "static_temperature": 0x0C0B0A}

    @pytest.mark.parametrize(
        ("data", "state"),
        [
            ("10 010203 0A0B0C", SensorState.STALE),
            ("70 000080 0A0B0C", SensorState.STALE),
            ("70 000000 0A0B0C", SensorState.OUT_OF_RANGE),
        ],
    )
    def test_states(self, data: str, state: SensorState) -> None:
        chip = self.chip()
        chip.put(0x03, bytes.fromhex(data))
        assert Bmp390(StaticConfig(), FakeBus({0x77: chip})).read().state is state

    def test_oversampling_must_fit_the_rate(self) -> None:
        with pytest.raises(ValueError, match="longer than 1/rate_hz"):
            StaticConfig(rate_hz=200, pressure_oversampling=8)


class TestSdp3x:
    """Checksums from the data sheet's example: 0xBEEF has 0x92."""

    def reading(self, data: str, chip: str = "sdp33") -> Reading:
        plain = FakeChip()
        plain.plain = bytes.fromhex(data)
        config = PitotConfig(driver="sdp3x", address=0x21, chip=chip)  # type: ignore[arg-type]
        return Sdp3x(config, FakeBus({0x21: plain})).read()

    def test_checksum(self) -> None:
        assert sdp3x.crc8(bytes.fromhex("BEEF")) == 0x92
        assert words_of(bytes.fromhex("BEEF92")) == [0xBEEF]
        with pytest.raises(OSError, match="checksum of a word"):
            words_of(bytes.fromhex("BEEE92"))

    def test_counts_and_scale(self) -> None:
        word = bytes.fromhex("0BB8")  # 3000 counts: 150 Pa of an SDP33, 50 of an SDP31
        warm = bytes.fromhex("1388")  # 25 degrees
        data = word + bytes([sdp3x.crc8(word)]) + warm + bytes([sdp3x.crc8(warm)])
        for chip, pascal in (("sdp33", 150.0), ("sdp31", 50.0), ("sdp32", 12.5)):
            reading = self.reading(data.hex(), chip)
            scale, offset = nominal_transfer(PitotConfig(driver="sdp3x", chip=chip, address=0x21))  # type: ignore[arg-type]
            assert reading.values["pitot_pressure"] * scale + offset == pytest.approx(pascal)
            assert reading.values["pitot_temperature"] * 200 / 2047 - 50 == pytest.approx(25.0, abs=0.06)

    def test_another_chip_of_the_family_is_named(self) -> None:
        plain = FakeChip()
        plain.plain = b"".join(w + bytes([sdp3x.crc8(w)]) for w in (b"\0\0", b"\x13\x88", b"\0\x3c"))
        bus = FakeBus({0x21: plain})
        bus.i2c_rdwr = lambda *m: FakeBus.i2c_rdwr(bus, *m) if m[0].flags & 1 else None  # type: ignore[method-assign]
        with pytest.raises(SelfTestError, match="60 counts a pascal: a SDP31, not an SDP33"):
            set_up(Sdp3x(PitotConfig(driver="sdp3x", address=0x21), bus))


class TestAs5600:
    def chip(self, raw: int, status: int = 0x20) -> FakeChip:
        return FakeChip({0x0B: status, 0x0C: raw >> 8, 0x0D: raw & 0xFF})

    def driver(self, chip: FakeChip, centre: int = 2048) -> As5600:
        return As5600(EncoderConfig(centre_count=centre), FakeBus({0x36: chip}), group="vane_beta")

    @pytest.mark.parametrize(
        ("raw", "centre", "count"),
        [(2048, 2048, 0), (2148, 2048, 100), (4090, 6, -12), (6, 4090, 12), (0, 2048, -2048)],
    )
    def test_angle_from_the_centre_across_the_wrap(self, raw: int, centre: int, count: int) -> None:
        reading = self.driver(self.chip(raw), centre).read()
        assert (reading.state, reading.values) == (SensorState.OK, {"beta_encoder": count})

    @pytest.mark.parametrize(("status", "words"), [(0x00, "no magnet"), (0x30, "too weak"), (0x28, "too strong")])
    def test_magnet_bits(self, status: int, words: str) -> None:
        reading = self.driver(self.chip(2000, status)).read()
        assert reading.state is SensorState.OUT_OF_RANGE
        assert words in reading.detail
        with pytest.raises(SelfTestError, match=words):
            set_up(self.driver(self.chip(2000, status)))

    def test_set_up_and_what_is_read_back(self) -> None:
        chip = self.chip(2000)
        driver = self.driver(chip)
        set_up(driver)
        assert chip.written == [(0x07, 0x03), (0x08, 0x00)]  # slow filter 2x, nothing else
        assert driver.intact()
        chip.registers[0x08] = 0x04
        assert not driver.intact()


class TestNau7802:
    def chip(self) -> FakeChip:
        chip = FakeChip({0x1F: 0x0F})

        def after_write(register: int, value: int) -> None:
            if register == 0x00 and value & 0x02:
                chip.registers[0x00] = value | 0x08  # power-up ready
            if register == 0x02:
                chip.registers[0x02] = value & ~0x04  # calibration done at once

        chip.after_write = after_write
        return chip

    def test_set_up_gain_rate_and_calibration(self) -> None:
        chip = self.chip()
        driver = Nau7802(ThrustConfig(), FakeBus({0x2A: chip}))
        waited = set_up(driver)
        assert chip.registers[0x01] == 0b00_101_111  # 3.0 V, gain 128
        assert chip.registers[0x02] == 0b0_011_0000  # 80 samples/s
        assert (0x02, 0b0_011_0100) in chip.written  # offset calibration started
        assert chip.registers[0x15] == 0x30
        assert waited >= 6 * 1e9 / 80
        assert driver.intact()
        chip.registers[0x01] ^= 0x01  # gain
        assert not driver.intact()

    def test_failed_calibration_is_told(self) -> None:
        chip = self.chip()
        ready = chip.after_write

        def after_write(register: int, value: int) -> None:
            ready(register, value)
            if register == 0x02:
                chip.registers[0x02] |= 0x08

        chip.after_write = after_write
        with pytest.raises(SelfTestError, match="calibration failed"):
            set_up(Nau7802(ThrustConfig(), FakeBus({0x2A: chip})))

    @pytest.mark.parametrize(
        ("data", "count", "state"),
        [
            ("000001", 1, SensorState.OK),
            ("FFFFFE", -2, SensorState.OK),
            ("7FFFFF", 8388607, SensorState.OUT_OF_RANGE),
            ("800000", -8388608, SensorState.OUT_OF_RANGE),
        ],
    )
    def test_counts(self, data: str, count: int, state: SensorState) -> None:
        chip = FakeChip({0x00: 0x20})
        chip.put(0x12, bytes.fromhex(data))
        reading = Nau7802(ThrustConfig(), FakeBus({0x2A: chip})).read()
        assert (reading.values["thrust_load"], reading.state) == (count, state)

    def test_cycle_ready_clear_is_stale(self) -> None:
        assert Nau7802(ThrustConfig(), FakeBus({0x2A: FakeChip()})).read().state is SensorState.STALE


class TestCapture:
    def snapshot(self, **changes: int) -> bytes:
        f = {"sequence": 100, "valid": 0b111111, "latched": 0, "edges": 0, "edge_age": 0xFFFF, "status": 0} | changes
        widths = [15000 + 100 * i for i in range(6)]
        body = struct.pack(
            "<H6HB6BBBBHB",
            f["sequence"], *widths, f["valid"], *[5] * 6, 0, f["latched"], f["edges"], f["edge_age"], f["status"],
        )  # fmt: skip
        return body + bytes([crc8(body)])

    def driver(self, now: list[int] | None = None) -> tuple[Capture, FakeChip]:
        chip = FakeChip({0x00: 0x5C, 0x01: 1, 0x02: 4, 0x03: 2})
        chip.put(0x10, self.snapshot())
        clock = now or [0]
        return Capture(CaptureConfig(), FakeBus({0x40: chip}), lambda: clock[0]), chip

    def test_checksum_is_the_smbus_one(self) -> None:
        assert crc8(b"123456789") == 0xF4

    def test_set_up_follows_the_register_map(self) -> None:
        driver, chip = self.driver()
        set_up(driver)
        assert chip.written == [(0x05, 50), (0x06, 10), (0x04, 1)]
        assert driver.metadata()["firmware"] == "2.4"
        chip.registers[0x01] = 2
        with pytest.raises(SelfTestError, match="register map 2, this driver 1"):
            set_up(driver)

    def test_settings_are_read_back(self) -> None:
        driver, chip = self.driver()
        set_up(driver)
        assert driver.intact()
        chip.registers[0x06] ^= 0x10
        assert not driver.intact()

    def test_widths_and_bits(self) -> None:
        driver, chip = self.driver()
        chip.put(0x10, self.snapshot(latched=0b10010))
        values = driver.read().values
        assert [values[f"pwm_{i}"] for i in range(1, 7)] == [15000, 15100, 15200, 15300, 15400, 15500]
        assert [values[f"digital_{i}"] for i in range(1, 6)] == [0, 1, 0, 0, 1]

    def test_channel_without_pulses_is_unset(self) -> None:
        driver, chip = self.driver()
        chip.put(0x10, self.snapshot(valid=0b111101))
        reading = driver.read()
        assert "pwm_2" not in reading.values
        assert (reading.state, reading.detail) == (SensorState.OUT_OF_RANGE, "no valid pulses on pwm_2")
        chip.put(0x10, self.snapshot(valid=0b001111))  # channels 5 and 6 are not wired: four pwm_inputs
        assert driver.read().state is SensorState.OK

    def test_damaged_snapshot_is_a_failed_transfer(self) -> None:
        driver, chip = self.driver()
        chip.registers[0x15] ^= 0x10
        with pytest.raises(ChecksumError):
            driver.read()

    def test_edges_are_counted_across_the_wrap_and_dated(self) -> None:
        now = [1_000_000_000]
        driver, chip = self.driver(now)
        chip.put(0x10, self.snapshot(edges=255))
        assert driver.read().events == ()  # the first reading only learns the count
        chip.put(0x10, self.snapshot(sequence=150, edges=1, edge_age=30))
        assert driver.read().events == (970_000_000, 970_000_000)

    def test_dead_loop_is_stale_and_restart_a_fault(self) -> None:
        now = [0]
        driver, chip = self.driver(now)
        assert driver.read().state is SensorState.OK
        now[0] += 50_000_000
        assert driver.read().state is SensorState.STALE
        chip.put(0x10, self.snapshot(sequence=7, status=1))
        assert driver.read().state is SensorState.FAULT
