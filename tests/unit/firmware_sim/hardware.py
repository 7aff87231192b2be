"""Small things the hardware tests share: a clock that only counts, and chips on a bus with steady inputs."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np

from firmware_sim.hardware.bus import BusModel, SimulatedBus
from firmware_sim.hardware.registers.chip import PoweredChip


class CountingClock:
    """Simulated time that the bus moves on."""

    def __init__(self, now_ns: int = 0) -> None:
        self.now_ns = now_ns

    def monotonic_ns(self) -> int:
        return self.now_ns

    def advance(self, duration_ns: int) -> None:
        self.now_ns += duration_ns

    def sleep_until(self, monotonic_ns: int) -> None:
        self.now_ns = max(self.now_ns, monotonic_ns)

    def wait_ms(self, duration: float) -> None:
        self.now_ns += round(duration * 1e6)


def on_bus(address: int, chip: PoweredChip, clock: CountingClock | None = None, **model: float) -> SimulatedBus:
    """A bus with one chip."""
    return SimulatedBus(clock or CountingClock(), {address: chip}, BusModel(**model))


def steady(*values: float) -> Callable[[int], np.ndarray]:
    """Inputs that never change."""
    return lambda time_ns: np.array(values)


def quiet_rng() -> np.random.Generator:
    """For chips without noise."""
    return np.random.default_rng(0)


def truth_at_rest(**changes: object) -> SimpleNamespace:
    """A truth of an aircraft standing level in still air of 15 degC, with some things changed."""
    sensed = SimpleNamespace(
        ax=0.0, ay=0.0, az=-9.80665, p=0.0, q=0.0, r=0.0, phi=0.0, theta=0.0, psi=0.0,
        alpha=0.0, beta=0.0, V=0.0, arm_left=0.0, arm_right=0.0, arm_r=0.0,
    )  # fmt: skip
    truth = SimpleNamespace(
        rates=(0.0, 0.0, 0.0), rate_derivatives=(0.0, 0.0, 0.0), magnetic=(2e-5, 0.0, 4e-5), temperature=288.15,
        supply_voltage=12.0, p_static=101325.0, p_dynamic=0.0, thrust=0.0, latitude=26.0, longitude=80.0,
        altitude=0.0, velocity_ned=(0.0, 0.0, 0.0), pulses_us=(1500.0,) * 6, digital=(0.0,) * 5, sensed=sensed,
    )  # fmt: skip
    for name, value in changes.items():
        setattr(sensed if hasattr(sensed, name) else truth, name, value)
    return truth


class Still:
    """A truth source that shows the same truth for ever."""

    def __init__(self, truth: SimpleNamespace | None = None) -> None:
        self.truth = truth or truth_at_rest()

    def advance(self, to_time: float) -> SimpleNamespace:
        return self.truth
