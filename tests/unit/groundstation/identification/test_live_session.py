"""Live identification at the ground: the same numbers as over the file, from scans in order, lossy, late; nothing harms it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from daq.contract.recordings.reading import read_recording
from daq.contract.scan import Scan, encode_scan
from daq.identification.airframe import SIGNALS, Belief, Sample
from daq.identification.live import LiveEstimator
from daq.identification.movement import ManoeuvreDetector
from daq.identification.regression import LONGITUDINAL
from estimation.aircraft import load_aircraft
from estimation.errors import EstimationError
from estimation.estimators.recursive import airframe_of, estimate_recursively, samples_of
from estimation.models import load_model
from estimation.models.load import write_model
from groundstation.calibration.apply import Calibrator, calibrate
from groundstation.calibration.recording import embedded_calibration
from groundstation.calibration.scan_table import Readings, ScanTable
from groundstation.flight import Flight
from groundstation.identification.alignment import NEIGHBOURS, ScanAlignment
from groundstation.identification.session import LiveIdentification, LiveState
from groundstation.identification.wanted import TimeToBound, wanted_bounds
from groundstation.identification.watching import LiveWatch, conditions_at
from groundstation.identification.words import short_line, state_lines
from sideslip.live_aircraft import airframe_of_file, live_aircraft

EIGHT = ("CY_beta", "CY_dr", "Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_r", "Cn_dr")
Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def recording(root: Path) -> tuple[list[Scan], Calibrator, Flight]:
    """Scans of a simulated flight of half a minute, its calibration, and the flight as `sideslip calibrate` makes it."""
    found = read_recording(root / "recordings" / "cdfp_ld4_raw.mcap")
    scans = list(found.scans())
    calibration = embedded_calibration(found)
    return scans, Calibrator(calibration, found.info.details), calibrate(scans, calibration, facts=found.info.details)


def session(calibrator: Calibrator, alignment: ScanAlignment) -> LiveIdentification:
    return LiveIdentification(live_aircraft("cdfp"), calibrator, 0.05, alignment, ManoeuvreDetector(9.0, 2.0))


def received(scans: list[Scan], seed: int = 3) -> Iterator[Scan]:
    """At 11.5 Hz, 5 % of it lost."""
    rng = np.random.default_rng(seed)
    sent = np.diff(np.floor(np.arange(len(scans)) * 11.5 / 20.0), prepend=-1.0) > 0
    return (s for s, there in zip(scans, sent & (rng.uniform(size=len(scans)) > 0.05), strict=True) if there)


def fed(live: LiveIdentification, alignment: ScanAlignment, scans: Iterator[Scan]) -> list[LiveState]:
    states = []
    for scan in scans:
        alignment.add(scan)
        state = live.step()
        states += [] if state is None else [state]
    return states


@dataclass(frozen=True)
class InOrder:
    """All scans, in order: states on the way, the last one, and the stretches identified from."""

    states: tuple[LiveState, ...]
    final: LiveState
    stretches: tuple[tuple[float, float], ...]


@pytest.fixture(scope="module")
def in_order(recording: tuple[list[Scan], Calibrator, Flight]) -> InOrder:
    scans, calibrator, _ = recording
    alignment = ScanAlignment()
    live = session(calibrator, alignment)
    states = fed(live, alignment, iter(scans))
    final = live.finish()
    assert final is not None
    return InOrder(tuple(states), final, live.stretches.found)


def test_scans_in_order_give_the_numbers_of_the_file(
    recording: tuple[list[Scan], Calibrator, Flight], in_order: InOrder
) -> None:
    flight, final = recording[2], in_order.final
    assert 20 < len(in_order.states) < 40
    used = np.zeros(len(flight), bool)
    for begin, end in in_order.stretches:
        used |= (flight.time >= begin - 1e-9) & (flight.time <= end + 1e-9)
    assert 300 < used.sum() < len(flight)
    aircraft = load_aircraft("cdfp")
    over_file = estimate_recursively(load_model("lateral", aircraft), [flight.part(used)], aircraft)
    for name, known in final.estimates.derivatives.items():
        there = over_file.parameters[name]
        assert known.estimate == pytest.approx(there.estimate, rel=1e-6)
        assert known.std == pytest.approx(there.std_coloured, rel=1e-6)


def test_both_planes_are_identified_where_asked_for(recording: tuple[list[Scan], Calibrator, Flight]) -> None:
    """Lateral numbers are those of the file; the elevator, which was not flown, is named."""
    scans, calibrator, flight = recording
    alignment, aircraft = ScanAlignment(), live_aircraft("cdfp", model="six-dof")
    stretches = ManoeuvreDetector(9.0, 2.0, aircraft.regressions)
    live = LiveIdentification(aircraft, calibrator, 0.05, alignment, stretches)
    states = fed(live, alignment, iter(scans))
    final = live.finish()
    assert final is not None
    assert not live.trouble
    used = np.zeros(len(flight), bool)
    for begin, end in live.stretches.found:
        used |= (flight.time >= begin - 1e-9) & (flight.time <= end + 1e-9)
    craft = load_aircraft("cdfp")
    over_file = estimate_recursively(load_model("six-dof", craft), [flight.part(used)], craft)
    assert not any(final.estimates.derivatives[n].told for n in ("CL_alpha", "CD_0", "Cm_de"))
    for name in ("CY_beta", "Cl_p", "Cn_beta"):
        known, there = final.estimates.derivatives[name], over_file.parameters[name]
        assert known.estimate == pytest.approx(there.estimate, rel=1e-5, abs=1e-9)
        assert known.std == pytest.approx(there.std_coloured, rel=1e-5)
    shown = "\n".join(state_lines(final))
    assert all(word in shown for word in ("CL_alpha", "Cm_q", "Cn_dr", "elevator has not moved yet"))
    assert short_line(states[-1])
    assert set(live.history.to_json()) == {"time", *aircraft.derivatives}


def test_late_scans_end_in_the_same_numbers(
    recording: tuple[list[Scan], Calibrator, Flight], in_order: InOrder
) -> None:
    scans, calibrator, _ = recording
    lossy = ScanAlignment()
    second = session(calibrator, lossy)
    there = {s.number for s in received(scans)}
    fed(second, lossy, received(scans))
    before = second.state
    for scan in scans:
        if scan.number not in there:
            lossy.add(encode_scan(scan))
    got = second.finish()
    assert got is not None
    assert before is not None
    # the stretch of flight begins by the scans that came in order: within one of theirs
    for name in EIGHT:
        a, b, c = (s.estimates.derivatives[name] for s in (in_order.final, got, before))
        assert abs(b.estimate - a.estimate) < 0.05 * a.std
        assert b.std < c.std
    assert got.late == 0


def test_lossy_link_is_aligned_well_enough(recording: tuple[list[Scan], Calibrator, Flight], in_order: InOrder) -> None:
    """Left at their own instants, the same scans give rolling derivatives that are 15 to 25 % small."""
    scans, calibrator, _ = recording

    def rolling(state: LiveState | None) -> Array:
        assert state is not None
        return np.array([state.estimates.derivatives[n].estimate for n in ("Cl_beta", "Cl_p", "Cl_da")])

    def found(seed: int) -> Array:
        alignment = ScanAlignment()
        live = session(calibrator, alignment)
        fed(live, alignment, received(scans, seed))
        return rolling(live.finish())

    off = [found(seed) / rolling(in_order.final) - 1.0 for seed in range(3)]
    assert np.abs(np.median(off, axis=0)).max() < 0.08


def test_samples_of_the_aligned_stretch_are_those_of_the_flight(
    recording: tuple[list[Scan], Calibrator, Flight],
) -> None:
    scans, calibrator, flight = recording
    alignment = ScanAlignment()
    got: list[Sample] = []
    for scan in scans:
        alignment.add(scan)
        got += alignment.ready(calibrator)
    assert len(got) >= len(scans) - NEIGHBOURS - 21
    table = np.array([s[: 1 + len(SIGNALS)] for s in got[40:]])
    rows = np.searchsorted(flight.time, table[:, 0] - 1e-9)
    expected = np.stack([flight.time[rows], *(flight[n][rows] for n in SIGNALS)], axis=1)
    np.testing.assert_allclose(table, expected, rtol=1e-9, atol=1e-12)


class _WithLoading(Calibrator):
    """As if a sensor of one's own had made a column `mass` or `cg_x`, in every tenth scan."""

    column, value = "mass", 4.2

    def columns(self, table: ScanTable, *, aligned: bool) -> tuple[dict[str, Array], Readings]:
        columns, readings = super().columns(table, aligned=aligned)
        read = np.arange(len(table)) % 10 == 0
        return {**columns, self.column: np.where(read, self.value, np.nan)}, readings


@pytest.mark.parametrize(("share", "words"), [(0.8, "as measured"), (9.0, "which is not this aircraft's")])
def test_a_mass_that_a_sensor_of_ones_own_measures_is_taken(
    share: float, words: str, recording: tuple[list[Scan], Calibrator, Flight], in_order: InOrder
) -> None:
    """Side force is mass times acceleration, moments have nothing to do with it."""
    scans, calibrator, _ = recording
    fuel, alignment = _WithLoading(calibrator.calibration, calibrator.facts.values), ScanAlignment()
    live = session(fuel, alignment)
    fuel.value = share * live.aircraft.airframe.mass
    fed(live, alignment, iter(scans))
    final = live.finish()
    assert final is not None
    assert words in "\n".join(state_lines(final))
    expected = share if words == "as measured" else 1.0
    for name, ratio in (("CY_beta", expected), ("CY_dr", expected), ("Cl_p", 1.0)):
        without = in_order.final.estimates.derivatives[name].estimate
        assert final.estimates.derivatives[name].estimate == pytest.approx(ratio * without, rel=5e-3)


@pytest.mark.parametrize(("ahead", "words"), [(0.06, "+0.06 m ahead"), (60.0, "further than a tenth of the span")])
def test_a_centre_of_gravity_that_a_sensor_of_ones_own_measures_is_taken(
    ahead: float, words: str, recording: tuple[list[Scan], Calibrator, Flight], in_order: InOrder
) -> None:
    """About the file's CG the side force has an arm."""
    scans, calibrator, _ = recording
    moving, alignment = _WithLoading(calibrator.calibration, calibrator.facts.values), ScanAlignment()
    moving.column, moving.value = "cg_x", ahead
    live = session(moving, alignment)
    fed(live, alignment, iter(scans))
    final = live.finish()
    assert final is not None
    assert words in "\n".join(state_lines(final))
    without, now = (s.estimates.derivatives for s in (in_order.final, final))
    arm = ahead / live.aircraft.airframe.span if ahead < 1.0 else 0.0
    for name, side in (("Cn_beta", "CY_beta"), ("Cn_dr", "CY_dr")):
        expected = without[name].estimate + arm * now[side].estimate
        assert now[name].estimate == pytest.approx(expected, rel=0.05 if arm else 1e-9), name


@pytest.mark.parametrize(
    ("rate", "seen", "grid"), [(11.5, 11.5, 0.05), (19.6, 20.0, 0.05), (50.2, 25.0, 0.04), (100.0, 20.0, 0.05)]
)
def test_thresholds_are_simulated_for_the_scans_that_come(rate: float, seen: float, grid: float) -> None:
    """Of fast ones some are left out, as over a file."""
    conditions = conditions_at(rate)
    assert (conditions.rate, conditions.grid) == (pytest.approx(seen), pytest.approx(grid))


def test_of_fast_scans_the_watch_looks_at_some(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LiveWatch, "_calibrate", lambda self: None)
    for rate, left in ((19.6, 98), (50.0, 125), (100.0, 100)):
        watch = LiveWatch(live_aircraft("cdfp"), rate)
        for k in range(round(5.0 * rate)):
            watch.add(Sample(k / rate, *[0.0] * 12))
        assert len(watch._waiting) == left


def test_numbers_that_cannot_be_end_identification_and_nothing_else(
    recording: tuple[list[Scan], Calibrator, Flight], monkeypatch: pytest.MonkeyPatch
) -> None:
    scans, calibrator, _ = recording

    def singular(self: LiveEstimator) -> None:
        raise np.linalg.LinAlgError("singular")

    alignment = ScanAlignment()
    live = session(calibrator, alignment)
    monkeypatch.setattr(LiveEstimator, "estimates", singular)
    assert fed(live, alignment, iter(scans)) == []
    assert live.trouble == "live identification rests: singular"
    assert live.finish() is None


def test_words_name_what_rests_and_what_helps(in_order: InOrder) -> None:
    states = in_order.states
    early, late = "\n".join(state_lines(states[0])), "\n".join(state_lines(states[-1]))
    assert "rudder has not moved yet" in early
    assert "Cl_p" in late
    assert "wind tunnel" in late
    assert "next: " in late
    assert " identified, " in short_line(states[-1])
    assert states[-1].estimates.derivatives["Cn_dr"].told


def test_aircraft_files_give_the_airframe_of_the_estimate() -> None:
    aircraft = load_aircraft("cdfp")
    assert airframe_of_file(aircraft) == airframe_of(load_model("lateral", aircraft), aircraft)


def test_time_to_a_bound_follows_information() -> None:
    """Of a bound that falls as 1 / sqrt(t), 0.1 at 10 s, 0.05 is there at 40 s."""
    pace = TimeToBound()
    wanted = {"Cl_p": 0.05}
    for t in np.arange(1.0, 21.0):
        to_go = pace.at(_estimates(t, 0.1 * math.sqrt(10.0 / t)), wanted)
        if t > 1.0:
            assert to_go["Cl_p"] == pytest.approx(40.0 - t)
    assert pace.at(_estimates(45.0, 0.04), wanted)["Cl_p"] == 0.0


def test_wanted_bounds_follow_what_is_told() -> None:
    beliefs = {"Cl_p": Belief(-0.4, 0.1), "CY_r": Belief(0.1, 0.05)}
    assert wanted_bounds(beliefs, {}, 0.05)["Cl_p"] == pytest.approx(0.02)
    assert wanted_bounds(beliefs, {}, 0.05)["CY_r"] == pytest.approx(0.02)  # weak: four times the share
    told = _estimates(1.0, 0.01).derivatives
    assert wanted_bounds(beliefs, told, 0.05)["Cl_p"] == pytest.approx(0.025)


def test_stretches_lie_about_movements_in_flight() -> None:
    """Fast from 9 to 40 s; the aileron moves at 0.5 s (not in flight), at 20 s and at 25 s."""
    found = ManoeuvreDetector(9.0, 2.0)
    at_rest = Sample(0.0, *[0.0] * 12)._replace(rho=1.2)
    given: list[float] = []
    for i in range(500):
        t = 0.1 * i
        moved = 0.1 if any(m <= t < m + 0.5 for m in (0.5, 20.0, 25.0)) else 0.0
        given += [
            s.time for s in found.take(at_rest._replace(time=t, V=15.0 if 9.0 <= t < 40.0 else 5.0, delta_a=moved))
        ]
    ((begin, end),) = found.found
    assert begin == pytest.approx(19.0, abs=0.11)
    assert end == pytest.approx(32.5, abs=1.01)  # moved last at 25.5 s, noticed for a second, six more
    assert given[0] == begin
    assert given[-1] == end
    assert np.all(np.diff(given) < 0.11)
    assert [s.time for s in found.take(at_rest._replace(time=20.03, V=15.0))] == [20.03]  # late
    assert not list(found.take(at_rest._replace(time=15.03, V=15.0)))


def _estimates(time: float, std: float):  # type: ignore[no-untyped-def]
    from daq.identification.estimates import LiveDerivative, LiveEstimates

    return LiveEstimates(time, time, 100, {"Cl_p": LiveDerivative("Cl_p", -0.5, std, std)}, ())


def test_samples_of_the_flight_are_used(recording: tuple[list[Scan], Calibrator, Flight]) -> None:
    _, _, flight = recording
    assert sum(s.credible for s in samples_of(flight, slice(None))) > 500


@pytest.mark.parametrize(("with_model", "heard"), [(True, False), (False, True)])
def test_the_monitor_beside_it_hears_of_an_aileron_that_does_less_than_believed(
    with_model: bool,
    heard: bool,
    recording: tuple[list[Scan], Calibrator, Flight],
    in_order: InOrder,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A model is what this flight shows, and sure; what is believed is so too, but for the aileron."""
    from daq.identification.monitor import threshold
    from groundstation.identification import watching

    monkeypatch.setattr(threshold, "AT_ONCE", 24)
    monkeypatch.setattr(threshold, "FLIGHT_S", 40.0)
    monkeypatch.setattr(watching, "HOURS", 0.2)  # a batch; the aileron's score is far above any threshold
    scans, calibrator, _ = recording
    beliefs = {n: Belief(d.estimate, max(2.0 * d.std, 1e-4)) for n, d in in_order.final.estimates.derivatives.items()}
    wrong = beliefs | {"Cl_da": Belief(2.2 * beliefs["Cl_da"].value, 0.002)}
    sure = live_aircraft("cdfp")
    modelled = replace(sure.airframe, beliefs=beliefs) if with_model else None
    sure = replace(sure, airframe=replace(sure.airframe, beliefs=wrong), modelled=modelled)
    again = ScanAlignment()
    live = LiveIdentification(sure, calibrator, 0.05, again, ManoeuvreDetector(9.0, 2.0), watched=True)
    fed(live, again, iter(scans))
    live.finish()
    assert live.watch is not None
    alarms = live.watch.step(finish=True)
    assert not live.watch.trouble
    assert live.watch.watched > 10.0
    assert bool(alarms) is heard
    if heard:
        assert alarms[0].equation == "Cl"
        assert "holds in Cl (shown by p" in alarms[0].text


def test_a_model_is_held_against_flight_with_what_it_states_of_its_bounds(tmp_path: Path) -> None:
    craft = load_aircraft("cdfp")
    model = load_model("lateral", craft).with_starts({"Cl_p": -0.3})
    write_model(model, tmp_path / "m.toml")
    found = live_aircraft("cdfp", None, str(tmp_path / "m.toml"))
    assert found.modelled is not None
    believed, held = found.airframe.beliefs["Cl_p"], found.modelled.beliefs["Cl_p"]
    assert (believed.value, held.value) == (-0.45, -0.3)
    assert held.std == 0.0  # it was estimated, and says nothing of its bound: the monitor takes its own
    assert found.modelled.beliefs["Cl_da"] == found.airframe.beliefs["Cl_da"]  # what nobody has estimated yet
    assert live_aircraft("cdfp").modelled is None


def test_a_model_of_the_other_plane_is_estimated_and_one_that_is_not_linear_refused(tmp_path: Path) -> None:
    write_model(load_model("longitudinal", load_aircraft("cdfp")), tmp_path / "m.toml")
    aircraft = live_aircraft("cdfp", None, str(tmp_path / "m.toml"))
    assert aircraft.modelled is not None  # the gap monitor holds its values against flight
    assert set(aircraft.modelled.beliefs) == set(LONGITUDINAL.derivatives)
    assert [r.name for r in aircraft.regressions] == ["longitudinal"]
    write_model(load_model("lateral", load_aircraft("cdfp")).with_biases("beta"), tmp_path / "biased.toml")
    with pytest.raises(EstimationError, match="bias_beta is none of them"):
        live_aircraft("cdfp", None, str(tmp_path / "biased.toml"))


def test_nothing_is_called_reached_that_is_not(in_order: InOrder) -> None:
    for state in in_order.states:
        bounds = {n: (state.estimates.derivatives[n].std, wanted) for n, wanted in state.wanted.items() if wanted > 0.0}
        there = all(std <= wanted for std, wanted in bounds.values())
        assert ("every wanted bound is reached" in short_line(state)) is there, f"{state.time}: {bounds}"
        solved = all(math.isfinite(std) for std, _ in bounds.values())
        assert (state.advice is not None) is (solved and not there)
