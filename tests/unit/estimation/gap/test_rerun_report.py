"""The gap report in rerun, read back: every series with its values and units, and the words beside them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from estimation.gap.answer.result import (
    DisagreementView,
    EffectStep,
    Gap,
    GapResult,
    GapVerdict,
    Histories,
    Weighed,
    Where,
)
from estimation.gap.pages.rerun_report import CLOCK, drawable, write_gap_recording
from estimation.models.load import load_model
from tests.unit.groundstation.viewer.vulkan import need_vulkan

Array = NDArray[np.float64]

SCORES = {"Cn_da": 18.53, "Ixz_error": 18.46, "Cn_betadot": 6.2, "aileron_lag": 2.5}
FLOOR = np.array([0.004, 0.007, 0.005, 0.006, 0.05])
DEGREES = 180.0 / np.pi


def history(flight: str, holdout: bool, rng: np.random.Generator) -> Histories:
    """20 samples of five channels, each course different."""
    measured, before, after = rng.standard_normal((3, 20, 5))
    return Histories(flight, holdout, 0.05 * np.arange(20), measured, before, after, FLOOR)


def an_answer(rng: np.random.Generator) -> GapResult:
    """A gap closed by one effect, on two training flights and one held out."""
    model = load_model("lateral", "cdfp")
    gap = Gap(1.65, 1.19, 1.17)
    step = EffectStep(
        effect="Cn_da", title="adverse yaw from aileron", form="Cn_da", confidence=0.78,
        members=(Weighed("Cn_da", 0.78), Weighed("Ixz_error", 0.22)), separate_by="swing test",
        estimates={"Cn_da": (-0.0084, 0.0002)}, units={"Cn_da": "1/rad"}, score=18.53, threshold=4.06,
        where=Where("yawing moment", ("r",), (), ""), gap=gap, holdout=Gap(1.6, 1.2, 1.17), migrated={},
    )  # fmt: skip
    channels = dict(zip(model.output_names, (1.26, 2.07, 2.23, 1.29, 1.02), strict=True))
    view = DisagreementView("after the refit", 1.65, channels, (), {}, {}, ())
    return GapResult(
        verdict=GapVerdict.GAP_CLOSED, text="adverse yaw from aileron explains the gap", minimum_detectable={}, steps=(step,),
        scores=SCORES, threshold=4.06, nominal_threshold=3.1, rejected=(), ties=(), model_before=model, model_after=model,
        outputs=model.output_names, views=(view,),
        histories=(history("f0", False, rng), history("f1", False, rng), history("f3", True, rng)),
    )  # fmt: skip


@pytest.fixture
def answered(rng: np.random.Generator) -> GapResult:
    return an_answer(rng)


class Recording:
    """Read back with rerun's own reader. values: entity -> (times [s], values); labels, words: entity -> text."""

    def __init__(self, path: Path) -> None:
        from rerun.chunk import RrdReader

        self.values: dict[str, tuple[Array, Array]] = {}
        self.labels: dict[str, str] = {}
        self.words: dict[str, str] = {}
        for chunk in RrdReader(str(path)).stream():
            batch = chunk.to_record_batch()
            columns = {n: batch.column(i).to_pylist() for i, n in enumerate(batch.schema.names)}
            entity = chunk.entity_path.lstrip("/")
            if "Scalars:scalars" in columns:
                times = np.array([t.value * 1e-9 for t in batch.column(batch.schema.names.index(CLOCK))])
                self.values[entity] = times, np.array([v[0] for v in columns["Scalars:scalars"]])
            for series in ("SeriesLines:names", "SeriesPoints:names"):
                if series in columns:
                    self.labels[entity] = columns[series][0][0]
            if "TextDocument:text" in columns:
                self.words[entity] = columns["TextDocument:text"][0][0]


def test_measured_before_and_after_of_every_channel_are_there_in_the_units_shown(
    answered: GapResult, tmp_path: Path
) -> None:
    read = Recording(write_gap_recording(answered, tmp_path / "gap.rrd"))
    shown = {
        "beta": ("deg", DEGREES),
        "p": ("deg/s", DEGREES),
        "r": ("deg/s", DEGREES),
        "phi": ("deg", DEGREES),
        "ay": ("m/s2", 1.0),
    }
    assert set(shown) == set(answered.outputs)
    for h, place in zip(answered.histories, ("training/f0", "training/f1", "held_out/f3"), strict=True):
        for c, name in enumerate(answered.outputs):
            unit, k = shown[name]
            for course in ("measured", "before", "after"):
                entity = f"{place}/{name}/{course}"
                times, values = read.values[entity]
                np.testing.assert_allclose(times, h.time, atol=1e-9)
                np.testing.assert_allclose(values, k * getattr(h, course)[:, c], rtol=1e-12)
                assert read.labels[entity] == f"{course} [{unit}]"


def test_residuals_stand_beside_the_noise_floor(answered: GapResult, tmp_path: Path) -> None:
    read = Recording(write_gap_recording(answered, tmp_path / "gap.rrd"))
    held = answered.histories[2]
    for name in ("p", "ay"):
        c, k = answered.outputs.index(name), DEGREES if name == "p" else 1.0
        place = f"held_out/f3/residual/{name}"
        for course in ("before", "after"):
            left = k * (held.measured - getattr(held, course))[:, c]
            np.testing.assert_allclose(read.values[f"{place}/{course}"][1], left, rtol=1e-9, atol=1e-12)
        times, upper = read.values[f"{place}/floor_upper"]
        assert times.tolist() == [held.time[0], held.time[-1]]
        np.testing.assert_allclose(upper, k * FLOOR[c])
        np.testing.assert_allclose(read.values[f"{place}/floor_lower"][1], -k * FLOOR[c])


def test_verdict_place_and_scores_are_in_words(answered: GapResult, tmp_path: Path) -> None:
    read = Recording(write_gap_recording(answered, tmp_path / "gap.rrd"))
    assert "# gap closed" in read.words["verdict"]
    assert answered.text in read.words["verdict"]
    assert "| Cn_da | 18.5 | 4.1 | 1.65 | 1.19 | 1.17 | 97% | 94% |" in read.words["verdict"]
    assert "| after the refit | **1.65** | 1.26 | 2.07 | 2.23 | 1.29 | 1.02 |" in read.words["where"]
    rows = [line.strip("| ").split(" | ") for line in read.words["scores"].splitlines() if line.startswith("|")][2:]
    told = [row[-1].strip("* ") for row in rows]
    assert told == ["Cn_da", "Ixz_error", "Cn_betadot", "null threshold", "aileron_lag"]
    assert [row[-2].strip("* ") for row in rows] == ["18.5", "18.5", "6.2", "4.06", "2.5"]
    assert [len(row[0]) for row in rows] == [28, 28, 9, 6, 4]


def test_flights_of_one_name_stay_apart(answered: GapResult, rng: np.random.Generator, tmp_path: Path) -> None:
    twins = (history("my flight.v2", False, rng), history("my flight.v2", False, rng))
    read = Recording(write_gap_recording(replace(answered, histories=twins), tmp_path / "gap.rrd"))
    found = [values for entity, (_, values) in sorted(read.values.items()) if entity.endswith("v2/ay/after")]
    again = [values for entity, (_, values) in sorted(read.values.items()) if entity.endswith("again2/ay/after")]
    np.testing.assert_allclose(found, [twins[0].after[:, 4]])
    np.testing.assert_allclose(again, [twins[1].after[:, 4]])


def test_letters_that_the_viewer_cannot_draw_are_replaced() -> None:
    """Its font has no box drawing and no Chinese, and its native window ends at the first such letter."""
    assert drawable("β̇ = −r, ±2° → δ² ≠ ½\n| a |") == "β̇ = −r, ±2° → δ² ≠ ½\n| a |"
    assert drawable("飛行 █ δ ∓ h") == "?? ? δ ? h"


@pytest.mark.viewer
@pytest.mark.timeout(120)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_the_viewer_shows_every_view_and_lives(answered: GapResult, tmp_path: Path) -> None:
    from rerun.experimental import ViewerClient

    from groundstation.viewer.live import free_port
    from groundstation.viewer.window import rerun_binary

    need_vulkan()
    rrd = write_gap_recording(replace(answered, text="δ ∓ h, 飛行"), tmp_path / "gap.rrd")
    viewer = ViewerClient.spawn(
        headless=True, port=free_port(), executable_path=rerun_binary(), hide_welcome_screen=True
    )
    try:
        viewer.open(str(rrd))
        for _ in range(40):
            state = viewer.get_state()
            if state.recordings and state.views and not state.loading:
                break
            viewer.take_screenshot()
        viewer.take_screenshot()
        state = viewer.get_state()
    finally:
        viewer.quit()
    units = {"beta": "deg", "p": "deg/s", "r": "deg/s", "phi": "deg", "ay": "m/s2"}
    expected = {"Verdict", "Where", "Scores of all hypotheses"}
    expected |= {f"{n}{word} [{u}]" for n, u in units.items() for word in ("", " residual")}
    assert {v.name for v in state.views} == expected
    assert {v.name: v.reports for v in state.views if v.reports} == {}
