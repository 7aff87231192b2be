"""What recording costs the card, and what a slow card costs the recording. Run by `make bench`.

Bytes are counted on an ext4 image behind a loop device (root); the slow card is the forgetting one, in real time.
"""

import json
import os
from pathlib import Path

import pytest

from daq.contract.recordings.accounting import verify
from tests.benchmarks.bench_logger import measure
from tests.chain.card.mounted import mounted, need_card
from tests.chain.card.troubles import Troubles
from tests.studies.power_cuts import WAYS, written

SECONDS = float(os.environ.get("CARD_BENCH_S", "30"))


@pytest.mark.benchmark
@pytest.mark.timeout(300)
def test_bytes_written_in_an_hour_of_flight(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("counting what reaches a disk needs root: an ext4 image is mounted")
    unsynced, chosen = (way for way in WAYS if way.name == "no sync at all" or "chosen" in way.name)
    rows = {}
    for way in (unsynced, chosen):
        folder = tmp_path / way.name.replace(" ", "_")
        folder.mkdir()
        medium, recording, syncs = written(way, folder)
        rows[way.name] = {"medium_mb_an_hour": round(medium), "recording_mb_an_hour": round(recording), "syncs": syncs}
    print(json.dumps(rows, indent=1))
    ratio = rows[chosen.name]["medium_mb_an_hour"] / rows[unsynced.name]["medium_mb_an_hour"]
    assert ratio < 3.0, f"syncing writes {ratio:.1f} times what there is to write"


@pytest.mark.benchmark
@pytest.mark.timeout(SECONDS + 180)
def test_no_slot_is_missed_on_a_slow_card(tmp_path: Path) -> None:
    """200 ms for every sync and 5 MB/s; FUSE lets no write pass a sync, so that the writer waits as well."""
    need_card()
    with mounted(tmp_path / "card") as card:
        card.trouble(Troubles(sync_s=0.2, bytes_per_s=5e6))
        result = measure(tmp_path, SECONDS, card.path / "recordings")
        traffic = card.traffic()
        assert verify(Path(str(result["directory"]))).ok
    print(json.dumps({**result, "medium_pages": traffic.pages, "syncs": traffic.syncs}, indent=1))
    assert result["written"] == result["slots"]
    assert result["missed"] == 0
