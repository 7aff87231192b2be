"""The simulated pilot, receiver and ArduPlane of a flight in which the sequencer moves the servos through the autopilot.

Channels of the receiver: roll, pitch, throttle and yaw on 1 to 4, the switch on 5; 500 us are 25 deg. The ArduPlane mixes elevons
and drives the servos.
"""

import numpy as np
from numpy.typing import NDArray

from firmware_sim.hardware.autopilots.arduplane import ArduPlane
from firmware_sim.hardware.cockpit import SWITCH_US, CockpitTable, Transmitter
from firmware_sim.physics.plant import Commands
from firmware_sim.world.truth import PULSE_CENTRE_US, PULSE_PER_RAD_US, THROTTLE_PULSE_US

THROTTLE_STEP = 0.1  # by which the pilot moves the throttle at `throttle_s` of the scenario
STILL_FROM_GO_NS = 2_500_000_000  # after the switch went to go, in which overrides begin if they begin at all
STILL_AFTER_NS = 500_000_000  # after the last override: the pilot sees from the aircraft that they have ended


class AutopilotCockpit(Transmitter):
    """origin_ns: time at which the autopilot was switched on, before the first frame of the world."""

    def __init__(self, table: CockpitTable, takeoff_s: float, origin_ns: int) -> None:
        super().__init__(table, takeoff_s)
        self.plane = ArduPlane(self.receiver, table.parameters, origin_ns)
        self._modes = sorted(table.modes)
        self._go_ns: int | None = None  # since when the switch is at go
        self._overridden_ns = origin_ns - STILL_AFTER_NS
        if table.line_lost_s is not None:
            lost_ns = round(table.line_lost_s * 1e9)
            for line in (self.plane.inward, self.plane.outward):
                line.lost = lambda time_ns: time_ns >= lost_ns

    def receiver(self, time_ns: int) -> tuple[int, ...] | None:
        """The pilot's eight channels at a time [us], None while the receiver is silent."""
        commands = self.sticks(time_ns)
        if commands is None:
            return None
        aileron, elevator = (commands.right - commands.left) / 2.0, (commands.right + commands.left) / 2.0
        roll, pitch, yaw = (round(PULSE_CENTRE_US + PULSE_PER_RAD_US * a) for a in (aileron, elevator, commands.rudder))
        idle, span = THROTTLE_PULSE_US
        throttle_s = self.table.throttle_s
        throttle = commands.throttle + (
            THROTTLE_STEP if throttle_s is not None and time_ns >= throttle_s * 1e9 else 0.0
        )
        return (roll, pitch, round(idle + span * throttle), yaw, round(self.switch_us(time_ns)), 1500, 1500, 1500)

    def behind(self, time_ns: int, pulses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Servo pulses out of the autopilot [s]."""
        pulses = pulses.copy()
        pulses[:4] = np.array(self.plane.outputs_us(time_ns)) * 1e-6
        return pulses

    # ---------------------------------------------------------------------------------------- for the world

    def hands_still(self, airborne_s: float) -> bool:
        """Whether the pilot keeps his sticks still: while overrides hold, or may still begin."""
        time_ns = self.time_ns(airborne_s)
        if self.switch_us(time_ns) != SWITCH_US["go"]:
            self._go_ns = None
            return False
        self._go_ns = time_ns if self._go_ns is None else self._go_ns
        if self.plane.rc.any_holds(time_ns):
            self._overridden_ns = time_ns
        waits = time_ns - self._go_ns < STILL_FROM_GO_NS or time_ns - self._overridden_ns < STILL_AFTER_NS
        return waits and not self.takes_over(time_ns)

    def route(self, airborne_s: float, wanted: Commands) -> Commands:
        """Commands of the servos as the autopilot drives them."""
        time_ns = self.time_ns(airborne_s)
        self.note(time_ns, wanted)
        while self._modes and time_ns >= self._modes[0][0] * 1e9:
            self.plane.set_mode(self._modes.pop(0)[1], time_ns)
        *surfaces, throttle = self.plane.outputs_us(time_ns)
        if not any(self.plane.rc.widths):
            return wanted  # nothing has come from the receiver yet
        idle, span = THROTTLE_PULSE_US
        left, right, rudder = ((width - PULSE_CENTRE_US) / PULSE_PER_RAD_US for width in surfaces)
        return Commands(left, right, rudder, (throttle - idle) / span)
