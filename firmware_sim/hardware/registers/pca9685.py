"""PCA9685 sixteen-channel PWM driver at register level (NXP data sheet rev. 4).

Modelled: MODE1 with SLEEP, RESTART, auto-increment and ALLCALL; MODE2 with OCH; PRE_SCALE that changes in SLEEP only; LEDn and
ALL_LED registers with full on and full off; software reset by general call; 500 us from wake to the first cycle; new
values from the end of the cycle under way; an internal oscillator of its own frequency; the OE pin. Not modelled: the
external clock, sub-addresses, INVRT, and where the auto-increment wraps.
"""

from bisect import bisect_right
from collections.abc import Callable

from firmware_sim.hardware.registers.chip import PoweredChip, RegisterChip

MODE1, MODE2, SUBADR1, ALLCALLADR, LED0, LED15_END, ALL_LED, PRE_SCALE = 0x00, 0x01, 0x02, 0x05, 0x06, 0x45, 0xFA, 0xFE
RESTART, AUTO_INCREMENT, SLEEP, ALLCALL = 0x80, 0x20, 0x10, 0x01
OCH = 0x08
FULL = 0x10  # bit 4 of ON_H (full on) and OFF_H (full off)
STEPS = 4096
WAKE_NS = 500_000
NOMINAL_HZ = 25e6
CHANNELS = 16
ALLCALL_ADDRESS = 0x70
_SOFTWARE_RESET = b"\x06"
_KEPT = 64  # sets of values kept, so that what the outputs did some cycles ago can still be asked

Enable = Callable[[int], bool]


class Pca9685Chip(RegisterChip):
    """oscillator_error: relative, within +-0.08 by the data sheet (23 to 27 MHz). enabled: whether OE is low at a time [ns]."""

    def __init__(self, oscillator_error: float = 0.0, enabled: Enable = lambda time_ns: True) -> None:
        super().__init__()
        self._oscillator_hz = NOMINAL_HZ * (1.0 + oscillator_error)
        self._enabled = enabled
        self.reset(0)

    def reset(self, now_ns: int) -> None:
        self._mode1, self._mode2, self._prescale = 0x11, 0x04, 0x1E
        self._addresses = [0xE2, 0xE4, 0xE8, 0xE0]
        self._led = bytearray(4 * CHANNELS)
        self._led[3::4] = bytes([FULL]) * CHANNELS
        self._restart = False  # the RESTART bit: pulses were running when it went to sleep
        self._running = False  # pulses run, as far as SLEEP and RESTART go
        self._first_ns = now_ns  # start of cycle 0 of the present run
        self._since: list[int] = [now_ns]  # when each set of values began to act
        self._values: list[bytes | None] = [None]  # None: no cycles run

    # ---------------------------------------------------------------------------------------- the bus

    def write(self, data: bytes, now_ns: int) -> None:
        old_values = bytes(self._led)
        if data:
            self._pointer = data[0]
        for value in data[1:]:
            self.write_register(self._pointer, value, now_ns)
            self._pointer = self.next_register(self._pointer)
        touches_pwm = any(LED0 <= data[0] + i <= LED15_END for i in range(len(data) - 1)) if data else False
        if touches_pwm and self._restart and not self._mode1 & SLEEP and not self._mode2 & OCH:
            self._restart, self._running = False, True  # section 7.3.1.1: writing a PWM register clears RESTART too
        if self._running and (bytes(self._led) != old_values or self._values[-1] is None):
            self._act(max(self._cycle_end(now_ns), self._first_ns))

    def next_register(self, register: int) -> int:
        """The register after this one; the same one while auto-increment is off."""
        return (register + 1) & 0xFF if self._mode1 & AUTO_INCREMENT else register

    def read_register(self, register: int, now_ns: int) -> int:
        if register == MODE1:
            return self._mode1 | (RESTART if self._restart else 0)
        if register == MODE2:
            return self._mode2
        if SUBADR1 <= register <= ALLCALLADR:
            return self._addresses[register - SUBADR1]
        if LED0 <= register <= LED15_END:
            return self._led[register - LED0]
        return self._prescale if register == PRE_SCALE else 0

    def write_register(self, register: int, value: int, now_ns: int) -> None:
        if register == MODE1:
            self._write_mode1(value, now_ns)
        elif register == MODE2:
            self._mode2 = value & 0x1F
        elif SUBADR1 <= register <= ALLCALLADR:
            self._addresses[register - SUBADR1] = value & 0xFE
        elif LED0 <= register <= LED15_END:
            self._led[register - LED0] = value & (0x1F if (register - LED0) % 2 else 0xFF)
        elif ALL_LED <= register < ALL_LED + 4:
            self._led[register - ALL_LED :: 4] = bytes([value & (0x1F if register % 2 else 0xFF)]) * CHANNELS
        elif register == PRE_SCALE and self._mode1 & SLEEP:
            self._prescale = max(value, 3)

    def general_call(self, data: bytes, now_ns: int) -> None:
        if data == _SOFTWARE_RESET:
            self.reset(now_ns)

    @property
    def answers_all_call(self) -> bool:
        """Whether it answers at the address of all such chips."""
        return self.powered and bool(self._mode1 & ALLCALL)

    def set_power(self, on: bool, now_ns: int) -> None:
        super().set_power(on, now_ns)
        if not on:
            self._stop(now_ns)

    def _write_mode1(self, value: int, now_ns: int) -> None:
        slept, sleeps = bool(self._mode1 & SLEEP), bool(value & SLEEP)
        self._mode1 = value & 0x7F
        if sleeps and not slept:
            self._restart = self._running
            self._stop(now_ns)
        if slept and not sleeps:
            self._first_ns = now_ns + WAKE_NS
            self._running = not self._restart
            if self._running:
                self._act(self._first_ns)
        if value & RESTART and self._restart and not sleeps:
            self._restart, self._running = False, True
            self._act(max(now_ns, self._first_ns))

    # ---------------------------------------------------------------------------------------- the outputs

    @property
    def period_ns(self) -> float:
        """Of a cycle."""
        return (self._prescale + 1) * STEPS / self._oscillator_hz * 1e9

    def _cycle_end(self, now_ns: int) -> int:
        cycles = max(0.0, now_ns - self._first_ns) // self.period_ns + 1
        return self._first_ns + round(cycles * self.period_ns) if now_ns >= self._first_ns else self._first_ns

    def _act(self, from_ns: int) -> None:
        self._note(from_ns, bytes(self._led))

    def _stop(self, now_ns: int) -> None:
        self._running = False
        self._note(now_ns, None)

    def _note(self, from_ns: int, values: bytes | None) -> None:
        while self._since and self._since[-1] >= from_ns:
            self._since.pop()
            self._values.pop()
        self._since.append(from_ns)
        self._values.append(values)
        del self._since[:-_KEPT], self._values[:-_KEPT]

    def width_us(self, channel: int, time_ns: int) -> float:
        """Width of the pulse of the cycle at a time [us]; 0 where there is none, also while OE is high."""
        values = self._values[max(bisect_right(self._since, time_ns) - 1, 0)]
        if values is None or not self.powered or not self._enabled(time_ns):
            return 0.0
        on, off = (int.from_bytes(values[4 * channel + i : 4 * channel + i + 2], "little") for i in (0, 2))
        if off & 0x1000:
            return 0.0
        steps = STEPS if on & 0x1000 else (off - on) % STEPS
        return steps * (self._prescale + 1) / self._oscillator_hz * 1e6


class AllCall(PoweredChip):
    """What answers at the address of all PCA9685s: every one whose ALLCALL bit is still set."""

    def __init__(self, chip: Pca9685Chip) -> None:
        super().__init__()
        self._chip = chip

    def answers(self, now_ns: int) -> bool:
        return self._chip.answers_all_call

    def write(self, data: bytes, now_ns: int) -> None:
        """Passed on."""
        self._chip.write(data, now_ns)

    def read(self, count: int, now_ns: int) -> bytes:
        """Passed on."""
        return self._chip.read(count, now_ns)

    def reset(self, now_ns: int) -> None:
        """It has no registers of its own."""
