"""A sequencer that runs in real time with its heartbeat on a file: `sequencing.py LINE`. Killed by test_sequencer_kill."""

import sys
import time
from pathlib import Path

from daq.actuation.config import HeartbeatConfig
from daq.actuation.pwm.heartbeat import FileHeartbeat, HeartbeatLine
from firmware_sim.hardware.cockpit import Monostable
from tests.unit.daq.sequencer_rig import PERIOD_NS, USUAL, Rig, short_manoeuvre, switch_plan


class Both:
    """The simulated monostable, and the line to the parent process."""

    def __init__(self, monostable: Monostable, line: HeartbeatLine) -> None:
        self._all = (monostable, line)

    def beat(self) -> None:
        for one in self._all:
            one.beat()

    def release(self) -> None:
        for one in self._all:
            one.release()


def main(line: Path) -> None:
    heartbeat = FileHeartbeat(HeartbeatConfig(line=line, clear=None))
    rig = Rig(switch_plan(*USUAL), manoeuvre=short_manoeuvre(20.0), also=lambda mono: Both(mono, heartbeat))
    start = time.monotonic_ns()
    while True:
        rig.frame()
        print(rig.state.name, flush=True)
        wait = start + rig.number * PERIOD_NS - time.monotonic_ns()
        if wait > 0:
            time.sleep(wait * 1e-9)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
