"""Parts on disk: whole or not at all, each key once, set aside where they cannot be read."""

import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from daq.utilities.durable import ENDING
from estimation.campaign.schema import RESULTS, VERSION_KEY, arrow_schema
from estimation.campaign.store import EVERY_S, Store
from estimation.campaign.tasks import CampaignError


class Clock:
    """Seconds that pass when told."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def rows(key: str) -> list[dict[str, object]]:
    return [{"key": key, "kind": kind, "parameter": p} for kind, p in (("run", None), ("estimate", "Cl_p"))]


def parts(folder: Path) -> list[Path]:
    return sorted((folder / "results").glob("*.parquet"))


def test_nothing_waits_longer_than_ten_seconds_for_the_disk(tmp_path: Path) -> None:
    clock, unwritten, longest = Clock(), 0.0, 0.0
    with Store(tmp_path, clock) as store:
        for second in range(60):
            clock.now = float(second)
            before = len(parts(tmp_path))
            store.add(rows(f"k{second}"))
            if len(parts(tmp_path)) > before:
                unwritten = clock.now + 1.0
            longest = max(longest, clock.now - unwritten)
        assert 4 < len(parts(tmp_path)) < 12
    assert longest <= EVERY_S
    with Store(tmp_path, clock) as store:
        assert len(set(store.load()["key"].to_pylist())) == 60


def test_a_key_in_two_parts_counts_once(tmp_path: Path) -> None:
    """As a kill leaves it between the joined file and the end of its parts."""
    with Store(tmp_path, Clock()) as store:
        store.add(rows("a"))
        store.flush()
        store.add([*rows("a"), *rows("b")])
        store.flush()
        table = store.load()
        assert sorted(table["key"].to_pylist()) == ["a", "a", "b", "b"]
        store.replace_all(table, table.slice(0, 0))
        assert len(parts(tmp_path)) == 1
        assert store.load().num_rows == 4


def test_a_damaged_part_is_set_aside_and_half_written_ones_go(tmp_path: Path) -> None:
    with Store(tmp_path, Clock()) as store:
        store.add(rows("a"))
    broken = tmp_path / "results" / "part-broken.parquet"
    broken.write_bytes(parts(tmp_path)[0].read_bytes()[:-20])
    gone = subprocess.run(
        [sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True, check=True
    )
    half = tmp_path / "results" / f".part-half.parquet.{int(gone.stdout)}.00ff00ff00ff{ENDING}"
    half.write_bytes(b"PAR1")
    with Store(tmp_path, Clock()) as store:
        assert set(store.load()["key"].to_pylist()) == {"a"}
        assert store.damaged == [tmp_path / "damaged" / "part-broken.parquet"]
    assert not half.exists()
    assert store.damaged[0].is_file()


def test_two_campaigns_do_not_share_a_folder(tmp_path: Path) -> None:
    with (
        Store(tmp_path, Clock()),
        pytest.raises(CampaignError, match="another campaign writes there"),
        Store(tmp_path, Clock()),
    ):
        pass


def test_older_tables_are_read_with_empty_columns_and_later_ones_refused(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    old = pa.table({"key": ["a"], "kind": ["run"]}).replace_schema_metadata({VERSION_KEY: "1"})
    pq.write_table(old, folder / "part-old.parquet")
    with Store(tmp_path, Clock()) as store:
        assert store.load().schema.equals(arrow_schema(RESULTS))
        assert store.load()["estimate"].to_pylist() == [None]
    pq.write_table(old.replace_schema_metadata({VERSION_KEY: "2"}), folder / "part-new.parquet")
    with Store(tmp_path, Clock()) as store, pytest.raises(CampaignError, match="later Sideslip"):
        store.load()
