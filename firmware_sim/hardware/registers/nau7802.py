"""NAU7802 24-bit bridge converter at register level (Nuvoton NAU7802 rev. 1.7).

Input: bridge output relative to its excitation [V/V]. Full scale is +-0.5 of the reference divided by the gain; the
reference is the excitation itself, so the supply cancels. The first four conversions after a start are still settling.
"""

from firmware_sim.hardware.registers.chip import Inputs, RegisterChip, to_counts

PU_CTRL, CTRL1, CTRL2, GCAL1, DATA, OTP, REVISION = 0x00, 0x01, 0x02, 0x06, 0x12, 0x15, 0x1F
RATE_SPS = (10.0, 20.0, 40.0, 80.0, 80.0, 80.0, 80.0, 320.0)
SETTLING = 4  # conversions
POWER_UP_NS = 200_000
CALIBRATION_CONVERSIONS = 8
# bits of PU_CTRL: register reset, power up digital, analogue, power-up ready, cycle start, cycle ready
_RR, _PUD, _PUA, _PUR, _CS, _CR = 0x01, 0x02, 0x04, 0x08, 0x10, 0x20
_CALS = 0x04  # of CTRL2: calibrate


class Nau7802Chip(RegisterChip):
    """A NAU7802 on channel 1."""

    def __init__(self, inputs: Inputs) -> None:
        super().__init__()
        self._inputs = inputs
        self.reset(0)

    def reset(self, now_ns: int) -> None:
        self._registers = {OTP: 0x30, REVISION: 0x0F, GCAL1 + 1: 0x80}
        self._control = 0
        self._digital_ns = now_ns
        self._started_ns = now_ns
        self._calibrated_ns = now_ns
        self._tick = 0
        self._ready = False
        self._data = bytes(3)

    def write_register(self, register: int, value: int, now_ns: int) -> None:
        if register == PU_CTRL:
            self._control_power(value, now_ns)
            return
        if register == CTRL2 and value & _CALS:
            self._calibrated_ns = now_ns + round(CALIBRATION_CONVERSIONS * self._period_ns())
        self._registers[register] = value
        if register in (CTRL1, CTRL2):
            self._restart(now_ns)

    def read_register(self, register: int, now_ns: int) -> int:
        if register == PU_CTRL:
            ready = self._control & _PUD and now_ns - self._digital_ns >= POWER_UP_NS
            return self._control | (_PUR if ready else 0) | (_CR if self._ready else 0)
        if register == CTRL2:
            value = self._registers.get(CTRL2, 0) & ~_CALS
            return value | (_CALS if now_ns < self._calibrated_ns else 0)
        if DATA <= register < DATA + 3:
            self._ready = False
            return self._data[register - DATA]
        return self._registers.get(register, 0)

    def latch(self, now_ns: int) -> None:
        if not self._converting():
            return
        tick = int((now_ns - self._started_ns) // self._period_ns())
        if tick <= self._tick:
            return
        self._tick = tick
        self._ready = True
        period = self._period_ns()
        middle = self._started_ns + round((tick - 0.5) * period)
        (bridge,) = self._inputs(middle)
        gain = 1 << (self._registers.get(CTRL1, 0) & 7)
        settling = min(1.0, tick / SETTLING)
        counts = to_counts(bridge * settling * gain / 0.5 * 2**23, -(2**23), 2**23 - 1)
        self._data = counts.to_bytes(3, "big", signed=True)

    def _control_power(self, value: int, now_ns: int) -> None:
        if value & _RR:
            self.reset(now_ns)
            self._control = _RR
            return
        if value & _PUD and not self._control & _PUD:
            self._digital_ns = now_ns
        started = value & _CS and not self._control & _CS
        powered = value & _PUA and not self._control & _PUA
        self._control = value & ~(_PUR | _CR)
        if started or powered:
            self._restart(now_ns)

    def _converting(self) -> bool:
        running = _PUD | _PUA | _CS
        return self._control & running == running and not self._control & _RR

    def _restart(self, now_ns: int) -> None:
        self._started_ns, self._tick, self._ready = now_ns, 0, False

    def _period_ns(self) -> float:
        return 1e9 / RATE_SPS[self._registers.get(CTRL2, 0) >> 4 & 7]
