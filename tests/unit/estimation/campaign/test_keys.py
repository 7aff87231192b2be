"""Keys of stored results: a change of any source file that decides a number makes them old."""

from pathlib import Path

import pytest
from grimp import build_graph

from estimation.campaign import work_list as planning
from estimation.campaign.keys import SOURCES_OF_RESULTS, digest_of_files, digest_of_own_code
from estimation.campaign.plan import plan_from
from estimation.campaign.sources import entries_of
from estimation.campaign.work_list import Member, joint_work, work_list
from estimation.estimators.registry import built_in
from tests.support.paths import ROOT

WORKER = "estimation.campaign.workers.work"
METHODS = "estimation.estimators.methods"  # found by name, not imported
AERODYNAMICS = "estimation/campaign/aerodynamics"  # in the key of the one kind of work that uses it

UNCOUNTED = {
    "daq/contract/errors.py": "messages",
    "daq/utilities": "reading within bounds, durable writing, messages; its constants are counted",
    "estimation/campaign/keys.py": "makes the keys",
    "estimation/campaign/plan.py": "checks the plan, whose values enter the keys",
    "estimation/campaign/pooling.py": "works on the tables of results, anew in every run",
    "estimation/campaign/sources.py": "fetches bytes, whose digest is in the key",
    "estimation/campaign/tasks.py": "carries what the keys are made of",
    "estimation/errors.py": "messages",
    "estimation/own_code.py": "imports by name",
    "estimation/simulation": "no simulation is attached",
    "estimation/structure": "no structure is tested: StructureWish.OFF",
}
"""What a worker imports and no number of its results depends on -> why."""


def is_below(file: str, places: tuple[str, ...]) -> bool:
    return any(file == place or file.startswith(f"{place}/") for place in places)


def test_every_source_that_a_worker_imports_is_counted_or_decides_no_number() -> None:
    graph = build_graph("estimation", "groundstation", "daq", exclude_type_checking_imports=True, cache_dir=None)
    entries = {WORKER, *graph.find_descendants(METHODS)}
    imported = entries.union(*(graph.find_upstream_modules(entry) for entry in entries))
    paths = [ROOT / module.replace(".", "/") for module in imported if not graph.find_children(module)]
    files = {path.with_suffix(".py").relative_to(ROOT).as_posix() for path in paths}
    places = (*SOURCES_OF_RESULTS, AERODYNAMICS, *UNCOUNTED)
    assert not {file for file in files if not is_below(file, places)}
    assert not {place for place in places if not (ROOT / place).exists()}


@pytest.mark.parametrize("place", ["estimation/prepare", "daq/identification", "groundstation/flight"])
def test_a_change_below_a_counted_folder_changes_the_digest(place: str, tmp_path: Path) -> None:
    assert place in SOURCES_OF_RESULTS
    file = tmp_path / place / "deep" / "some.py"
    file.parent.mkdir(parents=True)
    file.write_text("GAIN = 1.0\n")
    before = digest_of_files(SOURCES_OF_RESULTS, tmp_path)
    file.write_text("GAIN = 1.1\n")
    assert digest_of_files(SOURCES_OF_RESULTS, tmp_path) != before


def test_a_change_of_a_users_estimator_makes_its_results_old(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    code = "from estimation import Estimator\ndef fit(task): ...\nOWN = Estimator('own-fit', 'own', fit)\n"
    (tmp_path / "own_fits.py").write_text(code)
    flight = str(ROOT / "recordings" / "foreign" / "ordinary_0.csv")
    plan = plan_from({"flights": [flight], "aircraft": "cdfp", "methods": ["ls", "own_fits:OWN"]}, "test")
    entries = entries_of(plan, tmp_path)
    (before,) = work_list(plan, entries, tmp_path).planned
    (tmp_path / "own_fits.py").write_text(f"{code}GAIN = 1.1\n")
    (after,) = work_list(plan, entries, tmp_path).planned
    assert before.work.pieces["ls"] == after.work.pieces["ls"]
    assert before.work.pieces["own_fits:OWN"] != after.work.pieces["own_fits:OWN"]
    assert not {name for name, estimator in built_in().items() if digest_of_own_code(estimator)}


def test_another_version_does_not_change_the_order_of_flights_in_a_joint_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    flights = [str(ROOT / "recordings" / "foreign" / f"ordinary_{i}.csv") for i in range(4)]
    plan = plan_from({"flights": flights, "aircraft": "cdfp", "methods": ["ls"]}, "test")
    orders = set()
    for code in "abcdefgh":
        monkeypatch.setattr(planning, "versions", lambda code=code: {"code": code})
        planned = work_list(plan, entries_of(plan, ROOT), ROOT).planned
        work = joint_work(plan, "all flights", [Member(p, {"ls": {"Cl_p": (-0.4, 1e-4)}}) for p in planned])
        assert work is not None
        orders.add(tuple(subject.source.name for subject in work.subjects))
    assert len(orders) == 1
