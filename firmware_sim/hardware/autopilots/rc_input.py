"""RC channels of ArduPilot and their overrides by MAVLink, as in libraries/RC_Channel of its source (4.5 to 4.8).

* An override holds for RC_OVERRIDE_TIME seconds after it came, 0 never, negative for ever (RC_Channel::has_override).
* Channels are read only when the receiver has a new frame or an override has come (RC_Channels::read_input): an expired override
  stays in effect until then, and for ever if the receiver is silent.
* A switch with RCn_OPTION 46, read ten times a second and debounced for 200 ms, clears and refuses overrides at low (below
  1200 us), accepts them at high (above 1800 us) and changes nothing in between (debounce_completed, read_aux,
  do_aux_function_rc_override_enable). Its position at the start counts without debouncing (init_aux).
* RC_OPTIONS: bit 0 ignores the receiver, bit 1 overrides (RC_Channel::update); bit 14, in no release before 4.8, clears and
  refuses overrides when roll, pitch or yaw stick is out of its dead zone about trim (has_pilot_input_for_override_clear).
  The position counts, not its change: with a stick held out of trim all overrides are refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass

CHANNELS = 8
MS = 1_000_000
DEBOUNCE_NS = 200 * MS
LOW_US, HIGH_US = 1200, 1800
TRIM_US, DEAD_ZONE_US = 1500, 30
OVERRIDE_ENABLE = 46
IGNORE_RECEIVER, IGNORE_OVERRIDES, CLEAR_BY_STICK = 1 << 0, 1 << 1, 1 << 14
_STICKS = (0, 1, 3)  # roll, pitch, yaw by RCMAP's defaults
_LEAVE, _RELEASE = 65535, 0  # values of RC_CHANNELS_OVERRIDE that leave a channel alone, and release it


@dataclass(slots=True)
class _Override:
    """An override: value [us], _RELEASE for none; came_ns: time of its message."""

    value: int = 0
    came_ns: int = 0


class RcInput:
    """parameters: of the autopilot; a change takes effect at once. widths: pulse width in effect of each channel [us]."""

    def __init__(self, parameters: Mapping[str, float]) -> None:
        self._parameters = parameters
        self._overrides = [_Override() for _ in range(CHANNELS)]
        self._raw = [0] * CHANNELS
        self._had_receiver = False
        self._new_override = False
        self.enabled = True
        self._position: int | None = None  # of the switch, debounced
        self._candidate: int | None = None
        self._edge_ns = 0
        self.widths = [0] * CHANNELS

    def override(self, values: tuple[int, ...], now_ns: int) -> None:
        """Channels 1 to 8 of an RC_CHANNELS_OVERRIDE."""
        for override, value in zip(self._overrides, values, strict=True):
            if value != _LEAVE and self.enabled:
                override.value, override.came_ns = value, now_ns
                self._new_override = True

    def holds(self, channel: int, now_ns: int) -> bool:
        """Whether channel 0 to 7 is overridden."""
        override = self._overrides[channel]
        lasts_s = self._parameters["RC_OVERRIDE_TIME"]
        if override.value == _RELEASE or lasts_s == 0.0:
            return False
        return lasts_s < 0.0 or now_ns - override.came_ns < lasts_s * 1e9

    def any_holds(self, now_ns: int) -> bool:
        """Whether any channel is overridden."""
        return any(self.holds(i, now_ns) for i in range(CHANNELS))

    def read(self, frame: tuple[int, ...] | None, now_ns: int) -> bool:
        """Read all channels, if there is anything new; frame: of the receiver, None without a new one."""
        options = int(self._parameters["RC_OPTIONS"])
        if frame is not None:
            self._raw = list(frame)
        if frame is not None and not options & IGNORE_RECEIVER:
            self._had_receiver = True
        elif not self._new_override:
            return False
        self._new_override = False
        for i in range(CHANNELS):
            if self.holds(i, now_ns) and not options & IGNORE_OVERRIDES:
                self.widths[i] = self._overrides[i].value
            elif self._had_receiver and not options & IGNORE_RECEIVER:
                self.widths[i] = self._raw[i]
        if options & CLEAR_BY_STICK and self.any_holds(now_ns) and self._stick_out_of_trim():
            self._enable(False)
        return True

    def _stick_out_of_trim(self) -> bool:
        return any(abs(self._raw[i] - TRIM_US) > DEAD_ZONE_US for i in _STICKS)

    def read_switch(self, now_ns: int) -> None:
        """Read and debounce the switch; call it ten times a second."""
        channel = next((i for i in range(CHANNELS) if self._option(i) == OVERRIDE_ENABLE), None)
        if channel is None or not self._had_receiver:
            return
        width = self.widths[channel]
        position = 0 if width < LOW_US else 2 if width > HIGH_US else 1
        if self._position is None:
            self._settle(position)
        elif position == self._position:
            self._candidate = position
        elif position != self._candidate:
            self._candidate, self._edge_ns = position, now_ns
        elif now_ns - self._edge_ns >= DEBOUNCE_NS:
            self._settle(position)

    def _option(self, channel: int) -> int:
        return int(self._parameters.get(f"RC{channel + 1}_OPTION", 0.0))

    def _settle(self, position: int) -> None:
        self._position = self._candidate = position
        if position != 1:
            self._enable(position == 2)

    def _enable(self, enabled: bool) -> None:
        self.enabled = enabled
        if not enabled:
            for override in self._overrides:
                override.value = _RELEASE
