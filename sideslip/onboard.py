"""The companion of the logger: `python -m sideslip.onboard`, which the logger starts where `[identification]` is configured.

It reads scans from standard input (`daq.companion.wire`), identifies, and writes a reply every few seconds of flight. Alignment
and estimator are those of the ground station, so the same samples give the same numbers.
"""

import math
import sys
from typing import BinaryIO

from daq.companion.wire import CompanionReply, Setup, read_frame, read_setup
from daq.contract.scan import ScanDecodeError
from daq.identification.movement import ManoeuvreDetector
from daq.utilities.errors import UserError
from groundstation.calibration.apply import Calibrator
from groundstation.calibration.calibration_set import load_calibration
from groundstation.identification.alignment import ScanAlignment
from groundstation.identification.session import LiveIdentification, LiveState
from groundstation.identification.words import point_line, short_line
from groundstation.live.watches import LandingLimits
from sideslip.live_aircraft import live_aircraft

BATCH_S = 2.0
"""[s] of scans calibrated together, twice that of the ground station, for half the work: nobody watches here."""
WANTED = 0.05  # bound to be reached, as a share of a derivative; only texts use it


def answer_of(state: LiveState, point: str = "", alarm: str = "") -> CompanionReply:
    """The reply with the identified derivatives of a state. point, alarm: texts on a new test point or alarm, or empty."""
    derivatives = state.estimates.derivatives
    identified = {n: (derivatives[n].estimate, derivatives[n].std) for n in state.aircraft.shown if derivatives[n].told}
    return CompanionReply(state.time, identified, short_line(state), "", point, alarm)


def answers(source: BinaryIO, sink: BinaryIO) -> None:
    """Write replies to `sink` until `source` ends. Raises UserError where calibration or aircraft cannot be used."""
    first_frame = read_frame(source)
    if first_frame is None:
        return
    setup: Setup = read_setup(first_frame)
    calibrator = Calibrator(load_calibration(setup.calibration), setup.details)
    alignment, landing = ScanAlignment(BATCH_S), LandingLimits()
    aircraft = live_aircraft(setup.aircraft, model=setup.model)
    if setup.until and setup.until not in aircraft.shown:
        words = f"sequencer.until: {setup.model} does not estimate {setup.until}, so no set ends by it"
        _write(sink, CompanionReply(alarm=words))
    stretches = ManoeuvreDetector(landing.flying_speed, landing.flying_s, aircraft.regressions)
    live = LiveIdentification(aircraft, calibrator, WANTED, alignment, stretches, watched=setup.watch)
    next_reply = last_point = -math.inf
    trouble_sent = False
    while (data := read_frame(source)) is not None:
        try:
            alignment.add(data)
        except ScanDecodeError:
            continue
        state = live.step()
        if state is not None:
            point, alarm = "", "; ".join(a.text for a in live.new_alarms())
            if state.point is not None and not state.point.moving and state.point.begin > last_point:
                point, last_point = point_line(state), state.point.begin
            if state.time >= next_reply or point or alarm:
                next_reply = state.time + setup.every_s
                _write(sink, answer_of(state, point, alarm))
        if live.trouble and not trouble_sent:
            trouble_sent = True
            _write(sink, CompanionReply(trouble=live.trouble))
    final = live.finish()
    if final is not None:
        _write(sink, answer_of(final))


def _write(sink: BinaryIO, answer: CompanionReply) -> None:
    sink.write(answer.line())
    sink.flush()


def main() -> None:
    """Run on standard input and output; an error that the user can correct is the last reply."""
    try:
        answers(sys.stdin.buffer, sys.stdout.buffer)
    except UserError as error:
        _write(sys.stdout.buffer, CompanionReply(trouble=str(error)))
    except BrokenPipeError:
        return


if __name__ == "__main__":
    main()
