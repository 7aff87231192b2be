"""A set flown until identification on board has its bound: the whole logger in the simulated aircraft."""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import pytest
import tomli_w

from daq.contract.manoeuvre import Manoeuvre
from daq.contract.recordings.reading import read_recording
from daq.contract.scan import Scan, encode_scan
from daq.contract.sequencing import Reason, State
from daq.identification.movement import ManoeuvreDetector
from firmware_sim.hardware.cockpit import switch_for
from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import load_scenario
from groundstation.calibration.apply import Calibrator
from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY, load_calibration
from groundstation.identification.alignment import ScanAlignment
from groundstation.identification.session import LiveIdentification
from sideslip.live_aircraft import live_aircraft
from sideslip.onboard import WANTED, answer_of

SET_S = 8.0


class CompanionInStep:
    """Identification on board in the simulation's own time, half a second of scans at once: the process would be as late as this
    computer is slow."""

    TOGETHER = 10

    def __init__(self, calibration: Path) -> None:
        self._calibration = calibration
        self._known: Mapping[str, tuple[float, float]] | None = None
        self._waiting = 0

    def start(self, details: Mapping[str, str]) -> None:
        aircraft = live_aircraft("cdfp")
        self._alignment = ScanAlignment(1.0)
        calibrator, stretches = Calibrator(load_calibration(self._calibration), details), ManoeuvreDetector(9.0, 2.0)
        self._live = LiveIdentification(aircraft, calibrator, WANTED, self._alignment, stretches)

    def scans(self, scans: Iterable[Scan]) -> None:
        for scan in scans:
            self._alignment.add(encode_scan(scan))
            self._waiting += 1
        if self._waiting < self.TOGETHER:
            return
        self._waiting = 0
        state = self._live.step()
        if state is not None:
            self._known = answer_of(state).values

    def close(self) -> None:
        assert self._live.trouble == ""

    def known(self) -> Mapping[str, tuple[float, float]] | None:
        return self._known


def set_file(path: Path) -> Path:
    """Sines of a second of aileron and rudder, one after the other."""
    deflections = {"delta_a": [0.0] * round(SET_S / 0.02), "delta_r": [0.0] * round(SET_S / 0.02)}
    for control, starts, peak in (("delta_a", (0.2, 2.0, 5.0), 5.0), ("delta_r", (3.3, 6.3), 3.5)):
        for start in starts:
            for k in range(50):
                deflections[control][round(start / 0.02) + k] = math.radians(peak) * math.sin(2.0 * math.pi * k / 50)
    path.write_text(tomli_w.dumps(Manoeuvre("test", 0.02, {n: tuple(v) for n, v in deflections.items()}).to_dict()))
    return path


@pytest.mark.parametrize(
    ("until", "sets", "reason", "least_s", "most_s"),
    [
        ("Cl_da 8 %", 3, Reason.REACHED, 3.0, 2.6 * SET_S),
        ("Cn_p 0.2 %", 2, Reason.COMPLETE, 2 * SET_S - 0.1, 2 * SET_S + 0.2),
    ],
)
def test_a_set_ends_or_goes_on_by_what_is_known(
    until: str, sets: int, reason: Reason, least_s: float, most_s: float, tmp_path: Path
) -> None:
    calibration = NOMINAL_DIRECTORY / "cdfp"
    sequencer = {"manoeuvre": str(set_file(tmp_path / "m.toml")), "until": until, "most_sets": sets}
    scenario = load_scenario("nominal").altered(
        flight={"duration_s": 10.0 + SET_S * sets, "manoeuvres": "none"}, ground={"launch_s": 8.0, "after_s": 0.0}
    )
    scenario = scenario.altered(
        logger={"sequencer": sequencer, "identification": {}},
        sequencer={"switch": switch_for(scenario, SET_S * sets)},
    )
    with prepare_flight(scenario, tmp_path / "out", calibration=calibration) as flight:
        companion = CompanionInStep(calibration)
        flight.assembly.logger.attach_companion(companion)  # type: ignore[arg-type]  # in the place of the process
        assert flight.assembly.actuation is not None
        flight.assembly.actuation.known = companion.known
        files = flight.run()
    frames = read_recording(files.folder / "onboard").sequencer
    running = [f for f in frames if f.state == State.RUNNING]
    assert frames[-1].state in (State.RELEASED, State.IDLE)
    assert reason in {f.reason for f in frames}
    assert least_s < 0.02 * len(running) < most_s
