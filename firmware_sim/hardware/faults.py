"""Scenario lines `[[faults]]`: what breaks, when, for how long.

Each kind acts where the real fault acts: on the bus, inside a chip's input, on the serial line, on the supply, in the file
system, on the clock or on the radio; nothing above is told. Times are seconds from the start of the recording.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from firmware_sim.hardware.board import ADDRESSES, VALUE_DEVICES
from firmware_sim.hardware.bus import Disturbance
from firmware_sim.hardware.registers.chip import Inputs
from firmware_sim.tables import SimulatorTable, checked

OnWires = Literal["absent", "nack", "stuck_bus", "slow_bus", "stuck_value", "spikes", "torn_gnss", "power_dip"]
Kind = OnWires | Literal["sd_stall", "sd_slow", "disk_full", "card_gone", "clock_step", "radio_lost"]

_ON_BUS = frozenset({"nack", "slow_bus"})
_NEEDS_DEVICE = frozenset({"absent", "nack", "stuck_value", "spikes"})
_TOGETHER: Mapping[str, tuple[str, ...]] = {"imu": ("mag",)}  # one package
FILE_KINDS = frozenset({"sd_stall", "sd_slow", "disk_full", "card_gone"})


class Fault(SimulatorTable):
    """One line of `[[faults]]`.

    absent: `device` is unplugged, and comes back with its settings lost (the magnetometer goes with the imu). nack: it does
    not acknowledge with `probability`. stuck_bus: data line held low. slow_bus: transfers (to `device`, or all) take
    `size` times as long. stuck_value: `device` repeats its value. spikes: with
    `probability` a sample is off by `size` (units of the chip's input: V, Pa, m/s2 and rad/s, T). torn_gnss: a GPS
    message loses bytes with `probability`. power_dip: the 5 V supply drops out. sd_stall: a write that falls in the window
    returns at its end. sd_slow: each write takes `size` seconds. disk_full, card_gone: writes fail with ENOSPC, EIO.
    clock_step: the machine's UTC jumps by `size` seconds. radio_lost: nothing gets through.
    """

    kind: Kind
    device: str | None = None
    start_s: float = Field(default=0.0, ge=0.0)
    stop_s: float = Field(default=math.inf, gt=0.0)
    probability: float = Field(default=1.0, gt=0.0, le=1.0)
    size: float | None = None

    @model_validator(mode="after")
    def _complete(self) -> "Fault":
        if self.stop_s <= self.start_s:
            raise ValueError(f"stop_s = {self.stop_s} must be after start_s = {self.start_s}")
        if self.kind in _NEEDS_DEVICE and self.device is None:
            raise ValueError(f"kind {self.kind!r} needs a device")
        if self.kind in ("slow_bus", "spikes", "clock_step", "sd_slow") and self.size is None:
            raise ValueError(f"kind {self.kind!r} needs a size")
        devices = VALUE_DEVICES if self.kind in ("stuck_value", "spikes") else {*ADDRESSES, "gnss", "autopilot"}
        if self.device is not None and self.device not in devices:
            raise ValueError(f"device {self.device!r} is none of {', '.join(sorted(devices))}")
        return self

    def active(self, time_s: float) -> bool:
        """Whether the fault is on at a time [s]."""
        return self.start_s <= time_s < self.stop_s


def parse_faults(lines: Sequence[Mapping[str, Any]], where: str) -> tuple[Fault, ...]:
    """The fault lines of a scenario; raises ScenarioError naming the line and key."""
    return tuple(checked(Fault, line, where, "faults", str(i + 1)) for i, line in enumerate(lines))


class FaultSet:
    """The faults of one flight, as the parts they act on ask for them.

    origin_ns: monotonic time of second zero. seed: of the faults' random choices.
    """

    def __init__(self, faults: Sequence[Fault], origin_ns: int = 0, seed: int = 0) -> None:
        self.faults = tuple(faults)
        self.addresses = ADDRESSES
        """Where devices sit on the bus."""
        self._origin_ns = origin_ns
        self._rng = np.random.default_rng([seed, 0xFA017])
        self._on_bus = [f for f in faults if f.kind in _ON_BUS or f.kind == "stuck_bus"]

    def seconds(self, now_ns: int) -> float:
        """Seconds from the start of the recording."""
        return (now_ns - self._origin_ns) * 1e-9

    def of_kinds(self, *kinds: str) -> tuple[Fault, ...]:
        """The faults of some kinds."""
        return tuple(f for f in self.faults if f.kind in kinds)

    def disturb(self, address: int, now_ns: int) -> Disturbance | None:
        """What happens to a bus transfer to `address` now."""
        if not self._on_bus:
            return None
        time_s = self.seconds(now_ns)
        stretch = 1.0
        for fault in self._on_bus:
            if not fault.active(time_s):
                continue
            if fault.kind == "stuck_bus":
                return Disturbance(held=True)
            if fault.device is not None and self.addresses.get(fault.device) != address:
                continue
            if fault.kind == "slow_bus":
                stretch *= fault.size or 1.0
            elif fault.probability >= 1.0 or self._rng.random() < fault.probability:
                return Disturbance(refused=True)
        return Disturbance(stretch=stretch) if stretch != 1.0 else None

    def gnss_corrupt(self, message: bytes, now_ns: int) -> bytes:
        """A GPS message as it comes through a bad line: a piece is missing from the middle, or its end."""
        time_s = self.seconds(now_ns)
        for fault in self.of_kinds("torn_gnss"):
            if message and fault.active(time_s) and self._rng.random() < fault.probability:
                start = int(self._rng.integers(0, len(message)))
                gap = int(self._rng.integers(1, max(2, len(message) // 3)))
                message = message[:start] + message[start + gap :]
        return message

    def radio_lost(self, now_ns: int) -> bool:
        """Whether the radio gets nothing through."""
        return any(f.active(self.seconds(now_ns)) for f in self.of_kinds("radio_lost"))

    def bend(self, device: str, inputs: Inputs) -> Inputs:
        """A chip's input with the value faults of `device` in it; `inputs` itself where there are none."""
        device_faults = [f for f in self.of_kinds("stuck_value", "spikes") if f.device == device]
        if not device_faults:
            return inputs
        rng = np.random.default_rng(self._rng.integers(0, 2**63))
        stuck_values: dict[int, NDArray[np.float64]] = {}

        def bent(time_ns: int) -> NDArray[np.float64]:
            values = np.array(inputs(time_ns), float)
            for i, fault in enumerate(device_faults):
                if not fault.active(self.seconds(time_ns)):
                    stuck_values.pop(i, None)
                elif fault.kind == "stuck_value":
                    values = stuck_values.setdefault(i, values)
                elif rng.random() < fault.probability:
                    values = values + (fault.size or 0.0) * rng.choice((-1.0, 1.0), size=values.shape)
            return values

        return bent

    def quiet(self, device: str, now_ns: int) -> bool:
        """Whether a sensor is stuck, so that its sample has no fresh noise either."""
        return any(f.device == device and f.active(self.seconds(now_ns)) for f in self.of_kinds("stuck_value"))


class PowerTaker(Protocol):
    """Anything that hangs on the 5 V supply."""

    def set_power(self, on: bool, now_ns: int) -> None: ...


class FaultEvents:
    """Faults that happen at an instant (plugs, power dips, clock steps), brought about as the clock advances.

    Register `at` with `SimulatedClock.on_advance`. powered: what hangs on the supply, by device. step_utc: called with
    nanoseconds for a clock step.
    """

    def __init__(
        self,
        faults: FaultSet,
        powered: Mapping[str, PowerTaker],
        step_utc: Callable[[int], None],
        origin_ns: int = 0,
    ) -> None:
        pending: list[tuple[int, Callable[[int], None]]] = []
        for fault in faults.of_kinds("power_dip", "absent"):
            names = list(powered) if fault.device is None else [fault.device, *_TOGETHER.get(fault.device, ())]
            for on, time_s in ((False, fault.start_s), (True, fault.stop_s)):
                if math.isfinite(time_s):
                    pending.append((origin_ns + round(time_s * 1e9), _switch([powered[n] for n in names], on)))
        for step in faults.of_kinds("clock_step"):
            pending.append((origin_ns + round(step.start_s * 1e9), _stepper(step_utc, round((step.size or 0.0) * 1e9))))
        self._pending = sorted(pending, key=lambda item: item[0])

    @property
    def any_left(self) -> bool:
        """Whether anything is still to come."""
        return bool(self._pending)

    def at(self, now_ns: int) -> None:
        """Bring about what was due by now."""
        while self._pending and self._pending[0][0] <= now_ns:
            due_ns, happen = self._pending.pop(0)
            happen(due_ns)


def _switch(takers: Sequence[PowerTaker], on: bool) -> Callable[[int], None]:
    def happen(now_ns: int) -> None:
        for taker in takers:
            taker.set_power(on, now_ns)

    return happen


def _stepper(step_utc: Callable[[int], None], by_ns: int) -> Callable[[int], None]:
    return lambda now_ns: step_utc(by_ns)
