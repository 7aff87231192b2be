"""Live identification in the running station: a simulated flight over the radio, what is said, forwarded, shown and kept."""

import json
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sideslip
from daq.identification.airframe import DERIVATIVES
from daq.identification.regression import LiveAircraft
from daq.transport.mavlink_codec import FrameDecoder
from daq.utilities.errors import UserError
from firmware_sim.world.scenario import load_scenario
from groundstation.flight import Flight, read_flight
from groundstation.identification.history import BELIEVED, DETAIL, MOST, LiveHistory, history_of
from groundstation.live.config import LiveIdentificationConfig
from groundstation.live.identifying import LiveIdentifications, NamedValues
from groundstation.live.watches import LandingLimits
from groundstation.viewer import entities as e
from groundstation.viewer.recorded import as_rrd
from sideslip.chain import fly_scenario
from sideslip.live_aircraft import live_aircraft
from sideslip.verbs.demo import DEMO_RADIO
from tests.unit.groundstation.viewer.test_scene import entity_paths, scalars

pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ground station's folder after a flight over a lossy radio, completed by backfill."""
    folder = tmp_path_factory.mktemp("flown")
    fly_scenario(load_scenario("cdfp_ld4").altered(radio=DEMO_RADIO), folder, seed=4)
    return folder / "ground"


def kept(flown: Path) -> Mapping[str, Any]:
    found: Mapping[str, Any] = read_flight(flown / "flight.mcap").provenance.detail[DETAIL]
    return found


def test_the_log_says_what_is_told_and_what_helps(flown: Path) -> None:
    said = (flown / "events.log").read_text()
    assert "live identification of cdfp begins" in said
    assert "live: Cn_dr identified: " in said
    assert "; next: " in said


def test_the_flight_keeps_history_and_last_numbers(flown: Path) -> None:
    detail = kept(flown)
    json.dumps(detail, allow_nan=False)
    times, series = history_of({DETAIL: detail}) or ([], {})
    assert len(times) > 20
    assert np.all(np.diff(times) >= 0.0)
    assert set(series) == set(DERIVATIVES)
    estimates, bounds = (np.array(v) for v in series["Cl_p"])
    assert np.isnan(estimates[0])
    assert estimates[-1] == pytest.approx(detail["final"]["Cl_p"]["estimate"], rel=1e-5)
    assert bounds[-1] < bounds[np.isfinite(bounds)][0]
    assert detail[BELIEVED]["Cl_beta"]["source"] == "wind tunnel"


def test_last_numbers_are_those_of_the_estimate_over_the_file(flown: Path, tmp_path: Path) -> None:
    """Once everything has come down: `sideslip estimate --method live` on the stretches that were identified from."""
    flight, detail = read_flight(flown / "flight.mcap"), kept(flown)
    # all of this flight is one stretch: it ends in the air, with the controls moving. Where it begins is found from its rows
    first = int(np.searchsorted(flight.time, flight.time[-1] - detail["span_s"] - 0.4))
    found = by_file(flight.part(flight.time >= flight.time[first]), tmp_path)
    first += found["iterations"] - detail["rows"]
    found = by_file(flight.part(flight.time >= flight.time[first]), tmp_path)
    assert found["iterations"] == detail["rows"]
    for name in ("CY_beta", "CY_dr", "Cl_p", "Cl_da", "Cn_beta", "Cn_dr"):
        one = found["parameters"][name]
        assert detail["final"][name]["estimate"] == pytest.approx(one["estimate"], abs=1e-3 * one["std_coloured"])


def by_file(stretch: Flight, folder: Path) -> Mapping[str, Any]:
    """`sideslip estimate --method live` over a file of the stretch; its rows are its iterations."""
    path = stretch.save(folder / "stretch.mcap")
    with pytest.raises(SystemExit):
        sideslip.main(["estimate", str(path), "--method", "live", "--json", str(folder / "out.json")])
    found: Mapping[str, Any] = json.loads((folder / "out.json").read_text())["flights"][0]["methods"]["live"]
    return found


def test_view_of_the_flight_shows_the_history(flown: Path, tmp_path: Path) -> None:
    rrd = as_rrd(flown / "flight.mcap", tmp_path / "f.rrd")
    assert {f"{e.IDENTIFICATION}/{c}" for c in ("CY", "Cl", "Cn")} <= entity_paths(rrd)
    times, table = scalars(rrd, f"{e.IDENTIFICATION}/Cl")
    history, series = history_of({DETAIL: kept(flown)}) or ([], {})
    assert len(times) == len(history)
    belief = kept(flown)[BELIEVED]["Cl_p"]
    estimates, bounds = (np.array(v) for v in series["Cl_p"])
    shown = table[np.argsort(times)][:, 3:6]  # Cl_beta, then Cl_p: estimate and both edges of its band
    np.testing.assert_allclose(shown[:, 0], (estimates - belief["value"]) / belief["std"], rtol=1e-6)
    np.testing.assert_allclose(shown[:, 2] - shown[:, 1], 4.0 * bounds / belief["std"], rtol=1e-6)


def test_the_live_view_shows_what_is_identified(tmp_path: Path) -> None:
    """Values and words of the last state, read back through rerun's own reader."""
    from rerun.chunk import RrdReader

    from groundstation.viewer.live import LiveView, ViewOptions
    from tests.web.live_identification import identified

    rrd = tmp_path / "live.rrd"
    view = LiveView("live", ViewOptions(layout="light", serve=False, rrd=rrd))
    states = [state for _, _, state in identified() if state is not None]
    for state in states:
        view.identification(state)
    view.close()
    assert view.dropped == 0
    times, table = scalars(rrd, f"{e.IDENTIFICATION}/Cn")
    assert sorted(times) == pytest.approx([s.time for s in states])
    last, belief = states[-1], states[-1].aircraft.airframe.beliefs["Cn_beta"]
    known = last.estimates.derivatives["Cn_beta"]
    assert known.told
    row = table[int(np.argmax(times))]
    assert row[0] == pytest.approx((known.estimate - belief.value) / belief.std)
    assert row[2] - row[1] == pytest.approx(4.0 * known.std / belief.std)
    texts = [
        str(text)
        for chunk in RrdReader(str(rrd)).stream().filter(content=e.IDENTIFIED)
        for text in chunk.to_record_batch().to_pydict().get("TextDocument:text", [])
    ]
    assert any(f"{known.estimate:.4g}" in text for text in texts)


class Told:
    """A monitor's part that identification needs."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.system = 1

    def note(self, level: str, text: str) -> None:
        self.said.append(f"{level} {text}")


def test_a_wrong_aircraft_is_said_before_the_flight() -> None:
    with pytest.raises(UserError, match="no such file and no built-in of that name"):
        LiveIdentifications(
            LiveIdentificationConfig(aircraft="cdpf"), LandingLimits(), live_aircraft, Told().said.append
        )


def test_nothing_is_read_where_it_is_off() -> None:
    def refused(name: str, text: str | None) -> LiveAircraft:
        raise AssertionError

    off = LiveIdentificationConfig(aircraft="cdfp", enabled=False)
    assert LiveIdentifications(off, LandingLimits(), refused, Told().said.append).state(1) is None


def test_values_are_forwarded_in_the_aircrafts_name(flown: Path) -> None:
    from daq.contract.recordings.reading import read_recording
    from daq.identification.movement import ManoeuvreDetector
    from groundstation.calibration.apply import Calibrator
    from groundstation.calibration.recording import embedded_calibration
    from groundstation.identification.alignment import ScanAlignment
    from groundstation.identification.session import LiveIdentification

    recording = read_recording(next(flown.glob("aircraft*.mcap")))
    alignment = ScanAlignment()
    calibrator = Calibrator(embedded_calibration(recording), recording.info.details)
    live = LiveIdentification(live_aircraft("cdfp"), calibrator, 0.05, alignment, ManoeuvreDetector(9.0, 2.0))
    for scan in recording.scans():
        alignment.add(scan)
    state = live.finish()
    assert state is not None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        other.settimeout(5.0)
        values = NamedValues((f"udp:127.0.0.1:{other.getsockname()[1]}",), Told().said.append)
        values.send(7, state)
        values.close()
        told = [d for d in state.estimates.derivatives.values() if d.told and not d.name.endswith("_0")]
        decoder = FrameDecoder()
        frames = [f for _ in range(2 * len(told)) for f in decoder.feed(other.recv(300))]
    assert {f.system for f in frames} == {7}
    got = {str(f.fields()["name"]).rstrip("\0"): f.fields()["value"] for f in frames}
    for d in told:
        assert got[d.name] == pytest.approx(d.estimate, rel=1e-6)
        assert got[f"{d.name}.s"] == pytest.approx(d.std, rel=1e-6)


def test_a_very_long_history_is_thinned_out(flown: Path) -> None:
    from daq.identification.estimates import LiveDerivative, LiveEstimates

    known = {n: LiveDerivative(n, 1.0, 0.1, 0.1) for n in DERIVATIVES}
    history = LiveHistory()
    for t in range(5 * MOST):
        history.add(float(t), LiveEstimates(float(t), 1.0, 1, known, ()))
    times = history.to_json()["time"]
    assert len(times) <= MOST
    assert times[0] == 0.0
    assert times[-1] > 4.9 * MOST
    assert max(np.diff(times)) <= 8.0


@pytest.mark.parametrize(
    "nonsense", [None, [], {"history": 3}, {"history": {"time": [1, "x"]}}, {"history": {"time": []}}]
)
def test_what_is_no_history_is_none(nonsense: object) -> None:
    assert history_of({DETAIL: nonsense}) is None
