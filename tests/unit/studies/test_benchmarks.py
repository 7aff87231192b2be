"""Benchmarks run by hand, so that a name that is gone would be noticed late."""

import importlib
from pathlib import Path

import pytest


@pytest.mark.parametrize("file", sorted(Path("tests/benchmarks").glob("bench_*.py")), ids=lambda f: f.stem)
def test_a_benchmark_can_be_imported(file: Path) -> None:
    importlib.import_module(".".join(file.with_suffix("").parts))
