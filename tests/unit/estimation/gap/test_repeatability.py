"""Are the flights admissible: do they repeat each other, is a channel stale, clipped or missing; and the rerun recording."""

from pathlib import Path

import numpy as np
import pytest

from estimation.gap.answer.result import GapResult
from estimation.gap.criteria import AS_SET
from estimation.gap.effects import catalogue
from estimation.gap.pages.rerun_report import write_gap_recording
from estimation.gap.records.channels import sample_notes
from estimation.gap.workflow import Options, run_gap
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import second_truth as truth


@pytest.fixture(scope="module")
def answered() -> GapResult:
    """Three flights; the last is of an aircraft whose roll damping is half as large again."""
    derivatives = dict(truth.TRUE_DERIVATIVES)
    other = derivatives | {"Cl_p": 1.5 * derivatives["Cl_p"]}
    requests = [
        truth.Request(60 + i, v, {}, duration=20.0, derivatives=d)
        for i, (v, d) in enumerate(((14.5, derivatives), (16.5, derivatives), (19.0, other)))
    ]
    flights = [
        Flight.build(f"f{i}", c["time"], {k: v for k, v in c.items() if k != "time"})
        for i, c in enumerate(truth.fly(requests))
    ]
    asked = [e for e in catalogue() if e.name in ("Cn_da", "Cl_betadot", "aileron_lag", "imu_lever_arm")]
    return run_gap(load_model("lateral", "cdfp"), flights, (), asked, options=Options(seed=2, nulls=20, most=1))


@pytest.mark.study  # its rule is in test_rules_fit.py, the recording of a hand-made answer in test_rerun_report.py
def test_the_flight_of_another_aircraft_does_not_repeat_the_others(answered: GapResult) -> None:
    chi2 = {r["flight"]: r for r in answered.details["repeatability"]}
    assert chi2["f2"]["odd"]
    assert chi2["f2"]["chi2"] == max(r["chi2"] for r in chi2.values())
    assert "f2" in answered.text


@pytest.mark.study
def test_the_same_in_rerun(answered: GapResult, tmp_path: Path) -> None:
    path = write_gap_recording(answered, tmp_path / "gap.rrd")
    assert path.read_bytes()[:3] == b"RRF"
    assert path.stat().st_size > 50_000


def test_stale_clipped_and_missing_channels_are_told() -> None:
    time = np.arange(400) * 0.05
    rng = np.random.default_rng(0)
    fine = np.sin(time) + 0.01 * rng.standard_normal(400)
    stale = fine[(np.arange(400) // 3) * 3]
    holes = fine.copy()
    holes[50:70] = np.nan
    flight = Flight.build("f", time, {"p": np.clip(fine, -1.0, 0.8), "beta": stale, "r": holes, "phi": fine})
    said = " ".join(sample_notes([flight], ["p", "beta", "r", "phi", "ay"], AS_SET))
    assert "f: p stands at its upper end 0.8" in said
    assert "f: beta repeats its last value in 66%" in said
    assert "f: r is missing in 5%" in said
    assert "phi" not in said
