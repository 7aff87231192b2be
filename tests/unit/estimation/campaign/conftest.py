"""Campaigns over a few small flights in this process."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from estimation.campaign.plan import plan_from
from estimation.campaign.run import Campaign, CampaignOutcome
from estimation.campaign.sources import entries_of
from estimation.campaign.store import Store
from estimation.campaign.work_list import work_list
from estimation.campaign.workers.in_process import SerialEngine


@pytest.fixture
def campaign(tmp_path: Path) -> Callable[..., CampaignOutcome]:
    """Run a plan in this process, into tmp_path/out unless told otherwise."""

    def run(plan: dict[str, Any], out: Path = tmp_path / "out", *, retry_failed: bool = False) -> CampaignOutcome:
        checked = plan_from({"aircraft": "cdfp", "methods": ["ls"], **plan}, "test")
        with Store(out, time.monotonic) as store:
            work = work_list(checked, entries_of(checked, Path()), Path())
            engine = SerialEngine()
            return Campaign(checked, work, store, lambda _: engine, lambda *told: None).run(retry_failed=retry_failed)

    return run


@pytest.fixture(scope="session")
def flights(root: Path, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Paths of four sound flights: the first 15 s of recordings."""
    folder = tmp_path_factory.mktemp("ordinary")
    for i in range(4):
        lines = (root / "recordings" / "foreign" / f"ordinary_{i}.csv").read_text(encoding="utf-8").splitlines()
        (folder / f"ordinary_{i}.csv").write_text("\n".join(lines[:302]) + "\n", encoding="utf-8")
    return [str(folder / f"ordinary_{i}.csv") for i in range(4)]
