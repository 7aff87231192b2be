"""Bench recordings: what was set is in the recording when the plan says so, and a fit gets the instruments' truth back."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from daq.contract.recordings.reading import read_recording
from firmware_sim.hardware.sensing.sensor_models import SensorModels
from firmware_sim.hardware.sensing.units import calibration_truth
from firmware_sim.runs.bench_recordings import BenchRig, Pose, SimulatedBench, bench_titles, bench_truth, record_bench
from firmware_sim.tables import ScenarioError
from firmware_sim.world.ground import direction_cosines
from groundstation.calibration.bench_plan import load_plan


def test_the_rig_moves_between_poses_and_stands_on_them() -> None:
    bench = SimulatedBench("test", (Pose(left=0.0), Pose(left=0.2)), ())
    rig = BenchRig(bench, SensorModels())
    start, stop = bench.window(1)
    assert rig.advance(bench.window(0)[0]).left_elevon == 0.0
    assert rig.advance(start).left_elevon == rig.advance(stop).left_elevon == 0.2
    assert rig.advance(bench.duration_s + 10.0).left_elevon == 0.2


def test_turning_by_hand_shows_in_the_rates() -> None:
    """The rates of the rig, integrated, turn one attitude into the next."""
    bench = SimulatedBench("test", (Pose(), Pose(attitude=(0.6, -0.4, 1.0))), (), tumbling=True)
    rig = BenchRig(bench, SensorModels())
    start = 1.5 + bench.dwell_s + 1.0
    step = 0.001
    turn = direction_cosines(0.0, 0.0, 0.0)
    for k in range(round((bench.dwell_s + 1.0) / step)):
        p, q, r = rig.advance(start + (k + 0.5) * step).rates
        turn = turn - step * np.array([[0.0, -r, q], [r, 0.0, -p], [-q, p, 0.0]]) @ turn
    assert turn == pytest.approx(direction_cosines(0.6, -0.4, 1.0), abs=2e-3)


def test_vanes_stand_where_they_are_put_whatever_the_wash() -> None:
    models = SensorModels().altered(
        beta_vane={"wash_factor": 1.2, "wash_offset": 0.01}, alpha_vane={"wash_factor": 0.9}
    )
    truth = bench_truth(0.0, Pose(vane_alpha=0.3, vane_beta=-0.2, speed=20.0), models)
    u = math.cos(truth.alpha) * math.cos(truth.beta)
    assert 1.2 * math.atan2(math.sin(truth.beta), u) + 0.01 == pytest.approx(-0.2)
    assert 0.9 * truth.alpha == pytest.approx(0.3)


def test_load_bench_recording_and_plan_agree(tmp_path: Path) -> None:
    unit = {"unit": 9}
    files = record_bench("bench_load", tmp_path, sensors=unit)
    (fit,) = load_plan(files.plan).fit
    scans = list(read_recording(tmp_path / "onboard").scans())
    exact = calibration_truth(SensorModels().altered(**unit))["thrust"]
    for dwell in fit.dwell:
        counts = [s.values["thrust_load"] for s in scans if dwell.start <= s.time - scans[0].time <= dwell.stop]
        newton = (np.mean(counts) - exact["zero_count"]) * exact["newton_per_count"]
        assert len(counts) == pytest.approx(20 * (dwell.stop - dwell.start), abs=1)
        assert newton == pytest.approx(dwell.reference, abs=4 * math.hypot(0.02, 0.05 / math.sqrt(len(counts))))


def test_every_bench_has_a_plan_that_the_fitting_reads() -> None:
    from firmware_sim.runs.bench_recordings import _BENCHES, _plan_text
    from groundstation.calibration.bench_plan import BenchPlan

    assert len(bench_titles()) == 7
    for make in _BENCHES.values():
        bench = make(np.random.default_rng(1))
        plan = BenchPlan.model_validate(tomllib.loads(_plan_text(bench, 0.3)))
        assert max(d.stop for fit in plan.fit for d in fit.dwell) < bench.duration_s


def test_unknown_bench(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="bench_tunnel"):
        record_bench("bench_wings", tmp_path)
