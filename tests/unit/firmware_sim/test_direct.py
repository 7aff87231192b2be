"""The short sensor model, and agreement of the simulated aircraft with the postulated models of the laboratory."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.contract.channels import COLUMN_BY_NAME
from estimation import load_model, output_error, simulate
from estimation.prepare.flight_data import Preparation
from firmware_sim.runs.direct import DIRECT_COLUMNS, DirectNoise, direct_flights, measured, write_csv
from firmware_sim.world.scenario import Scenario, load_scenario, scenario_from
from firmware_sim.world.simulation import derivatives_of
from firmware_sim.world.world import simulate_many
from groundstation.flight import Flight, read_flight

SILENT = DirectNoise(scale=0.0)
WELL_EXCITED = ("CY_beta", "CY_dr", "Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "Cn_r", "Cn_dr")


def as_flight(columns: dict[str, np.ndarray], name: str = "simulated") -> Flight:
    """Columns as the laboratory takes them."""
    values = {k: v for k, v in columns.items() if k != "time"}
    return Flight(name, columns["time"], values, np.zeros(len(columns["time"]), dtype=np.int64))


def calm(**flight: object) -> Scenario:
    """Rich manoeuvres in still air."""
    return scenario_from({"flight": {"manoeuvres": "rich", **flight}}, "calm")


def test_noise_has_the_stated_level_on_every_channel_and_nothing_else_is_changed() -> None:
    (truth,) = simulate_many([calm(duration_s=20.0)], [3])
    noise = DirectNoise()
    samples = [measured(truth, seed, noise) for seed in range(20)]
    for name in ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "V"):
        errors = np.concatenate([s[name] - truth[name] for s in samples])
        assert np.std(errors) == pytest.approx(getattr(noise, name), rel=0.05), name
        assert abs(np.mean(errors)) < 4.0 * getattr(noise, name) / np.sqrt(errors.size), name
    surfaces = np.concatenate([s["delta_a"] - truth["delta_a"] for s in samples])
    assert np.std(surfaces) == pytest.approx(noise.surfaces, rel=0.05)
    quiet = measured(truth, 1, SILENT)
    for name in DIRECT_COLUMNS:
        np.testing.assert_allclose(quiet[name], truth[name], atol=1e-12, err_msg=name)


def test_columns_are_flight_columns_and_the_file_is_read_as_a_flight(tmp_path: Path) -> None:
    assert set(DIRECT_COLUMNS) - {"time"} <= set(COLUMN_BY_NAME)
    (columns,) = direct_flights([calm(duration_s=5.0)], [2])
    write_csv(tmp_path / "flight.csv", columns)
    flight = read_flight(tmp_path / "flight.csv")
    np.testing.assert_allclose(flight.columns["beta"], columns["beta"], rtol=1e-8, atol=1e-12)


def test_same_seed_same_measurements() -> None:
    one, same, other = (direct_flights([calm(duration_s=4.0)], [seed])[0] for seed in (5, 5, 6))
    assert np.array_equal(one["p"], same["p"])
    assert not np.array_equal(one["p"], other["p"])


def test_small_motion_is_that_of_the_lateral_model_with_the_same_derivatives() -> None:
    """The six-degree-of-freedom truth and the laboratory's lateral model, written apart, fly the same path."""
    scenario = calm(duration_s=12.0)
    scenario = scenario.altered(
        manoeuvre=[
            {"axis": "aileron", "shape": "doublet", "start_s": 1.0, "amplitude": 1.0, "width_s": 0.7},
            {"axis": "rudder", "shape": "doublet", "start_s": 5.0, "amplitude": 1.0, "width_s": 0.8},
        ]
    )
    (columns,) = direct_flights([scenario], [2], DirectNoise(scale=0.01), rate_hz=200.0)
    model = load_model("lateral", "cdfp")
    truth = derivatives_of(scenario)
    values = {name: truth[name] for name in model.starts() if name in truth}
    assert len(values) >= 16
    flown = simulate(model, as_flight(columns), values, preparation=Preparation(denoise=False), compile_="never")
    for name, column in zip([o.name for o in model.outputs], flown.T, strict=True):
        if name in columns:
            scale = np.std(columns[name])
            assert np.sqrt(np.mean((column - columns[name]) ** 2)) < 0.01 * scale, name


def test_the_laboratory_recovers_the_derivatives_flown() -> None:
    scenario = load_scenario("rich").altered(
        flight={"derivative_scatter": 0.15, "derivative_seed": 9}, wind={"gust_deg": 0.05}
    )
    flights = direct_flights([scenario, scenario.altered(flight={"speed_m_s": 15.0})], [21, 22])
    result = output_error(load_model("lateral", "cdfp"), [as_flight(f, f"f{i}") for i, f in enumerate(flights)])
    truth = derivatives_of(scenario)
    for name in WELL_EXCITED:
        estimate = result.parameters[name]
        assert abs(estimate.estimate - truth[name]) < 4.0 * estimate.std_coloured, name
        assert abs(estimate.estimate / truth[name] - 1.0) < 0.10, name


def test_a_hidden_effect_reaches_the_measurements() -> None:
    base = calm(duration_s=8.0)
    plain, lagging = direct_flights([base, base.altered(hidden=[{"name": "beta_lag"}])], [4, 4], SILENT)
    assert np.abs(plain["beta"] - lagging["beta"]).max() > 0.01
    assert np.abs(plain["p"] - lagging["p"]).max() < 1e-9


def test_noise_can_be_set_channel_by_channel() -> None:
    (columns,) = direct_flights([calm(duration_s=4.0)], [4], replace(SILENT, scale=1.0, beta=0.0, V=0.0))
    (silent,) = direct_flights([calm(duration_s=4.0)], [4], SILENT)
    assert np.array_equal(columns["beta"], silent["beta"])
    assert not np.array_equal(columns["p"], silent["p"])
