"""Scenario files: what they say, what they refuse, and that they survive being written."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.utilities.errors import UserError
from estimation.aircraft import load_aircraft
from firmware_sim.physics.aerodynamics import simulation_of
from firmware_sim.physics.effects.registry import EFFECTS
from firmware_sim.pilot.manoeuvres import MANOEUVRE_SETS, SHAPES, StickInput
from firmware_sim.tables import ScenarioError
from firmware_sim.world.scenario import Scenario, built_in_scenarios, load_scenario, scenario_from
from firmware_sim.world.simulation import derivatives_of, manoeuvres_of

CDFP = simulation_of(load_aircraft("cdfp")).derivatives


@pytest.mark.parametrize("name", sorted(built_in_scenarios()))
def test_built_in_scenarios_load_have_a_title_and_write_back(name: str, tmp_path: Path) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert len(scenario.title) > 10
    copy = tmp_path / f"{name}.toml"
    copy.write_text(scenario.toml(), encoding="utf-8")
    assert load_scenario(copy) == scenario


def test_the_four_published_flights_the_nominal_one_and_the_sets_are_built_in() -> None:
    names = set(built_in_scenarios())
    assert {
        "nominal",
        "cdfp_ld1",
        "cdfp_ld2",
        "cdfp_ld3",
        "cdfp_ld4",
        "rich",
        "aileron_only",
        "quiet",
        "gusty",
    } <= names


def test_every_effect_can_be_flown_by_its_name() -> None:
    for name in EFFECTS:
        scenario = load_scenario(f"hidden_{name}")
        assert [h.name for h in scenario.hidden] == [name]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[flight]\nspeed_m_s = 'fast'", "flight.speed_m_s"),
        ("[flight]\nspeed_m_s = 3.0", "flight.speed_m_s"),
        ("[flight]\nvelocity = 17.0", "flight.velocity"),
        ("[flight]\nmanoeuvres = 'loopings'", "loopings|no such set"),
        (
            "[[manoeuvre]]\naxis = 'flaps'\nshape = 'doublet'\nstart_s = 1.0\namplitude = 3.0\nwidth_s = 0.5",
            "manoeuvre.0.axis",
        ),
        (
            "[[manoeuvre]]\naxis = 'rudder'\nshape = 'multisine'\nstart_s = 1.0\namplitude = 3.0\nwidth_s = 9.0",
            "harmonics",
        ),
        ("[[hidden]]\nname = 'gremlins'", "gremlins"),
        ("[wind]\ngust_deg = -1.0", "wind.gust_deg"),
        ("[turbulence]\nlevel = 1.0", "turbulence"),
        ("[flight\nspeed_m_s = 17.0", "not a TOML file"),
    ],
)
def test_a_wrong_file_is_refused_in_one_sentence_naming_the_key(text: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=told) as caught:
        load_scenario(path)
    assert isinstance(caught.value, UserError)
    assert "wrong.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_name_lists_what_there_is() -> None:
    with pytest.raises(ScenarioError, match="nominal"):
        load_scenario("no_such_scenario")


def test_an_unknown_derivative_is_refused() -> None:
    with pytest.raises(ScenarioError, match="Cl_flap"):
        derivatives_of(scenario_from({"derivatives": {"Cl_flap": 1.0}}, "here"))


def test_truth_is_table_5_with_overrides_then_scatter_by_seed() -> None:
    plain = derivatives_of(Scenario())
    assert {name: plain[name] for name in CDFP} == CDFP
    other = derivatives_of(scenario_from({"derivatives": {"Cl_dr": 0.02}}, "here"))
    assert other["Cl_dr"] == 0.02
    scattered = scenario_from({"flight": {"derivative_scatter": 0.15}}, "here")
    one, two = derivatives_of(scattered, 1), derivatives_of(scattered, 2)
    ratios = [one[n] / plain[n] for n in CDFP if not n.endswith("_0")]
    assert all(0.85 <= ratio <= 1.15 for ratio in ratios)
    assert max(ratios) - min(ratios) > 0.05
    assert one != two
    same_aircraft = scattered.altered(flight={"derivative_seed": 7})
    assert derivatives_of(same_aircraft, 1) == derivatives_of(same_aircraft, 2)


def test_tables_of_other_parts_pass_through_untouched() -> None:
    data = {
        "sensors": {"imu": {"bias": [1, 2]}},
        "faults": [{"kind": "nack"}],
        "radio": {"drop": 0.05},
        "logger": {"x": 1},
    }
    scenario = scenario_from(data, "here")
    assert scenario.sensors == data["sensors"]
    assert list(scenario.faults) == data["faults"]
    assert scenario_from({**data}, "here") == scenario


class TestManoeuvres:
    @pytest.mark.parametrize("name", sorted(MANOEUVRE_SETS))
    def test_sets_fit_the_flight_and_differ_from_seed_to_seed(self, name: str) -> None:
        scenario = scenario_from({"flight": {"manoeuvres": name}}, "here")
        one, same, other = (manoeuvres_of(scenario, seed) for seed in (1, 1, 2))
        assert one == same
        assert all(m.start >= 0.0 and m.start + m.length <= 30.0 for m in one)
        if name != "none":
            assert one != other

    def test_a_3211_holds_its_steps_for_three_two_one_and_one_widths(self) -> None:
        m = StickInput("aileron", "3211", 1.0, 4.0, 0.5)
        time = np.arange(0.0, 6.0, 0.01) + 0.005
        values = m.values(time)
        edges = time[1:][np.abs(np.diff(values)) > 1e-9]
        np.testing.assert_allclose(edges, [1.0, 2.5, 3.5, 4.0, 4.5], atol=0.011)
        np.testing.assert_allclose(np.unique(values), [-4.0, 0.0, 4.0])

    @settings(max_examples=40, deadline=None)
    @given(
        shape=st.sampled_from([s for s in SHAPES if s != "multisine"]),
        start=st.floats(0.0, 5.0),
        amplitude=st.floats(-10.0, 10.0),
        width=st.floats(0.1, 3.0),
    )
    def test_nothing_is_flown_outside_nor_beyond_the_amplitude(
        self, shape: str, start: float, amplitude: float, width: float
    ) -> None:
        m = StickInput("rudder", shape, start, amplitude, width)  # type: ignore[arg-type]
        time = np.arange(-1.0, 40.0, 0.05)
        values = m.values(time)
        assert np.all(np.abs(values) <= abs(amplitude) + 1e-9)
        assert np.all(values[(time < start - 1e-9) | (time > start + m.length + 1e-9)] == 0.0)

    def test_multisines_of_two_axes_share_no_frequency(self) -> None:
        flown = manoeuvres_of(scenario_from({"flight": {"manoeuvres": "multisine"}}, "here"), 3)
        aileron, rudder = (m for m in flown)
        assert not set(aileron.harmonics) & set(rudder.harmonics)


def test_numbers_that_are_none_are_written_as_they_were_read(tmp_path: Path) -> None:
    file = tmp_path / "odd.toml"
    file.write_text("[flight]\nspeed_m_s = 17.0\n[logger.scan]\nx = [nan, inf, 1.0]\n")
    assert "nan" in load_scenario(str(file)).toml()
