"""What is done is not done again, and only what decides a number decides what that is."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from estimation.aircraft import load_aircraft
from estimation.campaign.plan import plan_from, read_plan
from estimation.campaign.run import CampaignOutcome
from estimation.campaign.tasks import CampaignError, OverdueError
from estimation.campaign.workers.in_process import interrupted_after
from estimation.models import load_model
from estimation.session import runner
from estimation.threads import one_thread
from groundstation.flight import read_flight
from tests.unit.estimation.campaign.running import HOSTILE, altered, repeatable, results_of

Run = Callable[..., CampaignOutcome]


def test_the_numbers_are_those_of_estimate(campaign: Run, flights: list[str], tmp_path: Path) -> None:
    found = campaign({"flights": flights[:1], "methods": ["ml"]})
    craft = load_aircraft("cdfp")
    with one_thread():  # as on a worker: with several, sums are taken in another order
        session = runner.estimate(load_model("lateral", craft), [read_flight(flights[0])], craft, ["ml"])
    result = session.flights[0].results["ml"]
    rows = [r for r in results_of(tmp_path / "out").to_pylist() if r["kind"] == "estimate"]
    assert {r["parameter"]: (r["estimate"], r["std_coloured"]) for r in rows} == {
        n: (e.estimate, e.std_coloured) for n, e in result.parameters.items()
    }
    placed = sorted((r for r in rows if r["place"] is not None), key=lambda r: r["place"])
    assert [r["covariance"] for r in placed] == result.covariance_coloured.tolist()
    fits = {r["parameter"]: r["r2"] for r in results_of(tmp_path / "out").to_pylist() if r["kind"] == "fit"}
    assert fits == {n: f.r2 for n, f in result.flights[0].fit.items()}
    assert (found.done, found.fitted, found.failed) == (1, 1, {})


def test_a_rerun_fits_nothing_and_one_more_flight_is_one_more_fit(
    campaign: Run, flights: list[str], tmp_path: Path
) -> None:
    campaign({"flights": flights[:2]})
    page = (tmp_path / "out" / "manifest.json").read_bytes()
    again = campaign({"flights": flights[:2]})
    assert (again.fitted, again.skipped, again.unchanged) == (0, 2, True)
    assert (tmp_path / "out" / "manifest.json").read_bytes() == page
    more = campaign({"flights": flights[:3], "match": True})
    assert (more.fitted, more.skipped) == (1 + 3, 2)  # its fit, and the group's matches
    assert not more.unchanged
    assert campaign({"flights": flights[:3], "match": True}).fitted == 0


def test_name_path_order_and_company_change_no_number(campaign: Run, flights: list[str], tmp_path: Path) -> None:
    plan = {"methods": ["ml"], "bootstrap": 10}
    campaign({"flights": flights[:2], **plan})
    moved = tmp_path / "elsewhere" / "renamed.csv"
    moved.parent.mkdir()
    shutil.copy(flights[0], moved)
    campaign({"flights": [str(moved)], **plan}, tmp_path / "other")
    names = ("flight", "day")
    first = [
        {k: v for k, v in r.items() if k not in names}
        for r in repeatable(results_of(tmp_path / "out"))
        if r["flight"] == "ordinary_0"
    ]
    other = [{k: v for k, v in r.items() if k not in names} for r in repeatable(results_of(tmp_path / "other"))]
    assert first == other
    assert any(r["bootstrap_std"] for r in first)


def test_the_same_bytes_count_once_and_are_told(campaign: Run, flights: list[str], tmp_path: Path) -> None:
    copy = tmp_path / "copy.csv"
    shutil.copy(flights[0], copy)
    found = campaign({"flights": [flights[0], str(copy)]})
    assert (found.flights, found.done, found.fitted) == (2, 1, 1)
    assert found.duplicates == [(str(copy), flights[0])]


def test_another_method_or_plan_keeps_what_was_done(campaign: Run, flights: list[str], tmp_path: Path) -> None:
    campaign({"flights": flights[:2]})
    both = campaign({"flights": flights[:1], "methods": ["ls", "ml"]})
    assert both.fitted == 1
    assert set(results_of(tmp_path / "out")["flight"].to_pylist()) == {"ordinary_0"}
    assert campaign({"flights": flights[:2]}).fitted == 0
    assert set(results_of(tmp_path / "out")["method"].to_pylist()) == {"ls"}


def test_conditions_are_of_todays_plan(campaign: Run, flights: list[str], tmp_path: Path) -> None:
    campaign({"flight": [{"path": flights[0], "configuration": "old", "date": "2026-03-01"}]})
    found = campaign({"flight": [{"path": flights[0], "configuration": "new", "date": "2026-03-02T10:00:00"}]})
    assert found.fitted == 0
    rows = results_of(tmp_path / "out").to_pylist()
    assert {(r["configuration"], r["day"], r["aircraft"]) for r in rows} == {("new", "2026-03-02", "cdfp")}
    heavier = campaign({"flight": [{"path": flights[0], "mass": 5.0}]})
    assert heavier.fitted == 1  # mass decides numbers


def test_bad_flights_are_rows_and_can_be_tried_again(campaign: Run, flights: list[str], tmp_path: Path) -> None:
    bad = altered(Path(flights[0]), tmp_path / "raises.csv", 1.0)
    plan = {"flights": [*flights[:1], str(bad), str(tmp_path / "nosuch.csv")], "methods": [HOSTILE]}
    found = campaign(plan)
    assert (found.done, sorted(found.failed)) == (1, [str(tmp_path / "nosuch.csv"), str(bad)])
    assert "RuntimeError: on purpose" in found.failed[str(bad)]
    rows = results_of(tmp_path / "out")
    assert rows.filter(pc.equal(rows["status"], "failed"))["flight"].to_pylist() == ["nosuch", "raises"]
    assert campaign(plan).fitted == 0
    assert campaign(plan, retry_failed=True).fitted == 1


def test_a_flight_that_a_method_cannot_settle_is_a_row_with_the_reason(
    campaign: Run, flights: list[str], tmp_path: Path
) -> None:
    bad = altered(Path(flights[0]), tmp_path / "divides.csv", 1.0)
    found = campaign({"flights": [*flights[:1], str(bad)], "methods": [HOSTILE]})
    assert (found.done, list(found.failed)) == (1, [str(bad)])
    assert "failed in its arithmetic (by design)" in found.failed[str(bad)]


def test_joint_estimates_are_in_the_tables(campaign: Run, flights: list[str], tmp_path: Path) -> None:
    campaign({"flights": flights[:2], "joint": True})
    rows = results_of(tmp_path / "out").to_pylist()
    joint = {r["parameter"]: r for r in rows if r["kind"] == "joint"}
    assert (joint["Cl_p"]["group"], joint["Cl_p"]["flight"]) == ("aircraft=cdfp", None)
    single = [r["estimate"] for r in rows if r["kind"] == "estimate" and r["parameter"] == "Cl_p"]
    assert min(single) < joint["Cl_p"]["estimate"] < max(single)
    groups = pq.read_table(tmp_path / "out" / "groups" / "groups.parquet").to_pylist()
    assert {"pooled"} <= {r["kind"] for r in groups}


def test_a_full_check_gives_instrument_factors(campaign: Run, flights: list[str], tmp_path: Path) -> None:
    short = tmp_path / "short.csv"
    short.write_text("\n".join(Path(flights[0]).read_text().splitlines()[:160]))
    campaign({"flights": [str(short)], "check": "full"})
    factors = {r["parameter"] for r in results_of(tmp_path / "out").to_pylist() if r["kind"] == "check"}
    assert factors >= {"dp", "dq", "dr", "K_beta", "dbeta"}


def test_work_in_this_process_ends_at_its_limit() -> None:
    with pytest.raises(OverdueError, match=r"slow: took longer than 0.05 s"), interrupted_after(0.05, "slow"):
        while True:
            pass


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("methods = []", "methods"),
        ("flights = ['a.csv']\nworkers = 2", "workers"),
        ("[[flight]]\npath = 'a.csv'\ndate = 'yesterday'", "flight.0.date"),
        ("groups = ['colour']", "groups.0"),
        ("flights = [", "not a TOML file"),
    ],
)
def test_a_plan_that_cannot_be_used_names_the_key(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(text)
    with pytest.raises(CampaignError, match=said) as caught:
        read_plan(path)
    assert str(path) in str(caught.value)


def test_a_simulated_plan_needs_a_simulator(campaign: Run) -> None:
    with pytest.raises(CampaignError, match="simulate"):
        campaign({"simulate": [{"scenario": "quiet"}]})
    assert plan_from({"simulate": [{"scenario": "quiet", "count": 3}]}, "test").simulate[0].count == 3


def test_bad_flights_that_are_alike_are_each_told(campaign: Run, flights: list[str], tmp_path: Path) -> None:
    empty = [tmp_path / f"empty{i}.csv" for i in range(2)]
    for path in empty:
        path.write_text("")
    plan = {"flights": [*flights[:1], *map(str, empty), str(tmp_path / "nosuch.csv")]}
    found = campaign(plan)
    assert "no such file" in found.failed[str(tmp_path / "nosuch.csv")]
    assert campaign(plan).unchanged
    assert (found.flights, found.done, sorted(found.failed)) == (4, 1, [*map(str, empty), str(tmp_path / "nosuch.csv")])
    rows = results_of(tmp_path / "out")
    assert rows.filter(pc.equal(rows["status"], "failed"))["flight"].to_pylist() == ["empty0", "empty1", "nosuch"]
