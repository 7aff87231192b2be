"""Air data of aircraft without vanes against the truth of simulated flights, and the smoother against the joint distribution."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from estimation.compatibility.air_data import AIR, AirData, airspeed_of, reconstruct_air, with_air
from estimation.compatibility.air_filter import STATES, Assumptions, Nodes, Noise, _Chain
from estimation.compatibility.air_nodes import _earlier, fresh_samples
from estimation.errors import DataError
from firmware_sim.runs.direct import measured
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.world import simulate_many
from groundstation.flight import RECONSTRUCTED, Flight, MissingColumnError, read_flight, write_flight
from sideslip.verbs.reconstruct import reconstruct

Columns = dict[str, np.ndarray]
FIX_EVERY = 4  # samples: GNSS at 5 Hz beside the 20 Hz of the rest
FIX_NOISE = {"vn": 0.15, "ve": 0.15, "vd": 0.25}


COUNT = 4
GUSTS_DEG = (0.5, 2.0)


@pytest.fixture(scope="module")
def flown() -> list[list[Columns]]:
    """Truth of flights in 4 m/s of wind from all around, in light and in strong gusts."""
    base = load_scenario("rich")
    winds = [{"gust_deg": g, "speed_m_s": 4.0, "from_deg": 250.0 + 45.0 * i} for g in GUSTS_DEG for i in range(COUNT)]
    truths = simulate_many([base.altered(wind=w) for w in winds], list(range(COUNT)) * len(GUSTS_DEG), 20.0)
    return [truths[:COUNT], truths[COUNT:]]


def seen(truth: Mapping[str, np.ndarray], seed: int, *, hold: bool = False) -> Flight:
    """A flight without vanes: noise of the direct sensor model, velocity fixes interpolated or held between."""
    columns = measured(truth, seed)
    time = columns.pop("time")
    rng = np.random.default_rng([seed, 7])
    at = np.arange(0, time.size, FIX_EVERY)
    index = np.arange(time.size)
    for name, sigma in FIX_NOISE.items():
        values = truth[name][at] + sigma * rng.standard_normal(at.size)
        columns[name] = values[index // FIX_EVERY] if hold else np.interp(index, at, values)
    return Flight.build(f"s{seed}", time, {n: v for n, v in columns.items() if n not in ("alpha", "beta")})


def ratios(air: AirData, truth: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    error = (air.values[name] - truth[name]) / air.std[name]
    return error[np.isfinite(error)]


@pytest.fixture(scope="module")
def calm(flown: list[list[Columns]]) -> list[tuple[Columns, AirData]]:
    return [(t, reconstruct_air(seen(t, i))) for i, t in enumerate(flown[0])]


@pytest.fixture(scope="module")
def turbulent(flown: list[list[Columns]]) -> list[tuple[Columns, AirData]]:
    return [(t, reconstruct_air(seen(t, i))) for i, t in enumerate(flown[1])]


@pytest.mark.parametrize("air", ["calm", "turbulent"])
def test_errors_are_within_the_stated_uncertainty(air: str, request: pytest.FixtureRequest) -> None:
    """Of one flight an error is slow, so four flights are some dozens of draws: rms of a normal within 1.35."""
    flights = request.getfixturevalue(air)
    for name in AIR:
        z = np.concatenate([ratios(a, t, name) for t, a in flights])
        assert np.sqrt(np.mean(z**2)) < 1.35, name
        assert np.mean(np.abs(z) < 2.0) > 0.85, name
    wind = np.concatenate([(a.wind - true_wind(t)) / a.wind_std for t, a in flights])
    assert np.sqrt(np.mean(wind**2)) < 1.4


def true_wind(truth: Mapping[str, np.ndarray]) -> np.ndarray:
    """Mean of what is left of the velocity over the ground without that through the air, gusts averaged."""
    phi, theta, psi = truth["phi"], truth["theta"], truth["psi"]
    u = truth["V"] * np.cos(truth["alpha"]) * np.cos(truth["beta"])
    v, w = truth["V"] * np.sin(truth["beta"]), truth["V"] * np.sin(truth["alpha"]) * np.cos(truth["beta"])
    v, w = v * np.cos(phi) - w * np.sin(phi), v * np.sin(phi) + w * np.cos(phi)
    u, w = u * np.cos(theta) + w * np.sin(theta), -u * np.sin(theta) + w * np.cos(theta)
    u, v = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
    return np.array([np.mean(truth[n] - c) for n, c in (("vn", u), ("ve", v), ("vd", w))])


def test_the_uncertainty_says_something_and_grows_with_the_gusts(
    calm: list[tuple[Columns, AirData]], turbulent: list[tuple[Columns, AirData]]
) -> None:
    for (_, quiet), (_, rough) in zip(calm, turbulent, strict=True):
        assert quiet.typical("alpha") < np.radians(1.3)
        assert quiet.typical("beta") < np.radians(1.3)
        assert quiet.typical("V") < 0.6
        assert rough.gust > 2.0 * quiet.gust
        assert rough.typical("beta") > 1.3 * quiet.typical("beta")


def test_the_motion_of_the_angles_is_seen_better_than_their_level(calm: list[tuple[Columns, AirData]]) -> None:
    """What an estimate lives on: within a manoeuvre sideslip is right to a fraction of its motion."""
    for truth, air in calm:
        error = air.values["beta"] - truth["beta"]
        assert np.std(error) < 0.35 * np.std(truth["beta"])


def test_a_pitot_that_reads_high_and_a_biased_imu_stay_within(calm: list[tuple[Columns, AirData]]) -> None:
    z = []
    for i, (truth, _) in enumerate(calm[:3]):
        flight = seen(truth, i)
        flight = flight.with_columns(V=1.03 * flight["V"], ay=flight["ay"] + 0.08, q=flight["q"] + 0.003)
        air = reconstruct_air(flight)
        z.append([np.sqrt(np.mean(ratios(air, truth, n) ** 2)) for n in AIR])
    assert np.max(np.sqrt(np.mean(np.square(z), axis=0))) < 1.6


def test_held_fixes_count_once(calm: list[tuple[Columns, AirData]]) -> None:
    truth, _ = calm[0]
    held = seen(truth, 0, hold=True)
    assert 0.8 < fresh_samples(held, ("vn", "ve", "vd")).sum() * FIX_EVERY / len(held) < 1.2
    assert fresh_samples(seen(truth, 0), ("vn", "ve", "vd")).sum() * FIX_EVERY / len(held) < 1.2
    air = reconstruct_air(held)
    assert np.sqrt(np.mean(ratios(air, truth, "beta") ** 2)) < 2.0


def test_airspeed_from_dynamic_pressure_or_calibrated_airspeed(calm: list[tuple[Columns, AirData]]) -> None:
    truth, _ = calm[0]
    flight = seen(truth, 0)
    bare = replace(flight, columns={n: v for n, v in flight.columns.items() if n != "V"})
    pressure = bare.with_columns(p_dynamic=truth["p_dynamic"])
    np.testing.assert_allclose(airspeed_of(pressure)[0], truth["V"], rtol=1e-3)
    calibrated = bare.with_columns(V_cas=truth["V"] * np.sqrt(truth["rho"] / 1.225))
    np.testing.assert_allclose(airspeed_of(calibrated)[0], truth["V"], rtol=1e-9)
    with pytest.raises(DataError, match=r"no airspeed \(V, p_dynamic or V_cas\)"):
        reconstruct_air(bare)


def test_what_is_missing_is_named(calm: list[tuple[Columns, AirData]]) -> None:
    flight = seen(calm[0][0], 0)
    bare = replace(flight, columns={n: v for n, v in flight.columns.items() if n not in ("ve", "psi")})
    with pytest.raises(MissingColumnError, match="psi, ve"):
        reconstruct_air(bare)
    with pytest.raises(DataError, match="nothing to reconstruct"):
        reconstruct_air(flight.with_columns(V=np.full(len(flight), 2.0)))  # on the ground


def test_a_gap_is_bridged_by_the_wind_only(calm: list[tuple[Columns, AirData]]) -> None:
    truth, whole = calm[0]
    flight = seen(truth, 0)
    keep = (flight.time < 12.0) | (flight.time > 16.0)
    parted = Flight.build("parted", flight.time[keep], {n: v[keep] for n, v in flight.columns.items()})
    assert len(parted.segments) == 2
    air = reconstruct_air(parted)
    assert np.isfinite(air.values["beta"]).all()
    for name in AIR:
        z = (air.values[name] - truth[name][keep]) / air.std[name]
        assert np.sqrt(np.mean(z**2)) < 2.0
    assert air.typical("beta") < 1.5 * whole.typical("beta")


def test_vanes_stay_and_the_verb_writes_what_it_says(tmp_path: Path, calm: list[tuple[Columns, AirData]]) -> None:
    truth, _ = calm[0]
    flight = seen(truth, 0).with_columns(alpha=truth["alpha"])
    write_flight(flight, tmp_path / "log.mcap")
    words = [str(tmp_path / "log.mcap"), "-o", str(tmp_path / "air.mcap"), "--json", str(tmp_path / "air.json")]
    done = CliRunner().invoke(reconstruct, words, catch_exceptions=False)
    assert done.exit_code == 0
    assert "alpha measured by a vane: kept as measured" in done.output
    again = read_flight(tmp_path / "air.mcap")
    np.testing.assert_array_equal(again["alpha"], truth["alpha"])
    np.testing.assert_array_equal(again["V_measured"], flight["V"])
    assert np.isfinite(again["beta_std"]).all()
    told = again.provenance.detail
    assert told[RECONSTRUCTED]["columns"] == ["beta", "V"]
    assert told["uncertainty"]["beta"] == pytest.approx(np.sqrt(np.mean(again["beta_std"] ** 2)))
    assert any("moves every derivative by" in n.text for n in again.notes)
    assert any("estimate with ml" in n.text for n in again.notes)


def test_an_airspeed_that_comes_late_is_no_vertical_wind(flown: list[list[Columns]]) -> None:
    """0.3 s late it was one of 0.3 g: an aircraft that descends gains speed."""
    for seed, truth in enumerate(flown[0][:2]):
        flight = seen(truth, seed)
        late = flight.with_columns(V=np.interp(flight.time - 0.3, flight.time, flight["V"]))
        air, prompt = reconstruct_air(late), reconstruct_air(flight)
        assert abs(air.wind[2] - prompt.wind[2]) < 0.3
        error = air.values["alpha"] - truth["alpha"]
        assert abs(np.nanmean(error)) < np.radians(1.5)


def test_a_fix_of_before_is_held_against_the_motion_of_before() -> None:
    time = np.arange(0.0, 2.0, 0.02)
    velocity = np.column_stack([np.sin(3.0 * time), np.cos(3.0 * time), time])
    earlier = _earlier(velocity, time, 0.1)
    np.testing.assert_allclose(earlier[10:], velocity[5:-5], atol=1e-12)
    assert _earlier(velocity, time, 0.0) is velocity


def test_columns_that_are_added_leave_the_flight_as_it_was(calm: list[tuple[Columns, AirData]]) -> None:
    flight = seen(calm[0][0], 0)
    made = with_air(flight, calm[0][1])
    assert "beta" not in flight
    np.testing.assert_array_equal(made["p"], flight["p"])


def test_filter_and_smoother_agree_with_the_joint_distribution() -> None:
    """All states of all nodes as one normal distribution, conditioned on all measurements at once."""
    rng = np.random.default_rng(4)
    count = 7
    axes = np.array([np.linalg.qr(rng.standard_normal((3, 3)))[0] for _ in range(count)])

    def stretch(first: int, last: int) -> Nodes:
        n, about = last - first, np.array([15.0, 2.0, 0.5])
        fix = rng.standard_normal((n, 3))
        fix[1] = np.nan
        axis = axes[first:last]
        return Nodes(
            time=0.2 * np.arange(first, last) + (3.0 if first else 0.0),
            velocity=about + rng.standard_normal((n, 3)),
            mean_velocity=about + rng.standard_normal((n, 3)),
            axes=axis,
            force=rng.standard_normal((n, 3)),
            turn=0.2 * axis,
            acceleration=rng.standard_normal((n, 3)),
            speed_acceleration=rng.standard_normal((n, 3)),
            fix=fix,
            fixes=np.array([1.0, 0.0] + [1.0] * (n - 2)),
            airspeed=15.0 + rng.standard_normal(n),
        )

    noise = Noise(force=0.1, airspeed=0.2, level=0.01, heading=0.03)
    chain = _Chain([stretch(0, 4), stretch(4, count)], noise, 0.4, Assumptions(), np.array([2.0, 1.0, 0.0]))
    about = np.array([13.0, 1.0, 0.5]) + 0.3 * rng.standard_normal((count, 3))
    found = chain.run(about)
    x, P = chain._start()
    means, blocks = [x], {(0, 0): P}
    for k in range(1, count):
        means.append(chain._phi[k] @ means[-1])
        for j in range(k):
            blocks[k, j] = chain._phi[k] @ blocks[k - 1, j]
        blocks[k, k] = chain._phi[k] @ blocks[k - 1, k - 1] @ chain._phi[k].T + chain._q[k]
    joint = np.block([[blocks[i, j] if i >= j else blocks[j, i].T for j in range(count)] for i in range(count)])
    rows, values, variances = [], [], []
    for k in range(count):
        for _, value, row, variance in chain._measurements(k, about[k]):
            wide = np.zeros(count * STATES)
            wide[k * STATES : (k + 1) * STATES] = row
            rows.append(wide)
            values.append(value)
            variances.append(variance)
    H, mean = np.array(rows), np.concatenate(means)
    gain = joint @ H.T @ np.linalg.inv(H @ joint @ H.T + np.diag(variances))
    expected = (mean + gain @ (np.array(values) - H @ mean)).reshape(count, STATES)
    np.testing.assert_allclose(found.states, expected, atol=2e-6)
    left = joint - gain @ H @ joint
    for k in range(count):
        block = left[k * STATES : (k + 1) * STATES, k * STATES : (k + 1) * STATES]
        np.testing.assert_allclose(found.covariances[k], block, atol=2e-6)


def test_density_of_altitude_counts_a_measured_temperature_unless_it_is_a_board_s() -> None:
    from estimation.prepare.columns import with_derived

    time = np.arange(40) / 20
    columns = {"altitude": np.full(40, 300.0)}
    pressure = 101325.0 * (288.15 - 0.0065 * 300.0) ** 5.255876 / 288.15**5.255876
    for temperature, used in ((298.0, 298.0), (273.0, 273.0), (330.0, 288.15 - 0.0065 * 300.0)):
        flight = Flight.build("f", time, columns | {"temperature": np.full(40, temperature)})
        made = with_derived(flight, ["rho"])["rho"]
        assert made == pytest.approx(pressure / (287.053 * used), rel=1e-4)


def test_a_segment_without_altitude_has_no_density_and_the_others_have() -> None:
    from estimation.prepare.columns import with_derived

    time = np.arange(80) / 20
    segment = np.repeat([0, 1], 40)
    altitude = np.where(segment == 0, 300.0, np.nan)
    speed = np.where(segment == 0, 15.0 + np.sin(time), np.nan)
    flight = with_derived(
        Flight.build("f", time, {"altitude": altitude, "V": speed}, segment=segment), ["rho", "V_dot"]
    )
    for column in ("rho", "V_dot"):
        assert np.isfinite(flight[column][segment == 0]).all()
        assert np.isnan(flight[column][segment == 1]).all()
