"""Scans to flight: closed-form values, time base, what is not measured, and bits that do not depend on company."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daq.contract.channels import COLUMNS
from daq.contract.scan import GroupStatus, Scan, SensorState
from groundstation.calibration.apply import Calibrator, calibrate
from groundstation.calibration.calibration_set import CalibrationSet, load_calibration
from groundstation.calibration.schema import CalibrationError
from groundstation.flight import Flight

MakeScans = Callable[..., list[Scan]]


def test_every_column_of_the_table_is_there(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    flight = calibrate(make_scans(20), nominal)
    assert set(flight.columns) == {c.name for c in COLUMNS}
    assert flight.time[0] == 10.0
    assert flight.provenance.detail["aligned"] is True
    assert flight.provenance.calibration == nominal.hashes


def test_values_of_steady_flight(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    steady = {
        "p": 0.0,
        "alpha": 0.1,
        "beta": 0.05,
        "left": 0.1,
        "right": 0.2,
        "rudder": -0.1,
        "thrust": 5.0,
        "phi": 0.2,
        "psi": -2.0,
    }
    flight = calibrate(make_scans(20, **steady), nominal)
    row = {c: flight[c][10] for c in flight.columns}
    lsb = 0.8 * 4.096 / 32768  # rad of a vane count
    assert row["alpha"] == pytest.approx(0.1, abs=lsb)
    # the vane reads the flank angle atan(v/u): sin(beta) = cos(alpha) cos(beta) tan(0.05)
    assert np.tan(row["beta"]) == pytest.approx(np.tan(0.05) * np.cos(0.1), abs=2 * lsb)
    assert row["delta_e"] == pytest.approx(0.15, abs=1e-4)
    assert row["delta_a"] == pytest.approx(0.05, abs=1e-4)  # right elevon further down: rolls left, positive
    assert row["delta_r"] == pytest.approx(-0.1, abs=1e-4)
    assert (row["cmd_e"], row["cmd_a"]) == (pytest.approx(0.15, abs=1e-4), pytest.approx(0.05, abs=1e-4))
    assert row["throttle"] == pytest.approx(0.5)
    assert row["thrust"] == pytest.approx(5.0, abs=1e-4)
    assert row["az"] == pytest.approx(-9.80665)
    assert (row["phi"], row["psi"]) == (pytest.approx(0.2, abs=1e-4), pytest.approx(-2.0, abs=1e-4))
    assert row["V"] == pytest.approx(np.sqrt(2 * row["p_dynamic"] / row["rho"]), rel=1e-3)
    assert row["supply_voltage"] == pytest.approx(12.0, abs=1e-3)


def test_vanes_and_potentiometers_are_referred_to_the_sensor_supply(
    make_scans: MakeScans, nominal: CalibrationSet
) -> None:
    """The 5 V supply sags by 4 %: all ratiometric voltages with it, the angles stay."""
    sagging = []
    for scan in make_scans(5, beta=0.2, rudder=0.3):
        low = {n: round(0.96 * scan.values[n]) for n in ("alpha_vane", "beta_vane", "rudder_pot", "sensor_supply")}
        sagging.append(replace(scan, values={**scan.values, **low}))
    flight = calibrate(sagging, nominal)
    assert flight["delta_r"][2] == pytest.approx(0.3, abs=3e-4)
    assert flight["beta"][2] == pytest.approx(0.2, abs=3e-4)


def test_groups_read_at_different_instants_share_one_time_base(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    """A 0.8 Hz roll whose groups are read up to 12 ms apart: unaligned the skew shows, aligned it is gone."""

    def motion(t: float) -> dict[str, float]:
        return {"p": np.sin(5 * t), "beta": 0.1 * np.sin(5 * t), "rudder": 0.2 * np.sin(5 * t)}

    scans = make_scans(200, motion, {"imu": 1000, "analog_a": 6000, "analog_b": 12000, "pitot": 3000})
    truth = np.sin(5 * np.array([s.time for s in scans]))
    aligned, plain = calibrate(scans, nominal, align=True), calibrate(scans, nominal, align=False)
    for column, size in (("p", 1.0), ("delta_r", 0.2)):
        assert np.max(np.abs(aligned[column] / size - truth)[2:-2]) < 0.01
    assert np.max(np.abs(plain["delta_r"] / 0.2 - truth)) > 0.05
    # the two columns are then proportional to each other
    assert np.corrcoef(aligned["p"][2:-2], aligned["delta_r"][2:-2])[0, 1] > 0.99995
    assert aligned.provenance.detail["read_offsets_s"]["analog_b"] == 0.012


def test_filters_of_the_recording_are_taken_out(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    """The gyro's low pass in amplitude and phase, the static pressure's conversion as a delay."""
    gain = 1 / (1 + 5j * 0.0137)

    def lagging(t: float) -> dict[str, float]:
        return {"p": np.imag(gain * np.exp(5j * t))}

    facts = {"imu.gyro_delay_s": "0.0137", "static.filter_delay_s": "0.018"}
    flight = calibrate(make_scans(200, lagging), nominal, facts=facts)
    assert np.max(np.abs(flight["p"] - np.sin(5 * flight.time))[3:-3]) < 1e-3
    assert flight.provenance.detail["lags_s"]["gyro_x"] == 0.0137
    assert flight.provenance.detail["delays_s"]["static_pressure"] == 0.018


def test_recorded_range_takes_precedence(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    flight = calibrate(make_scans(5), nominal, facts={"imu.accel_scale_m_s2": repr(2 * 9.80665 / 4096)})
    assert flight["az"][2] == pytest.approx(-2 * 9.80665)


def test_imu_off_the_cg(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    """A pure yaw oscillation about the CG felt by an IMU 0.5 m ahead: nothing is left at the CG."""
    arm = 0.5

    def motion(t: float) -> dict[str, float]:
        r, r_dot = 0.8 * np.sin(4 * t), 3.2 * np.cos(4 * t)
        return {"r": r, "ay": r_dot * arm, "ax": -(r**2) * arm}

    text = nominal.texts["accelerometer.toml"].replace("position = [0.0, 0.0, 0.0]", f"position = [{arm}, 0.0, 0.0]")
    moved = nominal.with_texts({"accelerometer.toml": text})
    flight = calibrate(make_scans(200, motion), moved)
    assert np.max(np.abs(flight["ay"])[3:-3]) < 0.01  # of 1.6: what the derivative and quantisation leave
    assert np.max(np.abs(flight["ax"])[3:-3]) < 0.005
    plain = calibrate(make_scans(200, motion), moved, align=False)
    assert np.max(np.abs(plain["ay"])) > 1.5  # without neighbours only the centripetal part goes
    assert np.max(np.abs(plain["ax"])) < 0.005


def test_unusable_sensor_is_not_measured(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    scans = make_scans(40)
    for i in range(10, 20):
        groups = {**scans[i].groups, "pitot": GroupStatus(SensorState.STUCK, 0)}
        scans[i] = replace(scans[i], groups=groups)
    flight = calibrate(scans, nominal)
    assert np.isnan(flight["V"][10:20]).all()
    assert np.isnan(flight["alpha"][10:20]).all()  # the rotation of the vane cannot be taken out without airspeed
    assert np.isfinite(flight["V"][:10]).all()
    assert np.isfinite(flight["p"]).all()
    assert any("pitot" in n.text and "10 of 40" in n.text for n in flight.notes)
    assert flight.provenance.detail["unusable"] == {"pitot": 10}


def test_missing_scans_have_no_row_and_split_the_flight(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    scans = make_scans(300)
    del scans[150:160]
    flight = calibrate(scans, nominal)
    assert len(flight) == 290
    assert [s.stop - s.start for s in flight.segments] == [150, 140]
    assert any("gap" in n.text for n in flight.notes)


def test_thinned_stream_is_aligned_between_neighbours_and_says_so(
    make_scans: MakeScans, nominal: CalibrationSet
) -> None:
    """Every second scan of a 0.8 Hz roll whose gyro is read 12 ms late; one scan stands alone."""
    offset = {"imu": 12_000}
    scans = make_scans(200, lambda t: {"p": np.sin(5 * t)}, offset)
    thin = [*scans[:100:2], scans[110], *scans[120::2]]
    flight = calibrate(thin, nominal)
    assert flight.provenance.detail["aligned"] is True
    assert any(" of the scans are here: brought to one instant between neighbours" in n.text for n in flight.notes)
    whole = calibrate(scans, nominal)
    rows = np.isin(whole.time, flight.time)
    off = flight["p"] - whole["p"][rows]
    assert np.isnan(off).sum() == 1, "only the scan without neighbours"
    plain = calibrate(thin, nominal, align=False)
    assert np.nanstd(off) < 0.1 * np.std(plain["p"] - whole["p"][rows])


def test_stream_without_neighbours_is_left_unaligned_and_says_so(
    make_scans: MakeScans, nominal: CalibrationSet
) -> None:
    flight = calibrate(make_scans(100)[::5], nominal)
    assert flight.provenance.detail["aligned"] is False
    assert any("not aligned" in n.text for n in flight.notes)


def test_seldom_read_channel_of_a_thinned_stream_stays_in_its_scans(
    make_scans: MakeScans, nominal: CalibrationSet
) -> None:
    """Static pressure once a second, as a downlink has its slow channels: nothing is drawn between its samples."""
    scans = make_scans(200, busy)
    thin = [
        s if n % 20 == 0 else replace(s, values={k: v for k, v in s.values.items() if not k.startswith("static")})
        for n, s in enumerate(scans)
    ][::2]
    flight = calibrate(thin, nominal)
    assert flight.provenance.detail["aligned"] is True
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(flight["p_static"])), np.arange(0, 100, 10))


def test_repeated_and_shuffled_scans_give_the_same_flight(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    scans = make_scans(60, lambda t: {"p": np.sin(3 * t)})
    shuffled = [*scans[30:], *scans[:35]]
    flight, again = calibrate(scans, nominal), calibrate(shuffled, nominal)
    assert same_columns(flight, again)
    assert any("more than once" in n.text for n in again.notes)


def test_antenna_is_taken_to_the_cg(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    """Level flight northward with r: an antenna 0.5 m to the right of the CG lies east of it and moves backwards."""
    antenna = """format = 1
instrument = "gnss_antenna"
kind = "antenna"
date = 2026-11-01
method = "measured"
[mount]
position = [0.0, 0.5, -0.1]
"""
    fix = {
        "latitude_e7": 470_000_000,
        "longitude_e7": 85_000_000,
        "height_msl_mm": 60_000,
        "velocity_north_mm": 15_000,
        "velocity_east_mm": 0,
        "velocity_down_mm": 0,
        "gnss_fix": 3,
    }
    scans = [replace(s, values={**s.values, **fix}) for s in make_scans(20, r=0.4)]
    plain, moved = calibrate(scans, nominal), calibrate(scans, nominal.with_texts({"gnss_antenna.toml": antenna}))
    assert moved["vn"][10] == pytest.approx(plain["vn"][10] + 0.4 * 0.5, abs=2e-3)
    assert moved["altitude_gnss"][10] == pytest.approx(plain["altitude_gnss"][10] - 0.1, abs=1e-3)
    east = np.radians(plain["longitude"][10] - moved["longitude"][10]) * 6_371_000 * np.cos(np.radians(47))
    assert east == pytest.approx(0.5, abs=1e-3)
    assert moved["latitude"][10] == pytest.approx(plain["latitude"][10], abs=1e-9)


def test_gnss_counts_only_with_a_fix(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    scans = make_scans(4)
    fix = {
        "latitude_e7": 470_000_000,
        "longitude_e7": 85_000_000,
        "height_msl_mm": 60_000,
        "velocity_north_mm": 15_000,
        "velocity_east_mm": -1000,
        "velocity_down_mm": 0,
    }
    scans[1] = replace(scans[1], values={**scans[1].values, **fix, "gnss_fix": 3})
    scans[2] = replace(scans[2], values={**scans[2].values, **fix, "gnss_fix": 0})
    flight = calibrate(scans, nominal, align=False)
    assert flight["latitude"][1] == pytest.approx(47.0)
    assert (flight["vn"][1], flight["ve"][1], flight["altitude_gnss"][1]) == (15.0, -1.0, 60.0)
    assert np.isnan(flight["latitude"][[0, 2, 3]]).all()


def test_fixes_of_every_second_scan_are_brought_to_the_scan_time(
    make_scans: MakeScans, nominal: CalibrationSet
) -> None:
    """A velocity that rises by 2 m/s2, fixes 60 ms old when they arrive: aligned, every scan has its own."""
    scans = make_scans(60)
    for i in range(0, 60, 2):
        scan = scans[i]
        north = round(1000 * 2.0 * (scan.time - 0.06))
        groups = {**scan.groups, "gnss": GroupStatus(SensorState.OK, -60_000)}
        scans[i] = replace(scan, values={**scan.values, "velocity_north_mm": north, "gnss_fix": 3}, groups=groups)
    flight = calibrate(scans, nominal)
    np.testing.assert_allclose(flight["vn"][:-2], 2.0 * flight.time[:-2], atol=2e-3)
    plain = calibrate(scans, nominal, align=False)
    assert np.isnan(plain["vn"][1::2]).all()
    assert plain["vn"][10] == pytest.approx(2.0 * (plain.time[10] - 0.06), abs=1e-3)


def test_extrapolation_and_clipping_are_flagged(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    scans = make_scans(10)
    scans[3] = replace(scans[3], values={**scans[3].values, "alpha_vane": 32767})
    flight = calibrate(scans, nominal)
    assert flight.provenance.detail["extrapolated"] == {"alpha_vane": 1}
    assert flight.provenance.detail["clipped"] == {"alpha_vane": 1}
    assert any("alpha_vane" in n.text and "calibrated range" in n.text for n in flight.notes)


def test_static_port_error_is_taken_out(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    """Port reading 6 % of q too high: static down by it, impact up by it (same port feeds the pitot's low side)."""
    scans = make_scans(5)
    clean = calibrate(scans, nominal)
    text = nominal.texts["static.toml"].replace("position_error = 0.0", "position_error = 0.06")
    flight = calibrate(scans, nominal.with_texts({"static.toml": text}))
    q = clean["p_dynamic"][2] / (1 - 0.06)
    assert flight["p_dynamic"][2] == pytest.approx(q)
    assert flight["p_static"][2] == pytest.approx(clean["p_static"][2] - 0.06 * q)


def test_uncertainty_is_carried_to_every_calibrated_column(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    detail = calibrate(make_scans(60), nominal).provenance.detail
    sigma = detail["uncertainty"]
    for column in (
        "ax",
        "p",
        "alpha",
        "beta",
        "V",
        "rho",
        "delta_e",
        "delta_a",
        "delta_r",
        "p_dynamic",
        "thrust",
        "phi",
    ):
        assert sigma[column] > 0
    # V = sqrt(2 q / rho): 5 Pa of 130 are 1.9 % of V
    assert sigma["V"] == pytest.approx(0.5 * 14.87 * np.hypot(5 / 130, 1.5 / 295.6), rel=0.02)
    # two elevons of 0.01 rad each, averaged
    assert sigma["delta_e"] == pytest.approx(0.01 / np.sqrt(2), rel=0.01)


def test_noise_estimate_is_that_of_the_samples(
    make_scans: MakeScans, nominal: CalibrationSet, rng: np.random.Generator
) -> None:
    flight = calibrate(
        make_scans(800, lambda t: {"p": 0.5 * np.sin(3 * t) + 0.01 * rng.standard_normal()}), nominal, align=False
    )
    assert flight.provenance.detail["noise"]["p"] == pytest.approx(0.01, rel=0.15)


def same_columns(one: Flight, other: Flight) -> bool:
    return all(np.array_equal(one[c], other[c], equal_nan=True) for c in one.columns)


def busy(t: float) -> dict[str, float]:
    return {"p": np.sin(3 * t), "q": 0.3 * np.cos(2 * t), "r": 0.4 * np.sin(2.2 * t), "alpha": 0.1 + 0.05 * np.sin(4 * t),
            "beta": 0.1 * np.cos(3 * t), "left": 0.1 * np.sin(6 * t), "right": -0.05 * np.sin(5 * t), "q_c": 130 + 20 * np.sin(t),
            "phi": np.sin(t), "theta": 0.2 * np.cos(t), "psi": 3.0 * np.sin(0.7 * t), "die_c": 30 + t}  # fmt: skip


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(keep=st.lists(st.integers(0, 119), min_size=2, max_size=70, unique=True))
def test_a_sample_does_not_depend_on_its_company(
    make_scans: MakeScans, nominal: CalibrationSet, keep: Sequence[int]
) -> None:
    """Unaligned, any part of the scans gives the same bits as the whole: telemetry equals the recording where both exist."""
    scans = make_scans(120, busy)
    whole = calibrate(scans, nominal, align=False)
    rows = sorted(keep)
    part = calibrate([scans[i] for i in rows], nominal, align=False)
    for column in whole.columns:
        np.testing.assert_array_equal(part[column], whole[column][rows])


def test_live_sample_equals_the_recorded_row(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    scans = make_scans(30, busy)
    whole = calibrate(scans, nominal, align=False)
    live = Calibrator(nominal)
    for i in (0, 7, 29):
        assert live.sample(scans[i]) == {c: v[i] for c, v in whole.columns.items() if np.isfinite(v[i])}


def test_built_in_set_is_complete() -> None:
    full = load_calibration("cdfp")
    assert {"accelerometer", "gyro", "magnetometer", "alpha_vane", "beta_vane", "pitot", "static", "mixing"} <= set(
        full.instruments
    )


def test_nothing_to_calibrate_is_said(nominal: CalibrationSet, make_scans: MakeScans) -> None:
    with pytest.raises(CalibrationError, match="no scans"):
        calibrate([], nominal)
    with pytest.raises(CalibrationError, match="only one scan"):
        calibrate(make_scans(1), nominal)


def test_ratiometric_sensor_without_a_supply_file_is_an_error(make_scans: MakeScans, nominal: CalibrationSet) -> None:
    texts = {n: t for n, t in nominal.texts.items() if n != "sensor_supply.toml"}
    with pytest.raises(CalibrationError, match=r"sensor_supply\.toml"):
        calibrate(make_scans(3), CalibrationSet.from_texts("poor", texts))


def test_a_surface_by_its_pulse_is_behind_it_and_said_to_be_a_command(
    make_scans: MakeScans, nominal: CalibrationSet
) -> None:
    """Whoever times the pulses, here a co-processor without a sender's stamps: the servo of the file lags behind them."""
    rudder = load_calibration("autopilot").instruments["rudder"]
    by_pulse = replace(nominal, instruments={**nominal.instruments, "rudder": rudder})
    flight = calibrate(make_scans(80, lambda t: {"rudder": 0.1 if t > 11.99 else 0.0}), by_pulse)
    at = int(np.argmax(flight["delta_r"] > 1e-6))
    expected = 0.1 * (1.0 - np.exp(-(0.025 + 0.05 * np.arange(4)) / 0.035))
    np.testing.assert_allclose(flight["delta_r"][at : at + 4], expected, atol=4e-3)
    assert flight.held("delta_r") == pytest.approx(0.05)
    assert flight.dated_back("delta_r") == pytest.approx(0.025)
    assert flight.held("delta_e") is None
