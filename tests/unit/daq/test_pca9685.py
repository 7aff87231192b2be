"""What the servo driver writes, byte by byte, against the PCA9685 data sheet (NXP, rev. 4); and on the simulated chip."""

from collections.abc import Sequence

import pytest

from daq.actuation.config import ChipConfig
from daq.actuation.pwm.pca9685 import OSCILLATOR_START, RETRY_NS, ChipState, Pca9685, prescale
from daq.clock import SimulatedClock
from daq.sensors.base import SelfTestError
from firmware_sim.hardware.bus import SimulatedBus
from firmware_sim.hardware.registers.pca9685 import Pca9685Chip as Chip


class Wire:
    """Keeps every write; reads give what a chip that took them would."""

    def __init__(self) -> None:
        self.written: list[tuple[int, ...]] = []
        self.answers = {0x00: 0x20, 0x01: 0x04, 0xFE: 121}

    def write_byte_data(self, address: int, register: int, value: int) -> None:
        self.written.append((address, register, value))

    def write_i2c_block_data(self, address: int, register: int, data: Sequence[int]) -> None:
        self.written.append((address, register, *data))

    def read_byte_data(self, address: int, register: int) -> int:
        return self.answers[register]

    def read_i2c_block_data(self, address: int, register: int, length: int) -> list[int]:
        return [self.answers[register + i] for i in range(length)]


def test_set_up_as_the_data_sheet_has_it() -> None:
    wire = Wire()
    waits = list(Pca9685(ChipConfig(), wire, 0, 4).initialise())  # type: ignore[arg-type]
    assert wire.written == [
        (0x41, 0x00, 0x30),  # MODE1: auto-increment, SLEEP; ALLCALL off
        (0x41, 0x01, 0x04),  # MODE2: totem pole, change at STOP, outputs low while OE is high
        (0x41, 0xFE, 121),  # PRE_SCALE, in SLEEP: round(25 MHz / (4096 * 50 Hz)) - 1
        (0x41, 0xFA, 0, 0, 0, 0x10),  # ALL_LED: full off
        (0x41, 0x00, 0x20),  # wake
    ]
    assert waits == [500_000]


def test_restart_is_written_only_when_the_chip_asks_for_it() -> None:
    wire = Wire()
    wire.answers[0x00] = 0xA0
    with pytest.raises(SelfTestError, match="MODE1"):
        list(Pca9685(ChipConfig(), wire, 0, 4).initialise())  # type: ignore[arg-type]
    assert wire.written[-1] == (0x41, 0x00, 0xA0)


@pytest.mark.parametrize(
    ("oscillator", "frequency", "value"),
    [(25e6, 50.0, 121), (25e6, 200.0, 30), (25e6, 60.0, 101), (27e6, 50.0, 131), (23e6, 50.0, 111)],
)
def test_prescale(oscillator: float, frequency: float, value: int) -> None:
    """200 Hz and 25 MHz give 1Eh, the example of section 7.3.5."""
    assert prescale(oscillator, frequency) == value


def test_pulses_are_counts_of_the_cycle_and_go_out_in_one_transfer() -> None:
    wire = Wire()
    driver = Pca9685(ChipConfig(), wire, 2, 3)  # type: ignore[arg-type]
    driver.write([1500.0, None, 1000.0])
    # 25 MHz / 122 / 4096 = 50.03 Hz: a step is 4.88 us
    assert wire.written == [(0x41, 0x06 + 8, 0, 0, 307 & 255, 307 >> 8, 0, 0, 0, 0x10, 0, 0, 205, 0)]
    assert driver.step_us == pytest.approx(4.88)
    with pytest.raises(ValueError, match="2 widths"):
        driver.write([1500.0, 1500.0])


@pytest.mark.parametrize(("width", "steps"), [(0.0, 1), (1e6, 4095), (1500.0, 307)])
def test_no_width_makes_the_outputs_stand_still_or_wrap(width: float, steps: int) -> None:
    registers = Pca9685(ChipConfig(), Wire(), 0, 1).registers(width)  # type: ignore[arg-type]
    assert registers == [0, 0, steps & 255, steps >> 8]


def set_up(chip: Chip) -> tuple[Pca9685, SimulatedClock]:
    clock = SimulatedClock()
    driver = Pca9685(ChipConfig(), SimulatedBus(clock, {0x41: chip}), 0, 4)
    for wait in driver.initialise():
        clock.advance(wait)
    return driver, clock


def test_on_the_simulated_chip() -> None:
    chip = Chip(0.01)
    driver, clock = set_up(chip)
    assert not chip.answers_all_call
    driver.write([1000.0, 1500.0, 2000.0, None])
    clock.advance(40_000_000)
    widths = [chip.width_us(i, clock.monotonic_ns()) for i in range(4)]
    assert widths == pytest.approx([w / 1.01 for w in (1000.4, 1498.2, 2000.9, 0.0)], abs=0.1)
    assert driver.awake()


def test_a_dip_of_its_supply_shows() -> None:
    chip = Chip()
    driver, clock = set_up(chip)
    chip.set_power(False, clock.monotonic_ns())
    with pytest.raises(OSError, match="Remote I/O"):
        driver.awake()
    chip.set_power(True, clock.monotonic_ns())
    assert not driver.awake()
    # without auto-increment the block read gives MODE1 twice
    with pytest.raises(SelfTestError, match=r"11 11 1e instead of 20 04 79"):
        driver.verify()


def test_a_part_is_set_up_again_after_a_pause_and_says_why_not() -> None:
    chip = Chip()
    clock = SimulatedClock()
    part = ChipState(Pca9685(ChipConfig(), SimulatedBus(clock, {0x41: chip}), 0, 4).initialise)
    chip.set_power(False, 0)
    assert not part.attend(clock.monotonic_ns())
    assert part.fault == "Remote I/O error"
    chip.set_power(True, 0)
    assert not part.attend(clock.monotonic_ns() + RETRY_NS // 2)
    clock.advance(RETRY_NS)
    assert not part.attend(clock.monotonic_ns())
    clock.advance(OSCILLATOR_START)
    assert part.attend(clock.monotonic_ns())
    assert part.fault == ""
