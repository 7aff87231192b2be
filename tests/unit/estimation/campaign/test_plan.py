"""Every key of a plan is checked before any work: one sentence that names it."""

from pathlib import Path
from typing import Any

import pytest

from daq.utilities.errors import UserError
from estimation.campaign.keys import seed_of
from estimation.campaign.plan import CampaignPlan, plan_from
from estimation.campaign.sources import entries_of
from estimation.campaign.work_list import WorkList, work_list
from estimation.estimators.registry import find_estimator
from sideslip.cli import run
from sideslip.simulated import simulator
from tests.support.paths import ROOT

FLIGHT = str(ROOT / "recordings" / "foreign" / "ordinary_0.csv")


def checked(plan: CampaignPlan, folder: Path) -> WorkList:
    """All that happens before the first flight is estimated."""
    return work_list(plan, entries_of(plan, folder, simulator()), folder)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"bootstrap": 5}, "5 replicates make no bootstrap: at least 10"),
        ({"bootstrap": -1}, "^plan test: bootstrap: "),
        ({"bootstrap": 10**11}, "^plan test: bootstrap: "),
        ({"bootstrap": 20, "methods": ["ls"]}, "bootstrap is for methods ml, .*: add ml"),
        ({"methods": ["mll"]}, "methods: method 'mll' is unknown; .* did you mean ml"),
        ({"methods": [""]}, "methods: method '' is unknown"),
        ({"methods": []}, "^plan test: methods: "),
        ({"methods": ["ls"], "model": "nosuch"}, "model 'nosuch'"),
        ({"model": "nosuch.toml"}, "nosuch.toml: no such file"),
        ({"methods": ["ngn"], "model": "six-dof"}, "methods: model six-dof: Neural Gauss-Newton has"),
        ({"aircraft": "nosuch"}, "aircraft .*nosuch"),
        ({"groups": ["colour"]}, "groups.0"),
        ({"check": "fullest"}, "^plan test: check: "),
        ({"time_limit": 0}, "^plan test: time_limit: "),
        ({"time_limit": float("nan")}, "^plan test: time_limit: "),
        ({"time_limit": 1e300}, "^plan test: time_limit: "),
        ({"joint": 2}, "^plan test: joint: "),
        ({"seed": -1}, "^plan test: seed: "),
        ({"method": "ls"}, "^plan test: method: no such key; did you mean methods"),
        ({"flights": [""]}, "flights.0"),
        ({"table": "nosuch.csv"}, "nosuch.csv: no such table"),
        ({"flight": [{"path": "nosuch.csv", "aircraft": "nosuch"}]}, "aircraft .*nosuch"),
        ({"flight": [{"path": FLIGHT, "date": "2026-13-01"}]}, "flight.0.date: '2026-13-01' is no date; write"),
        ({"flight": [{"path": FLIGHT, "mass": 0}]}, "flight.0.mass"),
        ({"flight": [{"path": FLIGHT, "segments": "2-12"}]}, "flight.0.segments: .*begin:end"),
        ({"flight": [{"path": FLIGHT, "segments": "12:2"}]}, "flight.0.segments: .*begin:end"),
        ({"flight": [{"path": FLIGHT, "segments": "2:inf"}]}, "flight.0.segments: .*begin:end"),
        ({"flight": [{"path": FLIGHT, "segments": "2:8,5:9"}]}, "flight.0.segments: .*overlaps"),
        ({"flight": [{"path": FLIGHT, "colour": "red"}]}, "flight.0.colour: no such key"),
        ({"flight": [{"aircraft": "cdfp"}]}, "flight.0.path"),
    ],
)
def test_what_cannot_be_used_is_said_before_any_work(keys: dict[str, Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=said):
        checked(plan_from({"flights": [FLIGHT], "aircraft": "cdfp", **keys}, "test"), tmp_path)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"scenario": "quieter"}, "simulate.0: scenario 'quieter'.* did you mean quiet"),
        ({"count": 0}, "simulate.0.count"),
        ({"seed": -1}, "simulate.0.seed"),
        ({"aircraft": "nosuch"}, "aircraft .*nosuch"),
        ({"set": {"flight.duration": 3.0}}, "simulate.0: .*flight.duration"),
        ({"set": {"nosuch": 3.0}}, "simulate.0: .*nosuch"),
        ({"set": {"flight.aircraft": "nosuch"}}, "simulate.0: aircraft .*nosuch"),
        ({"set": {"derivatives.Cl_pp": -0.4}}, "simulate.0: derivatives.Cl_pp: no such derivative"),
        ({"set": {"hidden": [{"name": "nosuch"}]}}, "simulate.0: .*no effect named 'nosuch'"),
        ({"set": {"sensors.vane.noise": 1.0}}, "simulate.0: sensors.vane.noise: .*changes nothing"),
        ({"set": {"flight.seed": 3}}, "simulate.0: flight.seed: each flight has a seed of its own"),
        (
            {"set": {"flight": {"height_m": 50.0}, "flight.height_m": 60.0}},
            "simulate.0.set: flight.height_m is given twice",
        ),
        ({"vary": {"flight.speed": [13.0, 20.0]}}, "simulate.0: .*flight.speed"),
        ({"vary": {"derivatives.Cl_pp": [-0.4, -0.3]}}, "simulate.0: derivatives.Cl_pp"),
        ({"vary": {"flight.manoeuvres": [1.0, 2.0]}}, "simulate.0: .*flight.manoeuvres"),
        ({"vary": {"flight.speed_m_s": [13.0]}}, "simulate.0.vary.flight.speed_m_s"),
        ({"vary": {"flight.speed_m_s": [20.0, 13.0]}}, "simulate.0: .*begins above its end"),
        ({"vary": {"flight.speed_m_s": [13.0, float("inf")]}}, "simulate.0.vary.flight.speed_m_s"),
        ({"vary": {"flight.speed_m_s": [17.0, 90.0]}}, "simulate.0: .*90 is outside"),
        ({"vary": {"flight.speed_m_s": [15.0, 17.0]}, "set": {"flight.speed_m_s": 16.0}}, "both in set and in vary"),
    ],
)
def test_simulated_flights_are_checked_before_any_is_flown(keys: dict[str, Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=said):
        checked(plan_from({"simulate": [{"scenario": "quiet", "count": 2, **keys}]}, "test"), tmp_path)


def test_tables_and_dotted_keys_say_the_same() -> None:
    dotted, table = (
        plan_from(
            {"simulate": [{"scenario": "quiet", "set": keys, "vary": {"flight.speed_m_s": [14.0, 18.0]}}]}, "test"
        )
        for keys in ({"flight.duration_s": 20.0}, {"flight": {"duration_s": 20.0}})
    )
    assert dotted == table
    assert [e.source for e in entries_of(dotted, Path(), simulator())] == [
        e.source for e in entries_of(table, Path(), simulator())
    ]


def test_what_is_named_twice_is_done_once() -> None:
    plan = plan_from({"flights": [FLIGHT], "methods": ["ls", "ml", "ls"], "groups": ["day", "day"]}, "test")
    assert (plan.methods, plan.groups) == (("ls", "ml"), ("day",))


def test_the_command_refuses_with_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(f"flights = ['{FLIGHT}']\naircraft = 'cdfp'\nbootstrap = 5\n")
    with pytest.raises(SystemExit) as left:
        run(["campaign", str(plan), "--out", str(tmp_path / "out"), "--serial"], None)
    said = capsys.readouterr()
    assert (left.value.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert f"plan {plan}: 5 replicates make no bootstrap" in said.err
    assert not list((tmp_path / "out").glob("results/*"))


def test_the_seed_of_a_campaign_suits_a_network() -> None:
    pytest.importorskip("torch")
    from estimation.estimators.neural_gauss_newton.solve import generator_of

    seed = seed_of(0, "some flight", "ngn")
    assert 1000 * seed > 2**63  # as they are: it overflowed
    assert generator_of(seed, 0).initial_seed() != generator_of(seed, 1).initial_seed()
    assert generator_of(3, 1).initial_seed() == 3001
    assert find_estimator("ngn").needs_aircraft
