"""The study of two rates: what is averaged is the same record."""

from pathlib import Path

import numpy as np
import pytest

from groundstation.flight import Flight
from tests.studies.two_rates import averaged, table


def test_an_average_keeps_slow_motion_and_its_clock() -> None:
    time = np.arange(0.0, 20.0, 0.02)
    flight = Flight.build("f", time, {"p": np.sin(0.5 * time), "V": np.full(time.size, 19.0)})
    slow = averaged(flight, 10.0)
    assert slow.sample_interval == pytest.approx(0.1)
    assert slow["p"][5:-5] == pytest.approx(np.sin(0.5 * slow.time[5:-5]), abs=1e-3)


def test_errors_of_three_bounds_are_outside_and_count(tmp_path: Path) -> None:
    (tmp_path / "sets.jsonl").write_text(
        '{"50": {"Cl_p": [0.03, 0.01]}, "10": {"Cl_p": [0.03, 0.03]}}\n', encoding="utf-8"
    )
    assert "| Cl_p | 1 | 3.00 | 1.00 | 0% | 100% | 3.00 | 1.00 |" in list(table(tmp_path / "sets.jsonl"))
