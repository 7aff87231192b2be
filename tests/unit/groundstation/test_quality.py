"""Each check of the quality report against a flight in which exactly that is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from groundstation.flight import Flight, Provenance
from groundstation.flight.findings import Finding, worst
from groundstation.flight.quality.plausibility import suspicions
from groundstation.flight.quality.report import quality_report

Columns = dict[str, np.ndarray]


@pytest.fixture
def sound(rng: np.random.Generator) -> Columns:
    """40 s of sound flight: attitude is the integral of the rates, surfaces follow their commands by 40 ms."""
    t = np.arange(800) * 0.05

    def attitude(at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return 0.3 * np.sin(1.3 * at), 0.08 + 0.15 * np.sin(1.1 * at), 0.4 * np.sin(0.8 * at)

    phi, theta, psi = attitude(t)
    phi_dot, theta_dot, psi_dot = 0.39 * np.cos(1.3 * t), 0.165 * np.cos(1.1 * t), 0.32 * np.cos(0.8 * t)
    p = phi_dot - psi_dot * np.sin(theta)
    q = theta_dot * np.cos(phi) + psi_dot * np.cos(theta) * np.sin(phi)
    r = psi_dot * np.cos(theta) * np.cos(phi) - theta_dot * np.sin(phi)

    def pulses(at: np.ndarray, start: float) -> np.ndarray:
        late = at - start
        return 0.1 * ((late > 0) & (late < 1)) - 0.1 * ((late > 1) & (late < 2))

    def control(at: np.ndarray, start: float) -> np.ndarray:
        return pulses(at, start) + pulses(at, start + 15)

    noise = rng.standard_normal
    return {
        "time": t, "ax": 0.5 + 0.05 * noise(800), "ay": 0.5 * np.sin(t) + 0.05 * noise(800), "az": -9.8 + 0.08 * noise(800),
        "p": p + 0.007 * noise(800), "q": q + 0.007 * noise(800), "r": r + 0.005 * noise(800),
        "phi": phi + 0.003 * noise(800), "theta": theta + 0.003 * noise(800), "psi": psi + 0.003 * noise(800),
        "alpha": 0.09 + 0.03 * np.sin(t) + 0.005 * noise(800), "beta": 0.05 * np.sin(2 * t) + 0.004 * noise(800),
        "V": 16 + np.sin(0.5 * t) + 0.15 * noise(800),
        **{f"delta_{x}": control(t - 0.04, s) + 0.001 * noise(800) for x, s in (("a", 3.0), ("r", 8.0), ("e", 12.0))},
        **{f"cmd_{x}": control(t, s) for x, s in (("a", 3.0), ("r", 8.0), ("e", 12.0))},
    }  # fmt: skip


def build(columns: Columns, **detail: object) -> Flight:
    data = dict(columns)
    return Flight.build("test", data.pop("time"), data, provenance=Provenance(detail=detail))


def finding(flight: Flight, check: str) -> Finding:
    return next(f for f in quality_report(flight) if f.kind == check)


def test_a_sound_flight_passes_every_check(sound: Columns) -> None:
    report = quality_report(build(sound))
    assert [f.kind for f in report if f.severity != "ok"] == []
    assert worst(report) == "ok"
    assert len({f.kind for f in report}) == len(report) == 12
    assert all(f.text and not f.text.endswith(".") for f in report)


def test_a_jump_in_time_is_reported_and_splits(sound: Columns) -> None:
    sound["time"] = sound["time"] + np.where(sound["time"] > 20, 30.0, 0.0)
    found = finding(build(sound), "time gaps")
    assert found.severity == "fail"  # 30 of 70 s are missing
    assert "30" in found.text
    short = build(
        {k: np.delete(v, slice(400, 420)) for k, v in sound.items()}
        | {"time": np.delete(np.arange(800) * 0.05, slice(400, 420))}
    )
    assert finding(short, "time gaps").severity == "warn"
    assert len(short.segments) == 2


def test_single_missing_samples_and_jitter(sound: Columns, rng: np.random.Generator) -> None:
    keep = np.ones(800, bool)
    keep[rng.choice(np.arange(10, 790, 3), 60, replace=False)] = False
    assert "missing" in finding(build({k: v[keep] for k, v in sound.items()}), "sample interval").text
    sound["time"] = sound["time"] + 0.01 * rng.uniform(-1, 1, 800)
    assert finding(build(sound), "sample interval").severity == "warn"


def test_unsorted_and_repeated_rows(sound: Columns) -> None:
    sound["time"][[100, 101]] = sound["time"][[101, 100]]
    assert "backwards" in finding(build(sound), "time order").text
    sound["time"] = np.arange(800) * 0.05
    sound["time"][300] = sound["time"][299]
    assert "repeated" in finding(build(sound), "time order").text


def test_dropout_inside_is_reported_and_a_late_start_is_not(sound: Columns) -> None:
    sound["beta"][:40] = np.nan
    assert finding(build(sound), "dropouts").severity == "ok"
    assert "2.00 s at the start" in finding(build(sound), "dropouts").text
    sound["beta"][200:230] = np.nan
    found = finding(build(sound), "dropouts")
    assert (found.severity, "30 in a row" in found.text) == ("warn", True)
    sound["beta"][100:500] = np.nan
    assert finding(build(sound), "dropouts").severity == "fail"


def test_a_channel_that_never_moves_fails(sound: Columns) -> None:
    sound["ay"] = np.zeros(800)
    found = finding(build(sound), "stale samples")
    assert (found.severity, "ay is 0 throughout" in found.text) == ("fail", True)


def test_a_channel_in_another_unit_fails_with_a_hint(sound: Columns) -> None:
    sound["p"] = np.degrees(sound["p"])
    found = finding(build(sound), "plausible values")
    assert found.severity == "fail"
    assert "is p in deg/s?" in found.text


def test_stale_channel(sound: Columns) -> None:
    sound["beta"] = np.repeat(sound["beta"][::4], 4)
    found = finding(build(sound), "stale samples")
    assert found.severity == "warn"
    assert "beta repeats 75%" in found.text
    assert "about 4.98 Hz" in found.text


def test_stuck_channel(sound: Columns) -> None:
    sound["V"][300:400] = sound["V"][300]
    assert "V stands still for 5" in finding(build(sound), "stale samples").text or "V stands still for 4.9" in (
        finding(build(sound), "stale samples").text
    )


def test_clipping(sound: Columns) -> None:
    sound["p"] = np.clip(sound["p"], -0.3, 0.3)
    assert "p stays at its largest value 0.3" in finding(build(sound), "clipping").text
    assert "gyro_x: 7 samples" in finding(build(sound, clipped={"gyro_x": 7}), "clipping").text


def test_spikes_are_found_and_edges_are_not(sound: Columns) -> None:
    sound["alpha"][250] += 0.5
    sound["q"][[400, 500]] -= 2.0
    found = finding(build(sound), "spikes")
    assert "alpha: 1 single wild" in found.text
    assert "q: 2 single wild" in found.text
    assert "t = 12.50 s" in found.text


def test_implausible_values(sound: Columns) -> None:
    for axis in ("ax", "ay", "az"):
        sound[axis] = sound[axis] / 9.80665
    assert finding(build(sound), "plausible values").severity == "fail"


def circling(columns: Columns, rate: float) -> Columns:
    """The flight turning on at `rate` [rad/s] besides, its heading not wrapped."""
    psi = columns["psi"] + rate * columns["time"]
    p = columns["p"] - rate * np.sin(columns["theta"])
    q = columns["q"] + rate * np.cos(columns["theta"]) * np.sin(columns["phi"])
    r = columns["r"] + rate * np.cos(columns["theta"]) * np.cos(columns["phi"])
    return {**columns, "psi": psi, "p": p, "q": q, "r": r}


@pytest.mark.parametrize("rate", [-0.12, -0.6, 0.45])
def test_a_heading_that_runs_on_is_taken_as_it_is(sound: Columns, rate: float) -> None:
    turned = circling(sound, rate)
    assert np.abs(turned["psi"]).max() > 3.5
    assert not [s for s in suspicions(turned["time"], turned) if "psi" in s.columns]
    assert "psi" not in finding(build(turned), "plausible values").text


def test_a_heading_in_degrees_does_not_pass_for_one_that_runs_on(sound: Columns) -> None:
    turned = circling(sound, -0.12)
    degrees = {**turned, "psi": np.degrees(turned["psi"])}
    assert any("psi" in s.columns and "deg" in s.text for s in suspicions(turned["time"], degrees))
    gyroless = {n: v for n, v in turned.items() if n not in ("p", "q", "r")}
    assert any("psi" in s.columns for s in suspicions(turned["time"], gyroless))


def test_a_jet_at_cruise_is_plausible() -> None:
    n, rho, V = 200, 0.365, 230.0
    level = {
        "ax": 0.3,
        "ay": 0.0,
        "az": -9.8,
        "V": V,
        "rho": rho,
        "p_dynamic": 0.5 * rho * V**2,
        "vn": V,
        "ve": 0.0,
        "vd": 0.0,
    }
    height = {
        "p_static": 22_700.0,
        "temperature": 217.0,
        "altitude": 11_000.0,
        "altitude_gnss": 11_050.0,
        "thrust": 60_000.0,
    }
    columns = {name: np.full(n, value) for name, value in {**level, **height}.items()}
    assert suspicions(np.arange(n) / 20, columns) == []
    assert finding(build({"time": np.arange(n) / 20, **columns}), "plausible values").severity == "ok"
    for name, factor in (("p_static", 1e-2), ("altitude", 1 / 0.3048), ("rho", 1e3), ("az", -1.0)):
        (found,) = suspicions(np.arange(n) / 20, {**columns, name: factor * columns[name]})
        assert found.columns == (name,)
        assert found.text.startswith(f"{name}: ")


def test_extrapolated_calibration(sound: Columns) -> None:
    assert finding(build(sound, extrapolated={"alpha_vane": 3}), "calibrated range").severity == "ok"
    assert "alpha_vane: 90" in finding(build(sound, extrapolated={"alpha_vane": 90}), "calibrated range").text


@pytest.mark.parametrize("late", [0.06, -0.04])
def test_time_skew_of_the_attitude(sound: Columns, late: float) -> None:
    t = sound["time"]
    sound["phi"] = np.interp(t - late, t, sound["phi"])
    found = finding(build(sound), "time skew")
    assert found.severity == "warn"
    assert f"phi {'lags' if late > 0 else 'leads'} p by" in found.text
    assert abs(int(found.text.split(" by ", 1)[1].split(" ms", 1)[0]) - abs(late) * 1e3) <= 4


def test_surface_before_its_command(sound: Columns) -> None:
    t = sound["time"]
    sound["delta_a"] = np.interp(t + 0.1, t, sound["delta_a"])
    assert "which no servo does" in finding(build(sound), "time skew").text


def test_noise_against_the_sensor(sound: Columns, rng: np.random.Generator) -> None:
    sound["ay"] = sound["ay"] + 0.5 * rng.standard_normal(800)
    found = finding(build(sound), "noise")
    assert found.severity == "warn"
    assert "10 times" in found.text
    assert finding(build(sound, sensor_noise={"ay": 0.4}), "noise").severity == "ok"


def test_excitation(sound: Columns, rng: np.random.Generator) -> None:
    assert "delta_a 2 manoeuvres" in finding(build(sound), "excitation").text
    still = {**sound, "delta_r": 0.002 * np.sin(sound["time"])}
    assert "delta_r is hardly moved" in finding(build(still), "excitation").text
    small = 0.008 * np.sign(np.sin(2.0 * sound["time"])) + 2e-4 * rng.standard_normal(800)
    assert finding(build({**sound, "delta_e": small}), "excitation").severity == "ok", (
        "half a degree moves a large aeroplane"
    )
    coarse = small + 2e-3 * rng.standard_normal(800)
    assert "delta_e is hardly moved" in finding(build({**sound, "delta_e": coarse}), "excitation").text
    tied = {**sound, "delta_r": 0.5 * sound["delta_a"]}
    assert "move together (correlation +1.00)" in finding(build(tied), "excitation").text
    none = {k: v for k, v in sound.items() if not k.startswith(("delta", "cmd"))}
    assert "no control surface is measured" in finding(build(none), "excitation").text


def test_a_flight_with_next_to_nothing_still_gets_a_report() -> None:
    flight = Flight.build("bare", np.array([0.0, 0.05, 0.1]), {"V": np.array([15.0, np.nan, 15.1])})
    assert len(quality_report(flight)) == 12
    empty = replace(flight, columns={"V": np.full(3, np.nan)})
    assert len(quality_report(empty)) == 12
