"""What `make torture` does, with one verb and few trials; and that it sees a file that is written under its final name."""

import random
from pathlib import Path

import pytest

from tests.support.paths import ROOT
from tests.torture.trials import OLD, Tally, Trials, shim, two
from tests.torture.verbs import Inputs

pytestmark = [pytest.mark.timeout(300)]


@pytest.fixture
def trials(tmp_path: Path) -> Trials:
    inputs = Inputs({"RAW": ROOT / "recordings/cdfp_ld2_raw.mcap"})
    return Trials("info", tmp_path, inputs, random.Random(3), shim(tmp_path))


def test_a_verb_is_killed_meets_a_full_disk_and_itself(trials: Trials) -> None:
    try:
        killed, full, both = trials.killed(6), trials.full(4), two(trials, trials)
    finally:
        trials.close()
    assert (killed.trials, both.trials) == (7, 1)
    assert full.trials >= 3
    assert killed.faults + full.faults + both.faults == []


def test_a_file_that_is_neither_old_nor_new_is_seen(trials: Trials) -> None:
    try:
        (out,) = trials.empty()
        for content, spoilt in ((OLD, False), (b'{"scans": 594}', False), (b'{"scans": 5', True), (b"", True)):
            out.write_bytes(content)
            tally = Tally()
            trials.look(tally, [out], "in a test", leftovers=False)
            assert bool(tally.faults) is spoilt
        out.unlink()
        trials.look(tally := Tally(), [out], "in a test", leftovers=False)
        assert tally.faults == ["info: out.json gone in a test"]
    finally:
        trials.close()
