"""Servo pulses at GPIO lines: the driver at an injected source of edges, and at the kernel's own gpio-sim where it is."""

import errno
import importlib.util
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from daq.contract.scan import SensorState
from daq.sensors.base import DriverConfigError, SelfTestError
from daq.sensors.capture import CaptureConfig
from daq.sensors.gpio_pwm import GpioPwm, KernelEdges, LineEdge

MS = 1_000_000
WIDTHS = {17: 1_100_000, 27: 1_500_000, 5: 1_923_400}
CONFIG = CaptureConfig(driver="gpio", lines=tuple(WIDTHS))


class Servos:
    """Frames of 20 ms on each line, a little apart; edges carry times to 100 ns."""

    def __init__(self) -> None:
        self.now_ns = 10**9
        self.silent: set[int] = set()
        self.gone = False
        self.skip: set[int] = set()  # numbers of events that the queue lost
        self._next = {line: self.now_ns + 1_000_000 * i for i, line in enumerate(WIDTHS)}
        self._numbers = dict.fromkeys(WIDTHS, 0)

    def edges(self) -> Sequence[LineEdge]:
        if self.gone:
            raise OSError(errno.ENODEV, "No such device")
        out = []
        for line, width in WIDTHS.items():
            while self._next[line] + width <= self.now_ns:
                begun, self._next[line] = self._next[line], self._next[line] + 20 * MS
                if line in self.silent:
                    continue
                for rising, at in ((True, begun), (False, begun + width)):
                    self._numbers[line] += 1
                    if self._numbers[line] not in self.skip:
                        out.append(LineEdge(line, rising, at, self._numbers[line]))
        return sorted(out, key=lambda edge: edge.time_ns)


@pytest.fixture
def servos() -> Servos:
    return Servos()


@pytest.fixture
def driver(servos: Servos) -> GpioPwm:
    made = GpioPwm(CONFIG, lambda: servos.now_ns, lambda chip, lines: servos)
    set_up(made, servos)
    return made


def set_up(driver: GpioPwm, servos: Servos) -> None:
    for wait in driver.initialise():
        servos.now_ns += wait


def test_widths_at_the_instants_of_their_edges(driver: GpioPwm, servos: Servos) -> None:
    servos.now_ns += 50 * MS
    reading = driver.read()
    assert reading.state is SensorState.OK
    assert [reading.values[f"pwm_{i}"] for i in (1, 2, 3)] == [11000, 15000, 19234]
    assert reading.time_ns is not None
    assert 0 <= servos.now_ns - reading.time_ns < 22 * MS


def test_a_line_that_falls_silent_and_all_of_them(driver: GpioPwm, servos: Servos) -> None:
    servos.silent = {27}
    servos.now_ns += 100 * MS
    reading = driver.read()
    assert (reading.state, reading.detail) == (SensorState.OUT_OF_RANGE, "no valid pulses on pwm_2")
    assert set(reading.values) == {"pwm_1", "pwm_3"}
    servos.silent = set(WIDTHS)
    servos.now_ns += 100 * MS
    assert driver.read().state is SensorState.STALE
    with pytest.raises(SelfTestError, match="no servo pulse on lines 17, 27, 5 of /dev/gpiochip0"):
        set_up(driver, servos)


def test_lost_events_make_no_pulse_of_another_width(driver: GpioPwm, servos: Servos) -> None:
    rng = np.random.default_rng(3)
    seen: dict[str, set[object]] = {f"pwm_{i}": set() for i in (1, 2, 3)}
    for _ in range(200):
        servos.skip = {int(n) for n in rng.integers(1, 2000, 400)}
        servos.now_ns += 50 * MS
        for name, value in driver.read().values.items():
            seen[name].add(value)
    assert seen == {"pwm_1": {11000}, "pwm_2": {15000}, "pwm_3": {19234}}


def test_unplugged_lines_come_back(driver: GpioPwm, servos: Servos) -> None:
    servos.gone = True
    with pytest.raises(OSError, match="No such device"):
        driver.read()
    servos.gone = False
    set_up(driver, servos)
    servos.now_ns += 50 * MS
    assert driver.read().state is SensorState.OK


def test_lines_have_to_be_said() -> None:
    for section in ({"driver": "gpio"}, {"driver": "capture", "lines": (4,)}, {"driver": "gpio", "lines": (4, 4)}):
        with pytest.raises(ValidationError, match="numbers of the GPIO lines of pwm_1"):
            CaptureConfig.model_validate(section)


@pytest.mark.skipif(importlib.util.find_spec("gpiod") is not None, reason="gpiod is installed")
def test_without_the_package_it_says_what_to_install() -> None:
    with pytest.raises(DriverConfigError, match="pip install 'gpiod>=2'"):
        KernelEdges("/dev/gpiochip0", (4,))


GPIO_SIM = Path("/sys/kernel/config/gpio-sim")


@pytest.mark.skipif(not GPIO_SIM.is_dir(), reason="the kernel has no gpio-sim (configfs) here")
@pytest.mark.skipif(importlib.util.find_spec("gpiod") is None, reason="the package gpiod is not installed")
def test_edges_of_the_kernel() -> None:
    bank = GPIO_SIM / "sideslip" / "bank0"
    bank.mkdir(parents=True)
    try:
        (bank / "num_lines").write_text("4")
        (GPIO_SIM / "sideslip" / "live").write_text("1")
        chip, device = ((folder / "chip_name").read_text().strip() for folder in (bank, bank))
        source = KernelEdges(f"/dev/{chip}", (2,))
        pull = next(Path("/sys/devices/platform").glob(f"gpio-sim.*/{device}/sim_gpio2/pull"))
        pull.write_text("pull-up")
        pull.write_text("pull-down")
        assert [(e.line, e.rising) for e in source.edges()] == [(2, True), (2, False)]
    finally:
        (GPIO_SIM / "sideslip" / "live").write_text("0")
        bank.rmdir()
        bank.parent.rmdir()
