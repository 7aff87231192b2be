from pathlib import Path

import pytest

from groundstation.calibration.calibration_set import CalibrationSet, load_calibration, to_toml
from groundstation.calibration.facts import RecordedFacts
from groundstation.calibration.schema import CalibrationError, Instrument

GOOD = """format = 1
instrument = "thrust"
kind = "curve"
channel = "thrust_load"
date = 2026-03-01
method = "weights"
[curve]
kind = "polynomial"
input_unit = "count"
output_unit = "N"
coefficients = [0.0, 2.5e-5]
valid = [0.0, 1.0e6]
"""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("format = 1", "format = 9"), "format"),
        (("coefficients = [0.0, 2.5e-5]", "coefficients = []"), "coefficients"),
        (("valid = [0.0, 1.0e6]", "valid = [5.0, 1.0]"), "valid"),
        (('channel = "thrust_load"', 'channel = "trust"'), "trust is not in the channel table"),
        (("[curve]", "[crve]"), "crve"),
        (("date = 2026-03-01", "date = soon"), "TOML"),
        (("coefficients = [0.0, 2.5e-5]", "coefficients = [0.0, nan]"), "coefficients"),
    ],
)
def test_mistakes_are_named(change: tuple[str, str], words: str) -> None:
    with pytest.raises(CalibrationError, match=words) as caught:
        CalibrationSet.from_texts("bench", {"thrust.toml": GOOD.replace(*change)})
    assert "bench/thrust.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_instrument_twice_is_an_error() -> None:
    with pytest.raises(CalibrationError, match="twice"):
        CalibrationSet.from_texts("bench", {"a.toml": GOOD, "b.toml": GOOD})


def test_missing_directory_names_what_is_built_in(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="built in: autopilot, cdfp"):
        load_calibration(tmp_path / "nowhere")
    with pytest.raises(CalibrationError, match="no calibration file"):
        load_calibration(tmp_path)


def test_written_files_read_back_exactly() -> None:
    for item in load_calibration("cdfp").instruments.values():
        again = CalibrationSet.from_texts("x", {"a.toml": to_toml(item)}).instruments[item.instrument]
        assert again == item


def test_strings_survive_writing() -> None:
    item = CalibrationSet.from_texts("x", {"a.toml": GOOD}).instruments["thrust"]
    odd = item.model_copy(update={"method": 'he said "1 \\ 2"\nand left'})
    assert CalibrationSet.from_texts("x", {"a.toml": to_toml(odd)}).instruments["thrust"].method == odd.method


def test_facts_are_checked() -> None:
    with pytest.raises(CalibrationError, match="hexadecimal"):
        RecordedFacts({"static.nvm": "xyz"}).nvm("static")
    with pytest.raises(CalibrationError, match=r"imu\.gyro_delay_s"):
        RecordedFacts({"imu.gyro_delay_s": "long"}).lag("gyro")
    assert RecordedFacts({}).lag("gyro") == RecordedFacts({}).delay("pitot", "pitot") == 0.0
    assert RecordedFacts({"analog_a.beta_vane_after_s": "-0.000858"}).offset_in_group("beta_vane") == -0.001


def test_files_are_immutable() -> None:
    item = load_calibration("cdfp").instruments["pitot"]
    assert isinstance(item, Instrument)
    with pytest.raises(ValueError, match="frozen"):
        item.method = "other"
