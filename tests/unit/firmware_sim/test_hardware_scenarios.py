"""The hardware tables of the built-in scenarios, and the text form that configurations are written in."""

import math
import tomllib
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim.hardware.faults import Kind, parse_faults
from firmware_sim.hardware.radio import RadioModel
from firmware_sim.hardware.sensing.sensor_models import parse_sensors
from firmware_sim.tables import checked, toml_text
from firmware_sim.world.scenario import built_in_scenarios, load_scenario

_KEYS = st.text(min_size=1, max_size=8)
_PLAIN = st.one_of(
    st.booleans(),
    st.integers(-(2**62), 2**62),
    st.floats(allow_nan=False),
    st.text(max_size=12),
    st.lists(st.integers(-9, 9), max_size=3),
)
_TABLES = st.recursive(
    st.dictionaries(_KEYS, _PLAIN, max_size=4),
    lambda inner: st.dictionaries(_KEYS, st.one_of(_PLAIN, inner, st.lists(inner, min_size=1, max_size=2)), max_size=4),
    max_leaves=12,
)


@given(_TABLES)
def test_text_reads_back_to_the_same_table(table: dict[str, object]) -> None:
    assert tomllib.loads(toml_text(table)) == table


def test_what_has_no_equal_in_itself() -> None:
    assert math.isnan(tomllib.loads(toml_text({"a": math.nan}))["a"])
    assert tomllib.loads(toml_text({"a": None, "b": {"c": None}})) == {"b": {}}


@pytest.mark.parametrize("name", sorted(built_in_scenarios()))
def test_hardware_tables_of_the_built_in_scenarios(name: str) -> None:
    scenario = load_scenario(name)
    parse_sensors(scenario.sensors, name)
    checked(RadioModel, scenario.radio, name, "radio")
    for fault in parse_faults(scenario.faults, name):
        assert fault.start_s < scenario.total_s


def test_a_scenario_for_each_kind_of_fault() -> None:
    kinds = {kind for family in get_args(Kind) for kind in get_args(family) or (family,)} - {"sd_slow"}
    assert kinds
    shown = {f["kind"] for name in built_in_scenarios() for f in load_scenario(name).faults}
    assert kinds <= shown
