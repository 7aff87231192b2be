"""Mutated files by seed through everything that reads a recording, a flight or a telemetry log: an answer or a sentence."""

from pathlib import Path

import pytest

from tests.unit.daq.fuzzing import answered, mutated

CASES = 250
ONCE_FAILED = (100_172, 101_166)  # Parquet files whose provenance is no JSON, and no text


@pytest.mark.parametrize("block", range(5))
def test_mutated_files_are_answered(block: int, tmp_path: Path) -> None:
    for seed in range(block * CASES // 5, (block + 1) * CASES // 5):
        check(seed, tmp_path)


@pytest.mark.parametrize("seed", ONCE_FAILED)
def test_what_once_failed(seed: int, tmp_path: Path) -> None:
    check(seed, tmp_path)


def check(seed: int, folder: Path) -> None:
    """One case: an answer or a sentence from each reader; pytest shows the seed of a failure."""
    ending, data = mutated(seed)
    path = folder / f"case_{seed}{ending}"
    path.write_bytes(data)
    said = answered(path)
    assert all(words.strip() and "\n" not in words for words in said), said
