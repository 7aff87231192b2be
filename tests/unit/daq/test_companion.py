"""Live identification on board: the numbers of the ground from the same scans, and no way to harm the logger."""

import json
import sys
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import pytest

from daq.companion.process import BACKLOG, Companion, IdentificationConfig
from daq.companion.wire import CompanionReply, Setup, read_answer, setup_frame
from daq.config import ConfigError, parse_config
from daq.contract.recordings.messages import LogLevel
from daq.contract.recordings.reading import read_recording
from daq.contract.scan import Scan
from daq.identification.movement import ManoeuvreDetector
from estimation.aircraft.library import load_aircraft
from estimation.models import load_model, write_model
from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import load_scenario
from groundstation.calibration.apply import Calibrator
from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY, load_calibration
from groundstation.identification.alignment import ScanAlignment
from groundstation.identification.session import LiveIdentification
from sideslip.live_aircraft import live_aircraft
from sideslip.onboard import answers

CALIBRATION = NOMINAL_DIRECTORY / "cdfp"


@pytest.fixture(scope="module")
def scans(root: Path) -> list[Scan]:
    return list(read_recording(root / "recordings" / "cdfp_ld4_raw.mcap").scans())


class Heard:
    """What a companion says and shows."""

    def __init__(self) -> None:
        self.said: list[tuple[LogLevel, str]] = []
        self.shown: dict[str, float] = {}
        self.told: list[str] = []

    def companion(self, *command: str, every_s: float = 5.0) -> Companion:
        config = IdentificationConfig(every_s=every_s, command=command)
        return Companion(config, "cdfp", str(CALIBRATION), self.say, self.show, self.told.append)

    def say(self, level: LogLevel, name: str, text: str) -> None:
        assert name == "identification"
        self.said.append((level, text))

    def show(self, name: str, value: float) -> None:
        self.shown[name] = value


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scans come faster here than in the air."""
    monkeypatch.setattr("daq.companion.process.END_S", 60.0)


@pytest.mark.usefixtures("patient")
def test_numbers_are_those_of_the_ground_from_the_same_scans(scans: list[Scan]) -> None:
    heard = Heard()
    companion = heard.companion()
    companion.start({})
    for i in range(0, len(scans), 2):
        companion.scans(scans[i : i + 2])
    companion.close()
    alignment = ScanAlignment()
    live = LiveIdentification(
        live_aircraft("cdfp"), Calibrator(load_calibration(CALIBRATION)), 0.05, alignment, ManoeuvreDetector(9.0, 2.0)
    )
    for scan in scans:
        alignment.add(scan)
        live.step()
    state = live.finish()
    assert state is not None
    assert {level for level, _ in heard.said} == {LogLevel.INFO}
    last = json.loads(heard.said[-1][1])
    told = {n: d for n, d in state.estimates.derivatives.items() if d.told and not n.endswith("_0")}
    assert len(told) > 8
    assert last["values"] == {n: [pytest.approx(d.estimate), pytest.approx(d.std)] for n, d in told.items()}
    assert heard.shown["Cl_p"] == pytest.approx(told["Cl_p"].estimate)
    assert heard.shown["Cl_p.s"] == pytest.approx(told["Cl_p"].std)
    assert 3 <= len(heard.said) <= 7  # every five seconds of half a minute


PYTHON = sys.executable
WAYS: dict[str, tuple[tuple[str, ...], str]] = {
    "not there": (("/nowhere/python",), "/nowhere/python cannot be started (No such file or directory)"),
    "ends at once": ((PYTHON, "-c", "raise SystemExit(3)"), "is lost"),
    "says why": (
        (PYTHON, "-c", "import json; print(json.dumps({'time':None,'values':{},'words':'','trouble':'no wings'}))"),
        "no wings",
    ),
    "talks nonsense": ((PYTHON, "-c", "print('x' * 99999); print('{}'); print('[1]')"), "is lost"),
}


@pytest.mark.parametrize("way", WAYS)
def test_its_end_is_said_once_and_scans_go_on(way: str, scans: list[Scan]) -> None:
    command, words = WAYS[way]
    heard = Heard()
    companion = heard.companion(*command)
    companion.start({})
    for _ in range(40):
        companion.scans(scans[:20])
        if any(words in text for _, text in heard.said):
            break
        _wait()
    for scan in scans:
        companion.scans([scan])
    companion.close()
    warnings = [text for level, text in heard.said if level == LogLevel.WARNING]
    assert sum(words in text for text in warnings) == 1
    assert len(warnings) <= 2
    assert all(text.endswith("recording goes on") for text in warnings)
    assert heard.shown == {}


def test_one_that_does_not_read_leaves_the_loop_alone(scans: list[Scan], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daq.companion.process.END_S", 0.2)
    heard = Heard()
    companion = heard.companion(PYTHON, "-c", "import time; time.sleep(60)")
    companion.start({})
    for _ in range(10):
        companion.scans(scans)
    assert companion.dropped > 0
    assert len(companion._unsent) <= BACKLOG
    companion.close()
    texts = [text for _, text in heard.said]
    assert texts == [
        "cannot keep up: scans are left out of it; recording goes on",
        "has not finished in time; its last numbers are those before",
    ]


def test_a_set_flown_for_what_a_model_file_does_not_estimate_is_said(tmp_path: Path) -> None:
    write_model(load_model("lateral", load_aircraft("cdfp")), tmp_path / "m.toml")

    def said(until: str) -> bytes:
        sink = BytesIO()
        setup = Setup("cdfp", str(CALIBRATION), {}, 5.0, str(tmp_path / "m.toml"), until=until)
        answers(BytesIO(setup_frame(setup)), sink)
        return sink.getvalue()

    assert b"does not estimate Cm_q, so no set ends by it" in said("Cm_q")
    assert said("Cl_p") == b""


def test_an_answer_holds_what_can_be_shown() -> None:
    line = CompanionReply(3.0, {"Cl_p": (-0.5, 0.01), "much too long a name": (1.0, 1.0)}, "words").line()
    got = read_answer(line)
    assert got is not None
    assert got.values == {"Cl_p": (-0.5, 0.01)}
    assert read_answer(b'{"time": 1, "values": {"Cl_p": [NaN, 1]}, "words": "", "trouble": ""}') == CompanionReply(1.0)
    for nonsense in (b"", b"[]", b"{}", b'{"time": "x", "values": 3, "words": "", "trouble": ""}', b"\xff"):
        assert read_answer(nonsense) is None


@pytest.mark.usefixtures("patient")
def test_a_simulated_logger_records_what_it_identifies(tmp_path: Path) -> None:
    scenario = load_scenario("cdfp_ld4").altered(logger={"identification": {"every_s": 2.0}})
    with prepare_flight(scenario, tmp_path, calibration=CALIBRATION) as flight:
        flight.run()
    recording = read_recording(tmp_path / "onboard")
    kept = [json.loads(line.message) for line in recording.log if line.name == "identification"]
    assert kept
    assert kept[-1]["values"]["Cn_beta"][0] == pytest.approx(0.0286, rel=0.1)
    assert len(recording.numbers) > 20 * 30.0 - 15  # the sensors' own start takes some of the first second
    assert list(recording.numbers) == list(range(len(recording.numbers)))
    points = [line.message for line in recording.log if line.name == "test point"]
    assert all(p.startswith("point ") and "; next " in p for p in points)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.replace('calibration = "/etc/sideslip/calibration"', ""), "set the key calibration"),
        (lambda t: t.replace('name = "cdfp"', 'name = ""'), "set aircraft.name or aircraft.file"),
        (lambda t: t + "every_s = 0.1\n", "identification.every_s is 0.1"),
    ],
)
def test_what_it_needs_is_asked_for_before_anything_is_opened(
    root: Path, change: Callable[[str], str], words: str
) -> None:
    text = (root / "daq/configs/cdfp.toml").read_text() + "\n[identification]\n"
    parse_config(text, root / "c.toml")
    with pytest.raises(ConfigError, match=words):
        parse_config(change(text), root / "c.toml")


def _wait() -> None:
    import threading

    threading.Event().wait(0.1)
